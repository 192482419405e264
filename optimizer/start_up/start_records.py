"""States, faults, settings, samples and memory of the start-up, with units.

Speeds are electrical, in rad/s, angles electrical in rad, vectors amplitude-invariant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.float_control.records import Control
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Dq, Member

if TYPE_CHECKING:
    from dqforge.optimizer.start_up.plan import StartUpPlan


class StartupState(IntEnum):
    """What the drive is doing."""

    IDLE = 0
    CATCH = 1
    ALIGN = 2
    SEARCH = 3
    POLARITY = 4
    RAMP = 5
    LOW = 6
    RUN = 7
    WAIT = 8
    FAULT = 9


class StartupFault(IntEnum):
    """Why a start failed, or the drive stopped."""

    NO_FAULT = 0
    SAMPLE = 1
    OVERCURRENT = 2
    UNDERVOLTAGE = 3
    NO_HANDOVER = 4
    STALLED = 5
    LOST = 6
    NO_POLARITY = 7


# What is said of them.
STATES: Mapping[StartupState, str] = {
    StartupState.IDLE: "no gate pulses, no command",
    StartupState.CATCH: "short circuits tell whether the rotor turns already",
    StartupState.ALIGN: "the rotor is brought to a known angle",
    StartupState.SEARCH: "the axis is found by its saliency",
    StartupState.POLARITY: "... and which end of it is north",
    StartupState.RAMP: "a current or a voltage turns, the rotor follows",
    StartupState.LOW: "speed control below the hand-over",
    StartupState.RUN: "speed control on the observer",
    StartupState.WAIT: "no gate pulses before the next try",
    StartupState.FAULT: "no gate pulses until the command goes",
}
FAULTS: Mapping[StartupFault, str] = {
    StartupFault.NO_FAULT: "",
    StartupFault.SAMPLE: "a sample is not a number",
    StartupFault.OVERCURRENT: "a current above trip_A",
    StartupFault.UNDERVOLTAGE: "a DC link below v_dc_min_V",
    StartupFault.NO_HANDOVER: "the observer did not find the rotor in time",
    StartupFault.STALLED: "the speed stayed far below its reference",
    StartupFault.LOST: "the EMF does not fit the speed",
    StartupFault.NO_POLARITY: "north and south answered alike",
}

RESTING = (StartupState.IDLE, StartupState.WAIT, StartupState.FAULT)  # No gate pulses.

# In the order of their numbers in `StartupSettings`.
METHODS = ("i-f", "v-f", "direct", "saliency")
ALIGNMENTS = ("none", "one-step", "two-step", "voltage")


def _samples(time: float, plan: StartUpPlan, least: int = 1) -> int:
    return max(least, min(round(time / plan.t_s), 2**31 - 1))


def _share(time: float, plan: StartUpPlan) -> float:
    """Share of a new sample in a filter of a time constant in s."""
    return -math.expm1(-plan.t_s / time)


@dataclass(frozen=True, slots=True)
class StartupSettings:
    """Everything that can be set; the constant behind it holds the values of the design. Speeds are
    electrical, in rad/s.
    """

    method: Annotated[Any, Member("0 I-f, 1 V/f, 2 direct, 3 saliency", whole=True)]
    alignment: Annotated[Any, Member("0 none, 1 one step, 2 two steps, 3 voltage", whole=True)]
    flying: Annotated[Any, Member("1: look for a rotor that turns already", whole=True)]
    retries: Annotated[Any, Member("further tries after a failed start", whole=True)]
    align_samples: Annotated[Any, Member("duration of the alignment", whole=True)]
    agree_samples: Annotated[Any, Member("the observer's speed agrees for so long", whole=True)]
    patience_samples: Annotated[Any, Member("beyond the planned end", whole=True)]
    fade_samples: Annotated[Any, Member("in which the held current goes", whole=True)]
    stall_samples: Annotated[Any, Member("too slow for so long", whole=True)]
    settled_samples: Annotated[Any, Member("above ratio_above for so long", whole=True)]
    ratio_samples: Annotated[Any, Member("EMF outside its limits for so long", whole=True)]
    wait_samples: Annotated[Any, Member("without current before the next try", whole=True)]
    search_samples: Annotated[Any, Member("to find the axis by saliency", whole=True)]
    polarity_samples: Annotated[Any, Member("per side of the axis", whole=True)]
    catch_samples: Annotated[Any, Member("longest pulse of a flying start", whole=True)]
    pause_samples: Annotated[Any, Member("between two of them", whole=True)]
    t_s: Annotated[Reals, Member("sampling period, s")]
    r_s_Ohm: Annotated[Reals, Member("phase resistance")]  # noqa: N815
    l_d_H: Reals  # noqa: N815
    l_q_H: Reals  # noqa: N815
    psi_pm_Wb: Reals  # noqa: N815
    torque_per_A: Annotated[Reals, Member("3/2 p psi_pm, N m/A")]  # noqa: N815
    reluctance: Annotated[Reals, Member("3/2 p (L_d - L_q), N m/A^2")]
    align_A: Annotated[Reals, Member("current of the alignment")]  # noqa: N815
    align_V: Annotated[Reals, Member("voltage of the alignment")]  # noqa: N815
    align_rise: Annotated[Reals, Member("per sample, 0 to 1 in half of it")]
    align_damping: Annotated[Reals, Member("A against the turning rotor per rad/s")]
    align_share: Annotated[Reals, Member("of a new sample in its speed")]
    ramp_A: Annotated[Reals, Member("current of the ramp")]  # noqa: N815
    ramp_A_step: Annotated[Reals, Member("its change per sample")]  # noqa: N815
    ramp_step: Annotated[Reals, Member("acceleration, rad/s per sample")]
    ramp_jerk: Annotated[Reals, Member("change of ramp_step per sample")]
    boost_V: Annotated[Reals, Member("voltage of the voltage ramp at rest")]  # noqa: N815
    damping: Annotated[Reals, Member("rad/s per V of active voltage above its mean")]
    mean_share: Annotated[Reals, Member("of that mean, 50 ms")]
    hand_over: Annotated[Reals, Member("the observer takes over from here, rad/s")]
    mix_from: Annotated[Reals, Member("its angle counts from here")]
    back_below: Annotated[Reals, Member("it hands back below, rad/s")]
    ramp_end: Annotated[Reals, Member("the ramp ends here, rad/s")]
    agree_share: Annotated[Reals, Member("of the speed of the ramp")]
    held_A: Annotated[Reals, Member("d current until the observer takes over")]  # noqa: N815
    run_step: Annotated[Reals, Member("slope of the reference, rad/s per sample")]
    stall_below: Annotated[Reals, Member("rad/s")]
    ratio_above: Annotated[Reals, Member("the EMF is checked above, rad/s")]
    ratio_low: Annotated[Reals, Member("least EMF over omega psi")]
    ratio_high: Annotated[Reals, Member("largest EMF over omega psi")]
    ratio_share: Annotated[Reals, Member("of a new sample in its filter")]
    trip_A: Annotated[Reals, Member("overcurrent")]  # noqa: N815
    v_dc_min_V: Annotated[Reals, Member("undervoltage; 0: not checked")]  # noqa: N815
    catch_A: Annotated[Reals, Member("current that a pulse should reach")]  # noqa: N815
    catch_slow: Annotated[Reals, Member("slower needs a third pulse, rad/s")]
    catch_least: Annotated[Reals, Member("slower is at rest, rad/s")]
    mix_step: Annotated[Reals, Member("change of the observer's share per sample")]
    polarity_share: Annotated[Reals, Member("least difference of the ripples over their sum")]
    polarity_A: Annotated[Reals, Member("current of the test of the polarity")]  # noqa: N815

    @classmethod
    def of(cls, plan: StartUpPlan) -> StartupSettings:
        """A plan in samples: floats and whole numbers.

        Args:
            plan: What the start needs.
        """
        values: dict[str, Any] = {
            "method": METHODS.index(plan.method),
            "alignment": ALIGNMENTS.index(plan.alignment),
            "flying": int(plan.flying),
            "retries": plan.retries,
            "align_samples": _samples(plan.align_time, plan),
            "agree_samples": _samples(plan.agree_time, plan),
            "patience_samples": _samples(plan.patience, plan),
            "fade_samples": _samples(plan.fade_time, plan),
            "stall_samples": _samples(plan.stall_time, plan),
            "settled_samples": _samples(plan.ratio_settled, plan),
            "ratio_samples": _samples(plan.ratio_time, plan),
            "wait_samples": _samples(plan.retry_pause, plan),
            "search_samples": _samples(plan.search_time, plan),
            "polarity_samples": _samples(plan.polarity_time, plan),
            "catch_samples": _samples(plan.catch_longest, plan),
            "pause_samples": _samples(plan.catch_pause, plan, 3),
            "t_s": plan.t_s,
            "r_s_Ohm": plan.r_s,
            "l_d_H": plan.l_d,
            "l_q_H": plan.l_q,
            "psi_pm_Wb": plan.psi_pm,
            "torque_per_A": plan.torque_per_ampere,
            "reluctance": 1.5 * plan.pole_pairs * (plan.l_d - plan.l_q),
            "align_A": plan.align_current,
            "align_V": plan.align_voltage,
            "align_rise": 2.0 / _samples(plan.align_time, plan),
            "align_damping": plan.align_damping,
            "align_share": _share(plan.align_filter, plan),
            "ramp_A": plan.ramp_current,
            "ramp_A_step": plan.current_limit * plan.t_s / min(0.05, plan.align_time or 0.05),
            "ramp_step": plan.ramp_acceleration * plan.t_s,
            "ramp_jerk": plan.ramp_acceleration * plan.t_s / _samples(plan.ramp_rise, plan),
            "boost_V": plan.boost,
            "damping": plan.damping,
            "mean_share": _share(0.05, plan),
            "hand_over": plan.hand_over,
            "mix_from": plan.mix_from,
            "back_below": plan.back_below,
            "ramp_end": plan.ramp_end,
            "agree_share": plan.agree_share,
            "held_A": plan.held_current,
            "run_step": plan.run_acceleration * plan.t_s,
            "stall_below": plan.stall_below,
            "ratio_above": plan.ratio_above,
            "ratio_low": plan.ratio_low,
            "ratio_high": plan.ratio_high,
            "ratio_share": _share(plan.ratio_filter, plan),
            "trip_A": plan.trip_current,
            "v_dc_min_V": plan.v_dc_min,
            "catch_A": plan.catch_current,
            "catch_slow": 0.5 * plan.base_speed,
            "catch_least": plan.catch_least,
            "mix_step": plan.t_s / plan.agree_time,
            "polarity_share": plan.polarity_share,
            "polarity_A": plan.polarity_current,
        }
        return cls(**values)


@dataclass(slots=True)
class Measured:
    """Samples of an instant with the angle and the speed that the control is given."""

    i: Annotated[Abc, Member("phase currents, A")]
    theta_e: Annotated[Reals, Member("electrical angle of the d axis from phase a, rad")]
    omega_m: Annotated[Reals, Member("mechanical speed, rad/s")]
    v_dc: Annotated[Reals, Member("DC-link voltage, V")]


@dataclass(frozen=True, slots=True)
class StartupSample:
    """Samples of one instant."""

    i: Annotated[Abc, Member("phase currents, A")]
    v_dc: Annotated[Reals, Member("DC-link voltage, V")]
    u: Annotated[
        Reals | None,
        Member("mean of v_a + v_b + v_c against the star point over the period that ends now, V"),
    ]


@dataclass(slots=True)
class StartupOutput:
    """What the inverter does from the next sampling instant on, for one period."""

    duty: Annotated[Abc, Member("duty cycles 0 to 1 of the upper switches")]
    gate: Annotated[Any, Member("1: gate pulses; 0: all switches off", whole=True)]


@dataclass(slots=True)
class Followed:
    """What the start-up reads of the estimator at speed."""

    theta_e: Reals
    omega_e: Reals


@dataclass(slots=True)
class FollowedFromRest:
    """What it reads of the estimator from standstill on."""

    added: AlphaBeta
    current: AlphaBeta
    theta_e: Reals
    omega_e: Reals


def _count(text: str) -> Member:
    return Member(text, whole=True)


@dataclass(slots=True)
class Startup:
    """What changes from sample to sample; startup_init begins it.

    ``low``, ``share`` and ``ripple`` are None without an estimator from standstill on.
    """

    control: Control
    observer: Followed
    low: Annotated[FollowedFromRest | None, Member("from standstill on")]
    state: Annotated[Any, Member("", kind=StartupState)]
    fault: Annotated[
        Any,
        Member("the last one, until a start succeeds or the command goes", kind=StartupFault),
    ]
    tries: Annotated[Any, _count("of this command")]
    time: Annotated[Any, _count("samples in this state")]
    agreed: Annotated[Any, _count("samples for which the observer agrees")]
    late: Annotated[Any, _count("samples beyond the planned end")]
    slow: Annotated[Any, _count("samples of too little speed")]
    settled: Annotated[Any, _count("samples of enough speed")]
    over: Annotated[Any, _count("samples of far too much speed")]
    outside: Annotated[Any, _count("samples of a wrong EMF")]
    fading: Annotated[Any, _count("samples for which the held current still fades")]
    pulse: Annotated[Any, _count("flying start: pulses so far")]
    length: Annotated[Any, _count("... and their length in samples")]
    direction: Annotated[Reals, Member("1 or -1")]
    theta_e: Annotated[Reals, Member("angle that is used, rad")]
    omega_e: Annotated[Reals, Member("speed of the ramp, or that is used, rad/s")]
    step: Annotated[Reals, Member("acceleration of the ramp, rad/s per sample")]
    current: Annotated[Reals, Member("of the ramp, A")]
    turning: Annotated[Reals, Member("alignment: speed of the rotor, rad/s")]
    last_q: Annotated[Reals, Member("... and last current across, A")]
    power: Annotated[Reals, Member("mean of the active voltage, V")]
    emf: Annotated[Reals, Member("filtered, V")]
    reference: Annotated[Reals, Member("of the speed, on its slope, rad/s")]
    share: Annotated[Reals | None, Member("of the observer in angle and speed, 0 to 1")]
    ripple: Annotated[
        tuple[Reals, Reals] | None, Member("of the d current at both ends of the axis, A")
    ]
    along: Annotated[Dq, Member("direction of the current in the ramp's frame")]
    fade: Annotated[Dq, Member("of the held current per sample, A")]
    acted: Annotated[AlphaBeta, Member("voltage over the period that ends now, V")]
    first: Annotated[AlphaBeta, Member("flying start: current at the end of the first pulse, A")]

    @classmethod
    def blank(
        cls, control: Control, observer: Followed, low: FollowedFromRest | None, zero: Any
    ) -> Startup:
        """Members of a memory before `startup_init`.

        Args:
            control: State of the control.
            observer, low: What is read of the estimators; ``low`` is None without one.
            zero: The number 0 of an arithmetic.
        """
        pair, turn = Dq(zero, zero), AlphaBeta(zero, zero)
        return cls(
            control,
            observer,
            low,
            StartupState.IDLE,
            StartupFault.NO_FAULT,
            *(0,) * 11,
            *(zero,) * 10,
            None if low is None else zero,
            None if low is None else (zero, zero),
            pair,
            pair,
            turn,
            turn,
        )
