"""Rules that name the next switching state at each sample, as the firmware runs them: predictive,
circle, look-up table.

A rule is asked at the start of a sampling period, knows the state that is on until its end,
predicts the currents there, and names the state that is on from there: the computing time of one
sample is part of it.

Sources: paper 001 (Bezerra, COPPE/UFRJ 2004), sections 6.2.4.3 and 6.2.4.4; J. Holtz, S.
Stadtfeld, "A predictive controller for the stator current vector of AC machines fed from a
switched voltage source", IPEC Tokyo 1983, pp. 1665-1675 (circle, straight trajectories, time over
commutations); the table: `dqforge.machines.plants.regulator_rules`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Annotated, Any, NamedTuple

import numpy as np

from dqforge.machines.plants.regulator_rules import (
    ACTIVE,
    COMMUTATIONS,
    Codes,
    RuleConstants,
    switching_table,
    unit_vectors,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member, where

_FAR = float(np.finfo(np.float32).max)
_ROOT = 0.5 * math.sqrt(3.0)
_PER_COMMUTATION = (1.0, 1.0, 0.5, 1.0 / 3.0)

# Arrays of the firmware: legs that commutate between two states, by the bits in which they differ;
# states along an error, by its region; and those by sector of the voltage and region of the error.
MOVES = tuple(int(count) for count in COMMUTATIONS[0])
TABLE = switching_table()
_UNIT_ALPHA, _UNIT_BETA = unit_vectors().T.tolist()


class FeedbackPair(NamedTuple):
    """Currents on the d and q axes, or cosine and sine of an angle."""

    x: Reals
    y: Reals


@dataclass(frozen=True, slots=True)
class FeedbackInputs:
    """What is measured at a sample, and the references."""

    i_d_ref: Annotated[Reals, Member("reference on the d axis", "A", suffix="A")]
    i_q_ref: Annotated[Reals, Member("reference on the q axis", "A", suffix="A")]
    i_d: Annotated[Reals, Member("current on the d axis", "A", suffix="A")]
    i_q: Annotated[Reals, Member("current on the q axis", "A", suffix="A")]
    cos_theta: Annotated[Reals, Member("of the electrical angle at the sample")]
    sin_theta: Annotated[Reals, Member("of the same angle")]
    omega_e: Annotated[Reals, Member("electrical speed", "rad/s")]
    v_dc: Annotated[Reals, Member("of the DC link", "V", suffix="V")]


@dataclass(slots=True)
class FeedbackEnds:
    """Where the currents are at the end of the next sampling period."""

    under: Annotated[tuple[FeedbackPair, ...], Member("with each of the states", "A")]


@dataclass(slots=True)
class _Least:
    best: Reals
    fewest: Annotated[Any, Member("", whole=True)]
    chosen: Annotated[Any, Member("", whole=True)]


@dataclass(slots=True)
class _Longest:
    best: Reals
    chosen: Annotated[Any, Member("", whole=True)]
    stays: Annotated[Any, Member("", whole=True)]


def feedback_turned(
    o: Arithmetic,  # noqa: ARG001
    pair: FeedbackPair,
    slow: Reals,
    fast: Reals,
) -> FeedbackPair:
    """A pair turned by half of what the rotor turns in a sampling period."""
    return FeedbackPair(pair.x * slow - pair.y * fast, pair.y * slow + pair.x * fast)


def _moves(o: Arithmetic, bits: Any) -> Any:
    """Legs that commutate between states that differ in bits."""
    return o.at(o.constant("FEEDBACK_MOVES", MOVES), bits)


@dataclass(frozen=True, slots=True)
class SampledRule:
    """A rule with its numbers.

    Args:
        constants: What it knows of its drive.
    """

    constants: RuleConstants

    def square(self, o: Arithmetic) -> float:
        """Of the radius of the circle in A^2."""
        band = o.number(self.constants.band)
        return float(band * band)

    def feedback_ahead(
        self,
        o: Arithmetic,
        inputs: FeedbackInputs,
        i: FeedbackPair,
        state: Any,
        angle: FeedbackPair,
    ) -> FeedbackPair:
        """Currents a sampling period later, with a state that is on throughout; angle: in the
        middle of the period. The tables are the vectors of the states over v_dc.
        """
        k = self.constants
        alpha = o.let("alpha", o.at(o.table("unit_alpha", _UNIT_ALPHA), state) * inputs.v_dc)
        beta = o.let("beta", o.at(o.table("unit_beta", _UNIT_BETA), state) * inputs.v_dc)
        v_d = o.let("v_d", angle.x * alpha + angle.y * beta)
        v_q = o.let("v_q", angle.x * beta - angle.y * alpha)
        slope_d = (v_d - k.r_s * i.x) + inputs.omega_e * (k.l_q * i.y)
        slope_q = (v_q - k.r_s * i.y) - inputs.omega_e * (k.l_d * i.x + k.psi_pm)
        gain_d, gain_q = k.t_s / k.l_d, k.t_s / k.l_q
        return FeedbackPair(i.x + gain_d * slope_d, i.y + gain_q * slope_q)

    def feedback_least(
        self, o: Arithmetic, inputs: FeedbackInputs, now: Any, ends: FeedbackEnds
    ) -> Any:
        """The state with the least error: of equal ones that with the fewest commutations;
        not-a-number keeps the present one.
        """
        found = _Least(o.full(_FAR, inputs.omega_e), 4, now)

        def compared(state: Any) -> None:
            end: Any = o.at(ends.under, state)
            e_d = o.let("e_d", inputs.i_d_ref - end.x)
            e_q = o.let("e_q", inputs.i_q_ref - end.y)
            error = o.let("error", e_d * e_d + e_q * e_q)
            moves = o.let("moves", _moves(o, now ^ state))

            def better() -> None:
                found.best, found.fewest, found.chosen = error, moves, state

            less = (error < found.best) | ((error <= found.best) & (moves < found.fewest))
            where(o, less, better, found)

        o.repeated(found, len(MOVES), compared)
        return found.chosen

    def feedback_circle(
        self,
        o: Arithmetic,
        inputs: FeedbackInputs,
        now: Any,
        i: FeedbackPair,
        ends: FeedbackEnds,
    ) -> Any:
        """Keep a state whose error is in the circle a sample later; else the longest time within it
        per commutation, and where none lasts a sample the least error.
        """
        square = self.square(o)
        share = o.table("share", _PER_COMMUTATION)
        x = o.let("x", inputs.i_d_ref - i.x)
        y = o.let("y", inputs.i_q_ref - i.y)
        inside = o.let("inside", (x * x + y * y) - square)
        found = _Longest(o.full(0.0, x), now, 0)

        def tried(state: Any) -> None:
            end: Any = o.at(ends.under, state)
            along = o.let("along", (inputs.i_d_ref - end.x) - x)
            across = o.let("across", (inputs.i_q_ref - end.y) - y)

            def present() -> None:
                last_d, last_q = o.let("last_d", x + along), o.let("last_q", y + across)

                def kept() -> None:
                    found.stays = 1

                ends_in = last_d * last_d + last_q * last_q <= square
                where(o, ends_in, kept, found)

            def other() -> None:
                a = o.let("a", along * along + across * across)
                b = o.let("b", x * along + y * across)
                under = o.let("under", b * b - a * inside)

                def meets() -> None:
                    time = o.let("time", (o.root(under) - b) / a, "until the circle, in samples")
                    score = o.let("score", time * o.at(share, _moves(o, now ^ state)))

                    def longer() -> None:
                        found.best, found.chosen = score, state

                    better = (time >= 1.0) & (score > found.best)
                    where(o, better, longer, found)

                crosses = (a > 0.0) & (under >= 0.0) & ((inside <= 0.0) | (b < 0.0))
                where(o, crosses, meets, found)

            o.cases("", (o.equal(state, now), present), otherwise=other, changing=(found,))

        o.repeated(found, len(MOVES), tried)
        return o.cases(
            "named",
            (found.stays > 0, lambda: now),
            (found.best <= 0.0, lambda: o.call(self.feedback_least, inputs, now, ends)),
            otherwise=lambda: found.chosen,
        )

    def feedback_by_table(
        self, o: Arithmetic, inputs: FeedbackInputs, now: Any, i: FeedbackPair, angle: FeedbackPair
    ) -> Any:
        """Sector of the voltage that the references need, region of the error, and what the table
        says of both.
        """
        k = self.constants
        x = o.let("x", inputs.i_d_ref - i.x)
        y = o.let("y", inputs.i_q_ref - i.y)
        e_a = o.let("e_a", angle.x * x - angle.y * y, "errors of the phases, A")
        e_beta = o.let("e_beta", angle.y * x + angle.x * y)
        e_b = o.let("e_b", _ROOT * e_beta - 0.5 * e_a)
        e_c = o.let("e_c", -(_ROOT * e_beta) - 0.5 * e_a)
        v_d = o.let("v_d", k.r_s * inputs.i_d_ref - inputs.omega_e * (k.l_q * inputs.i_q_ref))
        flux = k.l_d * inputs.i_d_ref + k.psi_pm
        v_q = o.let("v_q", k.r_s * inputs.i_q_ref + inputs.omega_e * flux)
        v_alpha = o.let("v_alpha", angle.x * v_d - angle.y * v_q)
        v_beta = o.let("v_beta", angle.y * v_d + angle.x * v_q)
        first = o.let("first", _ROOT * v_alpha + 0.5 * v_beta)
        second = o.let("second", _ROOT * v_alpha - 0.5 * v_beta)
        size_a = o.let("size_a", o.magnitude(e_a))
        size_b = o.let("size_b", o.magnitude(e_b))
        size_c = o.let("size_c", o.magnitude(e_c))
        above, beside = o.cases(
            ("above", "beside"),
            ((size_b > size_a) & (e_b < 0.0), lambda: (size_b, 5)),
            (size_b > size_a, lambda: (size_b, 2)),
            (e_a < 0.0, lambda: (size_a, 3)),
            otherwise=lambda: (size_a, 0),
        )
        largest, region = o.cases(
            ("largest", "region"),
            ((size_c > above) & (e_c < 0.0), lambda: (size_c, 1)),
            (size_c > above, lambda: (size_c, 4)),
            otherwise=lambda: (above, beside),
        )
        sector = o.cases(
            "sector",
            ((v_beta >= 0.0) & (second < 0.0) & (first < 0.0), lambda: 2),
            ((v_beta >= 0.0) & (second < 0.0), lambda: 1),
            (v_beta >= 0.0, lambda: 0),
            (second < 0.0, lambda: 3),
            (first < 0.0, lambda: 4),
            otherwise=lambda: 5,
        )

        def along() -> Any:
            return o.at(o.constant("FEEDBACK_ACTIVE", ACTIVE), region)

        def by_both() -> Any:
            state = o.let("state", o.at(o.constant("FEEDBACK_TABLE", TABLE), sector, region))
            nearer = o.equal(state, 0) & (_moves(o, now ^ 7) < _moves(o, now))
            return o.choose(nearer, 7, state)

        return o.cases(
            "named",
            (largest > o.constant("FEEDBACK_OUTER_BAND_A", k.outer_band), along),
            (largest > o.constant("FEEDBACK_BAND_A", k.band), by_both),
            otherwise=lambda: now,
        )

    def next_state(self, o: Arithmetic, state: Any, inputs: FeedbackInputs) -> Any:
        """The state that is on from the next sample; call it at each sample with the state that is
        on until then (the value that it returned last), and hand the result to the bridge at the
        next sample. Owns nothing, allocates nothing.
        """
        k = self.constants
        now = o.let("now", o.masked(state, 7))
        turn = o.let("turn", inputs.omega_e * (0.5 * k.t_s))
        slow = o.let("slow", 1.0 - 0.5 * (turn * turn))
        fast = o.let("fast", turn * (1.0 - (turn * turn) * (1.0 / 6.0)))
        start = o.let("start", FeedbackPair(inputs.cos_theta, inputs.sin_theta))
        measured = o.let("measured", FeedbackPair(inputs.i_d, inputs.i_q))
        middle = o.let("middle", o.call(feedback_turned, start, slow, fast))
        i = o.let("i", o.call(self.feedback_ahead, inputs, measured, now, middle))
        sampled = o.let("sampled", o.call(feedback_turned, middle, slow, fast))
        if k.rule == "look-up-table":
            return o.call(self.feedback_by_table, inputs, now, i, sampled)
        later = o.let("later", o.call(feedback_turned, sampled, slow, fast))
        zero: Any = 0.0
        ends = o.local("ends", FeedbackEnds((FeedbackPair(zero, zero),) * len(MOVES)))

        def ended(trial: Any) -> None:
            end = o.let("end", o.call(self.feedback_ahead, inputs, i, trial, later))
            ends.under = o.with_item(ends.under, trial, end)

        o.repeated(None, len(MOVES), ended)
        if k.rule == "predictive":
            return o.call(self.feedback_least, inputs, now, ends)
        return o.call(self.feedback_circle, inputs, now, i, ends)


# Up to so many drives it takes less time to ask for one after the other than for arrays of them.
_FEW = 6

# The states, as places of an array that is filled at once.
_PLACES = np.arange(len(MOVES))


@cache
def _converted(number: str, values: tuple[float, ...]) -> Any:
    return np.asarray(values, dtype=number)


class _OneDrive(Arithmetic):
    """The operations of another arithmetic on single numbers, with less to do for each.

    A loop that only fills an array runs once, for all of its places.
    """

    def table(self, name: str, values: Sequence[float]) -> Any:  # noqa: ARG002
        """Constant numbers, converted once."""
        return _converted(self.number.__name__, tuple(values))

    def at(self, table: Sequence[Any], place: Any, *inner: Any) -> Any:
        """What stands at a place, which is a whole number, or at all places at once."""
        if isinstance(place, int):
            found = table[place]
            return found[inner[0]] if inner else found
        return super().at(table, place, *inner)

    def repeated(
        self,
        state: Any,
        count: Any,
        of: Callable[[Any], None],
        until: Callable[[], Any] | None = None,
    ) -> None:
        """As of arrays; without a state no time depends on one before it."""
        if state is None:
            of(_PLACES[:count])
        else:
            super().repeated(state, count, of, until)

    def with_item(self, array: tuple[Any, ...], place: Any, value: Any) -> tuple[Any, ...]:  # noqa: ARG002
        """All items of an array, from their values at all places."""
        return tuple(map(type(value), *value))


def next_codes(
    constants: RuleConstants, codes: Codes, *told: Reals, o: Arithmetic = SINGLE
) -> Codes:
    """Codes (N,) that are on from the next sample, for those (N,) that are on until then.

    Args:
        constants: The rule and what it knows of its drive.
        codes: The states.
        told: Members of `FeedbackInputs` in their order, shape (N,) each.
        o: Single precision is that of the emitted C.
    """
    rule, columns = SampledRule(constants), [np.asarray(column).astype(o.number) for column in told]
    with np.errstate(all="ignore"):  # what is not finite keeps the state
        if codes.size > _FEW:
            return np.asarray(rule.next_state(o, codes, FeedbackInputs(*columns)))
        one = _OneDrive(o.number, o.wrap, o.rotation)
        rows = zip(codes.tolist(), *columns, strict=True)
        named = [int(rule.next_state(one, code, FeedbackInputs(*row))) for code, *row in rows]
    return np.asarray(named, dtype=np.int64)
