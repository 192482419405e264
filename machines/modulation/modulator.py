"""What a modulator is: one record, which all that knows modulators by their names asks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np

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
            `dqforge.machines.modulation.zero_sequence` for every kind of number.
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
