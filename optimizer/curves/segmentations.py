"""Where the searches for breakpoints begin: one start for each low place of the
error over all segmentations.

The error of the best fits need not fall to one lowest place as the breakpoints move. Where a
derivative of the curve changes its sign, the error of a segment across that place first falls and
then rises with its length, and the ties between the segments add to it: two segmentations with a
worse one between them are common. So the error is looked at over a lattice of segmentations, and a
search begins from each of its low places.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, product

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.curves.breakpoints import SegmentErrors

# Steps of the lattice along the domain, by the number of segments: 31, 136 and 120 segmentations.
_STEPS = {2: 32, 3: 18, 4: 11}

# Multiple of the least error up to which a low place is a start. What a search reaches from there
# is lower than what is looked at by up to so much, and by more in one place than in another.
_LOW = 2.0
_MOST_PLACES = 3

# Multiple of the least cost up to which places count as one plain, on which small errors of the
# cost hide the best.
_PLAIN = 1.5
_WIDE = 3  # Steps from which on a plain is wide: then it is entered from its ends as well.
_APART = 0.5  # Steps of the lattice from which on two starts lead to different ends.


class Segmentations:
    """A lattice of segmentations of the domain, denser where the curves bend.

    Its steps along the domain are equal shares of the best segmentation into twice as many parts.
    ``squared`` says that the first start is that of the squared errors.
    """

    def __init__(self, errors: SegmentErrors, segments: int, *, squared: bool = False) -> None:
        self.first = errors.best_edges(segments, squared=squared)
        self.steps = _STEPS[segments]
        self.level = errors.best_edges(2 * segments)
        self.share = np.linspace(0.0, float(self.steps), self.level.size)
        self.places = list(combinations(range(1, self.steps), segments - 1))
        inner = np.interp(np.array(self.places, dtype=np.float64), self.share, self.level)
        zero = np.zeros((len(self.places), 1))
        self.edges = np.concatenate([zero, inner, zero + self.level[-1]], axis=1)

    def place(self, edges: FloatArray) -> FloatArray:
        """Where breakpoints lie, in steps of the lattice: edges of shape (S + 1,) to (S - 1,)."""
        return np.interp(edges[1:-1], self.level, self.share)

    def low_places(self, cost: FloatArray) -> list[FloatArray]:
        """Segmentations whose cost, shape (K,), no neighbour undercuts: at most three,
        the least one first.
        """
        value = dict(zip(self.places, cost.tolist(), strict=True))
        moves = [move for move in product((-1, 0, 1), repeat=len(self.places[0])) if any(move)]

        def is_low(place: tuple[int, ...]) -> bool:
            beside = (tuple(a + b for a, b in zip(place, move, strict=True)) for move in moves)
            return all(value[place] <= value.get(other, np.inf) for other in beside)

        order = [
            index for index in np.argsort(cost, kind="stable") if cost[index] <= _LOW * np.min(cost)
        ]
        return [self.edges[index] for index in order if is_low(self.places[index])][:_MOST_PLACES]

    def ends_of_plain(self, cost: FloatArray) -> list[FloatArray]:
        """The best segmentations at both ends of the low plain, along each breakpoint for which it
        is wide.
        """
        low = np.flatnonzero(cost <= _PLAIN * np.min(cost))
        places = np.array(self.places)[low]
        found = []
        for along in places.T:
            for end in (np.min(along), np.max(along)) if np.ptp(along) >= _WIDE else ():
                at_end = low[along == end]
                found.append(self.edges[at_end[np.argmin(cost[at_end])]])
        return found

    def starts(self, cost: Callable[[FloatArray], FloatArray]) -> list[FloatArray]:
        """Segmentations to begin from, each of shape (S + 1,): the best one without ties,
        and the low places.

        Args:
            cost: What segmentations of shape (K, S + 1) err by, shape (K,); need not be what the
                search lowers.
        """
        kept = [self.first]
        costs = cost(self.edges)
        for edges in self.low_places(costs) + self.ends_of_plain(costs):
            here = self.place(edges)
            if all(np.max(np.abs(here - self.place(other))) > _APART for other in kept):
                kept.append(edges)
        return kept
