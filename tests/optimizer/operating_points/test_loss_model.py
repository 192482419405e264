"""Loss coefficients against the loss budget, which averages waveforms,
and against sums written out by hand.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, MOSFET, SURFACE
from saturated import ArctanMachine
from simple_losses import loss_budget

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import MachineLoss
from dqforge.machines.names import ModulationName
from dqforge.optimizer.operating_points.mtpa_locus import LossCoefficients
from dqforge.optimizer.operating_points.points import (
    drive_losses,
    loss_coefficients,
    optimal_points,
)

INVERTER = Inverter(500.0, 100e3, MOSFET, 64.0)
EQUAL_IGBT = SwitchDevice(
    "igbt",
    on_resistance=3e-3,
    turn_on_energy=4e-3,
    turn_off_energy=5e-3,
    reference_current=300.0,
    reference_voltage=600.0,
    thermal_resistance=0.1,
    reverse_recovery_energy=2e-3,
    on_voltage=0.9,
    diode_voltage=0.9,
    diode_resistance=3e-3,
)
EXTRA = MachineLoss(ac_copper=4e-7, hysteresis=3.0, eddy=0.02)


def evaluated(
    coefficients: LossCoefficients, machine: Machine, i_d: FloatArray, i_q: FloatArray
) -> FloatArray:
    psi_d, psi_q = machine.flux(i_d, i_q)
    square = i_d**2 + i_q**2
    iron = coefficients.iron * (psi_d**2 + psi_q**2)
    return np.asarray(coefficients.square * square + coefficients.linear * np.sqrt(square) + iron)


def random_points(count: int = 200) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Currents and speeds whose voltage lies in the linear range of every modulator at 500 V."""
    generator = np.random.default_rng(4)
    i_d, i_q = generator.uniform(-150.0, 0.0, count), generator.uniform(-150.0, 150.0, count)
    return i_d, i_q, generator.uniform(-450.0, 450.0, count)


@pytest.mark.parametrize("modulation", ["spwm", "svpwm"])
@pytest.mark.parametrize("device", [MOSFET, EQUAL_IGBT], ids=["mosfet", "equal igbt"])
def test_continuous_modulators_have_the_loss_of_the_budget(
    device: SwitchDevice, modulation: ModulationName
) -> None:
    inverter = replace(INVERTER, device=device)
    i_d, i_q, omega = random_points()
    budget = loss_budget(IPM, inverter, i_d, i_q, omega, modulation)
    assert np.all(budget.linear)
    found = evaluated(loss_coefficients(IPM, omega, inverter, modulation=modulation), IPM, i_d, i_q)
    np.testing.assert_allclose(found, budget.total, rtol=1e-12)


def test_on_resistance_is_taken_at_the_junction_temperature() -> None:
    """A coolant-cooled switch without thermal resistance has the coolant's
    temperature in the budget.
    """
    device = replace(MOSFET, on_resistance_temperature_coefficient=4e-3, thermal_resistance=1e-12)
    inverter = replace(INVERTER, device=device, coolant_temperature=110.0)
    i_d, i_q, omega = random_points()
    coefficients = loss_coefficients(IPM, omega, inverter, junction_temperature=110.0)
    budget = loss_budget(IPM, inverter, i_d, i_q, omega, "svpwm")
    np.testing.assert_allclose(evaluated(coefficients, IPM, i_d, i_q), budget.total, rtol=1e-9)


def test_discontinuous_modulator_switches_half_within_thirty_degrees_and_more_beyond() -> None:
    i_d, i_q, omega = random_points(2000)
    budget = loss_budget(IPM, INVERTER, i_d, i_q, omega, "ddt-gdpwm")
    switching = loss_coefficients(IPM, omega, INVERTER, modulation="ddt-gdpwm").linear * np.hypot(
        i_d, i_q
    )
    v_d, v_q = IPM.voltage(i_d, i_q, IPM.pole_pairs * omega)
    cosine = np.abs(v_d * i_d + v_q * i_q) / (np.hypot(v_d, v_q) * np.hypot(i_d, i_q))
    within = cosine >= np.cos(np.radians(30.0))
    assert 100 < np.count_nonzero(within) < 1900
    np.testing.assert_allclose(switching[within], budget.switching[within], rtol=1e-9)
    assert np.all(switching[~within] < budget.switching[~within])


def test_duty_cycle_shifts_unequal_igbt_loss_as_the_docstring_says() -> None:
    """V_CE0 above V_F0: the difference to the even share is 3/2 |v| |i| cos(phi)
    (V_CE0 - V_F0) / v_dc with SPWM.
    """
    device = replace(EQUAL_IGBT, on_voltage=1.5, diode_voltage=0.7)
    inverter = replace(INVERTER, device=device)
    i_d, i_q, omega = random_points()
    v_d, v_q = IPM.voltage(i_d, i_q, IPM.pole_pairs * omega)
    even = evaluated(loss_coefficients(IPM, omega, inverter, modulation="spwm"), IPM, i_d, i_q)
    shift = 1.5 * (v_d * i_d + v_q * i_q) * (1.5 - 0.7) / inverter.v_dc
    budget = loss_budget(IPM, inverter, i_d, i_q, omega, "spwm")
    np.testing.assert_allclose(even + shift, budget.total, rtol=1e-12)


def test_machine_losses_are_those_written_out() -> None:
    """One point by hand: R = 2 mOhm, p = 4, omega_e = 1200 rad/s, i = (-60, 80) A."""
    coefficients = loss_coefficients(IPM, 300.0, extra=EXTRA)
    psi_square = (0.1049 - 350e-6 * 60.0) ** 2 + (592e-6 * 80.0) ** 2
    copper = 1.5 * 2e-3 * (1.0 + 4e-7 * 1200.0**2) * 100.0**2
    iron = (3.0 * 1200.0 + 0.02 * 1200.0**2) * psi_square
    i_d, i_q = np.array([-60.0]), np.array([80.0])
    assert evaluated(coefficients, IPM, i_d, i_q)[0] == pytest.approx(copper + iron, rel=1e-12)
    losses = drive_losses(
        IPM, replace(INVERTER, device=None), i_d, i_q, np.array([-300.0]), extra=EXTRA
    )
    assert losses.copper[0] == pytest.approx(copper, rel=1e-12)
    assert losses.iron[0] == pytest.approx(iron, rel=1e-12)
    assert losses.total[0] == pytest.approx(copper + iron, rel=1e-12)
    assert not losses.with_inverter


def test_drive_losses_equal_the_budget_and_take_any_machine() -> None:
    i_d, i_q, omega = random_points()
    losses = drive_losses(IPM, INVERTER, i_d, i_q, omega, modulation="ddt-gdpwm")
    budget = loss_budget(IPM, INVERTER, i_d, i_q, omega, "ddt-gdpwm")
    for name in ("copper", "conduction", "switching", "total", "junction_temperature"):
        np.testing.assert_allclose(getattr(losses, name), getattr(budget, name), rtol=1e-12)
    saturated = drive_losses(ArctanMachine(), INVERTER, i_d, i_q, omega)
    np.testing.assert_allclose(saturated.copper, 1.5 * 0.05 * (i_d**2 + i_q**2))


def test_conduction_of_an_igbt_beyond_the_linear_range_is_unknown() -> None:
    inverter = replace(INVERTER, device=EQUAL_IGBT)
    beyond = drive_losses(IPM, inverter, np.zeros(1), np.full(1, 100.0), np.full(1, 900.0))
    assert np.isnan(beyond.total[0])
    assert np.isfinite(
        drive_losses(IPM, INVERTER, np.zeros(1), np.full(1, 100.0), np.full(1, 900.0)).total[0]
    )


@pytest.mark.parametrize(
    "machine", [IPM, ArctanMachine(), SURFACE], ids=["ipm", "saturated", "spm"]
)
def test_least_total_loss_is_found_and_weakens_where_iron_counts(machine: Machine) -> None:
    """Of a dense scan along the torque curve no current loses less.

    Iron loss pulls i_d below that of least copper.
    """
    torque, omega = 10.0, 150.0
    coefficients = loss_coefficients(machine, omega, INVERTER, extra=EXTRA)
    total = optimal_points(machine, torque, omega, v_max=288.0, loss=coefficients)
    copper = optimal_points(machine, torque, omega, v_max=288.0)
    assert total.kkt_residual[0] < 1e-8
    assert total.i_d[0] < copper.i_d[0]
    # i_q of the torque curve by bisection for each i_d: the torque rises with i_q.
    i_d = total.i_d[0] + np.linspace(-5.0, 5.0, 4001)
    low, high = np.zeros_like(i_d), np.full_like(i_d, machine.i_max)
    for _ in range(60):
        i_q = 0.5 * (low + high)
        psi_d, psi_q = machine.flux(i_d, i_q)
        less = 1.5 * machine.pole_pairs * (psi_d * i_q - psi_q * i_d) < torque
        low, high = np.where(less, i_q, low), np.where(less, high, i_q)
    assert np.min(evaluated(coefficients, machine, i_d, i_q)) >= total.loss[0] * (1.0 - 1e-9)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_what_is_no_loss_is_refused(value: float) -> None:
    with pytest.raises(InputError, match="eddy must be zero or positive"):
        MachineLoss(eddy=value)
