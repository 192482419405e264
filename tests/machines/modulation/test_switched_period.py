"""Switched periods: Fourier integrals against sampled waveforms, distortion against
sums of harmonics and theory.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.modulation.modulators import MODULATORS, SIX_STEP_AMPLITUDE
from dqforge.machines.modulation.ripple import harmonic_distortion_factor
from dqforge.machines.modulation.switched_period import fundamental, reference_for, switched_period
from dqforge.machines.names import ModulationName


@pytest.mark.parametrize("name", MODULATORS)
def test_ripple_of_a_switched_period_is_that_of_the_distortion_factor(name: ModulationName) -> None:
    """Carrier ratio 150: independent of the squared ripple per carrier period, to 1 %."""
    v_dc, f_sw = 300.0, 15e3
    for index, lag in ((0.25, -0.3), (0.7, 1.2)):
        period = switched_period(name, index * SIX_STEP_AMPLITUDE * v_dc, v_dc, 150, load_angle=lag)
        flux = period.harmonic_flux(2.0 * math.pi * f_sw / 150.0)
        factor = harmonic_distortion_factor(name, index, lag)
        assert flux == pytest.approx(v_dc / (24.0 * f_sw) * math.sqrt(factor), rel=0.01)
        made = np.abs(period.phase_voltage([1]))[0]
        np.testing.assert_allclose(made, index * SIX_STEP_AMPLITUDE * v_dc, rtol=2e-4)


def test_harmonics_of_the_pulses_are_those_of_sampled_pulses() -> None:
    period = switched_period("dpwm1", 120.0, 300.0, 21, load_angle=0.5)
    theta = (np.arange(200_000) + 0.5) * (2.0 * math.pi / 200_000)
    on = np.zeros((theta.size, 3))
    for pulse in period.edges:
        on += (theta[:, None] > pulse[:, 0]) & (theta[:, None] < pulse[:, 1])
    orders = np.array([1, 2, 5, 7, 19, 21, 23, 42])
    sampled = 600.0 * np.mean(on[None] * np.exp(-1j * orders[:, None] * theta)[..., None], axis=1)
    np.testing.assert_allclose(period.leg_voltage(orders), sampled, rtol=0.0, atol=0.02)
    np.testing.assert_allclose(period.phase_voltage(orders).sum(axis=1), 0.0, atol=1e-10)
    line = 300.0 * (on - np.roll(on, -1, axis=1))
    phasors = np.abs(period.line_voltage([1])[0]) ** 2 / 2.0
    expected = math.sqrt(np.mean(line**2) / phasors.mean() - 1.0)
    assert period.line_voltage_thd() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("name", ["spwm", "dpwmmax"])
def test_distortions_are_the_sums_over_the_harmonics(name: ModulationName) -> None:
    period = switched_period(name, 130.0, 300.0, 15)
    orders = np.arange(2, 15 * 300)
    phase = np.abs(period.phase_voltage(orders)) ** 2 / 2.0
    omega_e = 500.0
    flux = math.sqrt(np.sum(np.mean(phase, axis=1) / (orders * omega_e) ** 2))
    assert period.harmonic_flux(omega_e) == pytest.approx(flux, rel=1e-5)
    assert period.current_thd(omega_e, 2e-3, 30.0) == pytest.approx(
        flux / 2e-3 / (30.0 / math.sqrt(2.0)), rel=1e-5
    )
    line = np.abs(period.line_voltage(orders)) ** 2
    first = np.mean(np.abs(period.line_voltage([1])) ** 2)
    truncated = math.sqrt(np.sum(np.mean(line, axis=1)) / first)
    assert truncated < period.line_voltage_thd() < truncated * 1.01


@pytest.mark.parametrize("name", ["svpwm", "dpwm3", "ddt-gdpwm"])
def test_overmodulated_references_make_the_wanted_fundamental(name: ModulationName) -> None:
    v_dc, wanted = 300.0, 0.62 * 300.0
    reference = float(reference_for(name, wanted, v_dc))
    made = np.abs(switched_period(name, reference, v_dc, 999).phase_voltage([1]))[0]
    np.testing.assert_allclose(made, wanted, rtol=5e-4)
    assert fundamental(name, reference, v_dc) == pytest.approx(wanted, rel=1e-12)


def test_six_step_has_its_known_harmonics_and_distortion() -> None:
    """2 v_dc / (n pi) for n = 1, 5, 7, 11, ...; distortion sqrt(pi^2 / 9 - 1) = 31.1 %."""
    period = switched_period("dpwm1", 400.0, 300.0, 300)
    orders = np.array([1, 3, 5, 7, 11, 13])
    expected = 2.0 * 300.0 / (orders * math.pi) * (orders % 3 != 0)
    np.testing.assert_allclose(
        np.abs(period.phase_voltage(orders)), expected[:, None] * np.ones(3), atol=1e-9
    )
    assert period.line_voltage_thd() == pytest.approx(math.sqrt(math.pi**2 / 9.0 - 1.0), rel=1e-9)


def test_too_few_carrier_periods_are_refused() -> None:
    with pytest.raises(InputError, match="3 carrier periods"):
        switched_period("spwm", 1.0, 10.0, 2)
