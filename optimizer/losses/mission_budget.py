"""Energy over a mission by kind of loss, and junction temperatures over its time,
for every alternative.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import AnyStrategy
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.bridge_heat import at_temperature
from dqforge.machines.losses.bridge_tables import BridgeTables
from dqforge.machines.losses.junction_transient import (
    JunctionNetworks,
    junction_history,
    junction_networks,
)
from dqforge.machines.losses.machine_budget import MachineBudget, WindingHeat, machine_budget
from dqforge.machines.losses.mission import Mission
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import (
    PARTS,
    BudgetOptions,
    harmonic_square,
    known_bridge,
    switched_iron,
    waveform_averages,
)
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    dead_time_share,
    least,
    strategy_currents,
    usable_limit,
)
from dqforge.optimizer.operating_points.loss_model import loss_coefficients

_WARM = 100.0


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
        missed: Lines of the file whose torque or voltage cannot be had.
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

    ``best`` is the index of the usable run that loses least, or -1.

    ``dead_time_share`` is what dead time takes of the linear range,
    least and most of the alternatives.
    """

    mission: Mission
    alternatives: Alternatives
    runs: tuple[MissionRun, ...]
    best: int
    dead_time_share: tuple[float, float]


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
            "loss comparison: give a strategy, a modulator and a carrier frequency at least"
        )
    chosen = BudgetOptions() if options is None else options
    tables = known_bridge(inverter)
    networks = junction_networks(inverter, tables)
    drive = _Drive(machine, inverter, tables, networks, chosen, mission, i_max, margin, repeated)
    runs = []
    for strategy in alternatives.strategies:
        for name in alternatives.modulations:
            runs += _runs(drive, strategy, name, alternatives.frequencies)
    totals = np.array([run.total if run.usable else np.inf for run in runs]).reshape(
        *alternatives.shape, 1
    )
    taken = dead_time_share(inverter, alternatives)
    return MissionComparison(mission, alternatives, tuple(runs), int(least(totals)[0]), taken)


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
