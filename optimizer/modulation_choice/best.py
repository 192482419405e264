"""Which modulator and which switching frequency lose least at every operating point,
and the rule that comes close.

Loss over frequency is smooth: switching rises with it, ripple falls with its square, and
temperatures tie both together. It is computed on a few frequencies, splined over their logarithm,
and its least value sought on a fine grid within the limits, for all points and modulators at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.losses.bridge_tables import bridge_tables
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, drive_budget
from dqforge.optimizer.modulation_choice.limits import (
    LIMITS,
    ROUNDING,
    ChoiceLimits,
    ChoicePoints,
    all_kept,
    electrical_frequency,
    frequency_marks,
    limit_marks,
)

_NODES = 13
_FINE = 193

# Frequencies per modulator that a rule may take, evenly in the logarithm, the ends of the range
# included.
_LISTED = 4

# Relative difference from which the losses of two modulators differ: less is rounding of the
# splines.
_EQUAL = 1e-6
_BINDS = 1e-4  # Relative saving from which a limit binds: less is the step of the frequency grid.
_AT_ONCE = 512  # Points whose curves are held in memory at once.


@dataclass(frozen=True, slots=True)
class BestChoice:
    """Best modulator and switching frequency per point, arrays of shape (P,) unless said otherwise.

    ``modulation`` is an index into ``modulations``, -1 where nothing keeps the limits; ``f_sw`` in
    Hz, ``loss`` in W, ``ripple_current`` in A (r.m.s.) and ``junction_temperature`` in degC belong
    to it, NaN where there is none. ``least`` holds the least loss of each modulator within the
    limits, shape (M, P), inf where it has none; of modulators that lose the same the first is
    taken. ``binding`` says for each of `LIMITS` where it costs: without it less could be lost, or
    something could be had at all.
    """

    modulations: tuple[ModulationName, ...]
    modulation: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    f_sw: FloatArray
    loss: FloatArray
    ripple_current: FloatArray
    junction_temperature: FloatArray
    least: FloatArray
    binding: dict[str, BoolArray]

    @property
    def found(self) -> BoolArray:
        """Where something keeps the limits."""
        return np.asarray(self.modulation >= 0)


def _splined(values: FloatArray, nodes: FloatArray, fine: FloatArray) -> FloatArray:
    """Values over frequency, (M, F, P), on finer frequencies, in the logarithm of both;
    NaN stays with its point.
    """
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
    return drive_budget(
        machine,
        inverter,
        points.i_d,
        points.i_q,
        points.omega_m,
        names,
        frequencies,
        options=options,
    )


@dataclass(frozen=True, slots=True)
class _Curves:
    """Loss in W, junction in degC and ripple in A at frequencies in Hz, all (M, F, P),
    and which limits are kept.
    """

    frequency: FloatArray
    loss: FloatArray
    hot: FloatArray
    ripple: FloatArray
    marks: dict[str, BoolArray]


def _curves(
    budget: DriveBudget,
    nodes: FloatArray,
    limits: ChoiceLimits,
    hottest: float,
    electrical: FloatArray,
) -> _Curves:
    """The budget on its nodes, carried over to a fine grid."""
    if nodes.size == 1:
        marks = limit_marks(budget, nodes, electrical, limits)
        frequency = np.broadcast_to(nodes[:, np.newaxis], budget.total.shape)
        return _Curves(
            frequency, budget.total, budget.junction_temperature, budget.ripple_current, marks
        )
    fine = np.union1d(np.geomspace(nodes[0], nodes[-1], _FINE), limits.edges())
    loss, hot = (
        _splined(values, nodes, fine) for values in (budget.total, budget.junction_temperature)
    )
    first = budget.ripple_current[:, 0] * nodes[0]  # ripple goes exactly as 1/f
    most = np.inf if limits.ripple_max is None else limits.ripple_max
    # The grid would round the least frequency that ripple and carrier ratio permit;
    # it stands behind it as it is.
    least = np.clip(np.fmax(first / most, limits.carrier_ratio * electrical), nodes[0], nodes[-1])
    shape = (loss.shape[0], fine.size, loss.shape[2])
    frequency = np.concatenate(
        [np.broadcast_to(fine[:, np.newaxis], shape), least[:, np.newaxis]], axis=1
    )
    loss, hot = (
        np.concatenate([values, _between(values, fine, least)], axis=1) for values in (loss, hot)
    )
    ripple = first[:, np.newaxis] / frequency
    # Between two nodes heat is steady where it is at the higher one.
    node = np.minimum(np.searchsorted(nodes, frequency * (1.0 - ROUNDING)), nodes.size - 1)
    marks = {
        "voltage": np.asarray((budget.linear & budget.known)[:, :1]),
        "ripple": np.asarray(ripple <= most * (1.0 + ROUNDING)),
        "junction": np.asarray(np.take_along_axis(budget.steady, node, axis=1) & (hot <= hottest)),
        **frequency_marks(frequency, electrical, limits),
    }
    return _Curves(frequency, loss, hot, ripple, marks)


def _between(values: FloatArray, fine: FloatArray, wanted: FloatArray) -> FloatArray:
    """Values (M, F, P) over fine frequencies at one of its own for each (M, P),
    straight in the logarithms.
    """
    after = np.clip(np.searchsorted(fine, wanted), 1, fine.size - 1)
    weight = np.log(wanted / fine[after - 1]) / np.log(fine[after] / fine[after - 1])
    low, high = (
        np.take_along_axis(values, place[:, np.newaxis], axis=1) for place in (after - 1, after)
    )
    return np.asarray(low * (high / low) ** weight[:, np.newaxis])


def _columns(points: ChoicePoints, here: slice) -> ChoicePoints:
    """Some of the points."""
    currents = (np.atleast_2d(values)[:, here] for values in (points.i_d, points.i_q))
    return ChoicePoints(points.torque[here], points.omega_m[here], *currents)


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

    Args:
        machine, inverter, modulations, options: As in `drive_budget`.
        points: Where.
        limits: What is permitted.
    """
    names = tuple(modulations)
    nodes = np.geomspace(limits.f_min, limits.f_max, _NODES if limits.f_max > limits.f_min else 1)
    hottest = bridge_tables(inverter).max_junction_temperature
    hottest = hottest if limits.junction_max is None else min(hottest, limits.junction_max)
    parts = []
    for start in range(0, points.torque.size, _AT_ONCE):
        some = _columns(points, slice(start, start + _AT_ONCE))
        budget = _budget(machine, inverter, some, names, nodes, options)
        parts.append(
            _best(
                names, _curves(budget, nodes, limits, hottest, electrical_frequency(machine, some))
            )
        )
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts], axis=-1)
        for name in (
            "modulation",
            "f_sw",
            "loss",
            "ripple_current",
            "junction_temperature",
            "least",
        )
    }
    binding = {name: np.concatenate([part.binding[name] for part in parts]) for name in LIMITS}
    return BestChoice(modulations=names, binding=binding, **whole)


def _best(names: tuple[ModulationName, ...], curves: _Curves) -> BestChoice:
    finite = np.isfinite(curves.loss)
    counted = np.where(all_kept(curves.marks) & finite, curves.loss, np.inf)
    least = np.min(counted, axis=1)
    smallest = np.min(least, axis=0)
    which = np.argmax(least <= smallest * (1.0 + _EQUAL), axis=0)
    column = np.arange(which.size)
    place = np.argmin(counted, axis=1)[which, column]
    found = np.isfinite(smallest)

    def taken(values: FloatArray) -> FloatArray:
        return np.where(found, values[which, place, column], np.nan)

    f_sw, ends = taken(curves.frequency), (np.min(curves.frequency), np.max(curves.frequency))
    ranged = bool(ends[0] < ends[1])
    binding = {
        "least frequency": found & (f_sw == ends[0]) & ranged,
        "largest frequency": found & (f_sw == ends[1]) & ranged,
    }
    for name in ("voltage", "ripple", "junction", "carrier ratio", "avoided band"):
        without = np.min(
            np.where(all_kept(curves.marks, name) & finite, curves.loss, np.inf), axis=(0, 1)
        )
        binding[name] = np.asarray(without < smallest * (1.0 - _BINDS))
    return BestChoice(
        modulations=names,
        modulation=np.where(found, which, -1),
        f_sw=f_sw,
        loss=taken(curves.loss),
        ripple_current=taken(curves.ripple),
        junction_temperature=taken(curves.hot),
        least=least,
        binding=binding,
    )


def permitted_losses(
    machine: Machine,
    inverter: Inverter,
    points: ChoicePoints,
    modulations: Sequence[ModulationName],
    frequencies: FloatArray,
    limits: ChoiceLimits,
    *,
    options: BudgetOptions | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Total losses in W of every modulator at every frequency in Hz, and where all limits are kept,
    (M, F, P) each.

    The loss is 0 where it is not known. Parameters as in `best_choice`;
    ``frequencies`` has the shape (F,).
    """
    budget = _budget(machine, inverter, points, tuple(modulations), frequencies, options)
    kept = all_kept(limit_marks(budget, frequencies, electrical_frequency(machine, points), limits))
    return np.where(np.isfinite(budget.total), budget.total, 0.0), kept


def listed_frequencies(limits: ChoiceLimits, count: int = _LISTED) -> FloatArray:
    """Frequencies in Hz that a rule may take: even in the logarithm, to 100 Hz,
    with the ends of range and bands.
    """
    listed = np.round(np.geomspace(limits.f_min, limits.f_max, count), -2)
    found = np.unique(np.concatenate([np.clip(listed, limits.f_min, limits.f_max), limits.edges()]))
    return found[limits.outside_bands(found)]


def rule_quantities(points: ChoicePoints) -> dict[str, FloatArray]:
    """What a rule may ask about at the points, shape (P,) each."""
    return {"torque_Nm": np.abs(points.torque), "speed_rad_per_s": np.abs(points.omega_m)}
