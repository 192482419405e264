"""Both current loops while the machine turns, against single loops at standstill and an
integration in the stator.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import Tolerances
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.integer_gains import (
    CurrentControl,
    TurningMachines,
    closed_matrices,
    largest_pole,
)
from dqforge.optimizer.loops.plants import current_loop

R, L_D, L_Q, T_S = 0.4, 2e-3, 5e-3, 1e-4
CONTROL = CurrentControl(
    kp=(4.0, 9.0), ki_ts=(0.05, 0.09), l_d=1.8e-3, l_q=5.5e-3, advance=1.5 * T_S, t_s=T_S
)


def machines(*omega_e: float, gain: float = 1.0) -> TurningMachines:
    ones = np.ones(len(omega_e))
    return TurningMachines(R * ones, L_D * ones, L_Q * ones, gain * ones, np.array(omega_e))


def test_at_standstill_the_poles_are_those_of_both_loops() -> None:
    found = np.sort_complex(np.linalg.eigvals(closed_matrices(machines(0.0), CONTROL)[0]))
    single = [
        current_loop(R, inductance, T_S, kp, ki_ts / T_S).closed.poles
        for inductance, kp, ki_ts in zip((L_D, L_Q), CONTROL.kp, CONTROL.ki_ts, strict=True)
    ]
    np.testing.assert_allclose(found, np.sort_complex(np.concatenate(single)), atol=1e-9)


@pytest.mark.parametrize("omega", [-1500.0, 700.0, 2500.0])
def test_the_map_is_that_of_a_voltage_held_in_the_stator(omega: float) -> None:
    """Each column by integrating the machine in rotor coordinates under a voltage that
    stands still in the stator.
    """
    matrix = closed_matrices(machines(omega, gain=1.1), CONTROL)[0]

    def after(i: FloatArray, v: FloatArray) -> FloatArray:
        """Currents one period later; v was computed one period before, in coordinates turned by the
        advance.
        """
        in_stator = (v[0] + 1j * v[1]) * np.exp(1j * omega * (CONTROL.advance - T_S))

        def slopes(time: float, x: FloatArray) -> list[float]:
            turned = 1.1 * in_stator * np.exp(-1j * omega * time)
            return [
                (turned.real - R * x[0] + omega * L_Q * x[1]) / L_D,
                (turned.imag - R * x[1] - omega * L_D * x[0]) / L_Q,
            ]

        return np.asarray(solve_ivp(slopes, (0.0, T_S), i, rtol=1e-11, atol=1e-13).y[:, -1])

    for column in range(6):
        x = np.eye(6)[column]
        i, v, integral = x[:2], x[2:4], x[4:]
        ki, kp = np.array(CONTROL.ki_ts), np.array(CONTROL.kp)
        computed = (
            -kp * i
            + (integral - ki * i)
            + omega * np.array([-CONTROL.l_q * i[1], CONTROL.l_d * i[0]])
        )
        expected = np.concatenate([after(i, v), computed, integral - ki * i])
        np.testing.assert_allclose(matrix[:, column], expected, rtol=1e-8, atol=1e-9)


def test_wrong_decoupling_at_high_speed_is_unstable_and_refused() -> None:
    far = replace(CONTROL, l_d=0.0, l_q=3.0 * L_Q)
    assert largest_pole(machines(0.0), far)[0] < 1.0
    assert largest_pole(machines(6000.0), far)[0] > 1.0
    design = catalogue.load("abb-ipmsm-2k2")
    machine = replace(design.machine, omega_m_max=3000.0)  # type: ignore[type-var]
    tolerances = Tolerances(l_d=0.5, l_q=0.5)
    slow = replace(design.control.current_loop, method="bandwidth", bandwidth=300.0)
    control = replace(
        design.control, current_loop=slow, speed_loop=None, observer=None, tolerances=tolerances
    )
    with pytest.raises(NoSolutionError, match="both current loops together are unstable at"):
        solve_gains(replace(design, machine=machine, control=control))
    kept = solve_gains(replace(design, control=control)).robust
    assert kept is not None
    assert kept.turning is not None
    assert 0.5 < kept.turning.value < 1.0
    assert "rpm" in kept.turning.at
