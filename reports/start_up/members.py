"""The members of ``<prefix>_startup_settings_t`` and their values: a plan in samples, as numbers of
single precision.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.optimizer.start_up.plan import StartUpPlan

METHODS = ("i-f", "v-f", "direct", "saliency")  # In the order of their numbers in the C code.

# In the order of their numbers in the C code.
ALIGNMENTS = ("none", "one-step", "two-step", "voltage")


@dataclass(frozen=True, slots=True)
class Member:
    """One member: its C type (``float`` or ``uint32_t``), and its value by the plan."""

    name: str
    comment: str
    value: Callable[[StartUpPlan], float]
    whole: bool = False

    @property
    def kind(self) -> str:
        """Its C type."""
        return "uint32_t" if self.whole else "float"


def _samples(time: float, plan: StartUpPlan, least: int = 1) -> int:
    return max(least, min(round(time / plan.t_s), 2**31 - 1))


def _share(time: float, plan: StartUpPlan) -> float:
    """Share of a new sample in a filter of a time constant in s."""
    return -math.expm1(-plan.t_s / time)


def _count(name: str, comment: str, time: Callable[[StartUpPlan], float]) -> Member:
    return Member(name, comment, lambda plan: _samples(time(plan), plan), whole=True)


# The members in the order of the C structure.
MEMBERS: tuple[Member, ...] = (
    Member("method", "0 I-f, 1 V/f, 2 direct, 3 saliency", lambda p: METHODS.index(p.method), True),
    Member(
        "alignment",
        "0 none, 1 one step, 2 two steps, 3 voltage",
        lambda p: ALIGNMENTS.index(p.alignment),
        True,
    ),
    Member("flying", "1: look for a rotor that turns already", lambda p: int(p.flying), True),
    Member("retries", "further tries after a failed start", lambda p: p.retries, True),
    _count("align_samples", "duration of the alignment", lambda p: p.align_time),
    _count("agree_samples", "the observer's speed agrees for so long", lambda p: p.agree_time),
    _count("patience_samples", "beyond the planned end", lambda p: p.patience),
    _count("fade_samples", "in which the held current goes", lambda p: p.fade_time),
    _count("stall_samples", "too slow for so long", lambda p: p.stall_time),
    _count("settled_samples", "above ratio_above for so long", lambda p: p.ratio_settled),
    _count("ratio_samples", "EMF outside its limits for so long", lambda p: p.ratio_time),
    _count("wait_samples", "without current before the next try", lambda p: p.retry_pause),
    _count("search_samples", "to find the axis by saliency", lambda p: p.search_time),
    _count("polarity_samples", "per side of the axis", lambda p: p.polarity_time),
    _count("catch_samples", "longest pulse of a flying start", lambda p: p.catch_longest),
    Member("pause_samples", "between two of them", lambda p: _samples(p.catch_pause, p, 3), True),
    Member("t_s", "sampling period, s", lambda p: p.t_s),
    Member("r_s_Ohm", "phase resistance", lambda p: p.r_s),
    Member("l_d_H", "", lambda p: p.l_d),
    Member("l_q_H", "", lambda p: p.l_q),
    Member("psi_pm_Wb", "", lambda p: p.psi_pm),
    Member("torque_per_A", "3/2 p psi_pm, N m/A", lambda p: p.torque_per_ampere),
    Member(
        "reluctance", "3/2 p (L_d - L_q), N m/A^2", lambda p: 1.5 * p.pole_pairs * (p.l_d - p.l_q)
    ),
    Member("align_A", "current of the alignment", lambda p: p.align_current),
    Member("align_V", "voltage of the alignment", lambda p: p.align_voltage),
    Member(
        "align_rise", "per sample, 0 to 1 in half of it", lambda p: 2.0 / _samples(p.align_time, p)
    ),
    Member("align_damping", "A against the turning rotor per rad/s", lambda p: p.align_damping),
    Member("align_share", "of a new sample in its speed", lambda p: _share(p.align_filter, p)),
    Member("ramp_A", "current of the ramp", lambda p: p.ramp_current),
    Member(
        "ramp_A_step",
        "its change per sample",
        lambda p: p.current_limit * p.t_s / min(0.05, p.align_time or 0.05),
    ),
    Member("ramp_step", "acceleration, rad/s per sample", lambda p: p.ramp_acceleration * p.t_s),
    Member(
        "ramp_jerk",
        "change of ramp_step per sample",
        lambda p: p.ramp_acceleration * p.t_s / _samples(p.ramp_rise, p),
    ),
    Member("boost_V", "voltage of the voltage ramp at rest", lambda p: p.boost),
    Member("damping", "rad/s per V of active voltage above its mean", lambda p: p.damping),
    Member("mean_share", "of that mean, 50 ms", lambda p: _share(0.05, p)),
    Member("hand_over", "the observer rules from here, rad/s", lambda p: p.hand_over),
    Member("mix_from", "its angle counts from here", lambda p: p.mix_from),
    Member("back_below", "it rules no more below, rad/s", lambda p: p.back_below),
    Member("ramp_end", "the ramp ends here, rad/s", lambda p: p.ramp_end),
    Member("agree_share", "of the speed of the ramp", lambda p: p.agree_share),
    Member("held_A", "d current until the observer rules", lambda p: p.held_current),
    Member(
        "run_step", "slope of the reference, rad/s per sample", lambda p: p.run_acceleration * p.t_s
    ),
    Member("stall_below", "rad/s", lambda p: p.stall_below),
    Member("ratio_above", "the EMF is looked at above, rad/s", lambda p: p.ratio_above),
    Member("ratio_low", "least EMF over omega psi", lambda p: p.ratio_low),
    Member("ratio_high", "largest EMF over omega psi", lambda p: p.ratio_high),
    Member("ratio_share", "of a new sample in its filter", lambda p: _share(p.ratio_filter, p)),
    Member("trip_A", "overcurrent", lambda p: p.trip_current),
    Member("v_dc_min_V", "undervoltage; 0: not looked at", lambda p: p.v_dc_min),
    Member("catch_A", "current that a pulse should reach", lambda p: p.catch_current),
    Member("catch_slow", "slower asks for a third pulse, rad/s", lambda p: 0.5 * p.base_speed),
    Member("catch_least", "slower is at rest, rad/s", lambda p: p.catch_least),
    Member("mix_step", "change of the observer's share per sample", lambda p: p.t_s / p.agree_time),
    Member(
        "polarity_share",
        "least difference of the ripples over their sum",
        lambda p: p.polarity_share,
    ),
    Member("polarity_A", "current of the test of the polarity", lambda p: p.polarity_current),
)


def settings_of(plan: StartUpPlan) -> dict[str, float]:
    """Values of all members by name, whole numbers as int.

    Args:
        plan: What the start needs.
    """
    return {
        member.name: int(member.value(plan)) if member.whole else float(member.value(plan))
        for member in MEMBERS
    }


def settings_bytes(plan: StartUpPlan) -> bytes:
    """Bytes of ``<prefix>_startup_settings_t`` on this machine.

    Args:
        plan: What the start needs.
    """
    values = settings_of(plan)
    form = "".join("I" if member.whole else "f" for member in MEMBERS)
    return struct.pack(f"={form}", *(values[member.name] for member in MEMBERS))
