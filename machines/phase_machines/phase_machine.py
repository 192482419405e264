"""Machines in phase quantities: any back-EMF shape, constant self and mutual inductance,
no saliency.

Angles are electrical, theta from phase a to the d axis; a waveform is an array over an even
grid theta_j = 2 pi turns j / N. Where the back-EMF differs from pole pair to pole pair, it repeats
after a mechanical turn only: ``turns`` electrical periods.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import MACHINE, FloatArray, Wanted, check_numbers, owned_numbers
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import DOUBLES, park

# What part of the period tells all: one sixth (equal phases, mirrored half waves), one third (equal
# phases), all.
Symmetry = Literal["sixth", "third", "none"]

# Weights of the central difference of sixth order at distances 1, 2 and 3.
STENCIL = (3.0 / 4.0, -3.0 / 20.0, 1.0 / 60.0)

# Weights of value and slope in the middle between two angles, at these offsets from the first of
# them.
OFFSETS = (-1, 0, 1, 2)
MIDDLE = (-1.0 / 16.0, 9.0 / 16.0, 9.0 / 16.0, -1.0 / 16.0)
SLOPE = (1.0 / 24.0, -27.0 / 24.0, 27.0 / 24.0, -1.0 / 24.0)
ANGLES = 360  # Angles of an electrical period, where nothing else is said.
_FEWER_ANGLES = 120
_MANY_TURNS = 8
_SAME = 1e-9
_TURN = 2.0 * np.pi / 3.0

# How the phases at theta + 120 degrees, or + 60 degrees with mirrored half waves,
# follow from those at theta.
SHIFT_THIRD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
SHIFT_SIXTH = -np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


def shift_of(parts: int, turns: int = 1) -> FloatArray:
    """How the phases a sixth (6), a third (3) or all (1) of a waveform over ``turns`` electrical
    periods later follow from those at an angle, matrix (3, 3).

    Args:
        parts: How many of these make the whole waveform: 6, 3 or 1.
        turns: Electrical periods that it spans.
    """
    # Of the mechanical turn; in electrical angle that is turns times as much.
    power = turns * 6 // parts
    return np.asarray(np.linalg.matrix_power(SHIFT_SIXTH, power % 6))


def phase_displacement(turns: int) -> float:
    """Electrical angle in rad by which phase b lies behind phase a, and c behind b,
    of equal phases over ``turns`` electrical periods.

    Coils of equal phases lie thirds of the mechanical turn apart, where that is 120 degrees more
    than whole electrical periods; with a multiple of 3 pole pairs nowhere, and 120 electrical
    degrees are taken.
    """
    thirds = {1: turns, 2: 2 * turns, 0: 1}[turns % 3]
    return _TURN * thirds


def _whole(orders: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.abs(orders - np.round(orders)) <= _SAME * np.maximum(np.abs(orders), 1.0))


def grid(count: int, turns: int = 1) -> FloatArray:
    """Even angles in rad over a number of electrical periods, shape (count,).

    Args:
        count: Number of angles.
        turns: Electrical periods that they span.
    """
    return np.asarray(2.0 * np.pi * turns * np.arange(count) / count, dtype=np.float64)


def angles_of(turns: int) -> int:
    """Number of angles that a waveform is held at.

    Args:
        turns: Electrical periods that it spans.
    """
    return ANGLES * turns if turns <= _MANY_TURNS else _FEWER_ANGLES * turns


def derivative(waveform: FloatArray, turns: int = 1) -> FloatArray:
    """Derivative by the angle in 1/rad along the last axis, periodic, of sixth order.

    Args:
        waveform: Values in any unit over ``turns`` electrical periods, shape (..., N).
        turns: Electrical periods after which it repeats.
    """
    step = 2.0 * np.pi * turns / waveform.shape[-1]
    found: FloatArray = np.zeros_like(waveform)
    for distance, weight in enumerate(STENCIL, start=1):
        ahead, behind = np.roll(waveform, -distance, axis=-1), np.roll(waveform, distance, axis=-1)
        found += weight / step * (ahead - behind)
    return found


def between(waveform: FloatArray, turns: int = 1) -> tuple[FloatArray, FloatArray]:
    """Value and slope (per rad) of a waveform, periodic over ``turns`` electrical periods,
    in the middle behind each angle, along the last axis.

    Of fourth order over the four angles around. Unlike the slope at an angle this one sees what
    alternates from one angle to the next, which would otherwise escape every limit on voltage.
    """
    step = 2.0 * np.pi * turns / waveform.shape[-1]
    value: FloatArray = np.zeros_like(waveform)
    slope: FloatArray = np.zeros_like(waveform)
    for offset, of_value, of_slope in zip(OFFSETS, MIDDLE, SLOPE, strict=True):
        moved = np.roll(waveform, -offset, axis=-1)
        value += of_value * moved
        slope += of_slope / step * moved
    return value, slope


_NUMBERS = {name: MACHINE[name] for name in ("pole_pairs", "r_s", "i_max")} | {
    "l_s": Wanted("H", "1e-3"),
    "m_s": Wanted("H", "-1e-4", negative=True),
    "turns": Wanted("", "1"),
}


@dataclass(frozen=True, slots=True, eq=False)
class PhaseMachine:
    """A three-phase machine whose back-EMF has any shape.

    Args:
        pole_pairs: Number of pole pairs p.
        r_s: Phase resistance in Ohm.
        l_s, m_s: Self inductance of a phase, and mutual inductance between two (usually negative),
            in H.
        flux: Back-EMF over electrical speed, e_k = omega_e flux_k(theta_j), in V s/rad, shape (3,
            N), N a multiple of 12 turns.
        i_max: Largest phase current in A, peak.
        turns: Electrical periods after which the waveform repeats: 1, or the pole pairs where they
            differ from each other.

    Raises:
        InputError: The shape does not fit, a value is not finite, the inductances store no energy
            in some current, or the turns are neither 1 nor the pole pairs.
    """

    pole_pairs: int
    r_s: float
    l_s: float
    m_s: float
    flux: FloatArray
    i_max: float
    turns: int = 1

    def __post_init__(self) -> None:
        """Own the waveform and check what would make no machine."""
        check_numbers(self, _NUMBERS)
        owned = owned_numbers(self.flux, "flux")
        owned.flags.writeable = False
        object.__setattr__(self, "flux", owned)
        if self.turns not in (1, self.pole_pairs):
            raise InputError(
                f"a back-EMF repeats after 1 electrical period or after all {self.pole_pairs} of a "
                f"mechanical turn, got turns = {self.turns}"
            )
        unit = 12 * self.turns
        least = 2 * unit
        if (
            owned.ndim != 2
            or owned.shape[0] != 3
            or owned.shape[1] < least
            or owned.shape[1] % unit
        ):
            raise InputError(
                f"the back-EMF needs the shape (3, N), N a multiple of {unit} from {least} on, got "
                f"{owned.shape}"
            )
        if not (np.all(np.isfinite(owned)) and np.any(owned)):
            raise InputError("the back-EMF must be finite and not zero everywhere")
        if not (self.l_s - self.m_s > 0.0 and self.l_s + 2.0 * self.m_s > 0.0):
            raise InputError(
                f"l_s = {self.l_s:g} H and m_s = {self.m_s:g} H store no energy in some current: "
                "l_s - m_s and l_s + 2 m_s must be positive"
            )

    def __repr__(self) -> str:
        """One line, the back-EMF by its number of angles."""
        numbers = ", ".join(f"{name}={getattr(self, name)!r}" for name in _NUMBERS)
        return f"PhaseMachine({numbers}, flux=3 x {self.angles} angles)"

    @classmethod
    def from_harmonics(
        cls,
        orders: ArrayLike,
        amplitudes: ArrayLike,
        phases: ArrayLike,
        *,
        pole_pairs: int,
        r_s: float,
        l_s: float,
        m_s: float,
        i_max: float,
        angles: int | None = None,
    ) -> PhaseMachine:
        """A machine from the harmonics of its back-EMF, e_k / omega_e = - sum
        A_kh sin(h theta - phi_kh).

        ``orders`` has the shape (H,); ``amplitudes`` in V s/rad and ``phases`` in rad have the
        shape (3, H), or (H,) for three equal phases, of which b and c lag by 120 and 240 degrees.

        Orders that are not whole are those of pole pairs that differ: multiples of 1/pole_pairs, so
        that the waveform spans a mechanical turn; equal phases then lag by
        :func:`phase_displacement`. ``angles`` is the number of angles, None for that of
        :func:`angles_of`.

        Raises:
            InputError: An order is neither whole nor a multiple of 1/pole_pairs, or as for the
                machine.
        """
        order = np.asarray(orders, dtype=np.float64)
        turns = 1 if np.all(_whole(order)) else pole_pairs
        if not np.all(_whole(order * turns)):
            raise InputError(
                f"orders of the back-EMF are whole, or multiples of 1/{pole_pairs} for the "
                f"{pole_pairs} pole pairs of a mechanical turn"
            )
        size, lag = np.asarray(amplitudes, dtype=np.float64), np.asarray(phases, dtype=np.float64)
        if size.ndim == 1:
            behind = phase_displacement(turns)
            size, lag = np.stack([size] * 3), np.stack([lag + order * behind * k for k in range(3)])
        theta = grid(angles_of(turns) if angles is None else angles, turns)
        angle = order[:, np.newaxis] * theta - lag[:, :, np.newaxis]
        flux = -np.sum(size[:, :, np.newaxis] * np.sin(angle), axis=1)
        return cls(pole_pairs, r_s, l_s, m_s, flux, i_max, turns)

    @property
    def angles(self) -> int:
        """Number N of angles, over all turns."""
        return int(self.flux.shape[1])

    @property
    def theta(self) -> FloatArray:
        """Electrical angles of the waveform in rad, 0 to below 2 pi turns, shape (N,)."""
        return grid(self.angles, self.turns)

    @property
    def inductances(self) -> FloatArray:
        """Inductance matrix of the phases in H, shape (3, 3)."""
        return self.m_s + (self.l_s - self.m_s) * np.eye(3)

    @property
    def psi_pm(self) -> float:
        """Positive sequence of the fundamental flux linkage, peak of phase, in Wb."""
        lagging = self.theta - _TURN * np.arange(3)[:, np.newaxis]
        return float(2.0 * np.abs(np.mean(self.flux * np.exp(-1j * lagging))))

    @property
    def symmetry(self) -> Symmetry:
        """How much of the whole grid must be known."""
        count, scale = self.angles, float(np.max(np.abs(self.flux)))

        def repeats(part: int) -> bool:
            moved = np.roll(self.flux, -count // part, axis=1)
            away = np.max(np.abs(moved - shift_of(part, self.turns) @ self.flux))
            return bool(away <= _SAME * scale)

        if repeats(6):
            return "sixth"
        return "third" if repeats(3) else "none"

    def symmetrised(self) -> PhaseMachine:
        """The machine with the mean of its phases and of its half waves, so that a
        sixth of the period tells all.

        Over several turns only the phases are averaged, each a third of the mechanical turn behind
        the one before: half waves and pole pairs keep their differences.

        Raises:
            InputError: The pole pairs differ, and their number is a multiple of 3: a third of a
                mechanical turn then leads from a phase to itself.
        """
        if self.turns > 1 and self.turns % 3 == 0:
            raise InputError(
                f"phases of {self.turns} different pole pairs lie no third of a mechanical turn "
                "apart and have no mean; keep them as they are"
            )
        parts = 6 if self.turns == 1 else 3
        flux, part = np.zeros_like(self.flux), self.angles // parts
        turned = np.eye(3)
        for sector in range(parts):
            flux += np.linalg.inv(turned) @ np.roll(self.flux, -sector * part, axis=1) / parts
            turned = shift_of(parts, self.turns) @ turned
        return replace(self, flux=flux)

    def torque(self, currents: FloatArray) -> FloatArray:
        """Torque p sum flux_k i_k in N m, shape (..., N), of phase currents in A, shape (..., 3,
        N).
        """
        made: FloatArray = self.pole_pairs * np.sum(self.flux * currents, axis=-2)
        return made

    def voltage(self, currents: FloatArray, omega_e: ArrayLike) -> FloatArray:
        """Phase voltages R i + omega_e (L di/dtheta + flux) in V, half a step behind each angle,
        shape (..., 3, N).

        ``currents`` in A have the same shape, the electrical speeds in rad/s the shape (...).
        """
        omega = np.asarray(omega_e, dtype=np.float64)[..., np.newaxis, np.newaxis]
        value, slope = between(currents, self.turns)
        return self.r_s * value + omega * (self.inductances @ slope + between(self.flux)[0])

    def copper_loss(self, currents: FloatArray) -> FloatArray:
        """Mean copper loss R sum i_k^2 in W, shape (...)."""
        loss: FloatArray = self.r_s * np.mean(np.sum(currents**2, axis=-2), axis=-1)
        return loss


# Phase machines with saliency: the inductances, like the back-EMF, are waveforms
# over the electrical angle.


@dataclass(frozen=True, slots=True, eq=False)
class SalientPhaseMachine:
    """A three-phase machine whose back-EMF and inductances vary with the angle in any way.

    No saturation.

    Args:
        phases: Pole pairs, resistance, back-EMF and current limit; its constant inductances play no
            part.
        inductance: Inductance matrices L(theta_j) of the phases in H, shape (N, 3, 3), on the
            angles of the back-EMF.

    Raises:
        InputError: The shape does not fit, a value is not finite, or a matrix is not symmetric and
            positive definite.
    """

    phases: PhaseMachine
    inductance: FloatArray

    def __post_init__(self) -> None:
        """Own the waveform and check what would make no machine."""
        owned = np.array(self.inductance, dtype=np.float64)
        owned.flags.writeable = False
        object.__setattr__(self, "inductance", owned)
        if owned.shape != (self.phases.angles, 3, 3):
            raise InputError(
                f"the inductances need the shape ({self.phases.angles}, 3, 3), got {owned.shape}"
            )
        if not np.all(np.isfinite(owned)):
            raise InputError("the inductances must be finite")
        if np.max(np.abs(owned - np.swapaxes(owned, 1, 2))) > _SAME * np.max(np.abs(owned)):
            raise InputError(
                "the inductance matrices must be symmetric: L_ab = L_ba at every angle"
            )
        least = np.linalg.eigvalsh(owned)[:, 0]
        if np.min(least) <= 0.0:
            where = np.rad2deg(self.theta[int(np.argmin(least))])
            raise InputError(
                f"the inductances store no energy in some current at {where:.0f} degrees"
            )

    @classmethod
    def with_second_harmonic(cls, phases: PhaseMachine, l_2: float) -> SalientPhaseMachine:
        """The machine with L_jk(theta) = L_jk + l_2 cos(2 theta - 120 deg (j + k)), j, k = 0, 1, 2,
        ``l_2`` in H.

        In dq coordinates l_d = l_s - m_s + 3/2 l_2 and l_q = l_s - m_s - 3/2 l_2,
        without any ripple.
        """
        theta = phases.theta
        lag = 2.0 * np.pi / 3.0 * np.add.outer(np.arange(3), np.arange(3))
        return cls(
            phases, phases.inductances + l_2 * np.cos(2.0 * theta[:, np.newaxis, np.newaxis] - lag)
        )

    @classmethod
    def from_harmonics(
        cls, phases: PhaseMachine, orders: ArrayLike, own: ArrayLike, mutual: ArrayLike
    ) -> SalientPhaseMachine:
        """The machine whose inductances vary with even harmonics about the d axis.

        L_aa = L_s + sum own_h cos(h theta) and L_bc = M_s + sum mutual_h cos(h theta), those of the
        other phases 120 and 240 degrees behind; ``own`` and ``mutual`` in H, ``orders`` even, all
        of shape (H,). With order 2 alone and own = mutual this is `with_second_harmonic`.
        """
        theta = phases.theta
        order = np.atleast_1d(np.asarray(orders, dtype=np.float64))
        varying = np.zeros((phases.angles, 3, 3))
        for size, pairs in ((own, ((0, 0), (1, 1), (2, 2))), (mutual, ((1, 2), (2, 0), (0, 1)))):
            weights = np.atleast_1d(np.asarray(size, dtype=np.float64))
            for phase, (j, k) in enumerate(pairs):
                wave = np.cos(np.multiply.outer(theta - _TURN * phase, order)) @ weights
                varying[:, j, k] += wave
                if j != k:
                    varying[:, k, j] += wave
        return cls(phases, phases.inductances + varying)

    @property
    def dq_inductances(self) -> tuple[float, float]:
        """Means of the inductances along and across the magnets in H, (l_d, l_q),
        in rotor coordinates.
        """
        lag = self.theta[:, np.newaxis] - _TURN * np.arange(3)
        phase = np.ones_like(lag), np.zeros_like(lag)
        axes = np.sqrt(2.0 / 3.0) * np.stack(park(DOUBLES, phase, (np.cos(lag), np.sin(lag))))
        l_d, l_q = np.mean(np.einsum("xjk,jkl,xjl->xj", axes, self.inductance, axes), axis=1)
        return float(l_d), float(l_q)

    @property
    def pole_pairs(self) -> int:
        """Number of pole pairs p."""
        return self.phases.pole_pairs

    @property
    def r_s(self) -> float:
        """Phase resistance in Ohm."""
        return self.phases.r_s

    @property
    def flux(self) -> FloatArray:
        """Back-EMF over electrical speed in V s/rad, shape (3, N)."""
        return self.phases.flux

    @property
    def psi_pm(self) -> float:
        """Positive sequence of the fundamental flux linkage, peak of phase, in Wb."""
        return self.phases.psi_pm

    @property
    def angles(self) -> int:
        """Number N of angles, over all turns."""
        return self.phases.angles

    @property
    def turns(self) -> int:
        """Electrical periods after which the back-EMF repeats."""
        return self.phases.turns

    @property
    def theta(self) -> FloatArray:
        """Electrical angles of the waveforms in rad, 0 to below 2 pi turns, shape (N,)."""
        return self.phases.theta

    def copper_loss(self, currents: FloatArray) -> FloatArray:
        """Mean copper loss R sum i_k^2 in W, shape (...)."""
        return self.phases.copper_loss(currents)

    @property
    def slope(self) -> FloatArray:
        """Derivative of the inductances by the angle in H/rad, shape (N, 3, 3)."""
        waves = np.moveaxis(self.inductance, 0, -1)
        return np.moveaxis(derivative(waves, self.turns), -1, 0)

    @property
    def symmetry(self) -> Symmetry:
        """How much of the period must be known: what both the back-EMF and the inductances
        permit.
        """
        of_flux = self.phases.symmetry
        if of_flux == "sixth" and self._repeats(6):
            return "sixth"
        return "third" if of_flux != "none" and self._repeats(3) else "none"

    def _repeats(self, part: int) -> bool:
        shift = shift_of(part, self.turns)
        moved = np.roll(self.inductance, -(self.phases.angles // part), axis=0)
        away = np.max(np.abs(moved - shift @ self.inductance @ shift.T))
        return bool(away <= _SAME * np.max(np.abs(self.inductance)))

    def torque(self, currents: FloatArray) -> FloatArray:
        """Torque p (flux i + i' dL/dtheta i / 2) in N m, shape (..., N), of phase currents in A,
        shape (..., 3, N).
        """
        reluctance = 0.5 * np.einsum("...kj,jkl,...lj->...j", currents, self.slope, currents)
        made: FloatArray = self.phases.torque(currents) + self.phases.pole_pairs * reluctance
        return made

    def voltage(self, currents: FloatArray, omega_e: ArrayLike) -> FloatArray:
        """Phase voltages R i + omega_e (d(L i)/dtheta + flux) in V, half a step behind each angle,
        shape (..., 3, N).

        ``currents`` in A have the same shape, the electrical speeds in rad/s the shape (...).
        """
        omega = np.asarray(omega_e, dtype=np.float64)[..., np.newaxis, np.newaxis]
        linked = np.einsum("jkl,...lj->...kj", self.inductance, currents)
        flux = between(self.phases.flux)[0]
        return np.asarray(
            self.phases.r_s * between(currents)[0] + omega * (between(linked, self.turns)[1] + flux)
        )


# A machine in phase quantities, with constant inductances or with such that vary over the angle.
AnyPhaseMachine = PhaseMachine | SalientPhaseMachine
