"""Shares with their intervals: how many of n rows, and how well n rows tell."""

from __future__ import annotations

from math import sqrt
from statistics import NormalDist

from dqforge.machines.records import dataclass

CONFIDENCE = 0.95  # Share of studies in which an interval holds the true share.


@dataclass(frozen=True, slots=True)
class Share:
    """``met`` of ``count`` rows.

    Args:
        met, count: Numbers of rows.
        confidence: Probability with which the interval holds the true share.
    """

    met: int
    count: int
    confidence: float = CONFIDENCE

    @property
    def value(self) -> float:
        """The share itself, NaN of no rows."""
        return self.met / self.count if self.count else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's interval of the true share."""
        return wilson(self.met, self.count, self.confidence)

    def plus(self, other: Share) -> Share:
        """Both together."""
        return Share(self.met + other.met, self.count + other.count, self.confidence)


def wilson(met: int, count: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Wilson's score interval of a share (Wilson 1927, doi:10.1080/01621459.1927.10502953).

    (p + z^2/2n +- z sqrt(p (1 - p)/n + z^2/4n^2)) / (1 + z^2/n) with p = met/n. None of n rows, and
    all of them, have an interval with a width, too; of no rows it is everything from 0 to 1.

    Args:
        met, count: Numbers of rows.
        confidence: Probability with which the interval holds the true share.
    """
    if count == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + 0.5 * confidence)
    share, part = met / count, z * z / count
    middle = share + 0.5 * part
    half = z * sqrt(share * (1.0 - share) / count + 0.25 * part / count)
    low, high = (middle - half) / (1.0 + part), (middle + half) / (1.0 + part)
    return (0.0 if met == 0 else low), (1.0 if met == count else high)
