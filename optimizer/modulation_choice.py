"""Which modulator and which switching frequency lose least at every operating point, and the rule that comes close.

Loss over frequency is smooth: switching rises with it, ripple falls with its square, and temperatures tie both
together. It is computed on a few frequencies, splined over their logarithm, and its least value sought on a fine grid
within the limits, for all points and modulators at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dqforge.machines.bridge_tables import bridge_tables
from dqforge.machines.errors import InputError
from dqforge.machines.inverter import Inverter
from dqforge.machines.modulation import BoolArray
from dqforge.machines.settings import ModulationName
from dqforge.machines.synchronous import FloatArray, Machine
from dqforge.optimizer.choice_rule import SimplifiedChoice, simplify
from dqforge.optimizer.drive_budget import BudgetOptions, DriveBudget, drive_budget

_NODES = 13
_FINE = 193
_LISTED = 4
"""Frequencies per modulator that a rule may take, evenly in the logarithm, the ends of the range included."""


@dataclass(frozen=True, slots=True)
class ChoiceLimits:
    """What a choice must keep.

    ``f_min`` and ``f_max`` in Hz bound the switching frequency: the least one keeps the noise out of hearing or the
    control fast enough. ``ripple_max`` in A is the largest r.m.s. of the phase-current ripple, None for any.
    ``junction_max`` in degC, None for what the device permits.
    """

    f_min: float
    f_max: float
    ripple_max: float | None = None
    junction_max: float | None = None

    def __post_init__(self) -> None:
        """Refuse an empty range."""
        if not 0.0 < self.f_min <= self.f_max < np.inf:
            raise InputError(f"switching frequencies from {self.f_min:g} to {self.f_max:g} Hz are no range")


@dataclass(frozen=True, slots=True)
class ChoicePoints:
    """Operating points, arrays of shape (P,): torque in N m, mechanical speed in rad/s, currents in A (peak).

    ``weights`` are shares of time, None for all alike.
    """

    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    weights: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class BestChoice:
    """Best modulator and switching frequency per point, arrays of shape (P,) unless said otherwise.

    ``modulation`` is an index into ``modulations``, -1 where nothing keeps the limits; ``f_sw`` in Hz, ``loss`` in W,
    ``ripple_current`` in A (r.m.s.) and ``junction_temperature`` in degC belong to it, NaN where there is none.
    ``least`` holds the least loss of each modulator within the limits, shape (M, P), inf where it has none.
    """

    modulations: tuple[ModulationName, ...]
    modulation: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    f_sw: FloatArray
    loss: FloatArray
    ripple_current: FloatArray
    junction_temperature: FloatArray
    least: FloatArray

    @property
    def found(self) -> BoolArray:
        """Where something keeps the limits."""
        return np.asarray(self.modulation >= 0)


@dataclass(frozen=True, slots=True)
class ListedChoice:
    """A rule over a short list of alternatives (modulator, switching frequency in Hz), and what it costs."""

    alternatives: tuple[tuple[ModulationName, float], ...]
    simplified: SimplifiedChoice


def _permitted(budget: DriveBudget, limits: ChoiceLimits) -> BoolArray:
    kept = budget.feasible
    if limits.ripple_max is not None:
        kept = kept & (budget.ripple_current <= limits.ripple_max * (1.0 + 1e-12))
    if limits.junction_max is not None:
        kept = kept & (budget.junction_temperature <= limits.junction_max)
    return np.asarray(kept)


def _splined(values: FloatArray, nodes: FloatArray, fine: FloatArray) -> FloatArray:
    """Values over frequency, (M, F, P), on finer frequencies, in the logarithm of both; NaN stays with its point."""
    from scipy.interpolate import CubicSpline

    usable = np.all(np.isfinite(values) & (values > 0.0), axis=1)
    safe = np.where(usable[:, np.newaxis], values, 1.0)
    found = np.exp(CubicSpline(np.log(nodes), np.log(safe), axis=1)(np.log(fine)))
    return np.where(usable[:, np.newaxis], found, np.nan)


def _budget(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    names: tuple[ModulationName, ...],
    frequencies: FloatArray,
    options: BudgetOptions | None,
) -> DriveBudget:
    return drive_budget(machine, inverter, points.i_d, points.i_q, points.omega_m, names, frequencies, options=options)


@dataclass(frozen=True, slots=True)
class _Curves:
    """Loss in W, junction in degC and ripple in A over frequency, and what is permitted, all of shape (M, F, P)."""

    frequency: FloatArray
    loss: FloatArray
    hot: FloatArray
    ripple: FloatArray
    kept: BoolArray


def _curves(budget: DriveBudget, nodes: FloatArray, limits: ChoiceLimits, hottest: float) -> _Curves:
    """The budget on its nodes, carried over to a fine grid."""
    if nodes.size == 1:
        loss, hot, ripple = budget.total, budget.junction_temperature, budget.ripple_current
        return _Curves(nodes, loss, hot, ripple, _permitted(budget, limits))
    fine = np.geomspace(nodes[0], nodes[-1], _FINE)
    loss, hot = (_splined(values, nodes, fine) for values in (budget.total, budget.junction_temperature))
    ripple = budget.ripple_current[:, :1] * (nodes[0] / fine)[np.newaxis, :, np.newaxis]  # exactly as 1/f
    # Between two nodes heat is steady where it is at the higher one.
    node = np.minimum(np.searchsorted(nodes, fine * (1.0 - 1e-12)), nodes.size - 1)
    kept = (budget.linear & budget.known)[:, :1] & budget.steady[:, node] & (hot <= hottest)
    if limits.ripple_max is not None:
        kept = kept & (ripple <= limits.ripple_max * (1.0 + 1e-12))
    return _Curves(fine, loss, hot, ripple, np.asarray(kept))


def best_choice(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    modulations: Sequence[ModulationName],
    limits: ChoiceLimits,
    *,
    options: BudgetOptions | None = None,
) -> BestChoice:
    """Modulator and switching frequency with the least total loss at P points.

    Parameters
    ----------
    machine, inverter, modulations, options:
        As in `drive_budget`.
    points:
        Where.
    limits:
        What is permitted.
    """
    names = tuple(modulations)
    nodes = np.geomspace(limits.f_min, limits.f_max, _NODES if limits.f_max > limits.f_min else 1)
    hottest = bridge_tables(inverter).max_junction_temperature
    hottest = hottest if limits.junction_max is None else min(hottest, limits.junction_max)
    curves = _curves(_budget(machine, inverter, points, names, nodes, options), nodes, limits, hottest)
    counted = np.where(curves.kept & np.isfinite(curves.loss), curves.loss, np.inf)
    least = np.min(counted, axis=1)
    which = np.argmin(least, axis=0)
    column = np.arange(which.size)
    place = np.argmin(counted, axis=1)[which, column]
    found = np.isfinite(least[which, column])

    def taken(values: FloatArray) -> FloatArray:
        return np.where(found, values[which, place, column], np.nan)

    return BestChoice(
        modulations=names,
        modulation=np.where(found, which, -1),
        f_sw=np.where(found, curves.frequency[place], np.nan),
        loss=taken(curves.loss),
        ripple_current=taken(curves.ripple),
        junction_temperature=taken(curves.hot),
        least=least,
    )


def listed_choice(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    modulations: Sequence[ModulationName],
    limits: ChoiceLimits,
    *,
    options: BudgetOptions | None = None,
) -> ListedChoice:
    """Rule over torque and speed that takes one of a short list of alternatives; parameters as in `best_choice`.

    Raises
    ------
    NoSolutionError
        At some point nothing on the list keeps the limits.
    """
    listed = np.round(np.geomspace(limits.f_min, limits.f_max, _LISTED), -2)
    frequencies = np.unique(np.clip(listed, limits.f_min, limits.f_max))
    names = tuple(modulations)
    budget = _budget(machine, inverter, points, names, frequencies, options)
    alternatives = tuple((name, float(frequency)) for name in names for frequency in frequencies)
    loss = budget.total.reshape(len(alternatives), -1).T
    kept = _permitted(budget, limits).reshape(len(alternatives), -1).T
    quantities = {"torque_Nm": np.abs(points.torque), "speed_rad_per_s": np.abs(points.omega_m)}
    return ListedChoice(alternatives, simplify(np.where(kept, loss, 0.0), kept, quantities, points.weights))
