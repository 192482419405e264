"""Takagi-Sugeno rules: four speeds by four currents, each with a linear answer.

The memberships are hats over the knots of two inputs, of which two overlap and sum to one. The
answer is the mean of four neighbouring rules with weights that are not negative and sum to one:

    y = sum_kl h_k(u) h_l(i_q) (c_kl0 + c_kl1 r_d + c_kl2 v + c_kl3 i_d + c_kl4 i_q)

It is linear in the 80 numbers c: one least-squares solve trains it. And it lies between the least
and the largest of its rules, each of which is largest in a corner of its box: that bounds it.

References:
    T. Takagi, M. Sugeno, "Fuzzy identification of systems and its applications to modeling and
    control", IEEE Trans. Systems, Man and Cybernetics 15, 1985; paper 001, 7.2.8.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.learned_correction.correction_frame import (
    CorrectionFrame,
    Inputs,
)
from dqforge.optimizer.learned_correction.least_squares import least_squares
from dqforge.optimizer.observers.parts import Arithmetic

KNOTS = 4
TERMS = 5

# Of i_q over its range: two close to nought, where the voltage of a dead time turns over.
CURRENT_KNOTS = (-1.0, -0.125, 0.125, 1.0)

# Of u over its range, nearly even in the logarithm of the speed.
SPEED_KNOTS = (-1.0, -0.3125, 0.3125, 1.0)
_SPEED, _CURRENT = 4, 3  # which inputs the memberships are of


@dataclass(frozen=True, slots=True)
class FuzzyRules:
    """Knots and the inverse of their distances for speed and current, and the answers of the rules:
    speed by speed, current by current, five numbers each in rad.
    """

    speed_knots: tuple[float, ...]
    speed_slopes: tuple[float, ...]
    current_knots: tuple[float, ...]
    current_slopes: tuple[float, ...]
    answers: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse another number of rules."""
        sizes = [len(self.speed_knots), len(self.current_knots)]
        slopes = [len(self.speed_slopes), len(self.current_slopes)]
        if sizes != [KNOTS] * 2 or slopes != [KNOTS - 1] * 2:
            raise ValueError("rules have four speeds and four currents")
        if len(self.answers) != KNOTS * KNOTS * TERMS:
            raise ValueError("rules have sixteen answers of five numbers")


def _slopes(knots: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(np.float32(1.0 / (after - before))) for before, after in pairwise(knots))


def _rules(answers: FloatArray) -> FuzzyRules:
    return FuzzyRules(
        SPEED_KNOTS,
        _slopes(SPEED_KNOTS),
        CURRENT_KNOTS,
        _slopes(CURRENT_KNOTS),
        tuple(float(np.float32(value)) for value in answers),
    )


NO_RULES = _rules(np.zeros(KNOTS * KNOTS * TERMS))  # Rules that answer nought.


def _cell(knots: Any, slopes: Any, x: Reals) -> tuple[Any, Reals]:
    """Number of the knot below and share of the way to the next one."""
    low = (x >= knots[1]).astype(np.intp) + (x >= knots[2]).astype(np.intp)
    return low, (x - np.array(knots)[low]) * np.array(slopes)[low]


def answered(rules: Any, x: Inputs, _: Arithmetic) -> Reals:
    """The mean of the four rules around the inputs (-1 to 1), in rad.

    Args:
        rules: `FuzzyRules` in the numbers of an arithmetic.
        x: The six inputs, shape (N,) each.
    """
    k, f = _cell(rules.speed_knots, rules.speed_slopes, x[_SPEED])
    n, g = _cell(rules.current_knots, rules.current_slopes, x[_CURRENT])
    answers = np.array(rules.answers)

    def rule(number: Any) -> Reals:
        at = number * TERMS
        total = answers[at]
        for term in range(TERMS - 1):
            total = total + answers[at + (term + 1)] * x[term]
        return np.asarray(total)

    def along(number: Any) -> Reals:
        first, second = rule(number), rule(number + 1)
        return np.asarray(first + g * (second - first))

    low, high = along(k * KNOTS + n), along((k + 1) * KNOTS + n)
    return np.asarray(low + f * (high - low))


def _hats(knots: tuple[float, ...], x: FloatArray) -> FloatArray:
    return np.stack([np.interp(x, knots, row) for row in np.eye(KNOTS)])


def trained_rules(x: FloatArray, wanted: FloatArray) -> FuzzyRules:
    """The rules with the least sum of squares.

    Args:
        x: Inputs of -1 to 1, shape (6, M).
        wanted: Corrections in rad, shape (M,).
    """
    speed, current = _hats(SPEED_KNOTS, x[_SPEED]), _hats(CURRENT_KNOTS, x[_CURRENT])
    terms = np.concatenate([np.ones((1, x.shape[1])), x[: TERMS - 1]])
    columns = speed[:, None, None] * current[None, :, None] * terms[None, None]
    return _rules(least_squares(columns.reshape(-1, x.shape[1]), wanted))


def largest_rule(rules: FuzzyRules, frame: CorrectionFrame) -> float:
    """Bound in rad of what the rules answer within the trained ranges.

    Each rule is linear: it is largest where every input is at that end of its range which its
    factor asks for. Speed and current lie where the rule has a weight, between its neighbouring
    knots.

    Args:
        frame: Of the inputs.
    """
    answers = np.array(rules.answers).reshape(KNOTS, KNOTS, TERMS)
    current, speed = np.array(rules.current_knots), np.array(rules.speed_knots)
    u = speed / frame.scale[_SPEED] + frame.centre[_SPEED]
    inverse = np.minimum(frame.low * (1.0 - u) / (frame.middle * (1.0 + u)), 1.0)
    v = (inverse - frame.centre[1]) * frame.scale[1]
    low, high = [0, 0, 1, 2], [1, 2, 3, 3]
    sums = [
        answers[..., 0]
        + answers[..., 2] * v[slow][:, None]
        + answers[..., 4] * current[near][None, :]
        for slow in (low, high)
        for near in (low, high)
    ]
    rest = np.abs(answers[..., 1]) + np.abs(answers[..., 3])
    return float(np.max(rest + np.max(np.abs(sums), axis=0)))
