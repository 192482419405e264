"""Rules for the currents of a phase machine compared by their losses, at any number of points.

What `compare_drives` is for dq machines: the strategies of the design give sinusoidal currents
(one row ``dq`` where the machine has no saliency), and dqx, dqy (with a neutral) and ``limited``,
the least copper loss within voltage and current, follow. The bridge is that of the topology, each
leg by its own duty cycle and current.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import AnyStrategy, LoadPoint, LossSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.bridge_tables import BridgeTables, at_temperature, junction_balance
from dqforge.machines.losses.phase_terminals import (
    LegAverages,
    LegWaveforms,
    PhaseTerminals,
    inductance_over_angle,
    leg_averages,
    leg_waveforms,
    phase_terminals,
    sheet_factor,
)
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName, OpenPhase, Topology
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine, PhaseMachine, grid
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, link_demand, sine_share
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, known_bridge
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    DriveComparison,
    compare_drives,
    compares,
    least,
    strategy_currents,
)
from dqforge.optimizer.waveforms.constraint_rows import (
    WaveformLimits,
    dq_waveform,
    pointwise_currents,
    unit_currents,
)
from dqforge.optimizer.waveforms.solver import solve_waveforms

_EXCESS = 1e-6


_ROUNDS = 3


# Budgets of phase machines with the legs behind them, and how several become one.


@dataclass(frozen=True, slots=True)
class PhaseBudget:
    """Budgets of a phase machine, arrays of the shape (..., F, P): carrier frequencies, points.

    Args:
        budget: As of any drive; ``copper`` counts the neutral's conductor, ``ripple_copper`` what
            the switching makes in phases and neutral, zero sequence included.
        legs: Names of the half bridges, the axis L of the next two.
        leg_loss, leg_temperature: Conduction, dead time and switching of each leg in W, and its
            hotter junction in degC, shape (..., F, P, L).
        neutral_current, neutral_ripple: R.m.s. in A of the sum of the phase currents without
            ripple, and of its ripple alone.
        link_demand: Least voltage of the link in V, without what dead time takes.
    """

    budget: DriveBudget
    legs: tuple[str, ...]
    leg_loss: FloatArray
    leg_temperature: FloatArray
    neutral_current: FloatArray
    neutral_ripple: FloatArray
    link_demand: FloatArray


@dataclass(frozen=True, slots=True)
class PhaseComparison:
    """Budgets of a phase machine with the legs behind them.

    ``legs`` has the axes (S, M) of strategies and modulators before those of `PhaseBudget`.
    """

    drives: DriveComparison
    legs: PhaseBudget


@dataclass(frozen=True, slots=True)
class PhaseDrive:
    """A phase machine and what feeds it.

    ``fundamental`` is the machine in dq coordinates, with the mean of any saliency.
    """

    machine: AnyPhaseMachine
    fundamental: Machine
    inverter: Inverter
    i_max: float
    options: BudgetOptions
    margin: float

    def usable_link(self, frequency: float) -> float:
        """Volts of the link in V that are left by dead time and margin at a carrier in Hz."""
        left = float(dead_time_factor(CENTRED, self.inverter.dead_time, frequency))
        return self.inverter.v_dc * left * (1.0 - self.margin)


def phase_rows(drive: PhaseDrive, strategies: tuple[AnyStrategy, ...]) -> tuple[AnyStrategy, ...]:
    """Rows of the comparison for the strategies that a design names.

    Args:
        drive: Machine and inverter.
        strategies: Those of dq machines that the design names.
    """
    plain = isinstance(drive.machine, PhaseMachine)
    rows: list[AnyStrategy] = ["dq"] if plain else list(strategies)
    rows.append("dqx")
    if TOPOLOGIES[drive.inverter.topology].neutral:
        rows.append("dqy")
    return (*rows, "limited") if plain else tuple(rows)


def compare_phases(
    drive: PhaseDrive, torque: FloatArray, omega_m: FloatArray, alternatives: Alternatives
) -> PhaseComparison:
    """Budgets of every rule with every modulator at every frequency, at P points.

    Args:
        drive: Machine, inverter and limits.
        torque, omega_m: In N m and rad/s, shape (P,).
        alternatives: What a design names: its strategies become rows by `phase_rows`; modulators
            matter on three legs without a neutral, elsewhere the extremes are centred.
    """
    names = (
        alternatives.modulations if TOPOLOGIES[drive.inverter.topology].modulated else (CENTRED,)
    )
    labels = Alternatives(
        phase_rows(drive, alternatives.strategies), names, alternatives.frequencies
    )
    found, reached = [], []
    for strategy in labels.strategies:
        rows, made = [], []
        for frequency in labels.frequencies:
            currents, kept = rule_currents(drive, strategy, torque, omega_m, frequency)
            rows.append([_budget(drive, currents, omega_m, name, frequency) for name in names])
            made.append(kept)
        by_name = [joined_phase_budgets([row[m] for row in rows]) for m in range(len(names))]
        found.append(stacked_phase_budgets(by_name))
        reached.append(np.broadcast_to(np.stack(made), (len(names), len(made), torque.size)))
    legs, kept_all = stacked_phase_budgets(found), np.stack(reached)
    compared = compares(drive.inverter, labels)
    total = np.where(kept_all & legs.budget.feasible & compared, legs.budget.total, np.inf)
    drives = DriveComparison(labels, torque, omega_m, legs.budget, kept_all, least(total), compared)
    return PhaseComparison(drives, legs)


def _budget(
    drive: PhaseDrive,
    currents: FloatArray,
    omega_m: FloatArray,
    name: ModulationName,
    frequency: float,
) -> PhaseBudget:
    return phase_budget(
        drive.machine,
        drive.inverter,
        currents,
        omega_m,
        modulation=name,
        frequencies=np.array([frequency]),
        options=drive.options,
        friction=drive.fundamental.friction,
    )


def rule_currents(
    drive: PhaseDrive,
    strategy: AnyStrategy,
    torque: FloatArray,
    omega_m: FloatArray,
    frequency: float,
) -> tuple[FloatArray, BoolArray]:
    """Phase currents (P, 3, N) in A of one row, NaN where there are none, and whether they make
    the torque.

    Args:
        drive: Machine, inverter and limits.
        strategy: The row.
        torque, omega_m: In N m and rad/s, shape (P,).
        frequency: Carrier in Hz, whose dead time the link pays.
    """
    if strategy == "limited":
        return _limited(drive, torque, omega_m, frequency)
    if strategy not in ("dqx", "dqy"):
        return _sinusoids(drive, strategy, torque, omega_m, frequency)
    try:
        if isinstance(drive.machine, PhaseMachine):
            wanted = torque[:, None, None] * unit_currents(drive.machine, strategy)
        else:
            way: Topology = "three-wire" if strategy == "dqx" else "six-leg"
            wanted = pointwise_currents(drive.machine, torque, way)
    except NoSolutionError:
        missing = np.full((torque.size, 3, drive.machine.angles), np.nan)
        return missing, np.zeros(torque.size, dtype=np.bool_)
    peak = np.max(np.abs(wanted), axis=(1, 2))
    share = np.minimum(1.0, drive.i_max / np.where(peak > 0.0, peak, drive.i_max))
    return share[:, None, None] * wanted, np.asarray(share >= 1.0 - _EXCESS)


def _sinusoids(
    drive: PhaseDrive,
    strategy: AnyStrategy,
    torque: FloatArray,
    omega_m: FloatArray,
    frequency: float,
) -> tuple[FloatArray, BoolArray]:
    """Currents that are constant in dq, the field weakened within the topology's voltage."""
    i_d, i_q, reached = strategy_currents(
        drive.fundamental,
        "mtpa" if strategy == "dq" else strategy,
        torque,
        omega_m,
        v_max=drive.usable_link(frequency) * sine_share(drive.inverter.topology),
        i_max=drive.i_max,
        options=drive.options,
    )
    angles, turns = drive.machine.angles, drive.machine.turns
    pairs = zip(i_d.tolist(), i_q.tolist(), strict=True)
    return np.stack([dq_waveform(d, q, angles, turns) for d, q in pairs]), reached


def _limited(
    drive: PhaseDrive, torque: FloatArray, omega_m: FloatArray, frequency: float
) -> tuple[FloatArray, BoolArray]:
    """Least copper loss within all limits; the link is taken shorter where what the programmes do
    not know (iron, a warm winding) needs more of it.
    """
    assert isinstance(drive.machine, PhaseMachine)
    link = np.full(torque.shape, drive.usable_link(frequency))
    currents = np.full((torque.size, 3, drive.machine.angles), np.nan)
    todo = np.arange(torque.size)
    for _ in range(_ROUNDS):
        for volts in np.unique(link[todo]):
            places = todo[link[todo] == volts]
            limits = WaveformLimits(float(volts), drive.inverter.topology, drive.i_max)
            try:
                solved = solve_waveforms(drive.machine, torque[places], omega_m[places], limits)
            except NoSolutionError:
                continue
            currents[places] = solved.currents
        found = _budget(drive, currents[todo], omega_m[todo], CENTRED, frequency)
        over = found.budget.known[0] & ~found.budget.linear[0]
        todo = todo[over]
        if not todo.size:
            break
        excess = found.link_demand[0, over] / drive.usable_link(frequency)
        link[todo] /= excess * (1.0 + _EXCESS)
    return currents, np.all(np.isfinite(currents), axis=(1, 2))


# Budget of a drive with a phase machine: every leg and the neutral path, from the waveforms.
#
# What `drive_budget` is for three legs and sinusoids, with any phase currents on any topology. The
# junctions of every leg are in balance with the losses of that leg alone.

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


def stacked_phase_budgets(found: Sequence[PhaseBudget], axis: int = 0) -> PhaseBudget:
    """Budgets of one shape along a new axis.

    Args:
        found: Budgets of the same legs.
        axis: Place of the new axis.
    """
    return _combined(found, lambda rows: np.stack(rows, axis=axis))


def joined_phase_budgets(found: Sequence[PhaseBudget], axis: int = 0) -> PhaseBudget:
    """Budgets one behind the other along an axis that they have.

    Args:
        found: Budgets of the same legs.
        axis: The axis.
    """
    return _combined(found, lambda rows: np.concatenate(rows, axis=axis))


def _combined(found: Sequence[PhaseBudget], join: Callable[[list[Any]], Any]) -> PhaseBudget:
    budget = DriveBudget(
        **{
            part.name: join([getattr(one.budget, part.name) for one in found])
            for part in fields(DriveBudget)
        }
    )
    names = ("leg_loss", "leg_temperature", "neutral_current", "neutral_ripple", "link_demand")
    rest = {name: join([getattr(one, name) for one in found]) for name in names}
    return PhaseBudget(budget=budget, legs=found[0].legs, **rest)


# The loss comparison at the operating points that a design names: every strategy with every
# modulator.
#
# The currents and budgets are those of loss maps (`compare_drives`): the field is weakened within
# the linear range of each modulator. A strategy that cannot make a point has no losses there and
# takes no part in the choice of the best.

# What the total counts; the bridge is left out where nothing is known of its switch.
LossScope = Literal["drive", "without-bridge"]


@dataclass(frozen=True, slots=True)
class LossComparison:
    """Losses of S strategies with M modulators at P operating points.

    Args:
        strategies, modulations, points: Labels of the three axes.
        budget: Losses, arrays of the shape (S, M, P); NaN where the torque is out of reach.
        reached: Whether the strategy makes the torque within its limits, shape (S, M, P).
        most: Torque in N m that is made there, shape (S, M, P): what is asked for, or as near as
            the limits allow.
        saving: Total loss saved, in percent of that of the first strategy with the first modulator,
            shape (S, M, P); NaN where either of the two is not feasible or the first has no loss,
            and of other modulators where these are not compared.
        best_strategy, best_modulation: Indices of the feasible alternative with the least total
            loss, shape (P,), or -1 where none is feasible. Of equally good alternatives the first,
            in the order of the labels. None where modulators are not compared.
        scope: What the total counts.
        legs: Half bridges and neutral of a machine with any back-EMF, arrays (S, M, P) and (S, M,
            P, L) as in `PhaseBudget`; None for others.
    """

    strategies: tuple[AnyStrategy, ...]
    modulations: tuple[ModulationName, ...]
    points: tuple[LoadPoint, ...]
    budget: DriveBudget
    reached: BoolArray
    most: FloatArray
    saving: FloatArray
    best_strategy: NDArray[np.intp]
    best_modulation: NDArray[np.intp]
    scope: LossScope = "drive"
    legs: PhaseBudget | None = None

    @property
    def usable(self) -> BoolArray:
        """True where the torque is made, the voltage can be, and every temperature is steady and
        permitted.
        """
        return self.reached & self.budget.feasible

    @property
    def compared(self) -> bool:
        """Whether the totals say which alternative loses least: without the bridge only those of
        one modulator do.
        """
        return self.scope == "drive" or len(self.modulations) == 1

    @property
    def best_labels(self) -> tuple[tuple[AnyStrategy, ModulationName] | None, ...]:
        """Strategy and modulator with the least total loss at each point, or
        None where none is feasible.
        """
        indices = zip(self.best_strategy.tolist(), self.best_modulation.tolist(), strict=True)
        return tuple(
            (self.strategies[s], self.modulations[m]) if s >= 0 else None for s, m in indices
        )


def compare_points(
    machine: Machine,
    inverter: Inverter,
    losses: LossSettings,
    *,
    i_max: float,
    options: BudgetOptions | None = None,
    margin: float = 0.0,
    phases: AnyPhaseMachine | None = None,
) -> LossComparison:
    """Complete budgets of every strategy with every modulator at every point.

    Args:
        machine, inverter: The drive; without a device the bridge is left out of the total.
        losses: Operating points, strategies and modulators.
        i_max: Current limit in A (peak).
        options: What is counted beside copper, conduction and switching loss.
        margin: Share of the voltage that is kept free for control.
        phases: The machine in phase quantities where its back-EMF has any shape: its rules take the
            place of strategies, its topology that of three legs.
    """
    torque = np.array([point.torque for point in losses.points])
    omega_m = np.array([point.omega_m for point in losses.points])
    alternatives = Alternatives(losses.strategies, losses.modulations, (inverter.f_sw,))
    legs: PhaseBudget | None = None
    if phases is None:
        found = compare_drives(
            machine,
            inverter,
            torque,
            omega_m,
            alternatives,
            i_max=i_max,
            options=options,
            margin=margin,
        )
    else:
        chosen = BudgetOptions() if options is None else options
        drive = PhaseDrive(phases, machine, inverter, i_max, chosen, margin)
        both = compare_phases(drive, torque, omega_m, alternatives)
        found, legs = both.drives, both.legs
    labels = found.alternatives
    reached = found.reached[:, :, 0]
    made = found.budget.torque[:, :, 0]
    budget = _point_comparison_blanked(found.budget, reached)
    total = np.where(reached & budget.feasible, budget.total, np.inf)
    saving = _saving(total)
    if not found.compared:
        saving[:, 1:] = np.nan
    best = least(np.where(found.compared, total, np.inf)[:, :, None])
    count = len(labels.modulations)
    return LossComparison(
        strategies=labels.strategies,
        modulations=labels.modulations,
        points=losses.points,
        budget=budget,
        reached=reached,
        most=made,
        saving=saving,
        best_strategy=np.where(best >= 0, best // count, -1),
        best_modulation=np.where(best >= 0, best % count, -1),
        scope="drive" if inverter.device is not None else "without-bridge",
        legs=None if legs is None else _of_one_frequency(legs, budget, reached),
    )


def _of_one_frequency(legs: PhaseBudget, budget: DriveBudget, reached: BoolArray) -> PhaseBudget:
    """Legs (S, M, 1, P, ...) as (S, M, P, ...), NaN where the torque is out of reach."""

    def kept(values: FloatArray) -> FloatArray:
        one = values[:, :, 0]
        mark = reached if one.ndim == reached.ndim else reached[..., None]
        return np.where(mark, one, np.nan)

    return PhaseBudget(
        budget=budget,
        legs=legs.legs,
        leg_loss=kept(legs.leg_loss),
        leg_temperature=kept(legs.leg_temperature),
        neutral_current=kept(legs.neutral_current),
        neutral_ripple=kept(legs.neutral_ripple),
        link_demand=kept(legs.link_demand),
    )


def _point_comparison_blanked(budget: DriveBudget, reached: BoolArray) -> DriveBudget:
    """Budgets (S, M, 1, P) as (S, M, P), with NaN for the numbers of points that are out of
    reach.
    """
    columns: dict[str, Any] = {}
    for part in fields(DriveBudget):
        values = getattr(budget, part.name)[:, :, 0]
        columns[part.name] = (
            values if values.dtype == np.bool_ else np.where(reached, values, np.nan)
        )
    return DriveBudget(**columns)


def _saving(total: FloatArray) -> FloatArray:
    """Compute the saving in percent of the first alternative.

    Total loss (S, M, P), infinite where not feasible.
    """
    first = np.broadcast_to(total[:1, :1], total.shape)
    valid = np.isfinite(total) & np.isfinite(first) & (first > 0.0)
    return np.where(
        valid, 100.0 * (1.0 - np.where(valid, total, 0.0) / np.where(valid, first, 1.0)), np.nan
    )
