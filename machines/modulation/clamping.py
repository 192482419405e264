"""Which phase discontinuous modulators tie to which rail, and what that
saves of the switching loss.

At every instant the phase with the highest reference can rest at the positive rail, or the one with
the lowest at the negative. The modulators differ in nothing but this choice: by the sign of the
rail (DPWMMAX, DPWMMIN), by the magnitudes of the references seen from another angle (DPWM0 to
DPWM3, GDPWM) or by those of the currents (DDT-GDPWM).

References:
    A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM
    algorithm", IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446
    (clamping angle psi, DPWM0 to DPWM3). A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical
    and graphical methods for carrier-based PWM-VSI drives", IEEE Transactions on Power Electronics
    14(1), 1999, doi:10.1109/63.737592 (switching loss function). T. D. Nguyen et al., "A direct
    digital technique implementation of general discontinuous pulse width modulation strategy", IEEE
    Transactions on Industrial Electronics 58(9), 2011, doi:10.1109/TIE.2010.2102311 (DDT-GDPWM).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.modulation.resting_angles import REACTIVE, SIXTY, THIRTY
from dqforge.machines.modulation.zero_sequence import compared, extremes, highest_rests, load_turn
from dqforge.machines.names import ModulationName
from dqforge.machines.transforms import DOUBLES, Pair, Reals, Triple, clarke

# Those of the package's modulators that keep one phase at a rail at every instant.
DISCONTINUOUS: frozenset[ModulationName] = frozenset(
    name for name, modulator in MODULATORS.items() if modulator.rests
)

# Eight Gauss points integrate products of three sines over at most 60 degrees to rounding.
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)


def compared_at(
    name: ModulationName, voltage: FloatArray, current: FloatArray
) -> tuple[Triple[Reals], Triple[Reals], Pair[Reals] | None, Pair[Reals] | None]:
    """References and currents of the phases, and for GDPWM the references' vector and
    the turn of the load angle.

    Args:
        name: The modulator.
        voltage, current: Phase references in V and phase currents in A, shape (..., 3).
    """
    v, i = (Triple(*np.moveaxis(phases, -1, 0)) for phases in (voltage, current))
    if MODULATORS[name].compared != "load angle":
        return v, i, None, None
    vector = clarke(DOUBLES, v)
    return v, i, vector, load_turn(vector, clarke(DOUBLES, i), REACTIVE)


def resting_phase(
    name: ModulationName, voltage: FloatArray, current: FloatArray
) -> tuple[IndexArray, BoolArray]:
    """Index (...) of the phase that a discontinuous modulator clamps, and True (...)
    where to the positive rail.

    Of equal references the first is the highest and the last is the lowest, so that the two are
    never the same phase; where both might rest equally well it is the highest.

    Args:
        name: A modulator that rests a phase.
        voltage, current: Phase references in V and phase currents in A, shape (..., 3). GDPWM takes
            the load angle from the space vectors of both, DDT-GDPWM compares currents, the others
            look at the references alone.
    """
    v, i, vector, turn = compared_at(name, voltage, current)
    number = Triple(*np.arange(3))
    if MODULATORS[name].one_rail:
        (_, highest), (_, lowest) = extremes(DOUBLES, v, number)
        upper = np.full(v.a.shape, MODULATORS[name].kind == "highest")
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

    Args:
        name: The modulator.
        load_angle: Angle in rad by which the current lags the voltage, shape (...).
    """
    return MODULATORS[name].hand_over(load_angle)


def sector_rule(
    name: ModulationName, lag: FloatArray, parts: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Angles (..., n) of the voltage vector in its first sector, in rad, and their weights (...,
    n) of sum 1.

    `lag` (...) in rad is the angle by which the current lags the voltage. The sector, 0 to 60
    degrees, keeps the order V_a > V_b > V_c. It is split where a phase current is zero and where
    the resting phase changes, and each part gets its own Gauss rule: 24 angles. With modulators of
    one rail the next sector follows with the same 24.

    Args:
        name: The modulator.
        lag: Angle in rad by which the current lags the voltage, shape (...).
        parts: Equal parts of the sector that get a rule of their own besides, even for waveforms
            that change at its middle.
    """
    current_zero = np.mod(lag + THIRTY, SIXTY)
    change = hand_over(name, lag)
    even = [np.full_like(lag, SIXTY * k / parts) for k in range(1, parts)]
    edges = np.sort(
        np.stack(
            [np.zeros_like(lag), current_zero, change, *even, np.full_like(lag, SIXTY)], axis=-1
        )
    )
    half = 0.5 * np.diff(edges, axis=-1)[..., None]
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])[..., None]
    shape = (*lag.shape, (2 + parts) * _GAUSS_NODES.size)
    angle, weight = (
        (middle + half * _GAUSS_NODES).reshape(shape),
        (half * _GAUSS_WEIGHTS / SIXTY).reshape(shape),
    )
    if not MODULATORS[name].one_rail:
        return angle, weight
    return np.concatenate([angle, angle + SIXTY], axis=-1), np.concatenate(
        [weight, weight], axis=-1
    ) / 2.0


def switching_loss_factor(name: ModulationName, load_angle: ArrayLike) -> FloatArray:
    """Switching loss relative to continuous modulators at the same carrier frequency (Hava 1999,
    SLF).

    ::

        SLF(phi) = 1 - 1/2 sum over the intervals where a phase rests in a half wave of
            int |cos(x - phi)| dx

    for losses proportional to the current; x from the peak of the phase's reference. The intervals
    in degrees are -60 to 0 (DPWM0), -30 to 30 (DPWM1), 0 to 60 (DPWM2), -60 to -30 and 30 to 60
    (DPWM3), psi - 60 to psi (GDPWM), and -60 to 60 in every other half wave (DPWMMIN, DPWMMAX).
    DDT-GDPWM: see docs/methods/loss-budget.md.

    Args:
        name: The modulator; 1 for continuous ones.
        load_angle: Angle phi in rad by which the current lags the voltage, any shape.

    Returns:
        Of the shape of `load_angle`.
    """
    return MODULATORS[name].loss_factor(np.asarray(load_angle, dtype=np.float64))
