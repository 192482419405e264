"""Table 2 of paper 000 by the method that the paper states, its Figures 2 to 4, and how far the
printed coefficients are from it.

The method: Lagrange on the sigma + 1 Chebyshev nodes of each segment in per unit, (20) to (29) and
(31), then multiplied by i_base / T_base^k. The paper prints (39) without the powers of the magnet
flux that this has.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import SideConditions, fit_curve, squared_error_integral
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.operating_points.mtpa import mtpa_currents, mtpa_per_unit, per_unit_base
from dqforge.reports.papers.paper000.ipmsm_tables import PRINTED_TABLE_1, PRINTED_TABLE_2

DOMAIN = 5.0  # End of the per-unit torque domain.
CURVE_END = 250.0  # Largest torque in N m of Figure 4.

# Largest error of degree 2 in A, and its share of the reference (section 7.2).
STATED_LARGEST, STATED_SHARE = 1.09, 0.0153

# From this share on a coefficient is marked: 5 %, beyond three printed digits and the identified
# machine.
DIFFERS = 0.05
_FREE = SideConditions(exact_at_zero=False, continuous=False)
_MAP_POINTS = 61


@dataclass(frozen=True, slots=True)
class Segment:
    """Coefficients of one segment of one axis, highest power first, in A/(N m)^k.

    ``largest`` in A is how far the two polynomials are apart within the segment up to 250 N m.
    """

    axis: str
    degree: int
    segment: int
    printed: tuple[float, ...]
    stated: tuple[float, ...]
    largest: float

    @property
    def marked(self) -> tuple[bool, ...]:
        """Whether each printed coefficient is off what the stated method gives."""
        return tuple(
            abs(printed - stated) > DIFFERS * abs(stated)
            for printed, stated in zip(self.printed, self.stated, strict=True)
        )


@dataclass(frozen=True, slots=True, eq=False)
class ErrorCurve:
    """Figure 4: a degree's currents and errors over the torque, by the printed coefficients and by
    the stated method, in A over N m.

    ``largest`` and ``share`` are the largest error of the printed ones on either axis and what
    share of the reference it is there, at ``place`` in N m on ``axis``.
    """

    degree: int
    torque: FloatArray
    exact: dict[str, FloatArray]
    printed: dict[str, FloatArray]
    stated: dict[str, FloatArray]
    largest: float
    share: float
    place: float
    axis: str


@dataclass(frozen=True, slots=True, eq=False)
class ErrorMap:
    """Figure 3: reduction of epsilon in % over both breakpoints in per unit, shape (N, N): rows by
    phi_d, columns by phi_q.
    """

    degree: int
    points: FloatArray
    reduction: FloatArray
    best: tuple[float, float]
    printed: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class StatedMethod:
    """All of it."""

    segments: tuple[Segment, ...]
    errors: tuple[ErrorCurve, ...]
    maps: tuple[ErrorMap, ...]


def curve_of(axis: str, torque: FloatArray) -> FloatArray:
    """MTPA current of an axis in per unit."""
    return mtpa_per_unit(torque)["dq".index(axis)]


def edges_of(axis: str, degree: int) -> FloatArray:
    """Segment limits in per unit with the paper's breakpoint."""
    return np.array([0.0, PRINTED_TABLE_1[degree]["dq".index(axis)], DOMAIN])


def stated_polynomial(
    axis: str, degree: int, edges: FloatArray | None = None
) -> PiecewisePolynomial:
    """The paper's method on given edges, or on its own, in per unit."""
    where = edges_of(axis, degree) if edges is None else edges
    return fit_curve(lambda torque: curve_of(axis, torque), where, degree, "lagrange", _FREE)


def in_powers(fit: PiecewisePolynomial, segment: int) -> FloatArray:
    """Ascending coefficients of a segment in the torque itself, not from its start, shape
    (n + 1,).
    """
    shift = np.polynomial.Polynomial([-float(fit.edges[segment]), 1.0])
    found = np.zeros(fit.degree + 1)
    series = np.polynomial.Polynomial(fit.coefficients[segment])(shift).coef
    found[: series.size] = series
    return found


def printed_currents(axis: str, degree: int, torque: FloatArray, base: float) -> FloatArray:
    """The printed polynomials in A at torques in N m, with the base torque in N m."""
    first, second = PRINTED_TABLE_2[axis, degree]
    limit = PRINTED_TABLE_1[degree]["dq".index(axis)] * base
    return np.where(torque < limit, np.polyval(first, torque), np.polyval(second, torque))


def _segments(machine: LinearMachine) -> tuple[Segment, ...]:
    base = per_unit_base(machine)
    found = []
    for (axis, degree), rows in PRINTED_TABLE_2.items():
        fit, edges = stated_polynomial(axis, degree), edges_of(axis, degree) * base.torque
        scale = base.current / base.torque ** np.arange(degree + 1)
        for k, printed in enumerate(rows):
            stated = (in_powers(fit, k) * scale)[::-1]
            inside = np.linspace(edges[k], min(float(edges[k + 1]), CURVE_END), 2001)
            apart = np.max(np.abs(np.polyval(printed, inside) - np.polyval(stated, inside)))
            found.append(Segment(axis, degree, k, printed, tuple(stated.tolist()), float(apart)))
    return tuple(found)


def _error_curve(machine: LinearMachine, degree: int) -> ErrorCurve:
    base = per_unit_base(machine)
    torque = np.linspace(0.0, CURVE_END, 2501)
    exact = dict(zip("dq", mtpa_currents(machine, torque), strict=True))
    printed = {axis: printed_currents(axis, degree, torque, base.torque) for axis in "dq"}
    stated = {
        axis: base.current * stated_polynomial(axis, degree)(torque / base.torque) for axis in "dq"
    }
    gaps = {axis: np.abs(printed[axis] - exact[axis]) for axis in "dq"}
    axis = max("dq", key=lambda name: float(np.max(gaps[name])))
    place = int(np.argmax(gaps[axis]))
    largest = float(gaps[axis][place])
    share = largest / abs(float(exact[axis][place]))
    return ErrorCurve(
        degree, torque, exact, printed, stated, largest, share, float(torque[place]), axis
    )


def _error_map(degree: int) -> ErrorMap:
    points = np.linspace(0.4, 4.2, _MAP_POINTS)

    def epsilon(axis: str, *inner: float) -> float:
        fit = stated_polynomial(axis, degree, np.array([0.0, *inner, DOMAIN]))
        return squared_error_integral(lambda torque: curve_of(axis, torque), fit)

    whole = epsilon("d") + epsilon("q")
    d, q = (np.array([epsilon(axis, float(phi)) for phi in points]) for axis in "dq")
    reduction = 100.0 * (1.0 - (d[:, np.newaxis] + q) / whole)
    best = (float(points[np.argmin(d)]), float(points[np.argmin(q)]))
    return ErrorMap(degree, points, reduction, best, PRINTED_TABLE_1[degree][:2])


def by_stated_method(machine: LinearMachine) -> StatedMethod:
    """Coefficients, error curves and maps of all three degrees."""
    degrees = tuple(PRINTED_TABLE_1)
    return StatedMethod(
        _segments(machine),
        tuple(_error_curve(machine, degree) for degree in degrees),
        tuple(_error_map(degree) for degree in degrees),
    )
