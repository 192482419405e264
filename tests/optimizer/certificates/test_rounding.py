"""Bounds of rounding errors against exact arithmetic: rationals and 60 digits,
floats with and without contraction.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
from flint import arb, ctx

from dqforge.optimizer.certificates.ball import ORDER, Piece, pieces
from dqforge.optimizer.current_reference.forms import (
    ClosedForm,
    CurrentReference,
    FixedReference,
    Form,
    Polynomials,
    Proportional,
    ReluctanceClosedForm,
    TorqueExact,
)
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial, FixedSegment
from dqforge.optimizer.curves.single_precision import SinglePolynomial

DIGITS = 60


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


def random_polynomial(generator: np.random.Generator, end: float, size: float) -> SinglePolynomial:
    """Two segments whose terms are all of one size at the ends; some coefficients are zero."""
    floats = [k for k in range(1, 6) if size / (0.5 * end) ** k < 1e36 and (0.5 * end) ** k < 1e36]
    degree = int(generator.integers(1, max(floats) + 1))
    rows = generator.normal(size=(2, degree + 1)) * size / (0.5 * end) ** np.arange(degree + 1)
    rows[0, 0] = 0.0 if generator.random() < 0.5 else rows[0, 0]
    if degree > 1 and generator.random() < 0.3:
        rows[0, 1] = 0.0
    starts = np.array([0.0, generator.uniform(0.3, 0.7) * end], dtype=np.float32)
    return SinglePolynomial(starts, rows.astype(np.float32))


def random_form(name: str, generator: np.random.Generator, end: float, size: float) -> Form:
    if name == "proportional":
        return Proportional(np.float32(generator.uniform(0.5, 2.0) * size / end))
    if name == "reluctance":
        return ReluctanceClosedForm(np.float32(generator.uniform(0.5, 2.0) * size**2 / end), 1)
    d = random_polynomial(generator, end, size)
    if name == "polynomials":
        return Polynomials(d, random_polynomial(generator, end, size))
    if name == "torque-exact":
        magnet = np.float32(end / size)
        return TorqueExact(
            d,
            magnet,
            np.float32(generator.uniform(-1.0, 1.0) * min(0.05 * float(magnet) / size, 1e30)),
        )
    return ClosedForm(
        d, np.float32(size * generator.uniform(0.1, 3.0)), int(generator.choice([1, -1]))
    )


def rational(value: Any) -> Fraction:
    return Fraction(float(value))


def root(value: Fraction) -> Fraction:
    """Square root to 60 digits."""
    with mpmath.workdps(DIGITS):
        found = mpmath.sqrt(mpmath.mpf(value.numerator) / value.denominator)
        mantissa, exponent = mpmath.frexp(found)
        return Fraction(int(mpmath.ldexp(mantissa, 250))) * Fraction(2) ** (int(exponent) - 250)


def horner(polynomial: SinglePolynomial, torque: np.float32) -> Fraction:
    index = int(np.searchsorted(polynomial.starts[1:], torque, side="right"))
    x, value = rational(torque) - rational(polynomial.starts[index]), Fraction(0)
    for coefficient in polynomial.coefficients[index][::-1]:
        value = value * x + rational(coefficient)
    return value


def exactly_evaluated(form: Form, torque: np.float32) -> tuple[Fraction, Fraction]:
    """(i_d, i_q) of the emitted constants without any rounding."""
    t = rational(torque)
    match form:
        case Proportional(gain):
            return Fraction(0), rational(gain) * t
        case ReluctanceClosedForm(gain, _):
            size = root(rational(gain) * t)
            return -size, size
        case Polynomials(d, q):
            return horner(d, torque), horner(q, torque)
        case TorqueExact(d, magnet, slope):
            i_d = horner(d, torque)
            return i_d, t / (rational(slope) * i_d + rational(magnet))
        case ClosedForm(q, base, sign):
            i_q = horner(q, torque)
            return sign * (rational(base) - root(i_q * i_q + rational(form.base_squared))), i_q


def as_fraction(bound: Any) -> Fraction:
    high = bound.abs_upper()
    mantissa, exponent = high.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


FORMS = ["proportional", "reluctance", "polynomials", "torque-exact", "closed-form"]

# Ends of the domain in N m and sizes of the currents in A; those far from 1 meet subnormal and huge
# numbers.
SCALES = [
    (1e2, 1e2),
    (1e-3, 1e-2),
    (1e-38, 1e-3),
    (1e-42, 1e-42),
    (1e-30, 1e-19),
    (1e30, 1e15),
    (1e3, 1e18),
]


@pytest.mark.thinned
@pytest.mark.filterwarnings("ignore:overflow:RuntimeWarning")
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("name", FORMS)
def test_rounding_of_floats_never_exceeds_its_bound(name: str, scale: tuple[float, float]) -> None:
    generator = np.random.default_rng([FORMS.index(name), SCALES.index(scale)])
    proven, closest = 0, 0.0
    for _ in range(12):
        form = random_form(name, generator, *scale)
        reference = CurrentReference(form, np.float32(scale[0]))
        for piece in pieces(reference):
            share = np.sort(
                np.concatenate([generator.uniform(size=6), generator.uniform(size=2) ** 8])
            )
            torque = (piece.low + share * (piece.high - piece.low)).astype(np.float32)
            torque = np.clip(
                torque, np.float32(piece.low), np.nextafter(np.float32(piece.high), np.float32(0.0))
            )
            found = [reference.currents(torque, fused=fused) for fused in (False, True)]
            for index, one in enumerate(torque):
                try:
                    bounds = piece.rounding(arb(float(one)))
                except ZeroDivisionError:
                    continue
                exact = exactly_evaluated(form, one)
                for axis in range(2):
                    bound = as_fraction(bounds[axis])
                    for contraction in found:
                        error = abs(rational(contraction[axis][index]) - exact[axis])
                        assert error <= bound + abs(exact[axis]) * Fraction(10) ** -(DIGITS - 5)
                        closest = max(closest, float(error / bound) if bound else 0.0)
                    proven += 1
    assert proven >= 100 or scale[1] == 1e18
    # A bound that is never approached would be worth little.
    assert closest >= 0.1 or proven == 0 or scale == (1e-42, 1e-42)


@pytest.mark.parametrize("name", FORMS)
def test_bound_of_an_interval_holds_for_its_torques(name: str) -> None:
    """Balls of torques: the bound is not below that of any torque inside,
    and narrow ones lose little.
    """
    generator = np.random.default_rng(7)
    for _ in range(20):
        form = random_form(name, generator, 100.0, 50.0)
        piece = pieces(CurrentReference(form, np.float32(100.0)))[-1]
        low = generator.uniform(piece.low + 1.0, piece.high - 1.0)
        width = generator.uniform(0.0, 0.01)
        inside = [piece.rounding(arb(low + share * width)) for share in (0.0, 0.3, 1.0)]
        try:
            over_all = piece.rounding(arb(low + 0.5 * width, 0.5 * width * (1.0 + 1e-9) + 1e-12))
        except ZeroDivisionError:
            continue
        for axis in range(2):
            assert all(one[axis] <= over_all[axis] for one in inside)


def test_overflow_is_not_bounded() -> None:
    form = Polynomials(
        *[
            SinglePolynomial(
                np.zeros(1, np.float32), np.array([[0.0, 1e30, 1e30]], dtype=np.float32)
            )
            for _ in range(2)
        ]
    )
    piece = pieces(CurrentReference(form, np.float32(1e10)))[0]
    piece.rounding(arb(1.0))
    with pytest.raises(ZeroDivisionError):
        piece.rounding(arb(1e5))


def random_integers(generator: np.random.Generator, width: int, end: int) -> FixedPolynomial:
    """Two segments with random constants whose steps keep to their words.

    Some of the results saturate.
    """
    segments, starts = [], (0, int(generator.integers(end // 4, end // 2)))
    for start in starts:
        degree = int(generator.integers(1, 5))
        bits = width - 1
        shifts = tuple(int(shift) for shift in generator.integers(bits - 4, bits + 3, degree))
        constants = tuple(
            int(generator.integers(-(1 << (shift + bits - 2)), 1 << (shift + bits - 2)))
            for shift in shifts
        )
        leading = int(generator.integers(-(1 << (bits - 1)), 1 << (bits - 1)))
        segments.append(FixedSegment(start, leading, constants, shifts))
    return FixedPolynomial(tuple(segments), width, end)


def exact_integers(segment: FixedSegment, code: int) -> Fraction:
    """What the steps mean: each constant less the half that rounds, and no bit dropped."""
    value = Fraction(segment.leading)
    for constant, shift in zip(segment.constants, segment.shifts, strict=True):
        half = (1 << shift) >> 1
        value = (value * (code - segment.start) + constant - half) / (1 << shift)
    return value


@pytest.mark.parametrize("width", [16, 32])
def test_rounding_of_integers_never_exceeds_its_bound(width: int) -> None:
    generator = np.random.default_rng(width)
    largest, saturated, closest = 2 ** (width - 1) - 1, 0, Fraction(0)
    end = largest - 5
    for _ in range(30):
        d, q = (random_integers(generator, width, end) for _ in range(2))
        reference = FixedReference(d, q, 128.0, 64.0)
        unit = Fraction(64) / (largest + 1)
        for code in [0, 1, end, *generator.integers(0, end, 25).tolist()]:
            torque = Fraction(128 * code, largest + 1)
            piece = next(p for p in reversed(pieces(reference)) if p.low <= torque)
            bounds = piece.rounding(arb(float(torque)))
            exact_balls = piece.currents(arb(float(torque)))
            for axis, polynomial in enumerate((d, q)):
                segment = [s for s in polynomial.segments if s.start <= code][-1]
                value = segment.leading
                for constant, shift in zip(segment.constants, segment.shifts, strict=True):
                    value = (value * (code - segment.start) + constant) >> shift
                result = min(max(value, -largest), largest)
                exact = exact_integers(segment, code)
                saturated += result != value
                assert abs(result - exact) * unit <= as_fraction(bounds[axis])
                if result == value:
                    closest = max(closest, abs(result - exact) * unit / as_fraction(bounds[axis]))
                assert (
                    abs(exact_balls[axis] - arb(exact.numerator) * float(unit) / exact.denominator)
                    < 1e-9
                )
    assert saturated > 10
    assert closest > Fraction(1, 3)


def test_pieces_lie_between_the_breakpoints_of_both_axes() -> None:
    d = SinglePolynomial(np.array([0.0, 3.0], np.float32), np.ones((2, 2), np.float32))
    q = SinglePolynomial(np.array([0.0, 1.0, 3.0], np.float32), np.ones((3, 2), np.float32))
    reference = CurrentReference(Polynomials(d, q), np.float32(8.0))
    assert [(piece.low, piece.high) for piece in pieces(reference)] == [
        (0.0, 1.0),
        (1.0, 3.0),
        (3.0, 8.0),
    ]
    assert pieces(CurrentReference(Proportional(np.float32(2.0)), np.float32(8.0))) == [
        Piece(CurrentReference(Proportional(np.float32(2.0)), np.float32(8.0)), 0.0, 8.0)
    ]
