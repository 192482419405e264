"""By how much a six-step drive hands its current on too early or too late, and at which speeds that
stays small.

All in electrical rad over the electrical speed omega; dv is an offset of the voltage of the
floating phase, sigma its noise, g' the slope at the crossing, g_c the level and x the angle at the
commutation:

    zero crossing    1.375 dv/(omega g')             1.275 sigma/(omega g')
    integral         dv x/(omega g_c)                sigma sqrt(x t_s/omega)/g_c
    grid of periods  omega t_s/2, and what the filter has not yet of its lag at the crossing
    saliency         |L_q - L_d| I/g' (crossing), |L_q - L_d| I x/g_c (integral): the voltage that a
                     current in the two phases induces in the third; and, of the integral, the
                     change of the slope by kappa = (L_q - L_d) V_dc/(sqrt(3) L omega g') while the
                     current rises: x |1 - 1/sqrt(1 + kappa)|

Where L_d is the larger inductance, kappa is negative and flattens the crossing: all that is divided
by g' is divided by 1 + kappa besides.

The delay behind a crossing is half of the mean of the last two intervals, in which this crossing
counts a quarter and the one two before a quarter against it: an offset, which moves them by at most
1.5 dv/(omega g') against each other, adds three eighths.
For a sine dv x/(omega g_c) is (pi/3) dv/(psi omega).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.six_step.block_shape import BlockShape
from dqforge.optimizer.six_step.sectors import SECTOR

_FLAT = 1e-3  # least share of a slope that is left


@dataclass(frozen=True, slots=True)
class Disturbed:
    """What disturbs the voltage of the floating phase.

    Args:
        offset: In V, half a step of the converter included.
        noise: Standard deviation in V.
        t_s: Period in s.
        filter_time: Time constant of the filter of the voltage in s.
        free: Electrical angle in rad from the end of the unseen time to the crossing, in which the
            filter reaches the lag that is compensated.
        step:
            |L_q - L_d| I in Wb: of the saliency at the largest current.
        kappa: (L_q - L_d) V_dc/(sqrt(3) L) in V/rad: voltage per angle that rising current induces,
            with the back-EMF where L_q is the larger one, against it where L_d is.
    """

    offset: float
    noise: float
    t_s: float
    filter_time: float
    free: float
    step: float
    kappa: float


@dataclass(frozen=True, slots=True, eq=False)
class CommutationErrors:
    """Parts of the error in rad (electrical), shape (N,); ``noise`` is a standard deviation."""

    omega: FloatArray
    offset: FloatArray
    noise: FloatArray
    grid: FloatArray
    saliency: FloatArray

    @property
    def largest(self) -> FloatArray:
        """All parts at once, noise three times, in rad."""
        return self.offset + 3.0 * self.noise + self.grid + self.saliency


def commutation_errors(
    shape: BlockShape, known: Disturbed, omega: FloatArray, *, by_integral: bool
) -> CommutationErrors:
    """Errors of a commutation.

    Args:
        shape: Of the waveform.
        known: What disturbs the voltage.
        omega: Electrical speeds in rad/s, above 0, shape (N,).
        by_integral: Whether the integral decides, or the delay behind the crossing.
    """
    steeper = 1.0 + known.kappa / (omega * shape.slope)
    if by_integral:
        lever = np.full_like(omega, shape.delay / shape.level)
        noise = known.noise * np.sqrt(shape.delay * known.t_s / omega) / shape.level
        seen = np.sqrt(np.maximum(steeper, _FLAT))
        saliency = known.step * lever + shape.delay * np.abs(1.0 - 1.0 / seen)
    else:
        share = shape.delay / SECTOR
        lever = np.full_like(omega, (1.0 + 0.75 * share) / shape.slope)
        both = np.hypot(1.0 + 0.5 * share, 0.5 * share)
        noise = known.noise * both / (shape.slope * omega)
        flatter = np.clip(steeper, _FLAT, 1.0)
        lever, noise = lever / flatter, noise / flatter
        saliency = known.step / (shape.slope * flatter)
    missing = np.zeros_like(omega)
    if known.filter_time > 0.0:
        turned = omega * known.filter_time
        missing = turned * np.exp(-known.free / turned)
    grid = 0.5 * omega * known.t_s
    return CommutationErrors(omega, known.offset * lever / omega, noise, grid + missing, saliency)
