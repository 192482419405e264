"""Core and magnet loss of a machine over its currents, as finite elements give it: splines of the
parts that grow alike with the frequency.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.records import dataclass

_ROUNDING = 1e-9  # Share of the largest loss below which a difference is none.


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
        compared: The formula by |psi|^2 beside it, None where there is nothing to compare.
    """

    iron: FluxMap
    magnet: FluxMap | None
    omega: float
    exponent: float = 1.0
    source: str = ""
    compared: FluxLossFit | None = None

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


@dataclass(frozen=True, slots=True)
class FluxLossFit:
    """The iron loss (k_h |omega_e| + k_c omega_e^2) |psi|^2 held against a map at omega_0, over
    those of its currents that are within the limit.

    Args:
        hysteresis, eddy: k_h in W s/(rad Wb^2) and k_c in W s^2/(rad^2 Wb^2).
        misfit: R.m.s. difference over the r.m.s. loss of the map.
        points: How many currents.
        below: At how many of them the formula loses more than the map.
        least: Least of map less formula, in W, and the currents i_d, i_q in A (peak) there.
        fitted: Whether the coefficients are least squares of the map itself.
    """

    hysteresis: float
    eddy: float
    misfit: float
    points: int
    below: int
    least: tuple[float, float, float]
    fitted: bool

    @property
    def sentence(self) -> str:
        """What the comparison says, with its unit."""
        of = "fitted to the map" if self.fitted else "of machine.iron_loss"
        said = (
            f"the iron loss by |psi|^2 ({of}) differs from the map by {self.misfit:.1%} r.m.s. "
            f"over {self.points} currents"
        )
        if not self.below:
            return said
        least, i_d, i_q = self.least
        return (
            f"{said}; the map less that loss is below zero at {self.below} of them, least "
            f"{least:.3g} W at i_d = {i_d:.4g} A, i_q = {i_q:.4g} A"
        )


def held_against_flux(
    loss_map: LossMap,
    flux: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]],
    i_max: float,
    given: tuple[float, float] | None = None,
) -> FluxLossFit | None:
    """The formula by |psi|^2 beside a map, None where no iron loss of the map is within the limit.

    Args:
        loss_map: The map.
        flux: Flux linkages in Wb at currents in A.
        i_max: Current limit in A (peak).
        given: k_h and k_c that the design has; None takes the least squares of the map's two parts,
            of a sum with the exponent x those that match the loss and its growth at omega_0.
    """
    table = loss_map.iron
    i_d, i_q = np.meshgrid(table.i_d, table.i_q, indexing="ij")
    near = np.hypot(i_d, i_q) <= i_max * (1.0 + 1e-9)
    i_d, i_q, first, second = (part[near] for part in (i_d, i_q, table.psi_d, table.psi_q))
    psi_d, psi_q = flux(i_d, i_q)
    square = psi_d * psi_d + psi_q * psi_q
    loss, omega = first + second, loss_map.omega
    if not (np.any(loss > 0.0) and np.any(square > 0.0)):
        return None
    if given is None:
        grown = loss_map.exponent - 1.0
        parts = ((1.0 - grown) * first, second + grown * first)
        per_square = [float(np.sum(part * square) / np.sum(square * square)) for part in parts]
        k_h, k_c = per_square[0] / omega, per_square[1] / omega**2
    else:
        k_h, k_c = given
    left = loss - (k_h * omega + k_c * omega**2) * square
    left = np.where(np.abs(left) > _ROUNDING * np.max(loss), left, 0.0)
    worst = int(np.argmin(left))
    return FluxLossFit(
        k_h,
        k_c,
        float(np.sqrt(np.mean(left**2) / np.mean(loss**2))),
        loss.size,
        int(np.count_nonzero(left < 0.0)),
        (float(left[worst]), float(i_d[worst]), float(i_q[worst])),
        given is None,
    )
