"""Drives in motion: against an adaptive integrator of the dq equations and the phasor equation,
and their control.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.plants.scenario import drive_motion, next_flux, plants

MACHINE = LinearMachine(pole_pairs=4, r_s=0.3, l_d=2e-3, l_q=5e-3, psi_pm=0.08, i_max=20.0)
T_S = 1e-4


def _integrated(v: complex, i_0: complex, theta_0: float, omega: tuple[float, float]) -> complex:
    """dq current after one period, from the dq voltage equations with an
    adaptive integrator of order 8.
    """

    def slope(time: float, x: FloatArray) -> list[float]:
        speed = omega[0] + (omega[1] - omega[0]) * time / T_S
        theta = theta_0 + omega[0] * time + 0.5 * (omega[1] - omega[0]) * time**2 / T_S
        v_dq = v * np.exp(-1j * theta)
        i_d, i_q = x
        return [
            (v_dq.real - MACHINE.r_s * i_d + speed * MACHINE.l_q * i_q) / MACHINE.l_d,
            (v_dq.imag - MACHINE.r_s * i_q - speed * (MACHINE.l_d * i_d + MACHINE.psi_pm))
            / MACHINE.l_q,
        ]

    end = solve_ivp(
        slope, (0.0, T_S), [i_0.real, i_0.imag], method="DOP853", rtol=1e-12, atol=1e-13
    ).y[:, -1]
    return complex(end[0], end[1])


def test_a_period_is_that_of_the_dq_equations_and_converges_with_the_fourth_order() -> None:
    plant = plants(MACHINE, count=3)
    theta, i_0 = np.array([0.3, -1.0, 2.5]), np.array([1 + 2j, -3 + 5j, -8 - 10j])
    omega = (np.array([300.0, -2000.0, 900.0]), np.array([310.0, -1900.0, 700.0]))
    v = np.array([20 + 5j, -30 + 40j, 60 - 10j])
    end = theta + 0.5 * T_S * (omega[0] + omega[1])
    expected = np.array(
        [
            _integrated(
                complex(v[n]),
                complex(i_0[n]),
                float(theta[n]),
                (float(omega[0][n]), float(omega[1][n])),
            )
            for n in range(3)
        ]
    )
    errors = []
    for substeps in (1, 2, 4):
        psi = next_flux(plant, plant.flux(i_0) * np.exp(1j * theta), v, theta, omega, T_S, substeps)
        errors.append(float(np.max(np.abs(plant.current(psi, end) * np.exp(-1j * end) - expected))))
    assert errors[2] < 1e-8
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)


def test_the_controller_holds_the_references_of_right_and_of_wrong_machines() -> None:
    omega = np.full((300, 1), 1200.0)
    wrong = {"r_s": [0.0, 0.5, 0.0], "l_q": [0.0, 0.0, -0.3], "psi_pm": [0.0, -0.1, 0.0]}
    motion = drive_motion(MACHINE, T_S, omega, np.array([-3 + 8j]), wrong)
    assert motion.i_d.shape == (300, 3)
    np.testing.assert_allclose(motion.i_d, -3.0, atol=1e-6)  # from the steady state on
    np.testing.assert_allclose(motion.i_q, 8.0, atol=1e-6)


@pytest.mark.slow
def test_the_controller_reaches_new_references_with_a_wrong_machine() -> None:
    reference = np.full((2500, 1), -3 + 8j)
    reference[:1] = 0.0
    wrong = {"r_s": [0.0, 0.5, 0.0], "l_q": [0.0, 0.0, -0.3], "psi_pm": [0.0, -0.1, 0.0]}
    motion = drive_motion(MACHINE, T_S, np.full((2500, 1), 1200.0), reference, wrong)
    assert np.max(np.abs(motion.i_q[:2])) < 1e-6  # the delay
    np.testing.assert_allclose(motion.i_d[-1], -3.0, atol=1e-6)
    np.testing.assert_allclose(motion.i_q[-1], 8.0, atol=1e-6)


def test_voltage_rows_belong_to_the_period_that_ends() -> None:
    """The rows of voltage carry the currents from one row to the next, with a speed that
    changes.
    """
    time: FloatArray = np.arange(60.0)[:, None] * T_S
    motion = drive_motion(
        MACHINE,
        T_S,
        500.0 + 3e5 * time,
        np.asarray(4j + 200j * time, dtype=np.complex128),
        theta_0=0.7,
    )
    plant = plants(MACHINE)
    for k in (5, 30):
        i_0 = motion.i_alpha[k] + 1j * motion.i_beta[k]
        turn = np.exp(1j * motion.theta_e[k])
        psi = plant.flux(i_0 / turn) * turn
        v = motion.v_alpha[k + 1] + 1j * motion.v_beta[k + 1]
        psi = next_flux(
            plant, psi, v, motion.theta_e[k], (motion.omega_e[k], motion.omega_e[k + 1]), T_S
        )
        i_1 = plant.current(psi, motion.theta_e[k + 1])
        assert complex(i_1[0]) == pytest.approx(
            complex(motion.i_alpha[k + 1, 0], motion.i_beta[k + 1, 0]), abs=1e-12
        )


def test_the_mean_voltage_is_that_of_the_phasor_equation() -> None:
    """Sampled finely, the held voltage is R i + j omega psi."""
    motion = drive_motion(
        MACHINE, 2e-6, np.full((300, 1), 400.0), np.array([-2 + 6j]), bandwidth=2000.0
    )
    middle = motion.theta_e[-1] - 400.0 * 1e-6
    v_dq = complex(((motion.v_alpha[-1] + 1j * motion.v_beta[-1]) * np.exp(-1j * middle))[0])
    v_d, v_q = MACHINE.voltage(np.array(-2.0), np.array(6.0), np.array(400.0))
    assert v_dq == pytest.approx(complex(v_d, v_q), rel=1e-5)


def test_noise_has_the_given_size_and_leaves_the_truth_alone() -> None:
    motion = drive_motion(MACHINE, T_S, np.full((2000, 2), 300.0), np.array([0j]))
    noisy = motion.measured(0.05, 0.4, seed=3)
    assert np.std(noisy.i_alpha - motion.i_alpha) == pytest.approx(0.05, rel=0.05)
    assert np.std(noisy.v_beta - motion.v_beta) == pytest.approx(0.4, rel=0.05)
    np.testing.assert_array_equal(noisy.theta_e, motion.theta_e)


def test_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(InputError, match="plant error of l_s is unknown"):
        plants(MACHINE, {"l_s": 0.1})
