"""The float32 model: fused multiply-add against exact rational arithmetic,
Horner against plain loops.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dqforge.optimizer.curves.single_precision import (
    PiecewisePolynomial,
    SinglePolynomial,
    compiled,
    fused_multiply_add,
    multiply_add,
)

floats = st.floats(min_value=-(2.0**40), max_value=2.0**40, width=32, allow_subnormal=False)


def nearest_float(exact: Fraction) -> np.float32:
    """Round an exact number to float32 by comparing with its two neighbours; ties to even."""
    guess = np.float32(float(exact))
    candidates = [
        np.nextafter(guess, np.float32(-np.inf)),
        guess,
        np.nextafter(guess, np.float32(np.inf)),
    ]
    distances = [abs(Fraction(float(candidate)) - exact) for candidate in candidates]
    least = min(distances)
    tied = [c for c, d in zip(candidates, distances, strict=True) if d == least]
    return next((c for c in tied if int(c.view(np.uint32)) % 2 == 0), tied[0])


@settings(max_examples=500, deadline=None)
@given(a=floats, b=floats, c=floats)
def test_fused_multiply_add_rounds_once(a: float, b: float, c: float) -> None:
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    if exact != 0 and not 2.0**-120 < abs(exact) < 2.0**120:
        return
    args = (np.array([value], dtype=np.float32) for value in (a, b, c))
    assert fused_multiply_add(*args)[0] == nearest_float(exact)


def test_fused_multiply_add_where_two_roundings_would_err() -> None:
    """(1 + 2^-23)(1 - 2^-23) - 1 = -2^-46 exactly; a rounded product loses it all."""
    a, b, c = (
        np.array([value], dtype=np.float32) for value in (1.0 + 2.0**-23, 1.0 - 2.0**-23, -1.0)
    )
    assert fused_multiply_add(a, b, c)[0] == np.float32(-(2.0**-46))
    assert multiply_add(a, b, c)[0] == 0.0


@pytest.mark.parametrize(
    ("sign", "tail", "expected"), [(1, -1, 0), (1, 1, 1), (-1, 1, 0), (-1, -1, 1)]
)
def test_fused_multiply_add_keeps_what_a_rounding_to_double_would_lose(
    sign: int, tail: int, expected: int
) -> None:
    """24929 * 673 = 2^24 + 1, so that the product is halfway between two floats;
    2^-80 decides between them.
    """
    a, b = (
        np.array([sign * 24929.0 * 2.0**-12], np.float32),
        np.array([673.0 * 2.0**-12], np.float32),
    )
    c = np.array([tail * 2.0**-80], np.float32)
    assert Fraction(float(a[0])) * Fraction(float(b[0])) == sign * (1 + Fraction(1, 2**24))
    assert fused_multiply_add(a, b, c)[0] == np.float32(sign * (1.0 + expected * 2.0**-23))


@pytest.mark.parametrize("fused", [False, True])
def test_horner_equals_a_scalar_loop(fused: bool) -> None:
    generator = np.random.default_rng(3)
    piecewise = PiecewisePolynomial(np.array([0.0, 1.5, 4.0]), generator.normal(size=(2, 4)))
    polynomial = SinglePolynomial.from_double(piecewise)
    muladd = fused_multiply_add if fused else multiply_add
    torque = np.linspace(0.0, 4.0, 101, dtype=np.float32)
    expected = []
    for t in torque:
        row = 0 if t < np.float32(1.5) else 1
        c = polynomial.coefficients[row]
        x = np.array([t - polynomial.starts[row]], dtype=np.float32)
        value = np.array([c[3]])
        for power in (2, 1, 0):
            value = muladd(value, x, np.array([c[power]]))
        expected.append(value[0])
    np.testing.assert_array_equal(
        polynomial.evaluate(torque, compiled(fused=fused)), np.array(expected)
    )
    np.testing.assert_allclose(
        polynomial.evaluate(torque, compiled(fused=fused)),
        piecewise(torque.astype(float)),
        atol=1e-4,
    )
