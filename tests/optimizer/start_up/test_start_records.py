"""A plan in samples: every member of the settings by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from start_designs import start_design

from dqforge.optimizer.start_up.plan import StartUpPlan, start_up_plan
from dqforge.optimizer.start_up.start_records import StartupSettings

COPIED = {
    "r_s_Ohm": "r_s", "l_d_H": "l_d", "l_q_H": "l_q", "psi_pm_Wb": "psi_pm", "t_s": "t_s",
    "torque_per_A": "torque_per_ampere", "align_A": "align_current", "align_V": "align_voltage",
    "align_damping": "align_damping", "ramp_A": "ramp_current", "boost_V": "boost",
    "damping": "damping", "hand_over": "hand_over", "mix_from": "mix_from",
    "back_below": "back_below", "ramp_end": "ramp_end", "agree_share": "agree_share",
    "held_A": "held_current", "stall_below": "stall_below", "ratio_above": "ratio_above",
    "ratio_low": "ratio_low", "ratio_high": "ratio_high", "trip_A": "trip_current",
    "v_dc_min_V": "v_dc_min", "catch_A": "catch_current", "catch_least": "catch_least",
    "polarity_share": "polarity_share", "polarity_A": "polarity_current", "retries": "retries",
}  # fmt: skip
SAMPLES = {
    "align_samples": "align_time", "agree_samples": "agree_time", "patience_samples": "patience",
    "fade_samples": "fade_time", "stall_samples": "stall_time",
    "settled_samples": "ratio_settled", "ratio_samples": "ratio_time",
    "wait_samples": "retry_pause", "search_samples": "search_time",
    "polarity_samples": "polarity_time", "catch_samples": "catch_longest",
}  # fmt: skip


def plan_of() -> StartUpPlan:
    plan = start_up_plan(start_design("{}", 1.2))
    assert plan is not None
    return plan


@pytest.mark.parametrize("slow", [1.0, 3.7])
@pytest.mark.parametrize("align_time", [None, 0.0])
def test_every_member_is_that_of_the_plan(slow: float, align_time: float | None) -> None:
    plan = plan_of()
    plan = replace(
        plan, t_s=slow * plan.t_s, l_d=0.8 * plan.l_q, ramp_rise=0.05, catch_pause=2.6 * plan.t_s
    )
    if align_time is not None:
        plan = replace(plan, align_time=align_time)
    found, t_s = StartupSettings.of(plan), plan.t_s
    for name, of in COPIED.items():
        assert getattr(found, name) == getattr(plan, of)
    for name, of in SAMPLES.items():
        assert getattr(found, name) == max(1, round(getattr(plan, of) / t_s))
    assert found.pause_samples == 3
    longer = replace(plan, catch_pause=5.2 * t_s)
    assert StartupSettings.of(longer).pause_samples == 5
    expected = {
        "reluctance": 1.5 * plan.pole_pairs * (plan.l_d - plan.l_q),
        "align_rise": 2.0 / max(1, round(plan.align_time / t_s)),
        "align_share": 1.0 - math.exp(-t_s / plan.align_filter),
        "ratio_share": 1.0 - math.exp(-t_s / plan.ratio_filter),
        "mean_share": 1.0 - math.exp(-t_s / 0.05),
        "ramp_A_step": plan.current_limit * t_s / min(0.05, plan.align_time or 0.05),
        "ramp_step": plan.ramp_acceleration * t_s,
        "ramp_jerk": plan.ramp_acceleration * t_s / round(0.05 / t_s),
        "run_step": plan.run_acceleration * t_s,
        "catch_slow": 0.5 * plan.base_speed,
        "mix_step": t_s / plan.agree_time,
    }
    for name, value in expected.items():
        assert getattr(found, name) == pytest.approx(value, rel=1e-9)
