"""Every lemma on rounding, each for itself: in rational arithmetic it holds at the extremes,
and it is no larger.

The extremes are operands at the ends of their balls and errors, and roundings of the full unit;
what is stated must not be below that, nor more than the lemma of docs/methods/certificates.md says.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx

from dqforge.optimizer.certificates import ball as rounding
from dqforge.optimizer.certificates.ball import (
    ORDER,
    Rounded,
    exact,
    horner,
    pieces,
    product,
    rounded,
    rounded_sum,
)
from dqforge.optimizer.current_reference.forms import (
    ClosedForm,
    CurrentReference,
    FixedReference,
    Polynomials,
    Proportional,
    ReluctanceClosedForm,
    TorqueExact,
)
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial, FixedSegment
from dqforge.optimizer.curves.single_precision import SinglePolynomial

UNIT, LEAST = Fraction(1, 2**24), Fraction(1, 2**149)
SIGNS = (-1, 0, 1)


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


def fraction(ball: Any) -> Fraction:
    """Upper end of a ball."""
    mantissa, exponent = arb(ball).upper().man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def rounding_of(value: Fraction, carried: Fraction) -> Fraction:
    """The lemma: what one operation adds to what it carries, u (|value| + carried) + 2^-149."""
    return carried + UNIT * (abs(value) + carried) + LEAST


def same(found: Any, expected: Fraction) -> None:
    """Equal but for the rounding of balls, which goes upwards."""
    got = fraction(found)
    assert expected <= got <= expected * (1 + Fraction(1, 2**26)) + Fraction(1, 2**200)


# Middle, radius and rounding error.
OPERANDS = [
    (Fraction(3), Fraction(1, 4), Fraction(1, 8)),
    (Fraction(-5), Fraction(1, 2), Fraction(1, 16)),
    (Fraction(7, 2), Fraction(0), Fraction(1, 2)),
    (Fraction(-11, 8), Fraction(1, 8), Fraction(0)),
]


def operand(data: tuple[Fraction, Fraction, Fraction]) -> Rounded:
    middle, radius, error = map(float, data)
    return Rounded(arb(middle, radius), arb(error))


def ends(data: tuple[Fraction, Fraction, Fraction]) -> list[tuple[Fraction, Fraction]]:
    """Exact values and rounded ones at the extremes of a ball and its error."""
    middle, radius, error = data
    return [(middle + s * radius, middle + s * radius + t * error) for s in SIGNS for t in SIGNS]


def test_magnitude_counts_radius_and_error() -> None:
    for data in OPERANDS:
        middle, radius, error = data
        same(operand(data).size(), abs(middle) + radius + error)


def test_one_rounding_adds_a_unit_of_the_largest_result_and_half_a_subnormal() -> None:
    for middle, radius, error in OPERANDS:
        found = rounded(arb(float(middle), float(radius)), arb(float(error)))
        same(found.error, rounding_of(abs(middle) + radius, error))
    same(rounded(arb(0), arb(0)).error, LEAST)


def test_results_up_to_half_of_the_range_are_bounded_and_larger_ones_are_not() -> None:
    half = arb(2) ** 127
    rounded(half * (1 - arb(2) ** -40), arb(0))
    rounded(-half / 4, half / 2)
    for value, carried in ((half, arb(0)), (-half, arb(0)), (half / 2, half / 2), (arb(0), half)):
        with pytest.raises(ZeroDivisionError):
            rounded(value, carried)


@pytest.mark.parametrize("pair", list(itertools.product(OPERANDS, repeat=2)))
def test_product(pair: tuple[tuple[Fraction, ...], tuple[Fraction, ...]]) -> None:
    left, right = pair
    found = product(operand(left), operand(right))  # type: ignore[arg-type]
    size_l, size_r = abs(left[0]) + left[1], abs(right[0]) + right[1]
    value, carried = size_l * size_r, size_l * right[2] + (size_r + right[2]) * left[2]
    same(found.error, rounding_of(value, carried))
    for (x, rx), (y, ry) in itertools.product(ends(left), ends(right)):  # type: ignore[arg-type]
        assert abs(rx * ry - x * y) + UNIT * abs(rx * ry) <= fraction(found.error)
        assert found.value.contains(arb(float(x * y)))


@pytest.mark.parametrize("pair", list(itertools.product(OPERANDS, repeat=2)))
def test_sum(pair: tuple[tuple[Fraction, ...], tuple[Fraction, ...]]) -> None:
    left, right = pair
    found = rounded_sum(operand(left), operand(right))  # type: ignore[arg-type]
    same(found.error, rounding_of(abs(left[0] + right[0]) + left[1] + right[1], left[2] + right[2]))
    for (x, rx), (y, ry) in itertools.product(ends(left), ends(right)):  # type: ignore[arg-type]
        assert abs(rx + ry - x - y) + UNIT * abs(rx + ry) <= fraction(found.error)
        assert found.value.contains(arb(float(x + y)))


@pytest.mark.parametrize("pair", list(itertools.product(OPERANDS, repeat=2)))
def test_quotient(pair: tuple[tuple[Fraction, ...], tuple[Fraction, ...]]) -> None:
    top, bottom = pair
    found = rounding._quotient(operand(top), operand(bottom))  # type: ignore[arg-type]
    most, least = abs(top[0]) + top[1], abs(bottom[0]) - bottom[1]
    ratio = most / least
    got = fraction(found.error)
    expected = rounding_of(ratio, (top[2] + ratio * bottom[2]) / (least - bottom[2]))
    assert (
        expected <= got <= expected * Fraction(11, 10)
    )  # quotients of balls are a little wider than of intervals
    if top[1] == bottom[1] == 0:
        same(found.error, expected)
    for (x, rx), (y, ry) in itertools.product(ends(top), ends(bottom)):  # type: ignore[arg-type]
        assert abs(rx / ry - x / y) + UNIT * abs(rx / ry) <= got


def test_quotient_by_exact_operands_is_sharp() -> None:
    found = rounding._quotient(Rounded(arb(6), arb(0.5)), Rounded(arb(-4), arb(0.25)))
    same(
        found.error,
        rounding_of(Fraction(3, 2), (Fraction(1, 2) + Fraction(3, 2) / 4) / Fraction(15, 4)),
    )
    assert found.value == arb(-1.5)


def test_divisors_that_may_vanish_are_refused() -> None:
    for bottom in (
        Rounded(arb(1), arb(1)),
        Rounded(arb(1, 1), arb(0)),
        Rounded(arb(-1, 0.5), arb(0.5)),
    ):
        with pytest.raises(ZeroDivisionError):
            rounding._quotient(exact(1.0), bottom)
    rounding._quotient(exact(1.0), Rounded(arb(1), arb(0.999)))


def test_root_divides_the_error_by_the_least_root() -> None:
    """Perfect squares throughout: [25, 49] with error 9 falls to 16, root 4."""
    found = rounding._root(Rounded(arb(37, 12), arb(9)))
    got = fraction(found.error)
    expected = rounding_of(Fraction(7), Fraction(9, 4))
    assert expected <= got <= expected * Fraction(101, 100)
    for value in (25, 36, 49):
        for error in (-9, 9):
            assert abs(float(value + error) ** 0.5 - float(value) ** 0.5) <= float(got)
    assert found.value.contains(arb(5))
    assert found.value.contains(arb(7))
    same(rounding._root(Rounded(arb(25), arb(9))).error, rounding_of(Fraction(5), Fraction(9, 4)))


def test_root_of_what_may_vanish_errs_by_the_root_of_the_error() -> None:
    for square in (Fraction(0), Fraction(9), Fraction(4)):
        found = rounding._root(Rounded(arb(float(square)), arb(9)))
        value = {0: 0, 9: 3, 4: 2}[int(square)]
        same(found.error, rounding_of(Fraction(value), Fraction(3)))
    # Just beyond, the first form holds: 9 over the root of 25 - 9,
    # and 5/16 over that of 9/16 - 5/16.
    same(
        rounding._root(Rounded(arb(0.5625), arb(0.3125))).error,
        rounding_of(Fraction(3, 4), Fraction(5, 8)),
    )
    same(rounding._root(Rounded(arb(25), arb(9))).error, rounding_of(Fraction(5), Fraction(9, 4)))


def test_constants_are_exact() -> None:
    assert exact(0.1).error == 0
    assert exact(0.1).value == arb(0.1)


def chain(row: list[float], x: tuple[Fraction, Fraction]) -> tuple[Fraction, Fraction]:
    """Value and error of Horner's rule at one exact argument with its error, lemma by lemma."""
    value, error = Fraction(row[-1]), Fraction(0)
    for coefficient in row[-2::-1]:
        carried = abs(value) * x[1] + (abs(x[0]) + x[1]) * error
        value = value * x[0]
        error = rounding_of(value, carried)
        if coefficient != 0.0:
            value = value + Fraction(coefficient)
            error = rounding_of(value, error)
    return value, error


@pytest.mark.parametrize("row", [[0.5, -1.5, 2.0, -0.25], [0.0, 3.0, 0.0, 1.25], [0.0, -0.75]])
@pytest.mark.parametrize("index", [0, 1])
def test_horner_is_product_and_sum_in_turn(row: list[float], index: int) -> None:
    starts = np.array([0.0, 1.0], np.float32)
    torque = Fraction(5, 2)
    found = horner(starts, np.array([row, row]), index, exact(float(torque)))
    x = (torque, Fraction(0)) if index == 0 else (torque - 1, rounding_of(torque - 1, Fraction(0)))
    value, error = chain(row, x)
    same(found.error, error)
    assert fraction(found.value) == value


SINGLE = SinglePolynomial(
    np.array([0.0, 2.0], np.float32), np.array([[0.0, -1.0, 0.5], [-3.0, 0.25, -0.125]], np.float32)
)
OTHER = SinglePolynomial(np.array([0.0], np.float32), np.array([[0.0, 2.0]], np.float32))


def only_piece(form: Any, low: float) -> Any:
    reference = CurrentReference(form, np.float32(8.0))
    return next(piece for piece in reversed(pieces(reference)) if piece.low <= low)


@pytest.mark.parametrize("torque", [Fraction(1), Fraction(6)])
def test_forms_are_their_operations_in_turn(torque: Fraction) -> None:
    """Errors of every form from the lemmas of its operations, in the order of the emitted C."""
    at, ball = float(torque), arb(float(torque))
    index = 0 if torque < 2 else 1
    i_d = horner(SINGLE.starts, SINGLE.coefficients, index, exact(at))
    other = horner(OTHER.starts, OTHER.coefficients, 0, exact(at))
    d, q = only_piece(Polynomials(SINGLE, OTHER), at).rounding(ball)
    same(d, fraction(i_d.error))
    same(q, fraction(other.error))
    d, q = only_piece(Proportional(np.float32(1.5)), at).rounding(ball)
    assert d == 0
    same(q, rounding_of(Fraction(3, 2) * torque, Fraction(0)))
    divisor = rounded_sum(product(exact(0.125), i_d), exact(4.0))
    d, q = only_piece(TorqueExact(SINGLE, np.float32(4.0), np.float32(0.125)), at).rounding(ball)
    same(d, fraction(i_d.error))
    same(q, fraction(rounding._quotient(exact(at), divisor).error))
    form = ClosedForm(SINGLE, np.float32(2.0), 1)
    root = rounding._root(rounded_sum(product(i_d, i_d), exact(float(form.base_squared))))
    d, q = only_piece(form, at).rounding(ball)
    expected = rounding_of(
        Fraction(0), fraction(root.error)
    )  # the difference is taken below, it has either sign
    size = abs(fraction(arb(2.0) - root.value))
    assert abs(fraction(d) - (expected + UNIT * size)) <= expected / 10**6
    same(q, fraction(i_d.error))
    d, q = only_piece(ReluctanceClosedForm(np.float32(1.5), 1), at).rounding(ball)
    root = rounding._root(product(exact(1.5), exact(at)))
    same(d, fraction(root.error))
    same(q, fraction(root.error))


@pytest.mark.parametrize("sign", [1, -1])
def test_exact_currents_of_the_constants(sign: int) -> None:
    """i_d and i_q of each form at T = 6 in plain numbers: p = -3 + 0.25 x -
    0.125 x^2 with x = 4 is -4.
    """
    ball = arb(6)
    assert tuple(map(float, only_piece(Polynomials(SINGLE, OTHER), 6).currents(ball))) == (
        -4.0,
        12.0,
    )
    assert tuple(map(float, only_piece(Proportional(np.float32(1.5)), 6).currents(ball))) == (
        0.0,
        9.0,
    )
    i_d, i_q = only_piece(TorqueExact(SINGLE, np.float32(4.0), np.float32(0.25)), 6).currents(ball)
    assert (float(i_d), float(i_q)) == (-4.0, 2.0)
    i_d, i_q = only_piece(ClosedForm(SINGLE, np.float32(3.0), sign), 6).currents(ball)
    assert float(i_q) == -4.0
    assert float(i_d) == pytest.approx(sign * (3.0 - 5.0), rel=1e-15)
    i_d, i_q = only_piece(ReluctanceClosedForm(np.float32(1.5), sign), 6).currents(ball)
    assert (float(i_d), float(i_q)) == (-sign * 3.0, 3.0)


FIRST = FixedSegment(0, 3, (5, 9), (1, 2))
SECOND = FixedSegment(4, -7, (-40, 300), (3, 0))
UNIT_A = Fraction(64, 2**15)  # A code of the current; one of the torque is 128 N m / 2^15.


def integer_piece(code: Fraction, polynomial: FixedPolynomial) -> Any:
    torque = float(code * 128 / 2**15)
    reference = FixedReference(None, polynomial, 128.0, 64.0)
    return next(piece for piece in reversed(pieces(reference)) if piece.low <= torque), torque


def integer_steps(segment: FixedSegment, code: Fraction) -> tuple[Fraction, Fraction]:
    """Exact value of the steps, and what their shifts may have taken: half a unit each,
    carried on.
    """
    x, value, error = code - segment.start, Fraction(segment.leading), Fraction(0)
    for constant, shift in zip(segment.constants, segment.shifts, strict=True):
        half = Fraction((1 << shift) >> 1)
        value = (value * x + constant - half) / 2**shift
        error = error * abs(x) / 2**shift + (Fraction(1, 2) if shift > 0 else 0)
    return value, error


@pytest.mark.parametrize("code", [Fraction(1), Fraction(3), Fraction(4), Fraction(9), Fraction(30)])
def test_shifts_take_half_a_unit_each(code: Fraction) -> None:
    piece, torque = integer_piece(code, FixedPolynomial((FIRST, SECOND), 16, 40))
    value, error = integer_steps(FIRST if code < 4 else SECOND, code)
    i_d, i_q = piece.currents(arb(torque))
    assert isinstance(i_d, arb)
    assert i_d == 0
    assert abs(float(i_q) - float(value * UNIT_A)) <= 1e-15
    bound_d, bound_q = piece.rounding(arb(torque))
    assert bound_d == 0
    same(bound_q, error * UNIT_A)
    # A ball of torques counts with its far end.
    same(
        piece.rounding(arb(torque, torque / 2))[1],
        wide_error(FIRST if code < 4 else SECOND, code) * UNIT_A,
    )


def wide_error(segment: FixedSegment, code: Fraction) -> Fraction:
    """The error where the code lies within half of itself; the far end of x counts."""
    far = max(abs(code * Fraction(3, 2) - segment.start), abs(code / 2 - segment.start))
    error = Fraction(0)
    for shift in segment.shifts:
        error = error * far / 2**shift + (Fraction(1, 2) if shift > 0 else 0)
    return error


def test_saturation_adds_what_it_cuts_off() -> None:
    """3000 x from code 0: at 20 the value is 60000 + 1/2, the word ends at 32767;
    at 10 nothing is cut off.
    """
    line = FixedSegment(0, 6000, (1,), (1,))
    polynomial = FixedPolynomial((line,), 16, 40)
    piece, torque = integer_piece(Fraction(20), polynomial)
    cut = 60000 + Fraction(1, 2) - 32767
    same(piece.rounding(arb(torque))[1], (Fraction(1, 2) + cut) * UNIT_A)
    piece, torque = integer_piece(Fraction(10), polynomial)
    same(piece.rounding(arb(torque))[1], Fraction(1, 2) * UNIT_A)


def test_pieces_of_integers_end_at_the_domain() -> None:
    reference = FixedReference(None, FixedPolynomial((FIRST, SECOND), 16, 40), 128.0, 64.0)
    code = 128.0 / 2**15
    assert [(piece.low, piece.high) for piece in pieces(reference)] == [
        (0.0, 4 * code),
        (4 * code, 40 * code),
    ]


def test_polynomial_of_degree_zero_is_a_series_too() -> None:
    from flint import arb_series

    found = rounding._polynomial([arb(2)], arb_series([arb(1), 1]))
    assert isinstance(found, arb_series)
    assert found[0] == arb(2)
