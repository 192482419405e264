"""Wilson's interval, against scipy and by what it promises."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import binomtest

from dqforge.optimizer.exploration.acceptance import Share, wilson


@pytest.mark.parametrize(("met", "count"), [(0, 10), (3, 7), (10, 10), (79_470, 100_000)])
@pytest.mark.parametrize("confidence", [0.9, 0.95, 0.99])
def test_the_interval_is_that_of_scipy(met: int, count: int, confidence: float) -> None:
    expected = binomtest(met, count).proportion_ci(confidence, method="wilson")
    low, high = wilson(met, count, confidence)
    assert low == pytest.approx(expected.low, abs=1e-12)
    assert high == pytest.approx(expected.high, abs=1e-12)


def test_the_worked_example_has_the_interval_that_was_found() -> None:
    low, high = Share(79_470, 100_000).interval
    assert (round(100 * low, 2), round(100 * high, 2)) == (79.22, 79.72)


def test_no_failure_of_n_is_not_a_hundred_percent() -> None:
    low, high = Share(50, 50).interval
    assert high == 1.0
    assert 0.9 < low < 0.94
    none = Share(0, 50).interval
    assert none[0] == 0.0
    assert none[1] == pytest.approx(1.0 - low)


def test_no_rows_say_nothing() -> None:
    assert math.isnan(Share(0, 0).value)
    assert Share(0, 0).interval == (0.0, 1.0)


def test_shares_of_parts_are_those_of_the_whole() -> None:
    assert Share(3, 10).plus(Share(4, 5)) == Share(7, 15)


def test_the_interval_holds_the_true_share_as_often_as_it_says() -> None:
    random = np.random.default_rng(1)
    met = random.binomial(200, 0.93, 4000)
    inside = [low <= 0.93 <= high for low, high in (wilson(int(k), 200) for k in met)]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)
