"""Core and magnet loss of a machine over its currents, as finite elements give it: splines of the
parts that grow alike with the frequency.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.records import dataclass


class LossJet(NamedTuple):
    """A loss in W with its derivatives by the currents, arrays of one shape: W/A and W/A^2."""

    value: FloatArray
    d: FloatArray
    q: FloatArray
    dd: FloatArray
    dq: FloatArray
    qq: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LossMap:
    """Core and magnet loss over the currents and the electrical speed.

    ::

        P_iron   = h (|omega_e| / omega_0)^x + e (omega_e / omega_0)^2
        P_magnet = m (omega_e / omega_0)^2

    with h, e and m over (i_d, i_q) by cubic splines, even in i_q. Beyond their grid they go on
    along their tangents, and a sum that falls below zero counts as zero.

    Args:
        iron: h and e in W at omega_0, in the place of psi_d and psi_q.
        magnet: m in W at omega_0 in the place of psi_d, None without.
        omega: omega_0 in rad/s (electrical).
        exponent: x of the first part.
        source: Name of the file.
    """

    iron: FluxMap
    magnet: FluxMap | None
    omega: float
    exponent: float = 1.0
    source: str = ""

    def losses(
        self, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Core and magnet loss in W at currents in A (peak) and speeds in rad/s (electrical),
        broadcastable to the shape (...).
        """
        first, second = self.iron.flux(i_d, i_q)
        share, square = self._shares(omega_e)
        iron = np.maximum(first * share + second * square, 0.0)
        if self.magnet is None:
            return iron, np.zeros_like(iron)
        return iron, np.maximum(self.magnet.flux(i_d, i_q)[0] * square, 0.0)

    def jet(self, i_d: FloatArray, i_q: FloatArray, omega_e: FloatArray) -> LossJet:
        """Core and magnet loss together with first and second derivatives by the currents in A,
        arrays of shape (N,).
        """
        share, square = self._shares(omega_e)
        jet = self.iron.jet(i_d, i_q)
        parts = [
            first * share + second * square
            for first, second in (
                (jet.psi_d, jet.psi_q),
                (jet.l_dd, jet.l_qd),
                (jet.l_dq, jet.l_qq),
                (jet.d_dd, jet.q_dd),
                (jet.d_dq, jet.q_dq),
                (jet.d_qq, jet.q_qq),
            )
        ]
        parts = [np.where(parts[0] > 0.0, part, 0.0) for part in parts]
        if self.magnet is not None:
            jet = self.magnet.jet(i_d, i_q)
            more = (jet.psi_d, jet.l_dd, jet.l_dq, jet.d_dd, jet.d_dq, jet.d_qq)
            counts = square * (more[0] > 0.0)
            parts = [part + counts * add for part, add in zip(parts, more, strict=True)]
        return LossJet(*parts)

    def _shares(self, omega_e: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Growth of the first and of the second part with the speed."""
        ratio = np.abs(omega_e) / self.omega
        return ratio if self.exponent == 1.0 else ratio**self.exponent, ratio * ratio
