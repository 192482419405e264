"""Whether P falls along a step at the corners of a cell and with what they leave out.

A step of the cell is a convex combination of its corners A_v plus E with |E_rc| <= e_rc in a few
rows. With M_v = P - A_v^T P' A_v > 0 and X M_v X^T = 1, the step contracts from P to P' if at every
corner

    2 sum of e_rc |X A_v^T P' u_r| |X_c| + (sum of e_rc sqrt(P'_rr) |X_c|)^2 < 1

u_r being unit vectors and X_c columns of X. Rows keep bounds of their own because they differ by
orders of magnitude: the speed moves by far less in a sample than the flux linkage.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.box_proofs.contraction import Contraction

_SLACK = 1e-5  # What the left-hand side keeps from 1, so that rounding does not decide.


def step_contracts(
    before: FloatArray, after: FloatArray, closed: FloatArray, left_out: FloatArray
) -> Contraction:
    """Whether x^T P x falls over a step.

    Args:
        before, after: P and P', shapes (n, n) and (m, m).
        closed: Corners of the step, shape (V, m, n).
        left_out: Bounds of the entries that the corners leave out: of the first rows and columns.
    """
    fall = before - np.swapaxes(closed, 1, 2) @ after @ closed
    try:
        np.linalg.cholesky(before)
        np.linalg.cholesky(after)
        frame = np.linalg.inv(np.linalg.cholesky(0.5 * (fall + np.swapaxes(fall, 1, 2))))
    except np.linalg.LinAlgError:
        return Contraction(corners=False, whole=False)
    if not np.isfinite(frame).all():
        return Contraction(corners=False, whole=False)
    rows, columns = left_out.shape
    turned = frame @ np.swapaxes(closed, 1, 2) @ after[:, :rows]
    cross = np.sqrt((turned**2).sum(1))
    reach = np.sqrt((frame[:, :, :columns] ** 2).sum(1)) @ left_out.T
    own = reach @ np.sqrt(np.diag(after)[:rows])
    whole = 2.0 * (cross * reach).sum(1) + own**2 < 1.0 - _SLACK
    return Contraction(corners=True, whole=bool(whole.all()))
