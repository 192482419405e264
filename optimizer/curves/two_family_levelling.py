"""Levelling of torque and flux errors over two linear families of currents:
Gauss-Newton steps in a rising p-norm.

The largest of many errors is brought down, each in units of what is permitted for it. Currents
themselves are no aim: next to MTPV many of them make nearly the same torque at the same flux
linkage, and only those two count.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass

_LARGEST_NORM = 14.0
_STEPS = 36

# Weight that holds steps along which neither torque nor flux change, per current limit.
_DAMPING = 0.01


@dataclass(frozen=True, slots=True)
class Aims:
    """What the currents at N points are to make, arrays of shape (N,).

    ``torque`` in N m and ``flux`` in Wb with the reciprocals of their permitted errors; ``i_d`` and
    ``i_q`` in A with ``per_current``; the current stays below ``i_max`` A with ``per_excess``. A
    reciprocal of 0 leaves that aim out.
    """

    machine: Machine
    torque: FloatArray
    per_torque: FloatArray
    flux: FloatArray
    per_flux: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    per_current: FloatArray
    i_max: float
    per_excess: float

    def errors(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Errors in units of the permitted ones, shape (5, N), and their derivatives by i_d and by
        i_q.
        """
        jet, factor = self.machine.jet(i_d, i_q), 1.5 * self.machine.pole_pairs
        torque = factor * (jet.psi_d * i_q - jet.psi_q * i_d)
        flux = np.maximum(np.hypot(jet.psi_d, jet.psi_q), 1e-300)
        zero = np.zeros_like(i_d)
        current = np.maximum(np.hypot(i_d, i_q), 1e-300)
        beyond = np.maximum(current - self.i_max, 0.0)
        errors = (torque - self.torque, flux - self.flux, i_d - self.i_d, i_q - self.i_q, beyond)
        by_d = (
            factor * (jet.l_dd * i_q - jet.psi_q - jet.l_qd * i_d),
            (jet.psi_d * jet.l_dd + jet.psi_q * jet.l_qd) / flux,
            zero + 1.0,
            zero,
            np.where(beyond > 0.0, i_d / current, 0.0),
        )
        by_q = (
            factor * (jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d),
            (jet.psi_d * jet.l_dq + jet.psi_q * jet.l_qq) / flux,
            zero,
            zero + 1.0,
            np.where(beyond > 0.0, i_q / current, 0.0),
        )
        units = np.stack(
            [
                self.per_torque,
                self.per_flux,
                self.per_current,
                self.per_current,
                zero + self.per_excess,
            ]
        )
        return units * np.stack(errors), units * np.stack(by_d), units * np.stack(by_q)


@dataclass(frozen=True, slots=True)
class Levelled:
    """Coefficients of both families, shapes (A,) and (B,), and the largest error in
    units of the permitted one.
    """

    d: FloatArray
    q: FloatArray
    worst: float


def level(
    aims: Aims,
    base: tuple[FloatArray, FloatArray],
    family_d: FloatArray,
    family_q: FloatArray,
    scale: float,
) -> Levelled:
    """Coefficients with the least largest error (nearly), from the least-squares fit of the
    currents.

    Args:
        aims: What is to be met at N points.
        base: Currents in A to which the families add, shape (N,) each.
        family_d, family_q: Values of the functions of each family at the points, shapes (N, A) and
            (N, B), of full rank.
        scale: Current in A that steps are measured by.
    """
    basis_d, triangle_d = np.linalg.qr(family_d)
    basis_q, triangle_q = np.linalg.qr(family_q)
    # In an orthonormal basis the first fit is a projection, and normal equations lose no digits.
    both = np.concatenate([basis_d.T @ (aims.i_d - base[0]), basis_q.T @ (aims.i_q - base[1])])
    split = basis_d.shape[1]

    def errors(weights: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return aims.errors(base[0] + basis_d @ weights[:split], base[1] + basis_q @ weights[split:])

    now, by_d, by_q = errors(both)
    best, worst = both, float(np.max(np.abs(now)))
    for step in range(_STEPS):
        norm = min(2.0 + step, _LARGEST_NORM)
        largest = float(np.max(np.abs(now)))
        if largest == 0.0:
            break
        share = np.maximum(np.abs(now) / largest, 1e-3) ** (norm - 2.0)
        slope_d, slope_q = np.sum(share * by_d * now, axis=0), np.sum(share * by_q * now, axis=0)
        gradient = np.concatenate([basis_d.T @ slope_d, basis_q.T @ slope_q])
        cross = basis_d.T @ (np.sum(share * by_d * by_q, axis=0)[:, np.newaxis] * basis_q)
        normal = np.block(
            [
                [basis_d.T @ (np.sum(share * by_d**2, axis=0)[:, np.newaxis] * basis_d), cross],
                [cross.T, basis_q.T @ (np.sum(share * by_q**2, axis=0)[:, np.newaxis] * basis_q)],
            ]
        )
        normal[np.diag_indices_from(normal)] += (_DAMPING / scale) ** 2
        direction = -np.linalg.solve(normal, gradient)
        length = 1.0 / (norm - 1.0)
        before = float(np.sum((np.abs(now) / largest) ** norm))
        for _ in range(6):
            trial = both + length * direction
            tried = errors(trial)
            if float(np.sum((np.abs(tried[0]) / largest) ** norm)) <= before:
                break
            length *= 0.5
        both, (now, by_d, by_q) = trial, tried
        if float(np.max(np.abs(now))) < worst:
            best, worst = both, float(np.max(np.abs(now)))
    return Levelled(
        np.linalg.solve(triangle_d, best[:split]), np.linalg.solve(triangle_q, best[split:]), worst
    )
