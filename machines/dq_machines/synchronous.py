"""Synchronous machines in rotor (dq) coordinates: flux linkage, torque, voltage and copper loss.

All dq quantities are amplitude-invariant (peak of phase) and in SI units;
the d axis lies along the magnet flux.
"""

from __future__ import annotations

import math
from dataclasses import field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import MACHINE, FloatArray, Wanted, check_numbers
from dqforge.machines.names import Strategy
from dqforge.machines.records import dataclass

# Convex regions in the plane of currents: where the points of a flux map lie, and where it ends.

_ON_THE_EDGE = 1e-9  # Distance over the size of a region within which a current counts as inside.

# Share by which a current limit may exceed a region that still covers it: digits that a file leaves
# out.
_COVERED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class CurrentRegion:
    """A convex polygon of currents, its corners counterclockwise.

    Zero current lies inside or on its edge.

    Args:
        corner_d, corner_q: Corners (i_d, i_q) in A (peak), shape (K,) each, K >= 3.
    """

    corner_d: FloatArray
    corner_q: FloatArray
    normal_d: FloatArray = field(init=False, repr=False)
    normal_q: FloatArray = field(init=False, repr=False)
    offset: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the unit normals that point outwards, and the distance of each
        edge from zero current, in A.
        """
        along_d, along_q = (
            np.roll(self.corner_d, -1) - self.corner_d,
            np.roll(self.corner_q, -1) - self.corner_q,
        )
        length = np.hypot(along_d, along_q)
        object.__setattr__(self, "normal_d", along_q / length)
        object.__setattr__(self, "normal_q", -along_d / length)
        object.__setattr__(
            self, "offset", self.normal_d * self.corner_d + self.normal_q * self.corner_q
        )

    @classmethod
    def rectangle(cls, low_d: float, high_d: float, end_q: float) -> CurrentRegion:
        """i_d between two currents, of which none leaves out zero, and |i_q| up to ``end_q``,
        all in A.
        """
        low, high = min(low_d, 0.0), max(high_d, 0.0)
        return cls(np.array([low, high, high, low]), np.array([-end_q, -end_q, end_q, end_q]))

    @classmethod
    def hull(cls, i_d: FloatArray, i_q: FloatArray) -> CurrentRegion:
        """Convex hull of points in A, shape (N,), of their mirror images in i_q,
        and of zero current.
        """
        from scipy.spatial import ConvexHull

        points = np.stack(
            [np.concatenate([i_d, i_d, [0.0]]), np.concatenate([i_q, -i_q, [0.0]])], axis=1
        )
        corners = points[ConvexHull(points / np.ptp(points, axis=0)).vertices]
        return cls(corners[:, 0], corners[:, 1])

    def within(self, other: CurrentRegion) -> CurrentRegion:
        """What both regions have in common."""
        corners = np.stack([self.corner_d, self.corner_q], axis=1)
        for normal_d, normal_q, offset in zip(
            other.normal_d, other.normal_q, other.offset, strict=True
        ):
            gap = corners @ np.array([normal_d, normal_q]) - offset
            corners = _cut(corners, gap, _ON_THE_EDGE * self.size)
        return CurrentRegion(corners[:, 0], corners[:, 1])

    @property
    def size(self) -> float:
        """Largest current in A within the region."""
        return float(np.max(np.hypot(self.corner_d, self.corner_q)))

    @property
    def reach(self) -> float:
        """Largest current in A that lies inside at any angle."""
        return float(np.min(self.offset))

    def covers(self, current: float) -> bool:
        """Whether all currents up to a magnitude in A lie inside, but for what files round away."""
        return current <= self.reach * (1.0 + _COVERED)

    def beyond(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Distance in A beyond the nearest edge line of currents, any one shape.

        Negative inside.
        """
        most = np.full(np.broadcast_shapes(np.shape(i_d), np.shape(i_q)), -np.inf)
        for normal_d, normal_q, offset in zip(
            self.normal_d, self.normal_q, self.offset, strict=True
        ):
            np.maximum(most, normal_d * i_d + normal_q * i_q - offset, out=most)
        return most

    def contains(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether currents in A lie inside or on the edge, any one shape."""
        return np.asarray(self.beyond(i_d, i_q) <= _ON_THE_EDGE * self.size)

    def end_of_ray(self, angle: float) -> float:
        """Current in A at which a ray from zero current, at an angle in rad, leaves the region."""
        along = self.normal_d * np.cos(angle) + self.normal_q * np.sin(angle)
        ahead = along > 1e-12
        return float(np.min(np.maximum(self.offset[ahead], 0.0) / along[ahead]))


def _cut(corners: FloatArray, gap: FloatArray, slack: float) -> FloatArray:
    """Corners of a polygon, shape (K, 2), behind a line, from their distances beyond it."""
    kept: list[FloatArray] = []
    for corner, here, other, there in zip(
        corners, gap, np.roll(corners, -1, axis=0), np.roll(gap, -1), strict=True
    ):
        if here <= slack:
            kept.append(corner)
        if (here > slack and there < -slack) or (here < -slack and there > slack):
            kept.append(corner + (other - corner) * (here / (here - there)))
    return np.array(kept)


# Synchronous machines in rotor (dq) coordinates: flux linkage, torque, voltage and copper loss.
#
# All dq quantities are amplitude-invariant (peak of phase) and in SI units; the d axis lies along
# the magnet flux.


def torque_from_flux(
    pole_pairs: int | NDArray[np.int64],
    psi_d: FloatArray,
    psi_q: FloatArray,
    i_d: FloatArray,
    i_q: FloatArray,
) -> FloatArray:
    """Air-gap torque T = 3/2 p (psi_d i_q - psi_q i_d) in N m, any broadcastable shapes.

    Args:
        pole_pairs: Number of pole pairs p, or those of several machines.
        psi_d, psi_q: Flux linkages in Wb (peak of phase), any shape.
        i_d, i_q: Currents in A (peak), shapes that fit.
    """
    return 1.5 * pole_pairs * (psi_d * i_q - psi_q * i_d)


_Value = TypeVar("_Value", float, FloatArray)


def torque_per_ampere(pole_pairs: Any, psi_pm: _Value) -> _Value:
    """Torque per ampere of i_q without current in the d axis, 3/2 p psi_pm, in N m/A (peak).

    Args:
        pole_pairs: Number of pole pairs, or those of several machines.
        psi_pm: Flux linkage of the magnets in Wb (peak of phase).
    """
    found: _Value = 1.5 * pole_pairs * psi_pm
    return found


def copper_loss(r_s: float | FloatArray, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Copper loss 3/2 R |i|^2 in W for peak dq currents in A, any broadcastable shapes.

    Paper 000 (12) prints R |i|^2, which holds for another scaling of the currents.

    Args:
        r_s: Phase resistance in Ohm, or those of several machines.
        i_d, i_q: Currents in A (peak), any shapes that fit.
    """
    return 1.5 * r_s * (i_d * i_d + i_q * i_q)


@dataclass(frozen=True, slots=True)
class FluxJet:
    """Flux linkages with their first and second derivatives by the currents, all of one shape.

    ``psi_d``, ``psi_q`` in Wb; ``l_dd`` = d psi_d/d i_d, ``l_dq`` = d psi_d/d i_q, ``l_qd`` = d
    psi_q/d i_d, ``l_qq`` = d psi_q/d i_q in H (incremental inductances); ``d_dd`` = d2 psi_d/d
    i_d^2, ``d_dq`` the mixed one, ``d_qq``, and ``q_dd``, ``q_dq``, ``q_qq`` likewise for psi_q, in
    H/A.
    """

    psi_d: FloatArray
    psi_q: FloatArray
    l_dd: FloatArray
    l_dq: FloatArray
    l_qd: FloatArray
    l_qq: FloatArray
    d_dd: FloatArray
    d_dq: FloatArray
    d_qq: FloatArray
    q_dd: FloatArray
    q_dq: FloatArray
    q_qq: FloatArray


class Machine(Protocol):
    """What every synchronous machine model offers, whatever its flux linkage.

    The model is symmetric in the q axis: psi_d is even and psi_q odd in i_q. ``psi_pm``, ``l_d``
    and ``l_q`` are the open-circuit flux linkage and the incremental inductances at zero current;
    they say it all for `LinearMachine` only.
    """

    @property
    def pole_pairs(self) -> int:
        """Number of pole pairs p."""
        ...

    @property
    def r_s(self) -> float:
        """Phase resistance in Ohm."""
        ...

    @property
    def i_max(self) -> float:
        """Largest permitted current in A, peak of phase."""
        ...

    @property
    def inertia(self) -> float | None:
        """Moment of inertia in kg m^2, or None."""
        ...

    @property
    def friction(self) -> float:
        """Viscous friction in N m s/rad."""
        ...

    @property
    def omega_m_max(self) -> float | None:
        """Largest mechanical speed in rad/s, or None."""
        ...

    @property
    def psi_pm(self) -> float:
        """Open-circuit flux linkage in Wb, peak of phase."""
        ...

    @property
    def l_d(self) -> float:
        """Incremental d inductance at zero current, in H."""
        ...

    @property
    def l_q(self) -> float:
        """Incremental q inductance at zero current, in H."""
        ...

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any shape."""
        ...

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, arrays of shape
        (N,).
        """
        ...

    def known(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether the model has data at currents in A, any one shape.

        Elsewhere it is extrapolated.
        """
        ...

    @property
    def region(self) -> CurrentRegion | None:
        """Currents that operating points may not leave, because the model has no data there; None:
        all may be used.
        """
        ...

    @property
    def saliency(self) -> float:
        """Inductance difference l_q - l_d in H."""
        ...

    @property
    def torque_per_ampere(self) -> float:
        """Torque per ampere of i_q at zero current, 3/2 p psi_pm, in N m/A (peak)."""
        ...

    def torque(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Torque in N m at currents in A, any broadcastable shapes."""
        ...

    def voltage(
        self, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Steady-state voltages (v_d, v_q) in V at currents in A and electrical speed in rad/s."""
        ...


class FluxSource(Protocol):
    """What torque and voltage are computed from: one machine, or columns of several."""

    @property
    def pole_pairs(self) -> int | NDArray[np.int64]:
        """Number of pole pairs p."""
        ...

    @property
    def r_s(self) -> float | FloatArray:
        """Phase resistance in Ohm."""
        ...

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A."""
        ...


class FluxFormulas:
    """Torque and voltage, which follow alike from the flux linkage of one machine and of several;
    a base for both. Of several machines the last axis of currents is theirs.
    """

    __slots__ = ()

    def torque(self: FluxSource, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Torque in N m at currents in A, any broadcastable shapes."""
        psi_d, psi_q = self.flux(i_d, i_q)
        return torque_from_flux(self.pole_pairs, psi_d, psi_q, i_d, i_q)

    def voltage(
        self: FluxSource, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Steady-state voltages (v_d, v_q) in V at currents in A and electrical speed
        in rad/s (paper 000, (1)).
        """
        psi_d, psi_q = self.flux(i_d, i_q)
        return self.r_s * i_d - omega_e * psi_q, self.r_s * i_q + omega_e * psi_d


class MachineFormulas(FluxFormulas):
    """What follows from flux linkage, resistance and pole pairs alike in every machine model;
    a base for models.
    """

    __slots__ = ()

    def known(self, i_d: FloatArray, i_q: FloatArray) -> NDArray[np.bool_]:
        """Whether the model has data at currents in A, any one shape: a formula holds
        everywhere.
        """
        return np.ones(np.broadcast_shapes(np.shape(i_d), np.shape(i_q)), dtype=np.bool_)

    @property
    def region(self) -> CurrentRegion | None:
        """Currents that operating points may not leave: a formula has no such limit."""
        return None

    @property
    def saliency(self: Machine) -> float:
        """Inductance difference l_q - l_d in H; positive for the usual interior-magnet machine."""
        return self.l_q - self.l_d

    @property
    def torque_per_ampere(self: Machine) -> float:
        """Torque per ampere of i_q at zero current, 3/2 p psi_pm, in N m/A (peak)."""
        return torque_per_ampere(self.pole_pairs, self.psi_pm)


_NUMBERS = MACHINE | {
    "l_d": Wanted("H", "1e-3"),
    "l_q": Wanted("H", "1e-3"),
    "psi_pm": Wanted("Wb", "0.1", zero=True),
}


@dataclass(frozen=True, slots=True)
class LinearMachine(MachineFormulas):
    """A permanent-magnet or reluctance machine with constant inductances.

    Args:
        pole_pairs: Number of pole pairs p.
        r_s: Phase resistance in Ohm.
        l_d, l_q: Phase (synchronous) inductances in H.
        psi_pm: Magnet flux linkage in Wb, peak of phase; 0 for a reluctance machine.
        i_max: Largest permitted current in A, peak of phase.
        inertia: Moment of inertia in kg m^2, or None if unknown.
        friction: Viscous friction in N m s/rad.
        omega_m_max: Largest mechanical speed in rad/s, or None if unknown.

    Raises:
        InputError: A value is no finite number, of the wrong sign, or the pole pairs are not whole.
    """

    pole_pairs: int
    r_s: float
    l_d: float
    l_q: float
    psi_pm: float
    i_max: float
    inertia: float | None = None
    friction: float = 0.0
    omega_m_max: float | None = None

    def __post_init__(self) -> None:
        """Check every number."""
        check_numbers(self, _NUMBERS)

    def flux(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any shape."""
        return self.psi_pm + self.l_d * i_d, self.l_q * i_q

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        """Flux linkages with first and second derivatives at currents in A, arrays of shape
        (N,).
        """
        zero = np.zeros_like(i_d)
        psi_d, psi_q = self.flux(i_d, i_q)
        l_d, l_q = zero + self.l_d, zero + self.l_q
        return FluxJet(psi_d, psi_q, l_d, zero, zero, l_q, zero, zero, zero, zero, zero, zero)


def linearised(machine: Machine) -> LinearMachine:
    """The machine with the constants that it has at zero current; a `LinearMachine` is returned as
    it is.
    """
    if isinstance(machine, LinearMachine):
        return machine
    return LinearMachine(
        pole_pairs=machine.pole_pairs,
        r_s=machine.r_s,
        l_d=machine.l_d,
        l_q=machine.l_q,
        psi_pm=machine.psi_pm,
        i_max=machine.i_max,
        inertia=machine.inertia,
        friction=machine.friction,
        omega_m_max=machine.omega_m_max,
    )


# The largest torque of a machine within a current limit.


def largest_torque_within(machine: Machine, i_max: float, strategy: Strategy = "mtpa") -> float:
    """Largest torque in N m within a current limit in A.

    Of saturated machines by a scan, good for a cross-check.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
        strategy: Which currents make the torque.
    """
    if isinstance(machine, LinearMachine):
        saliency = machine.saliency if strategy == "mtpa" else 0.0
        return largest_torque(machine.pole_pairs, machine.psi_pm, saliency, i_max)
    angle = np.linspace(0.0, np.pi, 721) if strategy == "mtpa" else np.array([0.5 * np.pi])
    region = machine.region
    if region is None or region.covers(i_max):
        return float(np.max(machine.torque(i_max * np.cos(angle), i_max * np.sin(angle))))
    length = np.array([min(i_max, region.end_of_ray(part)) for part in angle])
    return float(np.max(machine.torque(length * np.cos(angle), length * np.sin(angle))))


def largest_torque(pole_pairs: int, psi_pm: float, saliency: float, i_max: float) -> float:
    """Torque in N m that a linear machine gives at most with a peak phase current `i_max` in A.

    Args:
        pole_pairs: Number of pole pairs.
        psi_pm: Flux linkage of the magnets in Wb.
        saliency: Inductance difference l_q - l_d in H, of either sign.
        i_max: Length of the current vector in A.
    """
    # dT/d(angle) = 0 with i_d = -x: 2 s x^2 + psi x - s i^2 = 0; the sign of s only mirrors i_d.
    s = abs(saliency)
    # The conjugate form of the root has no cancellation, and gives x = 0 for s = 0.
    root = psi_pm + math.sqrt(psi_pm * psi_pm + 8.0 * s * s * i_max * i_max)
    x = 2.0 * s * i_max * i_max / root if root > 0.0 else 0.0
    return 1.5 * pole_pairs * (psi_pm + s * x) * math.sqrt(max(i_max * i_max - x * x, 0.0))
