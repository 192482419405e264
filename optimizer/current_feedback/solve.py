"""Current-feedback PWM of a design: the regulator over speed beside all others, at the loads of the
design beside its modulators, and a speed loop over it.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import ModulationName
from dqforge.machines.plants.regulator_rules import RuleConstants
from dqforge.machines.plants.regulator_schemes import Sampled
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_feedback.regulator_runs import (
    METHODS,
    VOLTAGE_SHARE,
    DesignPattern,
    RegulatorPlan,
    RegulatorRun,
    WorkingPoints,
    bridge_of,
    design_patterns,
    modulators_beside,
    regulator_plan,
    run_regulator,
)
from dqforge.optimizer.loops.loop_gains import LoopGains, analyse_current_loop, tune_speed_loop
from dqforge.optimizer.losses.drive_budget import DriveBudget
from dqforge.optimizer.losses.drive_comparison import strategy_currents
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

# Speeds of the comparison over the base speed of the per-unit system.
_SHARES = (0.25, 0.5, 0.75, 1.0)

# Largest bandwidth times sampling period at which the speed loop's model takes the regulator.
_CALM = 0.3


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
    """

    plan: RegulatorPlan
    over_speed: tuple[RegulatorRun, ...]
    own: int
    loads: LoadRuns | None
    equivalent: Equivalent | None
    speed: LoopGains | None
    patterns: tuple[DesignPattern, ...] = ()
    rule: RuleConstants | None = None

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
    v_max = VOLTAGE_SHARE * design.inverter.v_dc / math.sqrt(3.0)
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
    bandwidth = min(1.0 / delay, _CALM / control.t_s)
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
