"""Energy of a phase machine's drive over a mission: every leg with the history of its junctions.

What `compare_mission` is for dq machines, with the rules of `phase_comparison`. A junction follows
the losses of its own leg, so that the neutral's is the coldest.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import AnyStrategy
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
    MissionComparison,
    MissionRun,
    dead_time_share,
    held_winding,
    least,
)
from dqforge.optimizer.losses.phase_comparison import (
    CENTRED,
    PhaseDrive,
    averages_of_legs,
    phase_budget,
    phase_rows,
    rule_currents,
)

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
    totals = np.array([run.total if run.usable else np.inf for run in runs])
    best = int(least(totals.reshape(*labels.shape, 1))[0])
    taken = dead_time_share(drive.inverter, labels)
    return MissionComparison(mission, labels, tuple(runs), best, taken)


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
