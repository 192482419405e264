"""Fits of columns of curves by the methods of the single path, and their coefficients.

Minimax fits by reweighting, least squares with the weights of Clenshaw and Curtis; both as
`local_series` has them.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import FitMethod
from dqforge.optimizer.curves.piecewise import power_of_series
from dqforge.optimizer.machine_batch.local_series import (
    SeriesSpace,
    minimax_fit,
    series_values,
    weighted_fit,
)

# Methods that fit columns; interpolation is left to the single path.
BATCH_METHODS: tuple[FitMethod, ...] = ("minimax", "least-squares")


def segment_points(nodes: FloatArray, edges: FloatArray) -> FloatArray:
    """Points of every segment, shape (S, P, N), for nodes in [-1, 1] and edges (S + 1, N)."""
    half = 0.5 * np.diff(edges, axis=0)[:, np.newaxis]
    return edges[:-1, np.newaxis] + half * (nodes[:, np.newaxis] + 1.0)


def fit_columns(
    space: SeriesSpace, method: FitMethod, widths: FloatArray, values: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Series (S, n + 1, N) of curves, and what the method makes small, shape (N,).

    Args:
        space: Admissible series.
        method: ``minimax``, whose cost is the largest error at the nodes, or ``least-squares``,
            whose cost is the integral of the squared error.
        widths: Widths of the segments, shape (S, N).
        values: Curves at the nodes of the segments, shape (S, P, N).
    """
    if method == "minimax":
        return minimax_fit(space, values)
    weights = 0.5 * widths[:, np.newaxis] * _integral_weights(space.nodes.size)[:, np.newaxis]
    series = weighted_fit(space, weights, values)
    # Once more on what is left, whose rounding is a share of the error and not of the curve.
    series = series + weighted_fit(space, weights, values - series_values(space, series))
    squares = weights * np.square(values - series_values(space, series))
    cost = np.zeros(values.shape[2])
    for part in squares.reshape(-1, values.shape[2]):
        cost += part
    return series, cost


@cache
def _integral_weights(count: int) -> FloatArray:
    """Weights of Clenshaw and Curtis at the extrema of a Chebyshev polynomial, shape (count,)."""
    last = count - 1
    weights = []
    for place in range(count):
        total = 1.0
        for k in range(1, last // 2 + 1):
            part = 1.0 if 2 * k == last else 2.0
            total -= part * math.cos(2.0 * k * place * math.pi / last) / (4.0 * k * k - 1.0)
        weights.append((1.0 if place in (0, last) else 2.0) / last * total)
    return np.array(weights)


def local_powers(series: FloatArray, widths: FloatArray) -> FloatArray:
    """Ascending powers of t - edge from Chebyshev series, both of shape (S, n + 1, N).

    Args:
        series: Series on each segment.
        widths: Widths of the segments, shape (S, N).
    """
    degree = series.shape[1] - 1
    found, scale = np.zeros_like(series), np.ones_like(widths)
    for power in range(degree + 1):
        row = power_of_series(degree, power)
        for order in range(power, degree + 1):
            found[:, power] += row[order] * series[:, order]
        found[:, power] /= scale
        scale = scale * (0.5 * widths)
    return found


def power_values(coefficients: FloatArray, edges: FloatArray, argument: FloatArray) -> FloatArray:
    """Values of piecewise polynomials at points that are sorted into segments, shape (S, P, N).

    Args:
        coefficients: Ascending powers of t - edge, shape (S, n + 1, N).
        edges: Edges, shape (S + 1, N).
        argument: Points, shape (S, P, N), of each segment its own.
    """
    local = argument - edges[:-1, np.newaxis]
    value = np.broadcast_to(coefficients[:, -1, np.newaxis], local.shape)
    for power in range(coefficients.shape[1] - 2, -1, -1):
        value = value * local + coefficients[:, power, np.newaxis]
    return np.asarray(value)
