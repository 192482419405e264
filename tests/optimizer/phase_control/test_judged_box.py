"""The judgement of the currents over speeds and tolerances, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings, Tolerances
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.phase_control.judged_box import JudgedLoops, PhasePlants, radius

BOX = Tolerances(r_s=0.3, l_d=(-0.5, 0.1), l_q=(-0.3, 0.2))


def drive(tolerances: Tolerances | None = None, **loop: Any) -> Design:
    design = catalogue.load("paper002-phase-waveforms")
    settings: CurrentLoopSettings = replace(design.control.current_loop, **loop)
    control = replace(design.control, current_loop=settings, tolerances=tolerances)
    return replace(design, control=control)


def faster(design: Design, share: float) -> Design:
    machine: Any = design.machine
    return replace(design, machine=replace(machine, omega_m_max=share * machine.omega_m_max))


def judged(gains: GainSet) -> JudgedLoops:
    assert gains.phases is not None
    assert gains.phases.judged is not None
    return gains.phases.judged


def test_speeds_reach_from_standstill_to_the_largest_one() -> None:
    found = judged(solve_gains(drive()))
    assert [speed.omega_m * 30.0 / np.pi for speed in found.speeds] == pytest.approx(
        [0.0, 450.0, 900.0, 1350.0, 1800.0]
    )
    assert found.speeds[0].samples == np.inf
    assert found.speeds[-1].samples == pytest.approx(1e4 / 60.0)
    assert (found.corners, found.inside, found.midpoint_time) == (0, 0, None)
    for speed in found.speeds:
        assert speed.worst is None
        assert speed.decay_time == pytest.approx(-1e-4 / np.log(speed.nominal))
    assert found.speeds[0].orders == ((), ())
    assert found.speeds[-1].orders == ((-5, 7, -11, 13), (3, 9))
    learning = found.speeds[-1].learning_time
    assert learning is not None
    assert learning == pytest.approx(1.0 / 30.0, rel=0.1)


@pytest.mark.slow
def test_the_worst_corner_is_that_of_the_radius_itself() -> None:
    gains = solve_gains(drive(BOX))
    found = judged(gains)
    assert (found.corners, found.inside) == (16, 400)
    last = found.speeds[-1]
    assert gains.phases is not None
    assert last.worst is not None
    named = dict(part.rsplit(" ", 2)[:2] for part in last.worst.at.split(", "))
    share = {name: 1.0 + float(value) / 100.0 for name, value in named.items()}
    control = gains.phases.control
    resistance = np.array([control.r_s * share["r_s"]])
    d, q, zero = [
        np.array([value * share[name]])
        for value, name in zip(control.inductances, ("l_d", "l_q", "l_0"), strict=True)
    ]
    plant = PhasePlants(resistance, d, q, zero, np.ones(1))
    again = radius(replace(control, harmonics=None), plant, 2.0 * last.omega_m)[0]
    assert again == pytest.approx(last.worst.value, rel=1e-9)
    assert last.worst.value > last.nominal
    assert {share["l_0"]} <= {0.5, 1.2}  # as far as that of d or q, whichever is further


def test_the_zero_sequence_is_judged_within_the_tolerances_too() -> None:
    gains = solve_gains(drive(BOX))
    assert gains.robust is not None
    assert gains.robust.i_0 is not None
    assert gains.robust.turning is None  # the references decouple, not measured currents
    assert gains.robust.i_0.corners == 4
    assert "l_0 -50 %" in gains.robust.i_0.phase_margin.at
    assert [loop.loop for loop in gains.loops] == ["i_d", "i_q", "i_0"]


@pytest.mark.slow
def test_a_zero_sequence_loop_without_margin_in_the_box_is_refused() -> None:
    one = drive(Tolerances(l_d=(-0.6, 0.0), l_q=(-0.6, 0.0)), axis_gains="one")
    with pytest.raises(NoSolutionError, match=r"the i_0 loop .* l_0 -60 %") as refusal:
        solve_gains(one)
    assert "method 'given'" in refusal.value.message


@pytest.mark.thinned
@pytest.mark.parametrize("frame", ["table", "dqy"])
def test_measured_coupling_at_few_samples_is_refused_by_name(frame: str) -> None:
    quick = faster(drive(frame=frame, feedforward="measured", bandwidth=3141.6), 13.0)
    unstable = r"unstable at 2\d+ rpm, 12.8 samples"
    with pytest.raises(NoSolutionError, match=unstable) as refusal:
        solve_gains(quick)
    assert "feedforward: references" in refusal.value.message
    calm = faster(drive(frame=frame, bandwidth=3141.6), 13.0)
    assert judged(solve_gains(calm)).slowest.nominal < 1.0


def test_saturation_makes_measured_coupling_unstable_and_names_the_corner() -> None:
    halves = Tolerances(l_d=(-0.5, 0.0), l_q=(-0.5, 0.0))
    quick = faster(
        drive(halves, feedforward="measured", bandwidth=2200.0, min_phase_margin=0.1), 5.0
    )
    with pytest.raises(NoSolutionError, match="l_d -50 %, l_q -50 %"):
        solve_gains(quick)


def test_a_split_link_says_how_fast_its_midpoint_returns() -> None:
    design = drive()
    inverter = replace(design.inverter, topology="split-capacitor", midpoint_capacitance=4e-3)
    gains = solve_gains(replace(design, inverter=inverter))
    found = judged(gains)
    assert found.midpoint_time is not None
    assert found.midpoint_time == pytest.approx(1.0 / 20.0, rel=0.03)  # 20 rad/s are designed
    assert found.speeds[-1].nominal < 0.99
    four = judged(solve_gains(drive()))
    assert found.speeds[-1].nominal == pytest.approx(four.speeds[-1].nominal, rel=1e-9)


def test_a_star_has_no_zero_sequence_to_judge() -> None:
    design = drive(BOX)
    star = replace(design, inverter=replace(design.inverter, topology="three-wire"))
    gains = solve_gains(star)
    assert gains.robust is not None
    assert gains.robust.i_0 is None
    assert judged(gains).corners == 8
    assert "l_0" not in str(judged(gains).speeds[-1].worst)
