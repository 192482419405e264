"""The lowest speed at which every corner is stable, on a drive whose corners are few."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_runs import random_design, tuned

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.settings import Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.control_design import speed_range as speed_range_module
from dqforge.optimizer.control_design.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import ObservedDrive
from dqforge.optimizer.control_design.speed_range import (
    LEAST_SHARE,
    CornerBox,
    SpeedPi,
    corner_box,
    judge_corners,
    speed_range,
    worst_corner,
)
from dqforge.optimizer.loops.observed_margins import Corner, FailingCorner

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


# Drawn at random: its observer counts its speed as at least 2 % of the largest, and lets the corner
# of its filter go with the speed from 3.3 % on.
KINKED = """dqforge: 1
name: Drawn drive
machine:
  model: linear
  pole_pairs: 6
  resistance: 0.726 Ohm
  inductance_d: 0.9126 mH
  inductance_q: 1.758 mH
  magnet_flux: 0.08356 Wb
  max_current: 15.52 A
  max_speed: 416.6 rad/s
  inertia: 0.002504 kg m^2
  friction: 0.0002802 N m s
inverter: {topology: three-wire, v_dc: 546.1 V, switching_frequency: 8600 Hz, dead_time: 0 s}
control:
  current_loop: {method: magnitude-optimum}
  speed_loop: {method: symmetrical-optimum, ratio: 9}
  observer: {method: open-loop-flux}
operation: {strategy: mtpa}
export: {prefix: drawn}
"""


def test_nothing_fails_between_the_speeds_that_were_tried() -> None:
    """At 2.2 % of the largest speed this drive swings by 7 % in the emitted C; at 2 % exactly the
    differences across the kink of its observer called it stable, and its range began there.
    """
    design = load_text(KINKED.encode(), "kinked.yaml")
    gains, machine = tuned(design), design.machine
    assert isinstance(machine, LinearMachine)
    assert gains.position is not None
    assert gains.speed is not None
    drive = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(gains.position))
    loop, box = SpeedPi(gains.speed.kp, gains.speed.ki, 9), corner_box(design)
    corners = box.corners(dead_time=False)
    swinging = worst_corner(drive, machine, loop, corners, 55.62)
    assert swinging.radius > 1.2
    found = speed_range(drive, machine, loop, box, top_speed(design))
    assert found.low > 55.62
    for omega in np.geomspace(found.low, found.high, 40):
        tried = worst_corner(drive, machine, loop, corners, float(omega))
        assert tried.radius < 1.0
        assert tried.settling > 0.95  # the ends are found to 2 %


def test_what_fails_a_little_above_the_lowest_speed_ends_the_range(
    drive: tuple[ObservedDrive, SpeedPi, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A gap that lies between two of the nine speeds that are tried first."""
    made, calm, top = drive
    steps = np.geomspace(top, LEAST_SHARE * top, 9)
    gap = (1.1 * float(steps[-2]), 1.3 * float(steps[-2]))

    def judged(*given: object) -> FailingCorner:
        omega = float(given[4])  # type: ignore[arg-type]
        corner = Corner({}, 0.0)
        held = FailingCorner(omega, corner, 0.9, why=None)
        return replace(held, why="unstable") if gap[0] < omega < gap[1] else held

    monkeypatch.setattr(speed_range_module, "worst_corner", judged)
    found = speed_range(made, made.data.machine, calm, BOX, top)
    assert gap[1] <= found.low < 1.02 * gap[1]
    assert found.below is not None
    assert gap[0] < found.below.omega < gap[1]
