"""Gains and margins of the current loops of many machines at once.

Gains come from the rules of single loops (`dqforge.optimizer.loops.pi_methods`), margins in closed
form. What a single loop would be refused for is only marked here: `tune_current_loop` of that row
says why.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedLoopSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.closed_margins import (
    CurrentMargins,
    current_loops,
    current_margins,
    has_closed_margins,
)
from dqforge.optimizer.loops.pi_methods import current_pi

Settings = TypeVar("Settings", CurrentLoopSettings, SpeedLoopSettings)
BY_SEARCH = "optimised"  # The method whose gains are searched for, loop by loop.


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLoopAxis:
    """Current loops of one axis of N machines, arrays of shape (N,).

    Args:
        r_s, inductance, t_s: Ohm, H and s.
        kp, ki: Gains in V/A and V/(A s), NaN where no rule gives any.
        margins: NaN and not stable there.
        holds: True where a single loop would be accepted; of others `tune_current_loop` says what
            is wrong or, by the method ``optimised``, finds the gains.
    """

    r_s: FloatArray
    inductance: FloatArray
    t_s: FloatArray
    kp: FloatArray
    ki: FloatArray
    margins: CurrentMargins
    holds: BoolArray


def each_of(settings: Settings | Sequence[Settings], count: int) -> Sequence[Settings]:
    """Settings of every row: the ones given, or the one ``count`` times.

    Args:
        settings: One, or one per row.
        count: Number of rows.
    """
    if isinstance(settings, Sequence):
        return settings
    return [settings] * count


def columns(*values: ArrayLike) -> tuple[FloatArray, ...]:
    """Numbers and columns as columns of one length.

    Args:
        values: Numbers, or arrays of shape (N,).
    """
    given = [np.asarray(value, dtype=np.float64) for value in values]
    return tuple(np.atleast_1d(value) for value in np.broadcast_arrays(*given))


def tuned_current_loops(
    r_s: ArrayLike,
    inductance: ArrayLike,
    t_s: ArrayLike,
    settings: CurrentLoopSettings | Sequence[CurrentLoopSettings],
    rule_inductance: ArrayLike | None = None,
) -> CurrentLoopAxis:
    """Gains of N machines by the methods of the settings, with their margins.

    Args:
        r_s, inductance, t_s: Ohm, H and s, numbers or shape (N,).
        settings: Method and its settings, of all rows or of each.
        rule_inductance: Inductance in H that the rule of a vendor takes for this axis
            (`dqforge.optimizer.loops.vendor_methods.vendor_inductance`); None for the axis' own.
    """
    taken = inductance if rule_inductance is None else rule_inductance
    count = len(settings) if isinstance(settings, Sequence) else 1
    r_s, inductance, t_s, taken, _ = columns(r_s, inductance, t_s, taken, np.ones(count))
    rules = each_of(settings, r_s.size)
    rows = zip(r_s.tolist(), taken.tolist(), t_s.tolist(), rules, strict=True)
    gains = np.array([_by_rule(*row) for row in rows]).reshape(-1, 2)
    least = np.array([rule.min_phase_margin for rule in rules])
    return given_current_loops(r_s, inductance, t_s, gains[:, 0], gains[:, 1], least=least)


def _by_rule(
    r_s: float, inductance: float, t_s: float, settings: CurrentLoopSettings
) -> tuple[float, float]:
    """Gains of one loop, NaN where its rule gives none."""
    if settings.method == BY_SEARCH:
        return np.nan, np.nan
    try:
        return current_pi(r_s, inductance, t_s, settings)
    except NoSolutionError:
        return np.nan, np.nan


def given_current_loops(
    r_s: ArrayLike,
    inductance: ArrayLike,
    t_s: ArrayLike,
    kp: ArrayLike,
    ki: ArrayLike,
    gain: ArrayLike = 1.0,
    *,
    least: ArrayLike = 0.0,
) -> CurrentLoopAxis:
    """Margins of N machines with given gains, such as those of one header on many machines.

    Args:
        r_s, inductance, t_s: Ohm, H and s, numbers or shape (N,).
        kp, ki: Gains in V/A and V/(A s), numbers or shape (N,).
        gain: Gain of the voltage, a number or shape (N,): link voltage that acts over the one that
            duty cycles are computed with.
        least: Least phase margin in rad that a loop must have to hold.
    """
    r_s, inductance, t_s, kp, ki, gain, least = columns(r_s, inductance, t_s, kp, ki, gain, least)
    proper = has_closed_margins(kp, ki)
    found = current_margins(
        current_loops(
            r_s, inductance, t_s, np.where(proper, kp, 1.0), np.where(proper, ki, 1.0), gain
        )
    )
    margins = _only(found, proper)
    holds = margins.stable & np.isfinite(margins.crossover)
    holds &= np.abs(margins.phase_margin) >= least
    return CurrentLoopAxis(
        r_s,
        inductance,
        t_s,
        np.where(proper, kp, np.nan),
        np.where(proper, ki, np.nan),
        margins,
        holds,
    )


def _only(margins: CurrentMargins, proper: BoolArray) -> CurrentMargins:
    """The same with NaN where there are no gains."""
    numbers = {
        part.name: np.where(proper, getattr(margins, part.name), np.nan)
        for part in fields(CurrentMargins)
        if part.name != "stable"
    }
    return replace(margins, stable=margins.stable & proper, **numbers)
