"""The settings of the start-up from what a start needs: a plan in samples."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from dqforge.optimizer.start_up.records import ALIGNMENTS, METHODS, StartupSettings

if TYPE_CHECKING:
    from dqforge.optimizer.start_up.plan import StartUpPlan


def _samples(time: float, plan: StartUpPlan, least: int = 1) -> int:
    return max(least, min(round(time / plan.t_s), 2**31 - 1))


def _share(time: float, plan: StartUpPlan) -> float:
    """Share of a new sample in a filter of a time constant in s."""
    return -math.expm1(-plan.t_s / time)


def startup_settings(plan: StartUpPlan) -> StartupSettings:
    """Values of all members, floats and whole numbers.

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
    return StartupSettings(**values)
