"""Steady errors by three coefficients, against the fixed points of the emitted observer's step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from drives import IPM

from dqforge.machines.plants.scenario import ComplexArray, Plants
from dqforge.optimizer.learned_correction.correction_frame import (
    LARGEST_ERROR,
    SOFT,
    drawn,
    steady_errors,
    volts_of,
)
from dqforge.optimizer.observers.methods import flux
from dqforge.optimizer.observers.parts import steady_observer
from dqforge.optimizer.observers.reduced_order import usual_training_box

T_S, OMEGA_MAX = 1e-4, 3000.0
GAINS = flux.design(IPM, flux.usual_flux(IPM, T_S, OMEGA_MAX), T_S, 1.2 * OMEGA_MAX)


def test_errors_are_the_fixed_points_of_the_step() -> None:
    """300 salient drives with everything wrong at once, of any current and speed: angle and
    residual by Newton's method on the whole step, whose poles are stable there.
    """
    generator = np.random.default_rng(5)
    count = 300

    def off(size: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return 1.0 + generator.uniform(-size, size, count)

    plant = Plants(
        IPM.r_s * off(0.4), IPM.l_d * off(0.1), IPM.l_q * off(0.1), IPM.psi_pm * off(0.1)
    )
    omega = np.exp(generator.uniform(np.log(0.06 * OMEGA_MAX), np.log(OMEGA_MAX), count))
    i_d, i_q = generator.uniform(-0.5, 0.1, count), generator.uniform(-0.8, 0.8, count)
    current: ComplexArray = np.asarray(IPM.i_max * (i_d + 1j * i_q), dtype=np.complex128)
    lost = generator.uniform(0.0, 2.0, count)
    found = steady_errors(GAINS, volts_of(plant, omega, T_S), current, omega, lost, IPM.i_max)
    assert np.mean(found.held) > 0.95
    assert np.max(np.abs(found.error[found.held])) > 0.1
    true = current * np.exp(1j * found.error)
    soft = np.abs(current) / np.sqrt(np.abs(current) ** 2 + (SOFT * IPM.i_max) ** 2)
    whole = steady_observer(flux.METHOD, GAINS, T_S, plant, true, omega, 0.0, lost * soft)
    both = found.held & whole.found
    assert np.mean(both) > 0.95
    np.testing.assert_allclose(whole.theta_error[both], found.error[both], atol=1e-8)
    psi = (whole.states[:, 0] + 1j * whole.states[:, 1]) * np.exp(-1j * found.error)
    model = IPM.psi_pm + IPM.l_d * current.real + 1j * IPM.l_q * current.imag
    np.testing.assert_allclose((psi - model)[both], found.residual[both], atol=1e-8)
    assert np.max(np.abs(whole.poles[both, 0])) < 1.0
    # the loop rests where the residual on q is nil: it tells nothing of the error
    assert np.max(np.abs(found.residual.imag[both])) < 1e-9


def test_an_exact_drive_errs_by_what_sampling_leaves_alone() -> None:
    omega = np.array([200.0, 1000.0, 3000.0])
    plant = Plants(*(np.full(3, value) for value in (IPM.r_s, IPM.l_d, IPM.l_q, IPM.psi_pm)))
    found = steady_errors(
        GAINS, volts_of(plant, omega, T_S), np.full(3, -20 + 60j), omega, np.zeros(3), IPM.i_max
    )
    assert np.all(found.held)
    assert np.max(np.abs(found.error)) < 2e-3


def test_a_lost_angle_is_said() -> None:
    """A resistance that is nil in the drive and large in the observer: no rest at low speed."""
    omega = np.array([1.0, 2000.0])
    plant = Plants(*(np.full(2, v) for v in (0.0, IPM.l_d, IPM.l_q, IPM.psi_pm)))
    wrong = replace(IPM, r_s=100.0 * IPM.r_s)
    tuning = replace(flux.usual_flux(IPM, T_S, OMEGA_MAX), bandwidth=20.0)
    gains = flux.design(wrong, tuning, T_S, 1.2 * OMEGA_MAX)
    found = steady_errors(
        gains, volts_of(plant, omega, T_S), np.full(2, 60j), omega, np.zeros(2), IPM.i_max
    )
    assert not found.held[0]


def test_drives_are_those_of_the_box_and_the_same_every_time() -> None:
    box = usual_training_box(3.0, IPM.i_max, OMEGA_MAX)
    first, second = (drawn(IPM, box, T_S, 2000, 7) for _ in range(2))
    np.testing.assert_array_equal(first.current, second.current)
    assert np.min(first.omega) >= box.omega_low
    assert np.max(first.omega) <= box.omega_high
    assert np.max(np.abs(first.current)) <= 1.05 * IPM.i_max * (1.0 + 1e-12)
    assert np.min(first.current.real) < 0.9 * box.i_d_low
    assert np.max(first.lost) <= 3.0
    seen = first.at_rest(GAINS)
    assert np.max(np.abs(seen.error[seen.held])) < LARGEST_ERROR
    other = drawn(IPM, box, T_S, 2000, 8)
    assert not np.array_equal(first.current, other.current)
