"""Discontinuous modulators whose phases rest at angles of the reference: DPWM0 to DPWM3, and those
of one rail.

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM
    algorithm", IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulator import (
    SIXTY,
    THIRTY,
    Modulator,
    constant,
    saturated_resting,
    saving,
)
from dqforge.machines.transforms import Pair

_ROOT3 = math.sqrt(3.0)


_LIMIT = 1.0 / _ROOT3


_WHOLE_SECTOR = constant(
    6.0, -35.0 * _ROOT3 / (2.0 * math.pi), 27.0 / 8.0 + 81.0 * _ROOT3 / (64.0 * math.pi)
)


def _middle(load_angle: FloatArray) -> FloatArray:
    return np.full_like(load_angle, THIRTY)


def _that_with(what: str) -> str:
    return f"of the phases with the highest and lowest reference that with {what} rests"


MODULATORS = (
    Modulator(
        name="dpwm0",
        kind="compared",
        compared="seen later",
        delay=Pair(math.sqrt(0.75), -0.5),
        text=_that_with("the larger reference 30 degrees ahead"),
        linear_limit=_LIMIT,
        distortion=_WHOLE_SECTOR,
        overmodulated=saturated_resting,
        loss_factor=saving((-SIXTY, 0.0)),
        mean_loss_factor=2.0 / 3.0,
    ),
    Modulator(
        name="dpwm1",
        kind="compared",
        compared="voltages",
        text=_that_with("the larger reference"),
        linear_limit=_LIMIT,
        distortion=constant(
            6.0,
            -(45.0 + 8.0 * _ROOT3) / (2.0 * math.pi),
            27.0 / 8.0 + 27.0 * _ROOT3 / (32.0 * math.pi),
        ),
        overmodulated=saturated_resting,
        loss_factor=saving((-THIRTY, THIRTY)),
        mean_loss_factor=2.0 / 3.0,
        hand_over=_middle,
    ),
    Modulator(
        name="dpwm2",
        kind="compared",
        compared="seen later",
        delay=Pair(math.sqrt(0.75), 0.5),
        text=_that_with("the larger reference 30 degrees behind"),
        linear_limit=_LIMIT,
        distortion=_WHOLE_SECTOR,
        overmodulated=saturated_resting,
        loss_factor=saving((0.0, SIXTY)),
        mean_loss_factor=2.0 / 3.0,
    ),
    Modulator(
        name="dpwm3",
        kind="compared",
        compared="voltages",
        smaller=True,
        text=_that_with("the smaller reference"),
        linear_limit=_LIMIT,
        distortion=constant(
            6.0,
            (45.0 - 62.0 * _ROOT3) / (2.0 * math.pi),
            27.0 / 8.0 + 27.0 * _ROOT3 / (16.0 * math.pi),
        ),
        overmodulated=saturated_resting,
        loss_factor=saving((-SIXTY, -THIRTY), (THIRTY, SIXTY)),
        mean_loss_factor=2.0 / 3.0,
        hand_over=_middle,
    ),
    Modulator(
        name="dpwmmin",
        kind="lowest",
        text="the phase with the lowest rests at the negative rail",
        linear_limit=_LIMIT,
        distortion=_WHOLE_SECTOR,
        overmodulated=saturated_resting,
        loss_factor=saving((-SIXTY, SIXTY), one_rail=True),
        mean_loss_factor=2.0 / 3.0,
    ),
    Modulator(
        name="dpwmmax",
        kind="highest",
        text="the phase with the highest rests at the positive rail",
        linear_limit=_LIMIT,
        distortion=_WHOLE_SECTOR,
        overmodulated=saturated_resting,
        loss_factor=saving((-SIXTY, SIXTY), one_rail=True),
        mean_loss_factor=2.0 / 3.0,
    ),
)
