"""Convex regions in the plane of currents: where the points of a flux map lie,
and where it ends.
"""

from __future__ import annotations

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

_ON_THE_EDGE = 1e-9  # Distance over the size of a region within which a current counts as inside.

# Share by which a current limit may exceed a region that still covers it: digits that a file leaves
# out.
_COVERED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class CurrentRegion:
    """A convex polygon of currents, its corners counterclockwise.

    Zero current lies inside or on its edge.

    Args:
        corner_d, corner_q: Corners (i_d, i_q) in A (peak), shape (K,) each, K >= 3.
    """

    corner_d: FloatArray
    corner_q: FloatArray
    normal_d: FloatArray = field(init=False, repr=False)
    normal_q: FloatArray = field(init=False, repr=False)
    offset: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the unit normals that point outwards, and the distance of each
        edge from zero current, in A.
        """
        along_d, along_q = (
            np.roll(self.corner_d, -1) - self.corner_d,
            np.roll(self.corner_q, -1) - self.corner_q,
        )
        length = np.hypot(along_d, along_q)
        object.__setattr__(self, "normal_d", along_q / length)
        object.__setattr__(self, "normal_q", -along_d / length)
        object.__setattr__(
            self, "offset", self.normal_d * self.corner_d + self.normal_q * self.corner_q
        )

    @classmethod
    def rectangle(cls, low_d: float, high_d: float, end_q: float) -> CurrentRegion:
        """i_d between two currents, of which none leaves out zero, and |i_q| up to ``end_q``,
        all in A.
        """
        low, high = min(low_d, 0.0), max(high_d, 0.0)
        return cls(np.array([low, high, high, low]), np.array([-end_q, -end_q, end_q, end_q]))

    @classmethod
    def hull(cls, i_d: FloatArray, i_q: FloatArray) -> CurrentRegion:
        """Convex hull of points in A, shape (N,), of their mirror images in i_q,
        and of zero current.
        """
        from scipy.spatial import ConvexHull

        points = np.stack(
            [np.concatenate([i_d, i_d, [0.0]]), np.concatenate([i_q, -i_q, [0.0]])], axis=1
        )
        corners = points[ConvexHull(points / np.ptp(points, axis=0)).vertices]
        return cls(corners[:, 0], corners[:, 1])

    def within(self, other: CurrentRegion) -> CurrentRegion:
        """What both regions have in common."""
        corners = np.stack([self.corner_d, self.corner_q], axis=1)
        for normal_d, normal_q, offset in zip(
            other.normal_d, other.normal_q, other.offset, strict=True
        ):
            gap = corners @ np.array([normal_d, normal_q]) - offset
            corners = _cut(corners, gap, _ON_THE_EDGE * self.size)
        return CurrentRegion(corners[:, 0], corners[:, 1])

    @property
    def size(self) -> float:
        """Largest current in A within the region."""
        return float(np.max(np.hypot(self.corner_d, self.corner_q)))

    @property
    def reach(self) -> float:
        """Largest current in A that lies inside at any angle."""
        return float(np.min(self.offset))

    def covers(self, current: float) -> bool:
        """Whether all currents up to a magnitude in A lie inside, but for what files round away."""
        return current <= self.reach * (1.0 + _COVERED)

    def beyond(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Distance in A beyond the nearest edge line of currents, any one shape.

        Negative inside.
        """
        most = np.full(np.broadcast_shapes(np.shape(i_d), np.shape(i_q)), -np.inf)
        for normal_d, normal_q, offset in zip(
            self.normal_d, self.normal_q, self.offset, strict=True
        ):
            np.maximum(most, normal_d * i_d + normal_q * i_q - offset, out=most)
        return most

    def contains(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether currents in A lie inside or on the edge, any one shape."""
        return np.asarray(self.beyond(i_d, i_q) <= _ON_THE_EDGE * self.size)

    def end_of_ray(self, angle: float) -> float:
        """Current in A at which a ray from zero current, at an angle in rad, leaves the region."""
        along = self.normal_d * np.cos(angle) + self.normal_q * np.sin(angle)
        ahead = along > 1e-12
        return float(np.min(np.maximum(self.offset[ahead], 0.0) / along[ahead]))


def _cut(corners: FloatArray, gap: FloatArray, slack: float) -> FloatArray:
    """Corners of a polygon, shape (K, 2), behind a line, from their distances beyond it."""
    kept: list[FloatArray] = []
    for corner, here, other, there in zip(
        corners, gap, np.roll(corners, -1, axis=0), np.roll(gap, -1), strict=True
    ):
        if here <= slack:
            kept.append(corner)
        if (here > slack and there < -slack) or (here < -slack and there > slack):
            kept.append(corner + (other - corner) * (here / (here - there)))
    return np.array(kept)
