"""What flux linkages and torque have beside their means over the rotor angle: harmonics of slots
and magnets as finite elements give them, over the currents.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass

MOST_ORDERS = 8
_ANGLES = 720  # Angles over the period at which the torque is looked at.


@dataclass(frozen=True, slots=True, eq=False)
class TorqueRipple:
    """Torque beside its mean over the rotor angle, at constant currents.

    Args:
        orders: K orders per electrical turn.
        amplitudes: Of each order in N m, shape (K, N).
        peak_to_peak: Of all orders together in N m, shape (N,).
    """

    orders: tuple[float, ...]
    amplitudes: FloatArray
    peak_to_peak: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FluxRipple:
    """Fourier series over the electrical angle theta of what a flux map has beside its means.

    ::

        psi(i, theta) = psi(i) + sum_k a_k(i) cos(k theta) + b_k(i) sin(k theta)
        T = p (3/2 (psi_d i_q - psi_q i_d) + dW'/dtheta)

    with the co-energy W' of the machine. Between the grid currents the
    coefficients are cubic splines, as the flux linkages are.

    Args:
        orders: K orders per electrical turn, ascending, at most `MOST_ORDERS`.
        period: Electrical angle in rad after which all repeats.
        cosine, sine: a and b of psi_d and psi_q in Wb, one map per order.
        torque: Coefficients of dW'/dtheta in N m per pole pair: of the cosine in the place of
            psi_d, of the sine in that of psi_q; one map per order.
    """

    orders: tuple[float, ...]
    period: float
    cosine: tuple[FluxMap, ...]
    sine: tuple[FluxMap, ...]
    torque: tuple[FluxMap, ...]

    def flux(
        self, i_d: FloatArray, i_q: FloatArray, theta: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Flux linkages in Wb beside their means at currents in A and electrical angles in rad,
        broadcastable shapes.
        """
        shape = np.broadcast(i_d, i_q, theta).shape
        psi_d, psi_q = np.zeros(shape), np.zeros(shape)
        for order, first, second in zip(self.orders, self.cosine, self.sine, strict=True):
            for wave, part in ((np.cos, first), (np.sin, second)):
                by_d, by_q = part.flux(i_d, i_q)
                psi_d += wave(order * theta) * by_d
                psi_q += wave(order * theta) * by_q
        return psi_d, psi_q

    def coefficients(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Cosine and sine of the torque per pole pair in N m at currents in A, (K, 2, N)."""
        found = np.empty((len(self.orders), 2, np.size(i_d)))
        for k, parts in enumerate(zip(self.cosine, self.sine, strict=True)):
            turning = self.torque[k].flux(i_d, i_q)
            for j, part in enumerate(parts):
                psi_d, psi_q = part.flux(i_d, i_q)
                found[k, j] = 1.5 * (psi_d * i_q - psi_q * i_d) + turning[j]
        return found

    def torque_ripple(self, pole_pairs: int, i_d: FloatArray, i_q: FloatArray) -> TorqueRipple:
        """Ripple of the torque at currents in A, shape (N,)."""
        found = pole_pairs * self.coefficients(i_d, i_q)
        theta = np.arange(_ANGLES) * (self.period / _ANGLES)
        turns = np.outer(theta, self.orders)
        course = np.einsum("tk,kn->tn", np.cos(turns), found[:, 0])
        course += np.einsum("tk,kn->tn", np.sin(turns), found[:, 1])
        return TorqueRipple(self.orders, np.hypot(found[:, 0], found[:, 1]), np.ptp(course, axis=0))


def torque_ripple(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> TorqueRipple | None:
    """Ripple of the torque of a machine at currents in A, shape (N,); None where its data know
    none.
    """
    if not isinstance(machine, SaturatedMachine) or machine.flux_map.ripple is None:
        return None
    return machine.flux_map.ripple.torque_ripple(machine.pole_pairs, i_d, i_q)
