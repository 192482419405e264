"""Budget of a drive: where every watt goes, at any number of points with several
modulators and carrier frequencies.

Machine, bridge and DC link in the steady state, with junction and winding temperatures in balance
with the losses. The electrical power is that of the duty cycles and phase currents, so that power
in, losses and shaft power are three figures that must agree; `DriveBudget.imbalance` says how well
they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.devices.switch import SwitchDevice
from dqforge.machines.dq_machines.machine_batch import MachineOrBatch
from dqforge.machines.errors import InputError
from dqforge.machines.losses.bridge_heat import at_temperature, junction_balance
from dqforge.machines.losses.bridge_losses import BridgeAverages, bridge_averages
from dqforge.machines.losses.bridge_tables import BridgeTables, bridge_tables
from dqforge.machines.losses.machine_budget import MachineBudget, machine_budget
from dqforge.machines.losses.ripple_iron import ripple_iron_loss
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.modulation.low_harmonics import low_harmonics
from dqforge.machines.modulation.ripple import inverse_inductance
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import fundamental_share, overmodulation_of
from dqforge.optimizer.losses.budget_record import (
    PARTS,
    BudgetOptions,
    DriveBudget,
    stacked_budgets,
)

__all__ = [
    "PARTS",
    "BudgetOptions",
    "DriveBudget",
    "Supply",
    "drive_budget",
    "harmonic_square",
    "known_bridge",
    "stacked_budgets",
    "supplied_budget",
    "switched_iron",
    "waveform_averages",
]

_VOLTAGE_ROUNDING = 1e-6  # Excess over the linear range that solvers of operating points leave.

_LOSSLESS = SwitchDevice(
    "mosfet", 0.0, 0.0, 0.0, 1.0, 1.0, thermal_resistance=1.0, max_junction_temperature=1e4
)


def known_bridge(inverter: Inverter) -> BridgeTables:
    """Tables of the bridge; of one without losses where nothing is known of its switch.

    Args:
        inverter: DC link, device and coolant.
    """
    return bridge_tables(
        inverter if inverter.device is not None else replace(inverter, device=_LOSSLESS)
    )


@dataclass(frozen=True, slots=True)
class Supply:
    """What feeds N points.

    Args:
        v_dc, dead_time: Link voltage in V and dead time in s, of all points or of each, shape (N,).
        frequency: Carrier frequencies in Hz, shape (F, 1) of all points, (1, N) of each.
        energy_factors: As of `bridge_averages`, where the link voltage is not that of the tables.
    """

    v_dc: FloatArray | float
    dead_time: FloatArray | float
    frequency: FloatArray
    energy_factors: FloatArray | None = None


def drive_budget(
    machine: MachineOrBatch,
    inverter: Inverter,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    modulations: Sequence[ModulationName],
    frequencies: ArrayLike | None = None,
    *,
    options: BudgetOptions | None = None,
) -> DriveBudget:
    """Budget at P points with M modulators and F carrier frequencies.

    Args:
        machine, inverter: The drive; of several machines one per point (`MachineBatch`). The tables
            of its device are used where it has them, else its constants; without a device the
            bridge counts as lossless, and its temperatures are NaN.
        i_d, i_q: Currents in A (peak) that make the torque, broadcastable to (M, P): each modulator
            may have its own. NaN where there are none.
        omega_m: Mechanical speed in rad/s, broadcastable likewise.
        modulations: M modulators.
        frequencies: F carrier frequencies in Hz, shape (F,); that of the inverter when None.
        options: What else is counted.

    Returns:
        DriveBudget

    Raises:
        InputError: There is no modulator, or a frequency is not positive.
    """
    chosen = BudgetOptions() if options is None else options
    tables = known_bridge(inverter)
    carrier = np.atleast_1d(
        np.asarray(inverter.f_sw if frequencies is None else frequencies, dtype=np.float64)
    )
    if not modulations or not (carrier.size and np.all((carrier > 0.0) & np.isfinite(carrier))):
        raise InputError("drive budget: give a modulator and positive carrier frequencies at least")
    supply = Supply(inverter.v_dc, inverter.dead_time, carrier[:, None])
    return supplied_budget(
        machine, inverter, supply, i_d, i_q, omega_m, modulations, options=chosen, tables=tables
    )


def supplied_budget(
    machine: MachineOrBatch,
    inverter: Inverter,
    supply: Supply,
    i_d: ArrayLike,
    i_q: ArrayLike,
    omega_m: ArrayLike,
    modulations: Sequence[ModulationName],
    *,
    options: BudgetOptions,
    tables: BridgeTables,
) -> DriveBudget:
    """Budget at P points that may each have their own link voltage, dead time and carrier.

    Args:
        machine, inverter, i_d, i_q, omega_m, modulations, options: As of `drive_budget`; link
            voltage, dead time and carrier frequency are those of the supply.
        supply: What feeds the points.
        tables: Tables of the bridge at the inverter's link voltage (`known_bridge`).

    Raises:
        InputError: The shapes do not fit.
    """
    given = [np.asarray(value, dtype=np.float64) for value in (i_d, i_q, omega_m)]
    shape = np.broadcast_shapes((len(modulations), 1), *(value.shape for value in given))
    if len(shape) != 2 or shape[0] != len(modulations):
        raise InputError(
            f"drive budget: the points have the shape {shape}, not (modulators, points)"
        )
    rows = [np.broadcast_to(value, shape) for value in given]
    budgets = []
    for m, name in enumerate(modulations):
        points = np.stack([row[m] for row in rows])
        budgets.append(_budget(machine, inverter, tables, points, name, supply, options))
    return stacked_budgets(budgets, 0)


def waveform_averages(
    machine: MachineOrBatch,
    inverter: Inverter,
    tables: BridgeTables,
    found: MachineBudget,
    modulation: ModulationName,
    options: BudgetOptions,
    supply: Supply | None = None,
) -> BridgeAverages:
    """Averages of the bridge at N points of the machine.

    The machine's arrays have the shape (N,), without NaN.

    Args:
        machine: Any machine.
        inverter: DC link, device and coolant.
        tables: Tables of the bridge.
        found: Budget of the machine at the points, arrays of shape (N,) without NaN.
        modulation: The modulator.
        options: What is counted beside the bridge and the winding.
        supply: Where points have link voltages of their own; None for that of the inverter.
    """
    voltage, current = np.stack([found.v_d, found.v_q]), np.stack([found.i_d, found.i_q])
    factors = None
    if supply is not None and np.ndim(supply.v_dc) > 0:
        # Duty cycles know the voltages over that of the link alone.
        voltage, factors = voltage * (inverter.v_dc / supply.v_dc), supply.energy_factors
    stiff = (
        None
        if options.ripple_resistance is None
        else inverse_inductance(machine, found.i_d, found.i_q)
    )
    method = overmodulation_of(inverter, modulation)
    return bridge_averages(
        tables, modulation, voltage, current, inverter.v_dc, stiff, method, factors
    )


def harmonic_square(
    machine: MachineOrBatch,
    inverter: Inverter,
    found: MachineBudget,
    omega_m: FloatArray,
    modulation: ModulationName,
    options: BudgetOptions,
) -> FloatArray:
    """Mean square in A^2 of the low harmonics of a phase current that overmodulation makes at N
    points, shape (N,); zero where the ripple is left out.

    Args:
        machine, inverter: The drive.
        found: Budget of the machine at the points, arrays of shape (N,) without NaN.
        omega_m: Mechanical speeds in rad/s, shape (N,).
        modulation: The modulator.
        options: What is counted.
    """
    method = overmodulation_of(inverter, modulation)
    if options.ripple_resistance is None or method == "none":
        return np.zeros_like(found.i_d)
    harmonics = low_harmonics(
        method,
        machine,
        found.i_d,
        found.i_q,
        omega_m,
        v_dc=inverter.v_dc,
        voltage=(found.v_d, found.v_q),
    )
    return np.square(np.nan_to_num(harmonics.current))


def switched_iron(
    options: BudgetOptions, voltage: FloatArray, v_dc: FloatArray | float, frequency: FloatArray
) -> FloatArray:
    """Iron loss in W that the switching makes, for phase amplitudes in V and carrier
    frequencies in Hz, broadcast.

    Args:
        options: The coefficients of the machine's loss.
        voltage: Phase-voltage amplitudes in V (peak), any shape.
        v_dc: DC-link voltage in V.
        frequency: Carrier frequencies in Hz, a shape that fits.
    """
    if options.ripple_resistance is None:
        return np.zeros(np.broadcast_shapes(np.shape(voltage), np.shape(frequency)))
    return ripple_iron_loss(
        options.machine_loss.eddy, voltage, v_dc, frequency, options.sheet_corner
    )


def _quiet(found: MachineBudget) -> MachineBudget:
    """The same with zeros where the winding runs away, for waveforms that are not looked at."""
    columns: dict[str, Any] = {
        part.name: np.where(found.steady, getattr(found, part.name), 0.0)
        for part in fields(MachineBudget)
        if part.name != "steady"
    }
    return MachineBudget(steady=found.steady, **columns)


def _budget(
    machine: MachineOrBatch,
    inverter: Inverter,
    tables: BridgeTables,
    points: FloatArray,
    modulation: ModulationName,
    supply: Supply,
    options: BudgetOptions,
) -> DriveBudget:
    """Budget of one modulator, arrays (F, P), for rows i_d, i_q, omega_m (3, P)."""
    known = np.all(np.isfinite(points), axis=0)
    i_d, i_q, omega_m = np.where(known, points, 0.0)
    found = machine_budget(
        machine, i_d, i_q, omega_m, loss=options.machine_loss, heat=options.winding
    )
    quiet = _quiet(found)
    average = waveform_averages(machine, inverter, tables, quiet, modulation, options, supply)
    low_square = harmonic_square(machine, inverter, quiet, omega_m, modulation, options)
    v_dc, frequency = supply.v_dc, supply.frequency
    # The share of a carrier period in each of its two gaps.
    gap = supply.dead_time * frequency
    parts = [average.conduction[..., None, :], average.switching[..., None, :] * frequency]
    parts.append(average.dead[..., None, :] * gap)
    balance = junction_balance(tables, parts[0] + parts[1] + parts[2])
    # Three positions each, of upper and of lower ones.
    conduction, switching, dead = (
        3.0 * np.sum(at_temperature(tables.temperatures, part, balance.temperature), axis=(0, 1))
        for part in parts
    )
    ripple_square = average.ripple * (v_dc / frequency) ** 2
    ripple = 3.0 * found.resistance * (options.ripple_resistance or 0.0) * ripple_square
    ripple = ripple + 3.0 * found.resistance * low_square
    link_square = np.maximum(average.dc_square - average.dc_current**2, 0.0)
    size = np.hypot(found.i_d, found.i_q)
    error = (
        supply.dead_time
        * frequency
        * v_dc
        * average.switched
        / (1.5 * np.where(size > 0.0, size, 1.0))
    )
    voltage = np.hypot(found.v_d, found.v_q)
    left = dead_time_factor(modulation, supply.dead_time, frequency)
    hottest = np.max(balance.temperature, axis=(0, 1))
    steady = balance.steady & found.steady
    losses = {
        "copper": found.copper,
        "ripple_copper": ripple,
        "iron": found.iron,
        "ripple_iron": switched_iron(options, voltage, v_dc, frequency),
        "magnet": found.magnet,
        "conduction": conduction,
        "dead_time": dead,
        "switching": switching,
        "capacitor": options.capacitor_esr * link_square,
    }
    total = sum(losses.values(), np.zeros(1))
    added = total - found.copper - found.iron - found.magnet
    numbers = losses | {
        "torque": found.torque,
        "shaft_power": found.shaft_power,
        "friction": machine.friction * omega_m * omega_m,
        "total": total,
        "input_power": v_dc * average.dc_current + added,
        "junction_temperature": np.max(balance.temperature[:, 0], axis=0),
        "diode_temperature": np.max(balance.temperature[:, -1], axis=0),
        "winding_temperature": found.winding_temperature,
        "voltage": voltage,
        "voltage_error": error,
        "capacitor_current": np.sqrt(link_square),
        "ripple_current": np.sqrt(ripple_square + low_square),
        "thermal_residual": np.max(np.abs(balance.residual), axis=(0, 1)),
    }
    if inverter.device is None:
        numbers |= {
            name: np.full(known.shape, np.nan)
            for name in ("junction_temperature", "diode_temperature")
        }
    low, high = tables.temperature_reach
    inside = (size <= tables.current_reach) & np.all(
        (balance.temperature >= low - 1e-9) & (balance.temperature <= high + 1e-9), axis=(0, 1)
    )
    marks = {
        "linear": voltage * (1.0 - _VOLTAGE_ROUNDING)
        <= fundamental_share(inverter, modulation) * v_dc * left,
        "steady": steady,
        "cool_enough": hottest <= tables.max_junction_temperature,
        "within_tables": inside,
        "known": known,
    }
    shape = (frequency.shape[0], known.size)
    columns: dict[str, Any] = {
        name: np.broadcast_to(np.where(known, value, np.nan), shape)
        for name, value in numbers.items()
    }
    columns |= {name: np.broadcast_to(mark & known, shape) for name, mark in marks.items()}
    return DriveBudget(**columns)
