"""Polynomials of one axis's loop against its frequency response, and their Bernstein
coefficients against their values.
"""

from __future__ import annotations

import numpy as np
import pytest
from flint import fmpq

from dqforge.optimizer.axis_margins import AxisGains, Terms, bases, rational, tabled


def value(terms: Terms, c: float, a: float, gamma: float) -> float:
    return sum(float(factor) * c**i * a**j * gamma**k for (i, j, k), factor in terms.items())


@pytest.mark.parametrize("seed", range(5))
def test_squares_are_those_of_the_frequency_response(seed: int) -> None:
    generator = np.random.default_rng(seed)
    p, q = generator.uniform(0.05, 0.6), generator.uniform(0.001, 0.2)
    a, gamma, c = generator.uniform(0.6, 1.1), generator.uniform(0.2, 2.0), generator.uniform(-1, 1)
    gains = AxisGains(rational(float(p)), rational(float(q)))
    z = c + 1j * np.sqrt(1.0 - c * c)
    opened, control = z * (z - 1.0) * (z - a), gamma * ((p + q) * z - p)
    assert value(gains.open_squared(), c, a, gamma) == pytest.approx(abs(opened) ** 2)
    assert value(gains.control_squared(), c, a, gamma) == pytest.approx(abs(control) ** 2)
    assert value(gains.closed_squared(), c, a, gamma) == pytest.approx(abs(opened + control) ** 2)


def test_bernstein_coefficients_hold_the_values_of_a_cell() -> None:
    gains = AxisGains(fmpq(3, 10), fmpq(1, 20))
    terms = gains.closed_squared()
    sides = ((-0.3, 0.2), (0.9, 0.98), (0.7, 1.1))
    cell = [(rational(low), rational(high)) for low, high in sides]
    left, right = bases(*cell)
    coefficients = [float(entry) for entry in (left * tabled(terms) * right).entries()]
    generator = np.random.default_rng(1)
    values = [value(terms, *generator.uniform(*np.transpose(sides))) for _ in range(500)]
    assert min(coefficients) <= min(values)
    assert max(values) <= max(coefficients)
    corners = [value(terms, c, a, g) for c in sides[0] for a in sides[1] for g in sides[2]]
    for corner in corners:
        assert min(abs(corner - entry) for entry in coefficients) < 1e-12
