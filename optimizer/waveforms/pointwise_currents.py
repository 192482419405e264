"""Least-loss phase currents of constant torque for salient machines, each angle by itself,
to the global optimum.

Where neither dc link nor slew rate ties the angles together, each asks for the least |i|^2 with
b'i + i'Ai = T: one quadratic equality, whose optimum is global where I - lambda A is positive
semidefinite (S-lemma). In the eigenvectors of A, i_k = lambda b_k / (2 (1 - lambda a_k)), and the
torque grows with lambda on the whole interval that is left.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.waveforms.constraint_rows import OpenPhase

_STEPS = 200


_DOUBLINGS = 200


_EXACT = 1e-9


_ROUNDING = 1e-13


_LARGEST = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class PointwiseTorque:
    """Torque b'y + sum a_k y_k^2 at M angles in N m over r independent currents y in A.

    The phases carry i = V y.

    ``linear`` b in N m/A and ``curvature`` a in N m/A^2, shape (M, r); ``basis`` V, orthonormal,
    shape (M, 3, r).
    """

    linear: FloatArray
    curvature: FloatArray
    basis: FloatArray

    def phases(self, own: FloatArray) -> FloatArray:
        """Phase currents in A, shape (..., 3, M), of independent ones, shape (..., M, r)."""
        return np.asarray(np.moveaxis(np.einsum("mkr,...mr->...mk", self.basis, own), -1, -2))


def free_currents(topology: Topology, open_phase: OpenPhase | None) -> FloatArray:
    """Orthonormal basis of the phase currents that topology and open phase permit, shape (3, r)."""
    rows = []
    if not TOPOLOGIES[topology].neutral:
        rows.append(np.ones(3))
    if open_phase is not None:
        rows.append(np.eye(3)["abc".index(open_phase)])
    if not rows:
        return np.eye(3)
    _, size, right = np.linalg.svd(np.array(rows))
    return np.ascontiguousarray(right[np.count_nonzero(size > _ROUNDING) :].T)


def torque_forms(
    flux: FloatArray, slope: FloatArray, pole_pairs: int, free: FloatArray
) -> PointwiseTorque:
    """Torque over the independent currents, from flux (3, M) in Wb and dL/dtheta (M,
    3, 3) in H/rad.
    """
    form = 0.5 * pole_pairs * np.einsum("kr,mkl,ls->mrs", free, slope, free)
    curvature, turned = np.linalg.eigh(0.5 * (form + np.swapaxes(form, 1, 2)))
    basis = np.einsum("kr,mrs->mks", free, turned)
    return PointwiseTorque(pole_pairs * np.einsum("km,mkr->mr", flux, basis), curvature, basis)


def _own_currents(
    made: PointwiseTorque, multiplier: FloatArray
) -> tuple[list[FloatArray], FloatArray]:
    """Independent currents, r of them, and their torque, each of shape (K, M)."""
    own, parts = [], []
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for linear, curvature in zip(made.linear.T, made.curvature.T, strict=True):
            left = 1.0 - multiplier * curvature
            current = np.where(linear == 0.0, 0.0, multiplier * linear / (2.0 * left))
            parts.append(linear * current + curvature * current**2)
            own.append(current)
    return own, sum(parts[1:], parts[0])


def _slope(made: PointwiseTorque, multiplier: FloatArray) -> FloatArray:
    """Of the torque by the multiplier, shape (K, M)."""
    parts = []
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for linear, curvature in zip(made.linear.T, made.curvature.T, strict=True):
            left = 1.0 - multiplier * curvature
            parts.append(np.where(linear == 0.0, 0.0, linear**2 / left**3))
    return 0.5 * sum(parts[1:], parts[0])


def _interval(made: PointwiseTorque, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Multipliers between which the one for each torque lies, shapes (K, M)."""
    most, least = np.max(made.curvature, axis=1), np.min(made.curvature, axis=1)
    strength = np.maximum(np.sum(made.linear**2, axis=1), np.finfo(float).tiny)
    with np.errstate(divide="ignore"):
        above = np.where(most > 0.0, (1.0 - _ROUNDING) / most, np.inf)
        below = np.where(least < 0.0, (1.0 - _ROUNDING) / least, -np.inf)
    guess = 2.0 * np.abs(torque) / strength
    high = np.where(torque > 0.0, np.minimum(above, guess), 0.0)
    low = np.where(torque < 0.0, np.maximum(below, -guess), 0.0)
    for _ in range(_DOUBLINGS):
        short = (_own_currents(made, high)[1] < torque) & (high < above) & (torque > 0.0)
        over = (_own_currents(made, low)[1] > torque) & (low > below) & (torque < 0.0)
        if not (np.any(short) or np.any(over)):
            break
        high = np.where(short, np.minimum(above, 2.0 * high), high)
        low = np.where(over, np.maximum(below, 2.0 * low), low)
    return low, high


def _search(
    made: PointwiseTorque, wanted: FloatArray, at: FloatArray, low: FloatArray, high: FloatArray
) -> None:
    """Move the multipliers ``at`` between ``low`` and ``high`` to the torques ``wanted``, in place,
    shapes (K, M): by Newton's method, and by halves where that leaves the interval.

    What stands still is where it will be, and is left out of the steps that the others need.
    """
    place = np.flatnonzero(np.ones(at.shape, dtype=np.bool_))
    for _ in range(_STEPS):
        of = place % at.shape[1]
        part = PointwiseTorque(made.linear[of], made.curvature[of], made.basis)
        goal, here, least, most = (x.ravel()[place] for x in (wanted, at, low, high))
        found, slope = _own_currents(part, here)[1], _slope(part, here)
        below, above = np.where(found <= goal, here, least), np.where(found >= goal, here, most)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = here - (found - goal) / slope
        inside = (newton > below) & (newton < above)
        following = np.where(inside, newton, 0.5 * (below + above))
        if np.all(np.abs(following - here) <= 2e-16 * np.abs(here)):
            break
        for whole, value in ((at, following), (low, below), (high, above)):
            whole.flat[place] = value
        place = place[(following != here) | (below != least) | (above != most)]


def least_currents(made: PointwiseTorque, torque: FloatArray) -> FloatArray:
    """Phase currents in A of least |i|^2 for torques in N m, shape (K,), at every angle: (K, 3, M).

    NaN at angles where no current that is permitted makes the torque.
    """
    wanted = np.broadcast_to(torque[:, np.newaxis], (torque.size, made.linear.shape[0]))
    low, high = _interval(made, wanted)
    at = np.clip(
        2.0 * wanted / np.maximum(np.sum(made.linear**2, axis=1), np.finfo(float).tiny), low, high
    )
    _search(made, wanted, at, low, high)
    own, found = _own_currents(made, at)
    scale = np.maximum(np.max(np.abs(wanted)), np.finfo(float).tiny)
    missed = ~(np.abs(found - wanted) <= _EXACT * scale)
    return made.phases(np.where(missed[..., np.newaxis], np.nan, np.stack(own, axis=-1)))


def pointwise_currents(
    machine: SalientPhaseMachine,
    torque: FloatArray,
    topology: Topology,
    open_phase: OpenPhase | None = None,
) -> FloatArray:
    """Phase currents in A, shape (K, 3, N), of constant torque at least copper loss,
    dc link and current limit apart.

    ``torque`` in N m has the shape (K,).

    Raises:
        NoSolutionError: Some torque cannot be made at some angle, or only with currents beyond all
            measure.
    """
    made = torque_forms(
        machine.flux, machine.slope, machine.pole_pairs, free_currents(topology, open_phase)
    )
    currents = least_currents(made, np.asarray(torque, dtype=np.float64))
    size = np.max(np.abs(currents), axis=(0, 1))
    bad = ~(size <= _LARGEST * np.nanmin(size))
    if np.any(torque) and np.any(bad):
        where = 360.0 * machine.turns * int(np.argmax(bad)) / machine.angles
        raise NoSolutionError(
            f"constant torque cannot be made near {where:.0f} degrees: no phase that may carry "
            "current makes it there; permit a torque ripple"
        )
    return currents
