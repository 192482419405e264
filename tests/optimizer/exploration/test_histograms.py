"""Histograms that grow with what comes."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.exploration.acceptance import Histogram, empty_histogram


def spread(kind: str, count: int, random: np.random.Generator) -> FloatArray:
    values = random.standard_normal(count)
    return {
        "normal": values,
        "skew": np.exp(3.0 * values),
        "narrow": 800.0 + 1e-9 * values,
        "equal": np.full(count, -3.0),
        "rising": np.arange(count) * random.random(),
    }[kind]


def parts(kind: str) -> list[FloatArray]:
    random = np.random.default_rng(6)
    return [spread(kind, int(random.integers(1, 400)), random) for _ in range(40)]


def gathered(pieces: list[FloatArray]) -> Histogram:
    found = empty_histogram()
    for piece in pieces:
        found = found.plus(piece)
    return found


@pytest.mark.parametrize("kind", ["normal", "skew", "narrow", "equal", "rising"])
def test_every_value_is_counted_where_it_lies(kind: str) -> None:
    pieces = parts(kind)
    whole, found = np.concatenate(pieces), gathered(pieces)
    assert found.rows == whole.size
    assert (found.least, found.largest) == (whole.min(), whole.max())
    resolution = max((found.largest - found.least) / 120.0, np.spacing(abs(found.largest)) * 4)
    for share in (0.0, 0.01, 0.25, 0.5, 0.9, 0.999, 1.0):
        near = found.quantile(share)
        # Between two bins no value lies; the share that lies below is what counts there.
        below = np.mean(whole < near - resolution)
        above = np.mean(whole <= near + resolution)
        assert below <= share <= above
    edges, counts = found.coarser(30)
    assert counts.sum() == whole.size
    assert counts.size <= 30
    assert edges.size == counts.size + 1
    for place in range(counts.size):
        inside = (whole >= edges[place]) & (whole < edges[place + 1])
        if found.width > 1e-6:
            assert abs(int(np.sum(inside)) - counts[place]) <= 2


def test_rows_without_a_value_are_told_apart() -> None:
    found = gathered([np.array([np.nan, 1.0]), np.array([np.inf, np.nan]), np.array([2.0])])
    assert found.rows == 2
    assert found.unknown == 3
    assert np.isnan(empty_histogram().quantile(0.5))
    assert empty_histogram().coarser(30)[1].size == 0


def test_the_same_parts_give_the_same_bins() -> None:
    one, other = gathered(parts("skew")), gathered(parts("skew"))
    assert (one.low, one.width) == (other.low, other.width)
    assert np.array_equal(one.counts, other.counts)
