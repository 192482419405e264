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

from dataclasses import dataclass

import numpy as np

from dqforge.machines.arrays import FloatArray

_SLACK = 1e-5

"""What the left-hand side keeps from 1, so that rounding does not decide."""


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

    Parameters
    ----------
    before, after:
        P before and after the step, shapes (n, n) and (m, m); the same for one common P.
    closed:
        Corners of the step, shape (V, m, n).
    remainder:
        What the corners leave out.
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

    Parameters
    ----------
    closed:
        The loop, shape (n, n).
    """
    from scipy.linalg import solve_discrete_lyapunov

    try:
        matrix = solve_discrete_lyapunov(closed.T, np.eye(len(closed)))
        return np.asarray(np.linalg.cholesky(0.5 * (matrix + matrix.T)).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None


def common_lyapunov(closed: FloatArray, frame: FloatArray) -> FloatArray | None:
    """A P that falls along all corners, proposed by the inequality solver; None where it has none.

    Parameters
    ----------
    closed:
        Corners, shape (V, n, n).
    frame:
        T of the loop in the middle, shape (n, n).
    """
    from dqforge.optimizer.box_proofs.matrix_inequalities import common_matrix

    back = np.linalg.inv(frame)
    found = common_matrix(frame @ closed @ back, back.T @ back)
    if found is None or found.scalar <= 1e-7:
        return None
    matrix = frame.T @ found.matrices[0] @ frame
    return np.asarray(0.5 * (matrix + matrix.T), dtype=np.float64)
