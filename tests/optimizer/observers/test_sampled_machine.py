"""The sampled machine against scipy's integration of the continuous one,
and its slopes against differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, RELUCTANCE
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.observers.sampled_machine import (
    exact_entries,
    sampled_machine,
    turned,
    wrapped,
)

T_S = 200e-6


def integrated(
    machine: LinearMachine, omega: float, i: FloatArray, v: FloatArray, t_s: float
) -> FloatArray:
    """Currents after one period, integrated in the rotor's frame with the
    voltage held in the stator's.
    """

    def slope(t: float, x: FloatArray) -> list[float]:
        c, s = np.cos(omega * t), np.sin(omega * t)
        v_d, v_q = c * v[0] + s * v[1], c * v[1] - s * v[0]
        return [
            (v_d - machine.r_s * x[0] + omega * machine.l_q * x[1]) / machine.l_d,
            (v_q - machine.r_s * x[1] - omega * (machine.l_d * x[0] + machine.psi_pm))
            / machine.l_q,
        ]

    return np.asarray(solve_ivp(slope, (0.0, t_s), i, rtol=1e-11, atol=1e-12).y[:, -1])


@pytest.mark.parametrize("speed", [-1.0, -0.3, 0.0, 0.5, 1.0])
@pytest.mark.parametrize("which", ["bench", "ipm", "reluctance"])
def test_prediction_is_the_integral(bench001: LinearMachine, which: str, speed: float) -> None:
    machine = {"bench": bench001, "ipm": IPM, "reluctance": RELUCTANCE}[which]
    model = sampled_machine(machine, T_S, 1500.0)
    i, v = np.array([-1.0, 2.0]), np.array([5.0, -12.0])
    expected = integrated(machine, speed * 1500.0, i, v, T_S)
    np.testing.assert_allclose(
        model.predict(np.array(speed * 1500.0), i, v), expected, rtol=1e-6, atol=1e-6
    )
    assert model.error < 1e-7


def test_slopes_are_differences_of_the_matrix_exponential(bench001: LinearMachine) -> None:
    model = sampled_machine(bench001, T_S, 2000.0)
    omega = np.linspace(-1900.0, 1900.0, 13)
    difference = (
        exact_entries(bench001, omega + 0.5, T_S) - exact_entries(bench001, omega - 0.5, T_S)
    ) / 1.0
    np.testing.assert_allclose(
        model.slopes(omega), difference, rtol=1e-5, atol=1e-5 * float(np.max(np.abs(difference)))
    )


def test_limits(bench001: LinearMachine) -> None:
    fast = replace(bench001, omega_m_max=500.0)
    assert sampled_machine(fast, T_S).omega_max == pytest.approx(1800.0)
    assert sampled_machine(bench001, T_S).omega_max == pytest.approx(5000.0)
    model = sampled_machine(fast, T_S)
    np.testing.assert_array_equal(model.entries(np.array(3000.0)), model.entries(np.array(1800.0)))
    with pytest.raises(NoSolutionError, match="fewer than six samples"):
        sampled_machine(bench001, T_S, 6000.0)
    with pytest.raises(InputError, match="sampling period"):
        sampled_machine(bench001, 0.0)


def test_frames() -> None:
    vector = np.array([3.0, 1.0])
    ahead = turned(vector, np.array(0.3))
    assert complex(*ahead) == pytest.approx((3.0 + 1.0j) * np.exp(-0.3j))
    np.testing.assert_allclose(
        wrapped(np.array([np.pi, -np.pi, 7.0])), [-np.pi, -np.pi, 7.0 - 2.0 * np.pi]
    )
