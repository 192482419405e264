"""The back-EMF of a table over the angle, and the currents that follow from it, in alpha-beta-0.

Everything is amplitude-invariant, 0 is the mean of the phases. For 1 N m with least copper loss

    u = f / (p (3/2 |f_alphabeta|^2 + 3 f_0^2)),      f_0 = 0 where no zero sequence is used
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.phase_controller import PhaseShape

_TURN = 2.0 * np.pi / 3.0


PHASES = np.linalg.inv(clarke_matrix())

"""Matrix (3, 3) from alpha, beta and 0 to the phases."""


def flux_at(shape: PhaseShape, angle: FloatArray) -> FloatArray:
    """Back-EMF over electrical speed in Wb on alpha, beta and 0, shape (3, ...).

    Parameters
    ----------
    shape:
        The table.
    angle:
        Electrical angles in rad, any shape.
    """
    rows = shape.flux if shape.flux.shape[0] == 3 else np.repeat(shape.flux, 3, axis=0)
    lags = np.zeros(3) if shape.flux.shape[0] == 3 else _TURN * np.arange(3)
    period, count = 2.0 * np.pi * shape.turns, rows.shape[1]
    phases = []
    for row, lag in zip(rows, lags, strict=True):
        place = np.mod((angle - lag) * (count / period), count)
        # The remainder of a tiny negative number is the divisor itself.
        left = np.minimum(place.astype(np.intp), count - 1)
        part = place - left
        phases.append(row[left] + part * (row[(left + 1) % count] - row[left]))
    return np.asarray(np.einsum("jk,k...->j...", clarke_matrix(), np.stack(phases)))


def unit_currents(flux: FloatArray, pole_pairs: int, *, zero: bool) -> FloatArray:
    """Currents per torque in A/(N m) on alpha, beta and 0, shape (3, ...).

    Parameters
    ----------
    flux:
        Back-EMF over electrical speed in Wb on alpha, beta and 0, shape (3, ...).
    pole_pairs:
        Number of pole pairs.
    zero:
        Whether the zero sequence shares the torque.
    """
    used = flux if zero else flux * np.array([1.0, 1.0, 0.0]).reshape(3, *[1] * (flux.ndim - 1))
    weight = pole_pairs * (1.5 * (used[0] ** 2 + used[1] ** 2) + 3.0 * used[2] ** 2)
    return np.asarray(used / weight)


def torque_of(flux: FloatArray, currents: FloatArray, pole_pairs: int) -> FloatArray:
    """Torque in N m of currents in A, both on alpha, beta and 0, shapes (3, ...).

    Parameters
    ----------
    flux:
        Back-EMF over electrical speed in Wb.
    currents:
        Currents in A.
    pole_pairs:
        Number of pole pairs.
    """
    plane = flux[0] * currents[0] + flux[1] * currents[1]
    return np.asarray(pole_pairs * (1.5 * plane + 3.0 * flux[2] * currents[2]))


def turned(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors on alpha, beta and 0 turned by angles in rad about the 0 axis, shape (3, ...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack(
        np.broadcast_arrays(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2])
    )
