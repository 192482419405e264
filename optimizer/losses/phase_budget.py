"""Budget of a drive with a phase machine: every leg and the neutral path, from the waveforms.

What `drive_budget` is for three legs and sinusoids, with any phase currents on any topology. The
junctions of every leg are in balance with the losses of that leg alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.losses.bridge_heat import at_temperature, junction_balance
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.losses.leg_losses import (
    LegAverages,
    LegWaveforms,
    leg_averages,
    leg_waveforms,
)
from dqforge.machines.losses.phase_terminals import (
    PhaseTerminals,
    inductance_over_angle,
    phase_terminals,
)
from dqforge.machines.losses.ripple_iron import sheet_factor
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName, OpenPhase
from dqforge.machines.phase_machines.phase_machine import grid
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import link_demand
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, known_bridge
from dqforge.optimizer.losses.leg_budgets import PhaseBudget, joined_phase_budgets

# What the topologies with a neutral or second legs do: their extremes centred in the link.
CENTRED: ModulationName = "svpwm"
_VOLTAGE_ROUNDING = 1e-6
_NO_CURRENT = 1e-9  # Sum of the phase currents, relative, that is rounding alone.

# Points at once: the moments of 32 x 360 angles x 6 x 6 legs are 3 MB.
_CHUNK = 32


def phase_budget(
    machine: AnyPhaseMachine,
    inverter: Inverter,
    currents: FloatArray,
    omega_m: FloatArray,
    *,
    modulation: ModulationName = "svpwm",
    frequencies: FloatArray | None = None,
    options: BudgetOptions | None = None,
    friction: float = 0.0,
    open_phase: OpenPhase | None = None,
) -> PhaseBudget:
    """Budget of phase currents at P points with F carrier frequencies.

    Args:
        machine, inverter: The drive, with the inverter's topology; without a device the bridge
            counts as lossless.
        currents: Phase currents in A that make the torque, shape (P, 3, N); NaN where there are
            none.
        omega_m: Mechanical speeds in rad/s, shape (P,).
        modulation: Modulator of three legs without neutral; other topologies have their own.
        frequencies: In Hz, shape (F,); that of the inverter when None.
        options: What else is counted.
        friction: Coefficient of the machine's friction in N m s.
        open_phase: A phase that is not connected.
    """
    chosen = BudgetOptions() if options is None else options
    tables = known_bridge(inverter)
    carrier = np.atleast_1d(
        np.asarray(inverter.f_sw if frequencies is None else frequencies, float)
    )
    omega = np.broadcast_to(np.asarray(omega_m, float), currents.shape[:1])
    parts = []
    for start in range(0, max(omega.size, 1), _CHUNK):
        part = slice(start, start + _CHUNK)
        drive = _Drive(machine, inverter, tables, chosen, modulation, carrier, friction, open_phase)
        parts.append(_points(drive, currents[part], omega[part]))
    return joined_phase_budgets(parts, 1)


@dataclass(frozen=True, slots=True)
class _Drive:
    machine: AnyPhaseMachine
    inverter: Inverter
    tables: BridgeTables
    options: BudgetOptions
    modulation: ModulationName
    carrier: FloatArray
    friction: float
    open_phase: OpenPhase | None

    @property
    def flux(self) -> FloatArray:
        """V_dc / f_sw in V s, shape (F,)."""
        return self.inverter.v_dc / self.carrier

    @property
    def name(self) -> ModulationName:
        """The modulator: that of a star's legs, else the extremes centred."""
        free = TOPOLOGIES[self.inverter.topology].modulated
        return self.modulation if free else CENTRED

    @property
    def sees_ripple(self) -> bool:
        """Whether what the ripple makes is counted."""
        return self.options.ripple_resistance is not None


def averages_of_legs(
    machine: AnyPhaseMachine,
    inverter: Inverter,
    currents: FloatArray,
    omega_m: FloatArray,
    *,
    modulation: ModulationName = "svpwm",
    options: BudgetOptions | None = None,
) -> LegAverages:
    """What the legs lose at every temperature of the tables, for who follows their junctions.

    Args:
        machine, inverter, currents, omega_m, modulation, options: As of `phase_budget`, at the
            carrier of the inverter; the currents without NaN.
    """
    chosen = BudgetOptions() if options is None else options
    tables = known_bridge(inverter)
    carrier = np.array([inverter.f_sw])
    drive = _Drive(machine, inverter, tables, chosen, modulation, carrier, 0.0, None)
    flux = float(drive.flux[0]) if drive.sees_ripple else 0.0
    found = []
    for start in range(0, max(omega_m.size, 1), _CHUNK):
        part = slice(start, start + _CHUNK)
        wave = _wave(drive, _terminals(drive, currents[part], omega_m[part]))
        found.append(leg_averages(tables, inverter.topology, wave, flux))
    places = {"switched": 0, "link_current": 0, "capacitor_square": 0}
    return LegAverages(
        **{
            part.name: np.concatenate(
                [getattr(one, part.name) for one in found], axis=places.get(part.name, 3)
            )
            for part in fields(LegAverages)
        }
    )


def _terminals(drive: _Drive, currents: FloatArray, omega_m: FloatArray) -> PhaseTerminals:
    inverter = drive.inverter
    return phase_terminals(
        drive.machine,
        currents,
        omega_m,
        inverter.topology,
        loss=drive.options.machine_loss,
        heat=drive.options.winding,
        open_phase=drive.open_phase,
        neutral_resistance=inverter.neutral_resistance,
        neutral_inductance=inverter.neutral_inductance,
    )


def _wave(drive: _Drive, found: PhaseTerminals) -> LegWaveforms:
    """Legs at the terminals; at rest where the winding runs away, which is not looked at."""
    inverter = drive.inverter
    quiet = np.where(found.steady, 1.0, 0.0)[:, None, None]
    return leg_waveforms(
        inverter.topology,
        np.nan_to_num(found.voltages) * quiet,
        found.currents,
        inverter.v_dc,
        inductance_over_angle(drive.machine) + inverter.neutral_inductance,
        modulation=drive.modulation,
        open_phase=drive.open_phase,
    )


def _points(drive: _Drive, currents: FloatArray, omega_m: FloatArray) -> PhaseBudget:
    """Budget of a chunk of points, arrays (F, n)."""
    known = np.all(np.isfinite(currents), axis=(1, 2))
    found = _terminals(drive, np.where(known[:, None, None], currents, 0.0), omega_m)
    wave = _wave(drive, found)
    rows = [_at_frequency(drive, found, wave, k) for k in range(drive.carrier.size)]
    return _blanked(drive, found, known, omega_m, rows)


@dataclass(frozen=True, slots=True)
class _Row:
    """What depends on the carrier frequency: numbers, marks (n,), legs (n, L)."""

    numbers: dict[str, FloatArray]
    marks: dict[str, BoolArray]
    leg_loss: FloatArray
    leg_temperature: FloatArray
    neutral_ripple: FloatArray
    link_demand: FloatArray


def _at_frequency(drive: _Drive, found: PhaseTerminals, wave: LegWaveforms, place: int) -> _Row:
    inverter, tables, options = drive.inverter, drive.tables, drive.options
    frequency, flux = float(drive.carrier[place]), float(drive.flux[place])
    average = leg_averages(tables, inverter.topology, wave, flux if drive.sees_ripple else 0.0)
    gap = inverter.dead_time * frequency
    parts = (average.conduction, average.switching * frequency, average.dead * gap)
    balance = junction_balance(tables, parts[0] + parts[1] + parts[2])
    conduction, switching, dead = (
        np.sum(at_temperature(tables.temperatures, part, balance.temperature), axis=(0, 1))
        for part in parts
    )
    phases = flux**2 * np.maximum(np.mean(np.trace(wave.ripple, axis1=-2, axis2=-1), axis=-1), 0.0)
    neutral = flux**2 * np.mean(np.sum(wave.ripple, axis=(-2, -1)), axis=-1)
    neutral = np.where(neutral > _NO_CURRENT * phases, neutral, 0.0)
    factor = options.ripple_resistance or 0.0
    eddy = options.machine_loss.eddy * inverter.v_dc**2 * wave.harmonic_voltage
    if options.sheet_corner is not None:
        eddy = eddy * sheet_factor(frequency, options.sheet_corner)
    losses = {
        "copper": found.copper + found.neutral,
        "ripple_copper": factor
        * (found.resistance * phases + inverter.neutral_resistance * neutral),
        "iron": found.iron,
        "ripple_iron": eddy if drive.sees_ripple else np.zeros_like(eddy),
        "magnet": found.magnet,
        "conduction": np.sum(conduction, axis=-1),
        "dead_time": np.sum(dead, axis=-1),
        "switching": np.sum(switching, axis=-1),
        "capacitor": options.capacitor_esr * average.capacitor_square,
    }
    total = sum(losses.values(), np.zeros(1))
    added = total - losses["copper"] - found.iron - found.magnet
    hottest = np.max(balance.temperature, axis=(0, 1))
    numbers = losses | {
        "total": total,
        "input_power": inverter.v_dc * average.link_current + added,
        "junction_temperature": np.max(balance.temperature[:, 0], axis=(0, -1)),
        "diode_temperature": np.max(balance.temperature[:, -1], axis=(0, -1)),
        "voltage_error": _dead_time_error(found, average.switched, gap * inverter.v_dc),
        "capacitor_current": np.sqrt(average.capacitor_square),
        "ripple_current": np.sqrt(phases / 3.0),
        "thermal_residual": np.max(np.abs(balance.residual), axis=(0, 1, -1)),
    }
    low, high = tables.temperature_reach
    inside = np.all(
        (balance.temperature >= low - 1e-9) & (balance.temperature <= high + 1e-9), axis=(0, 1, -1)
    )
    demand = _link_demand(drive, found, wave)
    left = float(dead_time_factor(drive.name, inverter.dead_time, frequency))
    largest = np.max(np.abs(wave.current), axis=(-2, -1))
    marks = {
        "linear": demand * (1.0 - _VOLTAGE_ROUNDING) <= inverter.v_dc * left,
        "steady": np.all(balance.steady, axis=-1) & found.steady,
        "cool_enough": np.all(hottest <= tables.max_junction_temperature, axis=-1),
        "within_tables": inside & (largest <= tables.current_reach),
    }
    legs = conduction + switching + dead
    return _Row(numbers, marks, legs, hottest, np.sqrt(neutral), demand)


def _dead_time_error(found: PhaseTerminals, switched: FloatArray, volts: float) -> FloatArray:
    """Amplitude in V against the current that the dead time of all legs takes together."""
    size = np.sqrt(2.0 / 3.0 * np.mean(np.sum(found.currents**2, axis=-2), axis=-1))
    return np.asarray(volts * np.sum(switched, axis=-1) / (1.5 * np.where(size > 0.0, size, 1.0)))


def _link_demand(drive: _Drive, found: PhaseTerminals, wave: LegWaveforms) -> FloatArray:
    """Least link voltage in V, shape (n,): of the topology, or more where the modulator of three
    legs does not use all of it.
    """
    demand = link_demand(found.between, drive.inverter.topology)
    if drive.name == CENTRED or MODULATORS[drive.name].rests:
        return demand
    off_middle = np.max(np.abs(wave.duty - 0.5), axis=(-2, -1))
    return np.asarray(np.maximum(demand, 2.0 * drive.inverter.v_dc * off_middle))


def _blanked(
    drive: _Drive,
    found: PhaseTerminals,
    known: BoolArray,
    omega_m: FloatArray,
    rows: Sequence[_Row],
) -> PhaseBudget:
    """Rows of all frequencies as one budget, NaN where nothing is known."""
    common = {
        "torque": found.torque,
        "shaft_power": found.shaft_power,
        "friction": drive.friction * omega_m * omega_m,
        "winding_temperature": found.winding_temperature,
        "voltage": _fundamental(found.voltages, drive.machine.turns),
    }
    numbers = {name: np.stack([row.numbers[name] for row in rows]) for name in rows[0].numbers}
    numbers |= {name: np.stack([value] * len(rows)) for name, value in common.items()}
    legs = {
        name: np.where(known[:, None], np.stack([getattr(row, name) for row in rows]), np.nan)
        for name in ("leg_loss", "leg_temperature")
    }
    if drive.inverter.device is None:
        for name in ("junction_temperature", "diode_temperature"):
            numbers[name] = np.full_like(numbers[name], np.nan)
        legs = {name: np.full_like(values, np.nan) for name, values in legs.items()}
    columns: dict[str, Any] = {
        name: np.where(known, value, np.nan) for name, value in numbers.items()
    }
    columns |= {name: np.stack([row.marks[name] for row in rows]) & known for name in rows[0].marks}
    columns["known"] = np.stack([known] * len(rows))
    through = np.sqrt(np.mean(np.sum(found.currents, axis=-2) ** 2, axis=-1))
    size = np.sqrt(np.mean(found.currents**2, axis=(-2, -1)))
    through = np.where(through > _NO_CURRENT * size, through, 0.0)
    ripple = np.stack([row.neutral_ripple for row in rows])
    return PhaseBudget(
        budget=DriveBudget(**columns),
        legs=TOPOLOGIES[drive.inverter.topology].legs,
        neutral_current=np.where(known, np.stack([through] * len(rows)), np.nan),
        neutral_ripple=np.where(known, ripple, np.nan),
        link_demand=np.where(known, np.stack([row.link_demand for row in rows]), np.nan),
        **legs,
    )


def _fundamental(voltages: FloatArray, turns: int) -> FloatArray:
    """Amplitude in V (peak) of the fundamental's positive sequence, shape (n,), of voltages over
    ``turns`` electrical periods.
    """
    angle = grid(voltages.shape[-1], turns)
    lagging = np.exp(-1j * (angle - 2.0 * np.pi / 3.0 * np.arange(3)[:, None]))
    return np.asarray(2.0 * np.abs(np.mean(voltages * lagging, axis=(-2, -1))))
