"""By how much the torque of a drive may differ from the requested one, as its machine differs from
its data.

The currents of the reference are fixed in the firmware; on a machine whose magnet flux linkage and
inductances are off by shares e the torque is

    T' = T + 3/2 p (e_psi psi_pm i_q + e_d (psi_d - psi_pm) i_q - e_q psi_q i_d)

with the flux linkages of the data at these currents: exact for constant inductances, and for a flux
map whose parts are scaled as a simulation scales them (`dqforge.machines.plants.scenario`). It is
linear in each share, so that the extremes lie at the corners of the tolerances.

It is linear in the errors of a measured map's flux linkages as well: with its standard deviations
the torque at these currents has the covariance C = F F^T of F = 3/2 p (F_d i_q - F_q i_d), and the
band holds all torques at once at 95 % (`_held_at_once`).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ToleranceName, Tolerances
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import Reference, SignedReference
from dqforge.optimizer.operating_points.current_choice import OperatingPoints

# Least torque that is looked at, of the largest.
LEAST_TORQUE = 0.05

# What makes part of a band: a tolerance, a measured flux map, or the polynomial of the reference.
PartName = ToleranceName | Literal["flux_map", "reference"]
_MISSED = 0.05
_LEVELS = 201


@dataclass(frozen=True, slots=True)
class TorquePart:
    """What one tolerance, the map or the reference makes of the torque: largest shares below
    (negative or zero) and above.
    """

    name: PartName
    low: float
    high: float

    @property
    def size(self) -> float:
        """The larger of both."""
        return max(-self.low, self.high)


@dataclass(frozen=True, slots=True)
class TorqueBand:
    """Shares of the requested torque, from `LEAST_TORQUE` of the largest one up.

    Args:
        low, high: Least and largest at all corners of the tolerances together.
        independent: Root of the sum of the squared parts: where the tolerances are 95 % intervals
            of independent values, the torque is within it at 95 %. What the reference errs by is
            known, and added to that.
        parts: By tolerance, the largest first; those that change nothing are left out. With a map
            whose deviations are known, its 95 % interval and the error of the reference are parts.
    """

    low: float
    high: float
    independent: float
    parts: tuple[TorquePart, ...]


def torque_band(
    machine: Machine,
    points: OperatingPoints,
    tolerances: Tolerances | None,
    reference: Reference | SignedReference | None = None,
) -> TorqueBand | None:
    """The band of a current reference, None where nothing changes the torque.

    Args:
        machine: As its data are.
        points: Currents of the reference over the torque.
        tolerances: Of the drive.
        reference: As emitted; with a map whose deviations are known what it errs by is a part.
    """
    requested = np.asarray(machine.torque(points.i_d, points.i_q))
    seen = requested >= LEAST_TORQUE * np.max(requested)
    i_d, i_q, requested = points.i_d[seen], points.i_q[seen], requested[seen]
    parts, lows, highs = [], np.zeros(i_d.size), np.zeros(i_d.size)
    scaled = {} if tolerances is None else torque_parts(machine, i_d, i_q)
    for name, torque in scaled.items():
        assert tolerances is not None
        ends = np.multiply.outer(tolerances.limits(name), torque / requested)
        low, high = np.min(ends, axis=0), np.max(ends, axis=0)
        lows, highs = lows + low, highs + high
        parts.append(TorquePart(name, float(np.min(low)), float(np.max(high))))
    share = _map_share(machine, i_d, i_q, requested)
    errs = TorquePart("reference", 0.0, 0.0)
    if share > 0.0:
        parts.append(TorquePart("flux_map", -share, share))
        if reference is not None:
            errs = _reference_part(machine, reference, float(requested[-1]))
    independent = float(np.sqrt(np.sum([part.size**2 for part in parts]))) + errs.size
    held = [part for part in (*parts, errs) if part.size > 0.0]
    if not held:
        return None
    held.sort(key=lambda part: -part.size)
    return TorqueBand(
        low=float(np.min(lows)) - share + errs.low,
        high=float(np.max(highs)) + share + errs.high,
        independent=independent,
        parts=tuple(held),
    )


def _map_share(machine: Machine, i_d: FloatArray, i_q: FloatArray, requested: FloatArray) -> float:
    """Half of the 95 % interval of all torques at once that the deviations of a map leave, as a
    share of the requested ones, shape (N,); 0 where none are stated.
    """
    if not isinstance(machine, SaturatedMachine) or machine.flux_map.deviations is None:
        return 0.0
    # Levels at even steps count alike, however many points the locus has.
    levels = np.linspace(requested[0], requested[-1], _LEVELS)
    i_d, i_q = np.interp(levels, requested, i_d), np.interp(levels, requested, i_q)
    of_d, of_q = machine.flux_map.deviations.factors(i_d, i_q)
    torque = 1.5 * machine.pole_pairs * (of_d * i_q[:, None] - of_q * i_d[:, None])
    return _held_at_once(torque / levels[:, None])


def _held_at_once(factors: FloatArray) -> float:
    """Half width that correlated normal values F x along a curve, shape (N, P) of F, keep at 95 %.

    A value is beyond the width at the begin, or it crosses it later: Rice's mean number of
    crossings of c = width / deviation, with the length that the unit vectors of F go from level to
    level (Sun and Loader, Annals of Statistics 22, 1994). The sum bounds the probability from
    above.
    """
    sigma = np.linalg.norm(factors, axis=1)
    largest = float(np.max(sigma))
    if largest <= 0.0:
        return 0.0
    sigma = np.maximum(sigma, 1e-9 * largest)
    units = factors / sigma[:, None]
    length = np.maximum(np.linalg.norm(np.diff(units, axis=0), axis=1), 1e-12)

    def beyond(half: float) -> float:
        level = half / sigma
        rise, middle = np.diff(level), 0.5 * (level[1:] + level[:-1])
        crossing = length * _density(rise / length) - rise * ndtr(-rise / length)
        return float(2.0 * ndtr(-level[0]) + 2.0 * np.sum(_density(middle) * crossing))

    return float(
        brentq(lambda half: beyond(half) - _MISSED, 1.5 * largest, 10.0 * largest, rtol=1e-6)
    )


def _density(values: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * values**2) / np.sqrt(2.0 * np.pi))


def _reference_part(
    machine: Machine, reference: Reference | SignedReference, top: float
) -> TorquePart:
    """What the emitted reference errs by on the machine of the data, of the requested torque."""
    wanted = np.linspace(LEAST_TORQUE * top, top, 2 * _LEVELS).astype(np.float32)
    i_d, i_q = reference.currents(wanted)
    made = machine.torque(np.asarray(i_d, np.float64), np.asarray(i_q, np.float64))
    off = np.asarray(made) / wanted - 1.0
    return TorquePart("reference", min(float(np.min(off)), 0.0), max(float(np.max(off)), 0.0))


def torque_parts(
    machine: Machine, i_d: FloatArray, i_q: FloatArray
) -> dict[ToleranceName, FloatArray]:
    """Parts of the torque in N m by what scales them, shape of the currents.

    Args:
        machine: As its data are.
        i_d, i_q: Currents in A, shape (N,).
    """
    psi_d, psi_q = machine.flux(i_d, i_q)
    factor = 1.5 * machine.pole_pairs
    return {
        "psi_pm": factor * machine.psi_pm * i_q,
        "l_d": factor * (psi_d - machine.psi_pm) * i_q,
        "l_q": -factor * psi_q * i_d,
    }
