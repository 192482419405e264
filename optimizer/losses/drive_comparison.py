"""Strategies, modulators and carrier frequencies compared at any number of
points of torque and speed.

The currents are those that the reference of a strategy produces within the limits: field weakening
for the linear range of each modulator, less what dead time takes of it at each frequency, with what
AC resistance, iron and a warm winding add to the voltage. Each point names the alternative that
loses least there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import AnyStrategy
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.bridge_tables import (
    BridgeTables,
    JunctionNetworks,
    at_temperature,
    junction_history,
    junction_networks,
)
from dqforge.machines.losses.machine_budget import (
    MachineBudget,
    Mission,
    WindingHeat,
    machine_budget,
)
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import amplitude_limit
from dqforge.optimizer.losses.drive_budget import (
    PARTS,
    BudgetOptions,
    DriveBudget,
    drive_budget,
    harmonic_square,
    known_bridge,
    stacked_budgets,
    switched_iron,
    waveform_averages,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.mtpa_locus import LossCoefficients
from dqforge.optimizer.operating_points.points import loss_coefficients, optimal_points

_EQUAL_LOSS = 1e-9
_WARM = 100.0  # Junction temperature in degC at which ``least-loss`` takes the on resistance.

# Excess of the voltage that is corrected, and by how much the correction goes further.
ROUNDS = 6
EXCESS, AIM = 1e-7, 1e-6


@dataclass(frozen=True, slots=True)
class Alternatives:
    """What is compared: S strategies, M modulators, F carrier frequencies in Hz."""

    strategies: tuple[AnyStrategy, ...]
    modulations: tuple[ModulationName, ...]
    frequencies: tuple[float, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(S, M, F)."""
        return len(self.strategies), len(self.modulations), len(self.frequencies)

    def label(self, index: int) -> tuple[AnyStrategy, ModulationName, float]:
        """Strategy, modulator and frequency of a flat index."""
        s, m, f = np.unravel_index(index, self.shape)
        return self.strategies[int(s)], self.modulations[int(m)], self.frequencies[int(f)]


@dataclass(frozen=True, slots=True)
class DriveComparison:
    """Budgets of all alternatives at P points.

    Args:
        alternatives: Labels of the first three axes.
        torque, omega_m: What is asked for, in N m and rad/s, shape (P,).
        budget: Arrays of the shape (S, M, F, P).
        reached: Whether the currents make the torque within the limits, shape (S, M, F, P).
        best: Flat index of the usable alternative that loses least, shape (P,), or -1; of equal
            ones the first.
        compared: Whether the totals say who loses least, as `compares`; ``best`` is -1 otherwise.
    """

    alternatives: Alternatives
    torque: FloatArray
    omega_m: FloatArray
    budget: DriveBudget
    reached: BoolArray
    best: NDArray[np.intp]
    compared: bool = True

    @property
    def usable(self) -> BoolArray:
        """Where an alternative makes the torque, its voltage can be made and its
        temperatures are permitted.
        """
        return self.reached & self.budget.feasible


def strategy_currents(
    machine: Machine,
    strategy: AnyStrategy,
    torque: FloatArray,
    omega_m: FloatArray,
    *,
    v_max: float,
    i_max: float,
    options: BudgetOptions,
    loss: LossCoefficients | None = None,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Currents (i_d, i_q) in A of a strategy, and whether they make the torque, shape (P,) each.

    Args:
        machine, strategy: The machine and how its currents are chosen.
        torque, omega_m: In N m and rad/s, shape (P,).
        v_max, i_max: Limits in V (phase amplitude) and A (peak).
        options: What else drops voltage; the field is weakened for it, too.
        loss: What ``least-loss`` minimises.
    """
    if strategy == "id0":
        if machine.psi_pm == 0.0:
            return np.zeros(torque.shape), np.zeros(torque.shape), torque == 0.0
        points = CurrentChoice(machine, "id0", i_max).points(torque)
        return points.i_d, points.i_q, ~points.limited
    volts = np.full(torque.shape, v_max)
    found = optimal_points(machine, torque, omega_m, v_max=volts, i_max=i_max, loss=loss)
    i_d, i_q, reached = found.i_d.copy(), found.i_q.copy(), found.reached.copy()
    for _ in range(ROUNDS):
        made = machine_budget(
            machine, i_d, i_q, omega_m, loss=options.machine_loss, heat=options.winding
        )
        amplitude = np.hypot(made.v_d, made.v_q)
        (over,) = np.nonzero(made.steady & (amplitude > v_max * (1.0 + EXCESS)))
        if not over.size:
            break
        volts[over] *= v_max / amplitude[over] * (1.0 - AIM)
        part = None if loss is None else loss.spread(torque.shape).take(over)
        again = optimal_points(
            machine, torque[over], omega_m[over], v_max=volts[over], i_max=i_max, loss=part
        )
        i_d[over], i_q[over], reached[over] = again.i_d, again.i_q, again.reached
    return i_d, i_q, reached


def compare_drives(
    machine: Machine,
    inverter: Inverter,
    torque: ArrayLike,
    omega_m: ArrayLike,
    alternatives: Alternatives,
    *,
    i_max: float,
    options: BudgetOptions | None = None,
    margin: float = 0.0,
) -> DriveComparison:
    """Budgets of every strategy with every modulator at every frequency, at P points.

    Args:
        machine, inverter: The drive; the inverter with a device.
        torque, omega_m: In N m and rad/s, shape (P,) each.
        alternatives: What is compared.
        i_max: Current limit in A (peak).
        options: What else is counted.
        margin: Share of the voltage that is kept free for control.

    Raises:
        InputError: There is nothing to compare, or a strategy cannot drive the machine.
    """
    if 0 in alternatives.shape:
        raise InputError(
            "loss comparison: give a strategy, a modulator and a switching frequency at least"
        )
    wanted, speed = np.broadcast_arrays(
        np.asarray(torque, np.float64), np.asarray(omega_m, np.float64)
    )
    wanted, speed = wanted.ravel(), speed.ravel()
    chosen = BudgetOptions() if options is None else options
    budgets, reached = [], []
    for strategy in alternatives.strategies:
        parts = _strategy(
            machine, inverter, wanted, speed, strategy, alternatives, i_max, chosen, margin
        )
        budgets.append(parts[0])
        reached.append(parts[1])
    budget = stacked_budgets(budgets, 0)
    made, compared = np.stack(reached), compares(inverter, alternatives)
    total = np.where(made & budget.feasible & compared, budget.total, np.inf)
    return DriveComparison(alternatives, wanted, speed, budget, made, least(total), compared)


def compares(inverter: Inverter, alternatives: Alternatives) -> bool:
    """Whether totals say which alternative loses least.

    Without a device the losses by which modulators and frequencies differ most are unknown;
    strategies with one modulator at one frequency are compared all the same.

    Args:
        inverter: The bridge.
        alternatives: What is compared.
    """
    _, modulations, frequencies = alternatives.shape
    return inverter.device is not None or (modulations == 1 and frequencies == 1)


def dead_time_share(inverter: Inverter, alternatives: Alternatives) -> tuple[float, float]:
    """Least and largest share of the linear range that dead time takes of the alternatives.

    Args:
        inverter: Dead time in s.
        alternatives: Modulators and carrier frequencies in Hz.
    """
    kept = [
        float(dead_time_factor(name, inverter.dead_time, frequency))
        for name in alternatives.modulations
        for frequency in alternatives.frequencies
    ]
    return 1.0 - max(kept), 1.0 - min(kept)


def least(total: FloatArray) -> NDArray[np.intp]:
    """Flat index over the first three axes of the least total (S, M, F, P), shape (P,);
    -1 where all are infinite.

    Of values that differ by rounding alone the first is taken.
    """
    flat = total.reshape(-1, total.shape[-1])
    smallest = np.min(flat, axis=0)
    first = np.argmax(flat <= smallest * (1.0 + _EQUAL_LOSS), axis=0)
    return np.where(np.isfinite(smallest), first, -1)


def _strategy(
    machine: Machine,
    inverter: Inverter,
    torque: FloatArray,
    omega_m: FloatArray,
    strategy: AnyStrategy,
    alternatives: Alternatives,
    i_max: float,
    options: BudgetOptions,
    margin: float,
) -> tuple[DriveBudget, BoolArray]:
    """Budgets (M, F, P) of one strategy, and where its currents make the torque."""
    names, frequencies = alternatives.modulations, alternatives.frequencies
    if strategy != "least-loss" and inverter.dead_time == 0.0:
        i_d, i_q, made = _currents(
            machine, inverter, torque, omega_m, strategy, names, i_max, options, margin
        )
        budget = drive_budget(
            machine, inverter, i_d, i_q, omega_m, names, frequencies, options=options
        )
        return budget, np.repeat(made[:, None], len(frequencies), axis=1)
    budgets, reached = [], []
    for frequency in frequencies:
        carried = _at_frequency(inverter, frequency)
        i_d, i_q, made = _currents(
            machine, carried, torque, omega_m, strategy, names, i_max, options, margin
        )
        budgets.append(drive_budget(machine, carried, i_d, i_q, omega_m, names, options=options))
        reached.append(made)
    return _joined(budgets), np.stack(reached, axis=1)


def usable_limit(inverter: Inverter, name: ModulationName, margin: float = 0.0) -> float:
    """Largest phase amplitude in V: linear range of topology and modulator less dead time
    and a margin (0 to 1) for control.

    Args:
        inverter: Topology, DC link, carrier frequency and dead time.
        name: The modulator.
        margin: Share of 0 to 1 that is kept for control.
    """
    left = float(dead_time_factor(name, inverter.dead_time, inverter.f_sw))
    return amplitude_limit(inverter, name) * left * (1.0 - margin)


def _currents(
    machine: Machine,
    inverter: Inverter,
    torque: FloatArray,
    omega_m: FloatArray,
    strategy: AnyStrategy,
    names: Sequence[ModulationName],
    i_max: float,
    options: BudgetOptions,
    margin: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Currents (M, P) of one strategy at the inverter's frequency, and where they make the
    torque.
    """
    rows: dict[tuple[float, ModulationName | None], tuple[FloatArray, FloatArray, BoolArray]] = {}
    keys = []
    for name in names:
        v_max = usable_limit(inverter, name, margin)
        # What least loss minimises depends on the modulator, the others on its limit alone.
        key = (v_max, name if strategy == "least-loss" else None)
        keys.append(key)
        if key in rows:
            continue
        loss = None
        if strategy == "least-loss":
            loss = loss_coefficients(
                machine,
                omega_m,
                inverter,
                extra=options.machine_loss,
                modulation=name,
                junction_temperature=_WARM,
            )
        rows[key] = strategy_currents(
            machine, strategy, torque, omega_m, v_max=v_max, i_max=i_max, options=options, loss=loss
        )
    i_d, i_q = (np.stack([rows[key][k] for key in keys]) for k in (0, 1))
    return i_d.astype(np.float64), i_q.astype(np.float64), np.stack([rows[key][2] for key in keys])


def _at_frequency(inverter: Inverter, frequency: float) -> Inverter:
    from dataclasses import replace

    return replace(inverter, f_sw=frequency)


def _joined(budgets: Sequence[DriveBudget]) -> DriveBudget:
    """Budgets (M, 1, P) of single frequencies as one (M, F, P)."""
    names = [part.name for part in fields(DriveBudget)]
    return DriveBudget(
        **{name: np.concatenate([getattr(b, name) for b in budgets], axis=1) for name in names}
    )


# Energy over a mission by kind of loss, and junction temperatures over its time,
# for every alternative.

_ROUNDS = 60


_VOLTAGE_ROUNDING = 1e-6


@dataclass(frozen=True, slots=True)
class MissionRun:
    """One alternative over a mission of N intervals.

    Args:
        strategy, modulation, frequency: The alternative, the frequency in Hz.
        energy: Losses in J by the kinds of `PARTS`.
        driving, braking: Shaft work in J given out, and taken in (negative).
        input_energy: From the DC source in J.
        junction_max, swing: Largest junction temperature in degC, and largest less smallest of any
            junction in K, over the mission; NaN where nothing is known of the switch.
        winding_temperature: Of the mean copper loss of the mission, in degC; NaN where nothing is
            known of the winding's heat.
        missed: Lines of the file whose torque or voltage is out of reach.
        steady, cool_enough: False where the junctions run away, or become hotter than permitted.
        within_tables: False where device tables were carried on beyond their ends.
        time, junction: Course of the hottest junction: s and degC, shape (2 N,), each interval with
            its start and end.
    """

    strategy: AnyStrategy
    modulation: ModulationName
    frequency: float
    energy: dict[str, float]
    driving: float
    braking: float
    input_energy: float
    junction_max: float
    swing: float
    winding_temperature: float
    missed: NDArray[np.intp]
    steady: bool
    cool_enough: bool
    within_tables: bool
    time: FloatArray
    junction: FloatArray

    @property
    def total(self) -> float:
        """All losses in J."""
        return float(sum(self.energy.values()))

    @property
    def usable(self) -> bool:
        """Whether the whole mission is driven at permitted temperatures."""
        return self.steady and self.cool_enough and self.missed.size == 0


@dataclass(frozen=True, slots=True)
class MissionComparison:
    """All alternatives over one mission.

    ``best`` is the index of the usable run that loses least, or -1, also where the totals do not
    say it (``compared``, as `compares`).

    ``dead_time_share`` is what dead time takes of the linear range,
    least and most of the alternatives.
    """

    mission: Mission
    alternatives: Alternatives
    runs: tuple[MissionRun, ...]
    best: int
    dead_time_share: tuple[float, float]
    compared: bool = True


@dataclass(frozen=True, slots=True)
class _Drive:
    machine: Machine
    inverter: Inverter
    tables: BridgeTables
    networks: JunctionNetworks
    options: BudgetOptions
    mission: Mission
    i_max: float
    margin: float
    repeated: bool


def compare_mission(
    machine: Machine,
    inverter: Inverter,
    mission: Mission,
    alternatives: Alternatives,
    *,
    i_max: float,
    options: BudgetOptions | None = None,
    margin: float = 0.0,
    repeated: bool = True,
) -> MissionComparison:
    """Run a mission with every alternative.

    Args:
        machine, inverter: The drive; without a device the bridge counts as lossless. Junctions
            follow the networks of its device; what lies behind the case has no capacity.
        mission: Torque and speed over time. Where a torque cannot be had, the largest is driven,
            and its line listed.
        alternatives: What is compared.
        i_max: Current limit in A (peak).
        options: What else is counted. The winding takes the temperature of the mean copper loss
            over the mission.
        margin: Share of the voltage kept free for control.
        repeated: Whether the mission begins as warm as it ends, or at the coolant's temperature.

    Raises:
        InputError: There is nothing to compare, or a strategy cannot drive the machine.
        NoSolutionError: The winding temperature runs away.
    """
    if 0 in alternatives.shape:
        raise InputError(
            "loss comparison: give a strategy, a modulator and a switching frequency at least"
        )
    chosen = BudgetOptions() if options is None else options
    tables = known_bridge(inverter)
    networks = junction_networks(inverter, tables)
    drive = _Drive(machine, inverter, tables, networks, chosen, mission, i_max, margin, repeated)
    runs = []
    for strategy in alternatives.strategies:
        for name in alternatives.modulations:
            runs += _runs(drive, strategy, name, alternatives.frequencies)
    return mission_comparison(mission, inverter, alternatives, runs)


def mission_comparison(
    mission: Mission, inverter: Inverter, alternatives: Alternatives, runs: Sequence[MissionRun]
) -> MissionComparison:
    """Runs of all alternatives in their order, with the one that loses least.

    Args:
        mission: What was driven.
        inverter: Whose bridge it was; where it is unknown no alternative is the best.
        alternatives: Strategies, modulators and frequencies.
        runs: One per alternative.
    """
    compared = compares(inverter, alternatives)
    totals = np.array([run.total if run.usable and compared else np.inf for run in runs])
    best = int(least(totals.reshape(*alternatives.shape, 1))[0])
    taken = dead_time_share(inverter, alternatives)
    return MissionComparison(mission, alternatives, tuple(runs), best, taken, compared)


def _runs(
    drive: _Drive, strategy: AnyStrategy, name: ModulationName, frequencies: tuple[float, ...]
) -> list[MissionRun]:
    """All frequencies of one strategy with one modulator.

    They share currents and averages where they can.
    """
    if strategy == "least-loss" or drive.inverter.dead_time > 0.0:
        return [run for f in frequencies for run in _shared(drive, strategy, name, (f,))]
    return _shared(drive, strategy, name, frequencies)


def _shared(
    drive: _Drive, strategy: AnyStrategy, name: ModulationName, frequencies: tuple[float, ...]
) -> list[MissionRun]:
    found, reached, options = _machine_side(drive, strategy, name, frequencies[0])
    voltage = np.hypot(found.v_d, found.v_q) * (1.0 - _VOLTAGE_ROUNDING)
    made = reached & (voltage <= usable_limit(replace(drive.inverter, f_sw=frequencies[0]), name))
    average = waveform_averages(drive.machine, drive.inverter, drive.tables, found, name, options)
    low_square = harmonic_square(
        drive.machine, drive.inverter, found, drive.mission.omega_m, name, options
    )
    missed = drive.mission.lines[~made]
    length, tables, v_dc = drive.mission.length, drive.tables, drive.inverter.v_dc
    link = v_dc * average.dc_current
    square = np.maximum(average.dc_square - average.dc_current**2, 0.0)
    winding = drive.options.winding
    warm = (
        np.nan
        if winding is None or options.winding is None
        else options.winding.coolant_temperature
    )
    runs = []
    for frequency in frequencies:
        parts = {
            "conduction": average.conduction,
            "switching": average.switching * frequency,
            "dead_time": average.dead * (drive.inverter.dead_time * frequency),
        }
        history = junction_history(
            tables,
            drive.networks,
            sum(parts.values(), np.zeros(1)),
            length,
            repeated=drive.repeated,
        )
        bridge = {
            part: 3.0
            * np.sum(at_temperature(tables.temperatures, value, history.mean), axis=(0, 1))
            for part, value in parts.items()
        }
        ripple = (
            average.ripple
            * (v_dc / frequency) ** 2
            * 3.0
            * found.resistance
            * (options.ripple_resistance or 0.0)
        )
        ripple = ripple + 3.0 * found.resistance * low_square
        powers = bridge | {
            "copper": found.copper,
            "ripple_copper": ripple,
            "iron": found.iron,
            "ripple_iron": switched_iron(
                options, np.hypot(found.v_d, found.v_q), v_dc, np.array(frequency)
            ),
            "magnet": found.magnet,
            "capacitor": options.capacitor_esr * square,
        }
        put_in = (
            link
            + ripple
            + powers["ripple_iron"]
            + powers["capacitor"]
            + sum(bridge.values(), np.zeros(1))
        )
        both = np.stack([history.start, history.end], axis=-1)
        swing = np.max(both, axis=(2, 3)) - np.min(both, axis=(2, 3))
        known = drive.inverter.device is not None
        hottest = np.max(both, axis=(0, 1)) if known else np.full(both.shape[2:], np.nan)
        low, high = tables.temperature_reach
        size = float(np.max(np.hypot(found.i_d, found.i_q)))
        inside = size <= tables.current_reach and bool(
            np.min(both) >= low - 1e-9 and np.max(both) <= high + 1e-9
        )
        peak = float(np.max(both))
        runs.append(
            MissionRun(
                strategy,
                name,
                frequency,
                energy={part: float(np.sum(length * powers[part])) for part in PARTS},
                driving=float(np.sum(length * np.maximum(found.shaft_power, 0.0))),
                braking=float(np.sum(length * np.minimum(found.shaft_power, 0.0))),
                input_energy=float(np.sum(length * put_in)),
                junction_max=peak if known else np.nan,
                swing=float(np.max(swing)) if known else np.nan,
                winding_temperature=float(warm),
                missed=missed,
                steady=history.steady,
                cool_enough=bool(peak <= tables.max_junction_temperature),
                within_tables=inside,
                time=np.stack([drive.mission.time[:-1], drive.mission.time[1:]], axis=-1).ravel(),
                junction=hottest.ravel(),
            )
        )
    return runs


def _machine_side(
    drive: _Drive, strategy: AnyStrategy, name: ModulationName, frequency: float
) -> tuple[MachineBudget, NDArray[np.bool_], BudgetOptions]:
    """Machine at all intervals, what torque is made, and the options with the winding
    as warm as its mean loss.
    """
    options, mission, machine = drive.options, drive.mission, drive.machine
    v_max = usable_limit(replace(drive.inverter, f_sw=frequency), name, drive.margin)
    heat, temperature = options.winding, np.nan
    for _ in range(_ROUNDS):
        if heat is not None:
            temperature = heat.coolant_temperature if np.isnan(temperature) else temperature
            # A winding without thermal resistance to a coolant as warm as the winding:
            # its temperature is given.
            options = replace(options, winding=held_winding(heat, temperature))
        loss = None
        if strategy == "least-loss":
            carried = replace(drive.inverter, f_sw=frequency)
            loss = loss_coefficients(
                machine,
                mission.omega_m,
                carried,
                extra=options.machine_loss,
                modulation=name,
                junction_temperature=_WARM,
            )
        i_d, i_q, reached = strategy_currents(
            machine,
            strategy,
            mission.torque,
            mission.omega_m,
            v_max=v_max,
            i_max=drive.i_max,
            options=options,
            loss=loss,
        )
        found = machine_budget(
            machine, i_d, i_q, mission.omega_m, loss=options.machine_loss, heat=options.winding
        )
        if heat is None:
            return found, reached, options
        mean = float(np.sum(found.copper * mission.length)) / float(np.sum(mission.length))
        warmer = heat.coolant_temperature + heat.thermal_resistance * mean
        if abs(warmer - temperature) < 1e-6:
            return found, reached, options
        temperature = warmer
        if not temperature < 1e4:
            break
    raise NoSolutionError(
        f"{mission.source}: the mean copper loss of the mission leaves the winding no steady "
        "temperature; lower the thermal resistance or the torque"
    )


def held_winding(heat: WindingHeat, temperature: float) -> WindingHeat:
    """A winding that stays at a temperature in degC.

    Args:
        heat: Coefficient and reference of its resistance.
        temperature: In degC.
    """
    return replace(heat, thermal_resistance=0.0, coolant_temperature=temperature)
