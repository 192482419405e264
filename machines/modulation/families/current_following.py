"""Discontinuous modulators that rest the phase with the large current: GDPWM and DDT-GDPWM.

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM
    algorithm", IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446. T. D.
    Nguyen et al., "A direct digital technique implementation of general discontinuous pulse width
    modulation strategy", IEEE Transactions on Industrial Electronics 58(9), 2011,
    doi:10.1109/TIE.2010.2102311 (DDT-GDPWM).
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulator import (
    SIXTY,
    THIRTY,
    Coefficients,
    Modulator,
    clamping_angle,
    folded,
    rectified_integral,
    saturated_resting,
)

_ROOT3 = math.sqrt(3.0)


# c2, c3, c4 of a phase that rests from one peak of a reference to the next (DPWM0, DPWM2).
_EVEN = 6.0, -35.0 * _ROOT3 / (2.0 * math.pi), 27.0 / 8.0 + 81.0 * _ROOT3 / (64.0 * math.pi)


def _at_clamping_angle(psi: FloatArray) -> Coefficients:
    """c2, c3, c4 of GDPWM for clamping angles in rad, any shape."""
    delta = psi - THIRTY
    third = (9.0 * np.cos(3.0 * delta) - 54.0 * np.cos(delta) - 8.0 * _ROOT3) / (2.0 * math.pi)
    wave = 4.0 * np.cos(2.0 * delta) - 2.0 * np.cos(4.0 * delta)
    return np.full_like(psi, 6.0), third, 27.0 / 8.0 + 27.0 * _ROOT3 / (64.0 * math.pi) * wave


def _gdpwm_distortion(phi: FloatArray) -> Coefficients:
    return _at_clamping_angle(clamping_angle(phi))


def _ddt_distortion(phi: FloatArray) -> Coefficients:
    # Beyond 60 degrees DDT-GDPWM clamps what GDPWM with the clamping angle |phi| - 60 degrees would
    # not; both together clamp highest and lowest throughout, as DPWM0 and DPWM2 together do.
    lag = np.arccos(np.clip(np.abs(np.cos(phi)), 0.0, 1.0))
    following = _at_clamping_angle(clamping_angle(phi))
    opposite = _at_clamping_angle(np.maximum(lag - SIXTY, 0.0))
    c2, c3, c4 = (
        np.where(lag <= SIXTY, near, 2.0 * even - far)
        for near, even, far in zip(following, _EVEN, opposite, strict=True)
    )
    return c2, c3, c4


def _gdpwm_factor(phi: FloatArray) -> FloatArray:
    psi = clamping_angle(phi)
    return 1.0 - 0.5 * rectified_integral(psi - SIXTY - phi, psi - phi)


def _ddt_factor(phi: FloatArray) -> FloatArray:
    """Switching loss function of DDT-GDPWM: the largest of two currents rests,
    at any load angle (rad, any shape).
    """
    lag = np.abs(folded(np.sin(phi), np.cos(phi)))
    following_the_end = 1.0 - 0.5 * (np.sin(SIXTY - lag) + np.sin(lag))
    taking_turns = 1.0 - 0.5 * (_ROOT3 - np.sin(lag))
    return np.where(lag <= THIRTY, 0.5, np.where(lag <= SIXTY, following_the_end, taking_turns))


def _currents_cross(load_angle: FloatArray) -> FloatArray:
    return np.minimum(np.mod(load_angle + THIRTY, math.pi / 2.0), SIXTY)


MODULATORS = (
    Modulator(
        name="gdpwm",
        kind="compared",
        compared="load angle",
        text=(
            "of the phases with the highest and lowest reference that with the larger reference at "
            "the load angle, up to 30 degrees rests"
        ),
        linear_limit=1.0 / _ROOT3,
        distortion=_gdpwm_distortion,
        overmodulated=saturated_resting,
        loss_factor=_gdpwm_factor,
        mean_loss_factor=0.5,
        hand_over=clamping_angle,
    ),
    Modulator(
        name="ddt-gdpwm",
        kind="compared",
        compared="currents",
        text=(
            "of the phases with the highest and lowest reference that with the larger current rests"
        ),
        linear_limit=1.0 / _ROOT3,
        distortion=_ddt_distortion,
        overmodulated=saturated_resting,
        loss_factor=_ddt_factor,
        mean_loss_factor=0.5,
        hand_over=_currents_cross,
    ),
)
