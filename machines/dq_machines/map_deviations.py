"""Standard deviations that are stated for the points of a flux map, and the axes of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

# Currents that differ by less than this share of the largest one are the same.
_SAME_CURRENT = 1e-6

LEAST_POINTS = 4  # Of an axis, for a cubic spline through them.


@dataclass(frozen=True, slots=True, eq=False)
class MapDeviations:
    """Standard deviations of the points of a map that is symmetric in i_q.

    Args:
        i_d, i_q: Currents of the points in A (peak), shape (K,), of both halves or the upper one.
        own: Those of each point by itself, for psi_d and psi_q in Wb, shape (2, K).
        shared: What one standard deviation of each error that all points share makes of them, in
            Wb, shape (S, 2, K).
    """

    i_d: FloatArray
    i_q: FloatArray
    own: FloatArray
    shared: FloatArray

    def factors(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Errors of the flux linkages at currents in A, shape (N,), as columns of independent
        causes, Wb, shape (2, N, P): the covariance is the sum over P of their products.

        Between the points of a grid they are interpolated as the flux linkages are, by cubic
        splines; elsewhere those of the nearest point are taken, which are not smaller.
        """
        upper = self.i_q >= 0.0
        at_d, at_q = self.i_d[upper], self.i_q[upper]
        weights = self._weights(at_d, at_q, i_d, np.abs(i_q))
        sign = np.where(i_q < 0.0, -1.0, 1.0)
        found = []
        for axis, turn in enumerate((np.ones_like(sign), sign)):
            each = weights[axis] * self.own[axis, upper]
            common = weights[axis] @ self.shared[:, axis, upper].T
            own = (each, 0.0 * each) if axis == 0 else (0.0 * each, each)
            found.append(np.hstack([*own, common]) * turn[:, None])
        return np.stack(found)

    def _weights(
        self, at_d: FloatArray, at_q: FloatArray, i_d: FloatArray, i_q: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Shares of the upper points in psi_d and psi_q at currents, shape (N, K) each."""
        largest = float(max(np.abs(at_d).max(), at_q.max()))
        axis_d, row = axis_of(at_d, _SAME_CURRENT * largest)
        axis_q, column = axis_of(at_q, _SAME_CURRENT * largest)
        full = axis_d.size * axis_q.size == at_d.size
        full &= min(axis_d.size, axis_q.size) >= LEAST_POINTS
        if not full or axis_q[0] > _SAME_CURRENT * largest:
            away = np.hypot(i_d[:, None] - at_d, i_q[:, None] - at_q)
            nearest = np.zeros((i_d.size, at_d.size))
            nearest[np.arange(i_d.size), np.argmin(away, axis=1)] = 1.0
            return nearest, nearest
        whole_q = np.concatenate([-axis_q[:0:-1], axis_q])
        over_d = _shares(axis_d, np.clip(i_d, axis_d[0], axis_d[-1]))
        over_q = _shares(whole_q, np.clip(i_q, whole_q[0], whole_q[-1]))
        zero = axis_q.size - 1
        found = []
        for sign in (1.0, -1.0):  # psi_d is even in i_q, psi_q odd
            folded = over_q[:, zero:].copy()
            folded[:, 1:] += sign * over_q[:, :zero][:, ::-1]
            found.append(over_d[:, row] * folded[:, column])
        return found[0], found[1]


def axis_of(values: FloatArray, width: float) -> tuple[FloatArray, NDArray[np.intp]]:
    """Ascending values that differ by more than a width, and the place of each value in them."""
    order = np.argsort(values, kind="stable")
    place = np.empty(values.size, dtype=np.intp)
    place[order] = np.concatenate([[0], np.cumsum(np.diff(values[order]) > width)])
    return np.bincount(place, values) / np.bincount(place), place


def _shares(axis: FloatArray, at: FloatArray) -> FloatArray:
    """Share of each point of an axis in a cubic spline through all (not-a-knot), shape (N, M)."""
    from scipy.interpolate import make_interp_spline

    return np.asarray(make_interp_spline(axis, np.eye(axis.size), k=3)(at))
