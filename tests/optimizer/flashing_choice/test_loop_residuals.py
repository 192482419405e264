"""What a loop leaves of disturbances, against loops stepped in time and against known figures."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from phase_shapes import paper_machine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.flashing_choice import (
    followed_offsets,
    noise_gain,
    phases_of,
    residual_currents,
    stationary,
)
from dqforge.optimizer.phase_control.phase_controller import (
    AxisGains,
    HarmonicGains,
    PhaseControl,
    PhaseShape,
)

T_S, OMEGA_C = 1e-4, 2.0 * math.pi * 500.0


def _gains(inductance: float, *, integral: bool = True) -> AxisGains:
    kp = OMEGA_C * inductance
    return AxisGains(kp, kp * OMEGA_C / 10.0 if integral else 0.0)


def _control(*, integral: bool = True) -> PhaseControl:
    plane, zero = _gains(8e-3, integral=integral), _gains(5e-3, integral=integral)
    return PhaseControl(
        frame="table",
        feedforward="references",
        topology="six-leg",
        shape=PhaseShape(paper_machine().flux[:1]),
        pole_pairs=2,
        r_s=1.0,
        psi_pm=0.2233,
        inductances=(8e-3, 8e-3, 5e-3),
        gains=(plane, plane, zero),
        harmonics=None,
        t_s=T_S,
        torque_max=4.0,
    )


CONTROL = _control()


def _stepped(disturbance: FloatArray, omega: float, periods: int) -> FloatArray:
    """The loop in time: phases with three axes, PI in dq0, one sample of delay. The last period of
    currents (3, samples) at the samples; disturbances (3, samples) repeat.
    """
    count = disturbance.shape[1]
    plane, zero = stationary(disturbance)
    decay = np.exp(-T_S / np.array([8e-3, 5e-3]))
    i_p, i_z, sum_p, sum_z, v_p, v_z = 0j, 0.0, 0j, 0.0, 0j, 0.0
    kept_p, kept_z = np.zeros(count, complex), np.zeros(count)
    gain_p, gain_z = CONTROL.gains[1], CONTROL.gains[2]
    for k in range(periods * count):
        kept_p[k % count], kept_z[k % count] = i_p, i_z
        turn = np.exp(1j * omega * T_S * k)
        next_p = -gain_p.kp * i_p + sum_p * turn * np.exp(1.5j * omega * T_S)
        next_z = -gain_z.kp * i_z + sum_z
        sum_p -= gain_p.ki * T_S * i_p / turn
        sum_z -= gain_z.ki * T_S * i_z
        i_p = decay[0] * i_p + (1.0 - decay[0]) * (v_p + plane[k % count])
        i_z = decay[1] * i_z + (1.0 - decay[1]) * (v_z + zero[k % count])
        v_p, v_z = next_p, next_z
    return phases_of(kept_p, kept_z)


@pytest.mark.parametrize("order", [1, 3, 5, 7])
def test_residuals_are_those_of_the_loop_in_time(order: int) -> None:
    """A phase voltage of one order, 400 samples per period: within 3 % of the stepped loop."""
    count, omega = 400, 2.0 * math.pi / (400 * T_S)
    theta = 2.0 * np.pi * np.arange(count) / count
    lag = 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    volts = np.cos(order * (theta - lag)) + 0.3 * np.cos(order * theta)
    found = residual_currents(CONTROL, volts, omega)
    exact = _stepped(volts, omega, 12)
    # The voltage of a sample acts over the period behind it, as the disturbance does here.
    lines = [
        np.abs(np.fft.rfft(part)[:, order] if part.ndim > 1 else part) for part in (found, exact)
    ]
    assert lines[0] == pytest.approx(lines[1], rel=3e-2, abs=1e-3 * np.max(lines[1]))


def test_an_order_with_an_integrator_of_its_own_vanishes() -> None:
    """Others stay as they are, and above the frequency of the integrators nothing vanishes."""
    theta = 2.0 * np.pi * np.arange(360) / 360.0
    volts = np.stack([np.cos(5.0 * (theta - 2.0 * np.pi / 3.0 * k)) for k in range(3)])
    other = np.stack([np.cos(7.0 * (theta - 2.0 * np.pi / 3.0 * k)) for k in range(3)])
    harmonics = HarmonicGains((-5,), (3,), 60.0, 10e3 / 6.0, 1.0)
    learned = replace(CONTROL, harmonics=harmonics)
    omega = 2.0 * math.pi * 25.0
    plain = residual_currents(CONTROL, volts, omega)
    assert np.max(np.abs(residual_currents(learned, volts, omega))) < 1e-12 * np.max(plain)
    assert residual_currents(learned, other, omega) == pytest.approx(
        residual_currents(CONTROL, other, omega)
    )
    fast = 2.0 * math.pi * 400.0
    assert residual_currents(learned, volts, fast) == pytest.approx(
        residual_currents(CONTROL, volts, fast)
    )


@pytest.mark.parametrize(("rpm", "open_loop", "closed"), [(150.0, 5.07, 0.10), (750.0, 2.19, 0.30)])
def test_dead_time_drives_the_known_neutral_current(
    rpm: float, open_loop: float, closed: float
) -> None:
    """Six legs, square waves of 2 t_d f_sw V_dc in every phase: third order of the neutral without
    a controller of the zero sequence, and with its PI.
    """
    omega = 2.0 * rpm * math.pi / 30.0
    theta = 2.0 * np.pi * (np.arange(3600) + 0.5) / 3600.0
    lag = 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    volts = -2.0 * 2.2 * np.sign(np.cos(theta - lag))
    none = AxisGains(0.0, 0.0)
    free = replace(CONTROL, gains=(CONTROL.gains[0], CONTROL.gains[1], none))
    for control, expected in ((free, open_loop), (CONTROL, closed)):
        neutral = np.sum(residual_currents(control, volts, omega), axis=0)
        third = 2.0 * abs(np.fft.rfft(neutral)[3]) / theta.size
        assert third == pytest.approx(expected, rel=8e-2)


def test_an_offset_is_followed() -> None:
    """A sensor that is 30 mA off: the machine gets nearly as much, with the other sign."""
    omega = 2.0 * math.pi * 25.0
    found = followed_offsets(CONTROL, np.array([30e-3, 0.0, 0.0]), omega)
    assert found == pytest.approx([-30e-3, 0.0, 0.0], abs=3e-3)
    assert TOPOLOGIES[CONTROL.topology].neutral


def test_noise_passes_by_the_loop_stepped_in_time() -> None:
    """R.m.s. of the current over that of the noise, against 40000 samples of the loop."""
    gains, r_s, inductance = AxisGains(OMEGA_C * 8e-3, 0.0), 1.0, 8e-3
    generator = np.random.default_rng(3)
    decay = math.exp(-T_S * r_s / inductance)
    current, volts, squares = 0.0, 0.0, 0.0
    noise = generator.normal(size=40_000)
    for value in noise:
        following = -gains.kp * (current + value)
        current = decay * current + (1.0 - decay) / r_s * volts
        volts = following
        squares += current * current
    stepped = math.sqrt(squares / noise.size)
    assert noise_gain(gains, r_s, inductance, T_S) == pytest.approx(stepped, rel=3e-2)


def test_two_periods_leave_what_one_leaves() -> None:
    """Waveforms over several electrical periods, with orders between the whole ones."""
    theta = 2.0 * np.pi * np.arange(360) / 360.0
    volts = np.stack([np.cos(5.0 * (theta - 2.0 * np.pi / 3.0 * k)) for k in range(3)])
    omega = 2.0 * math.pi * 25.0
    one = residual_currents(CONTROL, volts, omega)
    two = residual_currents(CONTROL, np.tile(volts, (1, 2)), omega, turns=2)
    assert two == pytest.approx(np.tile(one, (1, 2)), abs=1e-12)
