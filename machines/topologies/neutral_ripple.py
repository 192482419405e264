"""The current that the pulses themselves drive through the neutral.

::

    i_n,rms = 3 (V_dc T_s / L_0) sqrt(mean w' M w),   M = < g_j g_k > of the legs' harmonic fluxes
    w = (1, 1, 1, -3) / 3  four legs,   (1, 1, 1) / 3  split link,   (1, 1, 1, -1, -1, -1) / 3  six

w is what each leg adds to the mean of the phase voltages, L_0 = L_s + 2 M_s + 3 L_n that of the
phases with a choke in the neutral. Resistance and motion of the rotor within a period are left out.
On a split link it is sqrt(3)/8 V_dc T_s / L_0 where the voltages vanish, as large as it gets.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.ripple import flux_moments
from dqforge.machines.names import Topology
from dqforge.machines.topologies.duties import duty_cycles
from dqforge.machines.topologies.topology import TOPOLOGIES, leg_signs


def zero_weights(topology: Topology) -> FloatArray:
    """What each leg adds to the zero sequence of the phases, shape (legs,); all 0 where none acts.

    Args:
        topology: The topology.
    """
    weights = np.mean(leg_signs(topology), axis=0)
    return weights if TOPOLOGIES[topology].neutral else np.zeros_like(weights)


def neutral_ripple_squares(topology: Topology, duty: FloatArray) -> FloatArray:
    """Mean square of the harmonic flux of the zero sequence in each carrier period, in
    (V_dc T_s)^2, shape (...).

    Args:
        topology: The topology.
        duty: Duty cycles of its legs, shape (..., legs).
    """
    weights = zero_weights(topology)
    squares = np.einsum("j,...jk,k->...", weights, flux_moments(duty), weights)
    return np.asarray(np.maximum(squares, 0.0))


def neutral_ripple(
    topology: Topology,
    voltages: FloatArray,
    *,
    v_dc: float,
    t_s: float,
    l_0: float,
    v_m: ArrayLike | None = None,
) -> FloatArray:
    """Root mean square of the neutral current of the pulses over an electrical period in A, shape
    (...).

    Args:
        topology: The topology; without a neutral there is none.
        voltages: Phase voltages in V at evenly spaced angles, shape (..., 3, N), within the region.
        v_dc, t_s, l_0: Link in V, carrier period in s, zero-sequence inductance in H.
        v_m: Midpoint of a split link in V, shape (N,) or a number; half the link where it is not
            given.
    """
    duty = duty_cycles(topology, np.swapaxes(voltages, -1, -2), v_dc, v_m=v_m)
    squares = np.mean(neutral_ripple_squares(topology, duty), axis=-1)
    return np.asarray(3.0 * v_dc * t_s / l_0 * np.sqrt(squares))
