"""The production of one header: shares, and what its torque depends on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from drawn_machines import drawn_machines

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.acceptance import (
    AcceptedRange,
    StudyQuestion,
    StudySummary,
    summarise,
)
from dqforge.optimizer.exploration.yields import (
    LEAST_MARGIN,
    LOSS_PENALTY,
    TORQUE_ERROR,
    TORQUE_MADE,
    TORQUE_MAX,
    FixedDrive,
    check_outputs,
    header_budget,
    nominal_header,
    output_names,
    yield_outputs,
)
from dqforge.optimizer.losses.loss_map import budget_options

SEED = 20261122
DRAWN = ("r_s", "l_d", "l_q", "psi_pm", "v_dc")
ACCEPT = (
    AcceptedRange(TORQUE_ERROR, "torque", below=0.05),
    AcceptedRange(LOSS_PENALTY, "penalty", below=0.003),
    AcceptedRange(LEAST_MARGIN, "margin", above=np.deg2rad(68.0)),
    AcceptedRange("losses.total", "loss", below=800.0),
)


@cache
def drive() -> tuple[LinearMachine, FixedDrive]:
    design = catalogue.load("paper000-ipmsm-100kw")
    assert isinstance(design.machine, LinearMachine)
    fixed = FixedDrive(nominal_header(design), design.inverter, budget_options(design))
    return design.machine, fixed


@dataclass(frozen=True)
class Part:
    """Rows of the production."""

    first: int
    columns: dict[str, FloatArray]
    messages: tuple[str, ...] = ()

    @property
    def states(self) -> np.ndarray:
        return np.zeros(self.columns["v_dc"].size, dtype=np.int8)


def part(number: int, size: int, wanted: tuple[str, ...], cut: float) -> Part:
    machine, fixed = drive()
    machines = drawn_machines(machine, size, SEED + number, cut)
    v_dc = 500.0 * (1.0 + 0.1 * np.random.default_rng([SEED, number]).uniform(-1.0, 1.0, size))
    columns = {name: getattr(machines, name) for name in DRAWN[:4]} | {"v_dc": v_dc}
    columns |= yield_outputs(fixed.header, machines, wanted, v_dc)
    budget = header_budget(fixed, machines, np.array([130.0]), np.array([300.0]), ("ddt-gdpwm",))
    return Part(number * size, columns | {"losses.total": budget.total[0, 0]})


def production(parts: int, size: int, cut: float) -> StudySummary:
    question = StudyQuestion(
        accept=ACCEPT, inputs=DRAWN, drawn=DRAWN, sensitivity=(TORQUE_MADE,), spread=(TORQUE_ERROR,)
    )
    wanted = tuple(name for name in question.columns if name.startswith(("reference", "gains")))
    return summarise(question, (part(number, size, wanted, cut) for number in range(parts)))


@pytest.mark.parametrize(
    ("cut", "expected", "parts"),
    [(3.0, 0.7986, 6), pytest.param(np.inf, 0.795, 20, marks=pytest.mark.slow)],
)
def test_the_worked_example_has_its_yield_and_its_sensitivities(
    cut: float, expected: float, parts: int
) -> None:
    """Tails of the distributions that are cut at three standard deviations are worth 0.4 %."""
    found = production(parts, 5000, cut)
    assert found.rows == 5000 * parts
    assert found.acceptance.share_of_all().value == pytest.approx(expected, abs=0.004)
    assert found.acceptance.share(0).value == pytest.approx(0.8604, abs=0.008)
    assert found.acceptance.share(1).value == pytest.approx(0.8594, abs=0.008)
    assert found.acceptance.met[2] == found.rows
    if np.isfinite(cut):
        assert found.acceptance.met[3] == found.rows
    sensitivity = dict(zip(DRAWN, found.sensitivities[0].first.tolist(), strict=True))
    assert sensitivity["l_q"] == pytest.approx(0.58, abs=0.01)
    assert sensitivity["psi_pm"] == pytest.approx(0.22, abs=0.01)
    assert sensitivity["l_d"] == pytest.approx(0.20, abs=0.01)
    assert sensitivity["r_s"] == pytest.approx(0.0, abs=0.001)
    assert sensitivity["v_dc"] == pytest.approx(0.0, abs=0.001)


def test_every_machine_of_the_worked_example_keeps_its_margin() -> None:
    machine, fixed = drive()
    machines = drawn_machines(machine, 2000, SEED)
    v_dc = 500.0 * (1.0 + 0.1 * np.random.default_rng(SEED).uniform(-1.0, 1.0, 2000))
    margin = np.rad2deg(yield_outputs(fixed.header, machines, (LEAST_MARGIN,), v_dc)[LEAST_MARGIN])
    assert 68.0 < np.min(margin) < 70.0
    assert 71.0 < np.max(margin) < 72.5


def test_only_what_is_asked_for_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    machine, fixed = drive()
    few = MachineBatch.of([machine])
    everything = yield_outputs(fixed.header, few, output_names(fixed.header))
    assert tuple(everything) == output_names(fixed.header)
    for name, values in everything.items():
        assert np.array_equal(yield_outputs(fixed.header, few, (name,))[name], values)
    monkeypatch.setattr("dqforge.optimizer.exploration.yields.loop_outputs", None)
    assert TORQUE_ERROR in yield_outputs(fixed.header, few, (TORQUE_ERROR,))
    monkeypatch.setattr("dqforge.optimizer.exploration.yields.reference_points", None)
    assert yield_outputs(fixed.header, few, ()) == {}
    assert yield_outputs(fixed.header, few, (TORQUE_MAX,))[TORQUE_MAX].tolist() == [200.0]


def test_names_that_a_fixed_header_does_not_have_are_refused() -> None:
    _, fixed = drive()
    with pytest.raises(InputError, match=r"reference\.torque_eror: is not known of a fixed"):
        check_outputs(fixed.header, ("reference.torque_eror",))
    with pytest.raises(InputError, match=r"gains\.speed: .* current loops"):
        check_outputs(fixed.header, ("gains.speed.phase_margin",))
    weakened = replace(fixed.header, speed=500.0)
    with pytest.raises(InputError, match=r"loss_penalty: the header keeps the voltage limit"):
        check_outputs(weakened, (LOSS_PENALTY,))
    check_outputs(weakened, (TORQUE_ERROR, TORQUE_MADE, LEAST_MARGIN))
