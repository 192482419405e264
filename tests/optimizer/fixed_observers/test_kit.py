"""Pieces of the observers in integers against double precision."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.transforms import Pair
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    TOP,
    common_scale,
    odd_polynomial,
    polynomial,
    quotient,
    sine_of_angle,
)
from dqforge.optimizer.steps.integer_arithmetic import Integers

NUMBERS = Integers()
RNG = np.random.default_rng(20_261_122)


def test_the_sine_has_all_its_digits_near_zero_and_that_of_the_length_elsewhere() -> None:
    size = 2.0 ** RNG.uniform(22.0, 30.9, 20_000)
    angle = RNG.uniform(-1.5, 1.5, 20_000) * 10.0 ** RNG.uniform(-6.0, 0.0, 20_000)
    direction = RNG.uniform(-np.pi, np.pi, 20_000)
    across = np.rint(size * np.sin(angle)).astype(np.int64)
    vector = Pair(
        np.rint(size * np.cos(direction)).astype(np.int64),
        np.rint(size * np.sin(direction)).astype(np.int64),
    )
    found = sine_of_angle(NUMBERS, across, vector, 1)
    exact = across / np.hypot(vector.x, vector.y) * ONE
    # The length is known to two codes of 16 bits.
    allowed = np.abs(exact) * 2.5 / (size / 2**16) + 2.0
    assert np.all(np.abs(found - exact) <= allowed)
    assert np.all(found[across == 0] == 0)


def test_a_short_vector_counts_by_its_floor() -> None:
    vector = Pair(np.array([2**20]), np.array([0]))
    floor = 1024
    found = sine_of_angle(NUMBERS, np.array([2**20]), vector, floor)
    assert found[0] == pytest.approx(2**20 / (floor * 2**16) * ONE, abs=2.0)


def test_a_quotient_rounds_towards_zero_and_saturates() -> None:
    a = RNG.integers(-TOP, TOP, 5000)
    b = RNG.integers(1, TOP, 5000)
    found = quotient(NUMBERS, "q", a, b, 20)
    exact = np.array(
        [
            int(abs(x) * 2**20 // y) * (1 if x >= 0 else -1)
            for x, y in zip(a.tolist(), b.tolist(), strict=True)
        ]
    )
    assert np.array_equal(found, np.clip(exact, -TOP, TOP))
    assert quotient(NUMBERS, "q", np.array([TOP]), np.array([0]), 20)[0] == TOP


def test_polynomials_hold_their_values() -> None:
    rows = [[0.9, -0.3, 0.02], [0.001, 0.2, -0.05]]
    made = common_scale("test", rows, 30)
    x = RNG.uniform(-1.0, 1.0, 2000)
    codes = np.rint(x * TOP).astype(np.int64)
    square = (codes * codes + 2**30) >> 31
    for row, coefficients in zip(made.rows, rows, strict=True):
        exact = sum(c * x ** (2 * k) for k, c in enumerate(coefficients))
        assert polynomial(NUMBERS, row, square) * 2.0**-made.shift == pytest.approx(exact, abs=1e-8)
        odd = odd_polynomial(NUMBERS, row, square, codes) * 2.0**-made.shift
        assert odd == pytest.approx(x * exact, abs=1e-8)


def test_polynomials_without_a_scale_are_refused() -> None:
    with pytest.raises(NoSolutionError, match="use other bases"):
        common_scale("factor", [[2.0**31]], 30)
