"""The comparison of estimators and start-ups as plain data."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.optimizer.estimator_comparison.solve import (
    NOBODY,
    UNREACHED,
    EstimatorComparison,
)
from dqforge.reports.estimator_comparison.observer_errors import plain_capture
from dqforge.reports.estimator_comparison.pair_words import pair_lines

if TYPE_CHECKING:
    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator, ComparedStart
    from dqforge.optimizer.estimator_comparison.sensitivity import Slopes
    from dqforge.reports.plain_data import PlainData

_NO_NAME = {NOBODY: None, UNREACHED: "unreached"}


def plain_comparison(found: EstimatorComparison) -> PlainData:
    """By the keys of docs/reference/json.md.

    Args:
        found: The comparison.
    """
    asked = found.asked
    names = [row.candidate.name for row in found.estimators]
    return {
        "omega_rad_per_s": asked.omega,
        "torque_shares": asked.shares,
        "reached": asked.reached.tolist(),
        "disturbances": asdict(asked.disturbances),
        "candidates": [_estimator(row) for row in found.estimators],
        "starts": [_start(row) for row in found.starts],
        "winner": [
            [names[index] if index >= 0 else _NO_NAME[index] for index in line]
            for line in found.winner.tolist()
        ],
        "pair": _pair(found),
        "uncounted": found.uncounted,
    }


def _estimator(row: ComparedEstimator) -> PlainData:
    named: PlainData = {
        "name": row.candidate.name,
        "title": row.candidate.title,
        "from_standstill": row.candidate.from_standstill,
        "refusal": row.refusal,
    }
    figures = row.figures
    if figures is None or row.holds is None:
        return named
    return named | {
        "angle_rad": figures.angle,
        "speed_rad_per_s": figures.speed,
        "noise_rad": figures.noise,
        "holds": row.holds.tolist(),
        "omega_low_rad_per_s": figures.omega_low,
        "omega_high_rad_per_s": figures.omega_high,
        "left_rad_per_s": figures.left,
        "slopes": None if figures.slopes is None else _slopes(figures.slopes),
        "capture": None if figures.capture is None else plain_capture(figures.capture),
        "cycles": None if row.cycles is None else list(row.cycles),
        "instructions": row.instructions,
        "flash_B": row.flash,
    }


def _slopes(slopes: Slopes) -> PlainData:
    return {
        "omega_rad_per_s": slopes.omega,
        "angle_rad": slopes.angle,
        "speed_rad_per_s": slopes.speed,
    }


def _start(row: ComparedStart) -> PlainData:
    named: PlainData = {
        "name": row.candidate.name,
        "title": row.candidate.title,
        "refusal": row.refusal,
    }
    figures = row.figures
    if figures is None:
        return named
    return named | {
        "largest_load_Nm": figures.largest_load,
        "hand_over_rad_per_s": figures.hand_over,
        "duration_s": figures.duration,
        "success": figures.success,
        "tried": [
            {
                "load": part.load,
                "count": part.count,
                "succeeded": part.succeeded,
                "interval": list(part.interval),
                "failures": dict(part.failures),
            }
            for part in figures.tried
        ],
        "untried": figures.untried,
    }


def _pair(found: EstimatorComparison) -> PlainData:
    pair = found.pair
    return {
        "at_speed": pair.at_speed,
        "from_standstill": pair.from_standstill,
        "start": pair.start,
        "up_rad_per_s": pair.up,
        "down_rad_per_s": pair.down,
        "held": pair.held,
        "held_at_speed": pair.held_at_speed,
        "loop": None
        if pair.loop is None
        else {
            "phase_margin_rad": pair.loop.margin,
            "crossover_rad_per_s": pair.loop.crossover,
            "holds": pair.loop.holds,
            "low_rad_per_s": pair.loop.low,
        },
        "passed_over": list(pair.passed),
        "gap_rad_per_s": None if pair.gap is None else list(pair.gap),
        "words": list(pair_lines(found.asked, pair)),
    }
