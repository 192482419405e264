"""Phase machines with saliency: the inductances, like the back-EMF, are waveforms
over the electrical angle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import (
    PhaseMachine,
    Symmetry,
    between,
    derivative,
    shift_of,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import DOUBLES, park

_SAME = 1e-9
_TURN = 2.0 * np.pi / 3.0


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
