"""Losses of the bridge against closed forms and against brute-force quadrature of
independently written waveforms.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from modulators import CONTINUOUS, duties, rest
from scipy.integrate import quad
from scipy.optimize import brentq

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import (
    BridgeLoad,
    bridge_load,
    junction_temperature,
    required_device,
    resistance_factor,
    thermal_balance,
    thermal_gain,
)
from dqforge.machines.modulation.modulators import MODULATORS, linear_limit
from dqforge.machines.names import ModulationName

MOSFET = SwitchDevice(
    "mosfet", 9.5e-3, 0.8e-3, 0.5e-3, 200.0, 400.0, 0.306, reverse_recovery_energy=0.1e-3
)
IGBT = SwitchDevice(
    "igbt",
    4.0e-3,
    5e-3,
    6e-3,
    300.0,
    600.0,
    0.12,
    2e-3,
    on_voltage=0.9,
    diode_voltage=0.8,
    diode_resistance=3.0e-3,
)
V_DC = 500.0
THIRD = 2.0 * math.pi / 3.0
NAMES = tuple(MODULATORS)


def inverter(device: SwitchDevice, **changes: float) -> Inverter:
    return replace(Inverter(V_DC, 20e3, device, coolant_temperature=64.0), **changes)  # type: ignore[arg-type]


def load(
    device: SwitchDevice, name: ModulationName, v: float, i: float, lag: float, theta: float = 0.4
) -> BridgeLoad:
    """Return the loads for a voltage at the angle theta in the dq plane and a current that lags
    it.
    """
    v_d, v_q = v * math.cos(theta), v * math.sin(theta)
    return bridge_load(
        inverter(device), name, v_d, v_q, i * math.cos(theta - lag), i * math.sin(theta - lag)
    )


def phases_at(angle: float) -> list[float]:
    return [math.cos(angle), math.cos(angle - THIRD), math.cos(angle + THIRD)]


def averaged(
    name: ModulationName, v_amplitude: float, i_amplitude: float, lag: float, quantity: str
) -> float:
    """Integrate one quantity over the six sectors of a period by adaptive quadrature."""

    def integrand(angle: float) -> float:
        i = [i_amplitude * x for x in phases_at(angle - lag)]
        place, duty = rest(name, angle, lag), duties(name, v_amplitude / V_DC, angle, lag)
        clamped = None if place is None else place[0]
        total = 0.0
        for k in range(3):
            u = duty[k]
            share = u if i[k] > 0 else 1.0 - u
            total += {
                "unclamped": 0.0 if k == clamped else abs(i[k]),
                "transistor mean": share * abs(i[k]),
                "transistor square": share * i[k] ** 2,
                "diode mean": (1.0 - share) * abs(i[k]),
                "diode square": (1.0 - share) * i[k] ** 2,
            }[quantity]
        return total

    edges = [k * math.pi / 3 for k in range(7)]
    parts = [
        quad(integrand, a, b, limit=400, epsabs=1e-9, epsrel=1e-10)[0]
        for a, b in itertools.pairwise(edges)
    ]
    return float(sum(parts)) / (2.0 * math.pi)


def ddt_factor(lag: float) -> float:
    """Return the switching loss of DDT-GDPWM relative to SPWM.

    By hand: in the sector where v_a is the highest and v_c the lowest, angles alpha from 0 to 60
    degrees, the sum of the three |i| integrates to 2. The clamped current is |cos(alpha - lag)| or
    |cos(alpha - lag + 120 deg)|, whichever is larger. Up to 30 degrees of lag each phase is clamped
    in the 60 degrees around its own peak: 1/2. Up to 60 the clamping follows the voltage peak at
    the end of its allowed range, and only i_a is clamped: 1 - [sin(60 - lag) + sin(lag)] / 2. Up to
    90, i_c and i_a in turn: 1 - [sqrt 3 - sin(lag)] / 2. The loss depends on |cos|, so it is even
    in the lag and about 90 degrees.
    """
    lag = abs(math.remainder(lag, math.pi))
    if lag <= math.pi / 6:
        return 0.5
    if lag <= math.pi / 3:
        return 1.0 - 0.5 * (math.sin(math.pi / 3 - lag) + math.sin(lag))
    return 1.0 - 0.5 * (math.sqrt(3.0) - math.sin(lag))


@pytest.mark.parametrize("degrees", range(-180, 181, 15))
def test_switching_factor_of_ddt_by_hand_and_by_quadrature(degrees: int) -> None:
    lag = math.radians(degrees)
    factor = (
        load(MOSFET, "ddt-gdpwm", 150.0, 100.0, lag).switching
        / load(MOSFET, "spwm", 150.0, 100.0, lag).switching
    )
    assert factor == pytest.approx(ddt_factor(lag), rel=1e-10)
    assert averaged("ddt-gdpwm", 150.0, 1.0, lag, "unclamped") / (6.0 / math.pi) == pytest.approx(
        factor, rel=1e-7
    )


@settings(deadline=None)
@given(
    st.floats(-math.pi, math.pi),
    st.floats(-math.pi, math.pi),
    st.floats(0.1, 250.0),
    st.floats(0.1, 400.0),
)
def test_switching_factor_of_ddt_at_any_angle(lag: float, theta: float, v: float, i: float) -> None:
    """Independent of the amplitudes and of the place of the voltage in the dq plane."""
    ddt, spwm = (load(MOSFET, name, v, i, lag, theta).switching for name in ("ddt-gdpwm", "spwm"))
    assert ddt / spwm == pytest.approx(ddt_factor(lag), rel=1e-9)


@pytest.mark.parametrize("name", CONTINUOUS)
def test_switching_loss_of_continuous_modulators(name: ModulationName) -> None:
    """Paper 000 (11) for each of three legs: 2 sqrt2 / pi I_rms = 2/pi of the peak."""
    expected = 3 * 20e3 * 1.4e-3 * (2.0 / math.pi * 120.0 / 200.0) * (V_DC / 400.0)
    assert load(MOSFET, name, 200.0, 120.0, 0.8).switching == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_mosfet_conduction_is_paper_equation_10_in_all_three_legs(name: ModulationName) -> None:
    result = load(MOSFET, name, 180.0, 120.0, -1.2)
    assert result.resistive == pytest.approx(
        3.0 * 9.5e-3 * (120.0 / math.sqrt(2.0)) ** 2, rel=1e-12
    )
    assert result.threshold == 0.0


@pytest.mark.parametrize("lag_degrees", [0.0, 25.0, 77.0, 90.0, 140.0, 180.0, -50.0])
@pytest.mark.parametrize("v", [5.0, 140.0, 250.0])
def test_igbt_conduction_with_spwm_against_the_classical_closed_forms(
    v: float, lag_degrees: float
) -> None:
    """Per switch position, with M = 2 V / v_dc: V I (1/(2 pi) +- M cos/8) + r
    I^2 (1/8 +- M cos/(3 pi)).
    """
    i, lag, m = 110.0, math.radians(lag_degrees), 2.0 * v / V_DC
    in_phase = m * math.cos(lag)
    result = load(IGBT, "spwm", v, i, lag)
    resistive = 6.0 * IGBT.on_resistance * i**2 * (1.0 / 8.0 + in_phase / (3.0 * math.pi))
    threshold = 6.0 * (
        IGBT.on_voltage * i * (0.5 / math.pi + in_phase / 8.0)
        + IGBT.diode_voltage * i * (0.5 / math.pi - in_phase / 8.0)
        + IGBT.diode_resistance * i**2 * (1.0 / 8.0 - in_phase / (3.0 * math.pi))
    )
    assert result.resistive == pytest.approx(resistive, rel=1e-11)
    assert result.threshold == pytest.approx(threshold, rel=1e-11)


@pytest.mark.thinned
@pytest.mark.parametrize("name", [name for name in NAMES if name != "spwm"])
@pytest.mark.parametrize("lag", [0.2, 0.9, 1.5, 2.8, -0.6])
def test_igbt_conduction_against_quadrature(name: ModulationName, lag: float) -> None:
    v, i = 0.9 * linear_limit(name, V_DC), 90.0
    result = load(IGBT, name, v, i, lag)
    resistive = IGBT.on_resistance * averaged(name, v, i, lag, "transistor square")
    threshold = (
        IGBT.on_voltage * averaged(name, v, i, lag, "transistor mean")
        + IGBT.diode_voltage * averaged(name, v, i, lag, "diode mean")
        + IGBT.diode_resistance * averaged(name, v, i, lag, "diode square")
    )
    assert result.resistive == pytest.approx(resistive, rel=1e-6)
    assert result.threshold == pytest.approx(threshold, rel=1e-6)


@settings(deadline=None)
@given(
    st.sampled_from([MOSFET, IGBT]),
    st.sampled_from(NAMES),
    st.floats(0.0, 5e-3),
    st.floats(0.0, 250.0),
    st.floats(1.0, 120.0),
    st.floats(-math.pi, math.pi),
)
def test_junction_temperature_is_the_fixed_point_that_a_root_finder_finds(
    device: SwitchDevice, name: ModulationName, alpha: float, v: float, i: float, lag: float
) -> None:
    drive = inverter(replace(device, on_resistance_temperature_coefficient=alpha))
    loads = load(device, name, v, i, lag)
    result = thermal_balance(drive, loads)

    def imbalance(temperature: float) -> float:
        resistive = float(loads.resistive) * (1.0 + alpha * (temperature - 25.0))
        total = float(loads.threshold) + float(loads.switching) + resistive
        return temperature - 64.0 - device.thermal_resistance * total / 6.0

    root = brentq(imbalance, 64.0, 1e6, xtol=1e-10, rtol=1e-13)
    assert result.thermally_stable
    assert result.junction_temperature == pytest.approx(root, rel=1e-9)
    assert abs(float(result.thermal_residual)) <= 1e-9 * root


def test_junction_temperature_of_temperature_independent_losses() -> None:
    """0.306 K/W per switch position is 0.051 K per watt of the whole inverter (paper 000,
    Table 4).
    """
    assert junction_temperature(inverter(MOSFET), np.array([0.0, 1000.0])) == pytest.approx(
        [64.0, 115.0]
    )


def test_runaway_is_marked_and_its_neighbours_are_solved() -> None:
    drive = inverter(replace(MOSFET, on_resistance_temperature_coefficient=6e-3))
    # 0.306 / 6 * 6e-3 * P reaches one at P = 3268 W, that is at 478.9 A.
    loads = bridge_load(drive, "spwm", 0.0, 100.0, 0.0, np.array([100.0, 478.0, 480.0, 2000.0]))
    result = thermal_balance(drive, loads)
    assert result.thermally_stable.tolist() == [True, True, False, False]
    assert (thermal_gain(drive, loads) >= 1.0).tolist() == [False, False, True, True]
    assert np.isnan(result.junction_temperature).tolist() == [False, False, True, True]
    assert np.isnan(result.conduction).tolist() == [False, False, True, True]
    assert np.all(np.isfinite(result.switching))


def test_resistance_grows_linearly_from_25_degrees() -> None:
    device = replace(MOSFET, on_resistance_temperature_coefficient=5e-3)
    assert resistance_factor(device, np.array([25.0, 125.0])) == pytest.approx([1.0, 1.5])


@pytest.mark.thinned
@pytest.mark.parametrize("device", [MOSFET, IGBT], ids=["mosfet", "igbt"])
@pytest.mark.parametrize("name", NAMES)
def test_arrays_give_what_single_points_give(device: SwitchDevice, name: ModulationName) -> None:
    """Across the chunk boundary, in two axes, and broadcast."""
    rng = np.random.default_rng(7)
    v_d, v_q, i_d = rng.uniform(-120.0, 120.0, (3, 3, 2000))
    loads = bridge_load(inverter(device), name, v_d, v_q, i_d, 40.0)
    assert loads.threshold.shape == loads.resistive.shape == loads.switching.shape == (3, 2000)
    for index in [(0, 0), (1, 777), (2, 95), (2, 96), (2, 1999)]:
        one = bridge_load(inverter(device), name, v_d[index], v_q[index], i_d[index], 40.0)
        for field in ("threshold", "resistive", "switching"):
            assert getattr(one, field) == pytest.approx(getattr(loads, field)[index], rel=1e-13)


def test_no_points_give_no_losses() -> None:
    empty = np.zeros(0)
    assert bridge_load(
        inverter(MOSFET), "ddt-gdpwm", empty, empty, empty, empty
    ).switching.shape == (0,)


@pytest.mark.parametrize("name", NAMES)
def test_no_current_loses_nothing_and_no_voltage_is_no_fault(name: ModulationName) -> None:
    assert load(IGBT, name, 100.0, 0.0, 0.0).switching == 0.0
    assert np.isfinite(load(IGBT, name, 0.0, 100.0, 0.0).threshold)


def test_losses_without_a_device_are_refused() -> None:
    with pytest.raises(InputError, match="no device is given; add the device data"):
        required_device(Inverter(500.0, 1e4))
