"""Both current loops at speed: the compiled structure swings where the judgement says so."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from firmware_loops import INVERTER, MACHINE, VALUES, odrive
from scipy.optimize import brentq

from dqforge.machines.plants.scenario import Scenario, constant
from dqforge.optimizer.firmware.configuration import LoopProfile, turning_matrix
from dqforge.reports.firmware.target import firmware_simulator, simulate_profile
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulator

OMEGA_M = 120.0  # 286 Hz electrical, 28 samples per period


def louder(factor: float) -> LoopProfile:
    """ODrive's structure, without feedforward of the other axis, gains times a factor."""
    profile = odrive()
    pi = profile.current.q
    more = replace(pi, kp=factor * pi.kp, ki=factor * pi.ki)
    return replace(profile, current=replace(profile.current, d=more, q=more))


def radius(factor: float, omega_m: float) -> float:
    loops = louder(factor).current
    matrix = turning_matrix(0.05, (1e-4, 1e-4), loops, 15 * omega_m)
    return float(np.max(np.abs(np.linalg.eigvals(matrix))))


def limit_of(omega_m: float) -> float:
    return float(brentq(lambda factor: radius(factor, omega_m) - 1.0, 1.0, 10.0))


@pytest.fixture(scope="module")
def program() -> Iterator[Simulator]:
    with firmware_simulator(odrive(), VALUES) as made:
        yield made


@pytest.mark.parametrize("omega_m", [OMEGA_M, 0.5 * OMEGA_M])
def test_the_gain_at_which_the_axes_swing_is_that_of_the_judged_pair(
    program: Simulator, omega_m: float
) -> None:
    limit = limit_of(omega_m)
    assert limit < 0.995 * limit_of(0.0)

    def kept(factor: float) -> float:
        profile = louder(factor)
        pi = profile.current.q
        scenario = Scenario(
            600 * pi.t_s,
            "current",
            constant(0.01),
            shaft=constant(omega_m),
            omega_m=omega_m,
            dead_time=0.0,
        )
        drive = Drive(MACHINE, INVERTER, pi.t_s)
        run = simulate_profile(profile, VALUES, drive, scenario, program=program)
        count = run.i_q.size
        return float(np.ptp(run.i_q[3 * count // 4 :]) / np.ptp(run.i_q[count // 4 : count // 2]))

    # Beyond the limit the swing stays, up to the limit of the voltage.
    assert kept(0.97 * limit) < 0.2
    assert kept(1.03 * limit) > 0.98
