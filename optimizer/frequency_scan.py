"""A loop over many frequencies at little cost, and roots in brackets in few evaluations.

A scan needs thousands of solutions of (zI - A) x = b with one A. With A = Q T Q^H, T upper
triangular (Schur), each of them is a back substitution, and n of these serve all frequencies at
once. Q is unitary: the digits are those of a solution by elimination.

References:
    A. J. Laub, "Efficient multivariable frequency response computations", IEEE Trans. Automatic
    Control 26, 1981 (with Hessenberg matrices; the triangular ones here take fewer operations). T.
    R. Chandrupatla, "A new hybrid quadratic/bisection algorithm for finding the zero of a nonlinear
    function without using derivatives", Advances in Engineering Software 28, 1997.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_MOST_STEPS = 100  # Chandrupatla's method takes some eight; a function of pure noise ends here.
_SPACING = float(np.finfo(np.float64).eps)


def scanned_response(
    a: FloatArray, b: FloatArray, c: FloatArray, d: float, z: ComplexArray
) -> ComplexArray:
    """C (zI - A)^-1 b + d at many points, (F,) -> (F,).

    Args:
        a: Transition matrix, shape (n, n).
        b, c: Input column and output row, shape (n,).
        d: Direct part.
        z: Points that are no eigenvalues of A.
    """
    from scipy.linalg import matrix_balance, schur

    balanced, scales = matrix_balance(a, permute=False)
    sizes = np.diag(scales)
    triangle, turned = schur(balanced, output="complex")
    entry, exit_ = np.conj(turned.T) @ (b / sizes), (c * sizes) @ turned
    states = np.zeros((len(a), len(z)), dtype=np.complex128)
    for row in range(len(a) - 1, -1, -1):
        after = triangle[row, row + 1 :] @ states[row + 1 :]
        states[row] = (entry[row] + after) / (z - triangle[row, row])
    return np.asarray(exit_ @ states + d, dtype=np.complex128)


def bracketed_roots(
    function: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray
) -> FloatArray:
    """Roots in the brackets [low, high], shape (brackets,), all narrowed together.

    By Chandrupatla's method: inverse quadratic interpolation where that is safe, else bisection,
    until each bracket is as wide as the spacing of doubles.

    Args:
        function: Takes one argument per bracket; of different signs at both ends of each.
        low, high: Ends of the brackets.
    """
    if len(low) == 0:
        return low
    first, value_first = np.array(high), function(high)
    last, value_last = np.array(low), function(low)
    other, value_other = first.copy(), value_first.copy()
    share = np.full(len(low), 0.5)
    best = last.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        for _ in range(_MOST_STEPS):
            trial = first + share * (last - first)
            value = function(trial)
            same = np.sign(value) == np.sign(value_first)
            other = np.where(same, first, last)
            value_other = np.where(same, value_first, value_last)
            last = np.where(same, last, first)
            value_last = np.where(same, value_last, value_first)
            first, value_first = trial, value
            best = np.where(np.abs(value_first) < np.abs(value_last), first, last)
            width = np.abs(last - first)
            least = 0.5 * _SPACING * np.abs(best) / width
            if np.all((least > 0.25) | (value_first == 0.0) | (width == 0.0)):
                break
            share = _interpolated(
                (first, last, other), (value_first, value_last, value_other), least
            )
    return best


def _interpolated(
    points: tuple[FloatArray, FloatArray, FloatArray],
    values: tuple[FloatArray, FloatArray, FloatArray],
    least: FloatArray,
) -> FloatArray:
    """Share of the way from the latest point to the other end at which to try next."""
    (a, b, c), (f_a, f_b, f_c) = points, values
    place, height = (a - b) / (c - b), (f_a - f_b) / (f_c - f_b)
    safe = (height * height < place) & ((1.0 - height) ** 2 < 1.0 - place)
    found = f_a / (f_b - f_a) * (f_c / (f_b - f_c)) + (c - a) / (b - a) * (f_a / (f_c - f_a)) * (
        f_b / (f_c - f_b)
    )
    share = np.where(safe & np.isfinite(found), found, 0.5)
    least = np.minimum(least, 0.5)
    return np.asarray(np.clip(share, least, 1.0 - least), dtype=np.float64)
