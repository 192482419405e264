"""PWM by current feedback in a design: what it answers, and the runs of the regulators that switch
the bridge.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError
from dqforge.machines.losses.bridge_tables import BridgeTables, at_temperature, junction_balance
from dqforge.machines.losses.machine_budget import machine_budget
from dqforge.machines.names import FeedbackMethod, ModulationName
from dqforge.machines.plants.current_feedback import (
    Hysteresis,
    RampComparison,
    Scheme,
    simulate_currents,
)
from dqforge.machines.plants.fed_machine import BridgeDrive, CurrentTrace
from dqforge.machines.plants.regulator_rules import RuleConstants
from dqforge.machines.plants.regulator_schemes import (
    FurtherScheme,
    Sampled,
    Trajectory,
    optimal_pattern,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import linear_voltage
from dqforge.optimizer.current_feedback.sampled_rules import next_codes
from dqforge.optimizer.loops.loop_gains import LoopGains, analyse_current_loop, tune_speed_loop
from dqforge.optimizer.losses.drive_budget import (
    BudgetOptions,
    DriveBudget,
    drive_budget,
    known_bridge,
    switched_iron,
)
from dqforge.optimizer.losses.drive_comparison import strategy_currents
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

if TYPE_CHECKING:
    from dqforge.optimizer.control_design.gain_set import GainSet

# Speeds of the comparison over the base speed of the per-unit system.
_SHARES = (0.25, 0.5, 0.75, 1.0)

# Largest bandwidth times sampling period at which the speed loop's model takes the regulator.
CALM = 0.3


@dataclass(frozen=True, slots=True)
class Equivalent:
    """What the speed loop sees of the regulator.

    Args:
        delay: Computing time and half of the longest mean time between turn-ons, in s.
        bandwidth: Of the first-order lag that it is taken as, in rad/s: 1/delay, or less where the
            sampling of the speed loop does not see as much.
    """

    delay: float
    bandwidth: float


_NUMBERS = (
    "frequency",
    "lowest",
    "highest",
    "rms_error",
    "largest_error",
    "distortion",
    "stored",
)


@dataclass(frozen=True, slots=True)
class WorkingPoints:
    """Points at which regulators are run, arrays of the shape (P,).

    Torque asked for in N m, mechanical speed in rad/s, and the currents of the design's strategy in
    A (peak).
    """

    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray

    def part(self, index: slice) -> WorkingPoints:
        """Some of the points."""
        return WorkingPoints(
            self.torque[index], self.omega_m[index], self.i_d[index], self.i_q[index]
        )

    def and_further(self, others: WorkingPoints) -> WorkingPoints:
        """These points, and others behind them."""
        return WorkingPoints(
            *(
                np.concatenate([getattr(self, name), getattr(others, name)])
                for name in ("torque", "omega_m", "i_d", "i_q")
            )
        )


@dataclass(frozen=True, slots=True)
class RegulatorPlan:
    """Numbers of a regulator in SI units; those that its method does not use are defaults.

    Args:
        method: Which one.
        band, outer_band: In A.
        kp, ki: In V/A and V/(A s).
        carrier: In Hz.
        comparator_band: In V.
        t_s: Sampling period in s.
        pulses: Most pulses of a leg per electrical period.
    """

    method: FeedbackMethod
    band: float
    outer_band: float
    kp: float
    ki: float
    carrier: float
    comparator_band: float
    t_s: float
    pulses: int

    def scheme(self, electrical: float) -> Scheme | FurtherScheme:
        """The scheme that is simulated, at an electrical frequency in Hz, which decides the pulses
        of a pattern.
        """
        if self.method == "hysteresis":
            return Hysteresis(self.band)
        if self.method == "ramp-comparison":
            return RampComparison(
                self.kp, self.ki, self.carrier, comparator_band=self.comparator_band
            )
        if self.method == "trajectory":
            return Trajectory(self.angles(electrical), self.t_s)
        return Sampled(self.method, self.t_s, next_codes, self.band, self.outer_band)

    def angles(self, electrical: float) -> int:
        """Angles in a quarter of a pattern at an electrical frequency in Hz: as many pulses as the
        carrier frequency leaves, three at least.
        """
        pulses = min(self.pulses, int(self.carrier / electrical))
        return max(1, (pulses - 1) // 2)


@dataclass(frozen=True, slots=True)
class RegulatorRun:
    """What a regulator does at P points, arrays of the shape (P,); NaN where it could not be run.

    Args:
        plan: The regulator.
        points: Where it was run.
        frequency, lowest, highest: Switching frequencies in Hz: mean of the legs, and the ends of
            its range.
        rms_error, largest_error: Of a phase current in A.
        distortion: Of the phase currents, over the fundamental.
        stored: Power in W that the field takes up between first and last instant.
        budget: Powers and temperatures.
        obstacles: Why a point could not be run, or empty texts.
    """

    plan: RegulatorPlan
    points: WorkingPoints
    frequency: FloatArray
    lowest: FloatArray
    highest: FloatArray
    rms_error: FloatArray
    largest_error: FloatArray
    distortion: FloatArray
    stored: FloatArray
    budget: DriveBudget
    obstacles: tuple[str, ...]

    def part(self, index: slice) -> RegulatorRun:
        """The run at some of its points."""
        budget: dict[str, Any] = {
            part.name: getattr(self.budget, part.name)[index] for part in fields(DriveBudget)
        }
        columns = {name: getattr(self, name)[index] for name in _NUMBERS}
        return RegulatorRun(
            plan=self.plan,
            points=self.points.part(index),
            **columns,
            budget=DriveBudget(**budget),
            obstacles=self.obstacles[index],
        )


@dataclass(frozen=True, slots=True)
class LoadRuns:
    """Regulators at the loads of the design.

    Args:
        runs: One per method, in the order of `METHODS`.
        own: Place of the design's method.
        modulations: Modulators of the design.
        budget: Their budgets at the own method's switching frequency, arrays (M, P).
        distortion: Of their phase currents over the fundamental, shape (M, P).
    """

    runs: tuple[RegulatorRun, ...]
    own: int
    modulations: tuple[ModulationName, ...]
    budget: DriveBudget
    distortion: FloatArray


# Pulse patterns of a design that tracks trajectories, at the points at which it is judged.


@dataclass(frozen=True, slots=True)
class DesignPattern:
    """One pattern.

    Args:
        omega_m: Mechanical speed in rad/s at which it is meant.
        index: Amplitude of the phase voltage over half the DC link.
        sign: Level of a leg behind the angle 0 of its voltage's sine.
        angles: Of a quarter of the period, in rad.
    """

    omega_m: float
    index: float
    sign: int
    angles: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class CurrentFeedback:
    """Current-feedback PWM of a design.

    Args:
        plan: Numbers of its regulator.
        over_speed: All methods over speed with half of the largest torque, in the order of
            `METHODS`.
        own: Place of the design's method.
        loads: The same at the loads of the design; None where it names none.
        equivalent: What the speed loop sees; None without one.
        speed: The speed loop; None without one.
        patterns: Pulse patterns over speed; none where the method has none.
        rule: What the emitted rule knows of the drive; None where the method is not sampled.
        gains: Those of the speed control around it, as of `closed_drive.lag_gains`.
    """

    plan: RegulatorPlan
    over_speed: tuple[RegulatorRun, ...]
    own: int
    loads: LoadRuns | None
    equivalent: Equivalent | None
    speed: LoopGains | None
    patterns: tuple[DesignPattern, ...] = ()
    rule: RuleConstants | None = None
    gains: GainSet | None = None

    @property
    def run(self) -> RegulatorRun:
        """The design's regulator over speed."""
        return self.over_speed[self.own]


def working_points(design: Design, torque: FloatArray, omega_m: FloatArray) -> WorkingPoints:
    """Points with the currents of the design's strategy, those within reach of a regulator alone.

    Args:
        design: The drive.
        torque, omega_m: In N m and rad/s, shape (P,).

    Raises:
        InputError: No point is within reach.
    """
    v_max = VOLTAGE_SHARE * linear_voltage(design.inverter.v_dc)
    i_d, i_q, made = strategy_currents(
        design.machine,
        design.strategy,
        torque,
        omega_m,
        v_max=v_max,
        i_max=design.i_max,
        options=budget_options(design),
    )
    voltage = np.hypot(*design.machine.voltage(i_d, i_q, design.machine.pole_pairs * omega_m))
    kept = made & (voltage <= v_max * (1.0 + 1e-6)) & (omega_m > 0.0)
    if not np.any(kept):
        raise InputError(
            f"no point is within reach of a regulator with {v_max:.4g} V (95 % of v_dc/sqrt(3)) at "
            "a positive speed; lower speed or torque, or raise v_dc"
        )
    return WorkingPoints(torque[kept], omega_m[kept], i_d[kept], i_q[kept])


def load_points(design: Design) -> WorkingPoints | None:
    """The loads of the design, None where it names none."""
    if design.losses is None or not design.losses.points:
        return None
    torque = np.array([point.torque for point in design.losses.points])
    omega_m = np.array([point.omega_m for point in design.losses.points])
    return working_points(design, torque, omega_m)


def speed_points(design: Design) -> WorkingPoints:
    """Half of the largest torque at shares of the base speed."""
    torque = 0.5 * float(mtpa_locus(design.machine, design.i_max).torque[-1])
    omega_m = design.control.bases.speed * np.array(_SHARES)
    return working_points(design, np.full(omega_m.shape, torque), omega_m)


def _both(design: Design) -> tuple[tuple[RegulatorRun, ...], LoadRuns | None]:
    """All regulators over speed and at the loads, each in a single run of all points."""
    speeds, loads = speed_points(design), load_points(design)
    points = speeds if loads is None else speeds.and_further(loads)
    count = speeds.torque.size
    runs = [run_regulator(design, regulator_plan(design, name), points) for name in METHODS]
    over_speed = tuple(run.part(slice(0, count)) for run in runs)
    if loads is None or design.losses is None:
        return over_speed, None
    return over_speed, _load_runs(design, tuple(run.part(slice(count, None)) for run in runs))


def _load_runs(design: Design, runs: tuple[RegulatorRun, ...]) -> LoadRuns:
    own = METHODS.index(regulator_plan(design).method)
    modulations = () if design.losses is None else design.losses.modulations
    budget = modulators_beside(design, runs[own], modulations)
    size = np.hypot(runs[own].points.i_d, runs[own].points.i_q)
    with np.errstate(divide="ignore", invalid="ignore"):
        distortion = math.sqrt(2.0) * budget.ripple_current / size
    return LoadRuns(runs, own, modulations, budget, distortion)


def solve_loads(design: Design) -> LoadRuns | None:
    """All regulators at the loads of the design, None where it names none."""
    points = load_points(design)
    if points is None:
        return None
    return _load_runs(
        design,
        tuple(run_regulator(design, regulator_plan(design, name), points) for name in METHODS),
    )


def speed_loop(design: Design, run: RegulatorRun) -> tuple[Equivalent, LoopGains] | None:
    """The speed loop over a regulator, taken as a first-order lag; None where none is asked for.

    Args:
        design: The drive.
        run: Its regulator over speed.

    Raises:
        NoSolutionError: The regulator could not be run, or as `tune_speed_loop`.
    """
    control = design.control
    if control.speed_loop is None:
        return None
    frequency = run.frequency[np.isfinite(run.frequency)]
    if not frequency.size:
        raise NoSolutionError(f"control.current_loop: {run.obstacles[0]}")
    scheme = run.plan.scheme(1.0)
    computing = run.plan.t_s if isinstance(scheme, Sampled) else 0.0
    delay = computing + 0.5 / float(np.min(frequency))
    bandwidth = min(1.0 / delay, CALM / control.t_s)
    machine = linearised(design.machine)
    lag = analyse_current_loop(
        machine.r_s,
        machine.l_q,
        control.t_s,
        bandwidth * machine.l_q,
        bandwidth * machine.r_s,
        run.plan.method,
        respond=False,
    )
    return Equivalent(delay, bandwidth), tune_speed_loop(machine, lag, control)


def emitted_rule(design: Design, plan: RegulatorPlan) -> RuleConstants | None:
    """What a sampled rule knows of the drive, None of other regulators."""
    scheme = plan.scheme(1.0)
    return scheme.constants(bridge_of(design)) if isinstance(scheme, Sampled) else None


@on_design("control.current_loop")
def solve_current_feedback(design: Design) -> CurrentFeedback | None:
    """Current-feedback PWM of a design, None where its current loops are others."""
    if not design.control.current_loop.switches:
        return None
    plan, (runs, loads) = regulator_plan(design), _both(design)
    own = METHODS.index(plan.method)
    found = speed_loop(design, runs[own])
    return CurrentFeedback(
        plan=plan,
        over_speed=runs,
        own=own,
        loads=loads,
        equivalent=None if found is None else found[0],
        speed=None if found is None else found[1],
        patterns=design_patterns(design, plan, runs[own].points),
        rule=emitted_rule(design, plan),
    )


# A regulator at operating points: switching frequency, error, distortion and every watt.
#
# The bridge of the simulation is ideal: its losses are those of the device at the instants and
# currents of the run, and change nothing in it. Dead time is left out. Copper is that of the
# simulated currents, so that power in, losses and shaft power are three figures that must agree
# but for what the field of the ripple has stored.

# Electrical periods that are observed, and those before them: runs start on their references.
PERIODS, SETTLING = 1, 0


def run_regulator(design: Design, plan: RegulatorPlan, points: WorkingPoints) -> RegulatorRun:
    """Simulate a regulator at points of constant speed, and count what it loses.

    Args:
        design: The drive.
        plan: The regulator.
        points: P points, at least one; speeds other than 0.
    """
    tracks = plan.method == "trajectory"
    parts = [slice(k, k + 1) for k in range(points.torque.size)] if tracks else [slice(None)]
    try:
        return _joined([_run(design, plan, points.part(part)) for part in parts])
    except DqforgeError:
        # Some point cannot be run: each by itself, so that the others are known.
        single = [slice(k, k + 1) for k in range(points.torque.size)]
        return _joined([_run_or_reason(design, plan, points.part(part)) for part in single])


def _run_or_reason(design: Design, plan: RegulatorPlan, points: WorkingPoints) -> RegulatorRun:
    try:
        return _run(design, plan, points)
    except DqforgeError as error:
        nan = np.full(points.torque.shape, math.nan)
        columns: dict[str, Any] = {
            part.name: np.zeros(nan.shape, dtype=np.bool_) if part.type == "BoolArray" else nan
            for part in fields(DriveBudget)
        }
        budget = DriveBudget(**columns)
        return RegulatorRun(plan, points, *(nan,) * 7, budget, (error.message,) * nan.size)


def _joined(runs: Sequence[RegulatorRun]) -> RegulatorRun:
    if len(runs) == 1:
        return runs[0]

    def columns(parts: Sequence[Any], names: Sequence[str]) -> dict[str, Any]:
        return {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}

    budgets = [run.budget for run in runs]
    return RegulatorRun(
        plan=runs[0].plan,
        points=WorkingPoints(
            **columns([run.points for run in runs], ("torque", "omega_m", "i_d", "i_q"))
        ),
        **columns(runs, _NUMBERS),
        budget=DriveBudget(**columns(budgets, [part.name for part in fields(DriveBudget)])),
        obstacles=tuple(text for run in runs for text in run.obstacles),
    )


def _run(design: Design, plan: RegulatorPlan, points: WorkingPoints) -> RegulatorRun:
    electrical = design.machine.pole_pairs * float(np.max(np.abs(points.omega_m))) / (2.0 * math.pi)
    trace = simulate_currents(
        bridge_of(design),
        plan.scheme(electrical),
        points.i_d,
        points.i_q,
        points.omega_m,
        periods=PERIODS,
        settling=SETTLING,
    )
    switching = trace.switching_frequency()
    return RegulatorRun(
        plan,
        points,
        switching.average,
        switching.lowest,
        switching.highest,
        trace.rms_error(),
        trace.largest_error(),
        trace.current_thd(),
        trace.power_balance().stored,
        trace_budget(design, trace, budget_options(design)),
        ("",) * points.torque.size,
    )


def trace_budget(design: Design, trace: CurrentTrace, options: BudgetOptions) -> DriveBudget:
    """Budget of the points of a trace, arrays (P,).

    Args:
        design: Machine, bridge and coolant.
        trace: What the regulator did.
        options: What is counted beside copper, conduction and switching.
    """
    inverter, machine, plant = design.inverter, design.machine, trace.plant
    tables = known_bridge(inverter)
    omega_m = plant.omega_e / machine.pole_pairs
    found = machine_budget(
        machine, plant.i_d, plant.i_q, omega_m, loss=options.machine_loss, heat=options.winding
    )
    lost = trace_losses(tables, trace)
    heat = junction_balance(tables, lost.conduction + lost.switching)
    conduction, switching = (
        3.0 * np.sum(at_temperature(tables.temperatures, part, heat.temperature), axis=(0, 1))
        for part in (lost.conduction, lost.switching)
    )
    power = trace.power_balance()
    warm = found.resistance / machine.r_s if machine.r_s > 0.0 else np.ones(omega_m.shape)
    copper = power.copper * warm
    ripple = 3.0 * found.resistance * lost.ripple_square
    voltage = np.hypot(*machine.voltage(plant.i_d, plant.i_q, plant.omega_e))
    link_square = np.maximum(lost.link_square - (power.dc_link / inverter.v_dc) ** 2, 0.0)
    frequency = trace.switching_frequency().average
    zero, size = np.zeros(omega_m.shape), np.hypot(plant.i_d, plant.i_q)
    losses = {
        "copper": copper - ripple,
        "ripple_copper": ripple,
        "iron": found.iron,
        "ripple_iron": switched_iron(options, voltage, inverter.v_dc, frequency),
        "magnet": found.magnet,
        "conduction": conduction,
        "dead_time": zero,
        "switching": switching,
        "capacitor": options.capacitor_esr * link_square,
    }
    total = sum(losses.values(), zero)
    known = inverter.device is not None
    low, high = tables.temperature_reach
    inside = np.all(
        (heat.temperature >= low - 1e-9) & (heat.temperature <= high + 1e-9), axis=(0, 1)
    )
    return DriveBudget(
        **losses,
        torque=power.shaft / omega_m,
        shaft_power=power.shaft,
        friction=machine.friction * omega_m * omega_m,
        total=total,
        input_power=power.dc_link - power.copper + total,
        junction_temperature=np.max(heat.temperature[:, 0], axis=0) if known else zero + math.nan,
        diode_temperature=np.max(heat.temperature[:, -1], axis=0) if known else zero + math.nan,
        winding_temperature=found.winding_temperature,
        voltage=voltage,
        voltage_error=zero,
        capacitor_current=np.sqrt(link_square),
        ripple_current=np.sqrt(lost.ripple_square),
        thermal_residual=np.max(np.abs(heat.residual), axis=(0, 1)),
        linear=np.ones(omega_m.shape, dtype=np.bool_),
        steady=heat.steady & found.steady,
        cool_enough=np.max(heat.temperature, axis=(0, 1)) <= tables.max_junction_temperature,
        within_tables=(size <= tables.current_reach) & inside,
        known=np.ones(omega_m.shape, dtype=np.bool_),
    )


def modulators_beside(
    design: Design, run: RegulatorRun, modulations: Sequence[ModulationName]
) -> DriveBudget:
    """Budgets (M, P) of modulators at the mean switching frequency of a regulator at each point.

    With the same currents and without dead time, as the regulator. NaN where the regulator could
    not be run.

    Args:
        design: The drive.
        run: The regulator.
        modulations: M modulators.
    """
    inverter = _without_dead_time(design.inverter)
    columns = []
    for p, frequency in enumerate(run.frequency):
        known = bool(np.isfinite(frequency))
        blank = 1.0 if known else math.nan
        columns.append(
            drive_budget(
                design.machine,
                inverter,
                blank * run.points.i_d[p : p + 1],
                blank * run.points.i_q[p : p + 1],
                run.points.omega_m[p : p + 1],
                modulations,
                [frequency if known else inverter.f_sw],
                options=budget_options(design),
            )
        )
    names = [part.name for part in fields(DriveBudget)]
    return DriveBudget(
        **{
            name: np.concatenate([getattr(c, name)[:, 0] for c in columns], axis=1)
            for name in names
        }
    )


def _without_dead_time(inverter: Inverter) -> Inverter:
    return replace(inverter, dead_time=0.0)


# The regulator of a design: its numbers, given or computed, and what its current loop counts as.
#
# Defaults aim at the inverter's switching frequency f_sw with the smaller inductance L:
#
#     band     v_dc / (8 L f_sw), at which a phase on the middle of the link would switch at f_sw at
#              rest (`hysteresis_frequency`); an isolated star point mostly switches less
#     outer    twice the band
#   carrier  f_sw, with kp for half of the triangle's slope (`slope_ratio`) at the voltage limit and
#              ki = kp R / L, which cancels the winding's pole
#     sampling 10 f_sw; of a trajectory, whose edges need no more, 2 f_sw
#     pulses   at most 15 per electrical period

METHODS: tuple[FeedbackMethod, ...] = (
    "hysteresis",
    "ramp-comparison",
    "look-up-table",
    "circle",
    "predictive",
    "trajectory",
)

VOLTAGE_SHARE = 0.95  # Share of v_dc/sqrt(3) that a regulator is given: the rest is for the error.
_PULSES = 15


def bridge_of(design: Design) -> BridgeDrive:
    """Machine and ideal bridge of a design."""
    return BridgeDrive(linearised(design.machine), design.inverter.v_dc)


def regulator_plan(design: Design, method: FeedbackMethod | None = None) -> RegulatorPlan:
    """Numbers of the design's regulator, or of another one with the same section.

    Args:
        design: The drive; keys that it leaves open are computed.
        method: Another method than the design's, for comparisons.

    Raises:
        InputError: The design's outer band, given or not, is less than its band.
    """
    loop, machine = design.control.current_loop, linearised(design.machine)
    v_dc, f_sw = design.inverter.v_dc, design.inverter.f_sw
    least = min(machine.l_d, machine.l_q)
    band = v_dc / (8.0 * least * f_sw) if loop.band is None else loop.band
    carrier = f_sw if loop.carrier is None else loop.carrier
    steepest = (2.0 / 3.0 + 1.0 / math.sqrt(3.0)) * v_dc / least
    kp = v_dc * carrier / steepest if loop.kp is None else loop.kp
    ki = kp * machine.r_s / least if loop.ki is None else loop.ki
    outer = 2.0 * band if loop.outer_band is None else loop.outer_band
    if outer < band:
        raise InputError(
            f"control.current_loop.outer_band: {outer:.4g} A is less than the band of {band:.4g} "
            "A; write both"
        )
    chosen = loop.method if method is None else method
    often = 2.0 if chosen == "trajectory" else 10.0
    if chosen not in METHODS:
        raise InputError(
            f"control.current_loop: the method '{chosen}' does not switch the bridge itself"
        )
    return RegulatorPlan(
        method=chosen,
        band=band,
        outer_band=outer,
        kp=kp,
        ki=ki,
        carrier=carrier,
        comparator_band=0.0 if loop.comparator_band is None else loop.comparator_band,
        t_s=1.0 / (often * f_sw if loop.sampling is None else loop.sampling),
        pulses=_PULSES if loop.pulses is None else loop.pulses,
    )


# Losses of a bridge at the switching instants and currents that a regulator really had.
#
# Conduction is averaged between the commutations; each commutation costs the energy of the device
# at the current of that instant. What a leg does follows from the sign of its current: a leg that
# goes up with the current out of it, or down with the current into it, turns a transistor on
# against a diode that conducts; the other two turn one off.


@dataclass(frozen=True, slots=True)
class TraceLosses:
    """Powers of one switch position in W, mean of the three legs, shape (2, J, K, N).

    Upper and lower position; junction of the transistor and, where the diode has its own, of the
    diode; temperature of the tables.

    Args:
        conduction, switching: Powers in W.
        link_square: Mean square of the current from the DC link in A^2, shape (N,).
        ripple_square: Mean square of what a phase current has beside its reference in A^2, shape
            (N,).
    """

    conduction: FloatArray
    switching: FloatArray
    link_square: FloatArray
    ripple_square: FloatArray


def trace_losses(tables: BridgeTables, trace: CurrentTrace) -> TraceLosses:
    """Losses of all points of a trace.

    Args:
        tables: The device.
        trace: What the regulator did.
    """
    count = trace.plant.i_d.size
    found = [_one(tables, trace, point) for point in range(count)]
    stacked = [np.stack([part[k] for part in found], axis=-1) for k in range(4)]
    conduction, switching = (
        part if tables.separate_diode else np.sum(part, axis=1, keepdims=True)
        for part in stacked[:2]
    )
    return TraceLosses(conduction, switching, stacked[2], stacked[3])


def _one(
    tables: BridgeTables, trace: CurrentTrace, point: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Conduction and switching (2, 2, K), mean squares of link current and ripple, of a point."""
    weight, current, error = trace.samples_of(point)
    on = trace.legs[:, point]
    size = np.abs(current)
    channel = tables.channel.at(size) * size
    diode = channel if tables.synchronous or tables.diode is None else tables.diode.at(size) * size
    conduction = np.zeros((2, 2, tables.temperatures.size))
    for place, (own, out) in enumerate(((on, current > 0.0), (~on, current <= 0.0))):
        shares = weight[..., None] / 3.0
        ahead, back = shares * (own & out), shares * (own & ~out)
        conduction[place, 0] = np.sum(channel * ahead, axis=(1, 2, 3))
        part = np.sum(diode * back, axis=(1, 2, 3))
        conduction[place, 0 if tables.synchronous else 1] += part
    link = np.sum(weight * np.sum(np.where(on, current, 0.0), axis=-1) ** 2)
    ripple = np.sum(weight * np.mean(error**2, axis=-1))
    return conduction, _events(tables, trace, point), link, ripple


def _events(tables: BridgeTables, trace: CurrentTrace, point: int) -> FloatArray:
    """Switching power (2, 2, K) of the positions of a leg, mean of the three."""
    power = np.zeros((2, 2, tables.temperatures.size))
    duration = float(trace.duration[point])
    for leg in range(3):
        time, up = trace.instants(point, leg)
        if not time.size:
            continue
        current = trace.phase_currents(point, time)[:, leg]
        size, out = np.abs(current), current > 0.0
        turn_on, turn_off = tables.turn_on.at(size), tables.turn_off.at(size)
        recovery = tables.recovery.at(size)
        scale = 1.0 / (3.0 * duration)
        # With the current out of the leg its upper transistor switches, the lower diode recovers.
        for place, works in enumerate((out, ~out)):
            starts = works & (up == (place == 0))
            ends = works & (up != (place == 0))
            power[place, 0] += scale * (turn_on @ starts + turn_off @ ends)
            power[1 - place, 1] += scale * (recovery @ starts)
    return power


def design_patterns(
    design: Design, plan: RegulatorPlan, points: WorkingPoints
) -> tuple[DesignPattern, ...]:
    """Patterns at points; none of another regulator, or where no pattern makes the voltage.

    Args:
        design: The drive.
        plan: Its regulator.
        points: Where.
    """
    if plan.method != "trajectory":
        return ()
    omega_e = design.machine.pole_pairs * points.omega_m
    voltage = np.hypot(*design.machine.voltage(points.i_d, points.i_q, omega_e))
    found = []
    for speed, turning, amplitude in zip(points.omega_m, omega_e, voltage, strict=True):
        index = float(amplitude / (0.5 * design.inverter.v_dc))
        try:
            pattern = optimal_pattern(plan.angles(float(turning) / (2.0 * math.pi)), index)
        except NoSolutionError:
            continue
        angles = tuple(float(angle) for angle in pattern.angles)
        found.append(DesignPattern(float(speed), index, pattern.sign, angles))
    return tuple(found)
