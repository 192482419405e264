"""Rows of the quadratic programmes for phase currents: limits of current and voltage,
topology, torque.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import (
    MIDDLE,
    OFFSETS,
    SLOPE,
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
    shift_of,
)
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, VOLTAGE_ROWS, link_demand, voltage_bounds
from dqforge.machines.transforms import DOUBLES, park_inverse

OpenPhase = Literal["a", "b", "c"]

# The kinds of inequalities, in the order of their rows.
LIMITS = ("voltage", "current", "ripple", "neutral", "slew")
_RANK = 1e-9
_INFINITE = 1e30


@dataclass(frozen=True, slots=True)
class WaveformLimits:
    """What phase currents must keep.

    Args:
        v_dc: DC-link voltage in V.
        topology: Its voltages are those of `dqforge.machines.topologies`, a neutral current
            flows where it has a neutral; on ``split-capacitor`` one without a mean.
            ``diode-neutral``: one flows only against all three back-EMFs, which is an inner
            approximation and may cost more than three-wire; elsewhere as three-wire.
        i_max: Largest phase current in A, peak.
        ripple: Largest deviation of the torque from its mean in N m; 0 for constant torque.
        neutral: Largest neutral current in A, or None.
        open_phase: A phase without current, or None.
        slew: Largest rate of change of a phase current in A/s, or None.
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


def _voltage_shapes(topology: Topology, flux: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lower and upper bounds of the six voltages over v_dc, shapes (part, 6).

    Flux has the shape (part, 3).
    """
    _, high = voltage_bounds(topology)
    upper = np.tile(np.minimum(high, _INFINITE), (flux.shape[0], 1))
    lower = -upper
    if TOPOLOGIES[topology].diodes:
        # A current out of the neutral holds it at the upper rail: all phases lie below,
        # and the other way round.
        negative, positive = np.all(flux < 0.0, axis=1), np.all(flux > 0.0, axis=1)
        lower[negative, :3], upper[negative, :3] = -1.0, 0.0
        lower[positive, :3], upper[positive, :3] = 0.0, 1.0
    return lower, upper


def angle_by_angle(
    machine: PhaseMachine, limits: WaveformLimits, flux: FloatArray
) -> tuple[FloatArray, Any]:
    """Current of least size for 1 N m, shape (3 part,), and the basis of what is left,
    shape (3 part, n).

    Raises:
        NoSolutionError: Constant torque cannot be made at some angle.
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
            worst = int(np.argmax(np.max(np.abs(unit), axis=1) + 1e9 * missed))
            where = 360.0 * machine.turns * worst / machine.angles
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
    one_sided = np.all(flux < 0.0, axis=1) | np.all(flux > 0.0, axis=1)
    free = one_sided if TOPOLOGIES[topology].diodes else TOPOLOGIES[topology].neutral
    return np.where(np.broadcast_to(free, one_sided.shape), 0.0, 1.0)


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


def all_rows(
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
    turned = kron(identity(part), csr_matrix(VOLTAGE_ROWS)).tocsr() / limits.v_dc
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
    # With mirrored half waves the neutral current has no mean anyway; a sixth of an even number
    # of electrical periods mirrors nothing.
    if TOPOLOGIES[limits.topology].midpoint and (
        6 * part > machine.angles or machine.turns % 2 == 0
    ):
        rows.append(_symmetric(-1, mean @ neutral, csr_matrix((1, size)), 0.0, 0.0))
    most = _INFINITE if limits.neutral is None else limits.neutral / limits.i_max
    if TOPOLOGIES[limits.topology].diodes:
        positive = np.all(flux > 0.0, axis=1)
        # At all other angles the currents add to zero anyway.
        (free,) = np.nonzero(positive | np.all(flux < 0.0, axis=1))
        lower, upper = np.where(positive, -most, 0.0)[free], np.where(positive, 0.0, most)[free]
        rows.append(_Rows(3, neutral[free], still[free], lower, upper))
    elif limits.neutral is not None:
        rows.append(_symmetric(3, neutral, still, 0.0, most))
    if limits.slew is not None:
        rows.append(_symmetric(4, csr_matrix((size, size)), slope / limits.slew))
    return rows


# Quadratic programmes for phase currents: least copper loss for a torque, within bus,
# current and topology.
#
# What must hold at every angle (the torque where no ripple is allowed, no zero-sequence current, an
# open phase) is solved out: i = T c + B z with c the current of least size that satisfies it for 1
# N m, and B an orthonormal basis of what is left free, angle by angle. The objective becomes |z|^2
# + 2 T c'B z, and only inequalities remain: a problem of 60 or 120 unknowns for a symmetric machine
# instead of 1080.

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


# Least-loss phase currents of constant torque for salient machines, each angle by itself,
# to the global optimum.
#
# Where neither dc link nor slew rate ties the angles together, each asks for the least |i|^2 with
# b'i + i'Ai = T: one quadratic equality, whose optimum is global where I - lambda A is positive
# semidefinite (S-lemma). In the eigenvectors of A, i_k = lambda b_k / (2 (1 - lambda a_k)), and the
# torque grows with lambda on the whole interval that is left.

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


# Phase currents of machines with any back-EMF in closed form, and what a
# set of phase currents means.
#
# Three rules for the same mean torque: ``dq`` keeps i_q of the fundamental constant and leaves a
# torque ripple; ``dqx`` makes the torque constant without zero-sequence current, ``dqy`` with it.
# Both are the pointwise minimum of copper loss: i = T F / (p |F|^2) with F the vector of the three
# flux values (dqy), or its part without zero sequence (dqx); thesis of paper 002, chapters 3 and 4.

CurrentRule = Literal["dq", "dqx", "dqy"]


_VANISHING = 1e-6


@dataclass(frozen=True, slots=True)
class WaveformFigures:
    """What phase currents mean at an operating point, arrays of shape (K,).

    ``copper`` in W, ``torque`` (mean) and ``ripple`` (peak to peak) in N m, ``rms`` of the most
    loaded phase, ``peak`` and ``neutral_rms`` in A, ``bus`` in V: the least dc-link voltage of the
    topology.
    """

    copper: FloatArray
    torque: FloatArray
    ripple: FloatArray
    rms: FloatArray
    peak: FloatArray
    neutral_rms: FloatArray
    bus: FloatArray


def unit_currents(machine: PhaseMachine, rule: CurrentRule) -> FloatArray:
    """Phase currents per torque in A/(N m), shape (3, N).

    Raises:
        NoSolutionError: At some angle no current of the rule makes torque.
    """
    flux = machine.flux
    if rule == "dq":
        places = machine.turns * np.arange(machine.angles)
        turn = np.exp(-2j * np.pi * places / machine.angles)
        twist = np.exp(2j * np.pi / 3.0 * np.arange(3))[:, np.newaxis]
        # Positive sequence of the fundamental, one phasor for all three phases.
        phasor = 2.0 * np.mean(flux * turn * twist)
        shape = np.real(phasor / turn / twist)
        return np.asarray(shape / np.mean(machine.torque(shape)))
    part = flux - np.mean(flux, axis=0) if rule == "dqx" else flux
    square = np.sum(part**2, axis=0)
    weakest = int(np.argmin(square))
    if square[weakest] <= _VANISHING**2 * np.max(square):
        raise NoSolutionError(
            f"{rule}: at {np.rad2deg(machine.theta[weakest]):.0f} degrees no phase makes torque, "
            "so that it cannot be constant; permit a torque ripple"
        )
    currents: FloatArray = part / (machine.pole_pairs * square)
    return currents


def bus_demand(voltages: FloatArray, topology: Topology) -> FloatArray:
    """Least dc-link voltage in V, shape (...), for phase voltages in V, shape (..., 3, N);
    of two isolated links, of each.
    """
    return link_demand(voltages, topology)


def dq_waveform(i_d: float, i_q: float, angles: int, turns: int = 1) -> FloatArray:
    """Phase currents in A, shape (3, N), of constant dq currents in A, at angles over ``turns``
    electrical periods.
    """
    lag = 2.0 * np.pi * (turns * np.arange(angles) / angles - np.arange(3)[:, np.newaxis] / 3.0)
    return park_inverse(DOUBLES, (np.array(i_d), np.array(i_q)), (np.cos(lag), np.sin(lag))).x


def figures(
    machine: AnyPhaseMachine, currents: FloatArray, omega_m: FloatArray, topology: Topology
) -> WaveformFigures:
    """Figures of phase currents in A, shape (K, 3, N), at mechanical speeds in rad/s,
    shape (K,).
    """
    torque = machine.torque(currents)
    neutral = np.sum(currents, axis=-2)
    voltages = machine.voltage(currents, machine.pole_pairs * omega_m)
    return WaveformFigures(
        copper=machine.copper_loss(currents),
        torque=np.mean(torque, axis=-1),
        ripple=np.max(torque, axis=-1) - np.min(torque, axis=-1),
        rms=np.max(np.sqrt(np.mean(currents**2, axis=-1)), axis=-1),
        peak=np.max(np.abs(currents), axis=(-2, -1)),
        neutral_rms=np.sqrt(np.mean(neutral**2, axis=-1)),
        bus=bus_demand(voltages, topology),
    )


def spectrum(currents: FloatArray, turns: int = 1) -> tuple[FloatArray, FloatArray]:
    """Amplitudes in A, peak, shape (..., 3, H), and orders 0, 1/turns, ... (H - 1)/turns,
    of phase currents over ``turns`` electrical periods, shape (..., 3, N).
    """
    count = currents.shape[-1]
    lines = np.abs(np.fft.rfft(currents, axis=-1)) * (2.0 / count)
    lines[..., 0] *= 0.5
    return lines, np.arange(lines.shape[-1], dtype=np.float64) / turns
