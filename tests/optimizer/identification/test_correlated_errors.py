"""Errors of regressions whose residuals are not independent."""

from __future__ import annotations

import numpy as np
import pytest
from bench_files import slow_noise

from dqforge.optimizer.identification.correlated_errors import (
    averaged,
    correlation_time,
    mean_of,
    regress,
    separable,
)

ONE = np.zeros(2000, dtype=np.intp)


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_correlation_time_of_first_order_noise(memory: float) -> None:
    rng = np.random.default_rng(3)
    found = np.mean([correlation_time(slow_noise(rng, 2000, memory, 1.0), ONE) for _ in range(20)])
    assert found == pytest.approx((1.0 + memory) / (1.0 - memory), rel=0.15)


@pytest.mark.parametrize("memory", [0.0, 0.6, 0.9])
def test_standard_deviations_are_those_of_repeated_trials(memory: float) -> None:
    rng = np.random.default_rng(5)
    rows = np.column_stack([np.ones(2000), slow_noise(rng, 2000, 0.9, 1.0)])
    trials, said = [], []
    for _ in range(200):
        fit = regress(rows, slow_noise(rng, 2000, memory, 1.0), ONE)
        trials.append(fit.coefficients)
        said.append(np.sqrt(np.diag(fit.covariance)))
    assert np.mean(said, axis=0) == pytest.approx(np.std(trials, axis=0), rel=0.15)


def test_rows_far_off_count_little() -> None:
    rng = np.random.default_rng(7)
    rows = np.column_stack([np.ones(2000), rng.normal(size=2000)])
    values = rows @ [1.0, 2.0] + rng.normal(0.0, 0.1, 2000)
    values[:40] += 50.0
    fit = regress(rows, values, ONE)
    assert fit.coefficients == pytest.approx([1.0, 2.0], abs=0.02)


def test_series_are_not_tied_to_each_other() -> None:
    values = np.concatenate([np.full(1000, 1.0), np.full(1000, -1.0)])
    halves = np.repeat([0, 1], 1000)
    alternating = np.tile([1.0, -1.0], 1000)
    assert correlation_time(alternating, halves) == 1.0
    assert correlation_time(values, halves) > 400.0


def test_columns_that_say_the_same() -> None:
    ramp = np.linspace(0.0, 1.0, 50)
    rows = np.column_stack([ramp, 3.0 * ramp, ramp**2])
    assert separable(rows).tolist() == [False, False, True]


def test_terms_that_are_not_there_have_no_probability() -> None:
    rng = np.random.default_rng(9)
    rows = rng.normal(size=(2000, 4))
    values = rows @ [1.0, 0.5, 0.0, 0.0] + rng.normal(size=2000)
    found = averaged(rows, [0], values, ONE)
    assert found.included[1] > 0.99
    assert found.included[2:].max() < 0.5
    assert found.places[:2] == (0, 1)


def test_mean_of_slow_rows() -> None:
    rng = np.random.default_rng(11)
    values = 3.0 + slow_noise(rng, 2000, 0.9, 1.0)
    mean, sigma, _ = mean_of(values)
    # The standard deviation of the mean is sqrt(19) times that of independent rows.
    assert sigma == pytest.approx(np.sqrt(19.0 / 2000.0), rel=0.3)
    assert abs(mean - 3.0) < 4.0 * sigma


def test_tall_arrays_as_the_direct_sums() -> None:
    rng = np.random.default_rng(5)
    count = 43_217
    rows = np.column_stack([rng.normal(1.0, 1.0, (count, 3)), 1e-6 * rng.normal(size=count)])
    series = np.repeat([0, 1], [30_000, count - 30_000])
    values = rows @ [1.0, -2.0, 0.5, 3e6] + slow_noise(rng, count, 0.9, 0.1)
    found = regress(rows, values, series, robust=False)
    direct = np.linalg.lstsq(rows * [1.0, 1.0, 1.0, 1e6], values, rcond=None)[0]
    assert np.allclose(found.coefficients, direct * [1.0, 1.0, 1.0, 1e6], rtol=1e-11)
    left = found.residuals
    parts = left[:30_000], left[30_000:]
    products = [
        sum(float(part[lag:] @ part[: part.size - lag]) for part in parts) for lag in range(400)
    ]
    pairs = [products[lag] + products[lag + 1] for lag in range(1, 399, 2)]
    last = next(place for place, pair in enumerate(pairs) if pair <= 0.0)
    assert correlation_time(left, series) == pytest.approx(
        1.0 + 2.0 * sum(pairs[:last]) / products[0], rel=1e-9
    )
