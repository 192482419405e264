"""Machines in phase quantities: any back-EMF shape, constant self and mutual inductance,
no saliency.

Angles are electrical, theta from phase a to the d axis; a waveform is an array over an even
grid theta_j = 2 pi j / N.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError

Symmetry = Literal["sixth", "third", "none"]

"""What part of the period tells all: one sixth (equal phases, mirrored half waves),
one third (equal phases), all."""


STENCIL = (3.0 / 4.0, -3.0 / 20.0, 1.0 / 60.0)

"""Weights of the central difference of sixth order at distances 1, 2 and 3."""


OFFSETS = (-1, 0, 1, 2)


MIDDLE = (-1.0 / 16.0, 9.0 / 16.0, 9.0 / 16.0, -1.0 / 16.0)


SLOPE = (1.0 / 24.0, -27.0 / 24.0, 27.0 / 24.0, -1.0 / 24.0)

"""Weights of value and slope in the middle between two angles, at these
offsets from the first of them."""


ANGLES = 360


_SAME = 1e-9


_TURN = 2.0 * np.pi / 3.0


# How the phases at theta + 120 degrees, or + 60 degrees with mirrored half waves,
# follow from those at theta.
SHIFT_THIRD = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


SHIFT_SIXTH = -np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


def derivative(waveform: FloatArray) -> FloatArray:
    """Derivative by the angle in 1/rad along the last axis, periodic, of sixth order.

    Parameters
    ----------
    waveform:
        Values in any unit over one period, shape (..., N).
    """
    step = 2.0 * np.pi / waveform.shape[-1]
    found: FloatArray = np.zeros_like(waveform)
    for distance, weight in enumerate(STENCIL, start=1):
        ahead, behind = np.roll(waveform, -distance, axis=-1), np.roll(waveform, distance, axis=-1)
        found += weight / step * (ahead - behind)
    return found


def between(waveform: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value and slope (per rad) of a periodic waveform in the middle behind each angle,
    along the last axis.

    Of fourth order over the four angles around. Unlike the slope at an angle this one sees what
    alternates from one angle to the next, which would otherwise escape every limit on voltage.
    """
    step = 2.0 * np.pi / waveform.shape[-1]
    value: FloatArray = np.zeros_like(waveform)
    slope: FloatArray = np.zeros_like(waveform)
    for offset, of_value, of_slope in zip(OFFSETS, MIDDLE, SLOPE, strict=True):
        moved = np.roll(waveform, -offset, axis=-1)
        value += of_value * moved
        slope += of_slope / step * moved
    return value, slope


@dataclass(frozen=True, slots=True, eq=False)
class PhaseMachine:
    """A three-phase machine whose back-EMF has any shape.

    Parameters
    ----------
    pole_pairs:
        Number of pole pairs p.
    r_s:
        Phase resistance in Ohm.
    l_s, m_s:
        Self inductance of a phase, and mutual inductance between two (usually negative), in H.
    flux:
        Back-EMF over electrical speed, e_k = omega_e flux_k(theta_j), in V s/rad, shape (3, N),
        N a multiple of 12.
    i_max:
        Largest phase current in A, peak.

    Raises
    ------
    InputError
        The shape does not fit, a value is not finite, or the inductances store
        no energy in some current.
    """

    pole_pairs: int
    r_s: float
    l_s: float
    m_s: float
    flux: FloatArray
    i_max: float

    def __post_init__(self) -> None:
        """Own the waveform and check what would make no machine."""
        owned = np.array(self.flux, dtype=np.float64)
        owned.flags.writeable = False
        object.__setattr__(self, "flux", owned)
        if owned.ndim != 2 or owned.shape[0] != 3 or owned.shape[1] < 24 or owned.shape[1] % 12:
            raise InputError(
                "the back-EMF needs the shape (3, N), N a multiple of 12 from 24 on, got "
                f"{owned.shape}"
            )
        if not (np.all(np.isfinite(owned)) and np.any(owned)):
            raise InputError("the back-EMF must be finite and not zero everywhere")
        if not (self.l_s - self.m_s > 0.0 and self.l_s + 2.0 * self.m_s > 0.0):
            raise InputError(
                f"l_s = {self.l_s:g} H and m_s = {self.m_s:g} H store no energy in some current: "
                "l_s - m_s and l_s + 2 m_s must be positive"
            )

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
        angles: int = ANGLES,
    ) -> PhaseMachine:
        """A machine from the harmonics of its back-EMF, e_k / omega_e = - sum
        A_kh sin(h theta - phi_kh).

        ``orders`` has the shape (H,); ``amplitudes`` in V s/rad and ``phases`` in rad have the
        shape (3, H), or (H,) for three equal phases, of which b and c lag by 120 and 240 degrees.
        """
        order = np.asarray(orders, dtype=np.float64)
        size, lag = np.asarray(amplitudes, dtype=np.float64), np.asarray(phases, dtype=np.float64)
        if size.ndim == 1:
            size, lag = np.stack([size] * 3), np.stack([lag + order * _TURN * k for k in range(3)])
        theta = 2.0 * np.pi * np.arange(angles) / angles
        angle = order[:, np.newaxis] * theta - lag[:, :, np.newaxis]
        flux = -np.sum(size[:, :, np.newaxis] * np.sin(angle), axis=1)
        return cls(pole_pairs, r_s, l_s, m_s, flux, i_max)

    @property
    def angles(self) -> int:
        """Number N of angles in the period."""
        return int(self.flux.shape[1])

    @property
    def inductances(self) -> FloatArray:
        """Inductance matrix of the phases in H, shape (3, 3)."""
        return self.m_s + (self.l_s - self.m_s) * np.eye(3)

    @property
    def psi_pm(self) -> float:
        """Positive sequence of the fundamental flux linkage, peak of phase, in Wb."""
        theta = 2.0 * np.pi * np.arange(self.angles) / self.angles
        turns = theta - _TURN * np.arange(3)[:, np.newaxis]
        return float(2.0 * np.abs(np.mean(self.flux * np.exp(-1j * turns))))

    @property
    def symmetry(self) -> Symmetry:
        """How much of the period must be known."""
        count, scale = self.angles, float(np.max(np.abs(self.flux)))

        def repeats(part: int, shift: FloatArray) -> bool:
            return bool(
                np.max(np.abs(np.roll(self.flux, -count // part, axis=1) - shift @ self.flux))
                <= _SAME * scale
            )

        if repeats(6, SHIFT_SIXTH):
            return "sixth"
        return "third" if repeats(3, SHIFT_THIRD) else "none"

    def symmetrised(self) -> PhaseMachine:
        """The machine with the mean of its phases and of its half waves, so that a
        sixth of the period tells all.
        """
        flux, part = np.zeros_like(self.flux), self.angles // 6
        turned = np.eye(3)
        for sector in range(6):
            flux += np.linalg.inv(turned) @ np.roll(self.flux, -sector * part, axis=1) / 6.0
            turned = SHIFT_SIXTH @ turned
        return PhaseMachine(self.pole_pairs, self.r_s, self.l_s, self.m_s, flux, self.i_max)

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
        value, slope = between(currents)
        return self.r_s * value + omega * (self.inductances @ slope + between(self.flux)[0])

    def copper_loss(self, currents: FloatArray) -> FloatArray:
        """Mean copper loss R sum i_k^2 in W, shape (...)."""
        loss: FloatArray = self.r_s * np.mean(np.sum(currents**2, axis=-2), axis=-1)
        return loss
