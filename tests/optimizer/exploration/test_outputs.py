"""Names of outputs: which there are, which a design has, and what is said of the others."""

from __future__ import annotations

import pytest
from study_trials import POINTS, plan_of

from dqforge.machines.design.catalogue import load
from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.row_outputs import (
    LOSS_PEAKS,
    LOSS_POWERS,
    default_outputs,
    known_names,
    output_named,
)
from dqforge.optimizer.losses.drive_budget import PARTS, DriveBudget

_NO_SPEED = "set: {control: {current_loop: {method: magnitude-optimum}}}\n"


@pytest.mark.parametrize(
    ("name", "unit", "step"),
    [
        ("reference.torque_max", "N m", "limit"),
        ("reference.torque_error", "", "yields"),
        ("fit.error.i_d", "A", "fit"),
        ("gains.i_q.delay_margin", "s", "current-loops"),
        ("gains.speed.crossover", "rad/s", "speed-loop"),
        ("losses.total", "W", "losses"),
        ("losses.points.12.svpwm.ripple_current", "A", "losses"),
        ("losses.points.0.junction_temperature", "degC", "losses"),
    ],
)
def test_outputs_have_unit_and_step(name: str, unit: str, step: str) -> None:
    output = output_named(name)
    assert output is not None
    assert (output.unit, output.step) == (unit, step)


@pytest.mark.parametrize(
    "name", ["losses.points.01.total", "losses.points.0.none.total", "losses.points.0", "torque"]
)
def test_other_names_are_none(name: str) -> None:
    assert output_named(name) is None


def test_losses_are_those_of_the_budget() -> None:
    quantities = {**LOSS_POWERS, **LOSS_PEAKS}
    assert set(PARTS) < set(quantities)
    assert set(quantities) <= set(DriveBudget.__dataclass_fields__)


def test_default_outputs_exist_and_stand_once() -> None:
    names = default_outputs(load("paper000-ipmsm-100kw"), header=False)
    assert len(set(names)) == len(names)
    assert all(output_named(name) for name in names)
    assert "gains.speed.phase_margin" in names
    assert "losses.points.0.junction_temperature" in names
    assert "gains.speed.phase_margin" not in default_outputs(load("thor-pmsyrm-5k"), header=True)
    assert all(output_named(name) for name in known_names())


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (
            f"{_NO_SPEED}accept: {{gains.speed.phase_margin: {{above: 60 deg}}}}\n",
            r"study\.yaml:5:10: accept\.gains\.speed\.phase_margin: the design has no speed loop; ",
        ),
        ("outputs: [fit.error.i_e]\n", r"study\.yaml:4:\d+: .*did you mean fit\.error\.i_[dq]\?"),
        ("limits: {losses.total: 6 W}\n", r"study\.yaml:4:10: limits\.losses\.total: .*no operat"),
        ("pareto: {minimise: [reference.torque_error]}\n", r"needs a fixed header"),
        (
            "pareto: {minimise: [fit.path]}\n",
            r"study\.yaml:4:\d+: .* is a word, not a number; write it",
        ),
        (
            "limits: {fit.path: 3}\n",
            r"study\.yaml:4:10: limits\.fit\.path: .* is a word, not a number",
        ),
    ],
)
def test_what_a_design_cannot_give_is_refused_with_its_place(body: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        plan_of(body, "thor-pmsyrm-5k")


def test_points_that_the_design_does_not_have() -> None:
    bound = "accept: {losses.total: {below: 8 W, point: {torque: 1 N m, speed: 3 rad/s}}}\n"
    with pytest.raises(InputError, match=r"study\.yaml:\d+:\d+: accept\.losses\.total: .*1 N m at"):
        plan_of("set:\n" + POINTS + bound)
    with pytest.raises(InputError, match=r"the design has 3 operating points, counted from 0"):
        plan_of("set:\n" + POINTS + "outputs: [losses.points.3.total]\n")
