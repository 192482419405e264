"""Answers to steps against the drive as it moves, without linearisation."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from drives import IPM
from observed_runs import random_design, tuned

from dqforge.optimizer.control_design import speed_range as module
from dqforge.optimizer.control_design.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import DriveCases, ObservedDrive, drive_cases
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


@pytest.mark.parametrize(
    ("torque_max", "peak", "fall", "share"),
    [(5.0, 1.5, 0.0, 1.0), (5.0, 1.5, 10.0, 0.75), (8.6, 3.0, 7.0, 0.5), (0.7, 1.5, 0.0, 0.0)],
)
def test_the_load_is_that_of_torque_and_speeds_that_are_left(
    torque_max: float, peak: float, fall: float, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With stand-ins for what corners answer at three speeds, and for the speed that a torque
    reaches.
    """
    answers = iter(
        [
            module._Answers(4.0, 0.1, 0.2, 0.3, 0.1),
            module._Answers(1.0, peak, 0.7, 0.1, 0.2),
            module._Answers(2.0, 1.0, 0.5, 0.2, 0.8),
        ]
    )
    tried: list[float] = []

    def reached(_: object, at: object, torque: float, ends: tuple[float, float], v: float) -> float:
        assert (at, ends, v) == (pytest.approx(60.0), (10.0, 60.0), 40.0)
        tried.append(torque)
        return 60.0 - fall * torque

    monkeypatch.setattr(module, "_answers", lambda *_: next(answers))
    monkeypatch.setattr(module, "_reached", reached)
    monkeypatch.setattr(module, "cases_of", lambda _, __, omega: omega)
    made: Any = SimpleNamespace(data=SimpleNamespace(torque_max=torque_max))
    machine: Any = SimpleNamespace(pole_pairs=3)
    box = CornerBox(True, {"psi_pm": (-0.1, 0.1)}, (0.0, 3.0), (), v_max=40.0)
    found = steps_borne(made, machine, SpeedPi(1.0, 1.0, 10), box, SpeedRange(10.0, 60.0, None, 2))
    rise = max(peak, 2.0)
    most = min(3.0, (torque_max - 0.8) / rise)
    load = share * most
    assert found.load == pytest.approx(load)
    assert found.overshoot == 0.3
    assert tried[0] == pytest.approx(0.8 + rise * most)
    if share:
        assert found.load_low == pytest.approx(10.0 + 4.0 * load)
        assert found.load_high == pytest.approx(60.0 - fall * (0.8 + rise * load))
        assert found.speed == pytest.approx(3.0 * (rise - 1.0) * load / 0.7)
    else:
        assert (found.load_low, found.load_high, found.speed) == (10.0, 60.0, 0.0)


@pytest.mark.parametrize(("v_max", "low", "high"), [(60.0, 50.0, 900.0), (60.0, 50.0, 90.0)])
def test_the_speed_that_a_torque_reaches_is_that_of_the_worst_corner(
    v_max: float, low: float, high: float
) -> None:
    corners = BOX.corners(dead_time=False)
    errors = {"l_q": 0.2, "r_s": 0.3, "v_dc": -0.1}
    cases = drive_cases(IPM, np.full(len(corners), 1.0), 0.0, errors)
    i = -4.0 + 9.0j
    made: Any = SimpleNamespace(data=SimpleNamespace(reference=lambda x: i * x / 2.0))
    found = module._reached(made, cases, 2.0, (low, high), v_max)
    grid = np.linspace(low, high, 40_001)
    psi = complex(IPM.psi_pm + IPM.l_d * i.real, 1.2 * IPM.l_q * i.imag)
    volts = np.abs(1.3 * IPM.r_s * i + 1j * grid * psi) / 0.9
    assert found == pytest.approx(grid[volts <= v_max][-1], rel=1e-3)
    assert (found == high) == (volts[-1] <= v_max)
    assert module._reached(made, cases, 2.0, (1e4, 2e4), v_max) == 0.0
