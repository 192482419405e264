"""Steady states of drives on their observer against the observer alone, and against whole speed
periods differentiated as they run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_runs import random_design, tuned, with_spread

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import plants
from dqforge.optimizer.control_design.design_drive import (
    observed_drive,
    position_estimator,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import DriveCases, ObservedDrive, drive_cases
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.control_design.speed_range import SteadyDrives, steady_drives
from dqforge.optimizer.observers.parts import steady_observer

ERRORS = {"r_s": [0.0, 0.3, -0.3], "psi_pm": [0.0, -0.04, 0.02], "inertia": [0.0, 0.2, -0.2]}


def ipmsm(method: ObserverMethodName) -> Design:
    """A shipped machine with saliency, its currents on the locus of least copper loss."""
    design = with_spread(catalogue.load("abb-ipmsm-2k2"), 8.0)
    control = replace(design.control, observer=ObserverSettings(method=method))
    return replace(design, control=control)


def drive_and_gains(design: Design) -> tuple[ObservedDrive, GainSet]:
    gains = tuned(design)
    assert gains.position is not None
    loops = (gains.i_d, gains.i_q)
    return observed_drive(design, loops, position_estimator(gains.position)), gains


METHODS: list[ObserverMethodName] = [
    "flux", "extended-emf", "smo", "open-loop-flux", "matsui-voltage", "matsui-current",
]  # fmt: skip


@pytest.mark.thinned
@pytest.mark.parametrize("method", METHODS)
def test_the_angle_error_of_a_drive_is_that_of_its_observer_at_the_same_currents(
    method: ObserverMethodName,
) -> None:
    design = ipmsm(method)
    drive, gains = drive_and_gains(design)
    machine, position = drive.data.machine, gains.position
    assert position is not None
    cases = drive_cases(machine, 0.3 * top_speed(design), 3.0, ERRORS)
    steady = steady_drives(drive, cases)
    assert np.all(steady.found)
    wrong = plants(machine, {name: ERRORS[name] for name in ("r_s", "psi_pm")})
    i_dq = steady.states[:, 0] + 1j * steady.states[:, 1]
    alone = steady_observer(
        position.method, position.gains, position.t_s, wrong, i_dq, steady.states[:, 2]
    )
    np.testing.assert_allclose(steady.angle_error, alone.theta_error, atol=2e-7)
    # the speed controller sees its reference; the shaft is off by what the observer errs
    np.testing.assert_allclose(steady.states[:, 2] + steady.speed_error, cases.omega, rtol=1e-7)
    assert abs(steady.angle_error[1] - steady.angle_error[0]) > 1e-4


def whole_period(
    drive: ObservedDrive, cases: DriveCases, gains: GainSet, ratio: int, states: FloatArray
) -> FloatArray:
    """States with the integral of the speed controller one speed period on, as it runs."""
    speed = gains.speed
    assert speed is not None
    x, integral = states[:, :-1], states[:, -1]
    _, seen = drive.step(cases, x, integral)
    error = cases.omega / drive.data.machine.pole_pairs - seen
    integral = integral + speed.ki_ts * error
    torque = integral + speed.kp * error
    for _ in range(ratio):
        x, _ = drive.step(cases, x, torque)
    return np.concatenate([x, integral[:, None]], axis=1)


@pytest.mark.thinned
@pytest.mark.parametrize("lost", [3.0, 0.0])
def test_poles_are_those_of_a_speed_period_differentiated_as_a_whole(lost: float) -> None:
    """One salient machine, load, everything wrong, with dead time and without."""
    design = ipmsm("flux")
    drive, gains = drive_and_gains(design)
    machine, loop, speed = drive.data.machine, design.control.speed_loop, gains.speed
    assert loop is not None
    assert speed is not None
    wrong = {"r_s": 0.3, "psi_pm": -0.04, "inertia": 0.2, "l_q": 0.1, "v_dc": -0.02}
    cases = drive_cases(machine, [0.3 * top_speed(design)], [3.0], wrong, [lost])
    steady = steady_drives(drive, cases)
    assert steady.found[0]
    rest = np.append(steady.states[0], steady.torque[0])[None]
    moved = whole_period(drive, cases, gains, loop.ratio, rest)
    np.testing.assert_allclose(moved, rest, rtol=1e-7, atol=1e-7)
    size = 1e-6 * (np.abs(rest[0]) + 1e-3 * np.max(np.abs(rest[0])) * (np.abs(rest[0]) < 1e-9))
    size = np.maximum(size, 1e-7)
    n = len(size)
    ends = [
        whole_period(drive, cases.tiled(n), gains, loop.ratio, rest + sign * np.diag(size))
        for sign in (1.0, -1.0)
    ]
    jacobian = ((ends[0] - ends[1]) / (2.0 * size[:, None])).T
    expected = np.sort(np.abs(np.linalg.eigvals(jacobian)))[::-1][:6]
    found = np.abs(steady.poles(loop.ratio, speed.kp, speed.ki)[0, :6])
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_a_load_beyond_the_largest_torque_has_no_steady_state() -> None:
    design = random_design(np.random.default_rng(3), "flux")
    drive, gains = drive_and_gains(design)
    assert gains.speed is not None
    omega, loads = 0.5 * top_speed(design), np.array([0.3, 1.2]) * drive.data.torque_max
    steady: SteadyDrives = steady_drives(drive, drive_cases(drive.data.machine, omega, loads))
    assert steady.found.tolist() == [True, False]
    radius = steady.radius(10, 0.01 * gains.speed.kp, 1e-4 * gains.speed.ki)
    assert radius[0] < 1.0
    assert np.isinf(radius[1])


@pytest.mark.slow
def test_errors_of_what_is_no_parameter_are_refused() -> None:
    design = random_design(np.random.default_rng(3), "flux")
    drive, _ = drive_and_gains(design)
    with pytest.raises(InputError, match="error of r_rotor is unknown; write one of r_s, l_d"):
        drive_cases(drive.data.machine, 100.0, errors={"r_rotor": 0.1})
    without = replace(drive.data.machine, inertia=None)
    with pytest.raises(InputError, match=r"machine\.inertia"):
        drive_cases(without, 100.0)
