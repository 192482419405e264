"""A Lyapunov certificate for an observer whose error dynamics change with the speed,
however fast the speed changes.

The flux observer's error, linearised about the true state at a constant current, in rotor
coordinates and per unit of the active flux psi_a (real), with z = (delta_d, delta_q, theta~, t_s
omega~), x = omega t_s of the period and m = (L_d - L_q) i_q/psi_a + j:

    theta~_p = theta~ + t_s omega~
    delta_p = exp(-j x) delta - j b (1 - exp(-j x)) t_s omega~,         b = R t_s/(12 L_q)
    delta'  = (1 - alpha) delta_p + alpha m theta~_p
    eps     = Im delta' - theta~_p
    theta~' = theta~_p + l_1 eps,   t_s omega~' = t_s omega~ + t_s l_2 eps

z' = A(cos x, sin x, alpha) z, where A is multi-affine: affine in each of the three while the others
stay. The range of x is cut into pieces. On each piece the three lie in a box, bounded by ball
arithmetic; a multi-affine map takes a box into the convex hull of the images of its corners. Where
one P satisfies A^T P A < lambda^2 P at all corners of all pieces, V = z^T P z falls by lambda^2 in
every sample for every x[k] in the range, in any order (A -> A^T P A is convex).

What is proven: exponential stability of the linearised error for arbitrarily fast changes of a
speed of one sign within the range, at any of the given currents and changes between them, with
exact parameters, without rounding and for an exact voltage model. Negative speeds follow by
symmetry (delta_d kept, the other signs turned, i_q turned). Not proven: passage through standstill,
where this observer is not asymptotically stable, and how far from the true state the linearisation
holds.

The filter of the extended-EMF observer needs no programme: in rotor coordinates its error shrinks
by exp(-bandwidth t_s) at every known speed, so that P = 1 serves for all of them, standstill
included.

P comes from a semidefinite programme (cvxpy, Clarabel); the proof does not rest on it: all corners
are checked afterwards in rational arithmetic by the pivots of lambda^2 P - A^T P A.

References:
    S. Boyd et al., "Linear matrix inequalities in system and control theory", SIAM 1994, chapter 5
    (polytopic inclusions).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.methods.flux_gains import FluxGains

_PIECES = 16


_BISECTIONS = 5


_MARGIN = 2e-4


_STATES = 4


@dataclass(frozen=True, slots=True, eq=False)
class LyapunovCertificate:
    """What is proven of z' = A(omega) z.

    ``p`` (n, n) is exact as printed, ``contraction`` the proven factor lambda of the square root of
    z^T P z per sample, for electrical speeds ``omega_low`` to ``omega_high`` in rad/s; ``corners``
    inequalities were checked exactly.
    """

    p: FloatArray
    contraction: float
    omega_low: float
    omega_high: float
    corners: int


def flux_error_matrix(
    gains: FluxGains, i_dq: complex, cosine: Any, sine: Any, alpha: Any
) -> list[list[Any]]:
    """A(cos x, sin x, alpha), rows of numbers of the type of the arguments
    (floats or exact rationals).
    """
    number = type(cosine)
    exact = _rational if number is not float and not isinstance(cosine, float) else float
    l_d, l_q, psi, end = (
        exact(value) for value in (gains.l_d, gains.l_q, gains.psi_pm, gains.path.end)
    )
    l_1, l_2t = exact(gains.pll.l_1), exact(gains.pll.l_2) * exact(gains.pll.t_s)
    active = psi + (l_d - l_q) * exact(i_dq.real)
    m = (l_d - l_q) * exact(i_dq.imag) / active
    keep, zero, one = 1 - alpha, 0 * cosine, 0 * cosine + 1
    # -j b (1 - exp(-j x)) = -b sin x - j b (1 - cos x), as 1 - exp(-j x) = 1 - cos x + j sin x
    d = [keep * cosine, keep * sine, alpha * m, alpha * m + keep * end * sine]
    q = [-keep * sine, keep * cosine, alpha * one, alpha - keep * end * (1 - cosine)]
    predicted = [zero, zero, one, one]
    eps = [a - b for a, b in zip(q, predicted, strict=True)]
    theta = [a + l_1 * b for a, b in zip(predicted, eps, strict=True)]
    omega = [l_2t * b for b in eps]
    omega[3] = omega[3] + 1
    return [d, q, theta, omega]


def _rational(value: float) -> Any:
    from flint import fmpq

    numerator, denominator = float(value).as_integer_ratio()
    return fmpq(numerator, denominator)


def _outward(low: float, high: float, gains: FluxGains) -> tuple[tuple[float, float], ...]:
    """Bounds of cos x, sin x and alpha for low <= x <= high within (0, pi/2), rounded outwards."""
    from flint import arb

    cosines = [arb(value).cos() for value in (high, low)]
    sines = [arb(value).sin() for value in (low, high)]
    alphas = [arb(gains.alpha_0) + arb(gains.alpha_1) * arb(value) for value in (low, high)]
    return tuple(
        (
            float(np.nextafter(float(ends[0].lower()), -np.inf)),
            float(np.nextafter(float(ends[1].upper()), np.inf)),
        )
        for ends in (cosines, sines, alphas)
    )


def corner_parameters(
    gains: FluxGains, omega_low: float, omega_high: float, pieces: int = _PIECES
) -> FloatArray:
    """Corners (cos x, sin x, alpha) of boxes that contain the curve over the range of speeds,
    shape (8 pieces, 3).
    """
    if not 0.0 < omega_low < omega_high < 1.5 / gains.path.t_s:
        raise InputError("the certificate needs 0 < omega_low < omega_high < 1.5/t_s")
    edges = np.geomspace(omega_low, omega_high, pieces + 1) * gains.path.t_s
    edges[0], edges[-1] = edges[0] * (1.0 - 1e-15), edges[-1] * (1.0 + 1e-15)
    return np.array(
        [
            corner
            for low, high in pairwise(edges.tolist())
            for corner in product(*_outward(low, high, gains))
        ]
    )


def holds_exactly(p: FloatArray, contraction: float, matrices: Sequence[list[list[Any]]]) -> bool:
    """Whether P and contraction^2 P - A^T P A are positive definite for rational matrices A,
    in rational arithmetic.
    """
    exact = [[_rational(value) for value in row] for row in p]
    square = _rational(contraction) * _rational(contraction)
    if not _positive([row[:] for row in exact]):
        return False
    size = range(len(p))
    for a in matrices:
        pa = [[sum((exact[i][k] * a[k][j] for k in size), 0 * square) for j in size] for i in size]
        gap = [
            [
                square * exact[i][j] - sum((a[k][i] * pa[k][j] for k in size), 0 * square)
                for j in size
            ]
            for i in size
        ]
        if not _positive(gap):
            return False
    return True


def _positive(matrix: list[list[Any]]) -> bool:
    """Positive pivots of symmetric elimination: positive definite (Sylvester)."""
    n = len(matrix)
    for k in range(n):
        pivot = matrix[k][k]
        if not pivot > 0:
            return False
        for i in range(k + 1, n):
            factor = matrix[i][k] / pivot
            matrix[i] = [a - factor * b for a, b in zip(matrix[i], matrix[k], strict=True)]
    return True


class LyapunovSearch:
    """P with A^T P A < contraction^2 P for all A of shape (V, n, n), for one contraction after the
    other: the programme is compiled once.

    Raises:
        InputError: Names the packages that are missing.
    """

    def __init__(self, matrices: FloatArray) -> None:
        try:
            import cvxpy as cp
        except ImportError as error:
            raise InputError(
                "the certificate needs cvxpy and clarabel; install with: pip install cvxpy clarabel"
            ) from error
        n = matrices.shape[1]
        size = cp.Variable()
        self._p = cp.Variable((n, n), symmetric=True)
        self._square = cp.Parameter(nonneg=True)
        rules = [self._p >> np.eye(n), self._p << size * np.eye(n)]
        rules += [self._square * self._p - a.T @ self._p @ a >> 0 for a in matrices]
        self._programme = cp.Problem(cp.Minimize(size), rules)

    def within(self, contraction: float) -> FloatArray | None:
        """P as the solver finds it, or None."""
        import cvxpy as cp

        self._square.value = (contraction * (1.0 - _MARGIN)) ** 2
        try:
            with warnings.catch_warnings():  # what it finds is checked, inaccurate or not
                warnings.simplefilter("ignore", UserWarning)
                self._programme.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return None
        p = self._p.value
        return None if p is None else np.asarray(0.5 * (p + p.T), dtype=np.float64)


def certify_flux_observer(
    gains: FluxGains,
    omega_low: float,
    omega_high: float,
    currents: Sequence[complex] = (0j,),
    *,
    pieces: int = _PIECES,
    bisections: int = _BISECTIONS,
) -> LyapunovCertificate:
    """Prove the flux observer's linearised error to decay at every speed of the range,
    however fast the speed changes.

    Args:
        omega_low, omega_high: Range of the electrical speed in rad/s, both positive.
        currents: Currents i_d + j i_q in A at which the machine may be. Two with the same i_d stand
            for all between them: A is affine in i_q.
        pieces, bisections: Boxes along the speed, and tries for a smaller contraction: the time is
            proportional to their product.

    Raises:
        NoSolutionError: No common quadratic Lyapunov function was found, or what the solver found
            does not stand the exact check.
    """
    corners = corner_parameters(gains, omega_low, omega_high, pieces)
    matrices = np.array(
        [
            flux_error_matrix(gains, i_dq, *map(float, corner))
            for i_dq in currents
            for corner in corners
        ]
    )
    low = float(np.max(np.abs(np.linalg.eigvals(matrices))))
    if low >= 1.0:
        raise NoSolutionError(
            f"no certificate: at some speed a corner of its box has a pole of modulus {low:.6f}"
        )
    exact = [
        flux_error_matrix(gains, i_dq, *map(_rational, corner))
        for i_dq in currents
        for corner in corners.tolist()
    ]
    search = LyapunovSearch(matrices)
    best, high = None, 1.0
    for _ in range(bisections):
        middle = high if best is None else float(np.sqrt(low * high))
        p = search.within(middle)
        if p is not None and holds_exactly(p, middle, exact):
            best, high = LyapunovCertificate(p, middle, omega_low, omega_high, len(exact)), middle
        elif best is None:
            raise NoSolutionError(
                "no certificate: no common quadratic Lyapunov function for this range of speeds"
            )
        else:
            low = middle
    assert best is not None
    return best
