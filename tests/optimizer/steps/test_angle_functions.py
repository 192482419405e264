"""Angle functions and transforms in single precision, against their definitions in double."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.reports.c_code.harness import PI, rotation, small_rotation, turned, wrap

ROUNDING = 2.0**-24  # Half a unit in the last place of numbers about one.

# Rows of phases a, b, c: what alpha and beta are of them (amplitude-invariant).
CLARKE = np.array([[2.0, -1.0, -1.0], [0.0, np.sqrt(3.0), -np.sqrt(3.0)]]) / 3.0


def test_rotation_is_within_its_stated_error() -> None:
    theta = np.linspace(-PI, PI, 2_000_001).astype(np.float32)
    cosine, sine = rotation(theta)
    exact = theta.astype(np.float64)
    assert np.max(np.abs(cosine - np.cos(exact))) < 1.2e-7
    assert np.max(np.abs(sine - np.sin(exact))) < 1.2e-7
    assert cosine.dtype == sine.dtype == np.float32


@pytest.mark.parametrize("most", [0.4, 9.0])
def test_the_small_rotation_is_within_the_error_of_the_other(most: float) -> None:
    theta = np.linspace(-most, most, 200_001).astype(np.float32)
    cosine, sine = small_rotation(theta)
    exact = theta.astype(np.float64)
    assert np.max(np.abs(cosine - np.cos(exact))) < 2e-7
    assert np.max(np.abs(sine - np.sin(exact))) < 2e-7


def test_a_rotation_turned_on_has_the_sum_of_the_angles() -> None:
    x, y = np.random.default_rng(2).uniform(-3.0, 3.0, (2, 10_000)).astype(np.float32)
    cosine, sine = turned(rotation(x), rotation(y))
    both = x.astype(np.float64) + y
    assert np.max(np.abs(cosine - np.cos(both))) < 4e-7
    assert np.max(np.abs(sine - np.sin(both))) < 4e-7


def test_wrap_keeps_the_angle_and_the_range() -> None:
    theta = np.random.default_rng(4).uniform(-60_000.0, 60_000.0, 100_000).astype(np.float32)
    angle = wrap(theta)
    assert np.all((angle >= -PI) & (angle < PI))
    away = (angle.astype(np.float64) - theta.astype(np.float64) + np.pi) % (2.0 * np.pi) - np.pi
    assert np.max(np.abs(away)) < 2e-5  # n times the rounding of the second part of 2 pi
    inside = theta / np.float32(60_000.0)
    np.testing.assert_array_equal(wrap(inside), inside)


def test_what_is_no_angle_counts_as_none() -> None:
    none = np.array([np.nan, np.inf, -np.inf, 65536.0, -65536.0, 3e38], dtype=np.float32)
    np.testing.assert_array_equal(wrap(none), np.zeros(6))
    for kind in (rotation, small_rotation):
        with np.errstate(over="ignore"):  # of the square, which decides what is small
            cosine, sine = kind(none)
        np.testing.assert_array_equal(cosine, np.ones(6))
        np.testing.assert_array_equal(sine, np.zeros(6))


def _vectors(count: int) -> SingleArray:
    return np.random.default_rng(count).normal(size=(count, 5_000)).astype(np.float32)


def _near(found: object, matrix: NDArray[Any], x: SingleArray, roundings: float) -> None:
    """Within so many roundings of the largest sum that the terms can have."""
    exact = np.einsum("ij...,j...->i...", matrix, x.astype(np.float64))
    most = np.einsum("ij...,j...->i...", np.abs(matrix), np.abs(x.astype(np.float64)))
    assert np.all(np.abs(np.array(found) - exact) <= roundings * ROUNDING * most)


def test_clarke_is_its_matrix_and_the_inverse_its_right_inverse() -> None:
    phases, vector = _vectors(3), _vectors(2)
    _near(SINGLE.clarke(tuple(phases)), CLARKE, phases, 5.0)  # type: ignore[arg-type]
    inverse = np.linalg.pinv(CLARKE)
    np.testing.assert_allclose(inverse.sum(axis=0), 0.0, atol=1e-15)
    _near(SINGLE.clarke_inverse((vector[0], vector[1])), inverse, vector, 4.0)


def test_park_turns_by_the_angle_and_the_inverse_back() -> None:
    vector, angle = _vectors(2), np.linspace(-3.0, 3.0, 5_000)
    turn = np.cos(angle).astype(np.float32), np.sin(angle).astype(np.float32)
    back = np.array([[turn[0], -turn[1]], [turn[1], turn[0]]]).astype(np.float64)
    x = vector[0], vector[1]
    _near(SINGLE.park(x, turn), back.swapaxes(0, 1), vector, 3.0)
    _near(SINGLE.park_inverse(x, turn), back, vector, 3.0)
