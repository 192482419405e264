"""Saturated machines: flux linkages on a grid of currents, as C2 tensor-product cubic splines.

The splines are stored as one row of power-basis coefficients per cell, so that values and derivatives at a point come
from a single gather and one small matrix product: that is what makes whole torque-speed maps cheap.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.synchronous import FloatArray, FluxJet, torque_from_flux

_LEAST_POINTS = 4


def _cell_coefficients(i_d: FloatArray, i_q: FloatArray, values: FloatArray) -> FloatArray:
    """Bicubic not-a-knot spline per cell, shape (M - 1, N - 1, 4, 4): rising powers of the local i_d, then of i_q."""
    from scipy.interpolate import CubicSpline

    along_q = CubicSpline(i_q, values, axis=1, bc_type="not-a-knot").c[::-1]  # (power, cell, M)
    along_d = CubicSpline(i_d, np.moveaxis(along_q, 2, 0), axis=0, bc_type="not-a-knot").c[::-1]
    return np.ascontiguousarray(np.transpose(along_d, (1, 3, 0, 2)))


def _powers(local: FloatArray, orders: int) -> FloatArray:
    """Powers 1, x, x^2, x^3 and their derivatives, shape (N, orders, 4)."""
    rows = np.zeros((local.size, orders, 4))
    rows[:, 0, 0], rows[:, 0, 1] = 1.0, local
    rows[:, 0, 2] = local * local
    rows[:, 0, 3] = rows[:, 0, 2] * local
    if orders > 1:
        rows[:, 1, 1], rows[:, 1, 2], rows[:, 1, 3] = 1.0, 2.0 * local, 3.0 * rows[:, 0, 2]
        rows[:, 2, 2], rows[:, 2, 3] = 2.0, 6.0 * local
    return rows


@dataclass(frozen=True, slots=True)
class FluxMap:
    """Flux linkages over a grid of currents, symmetric in i_q, with C2 splines between the points.

    Outside the grid the flux linkage goes on with the incremental inductances of the edge (C1); `inside` tells where.

    Parameters
    ----------
    i_d, i_q:
        Ascending grid currents in A (peak), shapes (M,) and (N,), at least 4 each; i_q symmetric about 0.
    psi_d, psi_q:
        Flux linkages in Wb (peak), shape (M, N); psi_d even and psi_q odd in i_q.

    Raises
    ------
    InputError
        Too few points, an axis that does not ascend, a shape that does not fit, or a value that is not finite.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    _coefficients: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check the grid and compute the splines once."""
        for name, axis in (("i_d", self.i_d), ("i_q", self.i_q)):
            if axis.ndim != 1 or axis.size < _LEAST_POINTS:
                raise InputError(
                    f"the flux map needs at least {_LEAST_POINTS} different values of {name}, got {axis.size}"
                )
            if not (np.all(np.isfinite(axis)) and np.all(np.diff(axis) > 0.0)):
                raise InputError(f"the flux map's {name} must be finite and ascend")
        shape = (self.i_d.size, self.i_q.size)
        for name, values in (("psi_d", self.psi_d), ("psi_q", self.psi_q)):
            if values.shape != shape:
                raise InputError(f"the flux map's {name} has the shape {values.shape}, its axes need {shape}")
            if not np.all(np.isfinite(values)):
                row, column = np.argwhere(~np.isfinite(values))[0]
                where = f"i_d = {self.i_d[row]:g} A, i_q = {self.i_q[column]:g} A"
                raise InputError(f"the flux map's {name} has a hole at {where}; measure it or leave its row out")
        cells = [_cell_coefficients(self.i_d, self.i_q, values) for values in (self.psi_d, self.psi_q)]
        stacked = np.stack(cells, axis=2).reshape(-1, 8, 4)
        object.__setattr__(self, "_coefficients", np.ascontiguousarray(stacked))

    def inside(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether currents in A lie on the grid's rectangle, any broadcastable shapes."""
        within_d = (i_d >= self.i_d[0]) & (i_d <= self.i_d[-1])
        return np.asarray(within_d & (i_q >= self.i_q[0]) & (i_q <= self.i_q[-1]))

    def _local(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Coefficient rows of the cells, shape (N, 8, 4), and the currents counted from the cells' corners."""
        row = np.clip(np.searchsorted(self.i_d, i_d, side="right") - 1, 0, self.i_d.size - 2)
        column = np.clip(np.searchsorted(self.i_q, i_q, side="right") - 1, 0, self.i_q.size - 2)
        rows = self._coefficients[row * (self.i_q.size - 1) + column]
        return rows, i_d - self.i_d[row], i_q - self.i_q[column]

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any broadcastable shapes."""
        i_d, i_q = np.broadcast_arrays(np.asarray(i_d, dtype=np.float64), np.asarray(i_q, dtype=np.float64))
        shape = i_d.shape
        flat_d, flat_q = i_d.ravel(), i_q.ravel()
        if not np.all(self.inside(flat_d, flat_q)):
            jet = self.jet(flat_d, flat_q)
            return jet.psi_d.reshape(shape), jet.psi_q.reshape(shape)
        rows, local_d, local_q = self._local(flat_d, flat_q)
        along = np.matmul(rows, _powers(local_q, 1)[:, 0, :, np.newaxis]).reshape(-1, 2, 4)
        value = np.matmul(along, _powers(local_d, 1)[:, 0, :, np.newaxis])[:, :, 0]
        return value[:, 0].reshape(shape), value[:, 1].reshape(shape)

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, arrays of shape (N,)."""
        near_d, near_q = np.clip(i_d, self.i_d[0], self.i_d[-1]), np.clip(i_q, self.i_q[0], self.i_q[-1])
        rows, local_d, local_q = self._local(near_d, near_q)
        along = np.matmul(rows, _powers(local_q, 3).transpose(0, 2, 1)).reshape(-1, 2, 4, 3)
        table = np.matmul(_powers(local_d, 3)[:, np.newaxis], along)  # (N, flux, order in i_d, order in i_q)
        beyond_d, beyond_q = i_d - near_d, i_q - near_q
        keep = ((beyond_d == 0.0) & (beyond_q == 0.0)).astype(np.float64)
        linear = table[:, :, 1, 0] * beyond_d[:, np.newaxis] + table[:, :, 0, 1] * beyond_q[:, np.newaxis]
        value = table[:, :, 0, 0] + linear
        return FluxJet(
            psi_d=value[:, 0],
            psi_q=value[:, 1],
            l_dd=table[:, 0, 1, 0],
            l_dq=table[:, 0, 0, 1],
            l_qd=table[:, 1, 1, 0],
            l_qq=table[:, 1, 0, 1],
            d_dd=keep * table[:, 0, 2, 0],
            d_dq=keep * table[:, 0, 1, 1],
            d_qq=keep * table[:, 0, 0, 2],
            q_dd=keep * table[:, 1, 2, 0],
            q_dq=keep * table[:, 1, 1, 1],
            q_qq=keep * table[:, 1, 0, 2],
        )


def complete_by_symmetry(
    i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Full plane from the half with i_q >= 0, or the symmetric part of a full plane.

    ``i_q`` ascends, shape (N,); ``psi_d``, ``psi_q`` have the shape (M, N). A half plane begins at i_q = 0 and is
    mirrored, psi_d even and psi_q odd; a full plane with a symmetric axis is averaged with its mirror image.

    Raises
    ------
    InputError
        The axis neither begins at 0 nor is symmetric about it.
    """
    scale = float(np.max(np.abs(i_q)))
    if abs(float(i_q[0])) <= 1e-9 * scale:
        axis = np.concatenate([-i_q[:0:-1], i_q])
        odd = np.concatenate([-psi_q[:, :0:-1], 0.0 * psi_q[:, :1], psi_q[:, 1:]], axis=1)
        return axis, np.concatenate([psi_d[:, :0:-1], psi_d], axis=1), odd
    if np.max(np.abs(i_q + i_q[::-1])) > 1e-6 * scale:
        raise InputError(f"i_q must begin at 0 or be symmetric about 0, got {i_q[0]:g} to {i_q[-1]:g} A")
    axis = 0.5 * (i_q - i_q[::-1])
    return axis, 0.5 * (psi_d + psi_d[:, ::-1]), 0.5 * (psi_q - psi_q[:, ::-1])


@dataclass(frozen=True, slots=True)
class SaturatedMachine:
    """A machine whose flux linkages are a map; parameters as in `LinearMachine`, but for ``flux_map``."""

    pole_pairs: int
    r_s: float
    flux_map: FluxMap
    i_max: float
    inertia: float | None = None
    friction: float = 0.0
    omega_m_max: float | None = None
    _origin: FluxJet = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Keep the values at zero current, which several properties read."""
        zero = np.zeros(1)
        object.__setattr__(self, "_origin", self.flux_map.jet(zero, zero))

    @property
    def psi_pm(self) -> float:
        """Open-circuit flux linkage in Wb, peak of phase."""
        return float(self._origin.psi_d[0])

    @property
    def l_d(self) -> float:
        """Incremental d inductance at zero current, in H."""
        return float(self._origin.l_dd[0])

    @property
    def l_q(self) -> float:
        """Incremental q inductance at zero current, in H."""
        return float(self._origin.l_qq[0])

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any broadcastable shapes."""
        return self.flux_map.flux(i_d, i_q)

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, arrays of shape (N,)."""
        return self.flux_map.jet(i_d, i_q)

    def torque(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Torque in N m at currents in A, any broadcastable shapes."""
        return torque_from_flux(self.pole_pairs, *self.flux(i_d, i_q), i_d, i_q)
