"""Answers to steps against the drive as it moves, without linearisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_runs import random_design, tuned

from dqforge.optimizer.control_design.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import DriveCases, ObservedDrive
from dqforge.optimizer.control_design.speed_range import (
    CornerBox,
    SpeedPi,
    cases_of,
    steady_drives,
    steps_borne,
)
from dqforge.optimizer.loops.observed_margins import SpeedRange

BOX = CornerBox(True, {"psi_pm": (-0.1, 0.1)}, (0.0, 0.5), ())


@pytest.fixture(scope="module")
def drive() -> tuple[ObservedDrive, SpeedPi, float]:
    """A drive with calm gains, and its largest speed."""
    design = random_design(np.random.default_rng(1), "flux")
    gains = tuned(design)
    assert gains.position is not None
    assert gains.speed is not None
    made = observed_drive(design, (gains.i_d, gains.i_q), position_estimator(gains.position))
    return made, SpeedPi(0.2 * gains.speed.kp, 0.02 * gains.speed.ki, 10), top_speed(design)


def moved(
    made: ObservedDrive, pi: SpeedPi, cases: DriveCases, after: DriveCases, periods: int
) -> tuple[np.ndarray, np.ndarray]:
    """Electrical speeds and torques over the speed periods, shape (periods, M), of drives that
    meet what is ``after`` from their rest on.
    """
    steady = steady_drives(made, cases)
    x, integral = steady.states.copy(), steady.torque.copy()
    reference = after.omega / made.data.machine.pole_pairs
    speeds, torques = [], []
    for _ in range(periods):
        torque = None
        for _ in range(pi.ratio):
            if torque is None:
                seen = made.step(after, x, integral)[1]
                error = reference - seen
                step = pi.ki * pi.ratio * steady.t_s * error
                torque = integral + pi.kp * error + step
                integral = integral + step
                torques.append(torque)
            x, _ = made.step(after, x, torque)
        speeds.append(x[:, 2].copy())
    return np.array(speeds), np.array(torques)


def test_dip_peak_and_effort_are_those_of_the_moving_drive(
    drive: tuple[ObservedDrive, SpeedPi, float],
) -> None:
    made, pi, top = drive
    machine = made.data.machine
    held = SpeedRange(0.5 * top, 0.5 * top * (1.0 + 1e-9), None, 6)
    wide = replace(held, low=0.2 * top, high=top)
    found = steps_borne(made, machine, pi, BOX, wide)
    assert found.load == pytest.approx(0.5)
    corners = (*BOX.corners(dead_time=False), *BOX.corners(dead_time=False, braking=True))
    cases = cases_of(machine, corners, 0.5 * top)
    loaded = replace(cases, load=cases.load + found.load)
    speeds, torques = moved(made, pi, cases, loaded, 150)
    dip = float(np.max(0.5 * top - speeds))
    assert found.load_low - wide.low == pytest.approx(dip, rel=0.15)
    faster = replace(cases, omega=cases.omega + found.speed)
    speeds, more = moved(made, pi, cases, faster, 150)
    rise = float(np.max(more - more[-1]))
    idle = cases.load == 0.0
    assert np.max(more[:, idle]) <= made.data.torque_max
    assert np.max(np.abs(torques[:, idle])) <= made.data.torque_max
    assert rise == pytest.approx(found.load, rel=0.25)  # what 2 L leaves beside L
    assert found.overshoot >= float(np.max(speeds - faster.omega)) / found.speed - 0.1
