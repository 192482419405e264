"""Averages of a bridge with device tables against brute force over time, closed forms,
and a switched simulation.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices import catalogue as device_catalogue
from dqforge.machines.devices.inverter import DeviceModel, Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.bridge_tables import (
    BridgeAverages,
    BridgeTables,
    bridge_averages,
    bridge_tables,
    junction_balance,
)
from dqforge.machines.modulation.modulators import MODULATORS, modulate
from dqforge.machines.names import ModulationName
from dqforge.machines.plants.current_feedback import simulate_period
from dqforge.machines.transforms import dq_to_phases

V_DC = 600.0
IGBT = SwitchDevice(
    "igbt",
    4e-3,
    20e-3,
    25e-3,
    300.0,
    600.0,
    0.25,
    reverse_recovery_energy=10e-3,
    on_voltage=0.9,
    diode_voltage=1.1,
    diode_resistance=3e-3,
)
MACHINE = LinearMachine(pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)


def with_model(name: str, resistance: float = 0.3) -> tuple[Inverter, DeviceModel]:
    model = device_catalogue.load(name)
    device = model.switch_device(150.0 if model.kind == "igbt" else 30.0, V_DC, 100.0, resistance)
    return Inverter(V_DC, 10e3, device, 60.0, dead_time=1e-6, device_model=model), model


def constant(device: SwitchDevice = IGBT) -> BridgeTables:
    return bridge_tables(Inverter(V_DC, 10e3, device, 60.0))


def averages(
    tables: BridgeTables, name: ModulationName, v: float, i: float, lag: float
) -> BridgeAverages:
    voltage, current = np.array([[v], [0.0]]), i * np.array([[math.cos(lag)], [-math.sin(lag)]])
    return bridge_averages(tables, name, voltage, current, V_DC)


@pytest.mark.parametrize("lag", [0.0, 0.6, 1.3, 2.4, -0.8])
def test_igbt_conduction_with_spwm_against_the_classical_closed_forms(lag: float) -> None:
    """Per position with M = 2 V / v_dc: V I (1/(2 pi) +- M cos/8) + r I^2 (1/8 +- M cos/(3 pi))."""
    v, i = 220.0, 180.0
    m = 2.0 * v / V_DC * math.cos(lag)
    found = averages(constant(), "spwm", v, i, lag)
    transistor = 0.9 * i * (0.5 / math.pi + m / 8.0) + 4e-3 * i**2 * (0.125 + m / (3.0 * math.pi))
    diode = 1.1 * i * (0.5 / math.pi - m / 8.0) + 3e-3 * i**2 * (0.125 - m / (3.0 * math.pi))
    assert found.conduction[0, 0, 0, 0] == pytest.approx(transistor + diode, rel=1e-11)
    assert found.switching[1, 0, 0, 0] == pytest.approx(55e-3 * i / 300.0 / math.pi, rel=1e-11)


def brute_force(
    model: DeviceModel, name: ModulationName, v: float, i: float, lag: float, temperature: float
) -> dict[str, float]:
    """Average of what each position loses, instant by instant over a period.

    From the model's own look-ups.
    """
    theta: FloatArray = np.linspace(0.0, 2.0 * math.pi, 72_000, endpoint=False) + math.pi / 72_000
    voltage = dq_to_phases(np.full(theta.size, v), np.zeros(theta.size), theta)
    current = dq_to_phases(
        np.full(theta.size, i * math.cos(lag)), np.full(theta.size, -i * math.sin(lag)), theta
    )
    made = modulate(name, voltage, current, V_DC)
    u, a, free = made.duty[:, 0], current[:, 0], ~made.clamped[:, 0]
    on = model.on_voltage(a, temperature).value * np.abs(a)
    diode = on if model.diode is None else model.diode_voltage(a, temperature).value * np.abs(a)
    hard = (
        model.turn_on_energy(a, V_DC, temperature).value
        + model.turn_off_energy(a, V_DC, temperature).value
    )
    soft = model.recovery_energy(a, V_DC, temperature).value
    ahead = a >= 0.0
    back = on if model.kind == "mosfet" else diode
    parts = {
        "upper transistor": np.mean(u * ahead * on)
        + (np.mean(u * ~ahead * on) if model.kind == "mosfet" else 0.0),
        "upper diode": 0.0 if model.kind == "mosfet" else np.mean(u * ~ahead * diode),
        "lower": np.mean((1.0 - u) * np.where(ahead, back, on)),
        "upper events": np.mean(free * ahead * hard),
        "upper recoveries": np.mean(free * ~ahead * soft),
        "dead": np.mean(2.0 * free * ~ahead * (diode - on)) if model.kind == "mosfet" else 0.0,
    }
    return {name: float(value) for name, value in parts.items()}


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["spwm", "svpwm", "dpwm1", "dpwm3", "dpwmmin", "ddt-gdpwm"])
@pytest.mark.parametrize("device", ["sirectifier-sii400s12", "wolfspeed-c2m0045170d"])
def test_averages_against_brute_force(name: ModulationName, device: str) -> None:
    inverter, model = with_model(device)
    tables = bridge_tables(inverter)
    v, i, lag = 290.0, 210.0 if model.kind == "igbt" else 60.0, 0.7
    found = averages(tables, name, v, i, lag)
    for k, temperature in enumerate(tables.temperatures):
        truth = brute_force(model, name, v, i, lag, float(temperature))
        conduction = found.conduction[:, :, k, 0]
        upper = truth["upper transistor"] + truth["upper diode"]
        assert np.sum(conduction[0]) == pytest.approx(upper, rel=2e-4)
        assert np.sum(conduction[1]) == pytest.approx(truth["lower"], rel=2e-4)
        if tables.separate_diode:
            assert conduction[0, 1] == pytest.approx(truth["upper diode"], rel=2e-4)
            assert found.switching[0, 1, k, 0] == pytest.approx(truth["upper recoveries"], rel=2e-4)
        events = truth["upper events"] + truth["upper recoveries"]
        assert np.sum(found.switching[0, :, k, 0]) == pytest.approx(events, rel=2e-4)
        assert np.sum(found.dead[0, :, k, 0]) == pytest.approx(truth["dead"], rel=2e-4, abs=1e-12)


@pytest.mark.parametrize("name", MODULATORS)
@pytest.mark.parametrize("lag", [0.0, 0.8, 2.0])
def test_capacitor_current_against_kolar(name: ModulationName, lag: float) -> None:
    """I_C = I sqrt(2 M (sqrt3/(4 pi) + cos^2 (sqrt3/pi - 9/16 M))), I r.m.s., M = 2 V / v_dc.

    Any zero sequence.
    """
    v, i = 240.0, 100.0
    m, cos = 2.0 * v / V_DC, math.cos(lag)
    found = averages(constant(), name, v, i, lag)
    square = float(found.dc_square[0] - found.dc_current[0] ** 2)
    factor = (
        2.0
        * m
        * (math.sqrt(3) / (4.0 * math.pi) + cos**2 * (math.sqrt(3) / math.pi - 9.0 / 16.0 * m))
    )
    assert math.sqrt(square) == pytest.approx(i / math.sqrt(2) * math.sqrt(factor), rel=1e-9)
    assert V_DC * float(found.dc_current[0]) == pytest.approx(
        1.5 * v * i * cos, rel=1e-11, abs=1e-9
    )


@pytest.mark.slow
@given(st.floats(0.0, 400.0), st.floats(0.0, 2e4))
def test_separate_junctions_settle_where_a_root_finder_finds_them(
    i: float, frequency: float
) -> None:
    inverter, _ = with_model("sirectifier-sii400s12", 0.2)
    tables = bridge_tables(inverter)
    assert tables.separate_diode
    found = averages(tables, "dpwmmin", 200.0, i, 0.5)
    loss = found.conduction + found.switching * frequency
    balance = junction_balance(tables, loss)
    own, diode, shared = tables.resistances
    assert own + shared == pytest.approx(0.2)
    for side in range(2):

        def at(j: int, t: float, side: int = side) -> float:
            low, high = loss[side, j, :, 0]
            return float(low + (high - low) * (t - 25.0) / 100.0)

        def warm(t: float) -> float:
            """Transistor's own balance with the diode solved for inside."""
            cold = brentq(
                lambda d: d - 60.0 - diode * at(1, d) - shared * (at(1, d) + at(0, t)),
                -1e5,
                1e5,
                xtol=1e-11,
            )
            return t - 60.0 - own * at(0, t) - shared * (at(0, t) + at(1, cold))

        root = brentq(warm, 0.0, 1e5, xtol=1e-11)
        assert balance.steady[0]
        assert balance.temperature[side, 0, 0] == pytest.approx(root, abs=1e-7)
    assert np.max(np.abs(balance.residual)) < 1e-7


@pytest.mark.parametrize("separate", [False, True])
def test_runaway_is_marked_at_the_very_current(separate: bool) -> None:
    """R dP/dT = 1: conduction 3/2 R_on alpha |i|^2 over six positions, with 0.3 K/W to the
    coolant.
    """
    device = SwitchDevice(
        "mosfet", 10e-3, 0.0, 0.0, 100.0, 600.0, 0.3, on_resistance_temperature_coefficient=5e-3
    )
    tables = constant(device)
    if separate:
        tables = replace(tables, separate_diode=True, resistances=(0.1, 0.1, 0.2))
    limit = math.sqrt(6.0 / (0.3 * 1.5 * 10e-3 * 5e-3))
    for i, steady in ((0.999 * limit, True), (1.001 * limit, False)):
        found = averages(tables, "svpwm", 100.0, i, 0.3)
        balance = junction_balance(tables, found.conduction)
        assert bool(balance.steady[0]) is steady
        assert np.all(np.isnan(balance.temperature[..., 0])) == (not steady)


def test_coldest_balance_is_taken_of_several() -> None:
    """P rises, falls and rises again over T: three balances, of which a junction that
    warms up meets the first.
    """
    knots = np.array([0.0, 50.0, 60.0, 100.0, 101.0, 200.0])
    tables = replace(
        constant(), temperatures=knots, resistances=(1.0, 0.0), coolant_temperature=20.0
    )
    loss = np.array([10.0, 10.0, 10.0, 10.0, 150.0, 150.0]).reshape(1, 1, -1, 1).repeat(2, axis=0)
    balance = junction_balance(tables, loss)
    assert balance.temperature[:, 0, 0].tolist() == [30.0, 30.0]


def cool(inverter: Inverter) -> Inverter:
    """Everything at the coolant temperature."""
    assert inverter.device is not None
    return replace(
        inverter, device=replace(inverter.device, thermal_resistance=1e-9), coolant_temperature=80.0
    )


@pytest.mark.thinned
@pytest.mark.parametrize("name", MODULATORS)
def test_averages_against_a_switched_simulation(name: ModulationName) -> None:
    """One electrical period of 960 carrier periods: each loss to 0.5 %, currents to 0.1 %,
    its own balance exact.
    """
    inverter, _ = with_model("sirectifier-sii400s12")
    tables = bridge_tables(cool(inverter))
    i_d, i_q, omega_m, carriers = -80.0, 120.0, 250.0, 960
    v_d, v_q = MACHINE.voltage(np.array([i_d]), np.array([i_q]), np.array([4 * omega_m]))
    frequency = carriers * 4 * omega_m / (2.0 * math.pi)
    stiffness = np.diag([1.0 / MACHINE.l_d, 1.0 / MACHINE.l_q])[None]
    found = bridge_averages(
        tables,
        name,
        np.stack([v_d, v_q]),
        np.array([[i_d], [i_q]]),
        V_DC,
        np.asarray(stiffness, dtype=np.float64),
    )
    made = simulate_period(
        MACHINE,
        tables,
        name,
        (float(v_d[0]), float(v_q[0])),
        (i_d, i_q),
        omega_m,
        v_dc=V_DC,
        carrier_ratio=carriers,
        junction_temperature=80.0,
    )
    assert made.link_power == pytest.approx(made.copper + made.shaft_power, rel=1e-12)
    assert list(made.current) == pytest.approx([i_d, i_q], rel=1e-3)

    def mean(part: FloatArray) -> float:
        warm = part[:, :, 0] + (80.0 - 25.0) / 100.0 * (part[:, :, 1] - part[:, :, 0])
        return 3.0 * float(np.sum(warm))

    assert made.conduction == pytest.approx(mean(found.conduction), rel=1e-3)
    assert made.switching == pytest.approx(frequency * mean(found.switching), rel=5e-3)
    assert made.link_power == pytest.approx(V_DC * float(found.dc_current[0]), rel=1e-3)
    capacitor = math.sqrt(float(found.dc_square[0] - found.dc_current[0] ** 2))
    assert made.capacitor_current == pytest.approx(capacitor, rel=1e-3)
    assert made.ripple_current == pytest.approx(
        math.sqrt(float(found.ripple[0])) * V_DC / frequency, rel=1e-3
    )
