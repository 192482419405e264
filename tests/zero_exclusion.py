"""A second proof of stability over a box, which shares no idea with Lyapunov matrices.

If one drive is stable and z 1 - A is singular for no z on the unit circle and no drive of the
(connected) box, all drives are stable. Cells of (angle of z, b_d, b_q, s, x) are clear where, with
Y the inverse in the middle and T its eigenvectors, Y (z 1 - A) stays within 1 of the unit matrix at
all corners, what they leave out included. In doubles.
"""

from __future__ import annotations

import itertools

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.optimizer.certificates.cell_queue import (
    CurrentLoopBox,
    largest_moduli,
    loop_matrices,
    root_cell,
)

_CORNERS = np.array(list(itertools.product((0, 1), repeat=4)))


def excludes_zero(box: CurrentLoopBox, largest: int = 40_000) -> bool:
    """Whether every drive of a box is proven stable within as many cells."""
    root = root_cell(box)
    middle = loop_matrices(box, root.middle[None])
    if largest_moduli(middle)[0] >= 1.0:
        return False
    angles = np.concatenate([[0.0], np.geomspace(1e-3, np.pi, 25)])
    low = np.hstack([angles[:-1, None], np.tile(root.low, (25, 1))])
    high = np.hstack([angles[1:, None], np.tile(root.high, (25, 1))])
    looked_at = 0
    while len(low):
        looked_at += len(low)
        if looked_at > largest:
            return False
        held = _held(box, low, high)
        low, high = low[held], high[held]
        if not len(low):
            return True
        clear, axis = _clear(box, low, high)
        low, high, axis = low[~clear], high[~clear], axis[~clear]
        rows, value = np.arange(len(low)), 0.5 * (low + high)
        lower, upper = low.copy(), high.copy()
        lower[rows, axis] = upper[rows, axis] = value[rows, axis]
        low, high = np.vstack([low, lower]), np.vstack([upper, high])
    return True


def _held(box: CurrentLoopBox, low: FloatArray, high: FloatArray) -> BoolArray:
    """Cells in which drives may lie: those that some voltage gain reaches."""
    (d, q), (least, most) = box.decoupling, box.gain
    below = np.maximum(low[:, 1] * box.l_d[0] / d, low[:, 2] * box.l_q[0] / q)
    above = np.minimum(high[:, 1] * box.l_d[1] / d, high[:, 2] * box.l_q[1] / q)
    below = np.maximum(np.maximum(below, least), box.r_s[0] / high[:, 3])
    above = np.minimum(np.minimum(above, most), box.r_s[1] / low[:, 3])
    return np.asarray(below <= above * (1.0 + 1e-12))


def _clear(box: CurrentLoopBox, low: FloatArray, high: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Cells without a zero, and where the others are cut, both of shape (N,)."""
    count = len(low)
    points = np.where(_CORNERS[:, None] == 1, high[None, :, 1:], low[None, :, 1:])
    corners = loop_matrices(box, points.reshape(-1, 4)).reshape(16, count, 6, 6)
    middle = 0.5 * (low + high)
    centre = loop_matrices(box, middle[:, 1:])
    poles, frame = np.linalg.eig(centre)
    back = np.linalg.inv(frame)
    inverse = 1.0 / (np.exp(1j * middle[:, 0])[:, None] - poles)
    changes = inverse[:, :, None] * (back @ (corners - centre) @ frame)
    width = high - low
    reach = np.zeros(count)
    for angle in (low[:, 0], high[:, 0]):
        moved = (np.exp(1j * angle) - np.exp(1j * middle[:, 0]))[:, None] * inverse
        whole = moved[:, :, None] * np.eye(6) - changes
        reach = np.maximum(reach, np.sqrt((np.abs(whole) ** 2).sum((2, 3))).max(axis=0))
    size = np.abs(inverse).max(axis=1)
    rest = width[:, 0] ** 2 / 8.0 * size
    e_phi, e_gam = _rests(box, low, high)
    left = np.linalg.norm(inverse[:, :, None] * back[:, :, :2], axis=(1, 2))
    right = e_phi * np.linalg.norm(frame[:, :2], axis=(1, 2))
    right += e_gam * np.linalg.norm(frame[:, 2:4], axis=(1, 2))
    steps = [0.5 * width[:, 0] * size]
    for axis in range(4):
        one = np.zeros(4, dtype=int)
        one[axis] = 1
        place = int(np.flatnonzero((one == _CORNERS).all(axis=1))[0])
        steps.append(0.5 * np.linalg.norm(changes[place] - changes[0], axis=(1, 2)))
    return reach + rest + left * right < 0.999, np.argmax(np.array(steps), axis=0)


def _rests(box: CurrentLoopBox, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the corners leave out of Phi and Gam, without negative resistance."""
    rho = box.t_s / np.array(box.decoupling)
    slopes = np.column_stack(
        [
            high[:, 3] * rho[0],
            high[:, 3] * rho[1],
            (high[:, 1:3] * rho).max(axis=1),
            np.ones(len(low)),
        ]
    )
    steps = ((high - low)[:, 1:] * slopes) ** 2
    return steps.sum(axis=1) / 8.0, steps[:, :3].sum(axis=1) / 24.0 + steps[:, 3] / 12.0
