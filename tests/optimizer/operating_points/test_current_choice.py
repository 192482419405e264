"""Currents of a strategy for any machine: saturated, and at a speed,
against scans and against the machine itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, RELUCTANCE, SURFACE
from saturated import ArctanMachine

from dqforge.machines.design.catalogue import load
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, ScaledMachines
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.optimizer.current_reference.fit import fit_reference, possible_forms
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint
from dqforge.optimizer.operating_points.solve import solve_curves

SATURATED = ArctanMachine()
FAST = SpeedPoint(750.0, 280.0)


def test_saturated_mtpa_has_the_torque_and_no_scanned_angle_makes_more() -> None:
    choice = CurrentChoice(SATURATED, "mtpa", 0.8 * SATURATED.i_max)
    torque = np.linspace(0.0, choice.largest_torque(), 9)[1:]
    points = choice.points(torque)
    np.testing.assert_allclose(points.torque_residual, 0.0, atol=1e-10)
    np.testing.assert_allclose(points.stationarity, 0.0, atol=1e-8)
    assert not points.limited.any()
    assert np.hypot(points.i_d, points.i_q)[-1] == pytest.approx(0.8 * SATURATED.i_max, rel=1e-9)
    angle = np.linspace(0.0, np.pi, 7201)
    size = np.hypot(points.i_d, points.i_q)[:, np.newaxis]
    scan = SATURATED.torque(size * np.cos(angle), size * np.sin(angle))
    assert np.all(np.max(scan, axis=1) <= torque * (1.0 + 1e-9))


def test_saturated_id0_has_the_torque_without_d_current() -> None:
    choice = CurrentChoice(SATURATED, "id0", SATURATED.i_max)
    torque = choice.largest_torque() * np.array([-1.0, -0.3, 0.0, 0.5, 1.0])
    points = choice.points(torque)
    np.testing.assert_array_equal(points.i_d, 0.0)
    np.testing.assert_allclose(
        SATURATED.torque(points.i_d, points.i_q), torque, atol=1e-10 * torque[-1]
    )


def test_at_a_speed_the_voltage_limit_holds_and_a_scan_finds_no_less_current() -> None:
    choice = CurrentChoice(IPM, "mtpa", IPM.i_max, FAST)
    torque = np.linspace(0.0, choice.largest_torque(), 7)
    i_d, i_q = choice.currents(torque)
    omega_e = np.full_like(i_d, IPM.pole_pairs * FAST.omega_m)
    assert np.max(np.hypot(*IPM.voltage(i_d, i_q, omega_e))) <= FAST.v_max * (1.0 + 1e-9)
    np.testing.assert_allclose(IPM.torque(i_d, i_q), torque, atol=1e-9 * torque[-1])
    assert i_d[0] < -10.0  # the field is weakened without any torque
    # i_q of each torque over a fine range of i_d; of those within the voltage limit
    # none has a smaller current.
    scan = np.linspace(-IPM.i_max, 0.0, 20_001)
    beside = torque[:-1, np.newaxis] / IPM.torque(scan, np.ones_like(scan))
    volts = np.hypot(
        *IPM.voltage(np.broadcast_to(scan, beside.shape), beside, np.full_like(beside, omega_e[0]))
    )
    size = np.where(volts <= FAST.v_max, np.hypot(scan, beside), np.inf)
    found = np.hypot(i_d, i_q)[:-1]
    assert np.all(np.min(size, axis=1) >= found * (1.0 - 1e-9))
    np.testing.assert_allclose(np.min(size, axis=1), found, atol=0.1)


@pytest.mark.parametrize(
    "machine", [SATURATED, RELUCTANCE], ids=["saturated", "reluctance at a speed"]
)
def test_splines_for_the_search_lie_on_the_exact_curves(machine: Machine) -> None:
    speed = SpeedPoint(60.0, 150.0) if machine is RELUCTANCE else None
    choice = CurrentChoice(machine, "mtpa", machine.i_max, speed)
    end = choice.largest_torque()
    torque = end * np.random.default_rng(2).uniform(0.0, 1.0, 400)
    curves = choice.curves(end)
    for axis, exact in zip("dq", choice.currents(torque), strict=True):
        # At the speed the curves have kinks, between whose neighbours a spline swings.
        np.testing.assert_allclose(
            curves[axis](torque), exact, atol=(2e-3 if speed else 1e-6) * machine.i_max
        )


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("machine", "speed"),
    [
        (SATURATED, None),
        (SATURATED, SpeedPoint(200.0, 120.0)),
        (IPM, FAST),
        (SURFACE, SpeedPoint(800.0, 220.0)),
    ],
    ids=["saturated", "saturated weakened", "ipm weakened", "surface weakened"],
)
def test_references_reach_what_their_errors_say(machine: Machine, speed: SpeedPoint | None) -> None:
    choice = CurrentChoice(machine, "mtpa", machine.i_max, speed)
    fit = fit_reference(choice, FitSettings(form="polynomial", degree=4, segments=3))
    assert fit.errors.torque_relative < 0.01
    torque = np.linspace(0.0, fit.torque_max, 1001).astype(np.float32)
    i_d, i_q = (np.asarray(current, dtype=np.float64) for current in fit.reference.currents(torque))
    error = np.abs(machine.torque(i_d, i_q) - torque)
    assert np.max(error) <= fit.errors.torque * (1.0 + 0.02)
    exact_d, exact_q = choice.currents(torque.astype(np.float64))
    assert np.max(np.abs(i_d - exact_d)) <= fit.errors.i_d * (1.0 + 0.02)
    assert np.max(np.abs(i_q - exact_q)) <= fit.errors.i_q * (1.0 + 0.02)
    assert fit.errors.step_at_zero < 1e-4
    if speed is None:
        assert fit.errors.voltage_excess is None
    else:
        volts = np.hypot(
            *machine.voltage(i_d, i_q, np.full_like(i_d, machine.pole_pairs * speed.omega_m))
        )
        assert fit.errors.voltage_excess is not None
        assert np.max(volts) / speed.v_max - 1.0 <= fit.errors.voltage_excess + 1e-4
        assert fit.errors.voltage_excess < 0.02


def test_torque_exact_stays_exact_where_the_field_is_weakened() -> None:
    fit = fit_reference(
        CurrentChoice(IPM, "mtpa", IPM.i_max, FAST), FitSettings(form="torque-exact")
    )
    assert fit.errors.torque_relative < 1e-6


def test_what_does_not_suit_is_refused() -> None:
    with pytest.raises(InputError, match="torque-exact needs constant inductances"):
        fit_reference(
            CurrentChoice(SATURATED, "mtpa", SATURATED.i_max), FitSettings(form="torque-exact")
        )
    with pytest.raises(InputError, match="closed-form follows the MTPA locus"):
        fit_reference(CurrentChoice(IPM, "mtpa", IPM.i_max, FAST), FitSettings(form="closed-form"))
    with pytest.raises(InputError, match="id0 cannot weaken the field"):
        CurrentChoice(IPM, "id0", IPM.i_max, FAST)
    with pytest.raises(NoSolutionError, match="no current within 50 A keeps the voltage limit"):
        CurrentChoice(SURFACE, "mtpa", SURFACE.i_max, SpeedPoint(8000.0, 100.0)).largest_torque()
    with pytest.raises(NoSolutionError, match="280 V at 750 rad/s give at most"):
        CurrentChoice(IPM, "mtpa", IPM.i_max, FAST).require(400.0, "fit.max_torque")
    assert possible_forms(CurrentChoice(RELUCTANCE, "mtpa", 22.0, SpeedPoint(60.0, 150.0))) == (
        "polynomial",
    )


@pytest.mark.parametrize("magnet", [1.0, 0.01])
def test_a_map_of_hardly_any_magnets_has_curves(magnet: float) -> None:
    """At i_d = 0 such a machine makes no torque of the grid: there is nothing to compare with."""
    design = load("baldor-pmsyrm-5k6")
    assert isinstance(design.machine, SaturatedMachine)
    drawn = {"magnet": np.array([magnet])}
    machine = ScaledMachines.varied(design.machine, 1, drawn).machine(0)
    curves = solve_curves(replace(design, machine=machine))
    assert curves.chosen.torque[-1] > 5.0
    assert (curves.saving is None) == (magnet < 1.0)
