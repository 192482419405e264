"""Both current loops together while the machine turns: what the decoupling
leaves over couples them.

Each axis alone is judged as if the decoupling were perfect. It is not: its inductances are those of
the design, it works with currents one period old, and the voltage stands still in the stator while
the rotor turns on. With d + j q:

    l_d di_d/dt = -R i_d + omega l_q i_q + g v_d,
        l_q di_q/dt = -R i_q - omega l_d i_d + g v_q (- omega psi)
    v(k T + s)  = exp(j omega (a - T - s)) v[k-1],   0 <= s < T
                a: angle advance of the emitted control, in time
    v[k]        = -(kp + ki T) i[k] + I[k-1] + (-omega l_q' i_q[k], omega l_d' i_d[k]),
                I[k] = I[k-1] - ki T i[k]

for references of zero; magnets and references are inputs and move no pole. The poles are the
eigenvalues of this map of (i, v, I), six states.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass


@dataclass(frozen=True, slots=True)
class TurningMachines:
    """M windings that turn, arrays of shape (M,).

    ``r_s`` in Ohm, ``l_d`` and ``l_q`` in H, ``gain`` of the voltage,
    ``omega_e`` electrical speed in rad/s.
    """

    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    gain: FloatArray
    omega_e: FloatArray


@dataclass(frozen=True, slots=True)
class CurrentControl:
    """What the emitted current control works with.

    ``kp`` in V/A and ``ki_ts`` in V/A are those of (d, q), ``l_d`` and ``l_q`` in H the
    decoupling's, ``advance`` in s the time by which its voltage is turned ahead, ``t_s`` in s the
    sampling period.
    """

    kp: tuple[float, float]
    ki_ts: tuple[float, float]
    l_d: float
    l_q: float
    advance: float
    t_s: float


def closed_matrices(machines: TurningMachines, control: CurrentControl) -> FloatArray:
    """Maps of (i_d, i_q, v_d, v_q, I_d, I_q) over one sampling period, shape (M, 6, 6).

    Args:
        machines: M machines at constant electrical speeds.
        control: Gains, decoupling and sampling period.
    """
    from scipy.linalg import expm

    count, omega = len(machines.omega_e), machines.omega_e
    flow = np.zeros((count, 4, 4))
    flow[:, 0, 0], flow[:, 0, 1] = -machines.r_s / machines.l_d, omega * machines.l_q / machines.l_d
    flow[:, 1, 0], flow[:, 1, 1] = (
        -omega * machines.l_d / machines.l_q,
        -machines.r_s / machines.l_q,
    )
    flow[:, 0, 2], flow[:, 1, 3] = machines.gain / machines.l_d, machines.gain / machines.l_q
    flow[:, 2, 3], flow[:, 3, 2] = omega, -omega  # the voltage stands still while the rotor turns
    held = expm(flow * control.t_s)
    turn = omega * (control.advance - control.t_s)
    rotation = np.moveaxis(
        np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]), -1, 0
    )
    matrix = np.zeros((count, 6, 6))
    matrix[:, :2, :2], matrix[:, :2, 2:4] = held[:, :2, :2], held[:, :2, 2:] @ rotation
    proportional = np.array(control.kp) + np.array(control.ki_ts)
    matrix[:, 2, 0], matrix[:, 3, 1] = -proportional[0], -proportional[1]
    matrix[:, 2, 1], matrix[:, 3, 0] = -omega * control.l_q, omega * control.l_d
    matrix[:, 2, 4] = matrix[:, 3, 5] = matrix[:, 4, 4] = matrix[:, 5, 5] = 1.0
    matrix[:, 4, 0], matrix[:, 5, 1] = -control.ki_ts[0], -control.ki_ts[1]
    return matrix


def largest_pole(machines: TurningMachines, control: CurrentControl) -> FloatArray:
    """Largest modulus of the poles of both loops together, shape (M,); stable below 1.

    Args:
        machines: M machines at constant electrical speeds.
        control: Gains, decoupling and sampling period.
    """
    poles = np.linalg.eigvals(closed_matrices(machines, control))
    return np.asarray(np.max(np.abs(poles), axis=1), dtype=np.float64)
