"""Both current loops of a firmware together while the machine turns: what its decoupling, its delay
and its angle leave of the coupling of the axes.

With d + j q, omega the electrical speed, a the angle advance and T the period::

    l_d di_d/dt = -R i_d + omega l_q i_q + v_d,   l_q di_q/dt = -R i_q - omega l_d i_d + v_q
    v(t) = exp(j omega (a T - t)) v[k]         t since the sample k, from delay T to (delay + 1) T
    v[k] = PI(-y[k]) (+ omega (-l_q y_q, l_d y_d) with cross feedforward),  y the filtered currents

for references of zero; the magnets move no pole.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.sampled_structure import equivalent_gains, filter_share

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.optimizer.firmware.profile import CurrentLoops

_SPEEDS = 9


@dataclass(frozen=True, slots=True)
class TurningAxes:
    """The worst of the poles of both current loops together up to the largest speed.

    ``radius`` is their largest modulus per period, at the mechanical speed ``omega_m`` in rad/s;
    ``unstable_from`` the least of the speeds looked at that is unstable, None without one.
    """

    radius: float
    omega_m: float
    unstable_from: float | None


def _rotation(angle: float) -> FloatArray:
    return np.array(
        [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]], dtype=np.float64
    )


def _held(
    r_s: float, inductances: tuple[float, float], omega: float, time: float
) -> tuple[FloatArray, FloatArray]:
    """Currents after a time, of the currents before it and of a voltage that stands still."""
    from scipy.linalg import expm

    l_d, l_q = inductances
    flow = np.zeros((4, 4))
    flow[0, :3] = -r_s / l_d, omega * l_q / l_d, 1.0 / l_d
    flow[1] = -omega * l_d / l_q, -r_s / l_q, 0.0, 1.0 / l_q
    flow[2, 3], flow[3, 2] = omega, -omega
    found = np.asarray(expm(flow * time), dtype=np.float64)
    return found[:2, :2], found[:2, 2:]


def turning_matrix(
    r_s: float, inductances: tuple[float, float], loops: CurrentLoops, omega: float
) -> FloatArray:
    """Map of (i, y, I, v[k-1], v[k-2], ...), two numbers each, over one period.

    Args:
        r_s, inductances: Resistance in Ohm; l_d and l_q in H.
        loops: The structure with its gains; both axes have one period.
        omega: Electrical speed in rad/s.
    """
    t_s, whole = loops.d.t_s, math.floor(loops.delay + 1e-12)
    part, depth = max(loops.delay - whole, 0.0), whole + 1
    size, unit = 6 + 2 * depth, np.eye(2)
    gains = [equivalent_gains(pi) for pi in (loops.d, loops.q)]
    kp, step = np.diag([kp for kp, _ in gains]), np.diag([ki * t_s for _, ki in gains])
    share = np.diag([filter_share(pi.filter_time, t_s) for pi in (loops.d, loops.q)])
    feed = omega * np.array([[0.0, -inductances[1]], [inductances[0], 0.0]]) * loops.cross

    now = np.zeros((2, size))  # the filtered currents of this sample
    now[:, :2], now[:, 2:4] = share, unit - share
    voltage = (feed - kp - step) @ now
    voltage[:, 4:6] += unit
    past = [voltage, *(np.eye(size)[6 + 2 * n : 8 + 2 * n] for n in range(depth))]
    early, early_v = _held(r_s, inductances, omega, part * t_s)
    late, late_v = _held(r_s, inductances, omega, (1.0 - part) * t_s)
    lead = loops.angle_advance
    before = _rotation(omega * t_s * (lead - whole - 1.0)) @ past[whole + 1]
    after = _rotation(omega * t_s * (lead - loops.delay)) @ past[whole]

    matrix = np.zeros((size, size))
    matrix[:2, :2] = late @ early
    matrix[:2] += late @ early_v @ before + late_v @ after
    matrix[2:4] = now
    matrix[4:6] = -step @ now
    matrix[4:6, 4:6] += unit
    matrix[6:8] = voltage
    matrix[8:, 6:-2] = np.eye(size - 8)
    return matrix


def turning_axes(
    r_s: float,
    inductances: tuple[float, float],
    loops: CurrentLoops,
    pole_pairs: int,
    omega_m: float,
) -> TurningAxes:
    """The largest pole of both loops together from standstill to a mechanical speed in rad/s.

    Backwards is the mirror image.

    Args:
        r_s, inductances, loops: As in `turning_matrix`.
        pole_pairs: Number of pole pairs.
        omega_m: Largest mechanical speed in rad/s.
    """
    speeds = np.linspace(0.0, omega_m, _SPEEDS)
    radius = np.array(
        [
            np.max(
                np.abs(
                    np.linalg.eigvals(
                        turning_matrix(r_s, inductances, loops, pole_pairs * float(speed))
                    )
                )
            )
            for speed in speeds
        ]
    )
    worst, unstable = int(np.argmax(radius)), np.flatnonzero(radius >= 1.0)
    return TurningAxes(
        float(radius[worst]),
        float(speeds[worst]),
        float(speeds[unstable[0]]) if unstable.size else None,
    )
