"""Flying start: the short-circuit current against SciPy, and turning rotors found on random
drives whose resistance, flux and saturation the controller does not know."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.from_machine import RandomDrive, random_drives
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.sampled_systems import ComplexArray
from dqforge.optimizer.start_up.solve import (
    FlyingStart,
    angle_of_pulse,
    plan_flying_start,
    refined_speed,
    short_circuit_current,
    speed_of_pair,
)

NOISE = 5e-3  # of the rated current, per component


def slopes(machine: LinearMachine, saturation: float, omega: float, x: FloatArray) -> FloatArray:
    """Derivatives of (i_d, i_q) in A/s of a short-circuited winding."""
    i_d, i_q = x
    l_dd = machine.l_d * (1.0 - saturation * i_d / machine.i_max)
    psi_d = machine.psi_pm + machine.l_d * i_d * (1.0 - 0.5 * saturation * i_d / machine.i_max)
    return np.array(
        [
            (-machine.r_s * i_d + omega * machine.l_q * i_q) / l_dd,
            (-machine.r_s * i_q - omega * psi_d) / machine.l_q,
        ]
    )


def true_current(
    machine: LinearMachine, saturation: float, omega: float, time: float, steps: int = 40
) -> complex:
    """i_d + j i_q in A after a short circuit, by Runge-Kutta."""
    x, h = np.zeros(2), time / steps
    for _ in range(steps):
        k1 = slopes(machine, saturation, omega, x)
        k2 = slopes(machine, saturation, omega, x + 0.5 * h * k1)
        k3 = slopes(machine, saturation, omega, x + 0.5 * h * k2)
        k4 = slopes(machine, saturation, omega, x + h * k3)
        x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return complex(x[0], x[1])


@pytest.mark.parametrize("l_q", [2e-3, 4e-3])
@pytest.mark.parametrize("omega", [-900.0, -30.0, 0.0, 250.0, 2000.0])
def test_short_circuit_current_is_that_of_scipy(l_q: float, omega: float) -> None:
    machine = LinearMachine(4, 0.7, 2e-3, l_q, 0.05, 20.0)
    for time in (2e-5, 4e-4, 0.02):
        found = short_circuit_current(machine, np.array([omega]), time)[0]
        solved = solve_ivp(
            lambda _, x: slopes(machine, 0.0, omega, x),
            (0.0, time),
            np.zeros(2),
            rtol=1e-10,
            atol=1e-12,
        ).y[:, -1]
        assert abs(found - complex(*solved)) < 1e-7 * (1.0 + abs(found))


def test_at_first_the_current_is_that_of_the_emf_alone() -> None:
    machine = LinearMachine(4, 0.7, 2e-3, 3e-3, 0.05, 20.0)
    found = short_circuit_current(machine, np.array([300.0]), 1e-6)[0]
    assert math.isclose(found.imag, -300.0 * 0.05 * 1e-6 / 3e-3, rel_tol=1e-3)
    assert abs(found.real) < 1e-3 * abs(found.imag)


@dataclass(frozen=True)
class Found:
    """Relative error of the speed, error of the angle in rad, and the largest current over I."""

    speed: float
    angle: float
    peak: float


def caught(drive: RandomDrive, plan: FlyingStart, omega: float, *, noise: float = NOISE) -> Found:
    """A rotor at a speed found as the plan says."""
    rng = np.random.default_rng(drive.seed)
    machine, t_s = drive.machine, 1.0 / drive.f_s
    plant = replace(machine, r_s=1.3 * machine.r_s, psi_pm=0.96 * machine.psi_pm)
    length, made = plan.fraction, 0j
    while True:  # longer until there is enough current
        made = true_current(plant, drive.saturation, omega, length * t_s)
        if abs(made) >= plan.level or 2.0 * length > plan.longest:
            break
        length = max(1.0, math.ceil(2.0 * length)) if length >= 1.0 else min(1.0, 2.0 * length)
    waits = np.cumsum([0, plan.spacing, plan.long_spacing]) * t_s
    angles = rng.uniform(-np.pi, np.pi) + omega * waits
    scatter = noise * machine.i_max * (rng.normal(size=3) + 1j * rng.normal(size=3))
    seen: ComplexArray = made * np.exp(1j * angles) + scatter
    speed = speed_of_pair(seen[:1], seen[1:2], plan.spacing * t_s)
    last = 1
    if abs(speed[0]) < plan.omega_long:
        speed = refined_speed(speed, seen[1:2], seen[2:], plan.long_spacing * t_s)
        last = 2
    angle = angle_of_pulse(machine, seen[last : last + 1], speed, length * t_s)
    gap = np.angle(np.exp(1j * (angle[0] - angles[last])))
    return Found(float(speed[0]) / omega - 1.0, float(gap), abs(made) / machine.i_max)


def trials(share: float, count: int) -> list[Found]:
    found = []
    for number, drive in enumerate(random_drives(count)):
        plan = plan_flying_start(drive.machine, 1.0 / drive.f_s, drive.omega_rated, fractions=True)
        sign = 1.0 if number % 2 == 0 else -1.0
        found.append(caught(drive, plan, sign * share * drive.omega_rated))
    return found


@pytest.mark.thinned
@pytest.mark.parametrize(("share", "speed"), [(1.0, 0.05), (0.6, 0.07), (0.3, 0.15), (0.1, 0.15)])
def test_turning_rotors_are_found(share: float, speed: float) -> None:
    """Both directions, R 30 % higher, psi 4 % lower, saturated: 100 % found, 95 % within 5 deg."""
    found = trials(share, 200)
    angles = np.abs([one.angle for one in found])
    assert np.max(angles) < math.radians(20.0)
    assert np.percentile(angles, 95) < math.radians(5.0)
    assert np.percentile(np.abs([one.speed for one in found]), 95) < speed
    assert max(one.peak for one in found) <= 1.0


@pytest.mark.slow
def test_third_pulse_divides_the_error_of_the_speed_by_its_wait() -> None:
    drive = random_drives(1)[0]
    plan = plan_flying_start(drive.machine, 1.0 / drive.f_s, drive.omega_rated, fractions=True)
    errors = []
    for long in (drive.omega_rated, 0.0):  # with the third pulse, and without it
        kept = [
            caught(
                replace(drive, seed=seed), replace(plan, omega_long=long), 0.1 * drive.omega_rated
            ).speed
            for seed in range(200)
        ]
        errors.append(float(np.std(kept)))
    assert math.isclose(errors[1] / errors[0], plan.long_spacing / plan.spacing, rel_tol=0.15)


def test_whole_periods_are_refused_where_they_make_too_much_current() -> None:
    """Some drives need fractions of a period; the others are planned the same without."""
    refused = 0
    for drive in random_drives(200):
        t_s = 1.0 / drive.f_s
        plan = plan_flying_start(drive.machine, t_s, drive.omega_rated, fractions=True)
        if plan.fraction < 1.0:
            refused += 1
            with pytest.raises(NoSolutionError, match="one sampling period makes"):
                plan_flying_start(drive.machine, t_s, drive.omega_rated)
        else:
            assert plan_flying_start(drive.machine, t_s, drive.omega_rated) == plan
        assert plan.spacing * t_s * drive.omega_rated <= 0.8 * math.pi
    assert 2 <= refused < 20


def test_what_cannot_be_found_is_refused() -> None:
    machine = LinearMachine(4, 0.7, 2e-3, 3e-3, 0.05, 20.0)
    with pytest.raises(NoSolutionError, match="without magnets"):
        plan_flying_start(replace(machine, psi_pm=0.0), 1e-4, 1000.0)
    with pytest.raises(NoSolutionError, match="turns"):
        plan_flying_start(replace(machine, l_d=0.2, l_q=0.2), 1e-3, 1000.0)
