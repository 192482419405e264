"""Losses of alternatives over a map of torque and speed, and of a phase machine over a mission."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import AnyStrategy
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.bridge_tables import (
    BridgeTables,
    JunctionHistory,
    JunctionNetworks,
    at_temperature,
    junction_history,
    junction_networks,
)
from dqforge.machines.losses.machine_budget import Mission
from dqforge.machines.losses.phase_terminals import phase_terminals
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.losses.drive_budget import PARTS, BudgetOptions, known_bridge
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    DriveComparison,
    MissionComparison,
    MissionRun,
    compare_drives,
    dead_time_share,
    held_winding,
    mission_comparison,
    usable_limit,
)
from dqforge.optimizer.losses.phase_comparison import (
    CENTRED,
    PhaseDrive,
    averages_of_legs,
    compare_phases,
    phase_budget,
    phase_rows,
    rule_currents,
)
from dqforge.optimizer.operating_points.characteristics import (
    VoltageLimit,
    characteristics,
    fastest_speed,
    voltage_limit,
)


@dataclass(frozen=True, slots=True)
class LossMap:
    """A comparison of A alternatives over N torques in N m and M mechanical speeds in rad/s.

    Its points run row by row, P = N M. ``dead_time_share`` is what dead time takes of the linear
    range, least and most of the alternatives.
    """

    torque: FloatArray
    omega_m: FloatArray
    comparison: DriveComparison
    dead_time_share: tuple[float, float]

    @property
    def usable(self) -> BoolArray:
        """Where each alternative drives the point within all limits, shape (A, P)."""
        return self.comparison.usable.reshape(-1, self.comparison.torque.size)

    @property
    def shared(self) -> BoolArray:
        """Points that all alternatives drive, shape (P,); those that drive none do not count."""
        somewhere = np.any(self.usable, axis=1)
        points = np.zeros(self.comparison.torque.size, dtype=np.bool_)
        return np.all(self.usable[somewhere], axis=0) if np.any(somewhere) else points

    @property
    def mean_losses(self) -> FloatArray:
        """Mean losses in W by kind over the shared points, shape (parts, A);
        NaN where there is no such point.
        """
        somewhere, shared = np.any(self.usable, axis=1), self.shared
        columns = []
        for part in PARTS:
            values = getattr(self.comparison.budget, part).reshape(self.usable.shape)
            mean = (
                np.mean(values[:, shared], axis=1)
                if np.any(shared)
                else np.full(somewhere.size, np.nan)
            )
            columns.append(np.where(somewhere, mean, np.nan))
        return np.stack(columns)

    @property
    def hottest_junction(self) -> FloatArray:
        """Largest junction temperature in degC where each alternative is usable, shape (A,);
        -inf where nowhere.
        """
        return self._largest(self.comparison.budget.junction_temperature)

    @property
    def largest_ripple(self) -> FloatArray:
        """Largest ripple current in A where each alternative is usable, shape (A,);
        -inf where nowhere.
        """
        return self._largest(self.comparison.budget.ripple_current)

    def _largest(self, values: FloatArray) -> FloatArray:
        return np.asarray(
            np.max(values.reshape(self.usable.shape), axis=1, initial=-np.inf, where=self.usable)
        )

    @property
    def least_share(self) -> FloatArray:
        """Share of the points at which each alternative loses least, shape (A,)."""
        best = self.comparison.best
        return np.bincount(best[best >= 0], minlength=self.usable.shape[0]) / best.size


def budget_options(design: Design) -> BudgetOptions:
    """What the design says of losses beside those of the fundamental."""
    return BudgetOptions(design.machine_loss, design.winding, design.inverter.capacitor_esr)


def _widest(inverter: Inverter, alternatives: Alternatives, margin: float) -> VoltageLimit:
    """Largest limit that one of the alternatives has, dead time and margin taken off."""
    slowest = replace(inverter, f_sw=min(alternatives.frequencies))
    widest = max(alternatives.modulations, key=lambda name: usable_limit(slowest, name))
    taken = 1.0 - usable_limit(slowest, widest, margin) / voltage_limit(inverter, widest).v_max
    return voltage_limit(inverter, widest, taken)


def solve_map(
    design: Design, alternatives: Alternatives, margin: float, torques: int, speeds: int
) -> LossMap:
    """Compare over the motoring quadrant, up to the most torque and the largest
    speed of the best modulator.

    Args:
        design: The design.
        alternatives: Strategies, modulators and frequencies.
        margin: Share of the voltage of 0 to 1 that is kept for control.
        torques, speeds: Numbers of torques and speeds.
    """
    limit = _widest(design.inverter, alternatives, margin)
    figures = characteristics(design.machine, limit.v_max, design.i_max)
    fastest = fastest_speed(design.machine, figures, limit, design.i_max)
    torque = np.linspace(0.0, figures.torque_max, torques + 1)[1:]
    omega = np.linspace(0.0, fastest, speeds + 1)[1:]
    wanted, speed = np.meshgrid(torque, omega, indexing="ij")
    comparison = compare_alternatives(design, wanted.ravel(), speed.ravel(), alternatives, margin)
    return LossMap(
        torque, omega, comparison, dead_time_share(design.inverter, comparison.alternatives)
    )


def compare_alternatives(
    design: Design,
    torque: FloatArray,
    omega_m: FloatArray,
    alternatives: Alternatives,
    margin: float,
) -> DriveComparison:
    """Budgets of a design's machine by all alternatives, P points.

    Args:
        design: The design; one with any back-EMF is compared by the rules of its phase currents.
        torque, omega_m: In N m and rad/s, shape (P,).
        alternatives: Strategies, modulators and frequencies.
        margin: Share of the voltage of 0 to 1 that is kept for control.
    """
    options = budget_options(design)
    if design.phase_machine is not None:
        drive = PhaseDrive(
            design.phase_machine, design.machine, design.inverter, design.i_max, options, margin
        )
        return compare_phases(drive, torque, omega_m, alternatives).drives
    return compare_drives(
        design.machine,
        design.inverter,
        torque,
        omega_m,
        alternatives,
        i_max=design.i_max,
        options=options,
        margin=margin,
    )


# Energy of a phase machine's drive over a mission: every leg with the history of its junctions.
#
# What `compare_mission` is for dq machines, with the rules of `phase_comparison`. A junction
# follows the losses of its own leg, so that the neutral's is the coldest.

_ROUNDS = 60


_STILL = 1e-6


_HOTTEST = 1e4


@dataclass(frozen=True, slots=True)
class _Bridge:
    tables: BridgeTables
    networks: JunctionNetworks
    mission: Mission
    repeated: bool


def compare_phase_mission(
    drive: PhaseDrive, mission: Mission, alternatives: Alternatives, *, repeated: bool = True
) -> MissionComparison:
    """Run a mission with every rule, modulator and frequency.

    Args:
        drive: Machine, inverter and limits.
        mission: Torque and speed over time. Where a torque cannot be had, the largest of the rule
            is driven (none by ``limited``), and its line listed.
        alternatives: What a design names; its strategies become rows by `phase_rows`.
        repeated: Whether the mission begins as warm as it ends, or at the coolant's temperature.

    Raises:
        NoSolutionError: The winding temperature runs away.
    """
    names = alternatives.modulations
    if not TOPOLOGIES[drive.inverter.topology].modulated:
        names = (CENTRED,)
    rows = phase_rows(drive, alternatives.strategies)
    labels = Alternatives(rows, names, alternatives.frequencies)
    tables = known_bridge(drive.inverter)
    bridge = _Bridge(tables, junction_networks(drive.inverter, tables), mission, repeated)
    runs = [
        _run(drive, bridge, strategy, name, frequency)
        for strategy in labels.strategies
        for name in labels.modulations
        for frequency in labels.frequencies
    ]
    return mission_comparison(mission, drive.inverter, labels, runs)


def _warm_options(
    drive: PhaseDrive, mission: Mission, currents: FloatArray
) -> tuple[BudgetOptions, float]:
    """Options with the winding as warm as its mean loss over the mission, and that in degC."""
    heat, options = drive.options.winding, drive.options
    if heat is None:
        return options, np.nan
    temperature = heat.coolant_temperature
    for _ in range(_ROUNDS):
        options = replace(options, winding=held_winding(heat, temperature))
        found = phase_terminals(
            drive.machine,
            currents,
            mission.omega_m,
            drive.inverter.topology,
            loss=options.machine_loss,
            heat=options.winding,
        )
        mean = float(np.sum(found.copper * mission.length)) / float(np.sum(mission.length))
        warmer = heat.coolant_temperature + heat.thermal_resistance * mean
        if abs(warmer - temperature) < _STILL:
            return options, temperature
        temperature = warmer
        if not temperature < _HOTTEST:
            break
    raise NoSolutionError(
        f"{mission.source}: the mean copper loss of the mission leaves the winding no steady "
        "temperature; lower the thermal resistance or the torque"
    )


def _run(
    drive: PhaseDrive,
    bridge: _Bridge,
    strategy: AnyStrategy,
    name: ModulationName,
    frequency: float,
) -> MissionRun:
    """One rule with one modulator at one frequency."""
    mission, inverter = bridge.mission, replace(drive.inverter, f_sw=frequency)
    asked, kept = rule_currents(drive, strategy, mission.torque, mission.omega_m, frequency)
    currents = np.nan_to_num(asked)
    options, warm = _warm_options(drive, mission, currents)
    budget = phase_budget(
        drive.machine,
        inverter,
        currents,
        mission.omega_m,
        modulation=name,
        options=options,
        friction=drive.fundamental.friction,
    ).budget
    average = averages_of_legs(
        drive.machine, inverter, currents, mission.omega_m, modulation=name, options=options
    )
    gap = inverter.dead_time * frequency
    parts = {
        "conduction": average.conduction,
        "switching": average.switching * frequency,
        "dead_time": average.dead * gap,
    }
    loss = sum(parts.values(), np.zeros(1))
    legs = range(loss.shape[-1])
    histories = [
        junction_history(
            bridge.tables,
            bridge.networks,
            loss[..., leg],
            mission.length,
            repeated=bridge.repeated,
        )
        for leg in legs
    ]
    knots = bridge.tables.temperatures
    made = {
        part: sum(
            np.sum(at_temperature(knots, values[..., leg], histories[leg].mean), axis=(0, 1))
            for leg in legs
        )
        for part, values in parts.items()
    }
    powers = {part: np.asarray(made.get(part, getattr(budget, part)[0])) for part in PARTS}
    put_in = budget.input_power[0] + sum(
        (powers[part] - getattr(budget, part)[0] for part in made), np.zeros(1)
    )
    return _record(
        drive,
        bridge,
        histories,
        (strategy, name, frequency),
        (powers, budget.shaft_power[0], put_in),
        warm,
        ~(kept & budget.linear[0]),
        within=bool(np.all(budget.within_tables[0])),
    )


def _record(
    drive: PhaseDrive,
    bridge: _Bridge,
    histories: list[JunctionHistory],
    label: tuple[AnyStrategy, ModulationName, float],
    flows: tuple[dict[str, FloatArray], FloatArray, FloatArray],
    warm: float,
    missed: BoolArray,
    *,
    within: bool,
) -> MissionRun:
    """What a run comes to: energies over the intervals, junctions of the hottest leg.

    ``flows`` are the losses by kind, the power at the shaft and from the link, in W at each
    interval.
    """
    mission, tables = bridge.mission, bridge.tables
    length, (powers, shaft, put_in) = mission.length, flows
    both = np.stack(
        [np.stack([one.start, one.end], axis=-1) for one in histories]
    )  # (legs, 2, J, N, 2)
    known = drive.inverter.device is not None
    peak = float(np.max(both))
    swing = np.max(both, axis=(3, 4)) - np.min(both, axis=(3, 4))
    hottest = np.max(both, axis=(0, 1, 2)) if known else np.full(both.shape[3:], np.nan)
    low, high = tables.temperature_reach
    reached = bool(np.min(both) >= low - 1e-9 and peak <= high + 1e-9)
    return MissionRun(
        *label,
        energy={part: float(np.sum(length * powers[part])) for part in PARTS},
        driving=float(np.sum(length * np.maximum(shaft, 0.0))),
        braking=float(np.sum(length * np.minimum(shaft, 0.0))),
        input_energy=float(np.sum(length * put_in)),
        junction_max=peak if known else np.nan,
        swing=float(np.max(swing)) if known else np.nan,
        winding_temperature=float(warm),
        missed=mission.lines[missed],
        steady=all(one.steady for one in histories),
        cool_enough=bool(peak <= tables.max_junction_temperature),
        within_tables=within and reached,
        time=np.stack([mission.time[:-1], mission.time[1:]], axis=-1).ravel(),
        junction=hottest.ravel(),
    )
