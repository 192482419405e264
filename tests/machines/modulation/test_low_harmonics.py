"""Low harmonics of overmodulation against their integrals, and what they do in a machine."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.modulation.dead_time import (
    ORDERS,
    LowHarmonics,
    low_harmonics,
    voltage_harmonics,
    waveform,
)
from dqforge.machines.modulation.registry import HEXAGON, METHODS, SIX_STEP
from dqforge.machines.names import OvermodulationName

ROUND = LinearMachine(pole_pairs=4, r_s=0.0, l_d=1e-3, l_q=1e-3, psi_pm=0.05, i_max=50.0)
SALIENT = LinearMachine(pole_pairs=3, r_s=0.4, l_d=2e-3, l_q=5e-3, psi_pm=0.08, i_max=50.0)


@pytest.mark.parametrize("name", METHODS)
def test_six_step_has_the_harmonics_of_a_square_wave(name: OvermodulationName) -> None:
    (found,) = voltage_harmonics(name, [SIX_STEP])
    # 1 / n of the fundamental; the vector moves from corner to corner within 2e-3 rad
    assert found == pytest.approx(SIX_STEP / np.array(ORDERS), rel=1e-3)


def test_hexagon_has_the_harmonics_of_its_side() -> None:
    """The vector h(x) = 1/(sqrt(3) cos x) off the middle of a side: a_n is 6/pi times the integral
    of h cos((n -+ 1) x) over 30 degrees, with the radial method's polynomial within 1e-3 of it.
    """
    (found,) = voltage_harmonics("least-phase-error", [HEXAGON])
    for order, amplitude in zip(ORDERS, found, strict=True):
        turns = 6 * round(order / 6)
        integral, _ = quad(lambda x, n=turns: math.cos(n * x) / math.cos(x), 0.0, math.pi / 6.0)
        assert amplitude == pytest.approx(abs(6.0 / math.pi / math.sqrt(3.0) * integral), abs=4e-5)


@pytest.mark.parametrize("name", METHODS)
def test_distortion_holds_all_orders_and_grows(name: OvermodulationName) -> None:
    speed = np.linspace(0.907, 1.0, 40) * SIX_STEP * 300.0 / (4 * 0.05)
    found = low_harmonics(name, ROUND, 0.0, 0.0, speed, v_dc=300.0)
    assert found.index == pytest.approx(np.linspace(0.907, 1.0, 40))
    assert np.all(np.diff(found.distortion) > 0.0)
    assert np.all(np.diff(found.copper) == 0.0)  # no resistance
    told = np.sqrt(np.sum(found.voltage**2, axis=1)) / (found.index * SIX_STEP * 300.0)
    assert np.all(told <= found.distortion * (1.0 + 1e-9))
    assert told[-1] > 0.9 * found.distortion[-1]
    # of a six-step wave: sqrt(pi^2/9 - 1) of the fundamental
    assert found.distortion[-1] == pytest.approx(math.sqrt(math.pi**2 / 9.0 - 1.0), abs=2e-3)


def test_currents_of_a_round_machine_are_voltage_over_reactance() -> None:
    omega_m, v_dc = 450.0, 0.05 * 4 * 450.0 / (0.97 * SIX_STEP)
    found = low_harmonics("least-magnitude-error", ROUND, 0.0, 0.0, omega_m, v_dc=v_dc)
    orders = np.arange(5, 400, 6).repeat(2) + np.tile([0, 2], 66)
    bins = np.fft.fft(waveform("least-magnitude-error", np.array([0.97 * SIX_STEP]))[0]) / 720
    reactance = orders * 4 * omega_m * 1e-3
    places = np.where(orders % 6 == 1, orders // 6, -((orders + 1) // 6))
    amplitude = v_dc * np.abs(bins[places]) / reactance
    assert found.current[0] == pytest.approx(math.sqrt(0.5 * np.sum(amplitude**2)), rel=1e-3)
    # 6th of the torque: orders 5 and 7 turn against and with it, 3/2 p psi (i_7 - i_5) on q
    fifth, seventh = (v_dc * bins[k] / (n * 4 * omega_m * 1e-3) for k, n in ((-1, 5), (1, 7)))
    # i = v / (j n omega L), the backward one with -n; i_q is the imaginary part, v along q
    i_q = seventh - np.conj(-fifth)
    assert found.torque_6[0] == pytest.approx(1.5 * 4 * 0.05 * abs(i_q), rel=1e-3)


def test_currents_of_a_salient_machine_solve_its_equations() -> None:
    """The ripple is put back into the differential equations by a fine step in time."""
    i_d, i_q, omega_m = -8.0, 12.0, 700.0
    omega_e = 3 * omega_m
    v_d, v_q = SALIENT.voltage(np.array(i_d), np.array(i_q), np.array(omega_e))
    v_dc = math.hypot(v_d, v_q) / (0.965 * SIX_STEP)
    found = low_harmonics("least-phase-error", SALIENT, i_d, i_q, omega_m, v_dc=v_dc)
    wave = v_dc * waveform("least-phase-error", np.array([0.965 * SIX_STEP]))[0]
    count = wave.size
    direction = math.atan2(v_q, v_d)
    voltage = wave * np.exp(1j * direction)
    step = math.pi / 3.0 / count / omega_e
    x = np.array([i_d, i_q])
    inverse = np.diag([1.0 / 2e-3, 1.0 / 5e-3])
    matrix = inverse @ np.array([[-0.4, omega_e * 5e-3], [-omega_e * 2e-3, -0.4]])
    free = inverse @ np.array([0.0, -omega_e * 0.08])
    eye = np.eye(2)
    forward = np.linalg.solve(eye - 0.5 * step * matrix, eye + 0.5 * step * matrix)
    ahead = np.linalg.solve(eye - 0.5 * step * matrix, step * eye)
    record = []
    for turn in range(150):
        for k in range(count):
            x = forward @ x + ahead @ (inverse @ [voltage[k].real, voltage[k].imag] + free)
            if turn == 149:
                record.append(x)
    currents = np.array(record)
    ripple = currents - currents.mean(axis=0)
    assert found.current[0] == pytest.approx(
        math.sqrt(0.5 * np.mean(np.sum(ripple**2, axis=1))), rel=2e-3
    )
    torque = 4.5 * (0.08 + (2e-3 - 5e-3) * currents[:, 0]) * currents[:, 1]
    assert found.torque[0] == pytest.approx(np.ptp(torque), rel=5e-3)
    assert found.peak_current[0] == pytest.approx(np.hypot(*currents.T).max(), rel=1e-3)
    assert found.copper[0] == pytest.approx(0.6 * np.mean(np.sum(ripple**2, axis=1)), rel=4e-3)


def test_nothing_within_the_linear_range_and_no_number_beyond_six_step() -> None:
    speed = np.array([0.5, 0.9, 1.1]) * SIX_STEP * 300.0 / (4 * 0.05)
    found: LowHarmonics = low_harmonics("least-phase-error", ROUND, 0.0, 0.0, speed, v_dc=300.0)
    assert found.torque[:2].tolist() == [0.0, 0.0]
    assert math.isnan(found.torque[2])
    none = low_harmonics("none", ROUND, 0.0, 0.0, 1.05 * speed, v_dc=300.0)
    assert none.torque[:2].tolist() == [0.0, 0.0]
