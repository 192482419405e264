"""The step of every position observer, read by CasADi: the linear systems that are judged are its
derivatives, and it does what its definition says.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import IPM
from step_derivatives import derivative, evaluated

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import drive_motion, plants, steady_voltage
from dqforge.optimizer.observers.methods.ekf import ekf_gains, first_guess, usual_noise
from dqforge.optimizer.observers.methods.extended_emf import emf_part
from dqforge.optimizer.observers.methods.flux import flux_error, flux_of_current
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import ObserverMethod, observe, steady_observer
from dqforge.optimizer.observers.sampled_machine import (
    entries_and_slopes,
    matrix_entries,
    sampled_gains,
    sampled_machine,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT

T_S, OMEGA_MAX = 1e-4, 3000.0
# Largest steady error in rad where it is not 2e-4: the extended EMF of a salient machine moves
# within a period of a quarter rad, while its voltage is held.
ERROR = {"extended-emf": 3e-3, "smo": 3e-3}
EVERY = pytest.mark.parametrize("method", METHODS.values(), ids=list(METHODS))


def machine_of(generator: np.random.Generator) -> LinearMachine:
    """The machine of the tests with constants from half to double."""
    names = ("r_s", "l_d", "l_q", "psi_pm")
    factors = 2.0 ** generator.uniform(-1.0, 1.0, len(names))
    return replace(
        IPM, **{n: getattr(IPM, n) * float(f) for n, f in zip(names, factors, strict=True)}
    )


def gains_of(method: ObserverMethod, machine: LinearMachine) -> Any:
    if method.name == "ekf":
        noise = usual_noise(machine, 2.0 * OMEGA_MAX * machine.psi_pm, T_S)
        return ekf_gains(first_guess(machine, T_S, noise, OMEGA_MAX))
    return method.design(machine, method.usual(machine, T_S, OMEGA_MAX), T_S, OMEGA_MAX)


@EVERY
def test_the_poles_that_are_judged_are_those_of_the_step(method: ObserverMethod) -> None:
    """Fifty random drives on five machines: the derivative of the steady state by CasADi."""
    generator = np.random.default_rng(8)
    compared = 0
    for _ in range(5):
        machine = machine_of(generator)
        gains = gains_of(method, machine)
        step = derivative(method, gains)
        omega = generator.uniform(300.0, 2500.0, 10) * generator.choice([-1.0, 1.0], 10)
        i_dq = generator.uniform(-60.0, 0.0, 10) + 1j * generator.uniform(-80.0, 80.0, 10)
        drift = generator.uniform(-1.0, 1.0, 10) * 100.0 * T_S
        plant = plants(machine)
        steady = steady_observer(method, gains, T_S, plant, i_dq, omega, drift / T_S)
        for k in np.flatnonzero(steady.found):
            v = voltage_of(machine, i_dq[k], omega[k] - 0.5 * drift[k])
            turn = (omega[k] - 0.5 * drift[k]) * T_S
            inputs = (steady.states[k], turn, omega[k], drift[k], v, [i_dq[k].real, i_dq[k].imag])
            after, by_state, by_i, by_v = evaluated(step, *inputs)
            assert after[:, 0] == pytest.approx(steady.states[k], rel=1e-6, abs=1e-7)
            for found, expected in (
                (by_state, steady.jacobian[k]),
                (by_i, steady.by_current[k]),
                (by_v, steady.by_voltage[k]),
            ):
                size = np.abs(expected) + np.max(np.abs(expected), axis=1, keepdims=True)
                assert (
                    np.max(np.abs(found - expected) / (size + 1e-9)) < 1e-4
                )  # central differences
            compared += 1
    assert compared >= 45


@EVERY
def test_the_truth_is_where_an_observer_rests(method: ObserverMethod) -> None:
    """On exactly known machines, integrated apart from any observer, at both senses of rotation,
    motoring and braking: no error remains, and every pole lies inside the circle.
    """
    generator = np.random.default_rng(9)
    for _ in range(4):
        machine = machine_of(generator)
        omega = generator.uniform(500.0, 2500.0, 12) * np.tile([-1.0, 1.0], 6)
        i_dq = generator.uniform(-40.0, 0.0, 12) + 1j * generator.uniform(-60.0, 60.0, 12)
        gains = gains_of(method, machine)
        steady = steady_observer(method, gains, T_S, plants(machine), i_dq, omega)
        assert np.all(steady.found)
        assert np.max(np.abs(steady.theta_error)) < ERROR.get(method.name, 2e-4)
        assert np.max(np.abs(steady.omega_error)) < 1e-3 * OMEGA_MAX
        assert np.max(np.abs(steady.poles)) < 1.0


def test_fluxes_are_those_of_the_definition() -> None:
    """Rotating a vector is a factor exp(j theta), an angle between vectors is their argument."""
    generator = np.random.default_rng(10)
    l_d, l_q, psi = 1e-3, 2e-3, 0.1
    theta, x = generator.uniform(-3.0, 3.0, (2, 50))
    i, y, v = (generator.uniform(-50.0, 50.0, (3, 2, 50)) * [[1.0], [1.0j]]).sum(axis=1)
    turn, dq = EXACT.rotation(theta), i * np.exp(-1j * theta)
    pairs = [(z.real, z.imag) for z in (i, y, v)]
    current = flux_of_current(EXACT, l_d, l_q, psi, pairs[0], turn)
    expected = np.exp(1j * theta) * (psi + l_d * dq.real + 1j * l_q * dq.imag)
    assert current.alpha + 1j * current.beta == pytest.approx(expected, rel=1e-12)
    error = flux_error(EXACT, pairs[1], l_q, pairs[0], turn, 1e-9)
    active = y - l_q * i
    assert error == pytest.approx(np.sin(np.angle(active * np.exp(-1j * theta))), abs=1e-12)
    r, m = (1.0, -0.5, 0.25), (0.3, 0.2, -0.1)
    part = emf_part(EXACT, r, m, x, pairs[2])
    factor = np.polyval(r[::-1], x**2) + 1j * x * np.polyval(m[::-1], x**2)
    assert part.alpha + 1j * part.beta == pytest.approx(v * factor, rel=1e-12)


@EVERY
def test_an_observer_that_begins_at_the_truth_stays_there(method: ObserverMethod) -> None:
    """Without load, at both senses of rotation: the first step knows what the machine shows."""
    omega = np.array([600.0, -600.0, 2000.0, -2000.0])
    theta, nil = np.array([0.5, 1.5, -2.0, 3.0]), np.zeros(4, dtype=np.complex128)
    motion = drive_motion(IPM, T_S, np.full((12, 4), omega), nil, theta_0=theta)
    found = observe(method, gains_of(method, IPM), motion)
    assert np.max(np.abs(found.angle_error(motion))) < 2e-3
    assert np.max(np.abs(found.omega_e - omega) / np.abs(omega)) < 2e-3


def test_slopes_of_the_sampled_machine_are_its_derivatives_by_the_speed() -> None:
    model = sampled_gains(sampled_machine(IPM, T_S, OMEGA_MAX))
    x = T_S * np.linspace(-2900.0, 2900.0, 41)
    entries, slopes = entries_and_slopes(EXACT, model, x)
    ends = [matrix_entries(EXACT, model, x + sign * 1e-6) for sign in (1.0, -1.0)]
    scale = np.max(np.abs(slopes), axis=1, keepdims=True)
    assert np.max(np.abs(slopes - T_S * (ends[0] - ends[1]) / 2e-6) / scale) < 1e-7
    assert entries == pytest.approx(matrix_entries(EXACT, model, x), rel=1e-14)


def voltage_of(machine: LinearMachine, i_dq: complex, omega: float) -> FloatArray:
    """What holds a current steady over a period, seen at its end."""
    v = steady_voltage(plants(machine), np.array([i_dq]), np.array([omega]), T_S)
    return np.array([v[0].real, v[0].imag])
