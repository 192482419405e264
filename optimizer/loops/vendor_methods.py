"""PI gains by the rules of vendors' own tools: the numbers that those tools put into firmware, in
double precision and in the parallel form per second.

Formulas are facts of the sources named in docs/firmware/loops.md. What their macros hold besides
(scales, factors of the sampling period, dividers, digits) is the firmware's format, not its rule.
"""

from __future__ import annotations

from typing import get_args

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import VendorMethod

_TI_INTEGRAL = 0.25  # of R/L: setupControllers takes a quarter of it into its series form


def is_vendor(method: str) -> bool:
    """Whether a method is the rule of a vendor's tool.

    Args:
        method: As in ``control.current_loop.method``.
    """
    return method in get_args(VendorMethod)


def vendor_inductance(method: str, inductances: tuple[float, float], place: int) -> float:
    """Inductance in H that a rule takes for an axis.

    ``vesc`` knows the mean of both, ``st-mcsdk`` that of q alone (LS); the others each axis' own.

    Args:
        method: As in ``control.current_loop.method``; of those that are no vendor's, the axis' own.
        inductances: L_d and L_q in H.
        place: 0 for d, 1 for q.
    """
    if method == "vesc":
        return 0.5 * (inductances[0] + inductances[1])
    return inductances[1] if method == "st-mcsdk" else inductances[place]


def vendor_current_pi(
    method: str, r_s: float, inductance: float, omega: float, damping: float
) -> tuple[float, float]:
    """Gains (kp in V/A, ki in V/(A s)) of a current loop by a vendor's rule.

        nxp-mcat     kp = 2 xi w L - R     ki = w^2 L
        ti           kp = w L              ki = w R/4
        st-mcsdk, vesc, infineon, moteus
                     kp = w L              ki = w R

    Args:
        method: The rule.
        r_s, inductance: Resistance in Ohm, and inductance in H as of `vendor_inductance`.
        omega: Bandwidth in rad/s.
        damping: Damping ratio, for nxp-mcat.
    """
    if method == "nxp-mcat":
        return 2.0 * damping * omega * inductance - r_s, omega**2 * inductance
    share = _TI_INTEGRAL if method == "ti" else 1.0
    return omega * inductance, share * omega * r_s


def vendor_speed_pi(
    method: str,
    mechanics: tuple[float, float],
    omega: float,
    damping: float,
    spread: float,
) -> tuple[float, float]:
    """Gains (kp in N m s/rad, ki in N m/rad) of the speed loop by a vendor's rule.

        nxp-mcat     kp = 2 xi w J         ki = w^2 J
        infineon     kp = w J              ki = w B
        ti           kp = w J/delta        ki = kp w/delta^2      w of the current loop

    Args:
        method: The rule.
        mechanics: Inertia J in kg m^2 and friction B in N m s/rad.
        omega: Bandwidth in rad/s: of the speed loop, for ti that of the current loop.
        damping: Damping ratio xi, for nxp-mcat.
        spread: delta, for ti.

    Raises:
        NoSolutionError: infineon makes its integral gain of the friction, and there is none.
    """
    inertia, friction = mechanics
    if method == "nxp-mcat":
        return 2.0 * damping * omega * inertia, omega**2 * inertia
    if method == "ti":
        kp = omega * inertia / spread
        return kp, kp * omega / spread**2
    if not friction > 0.0:
        raise NoSolutionError(
            "control.speed_loop: the method 'infineon' makes ki of the friction, w B, and "
            "machine.friction is zero; write it, or another method"
        )
    return omega * inertia, omega * friction
