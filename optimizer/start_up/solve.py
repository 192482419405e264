"""The start of a design: its plan, what each method could lift, and what is refused."""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.reading import ROUNDING_OF_DATA
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import StartUpMethodName
from dqforge.machines.phase_machines.frame_choice import controlled_frame
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.estimators.solve import TunedTracker, solve_tracker, tune_tracker
from dqforge.optimizer.observers.conditions import lost_voltage
from dqforge.optimizer.start_up.flying_start import plan_flying_start
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
            f"control asks for, up to {limit:.4g} A; write more, such as {1.8 * limit:.3g} A"
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
            "control.start_up: an active load turns the rotor before a current stands; write "
            "brake: true for a brake that opens once the drive holds, or load: friction"
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
            f"{plan.load_torque:.4g} N m are asked for; write less, or a larger current"
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
