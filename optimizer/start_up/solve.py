"""The start of a design: its plan, what each method could lift, and what is refused."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Literal

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.design.design import ROUNDING_OF_DATA, Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import controlled_frame
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.estimators import TunedTracker, solve_tracker, tune_tracker
from dqforge.optimizer.observers.conditions import lost_voltage
from dqforge.optimizer.sampled_systems import ComplexArray
from dqforge.optimizer.start_up.plan import (
    LEAST_SALIENCY,
    LEAST_SATURATION,
    StartUpPlan,
    saturation,
    start_up_plan,
)

_HEADROOM = 0.8  # of the torque of a ramp's current: above it the rotor falls out of step


_TOLERATED = math.sin(math.radians(30.0))  # angle of the alignment that the observer recovers from


_DRIFT = 0.5  # of the magnet flux linkage, of the observer's until it holds


@dataclass(frozen=True, slots=True)
class StartUp:
    """A start with what it can lift.

    ``largest_loads`` are the largest load torques in N m that each method could start at the
    current limit, by its name; ``largest_load`` that of the plan itself, with its own currents.
    ``low`` is the estimator from standstill on, None where the method needs none.
    """

    plan: StartUpPlan
    largest_loads: dict[StartUpMethodName, float]
    largest_load: float
    low: TunedTracker | None = None


def accelerating_torque(plan: StartUpPlan) -> float:
    """Torque in N m that accelerates the ramp.

    Args:
        plan: What the start needs.
    """
    return plan.ramp_acceleration * plan.inertia / plan.pole_pairs


def largest_load(plan: StartUpPlan, method: StartUpMethodName, current: float) -> float:
    """Largest load torque in N m that a method starts with a current in A; 0 for none.

    Args:
        plan: What the start needs.
        method: The method.
        current: Of the ramp, of the alignment before ``direct``, or the current limit for
            ``saliency``.
    """
    torque = plan.torque_per_ampere * current
    if method == "direct":
        return _TOLERATED * torque
    if method == "saliency":
        held = min(plan.held_current, current)
        left = plan.torque_per_ampere * math.sqrt(current**2 - held**2)
        return max(left - accelerating_torque(plan), 0.0)
    return max(_HEADROOM * torque - accelerating_torque(plan), 0.0)


def drift(design: Design, plan: StartUpPlan) -> float:
    """Flux linkage in Wb that wrong resistance and dead time integrate until the hand-over of a
    start from the alignment into the observer.

    Args:
        design: The design.
        plan: What its start needs.
    """
    tolerances = design.control.tolerances
    share = 0.0 if tolerances is None else max(abs(side) for side in tolerances.limits("r_s"))
    lost = max(abs(volts) for volts in lost_voltage(design))
    wrong = (share or 0.3) * plan.r_s * plan.align_current + lost
    torque = max(plan.rated_torque - plan.load_torque, 1e-9)
    return wrong * plan.hand_over * plan.inertia / (plan.pole_pairs * torque)


_LIMITED = (
    ("current", "ramp_current"),
    ("alignment_current", "align_current"),
    ("held_current", "held_current"),
)


def _refuse_limits(design: Design, plan: StartUpPlan) -> None:
    """Refuse what the drive cannot carry, reach, or would trip on at once.

    Raises:
        InputError: With the limit.
    """
    settings, limit = design.control.start_up, plan.current_limit
    if settings is None:
        return
    most = limit * (1.0 + ROUNDING_OF_DATA)
    for key, name in _LIMITED:
        if getattr(settings, key) is not None and getattr(plan, name) > most:
            raise InputError(
                f"control.start_up.{key}: {getattr(plan, name):.4g} A is above the limit of the "
                f"drive, {limit:.4g} A; write less"
            )
    if plan.trip_current <= most:
        raise InputError(
            f"control.start_up.trip_current: {plan.trip_current:.4g} A trips at currents that the "
            f"control requests, up to {limit:.4g} A; write more, such as {1.8 * limit:.3g} A"
        )
    if plan.v_dc_min >= design.inverter.v_dc:
        raise InputError(
            f"control.start_up.v_dc_min: {plan.v_dc_min:.4g} V trips at the link's own "
            f"{design.inverter.v_dc:.4g} V; write less"
        )
    largest = design.machine.omega_m_max
    given = settings.hand_over
    if largest is not None and given is not None and given > largest * (1.0 + ROUNDING_OF_DATA):
        raise InputError(
            f"control.start_up.hand_over: {given:.4g} rad/s is above "
            f"machine.max_speed, {largest:.4g} rad/s; write less"
        )


def _refuse_slow(design: Design, plan: StartUpPlan) -> None:
    """Refuse a hand-over below the speeds at which a tracker holds."""
    tracked = solve_tracker(design)
    if tracked is not None and plan.hand_over < tracked.omega_low * (1.0 - 1e-9):
        least = tracked.omega_low / plan.pole_pairs
        raise NoSolutionError(
            f"control.start_up.hand_over: {tracked.tracker.name} holds from "
            f"{format_quantity(least, 'rpm')} on, it would take over at "
            f"{format_quantity(plan.hand_over / plan.pole_pairs, 'rpm')}; write "
            f"{format_quantity(1.02 * least, 'rpm', 3)} or more, or a smaller "
            "control.observer.pll_bandwidth"
        )


def _refuse_waveforms(design: Design) -> None:
    """Refuse references of a phase machine that no d current can be held beside."""
    machine = design.phase_machine
    if not isinstance(machine, SalientPhaseMachine):
        return
    wanted = design.control.current_loop.frame
    if controlled_frame(wanted, machine, design.inverter.topology) == "table":
        raise NoSolutionError(
            "control.start_up: the phase currents of inductances that vary with the angle leave no "
            "d current to fade after the hand-over; write control.current_loop.frame: dq"
        )


def _refuse(design: Design, plan: StartUpPlan, most: float) -> None:
    settings = design.control.start_up
    assert settings is not None
    _refuse_waveforms(design)
    if settings.load == "active" and not settings.brake:
        raise NoSolutionError(
            "control.start_up: an active load turns the rotor before a current is established; "
            "write brake: true for a brake that opens once the drive holds, or load: friction"
        )
    if plan.method == "saliency":
        saliency = plan.l_q / plan.l_d
        if saliency < LEAST_SALIENCY:
            raise NoSolutionError(
                f"control.start_up.method: L_q/L_d = {saliency:.4g} shows no angle at rest, "
                f"{LEAST_SALIENCY:g} or more do; write method: i-f"
            )
        if settings.observer is None:
            raise NoSolutionError(
                "control.start_up.method: saliency needs an estimator from standstill on; write "
                "control.start_up.observer: {method: injection}"
            )
        found = saturation(design.machine, plan.current_limit)
        if plan.alignment == "none" and found < LEAST_SATURATION:
            raise NoSolutionError(
                f"control.start_up.alignment: L_dd falls by {100.0 * found:.3g} % at the current "
                f"limit, which does not tell north from south ({100.0 * LEAST_SATURATION:g} % do); "
                "write two-step"
            )
    _refuse_slow(design, plan)
    if plan.flying:
        plan_flying_start(
            linearised(design.machine), plan.t_s, plan.base_speed, i_limit=plan.trip_current
        )
    if plan.load_torque > most * (1.0 + 1e-9):
        raise NoSolutionError(
            f"control.start_up.load_torque: {plan.method} starts at most {most:.4g} N m with its "
            f"currents and {accelerating_torque(plan):.4g} N m that accelerate, "
            f"{plan.load_torque:.4g} N m are requested; write less, or a larger current"
        )
    if plan.method == "direct":
        found = drift(design, plan)
        if found > _DRIFT * plan.psi_pm:
            raise NoSolutionError(
                f"control.start_up.method: until the hand-over wrong resistance and dead time move "
                f"the observer's flux linkage by {found / plan.psi_pm:.3g} of the magnet's, at "
                f"most {_DRIFT:g}; write method: i-f"
            )


@on_design("control")
def solve_start_up(design: Design) -> StartUp | None:
    """The start that a design asks for, None without one.

    Args:
        design: The design.

    Raises:
        InputError: The drive cannot carry or reach what is asked for, or trips on it.
        NoSolutionError: Physics forbids the method; the message has the number.
    """
    plan = start_up_plan(design)
    if plan is None:
        return None
    own = {"direct": plan.align_current, "saliency": plan.current_limit}
    most = largest_load(plan, plan.method, own.get(plan.method, plan.ramp_current))
    _refuse(design, plan, most)
    _refuse_limits(design, plan)
    methods: tuple[StartUpMethodName, ...] = ("i-f", "v-f", "direct", "saliency")
    if design.phase_machine is not None:
        methods = ("i-f",)
    limits = {
        method: largest_load(plan, method, plan.current_limit)
        for method in methods
        if method != "saliency" or plan.l_q / plan.l_d >= LEAST_SALIENCY
    }
    return StartUp(plan, limits, most, _low(design, plan))


def _low(design: Design, plan: StartUpPlan) -> TunedTracker | None:
    """The estimator from standstill on; `NoSolutionError` where it ends below the hand-over."""
    settings = design.control.start_up
    if plan.method != "saliency" or settings is None or settings.observer is None:
        return None
    low = tune_tracker(design, settings.observer)
    if low.omega_high < plan.hand_over:
        raise NoSolutionError(
            f"control.start_up.observer: {low.tracker.name} holds up to "
            f"{low.omega_high / (2.0 * math.pi):.4g} Hz (electrical), the observer at speed takes "
            f"over from {plan.hand_over / (2.0 * math.pi):.4g} Hz on; write a lower hand_over, or "
            "method: i-f"
        )
    return low


# Whether a drive has started, and what went wrong where it has not, from a record of the start.
#
# A start has succeeded when in the last part of the record the observer rules, the speed is held at
# its reference, the observer's angle is right and nothing swings. What is not so has a name: what
# the drive itself reports, and what really happened. A failure that the drive does not report is
# silent.

# What really happened: the observer never took over; the rotor stands or creeps; the observer is
# about half an electrical turn off; the speed swings; the angle, or the speed, is off by more than
# the limit; the current ran beyond every limit.
Failure = Literal["no hand-over", "stalled", "half a turn", "swings", "angle", "speed", "overload"]
SPEED_LIMIT = 0.05  # Largest deviation of the mean speed from its reference, relative.
ANGLE_LIMIT = math.radians(30.0)  # Largest error of the observer's angle in rad, r.m.s.
SWING_LIMIT = 0.2  # Largest swing of the speed, peak to peak, over its reference.
_STANDS = 0.2  # of the reference: slower is a standstill
_HALF_TURN = 0.5 * math.pi


@dataclass(frozen=True, slots=True, eq=False)
class StartRecord:
    """Samples of one start, shapes (N,).

    Args:
        time: In s, ascending.
        omega_m: True mechanical speed in rad/s.
        reference: The speed that is asked for, mechanical, in rad/s; it must not be zero at the
            end.
        angle_error: The observer's angle less the true one in rad, wrapped; nan where none is
            known.
        ruling: Whether the observer rules.
        reported: Whether the drive reports a fault, at the end or in a try before.
        broken: Whether the current ran beyond every limit.
    """

    time: FloatArray
    omega_m: FloatArray
    reference: FloatArray
    angle_error: FloatArray
    ruling: FloatArray
    reported: bool
    broken: bool = False


@dataclass(frozen=True, slots=True)
class StartVerdict:
    """How a start went.

    Args:
        failure: What happened, None where the drive has started.
        reported: Whether the drive reported a fault.
        speed_error: Mean speed at the end over its reference, less 1.
        angle_error: Error of the observer's angle at the end in rad, r.m.s.; nan where the record
            has none.
        swing: Swing of the speed at the end, peak to peak, over its reference.
        time_90: When 90 % of the reference was first reached, in s; nan if never.
        hand_over_error: Error of the observer's angle in rad when it took over; nan if it never
            did.
        back_turn: Largest mechanical movement against the direction of the start, in rad.
    """

    failure: Failure | None
    reported: bool
    speed_error: float
    angle_error: float
    swing: float
    time_90: float
    hand_over_error: float
    back_turn: float

    @property
    def started(self) -> bool:
        """Whether the drive has started."""
        return self.failure is None

    @property
    def silent(self) -> bool:
        """Whether it has not, and does not say so."""
        return self.failure is not None and not self.reported


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _back_turn(time: FloatArray, speed: FloatArray) -> float:
    """Farthest that a shaft turns back from where it was, in rad; speed in rad/s."""
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(time)
    return max(0.0, -float(np.min(np.cumsum(steps), initial=0.0)))


def _failure(
    record: StartRecord, last: IndexArray, speed_error: float, angle_error: float, swing: float
) -> Failure | None:
    """The first of what can be said of the last samples."""
    rules, stands = bool(np.all(record.ruling[last] > 0.0)), abs(1.0 + speed_error) < _STANDS
    ruled = bool(np.any(record.ruling > 0.0))
    said: tuple[tuple[Failure, bool], ...] = (
        ("overload", record.broken),
        ("stalled", stands and ruled),
        ("no hand-over", not rules),
        ("half a turn", float(np.mean(np.abs(record.angle_error[last]))) > _HALF_TURN),
        ("swings", swing >= SWING_LIMIT),
        ("angle", not angle_error <= ANGLE_LIMIT),
        ("speed", not abs(speed_error) <= SPEED_LIMIT),
    )
    return next((name for name, holds in said if holds), None)


def judge_start(record: StartRecord, settled: float) -> StartVerdict:
    """How a start went.

    Args:
        record: Its samples.
        settled: Length in s of the last part, in which everything must hold.
    """
    last = np.flatnonzero(record.time >= record.time[-1] - settled)
    wanted = float(record.reference[-1])
    share = record.omega_m / wanted
    speed_error, swing = float(np.mean(share[last])) - 1.0, float(np.ptp(share[last]))
    angle_error = _rms(record.angle_error[last])
    reached = np.flatnonzero(share >= 0.9)
    ruling = np.flatnonzero(record.ruling > 0.0)
    return StartVerdict(
        failure=_failure(record, last, speed_error, angle_error, swing),
        reported=record.reported,
        speed_error=speed_error,
        angle_error=angle_error,
        swing=swing,
        time_90=float(record.time[reached[0]]) if reached.size else math.nan,
        hand_over_error=float(record.angle_error[ruling[0]]) if ruling.size else math.nan,
        back_turn=_back_turn(record.time, record.omega_m * np.sign(wanted)),
    )


@dataclass(frozen=True, slots=True)
class StartRate:
    """How often drives started.

    Args:
        load: Load torque over the torque of the current limit in the q axis.
        verdicts: One per start.
    """

    load: float
    verdicts: tuple[StartVerdict, ...]

    @property
    def count(self) -> int:
        """How many starts."""
        return len(self.verdicts)

    @property
    def succeeded(self) -> int:
        """How many of them succeeded."""
        return sum(verdict.started for verdict in self.verdicts)

    @property
    def rate(self) -> float:
        """The share that succeeded."""
        return self.succeeded / self.count

    @property
    def interval(self) -> tuple[float, float]:
        """Within which the true share lies with 95 %."""
        from dqforge.optimizer.exploration.acceptance import wilson

        return wilson(self.succeeded, self.count)

    @property
    def failures(self) -> dict[str, int]:
        """How often each failure, the most frequent first."""
        found = Counter(one.failure for one in self.verdicts if one.failure is not None)
        return dict(sorted(found.items(), key=lambda item: (-item[1], item[0])))

    @property
    def silent(self) -> int:
        """How many failed without a report."""
        return sum(verdict.silent for verdict in self.verdicts)


def percentile(verdicts: Sequence[StartVerdict], name: str, share: float) -> float:
    """Percentile of the magnitude of one figure over the starts that succeeded; nan without any.

    Args:
        verdicts: Of the starts.
        name: Of the figure: a field of `StartVerdict`.
        share: In percent.
    """
    values = [abs(float(getattr(one, name))) for one in verdicts if one.started]
    return float(np.percentile(values, share)) if values else math.nan


# Speed and angle of a rotor that already turns, from the currents of short pulses.
#
# All lower switches short the winding for a time T and open again; the EMF alone has made a
# current, which dies in the diodes. In the frame of the rotor every pulse makes the same current
# i_0(omega), so that two of them that begin a time S apart differ by the angle that the rotor has
# turned:
#
#     i_1 = i_0 exp(j theta_1),  i_2 = i_0 exp(j theta_2):
#     omega = arg(i_2 / i_1) / S,   unique while |omega| S < pi
#     theta = arg(i_2) - arg(i_0(omega))
#
# with the short-circuit current of the model
#
#     di_d/dt = (-R i_d + omega L_q i_q)/L_d
#     di_q/dt = (-R i_q - omega L_d i_d - omega psi)/L_q     from rest
#
# at first i_q = -omega psi T/L_q. Its direction does not depend on psi and hardly on R. Noise of
# sigma per component turns a current |i| by sigma/|i|, the speed by sqrt(2) sigma/(|i| S): a third
# pulse after a longer time S_3, whose turns the first pair tells, divides that by S_3/S.

LEVEL = 0.15  # Share of the largest current that a pulse is to reach.

# Angle in rad that the rotor may turn between two pulses at the largest speed.
TURN = 0.8 * math.pi
LONG = 5.0  # How much longer the third pulse waits than the second.
LONG_BELOW = 0.2  # Share of the largest speed below which the third pulse is needed.
STANDSTILL = 0.05  # Share of the largest speed below which the rotor counts as at rest.
LEAST_FRACTION = 0.05  # Shortest pulse as a share of a sampling period.


@dataclass(frozen=True, slots=True)
class FlyingStart:
    """Pulses by which a turning rotor is found.

    Args:
        fraction: Length of the shortest pulse in sampling periods, at most 1: with it the largest
            speed makes no more than the largest current.
        longest: Length of the longest pulse in sampling periods. A pulse that has not made
            ``level`` is tried again with twice the length.
        spacing: From the begin of a pulse to that of the next one, in sampling periods.
        long_spacing: From the begin of the second pulse to that of the third one, in sampling
            periods.
        level: Current in A that a pulse is to reach.
        peak: Current in A of the shortest pulse at the largest speed.
        omega_max, omega_long, omega_least: Electrical speeds in rad/s: the largest that is unique,
            the one below which the third pulse is needed, and the one below which the rotor counts
            as at rest.
    """

    fraction: float
    longest: int
    spacing: int
    long_spacing: int
    level: float
    peak: float
    omega_max: float
    omega_long: float
    omega_least: float


def short_circuit_current(machine: LinearMachine, omega: FloatArray, time: float) -> ComplexArray:
    """Current i_d + j i_q in A after a short circuit from rest.

    Args:
        machine: Its constants.
        omega: Electrical speeds in rad/s, shape (N,).
        time: Length of the short circuit in s.
    """
    omega = np.asarray(omega, dtype=np.float64)
    d, q = machine.r_s / machine.l_d, machine.r_s / machine.l_q
    # x = exp(A time) x_0 + ..., A of the second order: mean rate, and what is left of it.
    mean = -0.5 * (d + q)
    root = np.sqrt((0.25 * (d - q) ** 2 - omega**2).astype(np.complex128))
    hyperbolic = np.where(
        np.abs(root) * time > 1e-8, np.sinh(root * time) / np.where(root == 0.0, 1.0, root), time
    )
    decay = np.exp(mean * time)
    even, odd = (decay * np.cosh(root * time)).real, (decay * hyperbolic).real
    # Deviation from the steady short-circuit current, at first minus that current.
    square = d * q + omega**2
    steady_d = -(omega**2) * machine.psi_pm / (machine.l_d * square)
    steady_q = -omega * d * machine.psi_pm / (machine.l_q * square)
    cross_d, cross_q = omega * machine.l_q / machine.l_d, -omega * machine.l_d / machine.l_q
    first_d = even + odd * (-d - mean)
    first_q = even + odd * (-q - mean)
    i_d = steady_d - (first_d * steady_d + odd * cross_d * steady_q)
    i_q = steady_q - (odd * cross_q * steady_d + first_q * steady_q)
    return np.asarray(i_d + 1j * i_q)


def _fraction(machine: LinearMachine, t_s: float, omega_max: float, i_limit: float) -> float:
    """Largest share of a period, halved from 1 on, whose current does not exceed the limit."""
    fraction, speed = 1.0, np.array([omega_max])
    while fraction > LEAST_FRACTION:
        if abs(short_circuit_current(machine, speed, fraction * t_s)[0]) <= i_limit:
            return fraction
        fraction *= 0.5
    return 0.0


def plan_flying_start(
    machine: LinearMachine,
    t_s: float,
    omega_max: float,
    *,
    fractions: bool = False,
    i_limit: float | None = None,
) -> FlyingStart:
    """Pulses for speeds up to ``omega_max``.

    Args:
        machine: Its constants; ``i_max`` is the largest current.
        t_s: Sampling period in s.
        omega_max: Largest electrical speed in rad/s.
        fractions: Whether pulses shorter than a sampling period can be made.
        i_limit: Current in A that no pulse may exceed; None for ``machine.i_max``.

    Raises:
        NoSolutionError: There is no magnet, the shortest pulse makes too much current, or the rotor
            turns too far between two pulses; the message has the number.
    """
    where, limit = "control.start_up.flying_start", machine.i_max if i_limit is None else i_limit
    if not machine.psi_pm > 0.0:
        raise NoSolutionError(f"{where}: a rotor without magnets makes no current")
    fraction = _fraction(machine, t_s, omega_max, limit)
    if fraction == 0.0 or (fraction < 1.0 and not fractions):
        peak = abs(short_circuit_current(machine, np.array([omega_max]), t_s)[0])
        raise NoSolutionError(
            f"{where}: a short circuit of one sampling period makes {peak:.3g} A at "
            f"{omega_max:.4g} rad/s, more than {limit:.3g} A; sample faster, or start from rest"
        )
    spacing = math.floor(TURN / (omega_max * t_s))
    if spacing < 3:
        raise NoSolutionError(
            f"{where}: the rotor turns {math.degrees(3.0 * omega_max * t_s):.3g} deg in three "
            f"sampling periods, the least between two pulses; at most "
            f"{math.degrees(TURN):.3g} deg can be distinguished"
        )
    peak = float(abs(short_circuit_current(machine, np.array([omega_max]), fraction * t_s)[0]))
    return FlyingStart(
        fraction=fraction,
        longest=max(1, spacing - 2),
        spacing=spacing,
        long_spacing=round(LONG * spacing),
        level=LEVEL * machine.i_max,
        peak=peak,
        omega_max=omega_max,
        omega_long=LONG_BELOW * omega_max,
        omega_least=STANDSTILL * omega_max,
    )


def speed_of_pair(first: ComplexArray, second: ComplexArray, spacing: float) -> FloatArray:
    """Electrical speed in rad/s from the currents of two pulses.

    Args:
        first, second: Currents alpha + j beta in A at the ends of two equal pulses, shape (N,).
        spacing: Time between them in s.
    """
    return np.asarray(np.angle(second * np.conj(first)) / spacing, dtype=np.float64)


def refined_speed(
    omega: FloatArray, second: ComplexArray, third: ComplexArray, long_spacing: float
) -> FloatArray:
    """Electrical speed in rad/s from a later pair, its turns told by a rough speed.

    Args:
        omega: Rough electrical speed in rad/s, shape (N,).
        second, third: Currents alpha + j beta in A at the ends of two equal pulses, shape (N,).
        long_spacing: Time between them in s.
    """
    gap = np.angle(third * np.conj(second) * np.exp(-1j * omega * long_spacing))
    return np.asarray(omega + gap / long_spacing, dtype=np.float64)


def angle_of_pulse(
    machine: LinearMachine, current: ComplexArray, omega: FloatArray, time: float
) -> FloatArray:
    """Electrical angle in rad at the end of a pulse, wrapped to -pi to pi.

    Args:
        machine: Its constants.
        current: Current alpha + j beta in A at the end of the pulse, shape (N,).
        omega: Electrical speed in rad/s, shape (N,).
        time: Length of the pulse in s.
    """
    model = short_circuit_current(machine, omega, time)
    return np.asarray(np.angle(current * np.conj(model)), dtype=np.float64)
