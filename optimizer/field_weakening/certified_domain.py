"""The plane of torque and excess flux linkage that a certificate covers, cut into boxes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball_arrays import Balls
from dqforge.optimizer.field_weakening.enclosures import Bend, Boxes, rounding, taylor
from dqforge.optimizer.field_weakening.exact import WeakeningRegion
from dqforge.optimizer.field_weakening.form import WeakeningReference
from dqforge.optimizer.field_weakening.limit_bounds import limit_decrease, limit_range

_FIRST = 16  # Parts of the torques and of the excess flux linkages to begin with.
STRIPS = 1024
_MARGIN = 1.01


@dataclass(frozen=True, slots=True)
class CertifiedDomain:
    """What the boxes have to cover: torques in N m on each segment, and flux linkages in Wb."""

    region: WeakeningRegion
    reference: WeakeningReference
    ends: FloatArray  # of the segments, from the least torque to the largest
    most_excess: float
    seam: float  # by so much rounding may move the decision whether the field is weakened
    overhang: float  # by so much in N m a torque may lie above the limit of its own flux linkage

    @classmethod
    def of(cls, region: WeakeningRegion, reference: WeakeningReference) -> CertifiedDomain:
        """Domain of a reference within a region, with room for the rounding at its seams."""
        flux = np.linspace(float(reference.flux_min), float(reference.flux_max), STRIPS + 1)
        lower, upper = limit_range(reference, flux[:-1], flux[1:])
        starts = np.append(reference.flux.starts.astype(np.float64)[1:], np.inf)
        end = float(np.max(upper))
        ends = np.unique(
            np.minimum(np.concatenate([[min(0.0, float(np.min(lower)))], starts]), end)
        )
        overhang = limit_decrease(reference)
        ends[-1] += overhang
        whole = cls(region, reference, ends, 0.0, 0.0, overhang)
        seam, largest = 0.0, -np.inf
        for segment in range(ends.size - 1):
            edges = np.linspace(ends[segment], ends[segment + 1], STRIPS + 1)
            boxes = boxes_between(
                segment, edges[:-1], edges[1:], np.zeros(STRIPS), np.zeros(STRIPS), weakens=False
            )
            seam = max(seam, float(np.max(rounding(reference, boxes)[2])))
            largest = max(
                largest, float(np.max(whole.flux_range(segment, edges[:-1], edges[1:])[1]))
            )
        excess = largest - float(reference.flux_min)
        return replace(
            whole, most_excess=max(excess * (1.0 + 1e-12), 0.0) + seam, seam=seam * _MARGIN
        )

    def flux_range(
        self, segment: int, low: FloatArray, high: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Bounds of the flux linkage of the MTPA currents in Wb for torques in N m on a segment,
        shape (N,).
        """
        curve, t = self.reference.flux, Balls.between(low, high)
        row, start = [float(c) for c in curve.coefficients[segment]], float(curve.starts[segment])
        value, slope, _ = taylor(row, Balls.exact(t.mid) - start)
        bend = Balls.of(taylor(row, t - start)[2])
        return Bend(value, slope, 0, 0, 0, 0).range(
            Bend(0, 0, 0, bend, 0, 0), t.rad, np.zeros(t.rad.shape)
        )

    def clipped(self, boxes: Boxes) -> Boxes:
        """Boxes without those outside the domain, the others cut where they stick out of it."""
        least, largest = float(self.reference.flux_min), float(self.reference.flux_max)
        low, high = self.flux_range(boxes.segment, boxes.t_low, boxes.t_high)
        if not boxes.weakens:
            return boxes.chosen(low - self.seam <= largest)
        x_low = np.maximum(boxes.x_low, low - largest)
        x_high = np.minimum(boxes.x_high, high - least)
        a_low, a_high = np.maximum(low - x_high, least), np.minimum(high - x_low, largest)
        # One unit in the last place makes up for the rounding of these differences.
        slack = 4e-16 * (np.abs(low) + np.abs(high) + np.abs(boxes.x_high) + least)
        x_low, x_high, a_low, a_high = x_low - slack, x_high + slack, a_low - slack, a_high + slack
        inside = np.flatnonzero((x_low <= x_high) & (a_low <= a_high))
        top = limit_range(
            self.reference, np.maximum(a_low[inside], least), np.minimum(a_high[inside], largest)
        )[1]
        t_high = np.minimum(boxes.t_high[inside], top + self.overhang)
        kept = t_high >= boxes.t_low[inside]
        inside = inside[kept]
        return boxes.chosen(inside, t_high=t_high[kept], x_low=x_low[inside], x_high=x_high[inside])

    def available(self, boxes: Boxes) -> tuple[FloatArray, FloatArray]:
        """Bounds of the available flux linkage in Wb on boxes inside the domain, shape (N,)."""
        least, largest = float(self.reference.flux_min), float(self.reference.flux_max)
        low, high = self.flux_range(boxes.segment, boxes.t_low, boxes.t_high)
        if not boxes.weakens:
            return np.clip(low - self.seam, least, largest) * (1.0 - 1e-15), np.full(
                low.shape, largest
            )
        a_low, a_high = (
            np.clip(low - boxes.x_high, least, None),
            np.clip(high - boxes.x_low, None, largest),
        )
        return a_low * (1.0 - 1e-15), np.maximum(a_high, a_low) * (1.0 + 1e-15)

    def holds(self, boxes: Boxes) -> NDArray[np.bool_]:
        """Whether the centres of boxes lie in the domain, so that errors there are really made.

        Not proven.
        """
        if not boxes.weakens:
            return np.ones(boxes.count, dtype=np.bool_)
        t, x = 0.5 * (boxes.t_low + boxes.t_high), 0.5 * (boxes.x_low + boxes.x_high)
        flux = self.flux_range(boxes.segment, t, t)[0] - x
        least, largest = float(self.reference.flux_min), float(self.reference.flux_max)
        limit = limit_range(self.reference, *[np.clip(flux, least, largest)] * 2)[0]
        return np.asarray((x > 0.0) & (flux >= least) & (flux <= largest) & (t <= limit))

    def first(self) -> Iterator[Boxes]:
        """Boxes over the whole domain to begin with, with what rounding may add on them and inside
        them.
        """
        for segment, (start, end) in enumerate(pairwise(self.ends.tolist())):
            edges = np.linspace(start, end, _FIRST + 1)
            seam = np.full(_FIRST, self.seam)
            yield self.rounded(
                boxes_between(segment, edges[:-1], edges[1:], seam, seam, weakens=False)
            )
            across = np.linspace(0.0, max(self.most_excess, self.seam), _FIRST + 1)
            across[0] = -self.seam
            low_t, low_x = (part.ravel() for part in np.meshgrid(edges[:-1], across[:-1]))
            high_t, high_x = (part.ravel() for part in np.meshgrid(edges[1:], across[1:]))
            yield self.rounded(boxes_between(segment, low_t, high_t, low_x, high_x, weakens=True))

    def rounded(self, boxes: Boxes) -> Boxes:
        """Boxes with what rounding may add on them."""
        by_d, by_q, _ = rounding(self.reference, boxes)
        return replace(boxes, rounding_d=by_d, rounding_q=by_q)


def boxes_between(
    segment: int,
    t_low: FloatArray,
    t_high: FloatArray,
    x_low: FloatArray,
    x_high: FloatArray,
    *,
    weakens: bool,
) -> Boxes:
    """Boxes of one segment between bounds of the torque (N m) and of the excess flux (Wb)."""
    zero = np.zeros_like(t_low)
    return Boxes(segment, weakens, t_low, t_high, x_low, x_high, zero, zero)


def halved(boxes: Boxes, along: NDArray[np.bool_]) -> Boxes:
    """Both halves of each box, cut across the direction in which the errors bend more."""
    along = along | (not boxes.weakens)
    t_mid, x_mid = 0.5 * (boxes.t_low + boxes.t_high), 0.5 * (boxes.x_low + boxes.x_high)
    twice = np.concatenate([np.arange(boxes.count)] * 2)
    return boxes.chosen(
        twice,
        t_high=np.concatenate([np.where(along, t_mid, boxes.t_high), boxes.t_high]),
        t_low=np.concatenate([boxes.t_low, np.where(along, t_mid, boxes.t_low)]),
        x_high=np.concatenate([np.where(along, boxes.x_high, x_mid), boxes.x_high]),
        x_low=np.concatenate([boxes.x_low, np.where(along, boxes.x_low, x_mid)]),
    )
