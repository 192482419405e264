"""Limits over speed against textbook formulas, brute force and the phase equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, MOSFET, RELUCTANCE, SURFACE
from saturated import ArctanMachine

from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.losses.machine_budget import MachineLoss
from dqforge.optimizer.operating_points.characteristics import (
    characteristics,
    efficiency,
    envelope,
    envelope_speeds,
    limit_changes,
    limit_speed,
    loci,
    operating_map,
    voltage_limit,
)
from dqforge.optimizer.operating_points.mtpa_locus import Active, mtpa_locus
from dqforge.optimizer.operating_points.points import loss_coefficients

IDEAL_SURFACE = replace(SURFACE, r_s=0.0)
IDEAL_IPM = replace(IPM, r_s=0.0)


def test_surface_machine_has_the_textbook_speeds() -> None:
    """R = 0: base speed V/(p |psi|) at full q current, largest speed V/(p (psi - L I)),
    both in rad/s of the shaft.
    """
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
    "machine",
    [IPM, SURFACE, INVERSE_SALIENT, ArctanMachine()],
    ids=["ipm", "spm", "inverse", "saturated"],
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


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("machine", "v_max"),
    [(IPM, 288.0), (SURFACE, 100.0), (INVERSE_SALIENT, 150.0)],
    ids=["ipm", "spm", "inverse"],
)
def test_envelope_equals_brute_force(machine: ArctanMachine, v_max: float) -> None:
    figures = characteristics(machine, v_max)
    speeds = figures.base_speed * np.array([0.5, 1.0, 1.3, 1.8, 2.2])
    edge = envelope(machine, v_max, speeds)
    radius, angle = np.meshgrid(np.linspace(0.0, machine.i_max, 801), np.linspace(0.0, np.pi, 1601))
    i_d, i_q = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    psi_d, psi_q = machine.flux(i_d, i_q)
    torque = 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d)
    # Braking torque at a speed is positive torque at the opposite speed: the mirror image.
    for sign, torques in ((1.0, edge.points.torque), (-1.0, -edge.braking.torque)):
        for speed, found in zip(speeds, torques, strict=True):
            omega = sign * machine.pole_pairs * speed
            kept = (
                np.hypot(machine.r_s * i_d - omega * psi_q, machine.r_s * i_q + omega * psi_d)
                <= v_max
            )
            best = np.max(torque[kept])
            assert best <= found * (1.0 + 1e-9)
            assert found == pytest.approx(best, abs=5e-3 * figures.torque_max)
    np.testing.assert_allclose(edge.power, edge.points.torque * speeds)
    np.testing.assert_allclose(edge.braking_power, edge.braking.torque * speeds)
    within = speeds <= (machine.omega_m_max or np.inf)
    assert np.max(edge.power[within]) <= figures.power_max * (1.0 + 1e-9)


def test_largest_power_keeps_to_the_speed_of_the_mechanics() -> None:
    free, held = characteristics(replace(IPM, omega_m_max=None), 288.0), characteristics(IPM, 288.0)
    assert held.power_speed <= 942.478 < free.power_speed
    assert held.power_max < free.power_max
    # At the end of its range the power is that of one operating point there.
    at_end = envelope(IPM, 288.0, np.array([942.478])).power[0]
    assert held.power_max == pytest.approx(at_end, rel=1e-9)


def test_ideal_machine_has_the_textbook_power_over_speed() -> None:
    """R = 0, psi = L I: i_q = rho sqrt(1 - (rho/2I)^2), rho = V/(omega L),
    so that P tends to 3/2 V I for ever.
    """
    machine = replace(IDEAL_SURFACE, psi_pm=1e-3 * 50.0)
    figures = characteristics(machine, 100.0)
    speeds = figures.base_speed * np.array([1.5, 2.0, 5.0, 20.0])
    radius = 100.0 / (3.0 * speeds * 1e-3)
    expected = 1.5 * 100.0 * 50.0 * np.sqrt(1.0 - (radius / 100.0) ** 2)
    np.testing.assert_allclose(envelope(machine, 100.0, speeds).power, expected, rtol=1e-6)


def test_braking_equals_motoring_without_resistance_and_exceeds_it_with() -> None:
    speeds = np.array([300.0, 600.0])
    ideal, real = envelope(IDEAL_IPM, 288.0, speeds), envelope(IPM, 288.0, speeds)
    np.testing.assert_allclose(-ideal.braking.torque, ideal.points.torque, rtol=1e-9)
    assert -real.braking.torque[1] > real.points.torque[1]


def test_kinks_of_the_envelope_are_the_textbook_speeds() -> None:
    """R = 0, psi < L I: voltage binds from the base speed, MTPV (i_d = -psi/L) from V / (L
    sqrt(I^2 - (psi/L)^2)).
    """
    machine = replace(IDEAL_SURFACE, psi_pm=0.02)
    base = 100.0 / (3 * np.hypot(0.02, 0.05))
    touching = 100.0 / (3 * 1e-3 * np.sqrt(50.0**2 - 20.0**2))
    for sign in (1.0, -1.0):
        kinks = limit_changes(machine, 100.0, np.linspace(0.0, 2000.0, 101), 50.0, sign=sign)
        np.testing.assert_allclose(kinks, [base, touching], rtol=1e-6)
    speeds = envelope_speeds(machine, 100.0, 2000.0, 50.0, 21)
    assert np.all(np.diff(speeds) > 0.0)
    assert set(np.linspace(0.0, 2000.0, 21)) <= set(speeds)
    assert np.min(np.abs(speeds - base)) < 1e-3
    assert np.min(np.abs(speeds - touching)) < 1e-3
    assert limit_changes(machine, 100.0, np.linspace(0.0, 100.0, 11), 50.0).size == 0


def test_mtpv_locus_is_the_textbook_line() -> None:
    """R = 0: i_d = -psi/L of a surface machine, |psi_d| = |psi_q| of a reluctance machine,
    none with psi > L I.
    """
    surface = loci(replace(IDEAL_SURFACE, psi_pm=0.02), 100.0)
    assert surface.i_max == 50.0
    assert surface.mtpv.torque.size > 50
    assert np.all(surface.mtpv.active == Active.MTPV)
    np.testing.assert_allclose(surface.mtpv.i_d, -20.0, rtol=1e-6)
    assert np.max(np.hypot(surface.mtpv.i_d, surface.mtpv.i_q)) == pytest.approx(50.0, rel=1e-3)
    reluctance = loci(replace(RELUCTANCE, r_s=0.0), 300.0).mtpv
    np.testing.assert_allclose(
        np.abs(41.5e-3 * reluctance.i_d), np.abs(6.2e-3 * reluctance.i_q), rtol=1e-6
    )
    assert loci(IDEAL_IPM, 288.0).mtpv.torque.size == 0


@pytest.mark.parametrize(
    ("power", "loss", "share"),
    [
        (900.0, 100.0, 0.9),
        (-1000.0, 100.0, 0.9),
        (-100.0, 100.0, 0.0),
        (-50.0, 60.0, np.nan),
        (0.0, 5.0, np.nan),
    ],
)
def test_efficiency_is_power_out_over_power_in(power: float, loss: float, share: float) -> None:
    found = efficiency(np.array([power]), np.array([loss]))
    np.testing.assert_allclose(found, [share], rtol=1e-15)


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
    # At 120 N m and 300 rad/s nothing limits: copper, conduction and switching loss of
    # the MTPA current by hand.
    i_square = chart.points.i_d.reshape(6, 7)[3, 2] ** 2 + chart.points.i_q.reshape(6, 7)[3, 2] ** 2
    switching = 3 * 100e3 * 1.72e-3 * (2 / np.pi) * np.sqrt(i_square) / 206.5
    assert chart.loss[3, 2] == pytest.approx(1.5 * (2e-3 + 9.5e-3) * i_square + switching, rel=1e-6)
    bare = operating_map(IPM, replace(inverter, device=None), limit, torque, speed, 283.0)
    assert not bare.with_inverter
    assert bare.loss[3, 2] == pytest.approx(1.5 * 2e-3 * i_square)


def test_map_of_all_four_quadrants_balances_its_power() -> None:
    """Electrical power 3/2 (v_d i_d + v_q i_q) is mechanical power plus copper loss,
    and eta their ratio.
    """
    inverter = Inverter(500.0, 100e3, None)
    limit = voltage_limit(inverter, "svpwm")
    torque, speed = np.linspace(-150.0, 150.0, 6), np.linspace(-600.0, 600.0, 6)
    chart = operating_map(IPM, inverter, limit, torque, speed, 283.0)
    points = chart.points
    psi_d, psi_q = IPM.flux(points.i_d, points.i_q)
    omega = 4 * points.omega_m
    v_d, v_q = 2e-3 * points.i_d - omega * psi_q, 2e-3 * points.i_q + omega * psi_d
    electrical = 1.5 * (v_d * points.i_d + v_q * points.i_q)
    power = points.torque * points.omega_m
    expected = np.where(power > 0.0, power / electrical, electrical / power)
    reached = points.reached & np.isfinite(chart.efficiency.ravel())
    assert np.count_nonzero(power[reached] < 0.0) > 10
    np.testing.assert_allclose(chart.efficiency.ravel()[reached], expected[reached], rtol=1e-10)
    np.testing.assert_allclose(electrical, power + chart.loss.ravel(), rtol=1e-10, atol=1e-6)


@pytest.mark.parametrize("machine", [IPM, ArctanMachine()], ids=["ipm", "saturated"])
def test_map_of_least_total_loss_loses_no_more_anywhere(machine: ArctanMachine) -> None:
    inverter = Inverter(500.0, 100e3, MOSFET, 64.0)
    limit, extra = voltage_limit(inverter, "svpwm"), MachineLoss(hysteresis=5.0, eddy=0.05)
    torque, speed = (
        np.linspace(5.0, 0.5 * characteristics(machine, 288.0).torque_max, 7),
        np.linspace(50.0, 700.0, 9),
    )
    total = loss_coefficients(machine, speed, inverter, extra=extra)
    least = operating_map(
        machine, inverter, limit, torque, speed, machine.i_max, loss=total, extra=extra
    )
    copper = operating_map(machine, inverter, limit, torque, speed, machine.i_max, extra=extra)
    assert np.max(least.points.kkt_residual) < 1e-8
    both = (least.points.reached & copper.points.reached).reshape(least.loss.shape)
    assert np.all(least.loss[both] <= copper.loss[both] * (1.0 + 1e-12))
    assert np.min((least.loss / copper.loss)[both]) < 0.99
