"""Linear regression with errors that hold for correlated residuals.

The textbook formula takes every row for independent. Rows of a log are not: what the model leaves
out changes slowly, and the errors of the textbook are two to eighteen times too small. Here the
covariance is the sandwich of Newey and West (Econometrica 55, 1987) within each series of rows, or
that of clusters where rows come in few groups; the degrees of freedom are those of the effective
number of rows.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

# Huber's constant: 95 % of the efficiency of least squares where there are no outliers.
_HUBER = 1.345
# The median of |x| of a normal distribution in its standard deviations.
_MAD = 0.6745
_ROUNDS = 50
_SETTLED = 1e-10
# Columns whose share that is not in the others falls below this cannot be told from them.
_LEAST_OWN = 1e-5
# A term is taken where it gains this much of BIC, and where its probability is that of such a gain:
# strong evidence by Kass and Raftery (Journal of the American Statistical Association 90, 1995).
BIC_GAIN = 6.0
SUPPORTED = 0.95

Groups = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Regression:
    """Coefficients, shape (K,), their covariance, weighted residuals and what they rest on.

    ``effective`` is the number of rows that independent residuals would have for the same errors;
    ``own`` the share of each column that is not in the others, shape (K,).
    """

    coefficients: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    weights: FloatArray
    effective: float
    own: FloatArray

    @property
    def rms(self) -> float:
        """R.m.s. value of the residuals without weights, for the degrees of freedom."""
        free = max(self.residuals.size - self.coefficients.size, 1)
        return float(np.sqrt(self.residuals @ self.residuals / free))

    @property
    def freedom(self) -> float:
        """Effective degrees of freedom."""
        return max(self.effective - self.coefficients.size, 1.0)


# Tall arrays are read by parts of this many rows, each by blocks: no copy is as large as they are.
_PART = 100_000
_BLOCK = 1_000


def _parts(count: int) -> Iterator[slice]:
    return (slice(begin, begin + _PART) for begin in range(0, count, _PART))


def _condensed(rows: FloatArray) -> FloatArray:
    """A few rows with the products of the columns of a tall array, shape (N, K): the triangular
    factors of its blocks.
    """
    columns = rows.shape[1]
    while rows.shape[0] > max(20 * _BLOCK, _BLOCK * columns):
        found = []
        for part in (rows[place] for place in _parts(rows.shape[0])):
            whole = part.shape[0] // _BLOCK * _BLOCK
            blocks = part[:whole].reshape(-1, _BLOCK, columns)
            found += [np.asarray(np.linalg.qr(blocks, mode="r")).reshape(-1, columns), part[whole:]]
        rows = np.concatenate(found)
    return rows


def _with_values(
    rows: FloatArray, values: FloatArray, root: FloatArray | None = None
) -> FloatArray:
    """Columns and values as of `_condensed`, rows times ``root``, shape (M, K + 1)."""
    found = []
    for place in _parts(values.size):
        both = np.column_stack([rows[place], values[place]])
        found.append(_condensed(both if root is None else both * root[place, None]))
    return np.concatenate(found)


def _solved(rows: FloatArray, values: FloatArray, root: FloatArray | None = None) -> FloatArray:
    """Least squares of values by columns, each row times ``root``, shape (K,)."""
    both = _with_values(rows, values, root)
    size = np.linalg.norm(both[:, :-1], axis=0)
    size[size <= 0.0] = 1.0
    return np.asarray(np.linalg.lstsq(both[:, :-1] / size, both[:, -1], rcond=None)[0] / size)


def own_shares(rows: FloatArray) -> FloatArray:
    """Share of each column's sum of squares that is not in the others, shape (K,)."""
    rows = _condensed(rows)
    size = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(size > 0.0, size, 1.0)
    found = np.zeros(rows.shape[1])
    for column in range(rows.shape[1]):
        others = np.delete(scaled, column, axis=1)
        left = scaled[:, column]
        if others.shape[1]:
            left = left - others @ np.linalg.lstsq(others, left, rcond=None)[0]
        found[column] = left @ left
    return found


def separable(rows: FloatArray) -> NDArray[np.bool_]:
    """Whether each column can be told from the others, shape (K,)."""
    return own_shares(rows) > _LEAST_OWN


def regress(
    rows: FloatArray,
    values: FloatArray,
    series: Groups,
    *,
    robust: bool = True,
) -> Regression:
    """Fit ``values`` by the columns of ``rows``.

    Args:
        rows: Shape (N, K), of full rank.
        values: Shape (N,).
        series: Label of each row's series, shape (N,); rows of a series follow each other in time.
        robust: Whether rows far off are given less weight (Huber).
    """
    size = np.sqrt(np.einsum("nk,nk->k", rows, rows))
    weights = np.ones(values.size)
    found = _solved(rows, values)
    for _ in range(_ROUNDS if robust else 0):
        residuals = values - rows @ found
        spread = np.median(np.abs(residuals)) / _MAD
        if spread <= 0.0:
            break
        weights = np.minimum(1.0, _HUBER * spread / np.maximum(np.abs(residuals), 1e-300))
        again = _solved(rows, values, np.sqrt(weights))
        step, whole = np.abs(again - found) * size, np.abs(again) * size
        settled = np.max(step) <= _SETTLED * np.max(whole)
        found = again
        if settled:
            break
    residuals = values - rows @ found
    bread = np.linalg.inv(_curvature(rows, weights) / np.outer(size, size))
    time = correlation_time(residuals, series)
    count = values.size
    effective = count / time
    meat = long_run(rows, weights * residuals, size, series) * count / max(count - found.size, 1)
    covariance = bread @ meat @ bread / np.outer(size, size)
    return Regression(found, covariance, residuals, weights, effective, own_shares(rows))


def _curvature(rows: FloatArray, weights: FloatArray) -> FloatArray:
    """Second derivative of Huber's sum: rows beyond his constant push, but do not hold.

    Where too few rows are within it for all coefficients, that of the weighted squares.
    """
    within = weights >= 1.0
    found = _products(rows, within)
    size = np.sqrt(np.maximum(np.diag(found), 1e-300))
    enough = np.count_nonzero(within) > 2 * rows.shape[1]
    if enough and np.linalg.cond(found / np.outer(size, size)) < _WORST_CONDITION:
        return found
    return _products(rows, weights)


def _products(rows: FloatArray, weights: NDArray[Any]) -> FloatArray:
    """Weighted sums of products of the columns, shape (K, K)."""
    found = np.zeros((rows.shape[1], rows.shape[1]))
    for place in _parts(rows.shape[0]):
        found += rows[place].T @ (rows[place] * weights[place, None])
    return found


_WORST_CONDITION = 1e12


def long_run(
    rows: FloatArray, residuals: FloatArray, size: FloatArray, series: Groups
) -> FloatArray:
    """Middle of the sandwich of columns in units of ``size`` with weighted residuals, shape (K, K),
    over lags with Bartlett's weights, within each series.

    The scores are made white by an autoregression of first order each before, and the result is
    coloured again (Andrews and Monahan, Econometrica 60, 1992): without that, slow residuals make
    95 % intervals that hold the truth in 85 of 100 cases.
    """
    series_of = [np.flatnonzero(series == label) for label in np.unique(series)]

    def scores() -> Iterator[FloatArray]:
        for places in series_of:
            part = rows[places]
            part *= residuals[places, None]
            part /= size
            yield part

    now, whole = np.zeros(size.size), np.zeros(size.size)
    for part in scores():
        now += np.einsum("nk,nk->k", part[1:], part[:-1])
        # Both ends count half, as of Burg: else a single score at the end makes the whole slow.
        whole += np.einsum("nk,nk->k", part[:-1], part[:-1])
        whole += np.einsum("nk,nk->k", part[1:], part[1:])
    slow = np.clip(2.0 * now / np.maximum(whole, 1e-300), -_SLOWEST, _SLOWEST)
    meat = np.zeros((size.size, size.size))
    for part in scores():
        if part.shape[0] < 2:
            meat += part.T @ part * np.outer(1.0 - slow, 1.0 - slow)
            continue
        white = part[1:] - slow * part[:-1]
        white *= np.sqrt(part.shape[0] / white.shape[0])
        meat += white.T @ white
        lags = int(min(4.0 * (white.shape[0] / 100.0) ** (2.0 / 9.0), white.shape[0] // 4))
        for lag in range(1, lags + 1):
            shifted = white[lag:].T @ white[:-lag]
            meat += (1.0 - lag / (lags + 1.0)) * (shifted + shifted.T)
    colour = 1.0 / (1.0 - slow)
    return np.asarray(meat * np.outer(colour, colour))


# Scores that are slower than this are taken for as slow; a random walk has no variance.
_SLOWEST = 0.97


def correlation_time(residuals: FloatArray, series: Groups) -> float:
    """Rows from one independent residual to the next, at least 1: by the sum of autocorrelations
    up to where their pairs turn negative (Geyer, Statistical Science 7, 1992).
    """
    whole = float(residuals @ residuals)
    if whole <= 0.0:
        return 1.0
    parts = [residuals[series == label] for label in np.unique(series)]
    longest = max(part.size for part in parts) // 2
    products = np.zeros(longest + 1)
    for part in parts:
        # All lags at once: those of slow rows reach over hundreds of thousands.
        length = fft.next_fast_len(part.size + longest, real=True)
        found = fft.irfft(np.abs(fft.rfft(part, length)) ** 2, length)
        products[: found.size] += found[: products.size]
    pairs = products[1:-1][: (longest - 1) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0.0)
    last = int(negative[0]) if negative.size else pairs.size
    total = 1.0 + 2.0 * float(pairs[:last].sum()) / whole
    return max(total, 1.0)


def information(residuals: FloatArray, count: int, effective: float) -> float:
    """BIC of a model from its residuals and number of coefficients, for an effective number of
    rows that is common to all models compared.
    """
    mean = max(float(np.mean(residuals**2)), 1e-300)
    return effective * float(np.log(mean)) + count * float(np.log(max(effective, 2.0)))


def mean_of(values: FloatArray) -> tuple[float, float, float]:
    """Mean of rows that follow each other, its standard deviation and effective freedom."""
    ones = np.ones((values.size, 1))
    found = regress(ones, values, np.zeros(values.size, dtype=np.intp), robust=False)
    return (
        float(found.coefficients[0]),
        float(np.sqrt(found.covariance[0, 0])),
        found.freedom,
    )


@dataclass(frozen=True, slots=True)
class Averaged:
    """Coefficients averaged over the models that the data leave open.

    Args:
        coefficients, covariance: Of all K columns; those that a model lacks count as 0 there. The
            covariance holds what the models differ by.
        best: The most probable model, with its columns in ``places``.
        included: Probability of each column, shape (K,).
    """

    coefficients: FloatArray
    covariance: FloatArray
    best: Regression
    places: tuple[int, ...]
    included: FloatArray


def averaged(rows: FloatArray, base: Sequence[int], values: FloatArray, series: Groups) -> Averaged:
    """Average over all models that hold the columns of ``base`` and any of the others.

    A single model that was picked by its BIC has intervals that are too narrow: a term that is just
    too small to be picked turns up in the others (Kass and Raftery, Journal of the American
    Statistical Association 90, 1995). The weights are exp(-BIC/2) with the effective number of rows
    that the residuals of the whole model have, the whitest there are.

    Args:
        rows: Shape (N, K); columns outside ``base`` that cannot be told from others are left out.
        base: Places of columns that every model has.
        values: Shape (N,).
        series: As in `regress`.
    """
    count = rows.shape[1]
    apart = separable(rows)
    optional = [place for place in range(count) if place not in base and apart[place]]
    whole = [*base, *optional]
    left = left_by(rows[:, whole], values)
    effective = max(values.size / correlation_time(left, series), len(whole) + 2.0)
    models = [
        tuple(sorted((*base, *(place for bit, place in enumerate(optional) if code >> bit & 1))))
        for code in range(1 << len(optional))
    ]
    scores = _scores(rows, values, models, effective)
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    included = np.array(
        [weights[[place in model for model in models]].sum() for place in range(count)]
    )
    kept = np.flatnonzero(weights >= _LEAST_WEIGHT * weights.max())
    shares = weights[kept] / weights[kept].sum()
    fits = [regress(rows[:, list(models[one])], values, series) for one in kept]
    means = np.zeros((kept.size, count))
    spread = np.zeros((count, count))
    for row, (one, fit, share) in enumerate(zip(kept, fits, shares, strict=True)):
        places = list(models[one])
        means[row, places] = fit.coefficients
        spread[np.ix_(places, places)] += share * fit.covariance
    mean = shares @ means
    apart_by = means - mean
    spread += (apart_by * shares[:, None]).T @ apart_by
    best = int(np.argmax(shares))
    return Averaged(mean, spread, fits[best], models[int(kept[best])], included)


# Models of less than this share of the best one's probability change nothing.
_LEAST_WEIGHT = 0.01


def _scores(
    rows: FloatArray, values: FloatArray, models: Sequence[tuple[int, ...]], effective: float
) -> FloatArray:
    """BIC of each model by the triangular factor of all columns and the values."""
    factor = np.asarray(np.linalg.qr(_with_values(rows, values), mode="r"))
    target = factor[:, -1]
    found = []
    for model in models:
        left = left_by(factor[:, list(model)], target)
        mean = max(float(left @ left) / values.size, 1e-300)
        found.append(
            effective * float(np.log(mean)) + len(model) * float(np.log(max(effective, 2.0)))
        )
    return np.array(found)


def left_by(rows: FloatArray, values: FloatArray) -> FloatArray:
    """What least squares of the columns of ``rows`` leave of ``values``, shape (N,)."""
    return np.asarray(values - rows @ _solved(rows, values))
