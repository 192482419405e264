"""Which phase discontinuous modulators tie to which rail, and what that
saves of the switching loss.

At every instant the phase with the highest reference can rest at the positive rail, or the one with
the lowest at the negative. The modulators differ in nothing but this choice: by the sign of the
rail (DPWMMAX, DPWMMIN), by the magnitudes of the references seen from another angle (DPWM0 to
DPWM3, GDPWM) or by those of the currents (DDT-GDPWM).

References
----------
A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM algorithm",
IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446 (clamping angle psi,
DPWM0 to DPWM3). A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical and graphical methods for
carrier-based PWM-VSI drives", IEEE Transactions on Power Electronics 14(1), 1999,
doi:10.1109/63.737592 (switching loss function). T. D. Nguyen et al., "A direct digital technique
implementation of general discontinuous pulse width modulation strategy", IEEE Transactions on
Industrial Electronics 58(9), 2011, doi:10.1109/TIE.2010.2102311 (DDT-GDPWM).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.modulation.zero_sequence import compared, extremes, highest_rests, load_turn
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import DOUBLES, Pair, Reals, Triple, clarke

DISCONTINUOUS: frozenset[ModulationName] = frozenset(
    ("dpwm0", "dpwm1", "dpwm2", "dpwm3", "dpwmmin", "dpwmmax", "gdpwm", "ddt-gdpwm")
)

"""Modulators that keep one phase at a rail at every instant."""


ONE_RAIL: frozenset[ModulationName] = frozenset(("dpwmmin", "dpwmmax"))

"""Modulators that use one rail only: their two half waves differ."""


_THIRTY = math.pi / 6.0


_SIXTY = math.pi / 3.0


# Eight Gauss points integrate products of three sines over at most 60 degrees to rounding.
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)


# Loads this close to pure reactance count as motoring, so that rounding does not turn the
# clamping angle to and fro.
_REACTIVE = 1e-9


# Angles from the positive peak of a phase between which it rests in each half wave.
_RESTING: dict[ModulationName, tuple[tuple[float, float], ...]] = {
    "dpwm0": ((-_SIXTY, 0.0),),
    "dpwm1": ((-_THIRTY, _THIRTY),),
    "dpwm2": ((0.0, _SIXTY),),
    "dpwm3": ((-_SIXTY, -_THIRTY), (_THIRTY, _SIXTY)),
    "dpwmmin": ((-_SIXTY, _SIXTY),),
    "dpwmmax": ((-_SIXTY, _SIXTY),),
}


def _folded(sine: FloatArray, cosine: FloatArray) -> FloatArray:
    """Angle from -90 to 90 degrees (rad) that a lag has when generating counts as
    motoring with current reversed.
    """
    generating = cosine < -_REACTIVE * np.hypot(sine, cosine)
    return np.asarray(
        np.arctan2(np.where(generating, -sine, sine), np.abs(cosine)), dtype=np.float64
    )


def clamping_angle(load_angle: ArrayLike) -> FloatArray:
    """Clamping angle psi of GDPWM in rad: phi + 30 degrees, within 0 and 60 degrees (Hava 1998).

    psi = 0, 30 and 60 degrees is DPWM0, DPWM1 and DPWM2: each phase rests from psi - 60
    degrees to psi after its peaks.

    Parameters
    ----------
    load_angle:
        Angle phi in rad by which the current lags the voltage, any shape. Loss depends on the
        magnitude of the current alone, so that generating (phi beyond 90 degrees) is as motoring
        with the current reversed.
    """
    phi = np.asarray(load_angle, dtype=np.float64)
    return np.clip(_folded(np.sin(phi), np.cos(phi)) + _THIRTY, 0.0, _SIXTY)


def compared_at(
    name: ModulationName, voltage: FloatArray, current: FloatArray
) -> tuple[Triple[Reals], Triple[Reals], Pair[Reals] | None, Pair[Reals] | None]:
    """References and currents of the phases, and for GDPWM the references' vector and
    the turn of the load angle.

    Parameters
    ----------
    name:
        The modulator.
    voltage, current:
        Phase references in V and phase currents in A, shape (..., 3).
    """
    v, i = (Triple(*np.moveaxis(phases, -1, 0)) for phases in (voltage, current))
    if name != "gdpwm":
        return v, i, None, None
    vector = clarke(DOUBLES, v)
    return v, i, vector, load_turn(vector, clarke(DOUBLES, i), _REACTIVE)


def resting_phase(
    name: ModulationName, voltage: FloatArray, current: FloatArray
) -> tuple[IndexArray, BoolArray]:
    """Index (...) of the phase that a discontinuous modulator clamps, and True (...)
    where to the positive rail.

    Of equal references the first is the highest and the last is the lowest, so that the two are
    never the same phase; where both might rest equally well it is the highest.

    Parameters
    ----------
    name:
        A modulator of `DISCONTINUOUS`; a `KeyError` for others.
    voltage, current:
        Phase references in V and phase currents in A, shape (..., 3). GDPWM takes the load angle
        from the space vectors of both, DDT-GDPWM compares currents, the others look at the
        references alone.
    """
    v, i, vector, turn = compared_at(name, voltage, current)
    number = Triple(*np.arange(3))
    if name in ONE_RAIL:
        (_, highest), (_, lowest) = extremes(DOUBLES, v, number)
        upper = np.full(v.a.shape, name == "dpwmmax")
    else:
        seen = compared(DOUBLES, name, v, i, vector, turn)
        (_, of_high, highest), (_, of_low, lowest) = extremes(DOUBLES, v, seen, number)
        upper = np.asarray(highest_rests(DOUBLES, name, of_high, of_low))
    return np.where(upper, highest, lowest), upper


def hand_over(name: ModulationName, load_angle: FloatArray) -> FloatArray:
    """Angle (...) in rad within the first 60 degrees after a positive peak where
    the resting phase changes.

    0 or 60 degrees where it changes between the sectors only, and for continuous modulators. With
    DDT-GDPWM it is where the magnitudes of the two currents cross, with the others at the clamping
    angle.

    Parameters
    ----------
    name:
        The modulator.
    load_angle:
        Angle in rad by which the current lags the voltage, shape (...).
    """
    if name == "ddt-gdpwm":
        return np.minimum(np.mod(load_angle + _THIRTY, math.pi / 2.0), _SIXTY)
    if name == "gdpwm":
        return clamping_angle(load_angle)
    return np.full_like(load_angle, _THIRTY if name in {"dpwm1", "dpwm3"} else _SIXTY)


def sector_rule(name: ModulationName, lag: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angles (..., n) of the voltage vector in its first sector, in rad, and their weights (...,
    n) of sum 1.

    `lag` (...) in rad is the angle by which the current lags the voltage. The sector, 0 to 60
    degrees, keeps the order V_a > V_b > V_c. It is split where a phase current is zero and where
    the resting phase changes, and each part gets its own Gauss rule: 24 angles. With modulators of
    one rail the next sector follows with the same 24.

    Parameters
    ----------
    name:
        The modulator.
    lag:
        Angle in rad by which the current lags the voltage, shape (...).
    """
    current_zero = np.mod(lag + _THIRTY, _SIXTY)
    change = hand_over(name, lag)
    edges = np.sort(
        np.stack([np.zeros_like(lag), current_zero, change, np.full_like(lag, _SIXTY)], axis=-1)
    )
    half = 0.5 * np.diff(edges, axis=-1)[..., None]
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])[..., None]
    shape = (*lag.shape, 3 * _GAUSS_NODES.size)
    angle, weight = (
        (middle + half * _GAUSS_NODES).reshape(shape),
        (half * _GAUSS_WEIGHTS / _SIXTY).reshape(shape),
    )
    if name not in ONE_RAIL:
        return angle, weight
    return np.concatenate([angle, angle + _SIXTY], axis=-1), np.concatenate(
        [weight, weight], axis=-1
    ) / 2.0


def _rectified_integral(start: FloatArray, end: FloatArray) -> FloatArray:
    """Integral of |cos x| from start to end in rad, any shape."""

    def primitive(x: FloatArray) -> FloatArray:
        half_waves = np.rint(x / math.pi)
        return np.asarray(2.0 * half_waves + np.sin(x - math.pi * half_waves))

    return primitive(end) - primitive(start)


def _ddt_factor(phi: FloatArray) -> FloatArray:
    """Switching loss function of DDT-GDPWM: the largest of two currents rests,
    at any load angle (rad, any shape).
    """
    lag = np.abs(_folded(np.sin(phi), np.cos(phi)))
    following_the_end = 1.0 - 0.5 * (np.sin(_SIXTY - lag) + np.sin(lag))
    taking_turns = 1.0 - 0.5 * (math.sqrt(3.0) - np.sin(lag))
    return np.where(lag <= _THIRTY, 0.5, np.where(lag <= _SIXTY, following_the_end, taking_turns))


def switching_loss_factor(name: ModulationName, load_angle: ArrayLike) -> FloatArray:
    """Switching loss relative to continuous modulators at the same carrier frequency (Hava 1999,
    SLF).

    ::

        SLF(phi) = 1 - 1/2 sum over the intervals where a phase rests in a half wave of
            int |cos(x - phi)| dx

    for losses proportional to the current; x from the peak of the phase's reference. The intervals
    in degrees are -60 to 0 (DPWM0), -30 to 30 (DPWM1), 0 to 60 (DPWM2), -60 to -30 and 30 to 60
    (DPWM3), psi - 60 to psi (GDPWM), and -60 to 60 in every other half wave (DPWMMIN, DPWMMAX).
    DDT-GDPWM: see docs/loss-budget.md.

    Parameters
    ----------
    name:
        The modulator; 1 for continuous ones.
    load_angle:
        Angle phi in rad by which the current lags the voltage, any shape.

    Returns
    -------
    FloatArray
        Of the shape of `load_angle`.
    """
    phi = np.asarray(load_angle, dtype=np.float64)
    if name not in DISCONTINUOUS:
        return np.ones_like(phi)
    if name == "ddt-gdpwm":
        return _ddt_factor(phi)
    if name == "gdpwm":
        psi = clamping_angle(phi)
        return 1.0 - 0.5 * _rectified_integral(psi - _SIXTY - phi, psi - phi)
    saved = sum(
        (_rectified_integral(start - phi, end - phi) for start, end in _RESTING[name]),
        np.zeros_like(phi),
    )
    return 1.0 - saved * (0.25 if name in ONE_RAIL else 0.5)


MEAN_SWITCHED_SHARE: Mapping[ModulationName, float] = MappingProxyType(
    dict.fromkeys(_RESTING, 2.0 / 3.0) | {"gdpwm": 0.5, "ddt-gdpwm": 0.5}
)

"""One figure for `switching_loss_factor` where the load angle is not known.

The mean over all load angles where the clamping does not follow the current; where it does, the
value up to 30 degrees.
"""
