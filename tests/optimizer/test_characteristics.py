"""Limits over speed against textbook formulas, brute force and the phase equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, MOSFET, RELUCTANCE, SURFACE
from saturated import ArctanMachine

from dqforge.machines.inverter import Inverter
from dqforge.optimizer.characteristics import (
    characteristics,
    envelope,
    limit_speed,
    operating_map,
    voltage_limit,
)
from dqforge.optimizer.mtpa_locus import mtpa_locus

IDEAL_SURFACE = replace(SURFACE, r_s=0.0)
IDEAL_IPM = replace(IPM, r_s=0.0)


def test_surface_machine_has_the_textbook_speeds() -> None:
    """R = 0: base speed V/(p |psi|) at full q current, largest speed V/(p (psi - L I)), both in rad/s of the shaft."""
    figures = characteristics(IDEAL_SURFACE, 100.0)
    psi, inductive = 0.1, 1e-3 * 50.0
    assert figures.base_speed == pytest.approx(100.0 / (3 * np.hypot(psi, inductive)), rel=1e-12)
    assert figures.speed_max == pytest.approx(100.0 / (3 * (psi - inductive)), rel=1e-5)
    assert figures.characteristic_current == pytest.approx(psi / 1e-3)
    assert figures.torque_max == pytest.approx(1.5 * 3 * psi * 50.0)


def test_interior_machine_has_the_textbook_base_speed() -> None:
    locus = mtpa_locus(IDEAL_IPM, 283.0)
    i_d, i_q = locus.i_d[-1], locus.i_q[-1]
    flux = np.hypot(0.1049 + 350e-6 * i_d, 592e-6 * i_q)
    figures = characteristics(IDEAL_IPM, 288.0)
    assert figures.base_speed == pytest.approx(288.0 / (4 * flux), rel=1e-9)
    assert figures.characteristic_current == pytest.approx(0.1049 / 350e-6)


def test_machines_that_reach_zero_flux_have_no_largest_speed() -> None:
    assert characteristics(INVERSE_SALIENT, 150.0).speed_max is None
    figures = characteristics(RELUCTANCE, 300.0)
    assert figures.speed_max is None
    assert figures.characteristic_current is None


@pytest.mark.parametrize(
    "machine", [IPM, SURFACE, INVERSE_SALIENT, ArctanMachine()], ids=["ipm", "spm", "inverse", "saturated"]
)
def test_limit_speed_takes_exactly_the_voltage(machine: ArctanMachine) -> None:
    """The voltage at the speed found, recomputed from the dq equations with the resistance drop."""
    locus = mtpa_locus(machine, machine.i_max)
    omega = limit_speed(machine, locus.i_d, locus.i_q, 120.0) * machine.pole_pairs
    psi_d, psi_q = machine.flux(locus.i_d, locus.i_q)
    v_d, v_q = machine.r_s * locus.i_d - omega * psi_q, machine.r_s * locus.i_q + omega * psi_d
    np.testing.assert_allclose(np.hypot(v_d, v_q), 120.0, rtol=1e-12)


def test_drop_alone_beyond_the_limit_leaves_no_speed() -> None:
    machine = replace(SURFACE, r_s=10.0)
    assert limit_speed(machine, np.zeros(1), np.full(1, 50.0), 100.0)[0] == 0.0


@pytest.mark.parametrize(
    ("machine", "v_max"), [(IPM, 288.0), (SURFACE, 100.0), (INVERSE_SALIENT, 150.0)], ids=["ipm", "spm", "inverse"]
)
def test_envelope_equals_brute_force(machine: ArctanMachine, v_max: float) -> None:
    figures = characteristics(machine, v_max)
    speeds = figures.base_speed * np.array([0.5, 1.0, 1.3, 1.8, 2.2])
    edge = envelope(machine, v_max, speeds)
    radius, angle = np.meshgrid(np.linspace(0.0, machine.i_max, 801), np.linspace(0.0, np.pi, 1601))
    i_d, i_q = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    psi_d, psi_q = machine.flux(i_d, i_q)
    torque = 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
    for speed, found in zip(speeds, edge.points.torque, strict=True):
        omega = machine.pole_pairs * speed
        kept = np.hypot(machine.r_s * i_d - omega * psi_q, machine.r_s * i_q + omega * psi_d) <= v_max
        best = np.max(torque[kept])
        assert best <= found * (1.0 + 1e-9)
        assert found == pytest.approx(best, abs=5e-3 * figures.torque_max)
    np.testing.assert_allclose(edge.power, edge.points.torque * speeds)
    assert np.max(edge.power) <= figures.power_max * (1.0 + 1e-3)


def test_field_weakening_begins_at_the_base_speed_for_most_torque() -> None:
    edge = envelope(IPM, 288.0, np.linspace(0.0, 900.0, 5))
    figures = characteristics(IPM, 288.0)
    assert edge.weakening_speed[-1] == pytest.approx(figures.base_speed, rel=1e-12)
    assert np.all(np.diff(edge.weakening_speed) < 0.0)
    # Without current the back-EMF alone takes the voltage: omega = V / (p psi).
    assert edge.weakening_speed[0] == pytest.approx(288.0 / (4 * 0.1049), rel=1e-3)


def test_map_has_the_efficiency_of_its_losses() -> None:
    inverter = Inverter(500.0, 100e3, MOSFET, 64.0)
    limit = voltage_limit(inverter, "svpwm", 0.05)
    assert limit.v_max == pytest.approx(0.95 * 500.0 / np.sqrt(3.0))
    torque, speed = np.linspace(0.0, 200.0, 6), np.linspace(0.0, 900.0, 7)
    chart = operating_map(IPM, inverter, limit, torque, speed, 283.0)
    assert chart.efficiency.shape == chart.loss.shape == (6, 7)
    assert np.all(np.isnan(chart.efficiency[0]))  # no torque, no power
    assert np.all(np.isnan(chart.efficiency[:, 0]))  # no speed, no power
    power = 120.0 * 300.0
    assert chart.efficiency[3, 2] == pytest.approx(power / (power + chart.loss[3, 2]))
    # At 120 N m and 300 rad/s nothing limits: copper, conduction and switching loss of the MTPA current by hand.
    i_square = chart.points.i_d.reshape(6, 7)[3, 2] ** 2 + chart.points.i_q.reshape(6, 7)[3, 2] ** 2
    switching = 3 * 100e3 * 1.72e-3 * (2 / np.pi) * np.sqrt(i_square) / 206.5
    assert chart.loss[3, 2] == pytest.approx(1.5 * (2e-3 + 9.5e-3) * i_square + switching, rel=1e-6)
    bare = operating_map(IPM, replace(inverter, device=None), limit, torque, speed, 283.0)
    assert not bare.with_inverter
    assert bare.loss[3, 2] == pytest.approx(1.5 * 2e-3 * i_square)
