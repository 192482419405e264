"""A smooth saturated machine written twice, for NumPy and for CasADi,
so that solvers can be compared on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.saturation import SaturationModel
from dqforge.machines.dq_machines.synchronous import (
    FluxJet,
    LinearMachine,
    Machine,
    MachineFormulas,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

# Baldor 5.6 kW, Lelli et al. 2024.
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


def saturated_reluctance(seed: int, axis: str = "d", *, magnet: float = 0.0) -> SaturatedMachine:
    """A random machine without resistance whose greatest inductance lies on an axis and saturates.

    Self- and cross-saturation from one coenergy; ``magnet`` adds a share of the flux linkage to the
    d axis.
    """
    generator = np.random.default_rng(seed)
    i_max, pole_pairs = 10.0 ** generator.uniform(0.5, 2.5), int(generator.integers(2, 5))
    flux = 10.0 ** generator.uniform(-1.5, 0.2)
    knee = i_max * generator.uniform(0.1, 0.6)
    leakage = flux / i_max * generator.uniform(0.02, 0.15)
    other = flux / knee * generator.uniform(0.08, 0.35) * i_max
    cross = generator.uniform(0.0, 0.3) * flux * i_max * 0.1
    axes = np.linspace(-1.3, 1.3, 41) * i_max
    main, small = np.meshgrid(axes, axes, indexing="ij")
    x, y = main / knee, small / i_max

    def hump(z: FloatArray) -> FloatArray:
        return z * z / (1.0 + z * z)

    def slope(z: FloatArray) -> FloatArray:
        return 2.0 * z / (1.0 + z * z) ** 2

    along = flux * 2.0 / np.pi * np.arctan(0.5 * np.pi * x) + leakage * main
    along -= cross * slope(x) / knee * hump(y)
    across = other * (0.7 * np.arctan(1.5 * y) / 1.5 + 0.3 * y) - cross * hump(x) * slope(y) / i_max
    psi_d, psi_q = (along, across) if axis == "d" else (across.T, along.T)
    flux_map = FluxMap(axes, axes, psi_d + magnet * np.max(np.abs(psi_d)), psi_q)
    return SaturatedMachine(pole_pairs, 0.0, flux_map, i_max)


def with_drop(machine: Machine, share: float, omega_m: float = 100.0) -> tuple[Machine, float]:
    """The machine with a resistance that takes a share of the voltage at the current limit, and
    that voltage in V: what its MTPA currents take at a mechanical speed in rad/s, nearly.
    """
    assert isinstance(machine, SaturatedMachine | LinearMachine)
    locus = mtpa_locus(machine, machine.i_max)
    flux = float(np.max(np.hypot(*machine.flux(locus.i_d, locus.i_q))))
    v_max = flux * omega_m * machine.pole_pairs / (1.0 - share)
    return replace(machine, r_s=share * v_max / machine.i_max), v_max
