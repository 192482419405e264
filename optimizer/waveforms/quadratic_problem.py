"""Quadratic programmes for phase currents: least copper loss for a torque, within bus,
current and topology.

What must hold at every angle (the torque where no ripple is allowed, no zero-sequence current, an
open phase) is solved out: i = T c + B z with c the current of least size that satisfies it for 1 N
m, and B an orthonormal basis of what is left free, angle by angle. The objective becomes |z|^2 + 2
T c'B z, and only inequalities remain: a problem of 60 or 120 unknowns for a symmetric machine
instead of 1080.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Topology
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.phase_machine import (
    MIDDLE,
    OFFSETS,
    SHIFT_SIXTH,
    SHIFT_THIRD,
    SLOPE,
    PhaseMachine,
)

OpenPhase = Literal["a", "b", "c"]


LIMITS = ("voltage", "current", "ripple", "neutral", "slew")

"""The kinds of inequalities, in the order of their rows."""


# Rows on the three phase voltages: each of them, and the differences between them.
_VOLTAGE_ROWS = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        [1.0, -1.0, 0.0],
        [0.0, 1.0, -1.0],
        [-1.0, 0.0, 1.0],
    ]
)


_RANK = 1e-9


_INFINITE = 1e30


UNBOUNDED = 1e29

"""Bounds of this size and beyond are none."""


DENSE_UNKNOWNS = 130

"""Unknowns up to which the matrices are kept dense, and an active-set method beats all others."""


@dataclass(frozen=True, slots=True)
class WaveformLimits:
    """What phase currents must keep.

    Parameters
    ----------
    v_dc:
        DC-link voltage in V.
    topology:
        ``three-wire``: no neutral current, phase voltages differ by at most v_dc. ``four-leg``:
        that, and each at most v_dc. ``split-capacitor``: each at most v_dc/2, no mean neutral
        current. ``six-leg``: each at most v_dc. ``diode-neutral``: a neutral current flows only
        where all three back-EMFs have its sign, which is an inner approximation and may cost more
        than three-wire; elsewhere as three-wire.
    i_max:
        Largest phase current in A, peak.
    ripple:
        Largest deviation of the torque from its mean in N m; 0 for constant torque.
    neutral:
        Largest neutral current in A, or None.
    open_phase:
        A phase without current, or None.
    slew:
        Largest rate of change of a phase current in A/s, or None.
    """

    v_dc: float
    topology: Topology
    i_max: float
    ripple: float = 0.0
    neutral: float | None = None
    open_phase: OpenPhase | None = None
    slew: float | None = None

    def __post_init__(self) -> None:
        """Refuse what limits nothing or everything."""
        for name in ("v_dc", "i_max", "neutral", "slew"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InputError(f"waveform limits: {name} must be positive, got {value:g}")
        if not (np.isfinite(self.ripple) and self.ripple >= 0.0):
            raise InputError(
                f"waveform limits: ripple must be zero or positive, got {self.ripple:g}"
            )


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

    ``part`` angles of the period are solved for, ``parts`` of them make it. ``unit`` is c in A/(N
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
        """Phase currents of the whole period in A, shape (K, 3, N), for torques
        (K,) and unknowns (K, n).
        """
        flat = torque[:, np.newaxis] * self.unit + self.scale * (self.basis @ z.T).T
        first = np.moveaxis(flat.reshape(-1, self.part, 3), 2, 1)
        shift = {6: SHIFT_SIXTH, 3: SHIFT_THIRD, 1: np.eye(3)}[self.parts]
        pieces = [first]
        for _ in range(self.parts - 1):
            pieces.append(shift @ pieces[-1])
        return np.concatenate(pieces, axis=2)


def _part_and_shift(machine: PhaseMachine, limits: WaveformLimits) -> tuple[int, FloatArray]:
    symmetry = "none" if limits.open_phase is not None else machine.symmetry
    return {"sixth": (6, SHIFT_SIXTH), "third": (3, SHIFT_THIRD), "none": (1, np.eye(3))}[symmetry]


def _between(part: int, angles: int, shift: FloatArray) -> tuple[Any, Any]:
    """Sparse matrices of value and slope half a step behind each angle, shape (3 part, 3 part),
    phases side by side.
    """
    step = 2.0 * np.pi / angles
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


def _voltage_shapes(topology: Topology, flux: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of the six voltages over v_dc, shapes (part, 6).

    Flux has the shape (part, 3).
    """
    one, none = np.ones(3), np.full(3, _INFINITE)
    high = {
        "three-wire": np.concatenate([none, one]),
        "diode-neutral": np.concatenate([none, one]),
        "four-leg": np.ones(6),
        "split-capacitor": np.concatenate([0.5 * one, none]),
        "six-leg": np.concatenate([one, none]),
    }[topology]
    upper = np.tile(high, (flux.shape[0], 1))
    lower = -upper
    if topology == "diode-neutral":
        # A current out of the neutral holds it at the upper rail: all phases lie below,
        # and the other way round.
        negative, positive = np.all(flux < 0.0, axis=1), np.all(flux > 0.0, axis=1)
        lower[negative, :3], upper[negative, :3] = -1.0, 0.0
        lower[positive, :3], upper[positive, :3] = 0.0, 1.0
    return lower, upper


def _per_angle(
    machine: PhaseMachine, limits: WaveformLimits, flux: FloatArray
) -> tuple[FloatArray, Any]:
    """Current of least size for 1 N m, shape (3 part,), and the basis of what is left,
    shape (3 part, n).

    Raises
    ------
    NoSolutionError
        Constant torque cannot be made at some angle.
    """
    from scipy.sparse import csr_matrix

    part = flux.shape[0]
    weight = machine.pole_pairs * flux / (machine.pole_pairs * np.max(np.abs(machine.flux)))
    torque = weight if limits.ripple == 0.0 else np.zeros_like(weight)
    star = np.ones_like(weight) * _has_no_neutral(limits.topology, flux)[:, np.newaxis]
    still = np.zeros_like(weight)
    if limits.open_phase is not None:
        still[:, "abc".index(limits.open_phase)] = 1.0
    rows = np.stack([torque, star, still], axis=1)
    left, size, right = np.linalg.svd(rows)
    kept = size > _RANK
    wanted = np.zeros((part, 3))
    wanted[:, 0] = 1.0 / (machine.pole_pairs * np.max(np.abs(machine.flux)))
    if limits.ripple > 0.0:
        unit = _proportional(machine, limits, flux)
    else:
        projected = np.einsum("kji,kj->ki", left, wanted) / np.where(kept, size, 1.0) * kept
        unit = np.einsum("kji,kj->ki", right, projected)
        missed = np.abs(np.einsum("ki,ki->k", torque, unit) - wanted[:, 0]) > 1e-6 * wanted[:, 0]
        if (
            missed.any()
            or np.max(np.abs(unit)) * machine.pole_pairs * np.max(np.abs(machine.flux)) > 1e4
        ):
            where = (
                360.0 * int(np.argmax(np.max(np.abs(unit), axis=1) + 1e9 * missed)) / machine.angles
            )
            raise NoSolutionError(
                f"constant torque cannot be made near {where:.0f} degrees: no phase that may carry "
                "current has a back-EMF there; permit a torque ripple"
            )
    # Rows of `right` behind the rank span what no row sees.
    angle, free = np.nonzero(~kept)
    vectors = right[angle, free]
    columns = np.repeat(np.arange(angle.size), 3)
    places = (3 * angle[:, np.newaxis] + np.arange(3)).ravel()
    return unit.ravel(), csr_matrix((vectors.ravel(), (places, columns)), (3 * part, angle.size))


def _has_no_neutral(topology: Topology, flux: FloatArray) -> FloatArray:
    """1 at the angles where the phase currents must add to zero, shape (part,)."""
    if topology == "diode-neutral":
        return np.where(np.all(flux < 0.0, axis=1) | np.all(flux > 0.0, axis=1), 0.0, 1.0)
    return np.full(flux.shape[0], 1.0 if topology == "three-wire" else 0.0)


def _proportional(machine: PhaseMachine, limits: WaveformLimits, flux: FloatArray) -> FloatArray:
    """Currents proportional to the back-EMF that may act, of mean torque 1 N m over the part,
    shape (part, 3).
    """
    shape = flux.copy()
    if limits.open_phase is not None:
        shape[:, "abc".index(limits.open_phase)] = 0.0
    active = (
        np.ones(3)
        if limits.open_phase is None
        else np.array([float(k != limits.open_phase) for k in "abc"])
    )
    star = _has_no_neutral(limits.topology, flux)[:, np.newaxis]
    shape = shape - star * active * np.sum(shape, axis=1, keepdims=True) / np.sum(active)
    return np.asarray(shape / np.mean(machine.pole_pairs * np.sum(flux * shape, axis=1)))


@dataclass(frozen=True, slots=True)
class _Rows:
    """Rows of one kind on the currents of the part: at standstill and per electrical speed,
    with their bounds.
    """

    kind: int
    still: Any
    moving: Any
    lower: FloatArray
    upper: FloatArray
    torque_share: float = 0.0


def _symmetric(
    kind: int, still: Any, moving: Any, torque_share: float = 0.0, bound: float = 1.0
) -> _Rows:
    limit = np.full(still.shape[0], bound)
    return _Rows(kind, still, moving, -limit, limit, torque_share)


def _all_rows(
    machine: PhaseMachine, limits: WaveformLimits, flux: FloatArray, middle: tuple[Any, Any]
) -> list[_Rows]:
    """Rows of every kind that the limits ask for, each of order one.

    Voltages and slew lie between the angles.
    """
    from scipy.sparse import block_diag, csr_matrix, identity, kron

    part, size, torque_max = (
        flux.shape[0],
        flux.size,
        machine.pole_pairs * np.max(np.abs(flux)) * limits.i_max,
    )
    value, slope = middle
    turned = kron(identity(part), csr_matrix(_VOLTAGE_ROWS)).tocsr() / limits.v_dc
    inductive = turned @ kron(identity(part), csr_matrix(machine.inductances)) @ slope
    low, high = _voltage_shapes(limits.topology, (value @ flux.ravel()).reshape(-1, 3))
    rows = [_Rows(0, machine.r_s * turned @ value, inductive, low.ravel(), high.ravel())]
    rows.append(
        _symmetric(1, identity(size, format="csr") / limits.i_max, csr_matrix((size, size)))
    )
    torque = block_diag(machine.pole_pairs * flux[:, np.newaxis, :]).tocsr() / torque_max
    neutral = kron(identity(part), np.ones((1, 3))).tocsr() / limits.i_max
    still = csr_matrix((part, size))
    mean = csr_matrix(np.full((1, part), 1.0 / part))
    if limits.ripple > 0.0:
        rows.append(_symmetric(2, torque, still, 1.0 / torque_max, limits.ripple / torque_max))
        rows.append(_symmetric(-1, mean @ torque, csr_matrix((1, size)), 1.0 / torque_max, 0.0))
    # With mirrored half waves the neutral current has no mean anyway.
    if limits.topology == "split-capacitor" and 6 * part > machine.angles:
        rows.append(_symmetric(-1, mean @ neutral, csr_matrix((1, size)), 0.0, 0.0))
    most = _INFINITE if limits.neutral is None else limits.neutral / limits.i_max
    if limits.topology == "diode-neutral":
        lower = np.where(np.all(flux > 0.0, axis=1), -most, 0.0)
        upper = np.where(np.all(flux < 0.0, axis=1), most, 0.0)
        rows.append(_Rows(3, neutral, still, lower, upper))
    elif limits.neutral is not None:
        rows.append(_symmetric(3, neutral, still, 0.0, most))
    if limits.slew is not None:
        rows.append(_symmetric(4, csr_matrix((size, size)), slope / limits.slew))
    return rows


def make_problem(machine: PhaseMachine, limits: WaveformLimits) -> WaveformProblem:
    """What all operating points share.

    Raises
    ------
    NoSolutionError
        Constant torque cannot be made at some angle.
    """
    from scipy.sparse import vstack

    parts, shift = _part_and_shift(machine, limits)
    part = machine.angles // parts
    flux = np.ascontiguousarray(machine.flux[:, :part].T)
    unit, basis = _per_angle(machine, limits, flux)
    middle = _between(part, machine.angles, shift)
    rows = _all_rows(machine, limits, flux, middle)
    still, moving = (
        vstack([getattr(row, name) for row in rows]).tocsr() for name in ("still", "moving")
    )
    lower, upper = (
        np.concatenate([getattr(row, name) for row in rows]) for name in ("lower", "upper")
    )
    counts = [row.lower.size for row in rows]
    emf = np.zeros(lower.size)
    emf[: counts[0]] = (
        (middle[0] @ flux.ravel()).reshape(-1, 3) @ _VOLTAGE_ROWS.T
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
