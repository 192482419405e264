"""Lemmas on integer ranges and on single precision, each for itself and
exhaustively where numbers are few.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from fractions import Fraction
from math import isqrt

import numpy as np
import pytest

from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.curves.single_precision import (
    SINGLE,
    PiecewisePolynomial,
    SingleArray,
    SinglePolynomial,
    _monic_chebyshev,
    fused_multiply_add,
    in_segments,
    multiply_add,
)
from dqforge.optimizer.fixed_control import ranges as fixed_ranges
from dqforge.optimizer.fixed_control.ranges import (
    DeadBand,
    codes,
    dead_band,
    finest,
    observer_ranges,
    pi_ranges,
    require,
    with_fraction,
)
from dqforge.optimizer.fixed_control.transforms import (
    FixedObserver,
    FixedPi,
    Pi,
    PiVelocity,
    ReducedOrder,
    pi_gains,
    reduced_order_gains,
)
from dqforge.optimizer.loops.integer_gains import FixedGain, given, quantise
from dqforge.optimizer.steps import integer_arithmetic as fixed
from dqforge.optimizer.steps.code_vectors import Dq
from dqforge.optimizer.steps.integer_arithmetic import Integers, Range, Ranges, Reach, scaled

SPANS = [Range(low, high) for low in range(-4, 5) for high in range(low, 5)]
POSITIVE = [Range(low, high) for low in range(1, 5) for high in range(low, 5)]
NATURAL = [Range(low, high) for low in range(5) for high in range(low, 5)]


def grid(a: Range, b: Range) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(a.low, a.high + 1), np.arange(b.low, b.high + 1))
    return x, y


def ends(values: np.ndarray) -> Range:
    return Range(int(values.min()), int(values.max()))


def test_ranges_of_one_operand_are_exact() -> None:
    o, numbers = Ranges(16), Integers()
    for a in SPANS:
        x = np.arange(a.low, a.high + 1)
        assert o.negative(a) == ends(-x)
        assert ends(numbers.negative(x)) == ends(-x)
        for bits in (0, 1, 2):
            assert o.shifted(a, bits) == ends(np.floor(x / 2**bits).astype(int))
            assert ends(numbers.shifted(x, bits)) == o.shifted(a, bits)
        for low, high in ((-2, 3), (0, 0), (1, 2), (None, 1), (-1, None)):
            assert o.clamp(a, low, high) == ends(np.clip(x, low, high))
            assert ends(numbers.clamp(x, low, high)) == o.clamp(a, low, high)
        assert a.largest == int(np.max(np.abs(x)))
        assert o.wrapped(a, 3) == Range(0, 7)
        np.testing.assert_array_equal(numbers.wrapped(x, 3), x % 8)
        if a.low >= 0:
            roots = np.array([isqrt(int(one)) for one in x])
            assert o.root(a) == ends(roots)
            np.testing.assert_array_equal(numbers.root(x), roots)


def test_ranges_of_two_operands_are_exact() -> None:
    o, numbers = Ranges(16), Integers()
    for a, b in itertools.product(SPANS, repeat=2):
        x, y = grid(a, b)
        assert o.product("p", a, b) == ends(x * y)
        assert o.total("s", a, b) == ends(x + y)
        assert a.hull(b) == Range(min(a.low, b.low), max(a.high, b.high))
        for name, decided in (("at_least", x >= y), ("above", x > y), ("equal", x == y)):
            whole = True if decided.all() else None if decided.any() else False
            assert getattr(o, name)(a, b) is whole
            np.testing.assert_array_equal(getattr(numbers, name)(x, y), decided)
    for a, b in itertools.product(SPANS, POSITIVE):
        x, y = grid(a, b)
        towards_zero = np.trunc(x / y).astype(int)
        assert o.quotient("q", a, b) == ends(towards_zero)
        np.testing.assert_array_equal(numbers.quotient("q", x, y), towards_zero)
    for a, limit in itertools.product(SPANS, NATURAL):
        x, y = grid(a, limit)
        assert o.within(a, limit) == ends(np.clip(x, -y, y))
        np.testing.assert_array_equal(numbers.within(x, y), np.clip(x, -y, y))


def test_choices_take_both_where_open() -> None:
    o, a, b = Ranges(16), Range(1, 2), Range(5, 7)
    assert o.choose(True, a, b) == a
    assert o.choose(False, a, b) == b
    assert o.choose(None, a, b) == Range(1, 7)
    assert int(Integers().choose(np.array(True), np.array(3), np.array(4))) == 3
    assert o.const(-3) == Range(-3, -3)
    assert int(Integers().const(-3)) == -3


def test_every_partial_sum_counts() -> None:
    """30 + 30 - 40: the end fits what the middle does not."""
    o, seen = Ranges(4), Integers({})
    assert o.total("s", Range(100, 100), Range(100, 100), Range(-150, -150)) == Range(50, 50)
    assert o.reaches["s"].range == Range(50, 200)
    worst = o.overflowing()
    assert worst is not None
    assert worst.name == "s"
    seen.total("s", np.array(100), np.array(100), np.array(-150))
    assert seen.seen == {"s": (0, 200)}
    seen.product("p", np.array([-3, 4]), np.array(5))
    assert seen.seen is not None
    assert seen.seen["p"] == (-15, 20)
    seen.product("p", np.array([-4, 1]), np.array(5))
    assert seen.seen["p"] == (-20, 20)


def test_words_hold_from_minus_half_to_one_less_than_half() -> None:
    for low, high, fits in ((-128, 127, True), (-129, 0, False), (0, 128, False), (0, 0, True)):
        assert Reach("x", Range(low, high), 8).fits is fits
    assert Reach("x", Range(-64, 3), 8).share == 0.5
    o = Ranges(8, "a: ")
    o.product("x", Range(0, 2), Range(0, 3))
    o.product("x", Range(-1, -1), Range(4, 4))
    assert o.reaches["a: x"] == Reach("a: x", Range(-4, 6), 16)
    assert o.overflowing() is None


def test_shift_rounds_halves_upwards() -> None:
    numbers = Integers()
    for bits in range(4):
        for a in range(-40, 41):
            wanted = (Fraction(a, 2**bits) + Fraction(1, 2) * (bits > 0)).__floor__()
            assert int(fixed.rounded(numbers, "x", np.array(a), bits)) == wanted
    for a, b in itertools.product(range(-3, 4), repeat=2):
        assert int(fixed.larger(numbers, np.array(a), np.array(b))) == max(a, b)
        assert int(fixed.magnitude(numbers, np.array(a))) == abs(a)


def test_codes_of_a_word() -> None:
    assert codes(16) == Range(-32768, 32767)
    assert DeadBand(3, 5).largest == 5
    assert DeadBand(7, 5).largest == 7


@pytest.mark.parametrize("rounding", [True, False])
def test_dead_band_is_the_least_error_that_moves(rounding: bool) -> None:
    for mantissa, shift in itertools.product(range(1, 20), range(7)):
        gain = FixedGain(mantissa, shift, mantissa / 2**shift)
        half = (1 << shift) >> 1 if rounding else 0
        found = dead_band(gain, rounding=rounding)
        errors = range(1, 200)
        assert found.positive == next(e for e in errors if (e * mantissa + half) >> shift != 0)
        assert found.negative == next(e for e in errors if (-e * mantissa + half) >> shift != 0)
    with pytest.raises(NoSolutionError):
        dead_band(FixedGain(0, 3, 0.0))


PI = FixedPi(
    given(3.7, 12), quantise(0.2 * 2.0**4, 16, 65_535), quantise(0.05 * 2.0**4, 16, 2**19), 4
)


def test_finer_state_has_the_same_integers() -> None:
    finer = with_fraction(PI, 2)
    assert finer is not None
    assert finer.fraction == 2
    assert (finer.ki.mantissa, finer.ki.shift) == (PI.ki.mantissa, PI.ki.shift - 2)
    assert finer.ki.value == 4.0 * PI.ki.value
    assert finer.tracking.shift == PI.tracking.shift - 2
    most = min(PI.ki.shift, PI.tracking.shift)
    assert with_fraction(PI, most) is not None
    assert with_fraction(PI, most + 1) is None


def test_finest_is_the_last_that_fits() -> None:
    coarse = replace(PI, fraction=0)
    for most in (0, 3, 15):
        found = finest(16, "x", coarse, "parallel", most)
        assert found is not None
        assert found.fraction <= min(most, 14)
        assert pi_ranges(16, "x", found, "parallel").overflowing() is None
        for fraction in range(found.fraction + 1, min(most, 14) + 1):
            finer = with_fraction(coarse, fraction)
            assert finer is None or pi_ranges(16, "x", finer, "parallel").overflowing() is not None


def test_refusal_names_quantity_reach_and_word() -> None:
    o = Ranges(8)
    o.product("kp e", Range(0, 200), Range(0, 200))
    with pytest.raises(
        NoSolutionError, match="'kp e' can reach 40000, int16_t ends at 32767; do so"
    ):
        require(o, "do so")
    require(Ranges(8))


SMALL = np.array(
    [
        s * m * 2.0**e
        for s in (-1, 1)
        for m in (1.0, 1.5, 1 + 2**-23, 2 - 2**-23)
        for e in (-24, -1, 0, 23)
    ]
)


def test_fused_sum_is_the_nearest_float_of_the_exact_one() -> None:
    """All triples of floats at the ends of their binades: the halfway cases are among them."""
    a, b, c = (part.ravel().astype(np.float32) for part in np.meshgrid(SMALL, SMALL[::3], SMALL))
    fused, plain = fused_multiply_add(a, b, c), multiply_add(a, b, c)
    for k in range(0, a.size, 7):
        exact = Fraction(float(a[k])) * Fraction(float(b[k])) + Fraction(float(c[k]))
        off = abs(Fraction(float(fused[k])) - exact)
        for towards in (-np.inf, np.inf):
            beside = np.nextafter(fused[k], np.float32(towards))
            other = abs(Fraction(float(beside)) - exact)
            assert off < other or (off == other and int(fused[k].view(np.uint32)) % 2 == 0)
        assert plain[k] == np.float32(a[k] * b[k]) + c[k]


@pytest.mark.parametrize("width", [0.5, 3.0])
def test_monic_polynomial_of_least_size(width: float) -> None:
    """2 (w/4)^n T_n(2 x/w - 1): leading coefficient 1, largest value 2 (w/4)^n, at both ends."""
    for degree in range(1, 6):
        found = _monic_chebyshev(degree, width)
        x = np.linspace(0.0, width, 401)
        values = np.polynomial.polynomial.polyval(x, found)
        assert found[-1] == 1.0
        assert np.max(np.abs(values)) == pytest.approx(2.0 * (width / 4.0) ** degree, rel=1e-9)
        assert values[-1] == pytest.approx(2.0 * (width / 4.0) ** degree, rel=1e-9)
        assert values[0] == pytest.approx((-1) ** degree * values[-1], rel=1e-9)


def test_coefficients_rounded_in_turn_make_up_for_each_other() -> None:
    """The polynomial moves by a small share of what plain rounding of each
    coefficient moves it by at worst.
    """
    generator = np.random.default_rng(5)
    wins = 0
    for _ in range(20):
        edges = np.array([0.0, 3.0])
        exact = PiecewisePolynomial(edges, generator.normal(size=(1, 5)) / 3.0 ** np.arange(5))
        x = np.linspace(0.0, 3.0, 301)
        turned = SinglePolynomial.from_double(exact).coefficients[0].astype(float)
        plain = exact.coefficients[0].astype(np.float32).astype(float)
        off = [
            np.max(np.abs(np.polynomial.polynomial.polyval(x, row) - exact(x)))
            for row in (turned, plain)
        ]
        assert turned[0] == plain[0]
        wins += off[0] < off[1]
    assert wins >= 15
    missing = PiecewisePolynomial(np.array([0.0, 3.0]), np.array([[0.1, 0.0, 0.3]]))
    found = SinglePolynomial.from_double(missing).coefficients[0]
    np.testing.assert_array_equal(found, np.array([0.1, 0.0, 0.3], np.float32))


def test_odd_continuation() -> None:
    """Through zero the last product carries the sign; elsewhere the result is turned."""
    polynomial = SinglePolynomial(
        np.array([0.0, 2.0], np.float32), np.array([[0.0, 1.5, 0.5], [4.0, 1.0, 0.0]], np.float32)
    )
    signed = np.array([-1.0, 1.0, -3.0, 3.0, 2.0, -2.0], np.float32)

    def odd(curve: SinglePolynomial, t: SingleArray) -> SingleArray:
        return in_segments(
            SINGLE, "i", curve.starts, np.abs(t), lambda n, x: curve.odd_within(SINGLE, n, x, t)
        )

    found = odd(polynomial, signed)
    np.testing.assert_array_equal(found, [-2.0, 2.0, -5.0, 5.0, 4.0, -4.0])
    shifted = SinglePolynomial(np.array([0.0], np.float32), np.array([[1.0, 2.0]], np.float32))
    found = odd(shifted, signed[:2])
    np.testing.assert_array_equal(found, [-3.0, 3.0])
    np.testing.assert_array_equal(shifted.evaluate(np.array([0.5], np.float32)), [2.0])


@pytest.mark.parametrize("width", [8, 16])
def test_controllers_are_met_by_any_error_and_any_past(
    monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    """Errors of two codes, limits up to full scale, states within it and with
    the fraction's bits more.
    """
    asked: list[tuple[object, ...]] = []
    monkeypatch.setattr(fixed_ranges, "pi_step", lambda *given: asked.append(given))
    monkeypatch.setattr(fixed_ranges, "pi_velocity_step", lambda *given: asked.append(given))
    pi, top = replace(PI, fraction=3), 2 ** (width - 1) - 1
    pi_ranges(width, "x", pi, "parallel")
    *_, state, error, limit = asked[-1]
    assert asked[-1][1] == pi_gains(width, pi)
    assert state == Pi(Range(-8 * top, 8 * top))
    assert error == Range(1 - 2**width, 2**width - 1)
    assert limit == Range(0, top)
    pi_ranges(width, "x", pi, "velocity")
    _, used, past, error, limit = asked[-1]
    assert used == pi_gains(width, pi)
    assert isinstance(past, PiVelocity)
    assert past.output == Range(-8 * top, 8 * top)
    assert past.proportional == scaled(Ranges(32), "kp e", pi.kp, Range(1 - 2**width, 2**width - 1))
    assert error == Range(1 - 2**width, 2**width - 1)
    assert limit == Range(0, top)


def test_observer_is_met_by_any_state(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[object, ...]] = []
    monkeypatch.setattr(fixed_ranges, "reduced_order_step", lambda *given: asked.append(given))
    part = FixedObserver(PI.kp, PI.kp, PI.kp, PI.kp, PI.kp, fraction=2, reach=3)
    observer_ranges(8, part)
    _, width, used, state, voltage, current = asked[0]
    assert (width, used) == (8, reduced_order_gains(8, part))
    assert isinstance(state, ReducedOrder)
    assert state.zeta == Range(-127 * 3 * 4, 127 * 3 * 4)
    every = Range(-128, 127)
    assert (state.omega_m, state.i, voltage, current) == (every, *[Dq(every, every)] * 3)


def test_roots_are_exact_beside_every_square() -> None:
    """The double of a large integer is rounded: one below a square its root would be one too
    large.
    """
    numbers = Integers()
    roots = np.concatenate(
        [np.arange(1, 300), 2**31 - 1 - np.arange(300), 94906265 + np.arange(-200, 200)]
    )
    for off in (-1, 0, 1, 2):
        squares = roots.astype(np.int64) ** 2 + off
        np.testing.assert_array_equal(numbers.root(squares), [isqrt(int(one)) for one in squares])


@pytest.mark.parametrize("width", [8, 16])
def test_state_keeps_two_bits_less_than_a_word(monkeypatch: pytest.MonkeyPatch, width: int) -> None:
    """Were nothing to overflow, the fraction would end two bits below the word."""
    monkeypatch.setattr(
        fixed_ranges, "with_fraction", lambda pi, fraction: replace(pi, fraction=fraction)
    )
    monkeypatch.setattr(fixed_ranges, "pi_ranges", lambda *_: Ranges(64))
    found = finest(width, "x", PI, "parallel", 99)
    assert found is not None
    assert found.fraction == width - 2
