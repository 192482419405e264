"""A smooth saturated machine written twice, for NumPy and for CasADi,
so that solvers can be compared on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.saturation import SaturationModel
from dqforge.machines.dq_machines.synchronous import FluxJet, MachineFormulas

PM_SYRM = SaturationModel(
    a_d0=3.96,
    a_dd=28.5,
    s=4,
    a_q0=5.89,
    a_qq=2.67,
    t=6,
    a_dq=41.5,
    u=1,
    v=1,
    psi_n=0.804,
    a_b=81.75,
    a_bp=1.0,
    k_q=0.1,
    bridge_exponent=2,
)
"""Baldor 5.6 kW, Lelli et al. 2024."""


@dataclass(frozen=True)
class ArctanMachine(MachineFormulas):
    """Cross-saturated: psi_d = psi_m + a_d atan(i_d/b_d) - c i_q^2, psi_q = a_q
    atan(i_q/b_q) - 2 c i_d i_q.
    """

    pole_pairs: int = 3
    r_s: float = 0.05
    i_max: float = 120.0
    psi_m: float = 0.12
    a_d: float = 0.08
    b_d: float = 150.0
    a_q: float = 0.16
    b_q: float = 70.0
    c: float = 8e-7
    inertia: float | None = None
    friction: float = 0.0
    omega_m_max: float | None = None

    @property
    def psi_pm(self) -> float:
        return self.psi_m

    @property
    def l_d(self) -> float:
        return self.a_d / self.b_d

    @property
    def l_q(self) -> float:
        return self.a_q / self.b_q

    def flux(self, i_d: Any, i_q: Any, lib: Any = np) -> tuple[Any, Any]:
        arctan = lib.arctan if lib is np else ca.atan
        psi_d = self.psi_m + self.a_d * arctan(i_d / self.b_d) - self.c * i_q * i_q
        return psi_d, self.a_q * arctan(i_q / self.b_q) - 2.0 * self.c * i_d * i_q

    def jet(self, i_d: FloatArray, i_q: FloatArray) -> FluxJet:
        psi_d, psi_q = self.flux(i_d, i_q)
        x, y = i_d / self.b_d, i_q / self.b_q
        zero, c = np.zeros_like(i_d), self.c
        slope_d, slope_q = self.a_d / self.b_d / (1 + x * x), self.a_q / self.b_q / (1 + y * y)
        bend_d = -2.0 * x * slope_d / (1 + x * x) / self.b_d
        bend_q = -2.0 * y * slope_q / (1 + y * y) / self.b_q
        return FluxJet(
            psi_d,
            psi_q,
            slope_d,
            -2.0 * c * i_q,
            -2.0 * c * i_q,
            slope_q - 2.0 * c * i_d,
            bend_d,
            zero,
            zero - 2.0 * c,
            zero,
            zero - 2.0 * c,
            bend_q,
        )
