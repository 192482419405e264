"""Phase-locked loop that follows an angle: speed and angle from an angle error, sampled exactly.

Model: the speed is constant, theta[k+1] = theta[k] + t_s omega[k]. Per sample

    theta_p = theta[k-1] + t_s omega[k-1]                 prediction
    theta[k] = theta_p + l_1 eps,  omega[k] = omega[k-1] + l_2 eps,
                                   eps = measured angle - theta_p

The errors follow z^2 - (2 - l_1 - l_2 t_s) z + (1 - l_1) = 0. With z = exp(s t_s) for the roots of
s^2 + 2 zeta w s + w^2 (the continuous gains 2 zeta w and w^2 of ODrive, moteus, NXP and motulator)

    l_1 = 1 - exp(-2 zeta w t_s)
    l_2 = (1 + exp(-2 zeta w t_s) - 2 exp(-zeta w t_s) cos(w t_s sqrt(1 - zeta^2))) / t_s

(cosh for zeta > 1). At a constant acceleration a the prediction lags by eps = a t_s / l_2,
about a / w^2.
"""

from __future__ import annotations

import cmath
from typing import Annotated

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member

FASTEST = 0.5  # Largest bandwidth times t_s: beyond, single samples decide the angle.


@dataclass(frozen=True, slots=True)
class PllGains:
    """A phase-locked loop."""

    t_s: Annotated[float, Member("sampling period", "s")]
    l_1: Annotated[float, Member("angle per angle error")]
    l_2: Annotated[float, Member("speed per angle error", "1/s")]

    def lag(self, acceleration: float) -> float:
        """Steady angle error theta_hat - theta in rad at a constant acceleration in rad/s^2,
        after the correction.
        """
        return -(1.0 - self.l_1) * acceleration * self.t_s / self.l_2


def pll_gains(bandwidth: float, damping: float, t_s: float) -> PllGains:
    """Gains whose poles are those of s^2 + 2 damping bandwidth s + bandwidth^2 (rad/s),
    sampled every t_s seconds.

    Raises:
        InputError, NoSolutionError: A value is not positive, or the loop is too fast for the
            sampling.
    """
    if not (bandwidth > 0.0 and damping > 0.0 and t_s > 0.0):
        raise InputError("control.observer: pll_bandwidth and damping must be positive")
    if bandwidth * t_s > FASTEST:
        raise NoSolutionError(
            f"control.observer.pll_bandwidth: {bandwidth:g} rad/s is too fast for t_s = {t_s:g} s; "
            f"write {FASTEST / t_s:g} rad/s or less"
        )
    root = bandwidth * cmath.sqrt(complex(damping * damping - 1.0))
    first, second = (cmath.exp((-damping * bandwidth + sign * root) * t_s) for sign in (1.0, -1.0))
    product, total = (first * second).real, (first + second).real
    return PllGains(t_s=t_s, l_1=1.0 - product, l_2=(1.0 + product - total) / t_s)


def predicted(theta: Reals, advance: Reals, maths: Arithmetic) -> Reals:
    """Angle one period on, wrapped; ``advance`` is t_s omega in rad."""
    return maths.wrap(theta + advance)


def corrected(
    gains: PllGains, theta_p: Reals, omega: Reals, error: Reals, maths: Arithmetic
) -> tuple[Reals, Reals]:
    """Angle and speed after the angle error ``error`` in rad; all arrays of shape (N,)."""
    return maths.wrap(theta_p + gains.l_1 * error), omega + gains.l_2 * error


def pll_bandwidth(t_s: float) -> float:
    """600 rad/s, a loop that follows the speed of common drives, or 1/20 of the
    sampling rate in rad/s if less.
    """
    return min(600.0, 0.05 / t_s)
