"""A flux map from a smooth co-energy: psi_d = dW/di_d and psi_q = dW/di_q of
one tensor-product spline W.

W has degree four in both currents, so that the flux linkages have no curl by construction. Its
coefficients make the residuals small against a penalty on third derivatives, which no machine with
constant inductances pays, under the condition that the incremental inductances are positive
definite. How strong the penalty is follows from the noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.flux_maps.co_energy import CHUNK, CoEnergy, SplineBasis, spline_basis
from dqforge.machines.flux_maps.noise import FluxNoise
from dqforge.machines.records import dataclass

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
_MOST_CUTS, _DROPPING = 30, 5
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
