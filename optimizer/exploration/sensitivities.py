"""What an output depends on, from the rows of a draw as they are: first-order sensitivities by the
means over bins of each input, and squared correlations beside them.

The first-order sensitivity of Y to X_i is Var(E[Y | X_i]) / Var(Y) (Saltelli and others 2008,
section 1.2.6). With B bins of X_i and N rows the variance of the bins' means is that of the
conditional mean, and a share (B - 1)/N of the rest by chance alone. That is taken off,

    S_i = (N - 1)/(N - B) (V_i/V - (B - 1)/(N - 1)),

as the adjusted correlation ratio does (Kelley 1935, doi:10.1073/pnas.21.9.554): an input without
influence has zero on average, and may come out a little below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

BINS = 50  # Bins of each input.


@dataclass(frozen=True, slots=True, eq=False)
class BinnedOutput:
    """Sums of an output over the bins of D inputs; more rows are added by `plus`.

    Args:
        edges: Inner edges of the bins of each input, shape (D, B - 1), ascending.
        centre: A value of the output from which it is counted, and of each input, shape (1 + D,):
            sums of squares would cancel otherwise.
        counts, sums: Rows, and sum of the output, in each bin, shape (D, B).
        moments: Sums of products of the output and the inputs, shape (1 + D, 1 + D), and their own
            sums, shape (1 + D,), as the last row.
    """

    edges: FloatArray
    centre: FloatArray
    counts: FloatArray
    sums: FloatArray
    moments: FloatArray

    @property
    def rows(self) -> int:
        """Number of rows."""
        return round(float(np.sum(self.counts[0])))

    def plus(self, inputs: FloatArray, output: FloatArray) -> BinnedOutput:
        """With further rows, inputs (n, D) and output (n,); rows with what is no finite number
        count nowhere. Sums go on in the order of the calls, so that the same parts in the same
        order give the same digits.
        """
        known = np.isfinite(output) & np.all(np.isfinite(inputs), axis=1)
        shifted = np.column_stack([output[known], inputs[known]]) - self.centre
        counts, sums = self.counts.copy(), self.sums.copy()
        bins = counts.shape[1]
        for place, edges in enumerate(self.edges):
            which = np.searchsorted(edges, inputs[known, place], side="right")
            counts[place] += np.bincount(which, minlength=bins)
            sums[place] += np.bincount(which, weights=shifted[:, 0], minlength=bins)
        added = np.vstack([shifted.T @ shifted, np.sum(shifted, axis=0)])
        return BinnedOutput(self.edges, self.centre, counts, sums, self.moments + added)


def binned_output(inputs: FloatArray, output: FloatArray, bins: int = BINS) -> BinnedOutput:
    """Bins for an output, empty, with edges that hold equally many of the rows given.

    Args:
        inputs: Inputs of the first rows of the study, shape (n, D).
        output: Output of the same rows, shape (n,).
        bins: Number of bins B, fewer where there are fewer rows.
    """
    count = max(min(bins, inputs.shape[0] // 4), 1)
    shares = np.arange(1, count) / count
    edges = np.quantile(inputs, shares, axis=0).T if count > 1 else np.empty((inputs.shape[1], 0))
    whole = np.column_stack([output, inputs])
    finite = np.where(np.isfinite(whole), whole, 0.0)
    width = whole.shape[1]
    return BinnedOutput(
        edges=np.ascontiguousarray(edges),
        centre=np.mean(finite, axis=0) if len(whole) else np.zeros(width),
        counts=np.zeros((inputs.shape[1], count)),
        sums=np.zeros((inputs.shape[1], count)),
        moments=np.zeros((width + 1, width)),
    )


@dataclass(frozen=True, slots=True)
class Sensitivities:
    """What an output depends on, arrays of shape (D,) in the order of ``inputs``.

    Args:
        output, inputs: Names.
        rows: Rows that they come from.
        first: First-order sensitivities; NaN of an output that does not change.
        squared_correlation: Squares of the correlations: the same where the output is a straight
            line in the input.
        bias: What was taken off the plain quotient of variances of an input without influence.
        total: Total sensitivities, with all that an input does together with others; None from a
            draw that was not made for them.
    """

    output: str
    inputs: tuple[str, ...]
    rows: int
    first: FloatArray
    squared_correlation: FloatArray
    bias: float
    total: FloatArray | None = None

    def designed(self, first: FloatArray, total: FloatArray) -> Sensitivities:
        """With the sensitivities of a design that was made for them in place of those by bins."""
        return replace(self, first=first, total=total, bias=0.0)


def sensitivities(output: str, inputs: Sequence[str], found: BinnedOutput) -> Sensitivities:
    """Sensitivities of an output to inputs that were drawn independently of each other.

    Args:
        output, inputs: Names of the output and of the D inputs.
        found: The output over their bins.
    """
    rows, width = found.rows, found.moments.shape[1]
    unknown = np.full(width - 1, np.nan)
    filled = np.count_nonzero(found.counts, axis=1)
    if rows <= int(np.max(filled, initial=0)) + 1:
        return Sensitivities(output, tuple(inputs), rows, unknown, unknown, float("nan"))
    mean = found.moments[-1] / rows
    covariance = found.moments[:-1] / rows - np.outer(mean, mean)
    spread = np.diag(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = covariance[0, 1:] ** 2 / (spread[0] * spread[1:])
        means = np.where(found.counts > 0.0, found.sums / found.counts, 0.0)
        between = np.sum(found.counts * (means - mean[0]) ** 2 * (found.counts > 0), axis=1) / rows
        plain = between / spread[0]
        first = (rows - 1) / (rows - filled) * (plain - (filled - 1) / (rows - 1))
    flat = not spread[0] > 1e-28 * (found.centre[0] ** 2 + spread[0])
    return Sensitivities(
        output,
        tuple(inputs),
        rows,
        unknown if flat else first,
        unknown if flat else squared,
        (int(np.max(filled)) - 1) / (rows - 1),
    )
