"""Budget of a drive: where every watt goes, at any number of points with several
modulators and carrier frequencies.

Machine, bridge and DC link in the steady state, with junction and winding temperatures in balance
with the losses. The electrical power is that of the duty cycles and phase currents, so that power
in, losses and shaft power are three figures that must agree; `DriveBudget.imbalance` says how well
they do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.machine_batch import MachineOrBatch
from dqforge.machines.errors import InputError
from dqforge.machines.losses.bridge_tables import (
    BridgeAverages,
    BridgeTables,
    at_temperature,
    bridge_averages,
    bridge_tables,
    junction_balance,
)
from dqforge.machines.losses.machine_budget import (
    NO_EXTRA_LOSS,
    MachineBudget,
    MachineLoss,
    WindingHeat,
    machine_budget,
)
from dqforge.machines.losses.phase_terminals import ripple_iron_loss
from dqforge.machines.modulation.dead_time import dead_time_factor, low_harmonics
from dqforge.machines.modulation.ripple import inverse_inductance
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import fundamental_share, overmodulation_of

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


# What a budget of a drive counts, and what it holds at any number of points with several
# modulators and carrier frequencies.

# Kinds of loss that make up the total, machine first.
PARTS = (
    "copper",
    "ripple_copper",
    "iron",
    "ripple_iron",
    "magnet",
    "conduction",
    "dead_time",
    "switching",
    "capacitor",
)


@dataclass(frozen=True, slots=True)
class BudgetOptions:
    """What is counted beside copper, conduction and switching.

    Args:
        machine_loss: AC copper, iron and magnet loss.
        winding: How warm the winding becomes; None keeps the machine's resistance.
        capacitor_esr: Series resistance of the DC-link capacitor in Ohm at the carrier frequency.
        ripple_resistance: Resistance of the winding at the carrier frequency over that of the
            fundamental; None leaves out what the ripple makes, in copper and in iron.
        sheet_corner: Frequency in Hz at which the skin depth equals the thickness of the sheets
            (`sheet_factor`); None leaves the skin effect out of the iron loss that the switching
            makes.
    """

    machine_loss: MachineLoss = field(default=NO_EXTRA_LOSS)
    winding: WindingHeat | None = None
    capacitor_esr: float = 0.0
    ripple_resistance: float | None = 1.0
    sheet_corner: float | None = None

    def __post_init__(self) -> None:
        """Refuse negative resistances and frequencies."""
        if self.sheet_corner is not None and not 0.0 < self.sheet_corner < np.inf:
            raise InputError(
                f"sheet_corner: expected a frequency such as 1000 Hz, got {self.sheet_corner:g} Hz"
            )
        if not 0.0 <= self.capacitor_esr < np.inf:
            raise InputError(
                "capacitor_esr: expected zero or a positive resistance, got "
                f"{self.capacitor_esr:g} Ohm"
            )
        if self.ripple_resistance is not None and not 0.0 <= self.ripple_resistance < np.inf:
            raise InputError(
                f"ripple_resistance: expected a ratio such as 1, got {self.ripple_resistance:g}"
            )


@dataclass(frozen=True, slots=True)
class DriveBudget:
    """Powers and temperatures, arrays of the shape (M, F, P): modulators, carrier frequencies,
    points.

    Args:
        torque, shaft_power: Of the currents, in N m and W.
        friction: Share of the shaft power in W that friction takes; no part of the total, since no
            alternative changes it.
        copper, ripple_copper, iron, ripple_iron, magnet: Losses of the machine in W; the second is
            what the ripple of the current adds, the fourth what switched voltages add.
        conduction, dead_time, switching: Losses of the bridge in W; dead time is what the diodes of
            a MOSFET bridge add in the gaps.
        capacitor: Loss in the DC-link capacitor in W.
        total, input_power: All losses, and power from the DC source, in W.
        junction_temperature, diode_temperature: Of the hotter position in degC; equal where both
            share a junction.
        winding_temperature: In degC; NaN where nothing is known of the winding's heat.
        voltage: Amplitude of the phase voltage in V, peak.
        voltage_error: Amplitude in V that dead time takes, against the current, where nothing
            compensates it.
        capacitor_current, ripple_current: R.m.s. in A: of the DC-link capacitor, and of the ripple
            of a phase current.
        thermal_residual: Largest residual of the balances of heat, in K.
        linear: False beyond the linear range of the modulator less the dead time's share
            (`dead_time_factor`): the voltage cannot be made there.
        steady: False where a junction or the winding runs away; what depends on it is NaN there.
        cool_enough: False where a junction is hotter than the device permits.
        within_tables: False where device tables were carried on beyond their ends.
        known: False where no currents were given (NaN); everything is NaN there.
    """

    torque: FloatArray
    shaft_power: FloatArray
    friction: FloatArray
    copper: FloatArray
    ripple_copper: FloatArray
    iron: FloatArray
    ripple_iron: FloatArray
    magnet: FloatArray
    conduction: FloatArray
    dead_time: FloatArray
    switching: FloatArray
    capacitor: FloatArray
    total: FloatArray
    input_power: FloatArray
    junction_temperature: FloatArray
    diode_temperature: FloatArray
    winding_temperature: FloatArray
    voltage: FloatArray
    voltage_error: FloatArray
    capacitor_current: FloatArray
    ripple_current: FloatArray
    thermal_residual: FloatArray
    linear: BoolArray
    steady: BoolArray
    cool_enough: BoolArray
    within_tables: BoolArray
    known: BoolArray

    @property
    def feasible(self) -> BoolArray:
        """True where the voltage can be made and every temperature is steady and permitted."""
        return self.linear & self.steady & self.cool_enough & self.known

    @property
    def imbalance(self) -> FloatArray:
        """Power in less losses and shaft power, in W, shape (M, F, P)."""
        return np.asarray(self.input_power - self.total - self.shaft_power)


def stacked_budgets(budgets: Sequence[DriveBudget], axis: int) -> DriveBudget:
    """Budgets of one shape along a new axis.

    Args:
        budgets: Budgets of one shape.
        axis: Place of the new axis.
    """
    names = [part.name for part in fields(DriveBudget)]
    return DriveBudget(
        **{name: np.stack([getattr(b, name) for b in budgets], axis=axis) for name in names}
    )
