"""The back-EMF of a table over the angle, and the currents that follow from it, in alpha-beta-0.

Everything is amplitude-invariant, 0 is the mean of the phases. For 1 N m with least copper loss

    u = f / (p (3/2 |f_alphabeta|^2 + 3 f_0^2)),      f_0 = 0 where no zero sequence is used
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.frame_choice import uses_zero_sequence
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.phase_controller import PhaseControl, PhaseShape

_TURN = 2.0 * np.pi / 3.0
PHASES = np.linalg.inv(clarke_matrix())  # Matrix (3, 3) from alpha, beta and 0 to the phases.


def phase_rows(
    table: FloatArray,
    turns: int,
    angle: FloatArray,
    which: tuple[NDArray[np.intp], ...] = (),
) -> FloatArray:
    """Values of the three phases at angles in rad, by straight lines between nodes, shape (3, ...).

    Args:
        table: Nodes of phase a, shape (1, ..., N), of which b and c lag by a third and two thirds
            of an electrical period, or of all phases, shape (3, ..., N).
        turns: Electrical periods that the nodes span.
        angle: Electrical angles in rad, any shape.
        which: Indices of the axes between the first and the last one, each of the angles' shape.
    """
    equal = table.shape[0] == 1
    period, count = 2.0 * np.pi * turns, table.shape[-1]
    phases = []
    for phase in range(3):
        row = table[0 if equal else phase]
        place = _remainder((angle - _TURN * phase * equal) * (count / period), count)
        # The remainder of a tiny negative number is the divisor itself.
        left = np.minimum(place.astype(np.intp), count - 1)
        part = place - left
        here, after = row[(*which, left)], np.roll(row, -1, axis=-1)[(*which, left)]
        phases.append(here + part * (after - here))
    return np.stack(phases)


def _remainder(value: FloatArray, divisor: int) -> FloatArray:
    """`numpy.mod`, bit for bit, in a quarter of its time.

    A quotient that is not whole never rounds away from zero to a whole number, so that what is left
    of a value is exact.
    """
    whole = np.asarray(value / divisor).astype(np.intp)
    left = np.asarray(value - whole * divisor)
    left += (left < 0.0) * divisor
    return left


def flux_at(shape: PhaseShape, angle: FloatArray) -> FloatArray:
    """Back-EMF over electrical speed in Wb on alpha, beta and 0, shape (3, ...).

    Args:
        shape: The table.
        angle: Electrical angles in rad, any shape.
    """
    phases = phase_rows(shape.flux, shape.turns, angle)
    return np.asarray(np.einsum("jk,k...->j...", clarke_matrix(), phases))


def unit_currents(flux: FloatArray, pole_pairs: int, *, zero: bool) -> FloatArray:
    """Currents per torque in A/(N m) on alpha, beta and 0, shape (3, ...).

    Args:
        flux: Back-EMF over electrical speed in Wb on alpha, beta and 0, shape (3, ...).
        pole_pairs: Number of pole pairs.
        zero: Whether the zero sequence shares the torque.
    """
    used = flux if zero else flux * np.array([1.0, 1.0, 0.0]).reshape(3, *[1] * (flux.ndim - 1))
    weight = pole_pairs * (1.5 * (used[0] ** 2 + used[1] ** 2) + 3.0 * used[2] ** 2)
    return np.asarray(used / weight)


def fade_share(control: PhaseControl, omega_e: FloatArray) -> FloatArray:
    """How much of the harmonics the references keep at electrical speeds in rad/s, 0 to 1: straight
    in the speed between the ends of the fading.

    Args:
        control: The control.
        omega_e: Electrical speeds in rad/s, any shape.
    """
    begin, end = (1.0 / samples for samples in control.fade)
    fraction = np.abs(omega_e) * control.t_s / (2.0 * np.pi)
    return np.asarray(np.clip((end - fraction) / (end - begin), 0.0, 1.0))


def reference_flux(control: PhaseControl, angle: FloatArray, omega_e: FloatArray) -> FloatArray:
    """The vector in Wb on alpha, beta and 0 that references are made from, shape (3, ...).

    The fundamental in dq; else the table, faded to its fundamental where there are few samples per
    period, without its zero sequence where that makes no torque.

    Args:
        control: The control.
        angle: Electrical angles in rad, any shape.
        omega_e: Electrical speeds in rad/s, broadcastable.
    """
    sine = control.psi_pm * np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)])
    if control.frame == "dq":
        return sine
    share = fade_share(control, omega_e)
    found = sine + share * (flux_at(control.shape, angle) - sine)
    found[2] *= float(uses_zero_sequence(control.frame, control.topology))
    return np.asarray(found)


def reference_currents(control: PhaseControl, angle: FloatArray, omega_e: FloatArray) -> FloatArray:
    """Currents per torque of the references in A/(N m) on alpha, beta and 0, shape (3, ...).

    Args:
        control: The control.
        angle: Electrical angles in rad, any shape.
        omega_e: Electrical speeds in rad/s, broadcastable.
    """
    return unit_currents(reference_flux(control, angle, omega_e), control.pole_pairs, zero=True)


def torque_of(flux: FloatArray, currents: FloatArray, pole_pairs: int) -> FloatArray:
    """Torque in N m of currents in A, both on alpha, beta and 0, shapes (3, ...).

    Args:
        flux: Back-EMF over electrical speed in Wb.
        currents: Currents in A.
        pole_pairs: Number of pole pairs.
    """
    plane = flux[0] * currents[0] + flux[1] * currents[1]
    return np.asarray(pole_pairs * (1.5 * plane + 3.0 * flux[2] * currents[2]))


def turned(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors on alpha, beta and 0 turned by angles in rad about the 0 axis, shape (3, ...)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack(
        np.broadcast_arrays(c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2])
    )
