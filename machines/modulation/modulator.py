"""What a modulator is: one record, which all that knows modulators by their names asks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Pair

# What is added to the references.
#
# ``sine``: nothing; ``third-harmonic``: a share of it; ``centred``: what brings the highest and the
# lowest reference to the same distance from the rails; ``highest``, ``lowest``: what ties that
# phase to its rail; ``compared``: what ties that of the two whose compared magnitude is the larger.
RuleKind = Literal["sine", "third-harmonic", "centred", "highest", "lowest", "compared"]

# What the rule ``compared`` looks at: the references, the references delayed by a constant angle or
# by the load angle, the currents.
Compared = Literal["none", "voltages", "seen later", "load angle", "currents"]
Coefficients = tuple[FloatArray, FloatArray, FloatArray]


def sector_end(load_angle: FloatArray) -> FloatArray:
    """``hand_over`` where the resting phase changes between the sectors only: 60 degrees in rad.

    Args:
        load_angle: Angles in rad by which the current lags the voltage, shape (...).
    """
    return np.full_like(load_angle, math.pi / 3.0)


@dataclass(frozen=True, slots=True)
class Modulator:
    """One modulator.

    Args:
        name: As in a design file.
        kind: The rule of its zero sequence, which is written once in
            `dqforge.machines.modulation.registry` for every kind of number.
        text: What it does, in a line.
        linear_limit: Largest phase-voltage amplitude (peak) without overmodulation, as a fraction
            of v_dc.
        distortion: c2, c3 and c4 of the harmonic distortion factor c2 m^2 + c3 m^3 + c4 m^4, m = V
            / (v_dc / 2), at angles in rad by which the current lags the voltage, all of the shape
            (...).
        overmodulated: int (u - 1/2) cos x dx over 0 to 90 degrees with the saturated duty cycle u,
            at amplitudes over v_dc beyond the linear limit, any shape; x from the peak of the
            phase's reference. The other quarters follow by symmetry: the fundamental is 4/pi v_dc
            of it.
        share: Share of the third harmonic in the amplitude, 1/4 at the most; 0 with other rules.
        compared: What the rule ``compared`` looks at.
        delay: Cosine and sine of the angle by which references ``seen later`` are delayed, +-30
            degrees.
        smaller: Whether the phase with the smaller of the compared magnitudes rests.
        loss_factor: Switching loss over that of continuous modulators at the same carrier
            frequency, for losses proportional to the current, at load angles in rad, any shape.
        mean_loss_factor: One figure for ``loss_factor`` where the load angle is not known: the mean
            over all load angles where the clamping does not follow the current; where it does, the
            value up to 30 degrees.
        hand_over: Angle in rad within the first 60 degrees after a positive peak of the voltage
            vector where the resting phase changes, at load angles in rad, shape (...).
    """

    name: ModulationName
    kind: RuleKind
    text: str
    linear_limit: float
    distortion: Callable[[FloatArray], Coefficients]
    overmodulated: Callable[[FloatArray], FloatArray]
    share: float = 0.0
    compared: Compared = "none"
    delay: Pair[float] | None = None
    smaller: bool = False
    loss_factor: Callable[[FloatArray], FloatArray] = np.ones_like
    mean_loss_factor: float = 1.0
    hand_over: Callable[[FloatArray], FloatArray] = sector_end

    @property
    def one_rail(self) -> bool:
        """Whether it uses one rail only: its two half waves differ."""
        return self.kind in ("highest", "lowest")

    @property
    def rests(self) -> bool:
        """Whether it keeps one phase at a rail at every instant (discontinuous modulators)."""
        return self.one_rail or self.kind == "compared"


def constant(c2: float, c3: float, c4: float) -> Callable[[FloatArray], Coefficients]:
    """Make a ``distortion`` that does not depend on the load angle.

    Args:
        c2, c3, c4: The coefficients, without unit.
    """

    def distortion(load_angle: FloatArray) -> Coefficients:
        return (
            np.full_like(load_angle, c2),
            np.full_like(load_angle, c3),
            np.full_like(load_angle, c4),
        )

    return distortion


# Angles between which phases rest, and what that saves of the switching loss.
#
# References:
#     A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM
#     algorithm", IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446
#     (clamping angle psi); "Simple analytical and graphical methods for carrier-based PWM-VSI
#     drives", IEEE Transactions on Power Electronics 14(1), 1999, doi:10.1109/63.737592 (switching
#     loss function).

THIRTY = math.pi / 6.0


SIXTY = math.pi / 3.0


# Loads this close to pure reactance count as motoring, so that rounding does not turn the
# clamping angle to and fro.
REACTIVE = 1e-9


def folded(sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Angle from -90 to 90 degrees (rad) that a lag has when generating counts as motoring with
    current reversed.

    Args:
        sine, cosine: Of the lag, times any positive factor, any shape.
    """
    generating = cosine < -REACTIVE * np.hypot(sine, cosine)
    return np.asarray(
        np.arctan2(np.where(generating, -sine, sine), np.abs(cosine)), dtype=np.float64
    )


def clamping_angle(load_angle: ArrayLike) -> FloatArray:
    """Clamping angle psi of GDPWM in rad: phi + 30 degrees, within 0 and 60 degrees (Hava 1998).

    psi = 0, 30 and 60 degrees is DPWM0, DPWM1 and DPWM2: each phase rests from psi - 60
    degrees to psi after its peaks.

    Args:
        load_angle: Angle phi in rad by which the current lags the voltage, any shape. Loss depends
            on the magnitude of the current alone, so that generating (phi beyond 90 degrees) is as
            motoring with the current reversed.
    """
    phi = np.asarray(load_angle, dtype=np.float64)
    return np.clip(folded(np.sin(phi), np.cos(phi)) + THIRTY, 0.0, SIXTY)


def rectified_integral(start: FloatArray, end: FloatArray) -> FloatArray:
    """Integral of |cos x| from start to end in rad, any shape."""

    def primitive(x: FloatArray) -> FloatArray:
        half_waves = np.rint(x / math.pi)
        return np.asarray(2.0 * half_waves + np.sin(x - math.pi * half_waves))

    return primitive(end) - primitive(start)


def saving(
    *intervals: tuple[float, float], one_rail: bool = False
) -> Callable[[FloatArray], FloatArray]:
    """Make the ``loss_factor`` of a phase that rests in given intervals.

    Args:
        intervals: First and last angle in rad from the positive peak of the phase's reference, for
            each half wave.
        one_rail: Whether it rests in every other half wave only.
    """

    def loss_factor(load_angle: FloatArray) -> FloatArray:
        saved = sum(
            (rectified_integral(start - load_angle, end - load_angle) for start, end in intervals),
            np.zeros_like(load_angle),
        )
        return 1.0 - saved * (0.25 if one_rail else 0.5)

    return loss_factor


def saturated_resting(r: FloatArray) -> FloatArray:
    """``overmodulated`` of all discontinuous modulators: u = 1 up to 30 degrees, sqrt(3) r cos(x -
    30 deg) from there.

    Args:
        r: Amplitude over v_dc, any shape.
    """
    edge = np.minimum(THIRTY + angle_of(1.0 / (math.sqrt(3.0) * r)), HALF_PI)
    end = np.full_like(r, HALF_PI)
    return (
        0.5 * np.sin(edge)
        + math.sqrt(3.0) * r * wave_integral(edge, end, THIRTY)
        - 0.5 * (1.0 - np.sin(edge))
    )


# Integrals of saturated duty cycles over a quarter of a period.

HALF_PI = 0.5 * math.pi


def wave_integral(start: FloatArray, end: FloatArray, shift: float, order: int = 1) -> FloatArray:
    """Integral of cos(order x - shift) cos(x) over an interval.

    Args:
        start, end: Its ends in rad, any shape.
        shift: Angle in rad.
        order: 1 or an odd order.
    """

    def primitive(x: FloatArray) -> FloatArray:
        slow = x * math.cos(shift) if order == 1 else np.sin((order - 1) * x - shift) / (order - 1)
        return np.asarray(0.5 * (slow + np.sin((order + 1) * x - shift) / (order + 1)))

    return primitive(end) - primitive(start)


def angle_of(cosine: FloatArray) -> FloatArray:
    """Angle in rad of a cosine, any shape, taken as +-1 beyond."""
    return np.arccos(np.clip(cosine, -1.0, 1.0))
