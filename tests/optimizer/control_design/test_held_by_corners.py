"""A speed loop on an observer holds over the tolerances, or is refused with what holds instead."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from observed_runs import random_design

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.control_design import observed_remedies
from dqforge.optimizer.control_design.design_drive import machine_top, reachable_speed, top_speed
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.optimizer.loops.observed_margins import CornerJudgement
from dqforge.reports.observers.speed_loop_text import (
    beyond_notes,
    corner_words,
    plain_observed,
    promise_lines,
    with_promise,
)

FEW = Tolerances(l_q=0.1, psi_pm=0.1)  # Four corners, so that a drive is judged within a second.


def by_rule(seed: int, method: ObserverMethodName, tolerances: Tolerances | None = FEW) -> Design:
    """A random drive whose loop is left to the rule."""
    design = random_design(np.random.default_rng(seed), method)
    control = design.control
    assert control.speed_loop is not None
    loop = replace(control.speed_loop, spread=4.0, counts_observer=True)
    return replace(design, control=replace(control, speed_loop=loop, tolerances=tolerances))


def corners_of(gains: GainSet) -> CornerJudgement:
    assert gains.speed is not None
    assert gains.speed.observed is not None
    assert gains.speed.observed.corners is not None
    return gains.speed.observed.corners


@pytest.fixture(scope="module")
def slowed() -> tuple[Design, GainSet]:
    """One whose loop by the rule alone is stable at no speed."""
    design = by_rule(0, "matsui-voltage")
    return design, solve_gains(design)


def test_a_range_that_the_dead_time_leaves_nothing_of_is_said(
    slowed: tuple[Design, GainSet],
) -> None:
    speed = slowed[1].speed
    assert speed is not None
    assert speed.observed is not None
    held = corners_of(slowed[1])
    nowhere = replace(held.exact, low=np.nan, high=np.nan)
    lossy = replace(held, lost=(0.5,), dead_time=nowhere)
    seen = replace(speed, observed=replace(speed.observed, corners=lossy))
    assert (
        "with 0.5 v of dead time, an indication: nowhere" in " ".join(promise_lines(seen)).lower()
    )


def test_a_loop_of_the_rule_is_slowed_down_until_every_corner_holds(
    slowed: tuple[Design, GainSet],
) -> None:
    design, gains = slowed
    assert gains.speed is not None
    assert gains.speed.observed is not None
    spread, found = gains.speed.observed.slowed, corners_of(gains)
    assert spread is not None
    assert spread > 4.0
    assert found.holds
    assert found.binding.high == pytest.approx(top_speed(design))
    require_observed(design, gains)


def given_loop(slowed: tuple[Design, GainSet], factor: float) -> Design:
    """The same drive with given gains, a factor times those that hold."""
    design, gains = slowed
    assert gains.speed is not None
    assert design.control.speed_loop is not None
    loop = replace(
        design.control.speed_loop,
        method="given",
        kp=factor * gains.speed.kp,
        ki=factor**2 * gains.speed.ki,
        counts_observer=False,
    )
    return replace(design, control=replace(design.control, speed_loop=loop))


@pytest.mark.slow
def test_given_gains_that_fail_at_a_corner_are_refused_with_gains_that_hold(
    slowed: tuple[Design, GainSet],
) -> None:
    design = given_loop(slowed, 2.2)
    with pytest.raises(NoSolutionError) as refused:
        require_observed(design, solve_gains(design))
    text = refused.value.message
    assert "there is no speed at which it holds" in text
    narrow = re.search(r"tolerances of ([\d.]+) % of these", text)
    assert narrow is not None
    share = float(narrow.group(1)) / 100.0
    named = Tolerances(l_q=0.1 * share, psi_pm=0.1 * share)
    narrower = replace(design, control=replace(design.control, tolerances=named))
    require_observed(narrower, solve_gains(narrower))
    pair = re.search(r"kp = ([\d.e-]+) N m s/rad and ki = ([\d.e-]+) N m/rad", text)
    assert pair is not None
    assert design.control.speed_loop is not None
    loop = replace(design.control.speed_loop, kp=float(pair.group(1)), ki=float(pair.group(2)))
    calmer = replace(design, control=replace(design.control, speed_loop=loop))
    require_observed(calmer, solve_gains(calmer))


@pytest.mark.parametrize("method", ["matsui-current", "flux"])
def test_an_error_of_the_speed_above_the_limit_of_the_design_ends_the_range(
    method: ObserverMethodName, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A speed from the back-EMF is as wrong as psi; that of a loop on the angle is not."""
    design = by_rule(1, method)
    assert design.control.observer is not None
    observer = replace(design.control.observer, max_speed_error=0.03, speed_gain=None)
    design = replace(design, control=replace(design.control, observer=observer))
    gains = solve_gains(design)
    if method == "flux":
        assert corners_of(gains).binding.speed_error < 1e-3
        require_observed(design, gains)
        return
    monkeypatch.setattr(observed_remedies, "_narrower", lambda *_: 0.0)
    monkeypatch.setattr(observed_remedies, "_other_method", lambda *_: None)
    with pytest.raises(NoSolutionError, match=r"wrong by .*max_speed_error of 11\.\d+ %"):
        require_observed(design, gains)


def test_range_error_and_steps_stand_in_every_file_in_json_and_in_the_summary(
    slowed: tuple[Design, GainSet],
) -> None:
    speed = slowed[1].speed
    assert speed is not None
    found = corners_of(slowed[1])
    assert found.steps is not None
    rpm = found.binding.high / found.pole_pairs * 30.0 / np.pi
    told = " ".join(promise_lines(speed))
    assert f"to {np.floor(rpm):.0f} rpm"[:6] in told
    assert "the speed is wrong by 0.1 % at most" in told
    assert "steps of the load by up to" in told
    header = b"/* x\n *\n * Input file: SHA-256 00\n *\n */\n"
    for name in ("x_control.h", "x_observer_q15.h", "x_startup.h", "x_main.c"):
        marked = with_promise(name, header, promise_lines(speed))
        assert told in marked.decode().replace("\n * ", " ")
    assert with_promise("x_control_vectors.h", header, promise_lines(speed)) == header
    plain = plain_observed(speed)["observed"]["corners"]
    assert plain["binding"]["high_rad_per_s"] == found.binding.high
    assert plain["steps"]["load_Nm"] == found.steps.load
    assert any("steps of the load by up to" in words for words in corner_words(speed))


def test_a_top_speed_beyond_the_link_is_judged_where_the_link_ends_and_remarked() -> None:
    design = by_rule(1, "flux")
    machine = design.machine
    assert isinstance(machine, LinearMachine)
    assert machine.omega_m_max is not None
    fast = replace(machine, omega_m_max=2.0 * machine.omega_m_max)
    far = replace(design, machine=fast)
    omega = reachable_speed(far)
    i_q = machine.friction * omega / machine.pole_pairs / machine.torque_per_ampere
    volts = np.hypot(machine.r_s * i_q + omega * machine.psi_pm, omega * machine.l_q * i_q)
    assert volts == pytest.approx(far.v_max, rel=1e-9)
    assert top_speed(far) == pytest.approx(omega)
    gains = solve_gains(far)
    assert gains.speed is not None
    assert gains.speed.observed is not None
    assert gains.speed.observed.omega[-1] == pytest.approx(omega)
    assert f"{machine_top(far) / 2.0 / np.pi:.4g} Hz" in beyond_notes(gains.speed)[0]
    # with more flux the link ends earlier: the range does, and nothing is refused
    above = corners_of(gains).exact.above
    assert above is not None
    assert above.why == "voltage"
    require_observed(far, gains)
    assert beyond_notes(solve_gains(design).speed) == ()
