"""Saturation of synchronous machines by published coefficients: currents as
functions of the flux linkages.

Self- and cross-saturation after M. Hinkkanen, P. Pescetto, E. Mölsä, S. E. Saarakkala, G.
Pellegrino, R. Bojoi, "Sensorless self-commissioning of synchronous reluctance motors at standstill
without rotor locking", IEEE Transactions on Industry Applications 53(3), 2017,
doi:10.1109/TIA.2016.2644624; magnets and saturable bridges after M. Lelli, M. Hinkkanen, F. Giulii
Capponi, "A saturation model based on a simplified equivalent magnetic circuit for permanent magnet
machines", ICEM 2024, doi:10.1109/ICEM60801.2024.10700403.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass

_GRID = 81


_MARGIN = 1.3


_STAGES = 12


_NEWTON_STEPS = 60


_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class SaturationModel:
    """Coefficients of the model, in powers of A and Wb, for peak dq quantities.

    ::

        i_d = (a_d0 + a_dd |psi_d|^s + a_dq/(v + 2) |psi_d|^u |psi_q|^(v + 2)) psi_d
              + g_b (psi_d - psi_n)
        i_q = (a_q0 + a_qq |psi_q|^t + a_dq/(u + 2) |psi_d|^(u + 2) |psi_q|^v) psi_q + k_q g_b psi_q
        g_b = a_b w^e / (1 + a_bp w^e),   w^2 = (psi_d - psi_n)^2 + k_q psi_q^2

    ``s``, ``t``, ``u``, ``v`` and ``e`` (``bridge_exponent``) are exponents; ``a_b`` = 0 leaves the
    magnets and their bridges out. The two cross terms come from one energy, so that d psi_d/d i_q =
    d psi_q/d i_d.
    """

    a_d0: float
    a_dd: float
    s: float
    a_q0: float
    a_qq: float
    t: float
    a_dq: float
    u: float
    v: float
    psi_n: float = 0.0
    a_b: float = 0.0
    a_bp: float = 0.0
    k_q: float = 0.0
    bridge_exponent: float = 2.0

    def __post_init__(self) -> None:
        """Refuse coefficients for which the currents do not rise with the fluxes."""
        if not (self.a_d0 > 0.0 and self.a_q0 > 0.0):
            raise InputError("the saturation model needs a_d0 and a_q0 above zero (1/H)")
        rest = (
            "a_dd",
            "s",
            "a_qq",
            "t",
            "a_dq",
            "u",
            "v",
            "psi_n",
            "a_b",
            "a_bp",
            "k_q",
            "bridge_exponent",
        )
        for name in rest:
            if not getattr(self, name) >= 0.0:
                raise InputError(
                    f"the saturation model needs {name} zero or positive, got "
                    f"{getattr(self, name):g}"
                )

    def currents(self, psi_d: FloatArray, psi_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents (i_d, i_q) in A at flux linkages in Wb, any one shape."""
        size_d, size_q = np.abs(psi_d), np.abs(psi_q)
        cross_d = self.a_dq / (self.v + 2.0) * size_d**self.u * size_q ** (self.v + 2.0)
        cross_q = self.a_dq / (self.u + 2.0) * size_d ** (self.u + 2.0) * size_q**self.v
        bridge = psi_d - self.psi_n
        gain, _ = self._bridge(bridge, psi_q)
        i_d = (self.a_d0 + self.a_dd * size_d**self.s + cross_d) * psi_d + gain * bridge
        i_q = (self.a_q0 + self.a_qq * size_q**self.t + cross_q + self.k_q * gain) * psi_q
        return i_d, i_q

    def _bridge(self, bridge: FloatArray, psi_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inverse inductance g_b of the bridges in 1/H, and its derivative by w over w."""
        width = np.maximum(np.sqrt(bridge**2 + self.k_q * psi_q**2), _TINY)
        power = width**self.bridge_exponent
        room = 1.0 + self.a_bp * power
        return self.a_b * power / room, self.a_b * self.bridge_exponent * power / (
            width * room
        ) ** 2

    def _inverse_inductances(
        self, psi_d: FloatArray, psi_q: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives d i_d/d psi_d, d i_q/d psi_q and the mixed one (both are equal) in 1/H."""
        size_d, size_q = np.abs(psi_d), np.abs(psi_q)
        bridge = psi_d - self.psi_n
        gain, slope = self._bridge(bridge, psi_q)
        share_d = (
            self.a_dq * (self.u + 1.0) / (self.v + 2.0) * size_d**self.u * size_q ** (self.v + 2.0)
        )
        share_q = (
            self.a_dq * (self.v + 1.0) / (self.u + 2.0) * size_d ** (self.u + 2.0) * size_q**self.v
        )
        by_d = (
            self.a_d0
            + self.a_dd * (self.s + 1.0) * size_d**self.s
            + share_d
            + gain
            + slope * bridge**2
        )
        across = self.k_q * psi_q
        by_q = (
            self.a_q0
            + self.a_qq * (self.t + 1.0) * size_q**self.t
            + share_q
            + self.k_q * gain
            + slope * across**2
        )
        mixed = (
            self.a_dq * size_d**self.u * size_q**self.v * psi_d * psi_q + slope * bridge * across
        )
        return by_d, by_q, mixed

    def fluxes(self, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Flux linkages (psi_d, psi_q) in Wb at currents in A, any one shape.

        Newton's method, damped by halving and led from zero current outwards: the energy is convex,
        so that there is one solution.

        Raises:
            NoSolutionError: The coefficients are such that it is not found.
        """
        psi_d, psi_q = np.zeros_like(i_d), np.zeros_like(i_q)
        for stage in range(_STAGES + 1):
            share = stage / _STAGES
            psi_d, psi_q, left = self._solve(share * i_d, share * i_q, psi_d, psi_q)
        if not np.max(left) <= 1e-9 * max(float(np.max(np.hypot(i_d, i_q))), 1e-9):
            raise NoSolutionError(
                "the saturation model has no flux linkage for some current; check its coefficients"
            )
        return psi_d, psi_q

    def _solve(
        self, i_d: FloatArray, i_q: FloatArray, psi_d: FloatArray, psi_q: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fluxes near a start, and the length of the current error that is left in A."""

        def error(at_d: FloatArray, at_q: FloatArray) -> tuple[FloatArray, FloatArray]:
            found_d, found_q = self.currents(at_d, at_q)
            return i_d - found_d, i_q - found_q

        error_d, error_q = error(psi_d, psi_q)
        left = np.hypot(error_d, error_q)
        for _ in range(_NEWTON_STEPS):
            by_d, by_q, mixed = self._inverse_inductances(psi_d, psi_q)
            determinant = by_d * by_q - mixed**2
            step_d = (by_q * error_d - mixed * error_q) / determinant
            step_q = (by_d * error_q - mixed * error_d) / determinant
            length = np.ones_like(left)
            for _ in range(8):
                worse = np.hypot(*error(psi_d + length * step_d, psi_q + length * step_q)) > left
                if not worse.any():
                    break
                length = np.where(worse, 0.5 * length, length)
            psi_d, psi_q = psi_d + length * step_d, psi_q + length * step_q
            error_d, error_q = error(psi_d, psi_q)
            left = np.hypot(error_d, error_q)
            if float(np.max(left)) <= 1e-13 * max(float(np.max(np.hypot(i_d, i_q))), 1.0):
                break
        return psi_d, psi_q, left

    def flux_map(self, i_max: float) -> FluxMap:
        """Splines through 81 x 81 points of the model up to 1.3 times a current limit in A (peak).

        Raises:
            NoSolutionError: As `fluxes`.
        """
        axis = _MARGIN * i_max * np.linspace(-1.0, 1.0, _GRID)
        i_d, i_q = np.meshgrid(axis, axis[_GRID // 2 :], indexing="ij")
        psi_d, psi_q = self.fluxes(i_d, i_q)
        mirrored_d, mirrored_q = psi_d[:, :0:-1], -psi_q[:, :0:-1]
        return FluxMap(axis, axis, np.hstack([mirrored_d, psi_d]), np.hstack([mirrored_q, psi_q]))
