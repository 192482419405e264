"""Quadratic programmes for phase currents: least copper loss for a torque, within bus,
current and topology.

What must hold at every angle (the torque where no ripple is allowed, no zero-sequence current, an
open phase) is solved out: i = T c + B z with c the current of least size that satisfies it for 1 N
m, and B an orthonormal basis of what is left free, angle by angle. The objective becomes |z|^2 + 2
T c'B z, and only inequalities remain: a problem of 60 or 120 unknowns for a symmetric machine
instead of 1080.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.phase_machine import (
    MIDDLE,
    OFFSETS,
    SLOPE,
    PhaseMachine,
    shift_of,
)
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import VOLTAGE_ROWS
from dqforge.optimizer.waveforms.constraint_rows import (
    WaveformLimits,
    all_rows,
    angle_by_angle,
)

UNBOUNDED = 1e29  # Bounds of this size and beyond are none.

# Unknowns up to which the matrices are kept dense, and an active-set method beats all others.
DENSE_UNKNOWNS = 130


@dataclass(frozen=True, slots=True)
class PointProblem:
    """One quadratic programme: least |z|^2/2 + gradient z for lower <= A z <= upper,
    rows of order one.

    ``matrix`` is A, sparse or an array, shape (m, n).
    """

    matrix: Any
    gradient: FloatArray
    lower: FloatArray
    upper: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class WaveformProblem:
    """Everything that all operating points of a machine under the same rules share.

    ``part`` angles of all are solved for, ``parts`` of them make the whole. ``unit`` is c in A/(N
    m), shape (3 part,), ``basis`` is B, sparse, shape (3 part, n), both with the phases of an angle
    side by side; i = T c + scale B z with ``scale`` in A. The m rows of inequalities hold (still +
    omega_e moving) z + T (still_unit + omega_e moving_unit - torque_share) + omega_e emf between
    ``lower`` and ``upper``; ``kinds`` are their indices into `LIMITS`, or -1 for means, whose
    bounds are equal.
    """

    machine: PhaseMachine
    limits: WaveformLimits
    part: int
    parts: int
    scale: float
    unit: FloatArray
    basis: Any
    still: Any
    moving: Any
    still_unit: FloatArray
    moving_unit: FloatArray
    torque_share: FloatArray
    emf: FloatArray
    lower: FloatArray
    upper: FloatArray
    kinds: NDArray[np.int8]

    @property
    def unknowns(self) -> int:
        """Number of unknowns n."""
        return int(self.basis.shape[1])

    def bounds(self, omega_e: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of the rows at electrical speeds in rad/s, shapes (..., m).

        In reverse rotation the back-EMFs, and with them the rails that the diodes of a
        neutral tie it to, change signs.
        """
        back = np.asarray(omega_e, dtype=np.float64)[..., np.newaxis] < 0.0
        return np.where(back, -self.upper, self.lower), np.where(back, -self.lower, self.upper)

    def offset(self, torque: float, omega_e: float) -> FloatArray:
        """Rows at z = 0, for a torque in N m and an electrical speed in rad/s, shape (m,)."""
        return torque * self.by_torque(omega_e) + omega_e * self.emf

    def by_torque(self, omega_e: float) -> FloatArray:
        """Change of the rows with the torque at z = 0, in 1/(N m), shape (m,)."""
        return self.still_unit + omega_e * self.moving_unit - self.torque_share

    def point(self, torque: float, omega_e: float) -> PointProblem:
        """The quadratic programme of one operating point."""
        offset = self.offset(torque, omega_e)
        gradient = torque / self.scale * (self.basis.T @ self.unit)
        lower, upper = self.bounds(omega_e)
        return PointProblem(
            self.still + omega_e * self.moving, gradient, lower - offset, upper - offset
        )

    def currents(self, torque: FloatArray, z: FloatArray) -> FloatArray:
        """Phase currents over all angles in A, shape (K, 3, N), for torques
        (K,) and unknowns (K, n).
        """
        flat = torque[:, np.newaxis] * self.unit + self.scale * (self.basis @ z.T).T
        first = np.moveaxis(flat.reshape(-1, self.part, 3), 2, 1)
        shift = shift_of(self.parts, self.machine.turns)
        pieces = [first]
        for _ in range(self.parts - 1):
            pieces.append(shift @ pieces[-1])
        return np.concatenate(pieces, axis=2)


def _part_and_shift(machine: PhaseMachine, limits: WaveformLimits) -> tuple[int, FloatArray]:
    symmetry = "none" if limits.open_phase is not None else machine.symmetry
    parts = {"sixth": 6, "third": 3, "none": 1}[symmetry]
    return parts, shift_of(parts, machine.turns)


def _between(part: int, machine: PhaseMachine, shift: FloatArray) -> tuple[Any, Any]:
    """Sparse matrices of value and slope half a step behind each angle, shape (3 part, 3 part),
    phases side by side.
    """
    step = 2.0 * np.pi * machine.turns / machine.angles
    return _stencil(part, shift, MIDDLE), _stencil(part, shift, SLOPE) / step


def _stencil(part: int, shift: FloatArray, weights: tuple[float, ...]) -> Any:
    """Sparse matrix of one stencil on the part.

    What lies beyond it are its own ends in other phases.
    """
    from scipy.sparse import coo_matrix

    rows, columns, values = [], [], []
    back = np.linalg.inv(shift)
    here = np.arange(part)
    for offset, weight in zip(OFFSETS, weights, strict=True):
        there = here + offset
        turn = np.where(
            (there >= part)[:, None, None],
            shift,
            np.where((there < 0)[:, None, None], back, np.eye(3)),
        )
        for phase in range(3):
            for source in range(3):
                rows.append(3 * here + phase)
                columns.append(3 * (there % part) + source)
                values.append(weight * turn[:, phase, source])
    size = 3 * part
    matrix = coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (size, size)
    ).tocsr()
    matrix.eliminate_zeros()
    return matrix


def make_problem(machine: PhaseMachine, limits: WaveformLimits) -> WaveformProblem:
    """What all operating points share.

    Raises:
        NoSolutionError: Constant torque cannot be made at some angle.
    """
    from scipy.sparse import vstack

    parts, shift = _part_and_shift(machine, limits)
    part = machine.angles // parts
    flux = np.ascontiguousarray(machine.flux[:, :part].T)
    unit, basis = angle_by_angle(machine, limits, flux)
    middle = _between(part, machine, shift)
    rows = all_rows(machine, limits, flux, middle)
    still, moving = (
        vstack([getattr(row, name) for row in rows]).tocsr() for name in ("still", "moving")
    )
    lower, upper = (
        np.concatenate([getattr(row, name) for row in rows]) for name in ("lower", "upper")
    )
    counts = [row.lower.size for row in rows]
    emf = np.zeros(lower.size)
    emf[: counts[0]] = (
        (middle[0] @ flux.ravel()).reshape(-1, 3) @ VOLTAGE_ROWS.T
    ).ravel() / limits.v_dc
    kinds = np.repeat(np.array([row.kind for row in rows], dtype=np.int8), counts)
    # Rows without any bound, such as phase voltages of a three-wire bridge, are left out.
    kept = np.flatnonzero((lower > -UNBOUNDED) | (upper < UNBOUNDED))
    still, moving = still[kept], moving[kept]
    scale = limits.i_max
    dense = basis.shape[1] <= DENSE_UNKNOWNS
    still_basis, moving_basis = ((scale * (matrix @ basis)).tocsc() for matrix in (still, moving))
    return WaveformProblem(
        machine=machine,
        limits=limits,
        part=part,
        parts=parts,
        scale=scale,
        unit=unit,
        basis=basis,
        still=still_basis.toarray() if dense else still_basis,
        moving=moving_basis.toarray() if dense else moving_basis,
        still_unit=still @ unit,
        moving_unit=moving @ unit,
        torque_share=np.repeat([row.torque_share for row in rows], counts)[kept],
        emf=emf[kept],
        lower=lower[kept],
        upper=upper[kept],
        kinds=kinds[kept],
    )
