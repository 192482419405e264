"""Resting phases and switching loss of discontinuous modulators: Hava, Kerkman,
Lipo 1998 and 1999.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from modulators import duties, folded, phases_at, rest
from scipy.integrate import quad

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.losses.machine_budget import bridge_load
from dqforge.machines.modulation.modulator import clamping_angle
from dqforge.machines.modulation.modulators import MODULATORS, modulate, period_waveforms
from dqforge.machines.modulation.registry import DISCONTINUOUS, resting_phase, switching_loss_factor
from dqforge.machines.names import ModulationName

RESTING = sorted(DISCONTINUOUS)
RIVALS: tuple[ModulationName, ModulationName] = ("gdpwm", "ddt-gdpwm")
DEVICE = SwitchDevice("mosfet", 1e-3, 1e-3, 1e-3, 1.0, 1.0, 0.1)
ROOT3 = math.sqrt(3.0)


def dpwm1_factor(phi: float) -> float:
    size = abs(folded(phi))
    return 1.0 - 0.5 * math.cos(size) if size <= math.pi / 3 else 0.5 * ROOT3 * math.sin(size)


def dpwm3_factor(phi: float) -> float:
    size = abs(folded(phi))
    if size <= math.pi / 6:
        return 1.0 - 0.5 * (ROOT3 - 1.0) * math.cos(size)
    return (
        0.5 * (math.sin(size) + math.cos(size))
        if size <= math.pi / 3
        else 1 - 0.5 * (ROOT3 - 1) * math.sin(size)
    )


def one_rail_factor(phi: float) -> float:
    size = abs(folded(phi))
    return (
        1.0 - 0.25 * ROOT3 * math.cos(size) if size <= math.pi / 6 else 0.5 + 0.25 * math.sin(size)
    )


def gdpwm_factor(phi: float) -> float:
    size = abs(folded(phi))
    return 0.5 if size <= math.pi / 6 else dpwm1_factor(size - math.pi / 6)


def ddt_factor(phi: float) -> float:
    """Beyond 60 degrees both currents rest in turn."""
    size = abs(folded(phi))
    return gdpwm_factor(phi) if size <= math.pi / 3 else 1.0 - 0.5 * (ROOT3 - math.sin(size))


# Switching loss functions integrated by hand, piece by piece (Hava 1999).
HAND: dict[str, Callable[[float], float]] = {
    "dpwm0": lambda phi: dpwm1_factor(phi + math.pi / 6),
    "dpwm1": dpwm1_factor,
    "dpwm2": lambda phi: dpwm1_factor(phi - math.pi / 6),
    "dpwm3": dpwm3_factor,
    "dpwmmin": one_rail_factor,
    "dpwmmax": one_rail_factor,
    "gdpwm": gdpwm_factor,
    "ddt-gdpwm": ddt_factor,
}


@pytest.mark.parametrize("name", RESTING)
@pytest.mark.parametrize("degrees", [*range(-90, 91, 10), -45, 45, 135, 170, 200])
def test_switching_loss_is_the_analytic_curve_in_closed_form_and_in_the_bridge(
    name: ModulationName, degrees: int
) -> None:
    lag = math.radians(degrees)
    assert switching_loss_factor(name, lag) == pytest.approx(HAND[name](lag), rel=1e-12)
    inverter = Inverter(1.0, 1.0, DEVICE)
    one, all_switch = (
        bridge_load(
            inverter, m, 0.3, 0.4, math.cos(0.927295218 - lag), math.sin(0.927295218 - lag)
        ).switching
        for m in (name, "spwm")
    )
    assert one / all_switch == pytest.approx(HAND[name](lag), rel=1e-7)


@pytest.mark.parametrize("name", RESTING)
@pytest.mark.parametrize("degrees", [0, 17, -38, 68, -85, 120])
def test_switching_loss_against_quadrature_of_waveforms_written_out(
    name: ModulationName, degrees: int
) -> None:
    lag = math.radians(degrees)

    def switched(angle: float) -> float:
        place, i = rest(name, angle, lag), phases_at(angle - lag)
        return sum(abs(x) for k, x in enumerate(i) if place is None or k != place[0])

    kinks = [k * math.pi / 6 for k in range(13)] + [lag + k * math.pi / 6 for k in range(-12, 25)]
    kinks += [math.pi / 3 * k + float(clamping_angle(lag)) for k in range(6)]
    kinks += [lag + (k + 0.5) * math.pi / 6 for k in range(-12, 25)]
    edges = sorted({min(max(x, 0.0), 2.0 * math.pi) for x in kinks})
    total = sum(quad(switched, a, b, epsabs=1e-9)[0] for a, b in pairwise(edges) if b - a > 1e-9)
    assert switching_loss_factor(name, lag) == pytest.approx(total / 12.0, rel=1e-6)


@settings(deadline=None)
@given(
    st.sampled_from(tuple(MODULATORS)),
    st.floats(0.01, 0.5),
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi, math.pi),
    st.floats(0.1, 900.0),
)
def test_duty_cycles_are_those_written_out(
    name: ModulationName, amplitude: float, angle: float, lag: float, v_dc: float
) -> None:
    """Away from the angles where the resting phase changes, where either of two phases may rest."""
    near = [(angle + s, lag) for s in (-1e-6, 1e-6)] + [(angle, lag - 1e-6), (angle, lag + 1e-6)]
    if len({rest(name, *place) for place in near}) == 1:
        voltage, current = (
            v_dc * amplitude * np.array(phases_at(angle)),
            7.0 * np.array(phases_at(angle - lag)),
        )
        found = modulate(name, voltage, current, v_dc)
        np.testing.assert_allclose(
            found.duty, duties(name, amplitude, angle, lag), rtol=0.0, atol=1e-12
        )
        place = rest(name, angle, lag)
        assert found.clamped.tolist() == [place is not None and place[0] == k for k in range(3)]


@settings(deadline=None)
@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_ddt_clamps_the_larger_current_of_the_two_that_can_rest(angle: float, lag: float) -> None:
    voltage, current = np.array(phases_at(angle)), np.array(phases_at(angle - lag))
    assume(np.min(np.diff(np.sort(voltage))) > 1e-9)
    phase, _ = resting_phase("ddt-gdpwm", voltage, current)
    candidates = sorted(range(3), key=lambda k: float(voltage[k]))
    assert int(phase) in {candidates[0], candidates[2]}
    assert (
        abs(current[phase]) >= max(abs(current[candidates[0]]), abs(current[candidates[2]])) - 1e-12
    )


@pytest.mark.parametrize("degrees", range(-180, 181, 5))
def test_ddt_rests_the_phase_around_the_peak_of_its_current(degrees: int) -> None:
    """Centred on the peak up to 30 degrees of lag, against the limit of what
    can rest up to 60 degrees.

    Beyond, a phase whose current peaks has the middle reference and cannot rest; then the peaks are
    as far from the resting phases as they must be.
    """
    lag = math.radians(degrees)
    angle = np.radians(
        np.arange(-89.95, 90.0, 0.1)
    )  # of the voltage from the positive peak of phase a
    wave = np.array([0.0, 2.0, -2.0]) * math.pi / 3.0
    voltage, current = np.cos(angle[:, None] - wave), np.cos(angle[:, None] - lag - wave)
    phase, _ = resting_phase("ddt-gdpwm", voltage, current)
    resting = np.degrees(angle[phase == 0])
    peak = math.degrees(folded(lag))
    if abs(peak) <= 60.0:
        # One interval of 60 degrees that holds the peak of the current's magnitude.
        assert np.ptp(resting) == pytest.approx(60.0, abs=0.25)
        assert resting.mean() == pytest.approx(min(max(peak, -30.0), 30.0), abs=0.15)
        assert resting.min() - 0.1 <= peak <= resting.max() + 0.1
    else:
        # 60 degrees in two parts, from the limit on the peak's side and from
        # the one on the other side.
        assert resting.size == pytest.approx(600, abs=4)
        assert np.abs(resting).max() == pytest.approx(60.0, abs=0.15)
        assert np.sum(resting * peak > 0.0) >= 0.5 * resting.size - 2
    # No modulator that rests the highest or the lowest phase finds a larger current anywhere.
    order = np.argsort(voltage, axis=-1)
    rows = np.arange(angle.size)
    largest = np.maximum(np.abs(current[rows, order[:, 0]]), np.abs(current[rows, order[:, 2]]))
    np.testing.assert_allclose(np.abs(current[rows, phase]), largest, atol=1e-12)


def test_ddt_is_gdpwm_up_to_sixty_degrees_and_loses_less_beyond() -> None:
    lags = np.radians(np.linspace(-180.0, 180.0, 721))
    ddt, gdpwm = (switching_loss_factor(name, lags) for name in RIVALS[::-1])
    within = np.abs([folded(lag) for lag in lags]) <= math.pi / 3
    np.testing.assert_allclose(ddt[within], gdpwm[within], rtol=1e-12)
    beyond = np.abs([folded(lag) for lag in lags]) > math.radians(60.25)
    assert np.all(ddt[beyond] < gdpwm[beyond])
    fixed = [
        switching_loss_factor(name, lags)
        for name in MODULATORS
        if name not in {"ddt-gdpwm", "gdpwm"}
    ]
    assert np.all(
        ddt <= np.min(fixed, axis=0) + 1e-12
    )  # nothing that keeps one phase at a rail saves more
    for lag in np.radians([-59.0, -20.0, 1.0, 33.0, 59.0, 150.0]):
        theirs, its = (
            period_waveforms(
                name, 1.0, 0.0, math.cos(lag), -math.sin(lag), 3.0, angles=720
            ).modulation.clamped
            for name in RIVALS
        )
        np.testing.assert_array_equal(theirs, its)


def test_clamping_angle_follows_the_load_within_its_limits() -> None:
    degrees = np.degrees(
        clamping_angle(
            np.radians([-90.0, -40.0, -30.0, 0.0, 10.0, 30.0, 80.0, 180.0, 190.0, -150.0])
        )
    )
    assert degrees == pytest.approx(
        [0.0, 0.0, 0.0, 30.0, 40.0, 60.0, 60.0, 30.0, 40.0, 60.0], abs=1e-9
    )


def test_gdpwm_without_current_rests_as_dpwm1() -> None:
    angle = np.linspace(0.01, 6.2, 50)
    voltage = np.cos(angle[:, None] - np.array([0.0, 2.0, -2.0]) * math.pi / 3)
    phase, upper = resting_phase("gdpwm", voltage, np.zeros_like(voltage))
    for found, expected in zip(
        (phase, upper), resting_phase("dpwm1", voltage, voltage), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


def test_mean_shares_are_the_means_over_all_load_angles() -> None:
    lags = (np.arange(3600) + 0.5) * math.pi / 3600
    for name in RESTING:
        factor = switching_loss_factor(name, lags)
        if name in {"gdpwm", "ddt-gdpwm"}:
            assert switching_loss_factor(name, [-0.5, 0.0, 0.5]) == pytest.approx(
                3 * [MODULATORS[name].mean_loss_factor]
            )
        else:
            assert factor.mean() == pytest.approx(MODULATORS[name].mean_loss_factor, rel=1e-6)


@pytest.mark.parametrize("name", MODULATORS)
def test_commutations_are_those_of_the_phases_that_switch(name: ModulationName) -> None:
    voltage = 40.0 * np.array([phases_at(0.01 + 0.1 * k) for k in range(62)])
    duty = modulate(name, voltage, voltage, 100.0).duty
    switching = np.count_nonzero((duty > 0.0) & (duty < 1.0)) / duty.size
    assert switching == pytest.approx(2.0 / 3.0 if name in DISCONTINUOUS else 1.0)
    assert name in DISCONTINUOUS or np.all(
        switching_loss_factor(name, np.linspace(-3.0, 3.0, 9)) == 1.0
    )


def test_a_hundred_thousand_points_take_far_less_than_a_second() -> None:
    lags = np.linspace(-3.0, 3.0, 100_000)
    start = time.perf_counter()
    for name in MODULATORS:
        assert switching_loss_factor(name, lags).shape == (100_000,)
    assert time.perf_counter() - start < 3.0  # some 0.03 s for all twelve
