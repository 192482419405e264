"""From a map of best choices to a rule that firmware can hold: a few thresholds,
with what the simplification costs.

At every operating point some alternative (modulator and switching frequency) loses least. A rule
asks one or two questions, "is this quantity at least that threshold?", and takes one alternative
for each answer. Among all such trees the one with the least mean loss is found by exhaustion: for
every first question the best second ones on both sides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import DriveBudget
from dqforge.optimizer.steps.step_arithmetic import Arithmetic

# What an alternative that is not permitted counts, in units of the largest permitted loss.
_FORBIDDEN = 1e6
_THRESHOLDS = 48  # Thresholds per quantity that are tried: quantiles of its values at the points.
_WORTH = 1e-9  # Share of the mean loss that a further question must save.


@dataclass(frozen=True, slots=True)
class Leaf:
    """Take this alternative, an index into those compared."""

    choice: int


@dataclass(frozen=True, slots=True)
class Question:
    """Is ``quantity`` at least ``threshold`` (in its unit)? Then ``above``, else ``below``."""

    quantity: str
    threshold: float
    below: Leaf | Question
    above: Leaf | Question


Rule = Leaf | Question


@dataclass(frozen=True, slots=True)
class SimplifiedChoice:
    """A rule with its price.

    ``mean_loss`` and ``best_loss`` in W are the weighted means over the points of what the rule
    takes and of what the best alternative at every point would; ``permitted`` is false where no
    rule keeps all limits at every point.
    """

    rule: Rule
    mean_loss: float
    best_loss: float
    permitted: bool

    @property
    def price(self) -> float:
        """What the simplification costs, relative to the mean loss of the best alternatives."""
        return self.mean_loss / self.best_loss - 1.0 if self.best_loss > 0.0 else 0.0


@dataclass(frozen=True, slots=True)
class _Split:
    """Best single question about some points: its quantity and threshold, or None,
    and the loss that is left.
    """

    quantity: str | None
    threshold: float
    loss: float


def decide(rule: Rule, quantities: Mapping[str, FloatArray]) -> NDArray[np.intp]:
    """Alternatives that a rule takes at points, shape (N,), for quantities of that shape by
    name.
    """
    if isinstance(rule, Leaf):
        shape = np.shape(next(iter(quantities.values())))
        return np.full(shape, rule.choice, dtype=np.intp)
    asked = quantities[rule.quantity] >= rule.threshold
    return np.where(asked, decide(rule.above, quantities), decide(rule.below, quantities))


def leaves(rule: Rule) -> int:
    """Number of alternatives that a rule distinguishes."""
    return 1 if isinstance(rule, Leaf) else leaves(rule.below) + leaves(rule.above)


class _Points:
    """Losses by point and alternative, and every quantity with its thresholds and the
    order of the points in it.
    """

    def __init__(self, loss: FloatArray, quantities: Mapping[str, FloatArray]) -> None:
        self.loss = loss
        self.quantities = {
            name: np.asarray(values, dtype=np.float64) for name, values in quantities.items()
        }
        self.thresholds = {name: _thresholds(values) for name, values in self.quantities.items()}

    def leaf(self, here: NDArray[np.bool_]) -> Leaf:
        """Alternative with the least loss over some points."""
        return Leaf(int(np.argmin(np.sum(self.loss[here], axis=0))))

    def split(self, here: NDArray[np.bool_]) -> _Split:
        """The best question about some points."""
        loss = self.loss[here]
        best = _Split(
            None, 0.0, float(np.min(np.sum(loss, axis=0), initial=np.inf)) if here.any() else 0.0
        )
        for name, values in self.quantities.items():
            inside = values[here]
            order = np.argsort(inside, kind="stable")
            sums = np.concatenate([np.zeros((1, loss.shape[1])), np.cumsum(loss[order], axis=0)])
            place = np.searchsorted(inside[order], self.thresholds[name], side="left")
            split = np.min(sums[place], axis=1) + np.min(sums[-1] - sums[place], axis=1)
            at = int(np.argmin(split)) if split.size else -1
            if at >= 0 and split[at] < best.loss * (1.0 - _WORTH):
                best = _Split(name, float(self.thresholds[name][at]), float(split[at]))
        return best

    def tree(self, here: NDArray[np.bool_], split: _Split) -> Rule:
        """The question of a split with the best alternatives behind it."""
        if split.quantity is None:
            return self.leaf(here)
        above = self.quantities[split.quantity] >= split.threshold
        return Question(
            split.quantity, split.threshold, self.leaf(here & ~above), self.leaf(here & above)
        )


def _thresholds(values: FloatArray) -> FloatArray:
    """Thresholds between neighbouring values, thinned to quantiles, rounded
    where that crosses no value.
    """
    steps = np.unique(values)
    between = 0.5 * (steps[1:] + steps[:-1])
    if between.size > _THRESHOLDS:
        between = between[
            np.unique(np.linspace(0, between.size - 1, _THRESHOLDS).round().astype(int))
        ]
    rounded = np.array([float(f"{value:.3g}") for value in between])
    same = np.searchsorted(steps, rounded, side="left") == np.searchsorted(
        steps, between, side="left"
    )
    return np.where(same, rounded, between)


def simplify(
    loss: FloatArray,
    permitted: NDArray[np.bool_],
    quantities: Mapping[str, FloatArray],
    weights: FloatArray | None = None,
    questions: int = 2,
) -> SimplifiedChoice:
    """Rule with the least mean loss.

    Args:
        loss: Total loss in W, shape (N, C) for N operating points and C alternatives.
        permitted: Where an alternative keeps all limits, shape (N, C).
        quantities: What the firmware knows at a point, each of shape (N,), by names that are C
            identifiers with units.
        weights: Share of time at each point, shape (N,); None for all alike.
        questions: Depth of the tree: 0 (one alternative everywhere), 1 or 2 (up to four
            alternatives).

    Raises:
        NoSolutionError: At some point no alternative keeps the limits.
    """
    if not bool(np.all(np.any(permitted, axis=1))):
        point = int(np.argmin(np.any(permitted, axis=1)))
        raise NoSolutionError(
            f"at operating point {point + 1} no alternative keeps all limits; permit more"
        )
    share = (
        np.full(loss.shape[0], 1.0 / loss.shape[0])
        if weights is None
        else weights / np.sum(weights)
    )
    largest = float(np.max(loss, where=permitted, initial=0.0))
    counted = np.where(permitted, loss, _FORBIDDEN * max(largest, 1.0))
    points = _Points(counted * np.maximum(share, 1e-12)[:, np.newaxis], quantities)
    everywhere = np.ones(loss.shape[0], dtype=np.bool_)
    rule: Rule = points.leaf(everywhere)
    if questions == 1:
        rule = points.tree(everywhere, points.split(everywhere))
    elif questions > 1:
        rule = _two_questions(points, everywhere)
    rows = np.arange(loss.shape[0])
    chosen = decide(rule, points.quantities)
    mean = float(share @ np.where(permitted[rows, chosen], loss[rows, chosen], np.inf))
    best = float(share @ np.min(np.where(permitted, loss, np.inf), axis=1))
    fallback = float(share @ loss[rows, chosen])
    kept = bool(np.all(permitted[rows, chosen]))
    return SimplifiedChoice(rule, mean if kept else fallback, best, kept)


def _two_questions(points: _Points, everywhere: NDArray[np.bool_]) -> Rule:
    """Best tree of depth two: every first question with the best second ones."""
    first = points.split(everywhere)
    best, least = points.tree(everywhere, first), first.loss
    for name, values in points.quantities.items():
        for threshold in points.thresholds[name].tolist():
            above = values >= threshold
            splits = points.split(~above), points.split(above)
            loss = splits[0].loss + splits[1].loss
            if loss < least * (1.0 - _WORTH):
                least = loss
                best = Question(
                    name, threshold, points.tree(~above, splits[0]), points.tree(above, splits[1])
                )
    return best


# Limits that a choice of modulator and switching frequency keeps, the points where it is made,
# and who keeps what.

# What may bind a choice; ``voltage`` is the linear range of a modulator that would lose less.
LIMITS = (
    "ripple",
    "junction",
    "carrier ratio",
    "avoided band",
    "voltage",
    "least frequency",
    "largest frequency",
)

ROUNDING = 1e-12  # Relative excess that is rounding.


@dataclass(frozen=True, slots=True)
class ChoiceLimits:
    """What a choice must keep.

    ``f_min`` and ``f_max`` in Hz bound the switching frequency: the least one keeps the noise out
    of hearing or the control fast enough; ``bands`` (low, high) in Hz are left out between them.
    ``ripple_max`` in A is the largest r.m.s. of the phase-current ripple, None for any.
    ``junction_max`` in degC, None for what the device permits. ``carrier_ratio`` is the least
    number of carrier periods in an electrical one.
    """

    f_min: float
    f_max: float
    ripple_max: float | None = None
    junction_max: float | None = None
    bands: tuple[tuple[float, float], ...] = ()
    carrier_ratio: float = 0.0

    def __post_init__(self) -> None:
        """Refuse an empty range."""
        if not 0.0 < self.f_min <= self.f_max < np.inf:
            raise InputError(
                f"switching frequencies from {self.f_min:g} to {self.f_max:g} Hz are no range"
            )

    def outside_bands(self, frequency: FloatArray) -> BoolArray:
        """Where frequencies in Hz lie in none of the bands; their ends are permitted."""
        inside = np.zeros(frequency.shape, dtype=np.bool_)
        for low, high in self.bands:
            inside |= (frequency > low) & (frequency < high)
        return ~inside

    def edges(self) -> FloatArray:
        """Ends of the bands within the range, in Hz."""
        ends = np.array([end for band in self.bands for end in band], dtype=np.float64)
        return ends[(ends > self.f_min) & (ends < self.f_max)]


@dataclass(frozen=True, slots=True)
class ChoicePoints:
    """Operating points, arrays of shape (P,): torque in N m, mechanical speed in rad/s,
    currents in A (peak).

    The currents may have the shape (M, P), one row for each modulator, with NaN where it cannot
    make the torque. ``weights`` are shares of time, None for all alike.
    """

    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    weights: FloatArray | None = None


def limit_marks(
    budget: DriveBudget, frequency: FloatArray, ratio: FloatArray, limits: ChoiceLimits
) -> dict[str, BoolArray]:
    """Which limits a budget keeps at frequencies (F,) in Hz.

    ``ratio`` are electrical frequencies in Hz, shape (P,).
    """
    ripple = np.inf if limits.ripple_max is None else limits.ripple_max
    hottest = np.inf if limits.junction_max is None else limits.junction_max
    warm = budget.steady & budget.cool_enough & (budget.junction_temperature <= hottest)
    return {
        "voltage": np.asarray(budget.linear & budget.known),
        "ripple": np.asarray(budget.ripple_current <= ripple * (1.0 + ROUNDING)),
        "junction": np.asarray(warm),
        **frequency_marks(frequency[:, np.newaxis], ratio, limits),
    }


def frequency_marks(
    frequency: FloatArray, ratio: FloatArray, limits: ChoiceLimits
) -> dict[str, BoolArray]:
    """Limits of the frequency alone, (M, F, P)."""
    return {
        "carrier ratio": np.asarray(frequency >= limits.carrier_ratio * ratio * (1.0 - ROUNDING)),
        "avoided band": limits.outside_bands(frequency),
    }


def all_kept(marks: dict[str, BoolArray], without: str = "") -> BoolArray:
    """Where all limits are kept, or all but one."""
    kept = np.ones((), dtype=np.bool_)
    for name, mark in marks.items():
        if name != without:
            kept = kept & mark
    return np.asarray(kept)


def electrical_frequency(machine: Machine, points: ChoicePoints) -> FloatArray:
    """Electrical frequency in Hz at the points, shape (P,)."""
    return np.asarray(machine.pole_pairs * np.abs(points.omega_m) / (2.0 * np.pi))


# The rule as the firmware asks it, over the magnitudes of torque and mechanical speed.


def modulation_choice(
    o: Arithmetic, rule: Rule, choices: Sequence[IntEnum], torque: Any, speed: Any
) -> Any:
    """Modulator and switching frequency for a torque and a mechanical speed; either sign,
    not-a-number as zero.

    Args:
        o: The arithmetic.
        rule: Over ``torque_Nm`` and ``speed_rad_per_s``.
        choices: What its alternatives are called.
        torque, speed: In N m and rad/s.
    """
    told = {"torque_Nm": torque, "speed_rad_per_s": speed}
    sizes = {
        name: o.let(name, o.magnitude(value))
        for name, value in told.items()
        if name in asked_thresholds(rule)
    }

    def taken(part: Rule, name: str) -> Any:
        if isinstance(part, Leaf):
            return _constant(o, choices[part.choice])
        below = "" if name == "choice" else f"{name}_"
        return o.cases(
            name,
            (
                sizes[part.quantity] >= part.threshold,
                lambda: taken(part.above, f"{below}above"),
            ),
            otherwise=lambda: taken(part.below, f"{below}below"),
        )

    return taken(rule, "choice")


def of_choice(
    o: Arithmetic, name: str, choices: Sequence[IntEnum], values: Sequence[Any], choice: Any
) -> Any:
    """What belongs to a choice: one of as many names or numbers.

    Args:
        o: The arithmetic.
        name: Of what is found.
        choices: What the alternatives are called.
        values: What belongs to each; the first one to what is none of them.
        choice: The choice.
    """
    found = [partial(_value, o, value) for value in values]
    if len(values) == 1:
        return found[0]()
    branches = {_constant(o, key): own for key, own in zip(choices[1:], found[1:], strict=True)}
    return o.switch(name, choice, branches, found[0])


def _value(o: Arithmetic, value: Any) -> Any:
    return _constant(o, value) if isinstance(value, IntEnum) else value


def _constant(o: Arithmetic, value: IntEnum) -> Any:
    return o.constant(value.name, value)


def asked_thresholds(rule: Rule) -> dict[str, set[float]]:
    """Thresholds by quantity."""
    if isinstance(rule, Leaf):
        return {}
    found = {rule.quantity: {rule.threshold}}
    for part in (asked_thresholds(rule.below), asked_thresholds(rule.above)):
        for name, thresholds in part.items():
            found[name] = found.get(name, set()) | thresholds
    return found
