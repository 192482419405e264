"""Third-harmonic tracker: integral against quadrature, drift, poles, noise, closed-form errors,
refusals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.harmonic_trackers import (
    ThirdHarmonic,
    angle_noise,
    other_harmonics,
    run,
    sum_voltage,
    third_error,
    third_flux,
    third_harmonic,
    turn_pole,
)

T_S = 1e-4
OMEGA_MAX = 3000.0
MACHINE = PhaseMachine.from_harmonics(
    [1, 3, 5],
    [0.1, 0.02, 0.004],
    [0.0, 0.4, 0.1],
    pole_pairs=3,
    r_s=0.5,
    l_s=1e-3,
    m_s=-1e-4,
    i_max=20.0,
)


def angles(
    speed: float, periods: int, drives: int = 1
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.outer(speed * T_S * np.arange(periods + 1), np.ones(drives)) + 0.3


@pytest.fixture(scope="module")
def tracker() -> ThirdHarmonic:
    return third_harmonic(MACHINE, T_S, 60.0, omega_max=OMEGA_MAX)


def test_sum_voltage_is_the_mean_of_the_phase_voltages() -> None:
    """Quadrature of -3 A omega sin(3 theta - phi) over each period."""
    theta = angles(800.0, 20)
    u = sum_voltage(MACHINE, theta, T_S)[:, 0]
    for k in range(20):
        start = theta[k, 0]
        e = (
            quad(
                lambda t, s=start: -3.0 * 0.02 * 800.0 * np.sin(3.0 * (s + 800.0 * t) - 0.4),
                0.0,
                T_S,
            )[0]
            / T_S
        )
        assert u[k] == pytest.approx(e, rel=1e-9, abs=1e-9)
    np.testing.assert_allclose(third_flux(MACHINE), (0.02, 0.4))
    assert other_harmonics(MACHINE) < 1e-12


@pytest.mark.parametrize("speed", [300.0, -300.0, 2000.0])
@pytest.mark.parametrize("offset", [0.0, 0.3])
def test_angle_is_found_and_drift_compensated(
    tracker: ThirdHarmonic, speed: float, offset: float
) -> None:
    theta = angles(speed, 4000)
    result = run(tracker, sum_voltage(MACHINE, theta, T_S) + offset, theta[0] + 0.2, speed + 5.0)
    assert np.max(np.abs(third_error(result.theta, theta)[-500:])) < 1e-4
    assert abs(result.omega[-1, 0] - speed) < 0.05


def test_start_angle_decides_which_of_three(tracker: ThirdHarmonic) -> None:
    theta = angles(500.0, 2000)
    u = sum_voltage(MACHINE, theta, T_S)
    for turn in (1, 2):
        shift = 2.0 * np.pi * turn / 3.0
        result = run(tracker, u, theta[0] + shift + 0.1, 500.0)
        assert result.theta[-1, 0] - theta[-1, 0] == pytest.approx(shift, abs=1e-4)


@pytest.mark.parametrize("speed", [400.0, 1500.0])
def test_errors_decay_as_the_product_of_the_steps_says(
    tracker: ThirdHarmonic, speed: float
) -> None:
    count = round(2.0 * np.pi / (3.0 * speed * T_S))
    speed = 2.0 * np.pi / (3.0 * count * T_S)
    theta = angles(speed, 60 * count)
    result = run(tracker, sum_voltage(MACHINE, theta, T_S), theta[0] + 1e-4, speed)
    error = third_error(result.theta, theta)[:, 0]
    pole = turn_pole(tracker, speed)
    assert pole < 1.0
    envelope = [np.max(np.abs(error[n * count : (n + 1) * count])) for n in (20, 40)]
    # Nearly double poles: up to the square of the elapsed time comes on top of the power.
    assert 0.9 < envelope[1] / envelope[0] / pole ** (20 * count) < 4.0


def test_noise(tracker: ThirdHarmonic) -> None:
    speed = 2.0 * np.pi / (3.0 * 50 * T_S)
    theta = angles(speed, 4000, 40)
    u = sum_voltage(MACHINE, theta, T_S)
    result = run(
        tracker, u + 0.5 * np.random.default_rng(3).standard_normal(u.shape), theta[0], speed
    )
    spread = float(np.std(third_error(result.theta, theta)[1500:]))
    assert spread == pytest.approx(angle_noise(tracker, speed, 0.5), rel=0.08)


def test_wrong_amplitude_only_ripples_and_wrong_phase_shifts(tracker: ThirdHarmonic) -> None:
    theta = angles(1200.0, 6000)
    u = sum_voltage(MACHINE, theta, T_S)
    strong = run(replace(tracker, amplitude=1.2 * tracker.amplitude), u, theta[0], 1200.0)
    error = third_error(strong.theta, theta)[3000:]
    assert abs(float(np.mean(error))) < 5e-3  # of second order
    assert 1e-4 < float(np.max(np.abs(error))) < 0.2 / 3.0
    turned = run(replace(tracker, phase=tracker.phase + 0.06), u, theta[0], 1200.0)
    assert float(np.mean(third_error(turned.theta, theta)[3000:])) == pytest.approx(0.02, rel=1e-3)


def test_least_speed_keeps_the_loops_apart(tracker: ThirdHarmonic) -> None:
    assert tracker.least_speed == pytest.approx(4.0 * (1.0 - np.exp(-0.012)) / T_S / 3.0)
    assert turn_pole(tracker, tracker.least_speed) < 1.0


def test_refusals() -> None:
    plain = PhaseMachine.from_harmonics(
        [1], [0.1], [0.0], pole_pairs=3, r_s=0.5, l_s=1e-3, m_s=0.0, i_max=9.0
    )
    with pytest.raises(NoSolutionError, match="third harmonic of this machine's flux is 0"):
        third_harmonic(plain, T_S, 60.0, omega_max=OMEGA_MAX)
    with pytest.raises(NoSolutionError, match="model: waveform"):
        third_harmonic(None, T_S, 60.0, omega_max=OMEGA_MAX)
    with pytest.raises(NoSolutionError, match="fewer than six"):
        third_harmonic(MACHINE, T_S, 60.0, omega_max=4000.0)
    with pytest.raises(InputError, match="pole must lie"):
        third_harmonic(MACHINE, T_S, 6e3, omega_max=OMEGA_MAX)
    # each limit from both sides
    pole, speed = 0.5 / T_S, 1.0 / (3.0 * T_S)
    third_harmonic(MACHINE, T_S, 0.999 * pole, drift=0.999 * pole, omega_max=0.999 * speed)
    for own, drift in ((1.001 * pole, 60.0), (60.0, 1.001 * pole), (60.0, 0.0), (-1.0, 60.0)):
        with pytest.raises(InputError, match=f"got {drift if own == 60.0 else own:g}"):
            third_harmonic(MACHINE, T_S, own, drift=drift, omega_max=OMEGA_MAX)
    with pytest.raises(NoSolutionError, match="fewer than six"):
        third_harmonic(MACHINE, T_S, 60.0, omega_max=1.001 * speed)

    def with_third(share: float) -> PhaseMachine:
        return PhaseMachine.from_harmonics(
            [1, 3], [0.1, share], [0.0, 0.0], pole_pairs=3, r_s=0.5, l_s=1e-3, m_s=0.0, i_max=9.0
        )

    unit = third_flux(with_third(0.01))[0] / 0.01
    least = 0.005 * plain.psi_pm / unit
    third_harmonic(with_third(1.001 * least), T_S, 60.0, omega_max=OMEGA_MAX)
    with pytest.raises(NoSolutionError, match=r"is 0\.50 % of the fundamental, 0\.5 % are needed"):
        third_harmonic(with_third(0.999 * least), T_S, 60.0, omega_max=OMEGA_MAX)
