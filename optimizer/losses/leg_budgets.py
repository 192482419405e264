"""Budgets of phase machines with the legs behind them, and how several become one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import DriveBudget


@dataclass(frozen=True, slots=True)
class PhaseBudget:
    """Budgets of a phase machine, arrays of the shape (..., F, P): carrier frequencies, points.

    Args:
        budget: As of any drive; ``copper`` counts the neutral's conductor, ``ripple_copper`` what
            the switching makes in phases and neutral, zero sequence included.
        legs: Names of the half bridges, the axis L of the next two.
        leg_loss, leg_temperature: Conduction, dead time and switching of each leg in W, and its
            hotter junction in degC, shape (..., F, P, L).
        neutral_current, neutral_ripple: R.m.s. in A of the sum of the phase currents without
            ripple, and of its ripple alone.
        link_demand: Least voltage of the link in V, without what dead time takes.
    """

    budget: DriveBudget
    legs: tuple[str, ...]
    leg_loss: FloatArray
    leg_temperature: FloatArray
    neutral_current: FloatArray
    neutral_ripple: FloatArray
    link_demand: FloatArray


def stacked_phase_budgets(found: Sequence[PhaseBudget], axis: int = 0) -> PhaseBudget:
    """Budgets of one shape along a new axis.

    Args:
        found: Budgets of the same legs.
        axis: Place of the new axis.
    """
    return _combined(found, lambda rows: np.stack(rows, axis=axis))


def joined_phase_budgets(found: Sequence[PhaseBudget], axis: int = 0) -> PhaseBudget:
    """Budgets one behind the other along an axis that they have.

    Args:
        found: Budgets of the same legs.
        axis: The axis.
    """
    return _combined(found, lambda rows: np.concatenate(rows, axis=axis))


def _combined(found: Sequence[PhaseBudget], join: Callable[[list[Any]], Any]) -> PhaseBudget:
    budget = DriveBudget(
        **{
            part.name: join([getattr(one.budget, part.name) for one in found])
            for part in fields(DriveBudget)
        }
    )
    names = ("leg_loss", "leg_temperature", "neutral_current", "neutral_ripple", "link_demand")
    rest = {name: join([getattr(one, name) for one in found]) for name in names}
    return PhaseBudget(budget=budget, legs=found[0].legs, **rest)
