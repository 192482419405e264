"""Current references over torque and available flux linkage as the firmware evaluates them,
and their errors.

The evaluator is the list of float32 operations that the header spells out, so that the errors
stated for it are those of the very arithmetic that runs.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, torque_from_flux
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.current_reference.forms import PENALTY_FROM
from dqforge.optimizer.curves.single_precision import (
    PiecewisePolynomial,
    SingleArray,
    SinglePolynomial,
    compiled,
)
from dqforge.optimizer.linear_programme import least_cost
from dqforge.optimizer.operating_points.mtpa_locus import Active, mtpa_locus, region_that_holds
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq

# Levelling of torque and flux errors over two linear families of currents: Gauss-Newton steps in a
# rising p-norm.
#
# The largest of many errors is brought down, each in units of what is permitted for it. Currents
# themselves are no aim: next to MTPV many of them make nearly the same torque at the same flux
# linkage, and only those two count.

_LARGEST_NORM = 14.0
_STEPS = 36

# Weight that holds steps along which neither torque nor flux change, per current limit.
_DAMPING = 0.01


@dataclass(frozen=True, slots=True)
class Aims:
    """What the currents at N points are to make, arrays of shape (N,).

    ``torque`` in N m and ``flux`` in Wb with the reciprocals of their permitted errors; ``i_d`` and
    ``i_q`` in A with ``per_current``; the current stays below ``i_max`` A with ``per_excess``. A
    reciprocal of 0 leaves that aim out.
    """

    machine: Machine
    torque: FloatArray
    per_torque: FloatArray
    flux: FloatArray
    per_flux: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    per_current: FloatArray
    i_max: float
    per_excess: float

    def errors(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Errors in units of the permitted ones, shape (5, N), and their derivatives by i_d and by
        i_q.
        """
        jet, factor = self.machine.jet(i_d, i_q), 1.5 * self.machine.pole_pairs
        torque = factor * (jet.psi_d * i_q - jet.psi_q * i_d)
        flux = np.maximum(np.hypot(jet.psi_d, jet.psi_q), 1e-300)
        zero = np.zeros_like(i_d)
        current = np.maximum(np.hypot(i_d, i_q), 1e-300)
        beyond = np.maximum(current - self.i_max, 0.0)
        errors = (torque - self.torque, flux - self.flux, i_d - self.i_d, i_q - self.i_q, beyond)
        by_d = (
            factor * (jet.l_dd * i_q - jet.psi_q - jet.l_qd * i_d),
            (jet.psi_d * jet.l_dd + jet.psi_q * jet.l_qd) / flux,
            zero + 1.0,
            zero,
            np.where(beyond > 0.0, i_d / current, 0.0),
        )
        by_q = (
            factor * (jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d),
            (jet.psi_d * jet.l_dq + jet.psi_q * jet.l_qq) / flux,
            zero,
            zero + 1.0,
            np.where(beyond > 0.0, i_q / current, 0.0),
        )
        units = np.stack(
            [
                self.per_torque,
                self.per_flux,
                self.per_current,
                self.per_current,
                zero + self.per_excess,
            ]
        )
        return units * np.stack(errors), units * np.stack(by_d), units * np.stack(by_q)


@dataclass(frozen=True, slots=True)
class Levelled:
    """Coefficients of both families, shapes (A,) and (B,), and the largest error in
    units of the permitted one.
    """

    d: FloatArray
    q: FloatArray
    worst: float


def level(
    aims: Aims,
    base: tuple[FloatArray, FloatArray],
    family_d: FloatArray,
    family_q: FloatArray,
    scale: float,
) -> Levelled:
    """Coefficients with the least largest error (nearly), from the least-squares fit of the
    currents.

    Args:
        aims: What is to be met at N points.
        base: Currents in A to which the families add, shape (N,) each.
        family_d, family_q: Values of the functions of each family at the points, shapes (N, A) and
            (N, B), of full rank.
        scale: Current in A that steps are measured by.
    """
    basis_d, triangle_d = np.linalg.qr(family_d)
    basis_q, triangle_q = np.linalg.qr(family_q)
    # In an orthonormal basis the first fit is a projection, and normal equations lose no digits.
    both = np.concatenate([basis_d.T @ (aims.i_d - base[0]), basis_q.T @ (aims.i_q - base[1])])
    split = basis_d.shape[1]

    def errors(weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return aims.errors(base[0] + basis_d @ weights[:split], base[1] + basis_q @ weights[split:])

    now, by_d, by_q = errors(both)
    best, worst = both, float(np.max(np.abs(now)))
    for step in range(_STEPS):
        norm = min(2.0 + step, _LARGEST_NORM)
        largest = float(np.max(np.abs(now)))
        if largest == 0.0:
            break
        share = np.maximum(np.abs(now) / largest, 1e-3) ** (norm - 2.0)
        slope_d, slope_q = np.sum(share * by_d * now, axis=0), np.sum(share * by_q * now, axis=0)
        gradient = np.concatenate([basis_d.T @ slope_d, basis_q.T @ slope_q])
        cross = basis_d.T @ (np.sum(share * by_d * by_q, axis=0)[:, np.newaxis] * basis_q)
        normal = np.block(
            [
                [basis_d.T @ (np.sum(share * by_d**2, axis=0)[:, np.newaxis] * basis_d), cross],
                [cross.T, basis_q.T @ (np.sum(share * by_q**2, axis=0)[:, np.newaxis] * basis_q)],
            ]
        )
        normal[np.diag_indices_from(normal)] += (_DAMPING / scale) ** 2
        direction = -np.linalg.solve(normal, gradient)
        length = 1.0 / (norm - 1.0)
        before = float(np.sum((np.abs(now) / largest) ** norm))
        for _ in range(6):
            trial = both + length * direction
            tried = errors(trial)
            if float(np.sum((np.abs(tried[0]) / largest) ** norm)) <= before:
                break
            length *= 0.5
        both, (now, by_d, by_q) = trial, tried
        if float(np.max(np.abs(now))) < worst:
            best, worst = both, float(np.max(np.abs(now)))
    return Levelled(
        np.linalg.solve(triangle_d, best[:split]), np.linalg.solve(triangle_q, best[split:]), worst
    )


# Current references over torque and available flux linkage as the firmware evaluates them, and
# their errors.
#
# The evaluator is the list of float32 operations that the header spells out, so that the errors
# stated for it are those of the very arithmetic that runs.

# Code and literals of the emitted evaluator on a Cortex-M4F: fixed part, and per coefficient (its
# load, its product, its sum and the literal itself). Above what gcc 12 makes with -O2 and without
# fused multiply-add; -Os saves a third.
_BYTES = 260, 18


@dataclass(frozen=True, slots=True)
class SingleSurface:
    """A polynomial in two variables with float32 coefficients: ``rows[j]`` holds
    rising powers of x beside y^j.
    """

    rows: tuple[SingleArray, ...]

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return sum(row.size for row in self.rows)

    def evaluate(self, o: Arithmetic, name: str, x: Reals, y: Reals) -> Any:
        """Value at arguments of any shape: Horner's rule in y over Horner's rule in x.

        ``name`` stands before the number of each sum.
        """
        last = len(self.rows) - 1
        value = self._row(o, last, x)
        for power in range(last - 1, -1, -1):
            above = o.let(f"{name}{power + 1}", value)
            value = o.multiply_add(above, y, self._row(o, power, x))
        return value

    def _row(self, o: Arithmetic, power: int, x: Reals) -> Any:
        *rest, value = (float(coefficient) for coefficient in self.rows[power])
        found: Any = value
        for coefficient in rest[::-1]:
            found = o.multiply_add(found, x, coefficient)
        return found


@dataclass(frozen=True, slots=True)
class WeakeningReference:
    """i_d and i_q in A over torque in N m and available flux linkage in Wb.

    t = min(|T|, ``limit``(a - ``flux_min``)); delta = ``flux``(t) - a is what the MTPA currents
    ``d``(t), ``q``(t) take too much; where it is positive, i_d = d(t) + delta D(x, y) and i_q =
    q(t) + delta t Q(x, y) with x = t - ``torque_mid``, y = delta - ``excess_mid``. Both are
    continuous across delta = 0, and i_q(0) = 0, whatever the coefficients. ``d``, ``q`` and
    ``flux`` have the same segments.
    """

    flux_min: np.float32
    flux_max: np.float32
    limit: SinglePolynomial
    d: SinglePolynomial
    q: SinglePolynomial
    flux: SinglePolynomial
    torque_mid: np.float32
    excess_mid: np.float32
    surface_d: SingleSurface
    surface_q: SingleSurface

    @property
    def coefficients(self) -> int:
        """Number of constants that the emitted C spells out."""
        curves = sum(
            polynomial.coefficients.size for polynomial in (self.limit, self.d, self.q, self.flux)
        )
        return curves + self.surface_d.size + self.surface_q.size

    @property
    def flash(self) -> int:
        """Estimate of the bytes of code and constants on a Cortex-M4F, without fused
        multiply-add.
        """
        fixed, each = _BYTES
        return fixed + each * self.coefficients

    def limited(
        self, torque: SingleArray, flux: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, ...]:
        """Magnitude of the torque within the limit in N m and clamped flux linkage in Wb,
        shape (N,) each.

        NaN as a torque counts as none; NaN as a flux linkage as no torque at the least flux
        linkage, which keeps the voltage limit at every speed of the design.
        """
        o = compiled(fused=fused)
        torque, flux = np.asarray(torque, dtype=np.float32), np.asarray(flux, dtype=np.float32)
        with np.errstate(invalid="ignore", under="ignore"):
            t = np.where(torque < 0.0, -torque, torque)
            t = np.where(np.isnan(torque) | np.isnan(flux), np.float32(0.0), t)
            a = np.where(flux >= self.flux_min, flux, self.flux_min)
            a = np.where(a > self.flux_max, self.flux_max, a)
            most = self.limit.evaluate(a - self.flux_min, o)
            return np.where(t > most, most, t), a

    def weakened(self, o: Arithmetic, t: Reals, delta: Reals, base: tuple[Reals, Reals]) -> Dq:
        """Currents in A where MTPA currents ``base`` in A take ``delta`` Wb too much, any shape."""
        x = o.let("x", t - float(self.torque_mid))
        y = o.let("y", delta - float(self.excess_mid))
        d = o.let("d", self.surface_d.evaluate(o, "d", x, y))
        q = o.let("q", self.surface_q.evaluate(o, "q", x, y))
        return Dq(o.multiply_add(delta, d, base[0]), o.multiply_add(delta * t, q, base[1]))

    def currents(
        self, torque: SingleArray, flux: SingleArray, *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        """(i_d, i_q) in A for float32 torques and available flux linkages, shape (N,), in the
        operations of the header.

        ``fused`` models a compiler that contracts products and sums.
        """
        o = compiled(fused=fused)
        t, a = self.limited(torque, flux, fused=fused)
        with np.errstate(invalid="ignore", under="ignore"):
            i_d, i_q = self.d.evaluate(t, o), self.q.evaluate(t, o)
            delta = self.flux.evaluate(t, o) - a
            weakened_d, weakened_q = self.weakened(o, t, delta, (i_d, i_q))
            weakens = delta > 0.0
            i_d, i_q = np.where(weakens, weakened_d, i_d), np.where(weakens, weakened_q, i_q)
            return i_d, np.where(np.asarray(torque, dtype=np.float32) < 0.0, -i_q, i_q)


@dataclass(frozen=True, slots=True)
class SurfaceErrors:
    """Largest errors over a dense set of torques and flux linkages, with and
    without fused multiply-add.

    ``torque`` in N m is the torque made less the one asked for or the largest one that can be had,
    ``torque_relative`` that over the largest torque of the machine; ``flux_excess`` is the flux
    linkage (and with it the voltage) beyond the available one, relative to it; ``current_excess``
    the current beyond the limit, relative to it. ``loss_relative`` is the copper loss above the
    least for the torque and the flux linkage that are really taken, from 5 % of the largest torque
    upwards. Found by sampling: not bounds.
    """

    torque: float
    torque_relative: float
    flux_excess: float
    current_excess: float
    loss_relative: float
    samples: int


@dataclass(frozen=True, slots=True)
class SurfaceSamples:
    """Where errors are measured: float32 torques in N m and flux linkages in Wb,
    and the largest torque, shape (N,).
    """

    torque: SingleArray
    flux: SingleArray
    most: FloatArray


@dataclass(frozen=True, slots=True)
class ErrorMap:
    """Errors at `SurfaceSamples`, shape (N,): torque in N m, flux and current excess
    relative (negative: none).
    """

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    flux_excess: FloatArray
    current_excess: FloatArray


def surface_samples(region: WeakeningRegion, count: int) -> SurfaceSamples:
    """Grid of ``count`` flux linkages by ``count`` torques from zero to beyond the largest,
    denser at either end.
    """
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))
    even = np.linspace(0.0, 1.0, count)
    flux = (region.flux_min + (region.flux_max - region.flux_min) * even).astype(np.float32)
    # A flux linkage that rounding put below the least one is clamped by the evaluator, too.
    most = region.largest_torque(np.clip(flux.astype(np.float64), region.flux_min, None))
    torque = np.append(share, 1.05) * most[:, np.newaxis]
    spread = np.broadcast_to(flux[:, np.newaxis], torque.shape)
    limits = np.broadcast_to(most[:, np.newaxis], torque.shape)
    return SurfaceSamples(torque.astype(np.float32).ravel(), spread.ravel(), limits.ravel())


def error_map(
    region: WeakeningRegion,
    reference: WeakeningReference,
    samples: SurfaceSamples,
    *,
    fused: bool = False,
) -> ErrorMap:
    """Torque and limits of the float32 currents, by the machine in double."""
    i_d, i_q = (
        current.astype(np.float64)
        for current in reference.currents(samples.torque, samples.flux, fused=fused)
    )
    wanted = np.minimum(samples.torque.astype(np.float64), samples.most)
    psi_d, psi_q = region.machine.flux(i_d, i_q)
    torque = torque_from_flux(region.machine.pole_pairs, psi_d, psi_q, i_d, i_q)
    available = np.maximum(samples.flux.astype(np.float64), region.flux_min)
    return ErrorMap(
        i_d,
        i_q,
        torque - wanted,
        np.hypot(psi_d, psi_q) / available - 1.0,
        np.hypot(i_d, i_q) / region.i_max - 1.0,
    )


def _loss_penalty(
    region: WeakeningRegion, errors: ErrorMap, samples: SurfaceSamples, chosen: NDArray[np.intp]
) -> float:
    """Largest relative copper loss above the least at some of the samples."""
    i_d, i_q = errors.i_d[chosen], errors.i_q[chosen]
    flux = np.maximum(samples.flux[chosen].astype(np.float64), region.flux(i_d, i_q))
    best = region.points(region.machine.torque(i_d, i_q), flux)
    least = best.i_d**2 + best.i_q**2
    # At the largest torque the optimum itself is on the brink: only what could be had is compared.
    loaded = best.reached & (np.abs(best.torque) > PENALTY_FROM * region.torque_max)
    excess = (i_d**2 + i_q**2 - least)[loaded] / least[loaded]
    return float(np.max(excess, initial=0.0))


def surface_errors(
    region: WeakeningRegion, reference: WeakeningReference, count: int = 300
) -> SurfaceErrors:
    """Largest errors over ``count`` squared samples in the arithmetic of the
    emitted C (both contractions).
    """
    samples = surface_samples(region, count)
    maps = [error_map(region, reference, samples, fused=fused) for fused in (False, True)]
    torque = max(float(np.max(np.abs(found.torque))) for found in maps)
    chosen = np.arange(0, samples.torque.size, max(samples.torque.size // 3000, 1))
    return SurfaceErrors(
        torque=torque,
        torque_relative=torque / region.torque_max,
        flux_excess=max(float(np.max(found.flux_excess)) for found in maps),
        current_excess=max(float(np.max(found.current_excess)) for found in maps),
        loss_relative=_loss_penalty(region, maps[0], samples, chosen),
        samples=2 * samples.torque.size,
    )


# Piecewise polynomials of one variable beneath a two-dimensional reference: MTPA currents,
# their flux, the limit.
#
# Functions of powers u^k and truncated powers (u - b)_+^k are continuous at every
# breakpoint b by construction.

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


# Least-loss currents over torque and available flux linkage: what a two-dimensional
# current reference approximates.
#
# The voltage limits the flux linkage: with the resistance drop left out |psi| <= v_max / omega_e,
# so that one number, the available flux linkage in Wb, stands for speed and DC-link voltage alike.

# Electrical speed in rad/s at which the points are solved: the resistance drop is some 1e-9 of the
# voltage there.
_OMEGA = 1e9
_NO_LIMIT = 1e12  # Phase voltage in V that limits nothing at standstill.

# Share of the largest torque that must be left at the least flux linkage: below, nothing is worth
# fitting.
LEAST_SHARE = 0.02
_LOCUS_POINTS = 801
_DATA_POINTS = 33


@dataclass(frozen=True, slots=True)
class WeakeningRegion:
    """The domain of torque and available flux linkage of a machine.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
        flux_min, flux_max: Range of the available flux linkage in Wb; from ``flux_max`` upwards it
            limits nothing.
        torque_max: Largest torque in N m within the current limit.
    """

    machine: Machine
    i_max: float
    flux_min: float
    flux_max: float
    torque_max: float

    def points(self, torque: FloatArray, flux: FloatArray) -> OptimalPoints:
        """Least-loss operating points for torques in N m within an available flux linkage in Wb,
        both shape (N,).
        """
        omega_m = _OMEGA / self.machine.pole_pairs
        return optimal_points(self.machine, torque, omega_m, v_max=_OMEGA * flux, i_max=self.i_max)

    def largest_torque(self, flux: FloatArray) -> FloatArray:
        """Largest torque in N m within the current limit and the available flux linkage in Wb,
        shape (N,).
        """
        return self.points(np.full(flux.shape, 2.0 * self.torque_max), flux).torque

    def mtpa(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents (i_d, i_q) in A of least loss for torque in N m where no flux
        linkage limits them, shape (N,).
        """
        found = optimal_points(self.machine, torque, 0.0, v_max=_NO_LIMIT, i_max=self.i_max)
        return found.i_d, found.i_q

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Magnitude of the flux linkage in Wb at currents in A, any shape."""
        return np.hypot(*self.machine.flux(i_d, i_q))


def weakening_region(machine: Machine, i_max: float, flux_min: float) -> WeakeningRegion:
    """Domain from ``flux_min`` Wb up to the largest flux linkage on the MTPA locus
    within ``i_max`` A (peak).

    Raises:
        NoSolutionError: Even ``flux_min`` limits nothing, it leaves next to no torque, or the data
            of a flux map hold the currents.
    """
    torque_max = float(mtpa_locus(machine, i_max).torque[-1])
    probe = WeakeningRegion(machine, i_max, flux_min, np.inf, torque_max)
    flux_max = float(np.max(probe.flux(*probe.mtpa(np.linspace(0.0, torque_max, _LOCUS_POINTS)))))
    if flux_min >= flux_max:
        raise NoSolutionError(
            f"field_weakening: the voltage limits nothing up to that speed ({flux_min:.4g} Wb are "
            f"available, the largest torque takes {flux_max:.4g} Wb); raise the speed or leave the "
            "section out"
        )
    least = float(probe.largest_torque(np.array([flux_min]))[0])
    if least < LEAST_SHARE * torque_max:
        raise NoSolutionError(
            f"field_weakening: within {flux_min:.4g} Wb and {i_max:.4g} A the machine makes less "
            f"than {100.0 * LEAST_SHARE:g} % of its largest torque; lower the speed"
        )
    region = WeakeningRegion(machine, i_max, flux_min, flux_max, torque_max)
    _refuse_what_data_hold(region)
    return region


def _refuse_what_data_hold(region: WeakeningRegion) -> None:
    """Refuse a domain in which the data of a flux map hold the currents: a fit would leave them.

    Raises:
        NoSolutionError: Names the least torque at which that happens.
    """
    if region_that_holds(region.machine, region.i_max) is None:
        return
    share = np.linspace(0.0, 1.0, _DATA_POINTS)
    torque, flux = np.meshgrid(
        share[1:] * region.torque_max, region.flux_min + share * (region.flux_max - region.flux_min)
    )
    held = region.points(torque.ravel(), flux.ravel()).active == Active.DATA
    if np.any(held):
        raise NoSolutionError(
            f"field_weakening: from {float(np.min(torque.ravel()[held])):.4g} N m on the currents "
            "are held by the data: the flux map ends there; measure further, lower max_current, or "
            "write flux_map: extrapolate: true"
        )
