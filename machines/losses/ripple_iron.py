"""Iron loss that the switching of the bridge makes in the machine.

The eddy-current term of the iron loss goes with the square of the rate at which the flux linkage
changes, and that is the voltage: k_c omega_e^2 |psi|^2 = k_c |d psi/dt|^2. What the bridge switches
beside the fundamental therefore adds k_c times the mean square of the harmonic voltage, and no
inductance comes into it. Of a bridge with centred pulses an active vector of 2/3 v_dc stands for
the share u_max - u_min of the carrier period, whatever the zero sequence:

    < |v|^2 > = 4/9 v_dc^2 < u_max - u_min >,   < u_max - u_min > = 3 sqrt 3 / pi V / v_dc

Sources: G. Bertotti, "General properties of power losses in soft ferromagnetic materials", IEEE
Transactions on Magnetics 24(1), 1988, doi:10.1109/20.43994 (classical term); A. Boglietti, A.
Cavagnino, M. Lazzari, M. Pastorelli, "Predicting iron losses in soft magnetic materials with
arbitrary voltage supply: an engineering approach", IEEE Transactions on Magnetics 39(2), 2003
(eddy-current loss by the square of the r.m.s. voltage; both quoted without the papers at hand).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray

# Where the series of the skin effect takes the place of its formula, whose terms cancel there.
_THIN = 0.3


_THICK = 50.0


def harmonic_voltage_square(amplitude: ArrayLike, v_dc: FloatArray | float) -> FloatArray:
    """Mean square of the harmonic voltage vector in V^2, shape (...): 4/(sqrt 3 pi) V v_dc - V^2.

    Args:
        amplitude: Fundamental phase voltage V in V (peak), any shape (...), within the linear
            range; the vector is amplitude-invariant.
        v_dc: DC-link voltage in V, a number or of a shape that fits.
    """
    volts = np.asarray(amplitude, dtype=np.float64)
    return np.asarray(
        np.maximum(4.0 / (math.sqrt(3.0) * math.pi) * volts * v_dc - volts * volts, 0.0)
    )


def sheet_factor(frequency: ArrayLike, corner: float) -> FloatArray:
    """Eddy-current loss of a sheet over that without skin effect, at frequencies
    in Hz of any shape (...).

    ::

        F = 3/x (sinh x - sin x) / (cosh x - cos x),   x = sqrt(f / corner)

    Args:
        frequency: In Hz, not negative.
        corner: Frequency in Hz at which the skin depth equals the thickness d of the sheet: rho /
            (pi mu d^2), some 1 kHz for sheets of 0.35 mm.
    """
    x = np.sqrt(np.asarray(frequency, dtype=np.float64) / corner)
    between = np.clip(x, _THIN, _THICK)
    exact = (
        3.0 / between * (np.sinh(between) - np.sin(between)) / (np.cosh(between) - np.cos(between))
    )
    return np.asarray(
        np.where(
            x < _THIN, 1.0 - x**4 / 630.0, np.where(x > _THICK, 3.0 / np.maximum(x, 1.0), exact)
        )
    )


def ripple_iron_loss(
    eddy: float,
    amplitude: ArrayLike,
    v_dc: FloatArray | float,
    f_sw: ArrayLike,
    corner: float | None = None,
) -> FloatArray:
    """Iron loss in W by the switching, shape (...): k_c < |v_h|^2 > F(f_sw).

    Args:
        eddy: k_c in W s^2/(rad^2 Wb^2), as in `MachineLoss`.
        amplitude, v_dc: Fundamental phase voltage in V (peak) and DC-link voltage in V.
        f_sw: Carrier frequency in Hz, broadcastable with the amplitude; it matters by the skin
            effect alone.
        corner: As in `sheet_factor`; None leaves the skin effect out, which overestimates at high
            carrier frequencies.
    """
    loss = eddy * harmonic_voltage_square(amplitude, v_dc)
    return np.asarray(
        loss * (np.ones(np.shape(f_sw)) if corner is None else sheet_factor(f_sw, corner))
    )
