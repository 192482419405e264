"""Constants of the speed observer for the main header."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.reports.c_code.header_constant import Constant, ConstantGroup

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution


def observer_constants(solution: Solution) -> list[ConstantGroup]:
    """The reduced-order speed observer; nothing without one."""
    observer = None if solution.loops is None else solution.loops.observer
    if observer is None:
        return []
    constants = (
        Constant("observer.a", observer.a, "", "pole in the z plane, dimensionless"),
        Constant("observer.b_u", observer.b_u, "rad/(s V)"),
        Constant("observer.b_i", observer.b_i, "rad/(s A)"),
        Constant("observer.c", observer.c, "rad/(s A)"),
    )
    comment = (
        "omega_hat[k] = zeta[k] - C i_q[k];  zeta[k+1] = A zeta[k] + B_U u_q[k] + B_I i_q[k]",
        "u_q = v_q - p omega_m L_D i_d, with the voltage that acts from sample k to k+1.",
        f"Continuous pole {observer.continuous_pole:.6g} 1/s; exact for held voltage.",
    )
    return [ConstantGroup("Reduced-order speed observer (mechanical speed)", constants, comment)]
