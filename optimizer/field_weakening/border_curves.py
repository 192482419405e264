"""Piecewise polynomials of one variable beneath a two-dimensional reference: MTPA currents,
their flux, the limit.

Functions of powers u^k and truncated powers (u - b)_+^k are continuous at every
breakpoint b by construction.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.polynomial import Polynomial

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.curves.two_family_levelling import Aims, level
from dqforge.optimizer.field_weakening.exact import WeakeningRegion
from dqforge.optimizer.linear_programme import least_cost

# Segments and degree in the order of their number of coefficients.
_SHAPES = (
    (1, 2),
    (1, 3),
    (1, 4),
    (1, 5),
    (2, 3),
    (1, 6),
    (2, 4),
    (2, 5),
    (3, 4),
    (2, 6),
    (3, 5),
    (4, 5),
    (4, 6),
)

# Powers by which breakpoints crowd towards the start, where roots are steep, or towards the end,
# next to which MTPV may give way to the current limit.
_SPACINGS = (1.0, 2.0, 3.0, 0.5, 0.3)
_POINTS = 601

# Permitted deviation of an MTPA current: share of itself plus share of the limit. It costs next to
# no loss.
_CURRENT_SHARES = 0.02, 0.02

# Least rise of the torque limit over its domain, over the largest torque: between the points it
# falls nowhere.
_LEAST_SLOPE = 1e-4

# Permitted error of the flux linkage of MTPA points below the least one: shares of that and of the
# distance from it.
_BELOW = 0.1, 0.8

# Share of the current limit between neighbours of `_POINTS` that is a jump of MTPA currents.
_JUMP = 0.1

# Share of the least flux linkage from which the flux linkage of an MTPA point matters.
_NEAR = 0.97


@dataclass(frozen=True, slots=True)
class Mtpa:
    """MTPA currents in A and their flux linkage in Wb over the torque in N m,
    on the same segments.
    """

    d: SinglePolynomial
    q: SinglePolynomial
    flux: SinglePolynomial


def in_double(polynomial: SinglePolynomial, argument: FloatArray) -> FloatArray:
    """Value of the rounded coefficients in double, arguments of shape (N,)."""
    edges = np.append(polynomial.starts.astype(np.float64), np.inf)
    return PiecewisePolynomial(edges, polynomial.coefficients.astype(np.float64))(argument)


def _edges(segments: int, spacing: float) -> FloatArray:
    edges: FloatArray = (np.arange(segments + 1) / segments) ** spacing
    return edges


def _functions(share: FloatArray, edges: FloatArray, degree: int) -> FloatArray:
    """Powers and truncated powers without a constant, shape (N, S n)."""
    power = np.arange(1, degree + 1)
    columns = [np.maximum(share - start, 0.0)[:, np.newaxis] ** power for start in edges[:-1]]
    return np.concatenate(columns, axis=1)


def _segments(
    constant: float, weights: FloatArray, edges: FloatArray, degree: int, end: float
) -> SinglePolynomial:
    """The sum of `_functions` as local powers of the argument itself, in single precision."""
    terms = [Polynomial([0.0, *row]) for row in weights.reshape(edges.size - 1, degree)]
    rows = np.zeros((edges.size - 1, degree + 1))
    for segment in range(edges.size - 1):
        total = Polynomial([constant])
        for start, term in zip(edges[: segment + 1], terms, strict=False):
            total = total + term(Polynomial([edges[segment] - start, 1.0]))
        rows[segment, : total.coef.size] = total.coef
    scaled = (
        rows / end ** np.arange(degree + 1) + 0.0
    )  # no negative zeros: C adds what the model leaves out
    return SinglePolynomial((edges[:-1] * end).astype(np.float32), scaled.astype(np.float32))


def _slopes(share: FloatArray, edges: FloatArray, degree: int) -> FloatArray:
    """Derivatives of `_functions`, shape (N, S n)."""
    power = np.arange(1, degree + 1)
    columns = []
    for start in edges[:-1]:
        local = np.maximum(share - start, 0.0)[:, np.newaxis]
        columns.append(np.where(share[:, np.newaxis] >= start, power * local ** (power - 1), 0.0))
    return np.concatenate(columns, axis=1)


def _level_curve(
    functions: FloatArray, target: FloatArray, unit: FloatArray, *, rising: FloatArray | None = None
) -> tuple[FloatArray, float]:
    """Constant and weights with the least largest |error| / unit (a linear programme).

    With ``rising``, the derivatives of the functions, that of a curve from
    below that rises everywhere.
    """
    # In units of what is permitted, so that the tolerance of the solver is a share of that.
    columns = np.column_stack([np.ones(target.size), functions]) / unit[:, np.newaxis]
    one, wanted = np.ones((target.size, 1)), target / unit
    room = -one if rising is None else 0.0 * one
    rows, most = np.block([[columns, room], [-columns, -one]]), np.append(wanted, -wanted)
    if rising is not None:
        nothing = np.zeros((rising.shape[0], 1))
        rows = np.vstack([rows, np.column_stack([nothing, -rising, nothing])])
        most = np.append(most, np.full(rising.shape[0], -_LEAST_SLOPE * float(np.max(target))))
    cost = np.append(np.zeros(columns.shape[1]), 1.0)
    found = least_cost(cost, rows, most, orthogonal=True)
    if found is None:  # a constant below everything always fulfils the rows
        raise AssertionError
    return found[:-1], float(found[-1])


def fit_limit(region: WeakeningRegion, permitted: float) -> SinglePolynomial:
    """Largest torque in N m over the available flux linkage less ``flux_min``,
    from below within ``permitted`` N m.

    Raises:
        NoSolutionError: No shape comes that close.
    """
    span = region.flux_max - region.flux_min
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, _POINTS))
    most = region.largest_torque(region.flux_min + span * share)
    # Room for rounding; a torque below zero is of no use to anybody.
    target = np.maximum(most - 1e-5 * region.torque_max, 0.0)
    unit = np.full(_POINTS, permitted)
    for segments, degree in _SHAPES:
        for spacing in _SPACINGS[: 1 if segments == 1 else None]:
            edges = _edges(segments, spacing)
            rising = _slopes(share, edges, degree)
            weights, worst = _level_curve(
                _functions(share, edges, degree), target, unit, rising=rising
            )
            if worst <= 1.0:
                return _segments(float(weights[0]), weights[1:], edges, degree, span)
    raise NoSolutionError(
        "field_weakening: the largest torque over the flux linkage is too steep for 4 segments; "
        "lower the speed"
    )


def _fit_currents(
    region: WeakeningRegion,
    share: FloatArray,
    exact: tuple[FloatArray, FloatArray],
    permitted: tuple[float, float],
) -> Callable[[int, int, float], tuple[SinglePolynomial, SinglePolynomial, float]]:
    """Function of segments, degree and spacing: MTPA currents with the error that is left."""
    torque_unit, flux_unit = permitted
    flux = region.flux(*exact)
    zero = np.zeros_like(share)
    own, limit = _CURRENT_SHARES
    aims = Aims(
        region.machine,
        share * region.torque_max,
        zero + 1.0 / torque_unit,
        flux,
        np.where(flux >= _NEAR * region.flux_min, 1.0 / (flux_unit * np.maximum(flux, 1e-9)), 0.0),
        *exact,
        1.0 / (own * np.hypot(*exact) + limit * region.i_max),
        region.i_max,
        0.0,
    )

    def fit(
        segments: int, degree: int, spacing: float
    ) -> tuple[SinglePolynomial, SinglePolynomial, float]:
        edges = _edges(segments, spacing)
        functions = _functions(share, edges, degree)
        found = level(aims, (zero, zero), functions, functions, region.i_max)
        d, q = (
            _segments(0.0, weights, edges, degree, region.torque_max)
            for weights in (found.d, found.q)
        )
        return d, q, found.worst

    return fit


def fit_mtpa(region: WeakeningRegion, torque_error: float, flux_error: float) -> Mtpa:
    """MTPA currents and their flux linkage, the torque within ``torque_error`` N m,
    the flux linkage relative.

    Raises:
        NoSolutionError: No shape comes that close, or the currents jump.
    """
    share = np.linspace(0.0, 1.0, _POINTS) ** 2
    exact = region.mtpa(share * region.torque_max)
    _refuse_a_jump(region, share * region.torque_max, exact)
    fit = _fit_currents(region, share, exact, (torque_error, 0.5 * flux_error))
    for segments, degree in _SHAPES:
        for spacing in _SPACINGS[: 1 if segments == 1 else None]:
            d, q, worst = fit(segments, degree, spacing)
            if worst > 1.0:
                continue
            torque = share * region.torque_max
            taken = region.flux(in_double(d, torque), in_double(q, torque))
            # Below the least flux linkage it counts only that the curve stays there, too.
            room = np.minimum(_BELOW[0] * region.flux_min, _BELOW[1] * (region.flux_min - taken))
            unit = np.maximum(0.5 * flux_error * taken, room)
            edges = _edges(segments, spacing)
            weights, worst = _level_curve(_functions(share, edges, degree), taken, unit)
            if worst <= 1.0:
                return Mtpa(
                    d,
                    q,
                    _segments(float(weights[0]), weights[1:], edges, degree, region.torque_max),
                )
    raise NoSolutionError(
        "field_weakening: the MTPA currents bend too sharply for 4 segments of degree 6"
    )


def _refuse_a_jump(
    region: WeakeningRegion, torque: FloatArray, exact: tuple[FloatArray, FloatArray]
) -> None:
    i_d, i_q = exact
    steps = np.hypot(np.diff(i_d), np.diff(i_q))
    place = int(np.argmax(steps))
    if steps[place] < _JUMP * region.i_max:
        return
    before, after = (f"({i_d[at]:.4g}, {i_q[at]:.4g}) A" for at in (place, place + 1))
    raise NoSolutionError(
        f"field_weakening: at {torque[place]:.4g} N m the currents of least loss jump from "
        f"{before} to {after}, which no continuous reference follows; lower max_current until "
        "they make less torque than that, or correct the flux data"
    )
