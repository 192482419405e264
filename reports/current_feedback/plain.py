"""Current-feedback PWM as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.optimizer.losses.drive_budget import PARTS

if TYPE_CHECKING:
    from dqforge.optimizer.current_feedback.regulator_numbers import RegulatorPlan
    from dqforge.optimizer.current_feedback.regulator_runs import RegulatorRun
    from dqforge.optimizer.current_feedback.solve import CurrentFeedback, LoadRuns
    from dqforge.reports.plain_data import PlainData


def plain_plan(plan: RegulatorPlan) -> PlainData:
    """Numbers of a regulator, those that its method does not use too."""
    return {
        "method": plan.method,
        "band_A": plan.band,
        "outer_band_A": plan.outer_band,
        "kp": plan.kp,
        "ki": plan.ki,
        "carrier_Hz": plan.carrier,
        "comparator_band_V": plan.comparator_band,
        "t_s": plan.t_s,
        "pulses": plan.pulses,
    }


def plain_run(run: RegulatorRun) -> list[PlainData]:
    """One entry per point."""
    numbers = {
        "torque_asked_Nm": run.points.torque,
        "omega_m_rad_per_s": run.points.omega_m,
        "i_d_A": run.points.i_d,
        "i_q_A": run.points.i_q,
        "frequency_Hz": run.frequency,
        "lowest_Hz": run.lowest,
        "highest_Hz": run.highest,
        "rms_error_A": run.rms_error,
        "largest_error_A": run.largest_error,
        "distortion": run.distortion,
        "stored_W": run.stored,
        "torque_Nm": run.budget.torque,
        "shaft_W": run.budget.shaft_power,
        "input_W": run.budget.input_power,
        "total_W": run.budget.total,
        "junction_degC": run.budget.junction_temperature,
    } | {f"{part}_W": getattr(run.budget, part) for part in PARTS}
    return [
        {"method": run.plan.method, "obstacle": run.obstacles[p] or None}
        | {name: _or_none(values[p]) for name, values in numbers.items()}
        for p in range(run.points.omega_m.size)
    ]


def _or_none(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)


def plain_loads(loads: LoadRuns | None) -> PlainData | None:
    """Regulators and modulators at the loads."""
    if loads is None:
        return None
    own, budget = loads.runs[loads.own], loads.budget
    return {
        "regulators": [entry for run in loads.runs for entry in plain_run(run)],
        "modulators": [
            {
                "modulation": name,
                "torque_asked_Nm": own.points.torque[p],
                "omega_m_rad_per_s": own.points.omega_m[p],
                "frequency_Hz": _or_none(own.frequency[p]),
                "ripple_current_A": _or_none(budget.ripple_current[m, p]),
                "distortion": _or_none(loads.distortion[m, p]),
                "torque_Nm": _or_none(budget.torque[m, p]),
                "total_W": _or_none(budget.total[m, p]),
            }
            | {f"{part}_W": _or_none(getattr(budget, part)[m, p]) for part in PARTS}
            for m, name in enumerate(loads.modulations)
            for p in range(own.points.omega_m.size)
        ],
    }


def plain_feedback(found: CurrentFeedback) -> PlainData:
    """What ``result.json`` says of it."""
    speed, lag = found.speed, found.equivalent
    return {
        "regulator": plain_plan(found.plan),
        "over_speed": [entry for run in found.over_speed for entry in plain_run(run)],
        "loads": plain_loads(found.loads),
        "speed": None
        if speed is None or lag is None
        else {
            "lag_rad_per_s": lag.bandwidth,
            "delay_s": lag.delay,
            "kp": speed.kp,
            "ki": speed.ki,
            "ki_ts": speed.ki_ts,
            "crossover_rad_per_s": speed.margins.crossover,
            "phase_margin_rad": speed.margins.phase_margin,
        },
        "patterns": [
            {
                "omega_m_rad_per_s": pattern.omega_m,
                "index": pattern.index,
                "first_level": pattern.sign,
                "angles_rad": list(pattern.angles),
            }
            for pattern in found.patterns
        ],
    }
