"""Every lemma on balls and Taylor remainders, each for itself: sound at the extremes,
and no wider than stated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx

from dqforge.optimizer.certificates.ball import (
    ORDER,
    Balls,
    Expansion,
    as_ball,
    exactly,
    hull,
    magnitude,
    most,
    upper,
    widened,
)

MORE, UNIT, LEAST = 1.0 + 2.0**-47, 2.0**-52, 1e-290


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


def test_upper_is_the_next_double_above() -> None:
    for value in (1.0, -1.0, 3.0, -2.5e-9, 1e300):
        assert upper(arb(value)) == math.nextafter(abs(value), math.inf)
    assert 1.5 < upper(arb(1, 0.5)) < 1.5 + 1e-8
    assert 1.5 < upper(arb(-1, 0.5)) < 1.5 + 1e-8
    assert upper(arb(0)) == 0.0
    assert upper(arb("1e-400")) == 1e-300
    assert upper(arb("inf")) == math.inf
    assert upper(arb("nan")) == math.inf


def test_balls_are_made_as_given() -> None:
    assert exactly(0.1) == arb(0.1)
    assert as_ball(3) == arb(3)
    ball = arb(1, 0.5)
    assert as_ball(ball) is ball
    wide = widened(arb(1, 0.5), arb(0.25))
    assert float(wide.lower()) == pytest.approx(0.25, rel=1e-8)
    assert float(wide.upper()) == pytest.approx(1.75, rel=1e-8)
    around = hull([arb(2, 0.5), arb(-1, 0.25), arb(0)])
    assert (float(around.lower()), float(around.upper())) == pytest.approx((-1.25, 2.5), rel=1e-7)


def test_expansion_reaches_both_ends_and_little_further() -> None:
    found = Expansion(1.0, 5.0)
    assert float(found.middle) == 3.0
    assert 2.0 < float(found.radius) <= 2.0 * (1 + 4e-15)
    assert found.ball.contains(arb(1))
    assert found.ball.contains(arb(5))
    assert float(found.step.lower()) <= -2.0
    assert float(found.step.upper()) == pytest.approx(2.0, rel=1e-8)
    thin = Expansion(4.0, 4.0)
    assert 0.0 < float(thin.radius) <= 8e-15


def test_radius_of_a_narrow_expansion_covers_the_rounding_of_its_middle() -> None:
    """Far from zero the middle may be off by half a last place, 2^-53 of it.

    The radius has 1e-15 of it to spare.
    """
    for low in (1.0, 1e5, 3e-7):
        found = Expansion(low, float(np.nextafter(low, 2 * low)))
        assert float(found.radius) >= 1e-15 * low
        assert float(found.radius) <= 2e-15 * low


@pytest.mark.parametrize("power", range(ORDER + 3))
def test_taylor_polynomial_of_a_power_is_its_binomials(power: int) -> None:
    """t^n about 2 within 1/2: sum of C(n, k) 2^(n-k) r^k, from order 5 on with the
    coefficient over the whole ball.
    """
    found = Expansion(1.5, 2.5).enclose(lambda t: [t**power if power else t * 0 + 1])[0]
    centre, radius = Fraction(2), Fraction(1, 2)
    exact = [
        math.comb(power, k) * centre ** max(power - k, 0) for k in range(min(power, ORDER - 1) + 1)
    ]
    spread = sum((part * radius**k for k, part in enumerate(exact) if k), Fraction(0))
    if power >= ORDER:
        spread += math.comb(power, ORDER) * (centre + radius) ** (power - ORDER) * radius**ORDER
    assert float(found.upper()) == pytest.approx(float(exact[0] + spread), rel=1e-6)
    assert float(found.lower()) == pytest.approx(float(exact[0] - spread), rel=1e-6, abs=1e-6)
    assert found.contains(arb(1.5) ** power)
    assert found.contains(arb(2.5) ** power)


def test_functions_that_are_not_finite_are_refused() -> None:
    for function in (lambda t: [1 / t], lambda t: [(t - 5).sqrt()], lambda t: [t, 1 / (t - 1)]):
        with pytest.raises(ZeroDivisionError):
            Expansion(-1.0, 1.0).enclose(function)


ENDS = [(-2.0, 3.0), (0.1, 0.1), (-0.7, -0.3), (1e-3, 5.0), (0.0, 2.0), (-1e8, -1e-8)]


def between(pair: tuple[float, float]) -> Balls:
    return Balls.between(*pair)


def bounds(ball: Balls) -> tuple[Fraction, Fraction]:
    mid, rad = Fraction(float(ball.mid)), Fraction(float(ball.rad))
    return mid - rad, mid + rad


def inner(pair: tuple[float, float]) -> list[Fraction]:
    low, high = map(Fraction, pair)
    return [low, high, low + (high - low) / 3]


OPERATIONS: dict[
    str, tuple[Callable[[Any, Any], Any], Callable[[Fraction, Fraction], Fraction]]
] = {
    "+": (lambda a, b: a + b, lambda x, y: x + y),
    "-": (lambda a, b: a - b, lambda x, y: x - y),
    "*": (lambda a, b: a * b, lambda x, y: x * y),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_operations_hold_all_results_and_little_else(name: str) -> None:
    operation, exact = OPERATIONS[name]
    for left, right in itertools.product(ENDS, repeat=2):
        a, b = between(left), between(right)
        found = operation(a, b)
        low, high = bounds(found)
        values = [exact(x, y) for x in inner(left) for y in inner(right)]
        assert low <= min(values)
        assert max(values) <= high
        rad = (abs(a.mid) + a.rad) * b.rad + a.rad * abs(b.mid) if name == "*" else a.rad + b.rad
        assert float(found.rad) == pytest.approx(
            float((rad + abs(found.mid) * UNIT) * MORE), rel=1e-14, abs=2e-290
        )


def test_radius_of_exact_operands_is_that_of_one_rounding() -> None:
    """2^-52 of the result, made up by 2^-47; products keep 1e-290 for underflow."""
    third, seventh = Balls.exact(1 / 3), Balls.exact(-3 / 7)
    total, product, negative = third + seventh, third * seventh, third - seventh
    assert float(total.rad) == abs(1 / 3 - 3 / 7) * UNIT * MORE
    assert float(negative.rad) == (1 / 3 + 3 / 7) * UNIT * MORE
    assert float(product.rad) == abs(1 / 3 * (3 / 7)) * UNIT * MORE + LEAST
    assert float((Balls.exact(1e-200) * Balls.exact(1e-200)).rad) >= LEAST
    assert float((2.0 - third).mid) == 2.0 - 1 / 3
    assert float((2.0 * third).mid) == 2 / 3


def test_zero_is_exact() -> None:
    ball = between((1.0, 2.0))
    assert ball + 0 is ball
    assert 0 + ball is ball
    assert ball * 0 == 0
    assert 0 * ball == 0
    assert isinstance(ball + 1, Balls)
    assert isinstance(ball * 1, Balls)
    assert magnitude(0) == 0
    assert magnitude(-3) == 3
    assert most(0) == 0
    assert float(magnitude(between((-3.0, 1.0)))) == pytest.approx(3.0, rel=1e-12)
    assert float(most(between((-3.0, -1.0)))) == pytest.approx(-1.0, rel=1e-12)


def test_negative_turns_the_middle_alone() -> None:
    ball = -between((1.0, 4.0))
    assert bounds(ball)[0] <= -4
    assert bounds(ball)[1] >= -1
    assert float(ball.rad) == float(between((1.0, 4.0)).rad)


@pytest.mark.parametrize("pair", ENDS)
def test_ends_and_magnitudes_are_rounded_outwards(pair: tuple[float, float]) -> None:
    ball, (low, high) = between(pair), pair
    assert bounds(ball)[0] <= Fraction(low)
    assert bounds(ball)[1] >= Fraction(high)
    size = max(abs(low), abs(high))
    assert float(ball.rad) == pytest.approx((high - low) / 2, rel=1e-12, abs=1e-12 * size)
    assert float(ball.rad) >= (high - low) / 2
    up, down = float(ball.upper()), float(ball.lower())
    assert Fraction(up) > bounds(ball)[1]
    assert Fraction(down) < bounds(ball)[0]
    assert up == pytest.approx(high, abs=1e-12 * size)
    assert down == pytest.approx(low, abs=1e-12 * size)
    largest, least = ball.abs_upper(), ball.abs_lower()
    assert float(largest.rad) == float(least.rad) == 0.0
    assert Fraction(float(largest.mid)) > max(-bounds(ball)[0], bounds(ball)[1])
    assert float(largest.mid) == pytest.approx(size, rel=1e-12)
    smallest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    assert 0.0 <= float(least.mid) <= smallest
    assert float(least.mid) == pytest.approx(smallest, abs=1e-12 * size)


def test_ends_of_points_leave_one_last_place() -> None:
    one = Balls.exact(1.0)
    assert float(one.upper()) == 1.0 + UNIT
    assert float(one.lower()) == -(1.0 * -1.0 + UNIT) or float(one.lower()) == 1.0 - UNIT
    assert float(one.abs_upper().mid) == MORE
    assert float(one.abs_lower().mid) == 1.0 - UNIT
    zero = Balls.exact(0.0)
    assert float(zero.upper()) == LEAST
    assert float(zero.lower()) == -LEAST
    assert float(zero.abs_upper().mid) == LEAST
    assert float(zero.abs_lower().mid) == 0.0


def test_limit_is_below_all() -> None:
    balls = Balls(np.array([1.0, 2.0]), np.array([0.5, 0.25]))
    assert balls < 2.2500001
    assert not balls < 2.25
    assert not balls < 2.0
    assert not balls < float(np.max(balls.upper()))


@pytest.mark.parametrize("pair", ENDS)
def test_square(pair: tuple[float, float]) -> None:
    found = between(pair).squared()
    squares = [x * x for x in inner(pair)]
    low, high = bounds(found)
    assert low <= (0 if pair[0] <= 0.0 <= pair[1] else min(squares))
    assert high >= max(squares)
    size = float(max(squares))
    assert float(high) == pytest.approx(size, rel=1e-11)
    assert float(low) == pytest.approx(
        0.0 if pair[0] <= 0.0 <= pair[1] else float(min(squares)), abs=1e-11 * size
    )


def test_square_of_a_point_is_widened_by_little() -> None:
    found = Balls.exact(3.0).squared()
    low, high = bounds(found)
    assert float(low) == pytest.approx(9.0 * (1 - 2 * 2.0**-52) / MORE, rel=1e-15, abs=0.0)
    assert float(high) == pytest.approx(9.0 * MORE**3, rel=1e-15, abs=0.0)
    assert float(bounds(Balls.exact(0.0).squared())[1]) >= LEAST
    assert float(Balls.between(0.0, 0.0).rad) == LEAST
    assert float(Balls.between(1.0, 4.0).rad) == 1.5 * MORE


@pytest.mark.parametrize("pair", [(0.1, 0.3), (-7.0, -0.5), (0.25, 40.0), (3.0, 3.0)])
def test_reciprocal(pair: tuple[float, float]) -> None:
    low, high = bounds(between(pair).reciprocal())
    values = [1 / x for x in inner(pair)]
    assert low <= min(values)
    assert max(values) <= high
    assert float(high - low) <= float(max(values) - min(values)) + 1e-11 * float(
        max(map(abs, values))
    )
    # The roundings of both quotients: at most a few last places, at least one
    # beyond those of the ends.
    third = Balls.exact(3.0).reciprocal()
    assert 2 * UNIT / 3 <= float(third.rad) <= 4 * UNIT / 3


def test_widened_and_chosen() -> None:
    balls = Balls(np.array([1.0, 2.0]), np.array([0.5, 0.25]))
    wide = balls.widened(np.array([0.125, 1.0]))
    np.testing.assert_array_equal(wide.mid, balls.mid)
    np.testing.assert_array_equal(wide.rad, np.array([0.625, 1.25]) * MORE)
    second = balls.at([1])
    assert (second.mid[0], second.rad[0]) == (2.0, 0.25)


def test_library_balls_are_taken_with_their_radius() -> None:
    plain = Balls.of(arb(0.1))
    assert (float(plain.mid), float(plain.rad)) == (0.1, 0.0)
    third = Balls.of(arb(1) / 3)
    assert bounds(third)[0] < Fraction(1, 3) < bounds(third)[1]
    assert UNIT / 3 <= float(third.rad) <= 1.01 * UNIT / 3
    wide = Balls.of(arb(-2, 0.5))
    assert float(wide.rad) == pytest.approx(
        float(arb(-2, 0.5).rad()) * MORE + 2.0 * UNIT, rel=1e-15
    )
    inexact = arb(1) + arb(2) ** -60
    assert float(Balls.of(inexact).rad) == UNIT
    assert Balls.of(third) is third
    assert float(Balls.of(2).mid) == 2.0


@pytest.mark.parametrize(
    ("low", "high"), [(1.0, 1.0), (0.1, 0.3), (1.0, 1.0 + 2.0**-52), (-0.3, 0.7), (-0.7, -0.3)]
)
def test_an_interval_holds_its_ends_and_what_rounds_to_them(low: float, high: float) -> None:
    """Half the width and 1e-15 of the middle, neither half nor twice of it."""
    half, middle = (Fraction(high) - Fraction(low)) / 2, abs(Fraction(high) + Fraction(low)) / 2
    radius = Fraction(float(Expansion(low, high).radius))
    extra = Fraction(1, 10**15) * (middle + half)
    assert (
        half + Fraction(9, 10) * extra
        <= radius
        <= half + Fraction(3, 2) * extra + Fraction(1, 10**16) * half
    )
