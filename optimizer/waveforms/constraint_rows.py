"""Rows of the quadratic programmes for phase currents: limits of current and voltage,
topology, torque.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import VOLTAGE_ROWS, voltage_bounds
from dqforge.machines.topologies.topology import TOPOLOGIES

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
        topology: Its voltages are those of `dqforge.machines.topologies.regions`, a neutral current
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
