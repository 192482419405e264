"""Losses at real switching instants, against the averages of a modulator and counted events."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.bridge_tables import bridge_averages, bridge_tables
from dqforge.machines.plants.current_feedback import RampComparison, simulate_currents
from dqforge.machines.plants.fed_machine import BridgeDrive
from dqforge.machines.plants.regulator_schemes import Trajectory
from dqforge.optimizer.current_feedback.regulator_runs import trace_losses

MACHINE = LinearMachine(pole_pairs=3, r_s=0.4, l_d=1.7e-3, l_q=1.7e-3, psi_pm=0.06, i_max=20.0)
IGBT = SwitchDevice(
    "igbt", 20e-3, 1.1e-3, 0.7e-3, 20.0, 180.0, 1.0, 0.4e-3, on_voltage=0.9, diode_voltage=0.8,
    diode_resistance=12e-3,
)  # fmt: skip
MOSFET = SwitchDevice("mosfet", 20e-3, 1.1e-3, 0.7e-3, 20.0, 180.0, 1.0, 0.4e-3)


def inverter(device: SwitchDevice) -> Inverter:
    return Inverter(v_dc=180.0, f_sw=10e3, device=device)


@pytest.mark.slow
@pytest.mark.parametrize("device", [IGBT, MOSFET], ids=lambda device: device.kind)
def test_fine_ramp_comparison_loses_what_the_sine_triangle_does(device: SwitchDevice) -> None:
    """With a fast triangle the ripple vanishes, and both are one thing."""
    tables = bridge_tables(inverter(device))
    i_d, i_q, omega_m, carrier = 0.0, 8.0, 200.0, 20e3
    trace = simulate_currents(
        BridgeDrive(MACHINE, 180.0), RampComparison(2.0, 500.0, carrier), i_d, i_q, omega_m
    )
    found = trace_losses(tables, trace)
    v_d, v_q = MACHINE.voltage(np.array([i_d]), np.array([i_q]), np.array([3.0 * omega_m]))
    voltage, current = np.stack([v_d, v_q]), np.array([[i_d], [i_q]])
    average = bridge_averages(tables, "spwm", voltage, current, 180.0)
    np.testing.assert_allclose(
        np.sum(found.conduction, axis=0), np.sum(average.conduction, axis=0), rtol=0.02
    )
    np.testing.assert_allclose(
        np.sum(found.switching, axis=0), carrier * np.sum(average.switching, axis=0), rtol=0.03
    )
    assert found.link_square[0] == pytest.approx(average.dc_square[0], rel=0.02)
    assert found.ripple_square[0] == pytest.approx(trace.rms_error()[0] ** 2, rel=1e-9)


def test_each_commutation_costs_its_own_current() -> None:
    """Energies proportional to the current: the sum of all currents at the instants says it all."""
    tables = bridge_tables(inverter(MOSFET))
    trace = simulate_currents(BridgeDrive(MACHINE, 180.0), Trajectory(2, 1e-4), 0.0, 8.0, 200.0)
    energy = 0.0
    for leg in range(3):
        time, up = trace.instants(0, leg)
        for instant, rises in zip(time, up, strict=True):
            current = float(trace.phase_currents(0, instant)[0, leg])
            hard = (current > 0.0) == bool(rises)
            per_ampere = (1.1e-3 + 0.4e-3 if hard else 0.7e-3) / 20.0
            energy += per_ampere * abs(current)
    total = 3.0 * float(np.sum(trace_losses(tables, trace).switching[:, :, 0]))
    assert energy > 0.0
    assert total == pytest.approx(energy / float(trace.duration[0]), rel=1e-9)
