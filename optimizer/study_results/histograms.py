"""How an output is spread over the rows of a study: counts over bins that grow with what comes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

# Bins; at least a quarter of them lie within the values, so that a quantile is known to 1/128 of
# their range, mostly to 1/256.
BINS = 512


@dataclass(frozen=True, slots=True, eq=False)
class Histogram:
    """Counts of an output's finite values.

    Args:
        low, width: Lower end of the first bin and width of each; the width is 0 while all values
            are equal.
        counts: Rows in each bin, int64 (BINS,).
        unknown: Rows without a finite value.
        least, largest: Of the values; infinite where there are none.
    """

    low: float
    width: float
    counts: NDArray[np.int64]
    unknown: int
    least: float
    largest: float

    @property
    def rows(self) -> int:
        """Rows with a finite value."""
        return int(np.sum(self.counts))

    def plus(self, values: FloatArray) -> Histogram:
        """With further rows, shape (n,)."""
        known = values[np.isfinite(values)]
        unknown = self.unknown + values.size - known.size
        if not known.size:
            return Histogram(self.low, self.width, self.counts, unknown, self.least, self.largest)
        least = min(self.least, float(np.min(known)))
        largest = max(self.largest, float(np.max(known)))
        low, width, counts = self._grown(least, largest)
        counts = counts + np.bincount(_places(known, low, width), minlength=BINS)
        return Histogram(low, width, counts, unknown, least, largest)

    def _grown(self, least: float, largest: float) -> tuple[float, float, NDArray[np.int64]]:
        """Bins that hold a range: two become one, upwards or downwards, until it fits."""
        low, width, counts = self.low, self.width, self.counts.copy()
        if width == 0.0:
            if largest == least:
                return least, 0.0, counts
            # So far all values were one; they go where that one lies among the new bins.
            width = max((largest - least) / (BINS // 2), np.spacing(max(abs(least), abs(largest))))
            spread = np.zeros_like(counts)
            if np.any(counts):
                spread[_places(np.array([low]), least, width)[0]] = np.sum(counts)
            return least, width, spread
        while largest > low + width * BINS or least < low:
            half = np.add.reduceat(counts, np.arange(0, BINS, 2))
            empty = np.zeros(BINS // 2, dtype=np.int64)
            if least < low:
                counts, low = np.concatenate([empty, half]), low - width * BINS
            else:
                counts = np.concatenate([half, empty])
            width *= 2.0
        return low, width, counts

    def quantile(self, share: float) -> float:
        """Value that a share of the rows lies below: evenly spread within its bin, NaN of no
        rows.
        """
        if not self.rows:
            return float("nan")
        if self.width == 0.0:
            return self.low
        sums = np.concatenate([[0], np.cumsum(self.counts)])
        place = int(np.clip(np.searchsorted(sums, share * self.rows, side="left") - 1, 0, BINS - 1))
        inside = (share * self.rows - sums[place]) / max(int(self.counts[place]), 1)
        value = self.low + self.width * (place + inside)
        return float(np.clip(value, self.least, self.largest))

    def coarser(self, bins: int) -> tuple[FloatArray, NDArray[np.int64]]:
        """Edges (B + 1,) and counts (B,) of at most about ``bins`` bins from the least to the
        largest value.
        """
        filled = np.flatnonzero(self.counts)
        if not filled.size:
            return np.zeros(1), np.zeros(0, dtype=np.int64)
        first, end = int(filled[0]), int(filled[-1]) + 1
        step = max(-(-(end - first) // bins), 1)
        starts = np.arange(first, end, step)
        counts = np.add.reduceat(self.counts[:end], starts)
        return self.low + self.width * np.append(starts, starts[-1] + step), counts


def empty_histogram() -> Histogram:
    """A histogram of no rows."""
    return Histogram(0.0, 0.0, np.zeros(BINS, dtype=np.int64), 0, np.inf, -np.inf)


def _places(values: FloatArray, low: float, width: float) -> NDArray[np.intp]:
    if width == 0.0:
        return np.zeros(values.size, dtype=np.intp)
    return np.clip(((values - low) / width).astype(np.intp), 0, BINS - 1)
