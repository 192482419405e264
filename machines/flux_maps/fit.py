"""Whether a flux map is interpolated or smoothed, and the smoothed map on its
grid with the price of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.dq_machines.synchronous import CurrentRegion
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.flux_maps.checks import energy_misfit
from dqforge.machines.flux_maps.evidence import (
    MOST_PLACES,
    NOISE_LIMIT,
    NOTABLE_CURL,
    FluxFit,
    FluxNoise,
    inductance_noise,
    places,
)
from dqforge.machines.names import FluxFitName
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity

_FINE_GRID = 20_000


_LEAST_NODES = 40


@dataclass(frozen=True, slots=True, eq=False)
class FluxData:
    """What there is to fit: a plain grid and the points behind it.

    ``i_d``, ``i_q`` are its axes in A, ``psi`` its flux linkages (2, M, N) in Wb. ``at_d``,
    ``at_q`` and ``values`` are the points, shapes (K,), (K,), (2, K), with their ``noise``, None
    where nothing but a fit shows it. ``is_grid``: the points are the nodes. ``hull`` is where
    scattered points lie, None for those of a grid.
    """

    i_d: FloatArray
    i_q: FloatArray
    psi: FloatArray
    at_d: FloatArray
    at_q: FloatArray
    values: FloatArray
    noise: FluxNoise | None
    is_grid: bool
    hull: CurrentRegion | None = None


def _judged(data: FluxData) -> tuple[FloatArray, FloatArray]:
    """Where a plain spline must have positive definite inductances: nodes and middles of cells,
    or the points.
    """
    if not data.is_grid:
        return data.at_d, data.at_q
    axes = [data.i_d, data.i_q]
    if data.psi[0].size <= _FINE_GRID:
        axes = [np.sort(np.append(axis, 0.5 * (axis[1:] + axis[:-1]))) for axis in axes]
    i_d, i_q = np.meshgrid(*axes, indexing="ij")
    return i_d.ravel(), i_q.ravel()


def _faults(data: FluxData) -> tuple[tuple[tuple[float, float], ...], int]:
    """Middles of the cells where a plain spline is not admissible, the first of them,
    and how many there are.
    """
    i_d, i_q = _judged(data)
    jet = FluxMap(data.i_d, data.i_q, data.psi[0], data.psi[1]).jet(i_d, i_q)
    mutual = 0.5 * (jet.l_dq + jet.l_qd)
    bad = (jet.l_dd <= 0.0) | (jet.l_qq <= 0.0) | (jet.l_dd * jet.l_qq <= mutual**2)
    if not np.any(bad):
        return (), 0
    rows = np.clip(np.searchsorted(data.i_d, i_d[bad], side="right") - 1, 0, data.i_d.size - 2)
    columns = np.clip(np.searchsorted(data.i_q, i_q[bad], side="right") - 1, 0, data.i_q.size - 2)
    cells = np.unique(np.stack([rows, columns], axis=1), axis=0)
    middle = [0.5 * (axis[1:] + axis[:-1]) for axis in (data.i_d, data.i_q)]
    named = tuple(
        (float(middle[0][row]), float(middle[1][column])) for row, column in cells[:MOST_PLACES]
    )
    return named, cells.shape[0]


def _fine(axis: FloatArray) -> FloatArray:
    """An axis with each step divided evenly, so that cubics through its nodes follow the smooth
    map.
    """
    parts = -(-_LEAST_NODES // (axis.size - 1))
    if parts == 1:
        return axis
    share = np.arange(parts) / parts
    inner = (axis[:-1, np.newaxis] + share * np.diff(axis)[:, np.newaxis]).ravel()
    return np.append(inner, axis[-1])


def _refuse_outliers(data: FluxData, off: NDArray[np.bool_], fit: CoEnergy, source: str) -> None:
    """Name all points that are no noise."""
    if not np.any(off):
        return
    which = np.flatnonzero(off)
    named = tuple((float(data.at_d[k]), float(data.at_q[k])) for k in which[:MOST_PLACES])
    apart = np.abs(data.values - fit.flux_at(data.at_d, data.at_q))[:, which]
    raise InputError(
        f"{which.size} points lie far from the smooth map through the others, by up to "
        f"{format_quantity(float(np.max(apart)), 'Wb', 3)}: {places(named, which.size)} (peak, d "
        "along the magnets); measure them again, or remove them from the file",
        source=source,
    )


def _priced(data: FluxData, fit: CoEnergy, found: FluxFit) -> FluxFit:
    """The fit with what smoothing changes against the plain spline at the points."""
    plain = FluxMap(data.i_d, data.i_q, data.psi[0], data.psi[1])
    apart = fit.flux_at(data.at_d, data.at_q) - np.stack(plain.flux(data.at_d, data.at_q))
    torque = 1.5 * (apart[0] * data.at_q - apart[1] * data.at_d)
    rms, largest = np.sqrt(np.mean(apart**2, axis=1)), np.max(np.abs(apart), axis=1)
    return replace(
        found,
        residual_rms=(float(rms[0]), float(rms[1])),
        residual_largest=(float(largest[0]), float(largest[1])),
        torque_rms=float(np.sqrt(np.mean(torque**2))),
        torque_largest=float(np.max(np.abs(torque))),
        freedom=fit.freedom,
    )


def fit_flux(
    data: FluxData, wanted: FluxFitName, source: str, *, even: bool = True
) -> tuple[FluxMap, FluxFit]:
    """The map through the points, or the smooth one near them, as ``wanted``.

    Not marked for extrapolation.

    Raises:
        InputError: Points that lie far from all others, or data that no machine has.
    """
    plain = FluxMap(data.i_d, data.i_q, data.psi[0], data.psi[1])
    faults, count = _faults(data)
    noise = data.noise
    try:
        if noise is None and wanted != "interpolate":
            noise = smooth_co_energy(
                data.at_d, data.at_q, data.values, None, even=even, positive=False
            ).noise
        share = 0.0 if noise is None else _inductance_noise(data, noise)
        curl = 0.0 if data.hull is None else energy_misfit(replace(plain, hull=data.hull))
        sound = count == 0 and share <= NOISE_LIMIT and curl <= NOTABLE_CURL
        if wanted == "interpolate" or (wanted == "auto" and sound):
            return plain, FluxFit(wanted, "interpolate", noise, share, faults, count, curl=curl)
        off, found = outliers(data.at_d, data.at_q, data.values, data.noise, even=even)
    except (NoSolutionError, np.linalg.LinAlgError) as error:
        raise InputError(f"the flux map cannot be smoothed: {error}", source=source) from None
    _refuse_outliers(data, off, found, source)
    i_d, i_q = _fine(data.i_d), _fine(data.i_q)
    if found.d.even and i_d[0] < 0.0 < i_d[-1]:
        i_d = np.union1d(i_d[np.abs(i_d) > 1e-9 * i_d[-1]], [0.0])
    psi = found.flux(i_d, i_q)
    if found.d.even:
        psi[0, i_d == 0.0] = 0.0  # to the last digit, too, so that there are no magnets
    used = FluxFit(wanted, "smooth", found.noise, share, faults, count, curl=curl)
    return FluxMap(i_d, i_q, psi[0], psi[1]), _priced(data, found, used)


def _inductance_noise(data: FluxData, noise: FluxNoise) -> float:
    """Noise of the incremental inductances of a plain spline over their mean.

    Scattered points have a mean step.
    """
    share = inductance_noise(noise, data.i_d, data.i_q, data.psi)
    return share if data.is_grid else share * float(np.sqrt(data.at_d.size / data.psi[0].size))


# A flux map from a smooth co-energy: psi_d = dW/di_d and psi_q = dW/di_q of
# one tensor-product spline W.
#
# W has degree four in both currents, so that the flux linkages have no curl by construction. Its
# coefficients make the residuals small against a penalty on third derivatives, which no machine
# with constant inductances pays, under the condition that the incremental inductances are positive
# definite. How strong the penalty is follows from the noise.

# Places per cell and axis at which the incremental inductances are held positive definite, of which
# one in each block is cut, and so many cuts are added at once.
_STRENGTHS = np.geomspace(1e-10, 1e6, 97)
_PER_CELL, _BLOCK, _MOST_ADDED = 8, 5, 150

# Least eigenvalue of the incremental inductances, over their mean, that a smoothed map keeps.
LEAST_SHARE = 0.05
_LEAST_NOISE = 1e-6  # Noise over the largest flux linkage below which nothing is fitted closer.

# R.m.s. residual over the r.m.s. flux linkage down to which the strongest penalty is taken.
_DIGITS = 1e-5

# Effective parameters over the number of values beyond which a fit says nothing of its noise.
_MOST_FREEDOM = 0.6

# Flux linkage at zero current over the largest one from which on it belongs to magnets, however
# noisy the points.
_MAGNET_SHARE = 0.03

# Third derivatives by i_d and by i_q, and how often each occurs.
_MOST_CUTS, _DROPPING = 60, 5
_MOST_ROUNDS = 8
_OUTLIER, _OUTLIER_SHARE = 8.0, 0.05
_THIRD = ((3, 0, 1.0), (2, 1, 3.0), (1, 2, 3.0), (0, 3, 1.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """Least squares of all points: normal matrix, right side, squares of the data, rows,
    and the penalty.

    Rows are over their noise, so that the residuals of a true fit have unit variance.
    """

    normal: FloatArray
    right: FloatArray
    squares: float
    count: int
    penalty: FloatArray


def _columns(d: FloatArray, q: FloatArray) -> FloatArray:
    """Products of two bases' functions at points, shape (n, D Q)."""
    return np.asarray(np.einsum("ka,kb->kab", d, q).reshape(d.shape[0], d.shape[1] * q.shape[1]))


def _problem(
    bases: tuple[SplineBasis, SplineBasis],
    i_d: FloatArray,
    i_q: FloatArray,
    psi: FloatArray,
    weights: tuple[float, float],
) -> _Problem:
    in_d, in_q = bases
    size = in_d.size * in_q.size
    normal, right = np.zeros((size, size)), np.zeros(size)
    for start in range(0, i_d.size, CHUNK):
        part = slice(start, start + CHUNK)
        rows_d, rows_q = in_d.rows(i_d[part]), in_q.rows(i_q[part])
        for index, rows in enumerate(
            (_columns(in_d.rows(i_d[part], 1), rows_q), _columns(rows_d, in_q.rows(i_q[part], 1)))
        ):
            weighted = weights[index] * rows
            normal += weighted.T @ weighted
            right += weighted.T @ (weights[index] * psi[index, part])
    penalty = np.zeros((size, size))
    for by_d, by_q, times in _THIRD:
        penalty += times * np.kron(in_d.products(by_d), in_q.products(by_q))
    # No flux linkage tells the constant of W: it is 0 without current.
    origin = _columns(in_d.rows(np.zeros(1)), in_q.rows(np.zeros(1)))
    normal += origin.T @ origin * (np.trace(normal) / size / float(np.sum(origin**2)))
    squares = sum(float(np.sum((weights[index] * psi[index]) ** 2)) for index in (0, 1))
    return _Problem(
        normal, right, squares, 2 * i_d.size, penalty * (np.trace(normal) / np.trace(penalty))
    )


def _solved(problem: _Problem, *, known: bool) -> tuple[float, float, float, FloatArray]:
    """Strength, effective parameters, squared residuals and coefficients with
    the least expected error.

    Where the noise is ``known`` the expected error follows from it (Mallows),
    else by generalised cross-validation.
    """
    from scipy.linalg import cholesky, eigh, solve_triangular

    reference = 1e-2
    whole = problem.normal + reference * problem.penalty
    lower = cholesky(
        whole + 1e-13 * np.trace(whole) / whole.shape[0] * np.eye(whole.shape[0]), lower=True
    )
    inner = solve_triangular(lower, problem.penalty, lower=True)
    inner = solve_triangular(lower, inner.T, lower=True)
    values, vectors = eigh(0.5 * (inner + inner.T))
    values = np.clip(values, 0.0, 1.0 / reference)
    of_data = 1.0 - reference * values
    right = vectors.T @ solve_triangular(lower, problem.right, lower=True)
    bend = of_data + _STRENGTHS[:, np.newaxis] * values + 1e-13
    scaled = right / bend
    squares = problem.squares - 2.0 * scaled @ right + np.sum(of_data * scaled**2, axis=1)
    squares = np.maximum(squares, 1e-14 * problem.squares)
    freedom = np.sum(of_data / bend, axis=1) - 1.0
    left = np.maximum(problem.count - freedom, 1.0)
    score = squares + 2.0 * freedom if known else squares / left**2
    score[:-1][freedom[:-1] > _MOST_FREEDOM * problem.count] = np.inf
    best = int(np.argmin(score))
    # Where points leave gaps only the penalty tells; nothing is bent for digits that no file has.
    met = np.flatnonzero(squares <= (_DIGITS**2) * problem.squares)
    best = max(best, int(met[-1])) if met.size else best
    found = solve_triangular(lower.T, vectors @ scaled[best], lower=False)
    return float(_STRENGTHS[best]), float(freedom[best]), float(squares[best]), np.asarray(found)


@dataclass(frozen=True, slots=True, eq=False)
class _Sites:
    """A grid of places at which the incremental inductances are held positive definite.

    ``d`` and ``q`` are the rows of the 0th to 2nd derivatives of both bases there.
    """

    d: tuple[FloatArray, ...]
    q: tuple[FloatArray, ...]

    @classmethod
    def of(cls, bases: tuple[SplineBasis, SplineBasis]) -> _Sites:
        """Eight places per cell; one side of an even basis tells the other."""
        found = []
        for basis in bases:
            edges = np.unique(basis.knots) * basis.scale
            at = np.linspace(edges[0], edges[-1], _PER_CELL * (edges.size - 1) + 1)
            at = at[at >= -1e-9 * basis.scale] if basis.even else at
            found.append(tuple(basis.rows(at, order) for order in (0, 1, 2)))
        return cls(found[0], found[1])

    def violations(self, coefficients: FloatArray, floor: float) -> FloatArray:
        """Rows of u' L u below ``floor`` H, for the worst places and their eigenvectors u,
        shape (K, C).
        """
        table = coefficients.reshape(self.d[0].shape[1], self.q[0].shape[1])
        l_dd, l_dq, l_qq = (self.d[2 - k] @ table @ self.q[k].T for k in (0, 1, 2))
        half = 0.5 * (l_dd - l_qq)
        least = 0.5 * (l_dd + l_qq) - np.hypot(half, l_dq)
        below = np.flatnonzero(least < floor * (1.0 - 1e-3))
        worst = below[np.argsort(least.ravel()[below], kind="stable")]
        row, column = np.unravel_index(worst, least.shape)
        # Of each block of places the worst one stands for its neighbours,
        # which nearly ask for the same.
        block = (row // _BLOCK) * (least.shape[1] // _BLOCK + 1) + column // _BLOCK
        first = np.sort(np.unique(block, return_index=True)[1])[:_MOST_ADDED]
        row, column = row[first], column[first]
        # The eigenvector of the smaller eigenvalue of [[l_dd, l_dq], [l_dq, l_qq]].
        angle = 0.5 * np.arctan2(l_dq[row, column], half[row, column]) + 0.5 * np.pi
        u, v = np.cos(angle)[:, np.newaxis], np.sin(angle)[:, np.newaxis]
        parts = [_columns(self.d[2 - k][row], self.q[k][column]) for k in (0, 1, 2)]
        return np.asarray(u * u * parts[0] + 2.0 * u * v * parts[1] + v * v * parts[2])


def _constrained(
    problem: _Problem, strength: float, start: FloatArray, sites: _Sites, floor: float
) -> tuple[FloatArray, int]:
    """Coefficients that keep the inductances positive definite at all sites, by cuts,
    and how many were needed.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    cuts = sites.violations(start, floor)
    if cuts.shape[0] == 0:
        return start, 0
    hessian = problem.normal + strength * problem.penalty
    unit = np.trace(hessian) / hessian.shape[0]
    hessian = hessian / unit + 1e-12 * np.eye(hessian.shape[0])
    upper, right = csc_matrix(np.triu(hessian)), -problem.right / unit
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    found = start
    for step in range(_MOST_CUTS):
        rows, limits = csc_matrix(-cuts / floor), -np.ones(cuts.shape[0])
        solver = clarabel.DefaultSolver(
            upper, right, rows, limits, [clarabel.NonnegativeConeT(cuts.shape[0])], settings
        )
        solution = solver.solve()
        if str(solution.status) not in ("Solved", "AlmostSolved"):
            break
        found = np.array(solution.x)
        # Cuts that do not bind are dropped at first, to be quick; later all stay,
        # so that none returns for ever.
        cuts = cuts[cuts @ found < 1.5 * floor] if step < _DROPPING else cuts
        more = sites.violations(found, floor)
        if more.shape[0] == 0:
            return found, cuts.shape[0]
        cuts = np.concatenate([cuts, more])
    raise NoSolutionError(
        "the smoothing fit of the flux map finds no positive definite inductances; check the signs "
        "of its columns"
    )


def _mean_inductance(i_d: FloatArray, i_q: FloatArray, psi: FloatArray) -> float:
    """The smaller of the two mean inductances in H, of a plane through all points."""
    terms = np.stack([np.ones(i_d.size), i_d, i_q], axis=1)
    slopes = np.linalg.lstsq(terms, psi.T, rcond=None)[0]
    return float(min(slopes[1, 0], slopes[2, 1]))


def smooth_co_energy(
    i_d: FloatArray,
    i_q: FloatArray,
    psi: FloatArray,
    noise: FluxNoise | None,
    *,
    even: bool = True,
    positive: bool = True,
) -> CoEnergy:
    """Co-energy of points anywhere, as smooth as their noise allows.

    Args:
        i_d, i_q: Currents in A, shape (K,).
        psi: (psi_d, psi_q) in Wb, shape (2, K).
        noise: Standard deviation of single points; None lets generalised cross-validation find it.
        even: psi_d even and psi_q odd in i_q; else both halves are kept as they are.
        positive: Hold the incremental inductances positive definite; not needed to see the noise
            alone.

    Where psi_d at zero current is less than the noise there are no magnets, and psi_d is made odd,
    psi_q even in i_d.

    Raises:
        NoSolutionError: No positive definite inductances come near the points.
    """
    with_magnets = _fitted(
        (_axis_basis(i_d, even=False), _axis_basis(i_q, even=even)), i_d, i_q, psi, noise, positive
    )
    rest = abs(float(with_magnets.flux_at(np.zeros(1), np.zeros(1))[0, 0]))
    if rest > min(with_magnets.noise.d, _MAGNET_SHARE * float(np.max(np.abs(psi)))):
        return with_magnets
    return _fitted(
        (_axis_basis(i_d, even=True), _axis_basis(i_q, even=even)), i_d, i_q, psi, noise, positive
    )


def _axis_basis(current: FloatArray, *, even: bool) -> SplineBasis:
    """Splines over the range of currents in A, or over the one symmetric about 0."""
    if not even:
        return spline_basis(
            float(np.min(current)), float(np.max(current)), _different(current), even=False
        )
    end = float(np.max(np.abs(current)))
    return spline_basis(-end, end, 2 * _different(np.abs(current)) - 1, even=True)


def _fitted(
    bases: tuple[SplineBasis, SplineBasis],
    i_d: FloatArray,
    i_q: FloatArray,
    psi: FloatArray,
    noise: FluxNoise | None,
    positive: bool,
) -> CoEnergy:
    """The smooth co-energy of given bases; parameters as in `smooth_co_energy`."""
    known, weights = noise is not None, (1.0, 1.0)
    if noise is not None:
        least = _LEAST_NOISE * float(np.max(np.abs(psi)))
        weights = 1.0 / max(noise.d, least), 1.0 / max(noise.q, least)
    problem = _problem(bases, i_d, i_q, psi, weights)
    strength, freedom, squares, start = _solved(problem, known=known)
    if noise is None:
        size = float(np.sqrt(squares / max(problem.count - freedom, 1.0)))
        noise = FluxNoise(size, size, "residual")
    floor = LEAST_SHARE * _mean_inductance(i_d, i_q, psi) if positive else 0.0
    found, cuts = (
        (start, 0)
        if floor <= 0.0
        else _constrained(problem, strength, start, _Sites.of(bases), floor)
    )
    return CoEnergy(
        *bases, found.reshape(bases[0].size, bases[1].size), strength, freedom, noise, cuts
    )


def _different(values: FloatArray) -> int:
    """How many different currents there are, or would be on a grid of as many scattered points."""
    span = float(np.ptp(values))
    found = np.unique(np.round(values / (1e-6 * span))).size
    return min(found, int(np.sqrt(2.0 * values.size)) + 1)


def outliers(
    i_d: FloatArray, i_q: FloatArray, psi: FloatArray, noise: FluxNoise | None, *, even: bool = True
) -> tuple[NDArray[np.bool_], CoEnergy]:
    """Points far off the smooth map through the others, shape (K,), and the map without them.

    Far is more than 8 times the scatter of all and more than 5 % of the span of the flux linkage.
    """
    off = np.zeros(i_d.size, dtype=bool)
    span = np.ptp(psi, axis=1)
    for _ in range(_MOST_ROUNDS):
        fit = smooth_co_energy(i_d[~off], i_q[~off], psi[:, ~off], noise, even=even)
        apart = np.abs(psi - fit.flux_at(i_d, i_q))
        scatter = np.median(apart[:, ~off], axis=1) / 0.6745
        far = np.any(
            apart > np.maximum(_OUTLIER * scatter, _OUTLIER_SHARE * span)[:, np.newaxis], axis=0
        )
        if np.array_equal(far, off):
            break
        off = far
    return off, fit


# Co-energy of a machine as a tensor-product spline W: psi_d = dW/di_d and psi_q = dW/di_q.
#
# W has degree four in both currents, so that the flux linkages have no curl by construction.

_DEGREE = 4


_CELLS = (4, 24)


CHUNK = 20_000


_GAUSS = np.polynomial.legendre.leggauss(_DEGREE + 1)


@dataclass(frozen=True, slots=True)
class SplineBasis:
    """Splines of one current in multiples of ``scale`` A, about which an even one is symmetric."""

    knots: FloatArray
    scale: float
    even: bool

    @property
    def size(self) -> int:
        """Number of functions."""
        whole = self.knots.size - _DEGREE - 1
        return whole // 2 if self.even else whole

    def rows(self, current: FloatArray, order: int = 0) -> FloatArray:
        """Derivatives by the current in A, shape (n, size)."""
        from scipy.interpolate import BSpline

        x = np.clip(current / self.scale, self.knots[0], self.knots[-1])
        count = self.knots.size - _DEGREE - 1
        spline = BSpline(self.knots, np.eye(count), _DEGREE)
        values = np.asarray(spline.derivative(order)(x) if order else spline(x)) / self.scale**order
        if not self.even:
            return values
        # Functions of one side and their mirror images have one coefficient.
        return np.asarray(values[:, : count // 2] + values[:, : count // 2 - 1 : -1])

    def products(self, order: int) -> FloatArray:
        """Integrals over the axis, in multiples of its scale, of the products of derivatives:
        shape (size, size).
        """
        edges = np.unique(self.knots)
        half = 0.5 * np.diff(edges)
        at = (
            0.5 * (edges[1:] + edges[:-1])[:, np.newaxis] + half[:, np.newaxis] * _GAUSS[0]
        ).ravel()
        weights = (half[:, np.newaxis] * _GAUSS[1]).ravel()
        rows = self.rows(at * self.scale, order) * self.scale**order
        return np.asarray(rows.T @ (weights[:, np.newaxis] * rows))


def spline_basis(low: float, high: float, count: int, *, even: bool) -> SplineBasis:
    """Splines on even cells from ``low`` to ``high`` A, for ``count`` different currents."""
    cells = int(np.clip(count - 1, *_CELLS))
    if even:
        cells += cells % 2
    scale = 0.5 * (high - low)
    inner = np.linspace(low / scale, high / scale, cells + 1)
    knots = np.concatenate([np.full(_DEGREE, inner[0]), inner, np.full(_DEGREE, inner[-1])])
    return SplineBasis(knots, scale, even)


@dataclass(frozen=True, slots=True, eq=False)
class CoEnergy:
    """W(i_d, i_q) in J/p, shape (D, Q) of its coefficients, with what was found on the way.

    ``strength`` is the penalty's, ``freedom`` the effective number of parameters, ``noise`` what
    the fit used or found, ``cuts`` how many places needed the condition of positive definite
    inductances.
    """

    d: SplineBasis
    q: SplineBasis
    coefficients: FloatArray
    strength: float
    freedom: float
    noise: FluxNoise
    cuts: int

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Flux linkages in Wb on the grid of two axes in A: shape (2, M, N)."""
        return np.stack(
            [
                self.d.rows(i_d, 1) @ self.coefficients @ self.q.rows(i_q).T,
                self.d.rows(i_d) @ self.coefficients @ self.q.rows(i_q, 1).T,
            ]
        )

    def flux_at(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Flux linkages in Wb at points (K,) in A: shape (2, K)."""
        parts = [slice(start, start + CHUNK) for start in range(0, i_d.size, CHUNK)]
        found = [
            [
                np.einsum(
                    "kd,dq,kq->k",
                    self.d.rows(i_d[part], a),
                    self.coefficients,
                    self.q.rows(i_q[part], b),
                )
                for part in parts
            ]
            for a, b in ((1, 0), (0, 1))
        ]
        return np.stack([np.concatenate(values) for values in found])

    def inductances(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Incremental inductances in H on the grid of two axes: l_dd, l_dq, l_qq, shape (3, M,
        N).
        """
        return np.stack(
            [
                self.d.rows(i_d, a) @ self.coefficients @ self.q.rows(i_q, b).T
                for a, b in ((2, 0), (1, 1), (0, 2))
            ]
        )


# Flux maps at a magnet temperature between those of several maps.


def flux_map_of_maps(
    temperatures: FloatArray, maps: Sequence[FluxMap], temperature: float
) -> FluxMap:
    """Flux map at a magnet temperature between those of several maps, on the
    rectangle that all of them cover.

    Between two maps linear in the temperature, else by monotone cubics (PCHIP) through all. The
    nodes are those of the map with the finest axis, for each axis.

    Args:
        temperatures: Of the maps in any order, in degC, shape (n,), n >= 2.
        maps: One for each.
        temperature: At which the map is wanted, in degC.

    Raises:
        InputError: Less than two maps, a repeated temperature, one outside the range, or maps that
            cover no common rectangle.
    """
    from scipy.interpolate import PchipInterpolator

    if len(maps) < 2 or temperatures.shape != (len(maps),):
        raise InputError(
            f"{len(maps)} flux maps and {temperatures.size} temperatures; give two or more of both"
        )
    order = np.argsort(temperatures)
    known = temperatures[order]
    if not np.all(np.diff(known) > 0.0):
        raise InputError("two flux maps have the same magnet temperature; keep one of them")
    if not known[0] <= temperature <= known[-1]:
        raise InputError(
            f"the magnet temperature {temperature:g} degC lies outside those of the flux maps, "
            f"{known[0]:g} to {known[-1]:g} degC; add a map or change the temperature"
        )
    i_d, i_q = _common([part.i_d for part in maps]), _common([part.i_q for part in maps])
    psi = np.stack([np.stack(maps[index].flux(i_d[:, np.newaxis], i_q)) for index in order])
    if len(maps) == 2:
        share = (temperature - known[0]) / (known[1] - known[0])
        here = (1.0 - share) * psi[0] + share * psi[1]
    else:
        here = PchipInterpolator(known, psi, axis=0)(temperature)
    hull = None
    if any(part.hull is not None for part in maps):
        hull = maps[0].region
        for part in maps[1:]:
            hull = hull.within(part.region)
    return FluxMap(i_d, i_q, here[0], here[1], all(part.extrapolate for part in maps), hull)


def _common(axes: Sequence[FloatArray]) -> FloatArray:
    """Nodes of the finest axis on the range that all axes cover, with its ends."""
    low, high = max(float(axis[0]) for axis in axes), min(float(axis[-1]) for axis in axes)
    finest = min(axes, key=lambda axis: float(axis[-1] - axis[0]) / (axis.size - 1))
    near = 0.25 * float(np.min(np.diff(finest)))
    inner = finest[(finest > low + near) & (finest < high - near)]
    if inner.size < 2:
        raise InputError(
            f"the flux maps overlap only from {low:g} to {high:g} A in one current; give them "
            "equal ranges"
        )
    return np.concatenate([[low], inner, [high]])
