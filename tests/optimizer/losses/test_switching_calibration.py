"""Switching energies calibrated on one measured point: found again, and refused
where the data contradict.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from simple_losses import loss_budget

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import ModulationName
from dqforge.optimizer.exploration.machine_axis import calibrate_switching

# Paper 000: Tables 5 and 6, with psi_pm and l_q - l_d as Table 2 identifies them.
MACHINE = LinearMachine(pole_pairs=4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0)
# The energies are placeholders: the calibration sets them. Thermal resistance and coolant
# temperature are not in the paper.
DEVICE = SwitchDevice("mosfet", 9.5e-3, 1e-3, 1e-3, 200.0, 500.0, thermal_resistance=0.306)
INVERTER = Inverter(v_dc=500.0, f_sw=100e3, device=DEVICE, coolant_temperature=64.0)
TORQUE, OMEGA_M = 130.0, 300.0
ID0 = (0.0, 2.0 * TORQUE / (3.0 * 4 * 0.1049))


def i_q_for(torque: float, i_d: float) -> float:
    return torque / (6.0 * (0.1049 - 242e-6 * i_d))


def least_current(torque: float) -> tuple[float, float]:
    """Return the MTPA currents by direct minimisation along the curve of constant torque."""
    best = minimize_scalar(
        lambda i_d: math.hypot(i_d, i_q_for(torque, i_d)),
        bounds=(-283.0, 0.0),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return float(best.x), i_q_for(torque, float(best.x))


MTPA = least_current(TORQUE)


def hot_inverter(alpha: float) -> Inverter:
    return replace(INVERTER, device=replace(DEVICE, on_resistance_temperature_coefficient=alpha))


@settings(deadline=None)
@given(
    st.floats(0.0, 4e-3), st.floats(1.0, 1000.0), st.sampled_from(["spwm", "svpwm", "ddt-gdpwm"])
)
def test_calibration_meets_the_measurement(
    alpha: float, extra: float, modulation: ModulationName
) -> None:
    """The energies that made a budget are found again from its total, with a warm resistance
    too.
    """
    device = replace(
        DEVICE, on_resistance_temperature_coefficient=alpha, reverse_recovery_energy=0.3e-3
    )
    true = replace(
        INVERTER, device=replace(device, turn_on_energy=1e-6 * extra, turn_off_energy=1e-6 * extra)
    )
    measured = float(loss_budget(MACHINE, true, *MTPA, OMEGA_M, modulation).total[0])
    found = calibrate_switching(
        measured, MACHINE, replace(INVERTER, device=device), *MTPA, OMEGA_M, modulation
    )
    assert true.device is not None
    assert found.switching_energy == pytest.approx(true.device.switching_energy, rel=1e-9)
    assert found.turn_on_energy / found.reverse_recovery_energy == pytest.approx(1.0 / 0.3)
    assert found.on_resistance == device.on_resistance


def test_calibration_refuses_a_measurement_below_the_other_losses() -> None:
    """Column 1 has 128.0 W of copper and 607.9 W of conduction loss."""
    with pytest.raises(
        InputError,
        match=r"700 W is below the copper loss of 128 W plus the conduction loss of 607\.9 W",
    ):
        calibrate_switching(700.0, MACHINE, INVERTER, *ID0, OMEGA_M, "spwm")


def test_calibration_refuses_a_point_or_a_device_without_switching_loss() -> None:
    silent = replace(INVERTER, device=replace(DEVICE, turn_on_energy=0.0, turn_off_energy=0.0))
    with pytest.raises(InputError, match="energies above zero"):
        calibrate_switching(1064.0, MACHINE, silent, *ID0, OMEGA_M, "spwm")
    with pytest.raises(InputError, match="energies above zero"):
        calibrate_switching(1064.0, MACHINE, INVERTER, 0.0, 0.0, OMEGA_M, "spwm")


def test_calibration_refuses_a_point_beyond_the_linear_range() -> None:
    with pytest.raises(InputError, match="spwm makes at most 250 V from 500 V"):
        calibrate_switching(1064.0, MACHINE, INVERTER, *ID0, 450.0, "spwm")


def test_calibration_refuses_thermal_runaway() -> None:
    torque, size = MACHINE.torque_per_ampere * ID0[1], math.hypot(*ID0)
    said = rf"{torque:.4g} N m and {OMEGA_M:.4g} rad/s \({size:.4g} A\): .* \(1 of 1 points\)"
    with pytest.raises(NoSolutionError, match="thermal runaway at " + said):
        calibrate_switching(1064.0, MACHINE, hot_inverter(5e-2), *ID0, OMEGA_M, "spwm")
