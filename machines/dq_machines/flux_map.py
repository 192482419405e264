"""Flux linkages on a grid of currents, as tensor-product cubic splines.

The splines are stored as one row of power-basis coefficients per cell, so that all values and
derivatives at a point come from a single gather and a few Horner steps: that is what makes whole
torque-speed maps cheap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import (
    MACHINE,
    BoolArray,
    FloatArray,
    IndexArray,
    check_numbers,
    owned_numbers,
)
from dqforge.machines.dq_machines.map_deviations import LEAST_POINTS, MapDeviations
from dqforge.machines.dq_machines.synchronous import (
    CurrentRegion,
    FluxFormulas,
    FluxJet,
    Machine,
    MachineFormulas,
)
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

# Points evaluated together: their coefficients (256 bytes each) and all intermediate values stay in
# the cache.
_CHUNK = 2048

MOST_ORDERS = 8
_ANGLES = 720  # Angles over the period at which the torque is looked at.


def _tridiagonal(rows: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a tridiagonal system by elimination with row interchanges, as LAPACK's gtsv does
    it: loading SciPy for this alone took a third of a check.

    Args:
        rows: Diagonals below, on and above, shape (3, M), of which the first lacks its first
            element and the last one its last.
        right: Right sides, shape (M, ...); they are overwritten.
    """
    count = rows.shape[1]
    below, on, above = rows[0, 1:].tolist(), rows[1].tolist(), rows[2, :-1].tolist()
    second = [0.0] * count  # the second diagonal above, which interchanges fill
    for i in range(count - 1):
        if abs(on[i]) >= abs(below[i]):
            factor = below[i] / on[i]
            on[i + 1] -= factor * above[i]
            right[i + 1] -= factor * right[i]
            continue
        factor, on[i], later = on[i] / below[i], below[i], on[i + 1]
        on[i + 1], above[i] = above[i] - factor * later, later
        if i < count - 2:
            second[i], above[i + 1] = above[i + 1], -factor * above[i + 1]
        upper = right[i].copy()
        right[i] = right[i + 1]
        right[i + 1] = upper - factor * right[i]
    right[-1] /= on[-1]
    for i in range(count - 2, -1, -1):
        right[i] -= above[i] * right[i + 1]
        if second[i] != 0.0:
            right[i] -= second[i] * right[i + 2]
        right[i] /= on[i]
    return right


def _spline(axis: FloatArray, values: FloatArray) -> FloatArray:
    """Rising powers of the cubic spline whose third derivative is continuous at the second point
    and the last but one, counted from the left of each interval, shape (4, M - 1, ...); M is 4 at
    least.
    """
    step = np.diff(axis)
    wide = step.reshape(-1, *[1] * (values.ndim - 1))
    chord = np.diff(values, axis=0) / wide
    first, last = axis[2] - axis[0], axis[-1] - axis[-3]
    rows, right = np.zeros((3, axis.size)), np.empty(values.shape)
    rows[0, 1:-1], rows[0, -1] = step[1:], last
    rows[1, 0], rows[1, 1:-1], rows[1, -1] = step[1], 2.0 * (step[:-1] + step[1:]), step[-2]
    rows[2, 0], rows[2, 1:-1] = first, step[:-1]
    right[0] = ((wide[0] + 2.0 * first) * wide[1] * chord[0] + wide[0] ** 2 * chord[1]) / first
    right[1:-1] = 3.0 * (wide[1:] * chord[:-1] + wide[:-1] * chord[1:])
    right[-1] = (wide[-1] ** 2 * chord[-2] + (2.0 * last + wide[-1]) * wide[-2] * chord[-1]) / last
    slope = _tridiagonal(rows, right)
    excess = (slope[:-1] + slope[1:] - 2.0 * chord) / wide
    return np.stack([values[:-1], slope[:-1], (chord - slope[:-1]) / wide - excess, excess / wide])


def _piecewise(axis: FloatArray, values: FloatArray) -> FloatArray:
    """Cubic spline along the first axis with straight ends: rising powers per cell, shape (4,
    M + 1, ...).

    Cell 0 lies before the grid and cell M behind it; there the spline goes on along its tangents.
    Each cell counts from its lower grid point, the first one from the first.
    """
    inner = _spline(axis, values)
    cells = np.zeros((4, axis.size + 1, *values.shape[1:]))
    cells[:, 1:-1] = inner
    cells[:2, 0] = inner[:2, 0]
    last, width = inner[:, -1], axis[-1] - axis[-2]
    cells[0, -1] = values[-1]
    cells[1, -1] = last[1] + width * (2.0 * last[2] + width * 3.0 * last[3])
    return cells


def _horner(rows: FloatArray, x: FloatArray, order: int) -> list[FloatArray]:
    """Value and up to two Taylor coefficients (the derivative, half the second one) of
    cubics at ``x``, shape (n,).

    ``rows`` holds the rising powers, shape (4, ..., n). Repeated synthetic division,
    six products for all three.
    """
    first = rows[3] * x
    sums = first + rows[2]
    second = sums * x
    second += rows[1]
    value = second * x
    value += rows[0]
    if order == 0:
        return [value]
    once = first + sums
    slope = once * x
    slope += second
    if order == 1:
        return [value, slope]
    return [value, slope, first + once]


@dataclass(frozen=True, slots=True)
class _Axis:
    """Grid points of one current in A, and how the cell of a current is found."""

    points: FloatArray
    corners: FloatArray  # where each cell counts from, the two outside the grid included
    step: float  # 0 where the points are not evenly spaced

    @classmethod
    def of(cls, points: FloatArray) -> _Axis:
        widths = np.diff(points)
        step = float(points[-1] - points[0]) / (points.size - 1)
        even = bool(np.all(np.abs(widths - step) <= 1e-9 * step))
        return cls(points, np.concatenate([points[:1], points]), step if even else 0.0)

    def cells(self, current: FloatArray) -> NDArray[np.intp]:
        """Cell of each current, from 0 (before the grid) to M (behind it), shape (n,)."""
        if self.step == 0.0:
            return np.searchsorted(self.points, current, side="right").astype(np.intp, copy=False)
        place = (current - (self.points[0] - self.step)) * (1.0 / self.step)
        # fmin and fmax drop nan, which has no integer; it comes back through the local coordinate.
        np.fmax(np.fmin(place, float(self.points.size), out=place), 0.0, out=place)
        cells: NDArray[np.intp] = place.astype(np.intp)
        return cells


# What is not known of a measured map, and what that makes of flux linkages between its points: each
# point has an error of its own, and all share those of what was subtracted from the voltages
# (resistance, inverter, encoder). Flux linkages of a map are linear in those of its points, so that
# their errors are, too.


@dataclass(frozen=True, slots=True, eq=False)
class FluxMap:
    """Flux linkages over a grid of currents, symmetric in i_q, with C2 splines between the points.

    Outside the grid the flux linkages go on along their tangents, psi + (i - i_edge) d psi/d i per
    axis: C1, with the incremental inductance of the edge. `inside` tells where the data end.

    Args:
        i_d, i_q: Ascending grid currents in A (peak), shapes (M,) and (N,), at least 4 each; i_q
            symmetric about 0.
        psi_d, psi_q: Flux linkages in Wb (peak), shape (M, N); psi_d even and psi_q odd in i_q.
        extrapolate: Whether results outside the data may be used; they are marked wherever they
            are.
        hull: Where the data are if not on the whole grid: the convex hull of the points it was made
            from.
        deviations: What is not known of the points, where that is stated.
        ripple: What they have beside these means over the rotor angle, where that is known.

    Raises:
        InputError: Too few points, an axis that does not ascend, a shape that does not fit, or a
            value that is not finite.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi_d: FloatArray
    psi_q: FloatArray
    extrapolate: bool = False
    hull: CurrentRegion | None = None
    deviations: MapDeviations | None = None
    ripple: FluxRipple | None = None
    _axes: tuple[_Axis, _Axis] = field(init=False, repr=False)
    _table: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the grid, own the arrays and compute the splines once."""
        for name in ("i_d", "i_q", "psi_d", "psi_q"):
            owned = owned_numbers(getattr(self, name), name)
            owned.flags.writeable = False
            object.__setattr__(self, name, owned)
        _check_grid(self.i_d, self.i_q, {"psi_d": self.psi_d, "psi_q": self.psi_q})
        both = np.stack([self.psi_d, self.psi_q], axis=2)  # (M, N, flux)
        along_q = np.moveaxis(
            _piecewise(self.i_q, np.moveaxis(both, 1, 0)), 2, 0
        )  # (M, power q, cell q, flux)
        cells = _piecewise(self.i_d, along_q)  # (power d, cell d, power q, cell q, flux)
        table = np.ascontiguousarray(np.transpose(cells, (1, 3, 2, 0, 4))).reshape(-1, 32)
        table.flags.writeable = False
        object.__setattr__(self, "_axes", (_Axis.of(self.i_d), _Axis.of(self.i_q)))
        object.__setattr__(self, "_table", table)

    def __repr__(self) -> str:
        """One line: how many points, and where."""
        ranges = (
            f"{name}={axis[0]:.6g}..{axis[-1]:.6g} A"
            for name, axis in (("i_d", self.i_d), ("i_q", self.i_q))
        )
        size = f"{self.i_d.size} x {self.i_q.size}"
        return f"FluxMap({size}, {', '.join(ranges)}, extrapolate={self.extrapolate})"

    def inside(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether currents in A lie where the data are, on the rectangle or in the hull,
        any broadcastable shapes.
        """
        if self.hull is not None:
            return self.hull.contains(i_d, i_q)
        within_d = (i_d >= self.i_d[0]) & (i_d <= self.i_d[-1])
        return np.asarray(within_d & (i_q >= self.i_q[0]) & (i_q <= self.i_q[-1]))

    @property
    def region(self) -> CurrentRegion:
        """Where the data are.

        Zero current belongs to it, even where the first points lie next to it.
        """
        if self.hull is not None:
            return self.hull
        return CurrentRegion.rectangle(float(self.i_d[0]), float(self.i_d[-1]), float(self.i_q[-1]))

    def rows(self, i_d: FloatArray) -> NDArray[np.intp]:
        """Cells of d currents in A, shape (n,), ascending.

        The first and the last lie outside the grid.
        """
        return self._axes[0].cells(i_d)

    def columns(self, i_q: FloatArray) -> NDArray[np.intp]:
        """Cells of q currents in A, shape (n,), likewise."""
        return self._axes[1].cells(i_q)

    def cell(self, row: int, column: int) -> tuple[FloatArray, float, float]:
        """Bicubic of one cell: coefficients by powers of q and d for (psi_d, psi_q), shape (4, 4,
        2), and its corner.

        The corner (i_d, i_q) in A is what the powers count from.
        """
        in_d, in_q = self._axes
        coefficients = self._table[row * in_q.corners.size + column].reshape(4, 4, 2)
        return coefficients, float(in_d.corners[row]), float(in_q.corners[column])

    def cubics(
        self, row: NDArray[np.intp], column: NDArray[np.intp]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Bicubics of many cells, all of shape (n,): as `cell`, coefficients of shape (4, 4, 2,
        n) and two corners.
        """
        in_d, in_q = self._axes
        rows = self._table.take(row * in_q.corners.size + column, axis=0)
        return (
            np.ascontiguousarray(rows.T).reshape(4, 4, 2, -1),
            in_d.corners[row],
            in_q.corners[column],
        )

    def _gather(
        self, i_d: FloatArray, i_q: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Coefficients by powers of q and d, shape (4, 4, 2, n), and the currents
        counted from the cells' corners.
        """
        in_d, in_q = self._axes
        row, column = in_d.cells(i_d), in_q.cells(i_q)
        local_d, local_q = i_d - in_d.corners[row], i_q - in_q.corners[column]
        row *= in_q.corners.size
        row += column
        rows = self._table.take(row, axis=0)
        return np.ascontiguousarray(rows.T).reshape(4, 4, 2, -1), local_d, local_q

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any broadcastable shapes."""
        shape, flat_d, flat_q = _flattened(i_d, i_q)
        psi = np.empty((2, flat_d.size))
        for start in range(0, flat_d.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            cubics, local_d, local_q = self._gather(flat_d[part], flat_q[part])
            psi[:, part] = _horner(_horner(cubics, local_q, 0)[0], local_d, 0)[0]
        return psi[0].reshape(shape), psi[1].reshape(shape)

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, any broadcastable
        shapes.
        """
        shape, flat_d, flat_q = _flattened(i_d, i_q)
        jet = np.empty((6, 2, flat_d.size))
        for start in range(0, flat_d.size, _CHUNK):
            part = slice(start, start + _CHUNK)
            cubics, local_d, local_q = self._gather(flat_d[part], flat_q[part])
            value, by_q, by_qq = _horner(cubics, local_q, 2)
            jet[0, :, part], jet[1, :, part], by_dd = _horner(value, local_d, 2)
            jet[2, :, part], jet[4, :, part] = _horner(by_q, local_d, 1)
            np.multiply(by_dd, 2.0, out=jet[3, :, part])
            np.multiply(_horner(by_qq, local_d, 0)[0], 2.0, out=jet[5, :, part])
        psi, by_d, by_q, by_dd, by_dq, by_qq = jet.reshape(6, 2, *shape)
        return FluxJet(
            psi_d=psi[0],
            psi_q=psi[1],
            l_dd=by_d[0],
            l_dq=by_q[0],
            l_qd=by_d[1],
            l_qq=by_q[1],
            d_dd=by_dd[0],
            d_dq=by_dq[0],
            d_qq=by_qq[0],
            q_dd=by_dd[1],
            q_dq=by_dq[1],
            q_qq=by_qq[1],
        )


@dataclass(frozen=True, slots=True, eq=False)
class TorqueRipple:
    """Torque beside its mean over the rotor angle, at constant currents.

    Args:
        orders: K orders per electrical turn.
        amplitudes: Of each order in N m, shape (K, N).
        peak_to_peak: Of all orders together in N m, shape (N,).
    """

    orders: tuple[float, ...]
    amplitudes: FloatArray
    peak_to_peak: FloatArray

    def over(self, torque: FloatArray) -> FloatArray:
        """Peak to peak over the magnitude of the mean, shape (N,); NaN where that is zero.

        Args:
            torque: Means in N m, shape (N,).
        """
        size = np.abs(torque)
        return self.peak_to_peak / np.where(size > 0.0, size, np.nan)


def swing(orders: FloatArray, period: float, series: FloatArray) -> FloatArray:
    """Peak to peak of Fourier series, shape (N,).

    Args:
        orders: K orders per electrical turn.
        period: Electrical angle in rad after which they repeat.
        series: Cosine and sine of each order, shape (K, 2, N).
    """
    turns = np.outer(np.arange(_ANGLES) * (period / _ANGLES), orders)
    course = np.einsum("tk,kn->tn", np.cos(turns), series[:, 0])
    course += np.einsum("tk,kn->tn", np.sin(turns), series[:, 1])
    return np.asarray(np.ptp(course, axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class FluxRipple:
    """Fourier series over the electrical angle theta of what a flux map has beside its means.

    ::

        psi(i, theta) = psi(i) + sum_k a_k(i) cos(k theta) + b_k(i) sin(k theta)
        T = p (3/2 (psi_d i_q - psi_q i_d) + dW'/dtheta)

    with the co-energy W' of the machine. Between the grid currents the
    coefficients are cubic splines, as the flux linkages are.

    Args:
        orders: K orders per electrical turn, ascending, at most `MOST_ORDERS`.
        period: Electrical angle in rad after which all repeats.
        cosine, sine: a and b of psi_d and psi_q in Wb, one map per order.
        torque: Coefficients of dW'/dtheta in N m per pole pair: of the cosine in the place of
            psi_d, of the sine in that of psi_q; one map per order.
    """

    orders: tuple[float, ...]
    period: float
    cosine: tuple[FluxMap, ...]
    sine: tuple[FluxMap, ...]
    torque: tuple[FluxMap, ...]

    def flux(
        self, i_d: FloatArray, i_q: FloatArray, theta: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Flux linkages in Wb beside their means at currents in A and electrical angles in rad,
        broadcastable shapes.
        """
        shape = np.broadcast(i_d, i_q, theta).shape
        psi_d, psi_q = np.zeros(shape), np.zeros(shape)
        for order, first, second in zip(self.orders, self.cosine, self.sine, strict=True):
            for wave, part in ((np.cos, first), (np.sin, second)):
                by_d, by_q = part.flux(i_d, i_q)
                psi_d += wave(order * theta) * by_d
                psi_q += wave(order * theta) * by_q
        return psi_d, psi_q

    def coefficients(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Cosine and sine of the torque per pole pair in N m at currents in A, (K, 2, N)."""
        found = np.empty((len(self.orders), 2, np.size(i_d)))
        for k, parts in enumerate(zip(self.cosine, self.sine, strict=True)):
            turning = self.torque[k].flux(i_d, i_q)
            for j, part in enumerate(parts):
                psi_d, psi_q = part.flux(i_d, i_q)
                found[k, j] = 1.5 * (psi_d * i_q - psi_q * i_d) + turning[j]
        return found

    def torque_ripple(self, pole_pairs: int, i_d: FloatArray, i_q: FloatArray) -> TorqueRipple:
        """Ripple of the torque at currents in A, shape (N,)."""
        found = pole_pairs * self.coefficients(i_d, i_q)
        largest = swing(np.array(self.orders), self.period, found)
        return TorqueRipple(self.orders, np.hypot(found[:, 0], found[:, 1]), largest)


def _flattened(i_d: FloatArray, i_q: FloatArray) -> tuple[tuple[int, ...], FloatArray, FloatArray]:
    """Common shape of two arrays of currents, and both as contiguous rows."""
    i_d, i_q = np.broadcast_arrays(
        np.asarray(i_d, dtype=np.float64), np.asarray(i_q, dtype=np.float64)
    )
    return i_d.shape, np.ascontiguousarray(i_d.ravel()), np.ascontiguousarray(i_q.ravel())


def _check_grid(i_d: FloatArray, i_q: FloatArray, fluxes: dict[str, FloatArray]) -> None:
    """Refuse grids that no spline can go through; raises `InputError`."""
    for name, axis in (("i_d", i_d), ("i_q", i_q)):
        if axis.ndim != 1 or axis.size < LEAST_POINTS:
            raise InputError(
                f"the flux map needs at least {LEAST_POINTS} different values of {name}, got "
                f"{axis.size}"
            )
        if not (np.all(np.isfinite(axis)) and np.all(np.diff(axis) > 0.0)):
            raise InputError(f"the flux map's {name} must be finite and ascend")
    shape = (i_d.size, i_q.size)
    for name, values in fluxes.items():
        if values.shape != shape:
            raise InputError(
                f"the flux map's {name} has the shape {values.shape}, its axes need {shape}"
            )
        if not np.all(np.isfinite(values)):
            row, column = np.argwhere(~np.isfinite(values))[0]
            where = f"i_d = {i_d[row]:g} A, i_q = {i_q[column]:g} A"
            raise InputError(
                f"the flux map's {name} has a hole at {where}; measure it or leave its row out"
            )


def complete_by_symmetry(
    i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Full plane from the half with i_q >= 0, or the symmetric part of a full plane.

    ``i_q`` ascends, shape (N,); ``psi_d``, ``psi_q`` have the shape (M, N). A half plane begins at
    i_q = 0 and is mirrored, psi_d even and psi_q odd; a full plane with a symmetric axis is
    averaged with its mirror image.

    Raises:
        InputError: The axis neither begins at 0 nor is symmetric about it.
    """
    scale = float(np.max(np.abs(i_q)))
    if abs(float(i_q[0])) <= 1e-9 * scale:
        axis = np.concatenate([-i_q[:0:-1], i_q])
        odd = np.concatenate([-psi_q[:, :0:-1], 0.0 * psi_q[:, :1], psi_q[:, 1:]], axis=1)
        return axis, np.concatenate([psi_d[:, :0:-1], psi_d], axis=1), odd
    if np.max(np.abs(i_q + i_q[::-1])) > 1e-6 * scale:
        raise InputError(
            f"i_q must begin at 0 or be symmetric about 0, got {i_q[0]:g} to {i_q[-1]:g} A"
        )
    axis = 0.5 * (i_q - i_q[::-1])
    return axis, 0.5 * (psi_d + psi_d[:, ::-1]), 0.5 * (psi_q - psi_q[:, ::-1])


def mirrored(flux_map: FluxMap) -> FluxMap:
    """The map of the machine with i_q, psi_q and the torque counted the other way.

    Args:
        flux_map: Flux linkages over the currents of a machine.
    """
    return FluxMap(
        flux_map.i_d,
        -flux_map.i_q[::-1],
        flux_map.psi_d[:, ::-1],
        -flux_map.psi_q[:, ::-1],
        flux_map.extrapolate,
        flux_map.hull,
    )


# Many machines over one flux map: each with its own magnet, inductances and saturation current.
#
# A tolerance of a saturated machine is a change of its map. With psi_0 the open-circuit flux
# linkage of the map and i' = i / current::
#
#     psi_d(i) = current (magnet psi_0 + inductance_d (psi_d'(i') - psi_0)),
#     psi_q(i) = current inductance_q psi_q'(i')
#
# is the map of a machine whose magnet, whose d and q inductances and whose current of saturation
# differ by those factors; ``current`` scales flux linkage and current alike, so that the
# inductances stay. Where the d and q factors differ, cross-coupled maps lose their reciprocity by
# as much.


@dataclass(frozen=True, slots=True, eq=False)
class ScaledMachines(FluxFormulas):
    """N machines over the flux map of one; columns of shape (N,).

    As with `MachineBatch`, the last axis of currents is that of the machines.

    Args:
        nominal: The machine whose map is scaled; pole pairs, inertia, friction and speed are its
            own.
        magnet, inductance_d, inductance_q, current: Factors of the open-circuit flux linkage, of
            the flux linkage that d and q currents make, and of the current at which it saturates.
        r_s: Phase resistances in Ohm.
        i_max: Largest permitted currents in A, peak of phase.

    Raises:
        InputError: Columns of different lengths, or a value that is not positive: names column and
            row.
    """

    nominal: SaturatedMachine
    magnet: FloatArray
    inductance_d: FloatArray
    inductance_q: FloatArray
    current: FloatArray
    r_s: FloatArray
    i_max: FloatArray

    def __post_init__(self) -> None:
        """Own the columns and refuse what no machine has."""
        names = [part.name for part in fields(self)[1:]]
        shape = np.shape(self.magnet)
        for name in names:
            owned = np.array(getattr(self, name), dtype=np.float64)
            if owned.ndim != 1 or owned.shape != shape:
                raise InputError(
                    f"machines: {name} has the shape {owned.shape}, magnet {shape}; every column "
                    "needs one value per machine"
                )
            least = owned >= 0.0 if name in ("magnet", "r_s") else owned > 0.0
            wrong = ~(least & np.isfinite(owned))
            if np.any(wrong):
                row = int(np.argmax(wrong))
                raise InputError(
                    f"machines: {name} of machine {row} is {owned[row]:g}; expected a positive "
                    "number"
                )
            owned.flags.writeable = False
            object.__setattr__(self, name, owned)

    @classmethod
    def varied(
        cls, nominal: SaturatedMachine, count: int, columns: Mapping[str, ArrayLike]
    ) -> ScaledMachines:
        """One machine ``count`` times, but for the ``columns`` given: by name, shape (count,)."""
        base = {part.name: 1.0 for part in fields(cls)[1:]}
        base |= {"r_s": nominal.r_s, "i_max": nominal.i_max}
        unknown = sorted(set(columns) - set(base))
        if unknown:
            raise InputError(f"machines: no column {unknown[0]}; there are {', '.join(base)}")
        whole = {
            name: np.asarray(columns[name], dtype=np.float64)
            if name in columns
            else np.full(count, value)
            for name, value in base.items()
        }
        return cls(nominal, **whole)

    @property
    def count(self) -> int:
        """Number of machines N."""
        return int(self.magnet.size)

    @property
    def pole_pairs(self) -> int:
        """Number of pole pairs p, of all."""
        return self.nominal.pole_pairs

    @property
    def friction(self) -> float:
        """Viscous friction in N m s/rad, of all."""
        return self.nominal.friction

    def taken(self, rows: IndexArray | BoolArray) -> ScaledMachines:
        """The machines of some rows, by their places or by a mask, in that order."""
        columns = {part.name: getattr(self, part.name)[rows] for part in fields(self)[1:]}
        return ScaledMachines(self.nominal, **columns)

    def repeated(self, count: int) -> ScaledMachines:
        """Each machine ``count`` times in a row: one per point of a list, machine by machine."""
        return self.taken(np.repeat(np.arange(self.count), count))

    def machine(self, row: int) -> SaturatedMachine:
        """One of the machines, with a map of its own."""
        flux_map, k = self.nominal.flux_map, float(self.current[row])
        hull = flux_map.hull
        if hull is not None:
            hull = CurrentRegion(k * hull.corner_d, k * hull.corner_q)
        whole = self._flux(flux_map.psi_d, flux_map.psi_q, np.array([row]))
        own = FluxMap(k * flux_map.i_d, k * flux_map.i_q, *whole, flux_map.extrapolate, hull)
        return SaturatedMachine(
            self.pole_pairs,
            float(self.r_s[row]),
            own,
            float(self.i_max[row]),
            self.nominal.inertia,
            self.friction,
            self.nominal.omega_m_max,
        )

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, shape (..., N)."""
        found = self.nominal.flux_map.flux(i_d / self.current, i_q / self.current)
        return self._flux(*found, np.arange(self.count))

    def _flux(
        self, psi_d: FloatArray, psi_q: FloatArray, rows: IndexArray
    ) -> tuple[FloatArray, FloatArray]:
        """Flux linkages of the map as those of machines."""
        own, k = self.nominal.psi_pm, self.current[rows]
        magnet, d, q = self.magnet[rows], self.inductance_d[rows], self.inductance_q[rows]
        # Written so that scales of 1 leave every digit of the map.
        return k * ((magnet - d) * own + d * psi_d), k * (q * psi_q)

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, shape (..., N)."""
        jet = self.nominal.flux_map.jet(i_d / self.current, i_q / self.current)
        psi_d, psi_q = self._flux(jet.psi_d, jet.psi_q, np.arange(self.count))
        # Flux linkage and current scale alike: the inductances do not, their slopes inversely.
        d, q = self.inductance_d, self.inductance_q
        bend_d, bend_q = d / self.current, q / self.current
        return FluxJet(
            psi_d=psi_d,
            psi_q=psi_q,
            l_dd=d * jet.l_dd,
            l_dq=d * jet.l_dq,
            l_qd=q * jet.l_qd,
            l_qq=q * jet.l_qq,
            d_dd=bend_d * jet.d_dd,
            d_dq=bend_d * jet.d_dq,
            d_qq=bend_d * jet.d_qq,
            q_dd=bend_q * jet.q_dd,
            q_dq=bend_q * jet.q_dq,
            q_qq=bend_q * jet.q_qq,
        )

    def known(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether the map has data at currents in A, shape (..., N)."""
        return self.nominal.flux_map.inside(i_d / self.current, i_q / self.current)


# Saturated machines: the machine behind a flux map, and its inductances at a current.

# Current over the largest of the grid below which a quotient of differences loses more digits than
# its series.
_SMALL_CURRENT = 1e-5


@dataclass(frozen=True, slots=True)
class SaturatedMachine(MachineFormulas):
    """A machine whose flux linkages are a map.

    Parameters as in `LinearMachine`, but for ``flux_map``.
    """

    pole_pairs: int
    r_s: float
    flux_map: FluxMap
    i_max: float
    inertia: float | None = None
    friction: float = 0.0
    omega_m_max: float | None = None
    _origin: FluxJet = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Check every number, and keep the values at zero current."""
        check_numbers(self, MACHINE)
        if not isinstance(self.flux_map, FluxMap):
            got = type(self.flux_map).__name__
            raise InputError(f"flux_map: expected a FluxMap, got {got}; make one by make_flux_map")
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
        """Flux linkages with two derivatives at currents in A, arrays of shape (N,)."""
        return self.flux_map.jet(i_d, i_q)

    def known(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether currents in A lie on the map, any one shape."""
        return self.flux_map.inside(i_d, i_q)

    @property
    def region(self) -> CurrentRegion | None:
        """Where the data of the map are, None where it may be left."""
        return None if self.flux_map.extrapolate else self.flux_map.region


@dataclass(frozen=True, slots=True)
class Inductances:
    """Inductances at operating points, arrays of the shape of the currents.

    Incremental, in H: ``l_dd`` = d psi_d/d i_d, ``l_dq`` = d psi_d/d i_q, ``l_qd`` = d psi_q/d i_d,
    ``l_qq`` = d psi_q/d i_q. Apparent: psi_d = ``psi_m`` + ``l_d`` i_d and psi_q = ``l_q`` i_q,
    with ``psi_m`` (Wb) the d flux linkage at i_d = 0 and the same i_q; at zero current they pass
    into the incremental ones.
    """

    l_dd: FloatArray
    l_dq: FloatArray
    l_qd: FloatArray
    l_qq: FloatArray
    psi_m: FloatArray
    l_d: FloatArray
    l_q: FloatArray


def inductances(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> Inductances:
    """Incremental and apparent inductances of any machine at currents in A, shape (N,).

    Args:
        machine: Any machine.
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    here = machine.jet(i_d, i_q)
    at_no_d, at_no_q = machine.jet(np.zeros_like(i_d), i_q), machine.jet(i_d, np.zeros_like(i_q))
    small = _SMALL_CURRENT * machine.i_max
    return Inductances(
        here.l_dd,
        here.l_dq,
        here.l_qd,
        here.l_qq,
        at_no_d.psi_d,
        _quotient(here.psi_d - at_no_d.psi_d, i_d, at_no_d.l_dd + 0.5 * at_no_d.d_dd * i_d, small),
        _quotient(here.psi_q, i_q, at_no_q.l_qq + 0.5 * at_no_q.q_qq * i_q, small),
    )


def _quotient(
    flux: FloatArray, current: FloatArray, series: FloatArray, small: float
) -> FloatArray:
    """Flux over current, or the series about zero current where the quotient has no digits."""
    tiny = np.abs(current) < small
    return np.where(tiny, series, flux / np.where(tiny, 1.0, current))


def ripple_of_map(machine: Machine) -> FluxRipple | None:
    """What turns with the rotor of a machine with a flux map, None where its data know nothing."""
    return machine.flux_map.ripple if isinstance(machine, SaturatedMachine) else None


def torque_ripple(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> TorqueRipple | None:
    """Ripple of the torque of a machine, None where its data know none.

    Args:
        machine: Any machine.
        i_d, i_q: Currents in A (peak), shape (N,).
    """
    ripple = ripple_of_map(machine)
    return None if ripple is None else ripple.torque_ripple(machine.pole_pairs, i_d, i_q)
