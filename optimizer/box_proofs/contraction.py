"""Whether P falls along every closed loop of a cell: its corners, and a small rest, in doubles.

Over a cell of parameters a closed loop A is a convex combination of its corners A_v plus U E, where
U picks the rows that are not multi-affine and E is bounded column group by column group. With
M_v = P - A_v^T P A_v > 0 and X M_v X^T = 1, every loop of the cell contracts if

    2 |X A_v^T P U| a + |U^T P U| a^2 < 1,     a = sum of e_j |X_j|

at every corner, X_j the columns of X that meet the states of group j. (A -> A^T P A is convex, so
that the corners stand for everything between.) The same holds for a step from P before to another
P after.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.interior_point import Blocks, Budget, climb

_SLACK = 1e-5  # What the left-hand side keeps from 1, so that rounding does not decide.


@dataclass(frozen=True, slots=True)
class Remainder:
    """What the corners leave out: ``rows`` of the matrix that err, and by how much.

    ``groups`` are pairs of the columns of a block and the bound of its 2-norm.
    """

    rows: tuple[int, ...]
    groups: tuple[tuple[tuple[int, ...], float], ...]


NOTHING_LEFT = Remainder((), ())


@dataclass(frozen=True, slots=True)
class Contraction:
    """``corners``: whether they alone contract; ``whole``: whether the remainder does too."""

    corners: bool
    whole: bool


def contracts(
    before: FloatArray, after: FloatArray, closed: FloatArray, remainder: Remainder = NOTHING_LEFT
) -> Contraction:
    """Whether x^T P x falls over a step, at the corners and with the remainder.

    Args:
        before, after: P before and after the step, shapes (n, n) and (m, m); the same for one
            common P.
        closed: Corners of the step, shape (V, m, n).
        remainder: What the corners leave out.
    """
    fall = before - np.swapaxes(closed, 1, 2) @ after @ closed
    fall = 0.5 * (fall + np.swapaxes(fall, 1, 2))
    try:
        np.linalg.cholesky(before)
        np.linalg.cholesky(after)
        lower = np.linalg.cholesky(fall)
    except np.linalg.LinAlgError:
        return Contraction(corners=False, whole=False)
    frame = np.linalg.inv(lower)
    if not np.isfinite(frame).all():
        return Contraction(corners=False, whole=False)
    return Contraction(corners=True, whole=_rest_falls(frame, after, closed, remainder))


def _rest_falls(
    frame: FloatArray, after: FloatArray, closed: FloatArray, remainder: Remainder
) -> bool:
    rows = list(remainder.rows)
    reach = np.zeros(len(closed))
    for columns, bound in remainder.groups:
        reach += bound * np.sqrt((frame[:, :, list(columns)] ** 2).sum((1, 2)))
    cross = np.sqrt(((frame @ np.swapaxes(closed, 1, 2) @ after[:, rows]) ** 2).sum((1, 2)))
    own = float(np.sqrt((after[np.ix_(rows, rows)] ** 2).sum()))
    return bool((2.0 * cross * reach + own * reach**2 < 1.0 - _SLACK).all())


def lyapunov_frame(closed: FloatArray) -> FloatArray | None:
    """The frame T in which one stable loop contracts most evenly: P_0 = T^T T with
    A^T P_0 A - P_0 + 1 = 0; None where the loop is not stable enough for a double.

    Args:
        closed: The loop, shape (n, n).
    """
    from scipy.linalg import solve_discrete_lyapunov

    try:
        matrix = solve_discrete_lyapunov(closed.T, np.eye(len(closed)))
        return np.asarray(np.linalg.cholesky(0.5 * (matrix + matrix.T)).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None


def common_lyapunov(
    closed: FloatArray,
    frame: FloatArray,
    taken: Callable[[FloatArray], bool] | None = None,
    budget: Budget | None = None,
) -> FloatArray | None:
    """A P that falls along all corners; None where there is none.

    In the frame, asked for is the largest t with P - A_v^T P A_v >= t T^-T T^-1 and a trace of n,
    from P = 1, which is the answer of the loop in the middle (t = 1). Slow integrators would drown
    without the frame.

    Args:
        closed: Corners, shape (V, n, n).
        frame: T of the loop in the middle, shape (n, n).
        taken: Whether a proposal already serves; without it, that with the largest t is returned.
        budget: Steps that may be taken.
    """
    back = np.linalg.inv(frame)
    seen = frame @ closed @ back
    turned = np.swapaxes(seen, 1, 2)
    weight = back.T @ back
    parts = _traceless(len(frame))
    slopes = np.empty((len(closed), len(parts) + 1, *frame.shape))
    slopes[:, :-1] = parts - turned[:, None] @ parts @ seen[:, None]
    slopes[:, -1] = -weight
    blocks = Blocks(np.eye(len(frame)) - turned @ seen, slopes)
    # T^T (P - A^T P A) T against the unit matrix, as the weight is T^-T T^-1
    least = float(np.linalg.eigvalsh(frame.T @ blocks.constant @ frame).min())
    start = np.zeros(len(parts) + 1)
    start[-1] = least - 0.3 * abs(least) - 0.05

    def matrix(unknowns: FloatArray) -> FloatArray:
        inner = np.eye(len(frame)) + np.einsum("n,nij->ij", unknowns[:-1], parts)
        whole = frame.T @ inner @ frame
        return np.asarray(0.5 * (whole + whole.T), dtype=np.float64)

    def serves(unknowns: FloatArray) -> bool:
        return taken is not None and unknowns[-1] > 0.0 and taken(matrix(unknowns))

    found = climb(blocks, start, serves, hopeless=1e-7, budget=budget)
    return None if found is None or found[-1] <= 1e-7 else matrix(found)


@lru_cache(maxsize=8)
def _traceless(size: int) -> FloatArray:
    """A basis of the symmetric matrices without trace, shape (n(n+1)/2 - 1, n, n)."""
    parts = []
    for column in range(size):
        for row in range(column + 1):
            part = np.zeros((size, size))
            part[row, column] = part[column, row] = 1.0
            parts.append(part - np.trace(part) / size * np.eye(size))
    return np.array(parts[:-1])
