"""Losses of a bridge by its constants alone: what the budget of a drive must agree
with where it counts no more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine, copper_loss
from dqforge.machines.losses.machine_budget import bridge_load, required_device, thermal_balance
from dqforge.machines.modulation.modulators import in_linear_range
from dqforge.machines.names import ModulationName


@dataclass(frozen=True, slots=True)
class SimpleBudget:
    """Losses in W and the junction temperature in degC at points, arrays of one shape;
    NaN at thermal runaway.
    """

    torque: FloatArray
    copper: FloatArray
    conduction: FloatArray
    switching: FloatArray
    total: FloatArray
    junction_temperature: FloatArray
    voltage: FloatArray
    linear: BoolArray
    steady: BoolArray
    cool_enough: BoolArray

    @property
    def feasible(self) -> BoolArray:
        return self.linear & self.steady & self.cool_enough


def loss_budget(
    machine: Machine,
    inverter: Inverter,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    modulation: ModulationName,
) -> SimpleBudget:
    """Copper, conduction and switching loss in the steady state."""
    points = (np.atleast_1d(np.asarray(value, dtype=np.float64)) for value in (i_d, i_q, omega_m))
    i_d, i_q, omega = np.broadcast_arrays(*points)
    v_d, v_q = machine.voltage(i_d, i_q, machine.pole_pairs * omega)
    voltage = np.hypot(v_d, v_q)
    bridge = thermal_balance(inverter, bridge_load(inverter, modulation, v_d, v_q, i_d, i_q))
    copper = copper_loss(machine.r_s, i_d, i_q)
    return SimpleBudget(
        torque=machine.torque(i_d, i_q),
        copper=copper,
        conduction=bridge.conduction,
        switching=bridge.switching,
        total=copper + bridge.conduction + bridge.switching,
        junction_temperature=bridge.junction_temperature,
        voltage=voltage,
        linear=in_linear_range(modulation, voltage, inverter.v_dc),
        steady=bridge.thermally_stable,
        cool_enough=bridge.junction_temperature
        <= required_device(inverter).max_junction_temperature,
    )
