"""The lowest speed at which every corner is stable, on a drive whose corners are few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_runs import random_design, tuned

from dqforge.machines.design.settings import Tolerances
from dqforge.optimizer.observed_drive.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.observed_drive.drive_model import ObservedDrive
from dqforge.optimizer.observed_drive.speed_range import (
    LEAST_SHARE,
    CornerBox,
    SpeedPi,
    corner_box,
    judge_corners,
    speed_range,
    worst_corner,
)

BOX = CornerBox(True, {"r_s": (-0.3, 0.3), "psi_pm": (-0.04, 0.0)}, (0.0, 0.5), ())


@pytest.fixture(scope="module")
def drive() -> tuple[ObservedDrive, SpeedPi, float]:
    """A drive with calm gains, and its largest speed."""
    design = random_design(np.random.default_rng(1), "flux")
    gains = tuned(design)
    assert gains.position is not None
    assert gains.speed is not None
    loops = (gains.i_d, gains.i_q)
    made = observed_drive(design, loops, position_estimator(gains.position))
    calm = SpeedPi(0.07 * gains.speed.kp, 0.0005 * gains.speed.ki, 10)
    return made, calm, top_speed(design)


def test_every_corner_holds_from_the_lowest_speed_on_and_one_fails_below(
    drive: tuple[ObservedDrive, SpeedPi, float],
) -> None:
    made, calm, top = drive
    machine = made.data.machine
    box = CornerBox(True, {"r_s": (-0.6, 0.6), "psi_pm": (-0.1, 0.1)}, BOX.loads, ())
    found = speed_range(made, machine, calm, box, top)
    assert found.any
    assert found.corners == 8
    corners = box.corners(dead_time=False)
    if found.below is None:
        assert found.low == pytest.approx(LEAST_SHARE * top)
    else:
        assert 0.95 * found.low < found.below.omega < found.low
        assert found.below.why == "unstable"
    for omega in (found.low, 1.5 * found.low):
        assert worst_corner(made, machine, calm, corners, min(omega, top)).why is None


def test_a_loop_that_holds_nowhere_says_its_worst_corner(
    drive: tuple[ObservedDrive, SpeedPi, float],
) -> None:
    made, calm, top = drive
    wild = SpeedPi(50.0 * calm.kp, 50.0 * calm.ki, 10)
    found = judge_corners(made, made.data.machine, wild, BOX, top)
    assert not found.exact.any
    assert found.exact.below is not None
    assert found.exact.below.radius >= 1.0
    assert found.dead_time is None
    assert found.braking is not None
    assert not found.braking.any


def test_braking_is_judged_by_itself_and_the_later_range_binds(
    drive: tuple[ObservedDrive, SpeedPi, float],
) -> None:
    made, calm, top = drive
    machine = made.data.machine
    box = CornerBox(True, {"r_s": (-0.6, 0.6), "psi_pm": (-0.1, 0.1)}, BOX.loads, ())
    corners = box.corners(dead_time=False, braking=True)
    assert {corner.load for corner in corners} == {-0.5}
    found = judge_corners(made, machine, calm, box, top)
    assert found.braking is not None
    assert found.braking.corners == len(corners) == 4
    assert found.binding.low == max(found.exact.low, found.braking.low)
    assert worst_corner(made, machine, calm, corners, found.braking.low).radius < 1.0
    late = replace(found.exact, low=float(np.sqrt(found.binding.low * found.binding.high)))
    assert replace(found, braking=late).binding.low == late.low
    nowhere = replace(found.exact, low=np.nan)
    assert not replace(found, exact=nowhere).binding.any
    assert not replace(found, braking=nowhere).binding.any


def test_nothing_is_tried_below_the_speeds_of_a_tracker(
    drive: tuple[ObservedDrive, SpeedPi, float],
) -> None:
    made, calm, top = drive
    whole = speed_range(made, made.data.machine, calm, BOX, top)
    least = float(np.sqrt(whole.low * whole.high))
    found = speed_range(made, made.data.machine, calm, BOX, top, least=least)
    assert found.low == pytest.approx(least)
    assert found.below is None


def test_corners_are_every_combination_of_what_is_not_exact() -> None:
    design = random_design(np.random.default_rng(1), "flux", dead_time=2e-6)
    usual = corner_box(design)
    assert not usual.named
    assert set(usual.limits) == {"r_s", "l_d", "l_q", "psi_pm"}
    assert len(usual.lost) == 1
    named = Tolerances(r_s=0.3, psi_pm=(-0.04, 0.0), inertia=0.2, dead_time=(-1e-7, 3e-7))
    box = corner_box(replace(design, control=replace(design.control, tolerances=named)))
    assert box.limits == {"r_s": (-0.3, 0.3), "psi_pm": (-0.04, 0.0), "inertia": (-0.2, 0.2)}
    assert len(box.corners(dead_time=False)) == 2**3 * 2
    lossy = box.corners(dead_time=True)
    assert len(lossy) == 2**3 * 2 * 2
    volts = 4.0 / np.pi * design.inverter.f_sw * design.inverter.v_dc
    assert {corner.lost for corner in lossy} == {-1e-7 * volts, 3e-7 * volts}
    assert box.loads[1] == pytest.approx(
        0.3 * design.machine.torque_per_ampere * design.machine.i_max
    )
