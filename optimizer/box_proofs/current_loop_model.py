"""Both current loops together in four parameters instead of six, and what encloses them.

In flux linkage over voltage gain and sampling period, phi = psi/(g t_s), the loop of a drive with
R, L_d, L_q, voltage gain g and electrical speed omega depends on

    b_d = g L_d'/L_d,   b_q = g L_q'/L_q,   s = R/g in Ohm,   x = omega t_s

alone (L' in the control's decoupling). Per sample, with rho_a = t_s/L_a' in 1/Ohm,
p_a = kp_a t_s/L_a' and q_a = ki_a t_s^2/L_a':

    F = [[-s rho_d b_d, x], [-x, -s rho_q b_q]],   W = x [[0, 1], [-1, 0]],   Phi = exp(F)
    Gam = integral of exp(F (1-u)) exp(W (u - 1/2)) over 0 <= u <= 1     (advance of 1.5 t_s)
    phi+ = Phi phi + Gam v;   v+ = K phi + I;   I+ = I - diag(q_d b_d, q_q b_q) phi
    K = [[-(p_d+q_d) b_d, -x b_q], [x b_d, -(p_q+q_q) b_q]]

Magnets and references move no pole, and the other sense of rotation is the same loop seen from the
other side, so that x >= 0 is enough. What the compensation of the dead time gets wrong acts as a
resistance that goes with the voltage gain, c g: it widens s by c.

The voltage gain is in three of the parameters: not every cell of them holds a drive.
"""

from __future__ import annotations

import itertools

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.cell_queue import Cell
from dqforge.optimizer.box_proofs.contraction import Remainder

# Relative width by which cells are shrunk too little, so that rounding loses no drive.
_OUTWARD = 1e-12
_TERMS = 18  # Terms of the exponential series, enough for norms up to 1.


@dataclass(frozen=True, slots=True)
class CurrentLoopBox:
    """All that the proof is about: the control, and the drives that it must serve.

    Args:
        t_s: Sampling period in s; the voltage is turned ahead by 1.5 of it.
        kp, ki_ts: Gains of (d, q), both in V/A.
        decoupling: Inductances (d, q) in H of the control's decoupling.
        r_s: Least and largest resistance in Ohm, not negative.
        dead_time: Least and largest resistance in Ohm that the rest of the dead time adds at a
            voltage gain of 1; it goes with the gain.
        l_d, l_q: Least and largest inductance in H.
        gain: Least and largest gain of the voltage.
        omega_e: Largest electrical speed in rad/s, in either sense.
    """

    t_s: float
    kp: tuple[float, float]
    ki_ts: tuple[float, float]
    decoupling: tuple[float, float]
    r_s: tuple[float, float]
    dead_time: tuple[float, float]
    l_d: tuple[float, float]
    l_q: tuple[float, float]
    gain: tuple[float, float]
    omega_e: float


@dataclass(frozen=True, slots=True)
class BoxDrive:
    """One drive of a box at a speed: Ohm, H, the gain of the voltage, and rad/s.

    ``r_s`` holds what the dead time adds.
    """

    r_s: float
    l_d: float
    l_q: float
    gain: float
    omega_e: float


def root_cell(box: CurrentLoopBox) -> Cell:
    """The smallest cell that holds all drives of a box."""
    (g_low, g_high), (r_low, r_high) = box.gain, box.r_s
    low = [g_low * box.decoupling[0] / box.l_d[1], g_low * box.decoupling[1] / box.l_q[1]]
    high = [g_high * box.decoupling[0] / box.l_d[0], g_high * box.decoupling[1] / box.l_q[0]]
    low += [r_low / g_high + box.dead_time[0], 0.0]
    high += [r_high / g_low + box.dead_time[1], box.omega_e * box.t_s]
    return Cell(np.array(low), np.array(high))


def gain_interval(box: CurrentLoopBox, cell: Cell) -> tuple[float, float]:
    """Voltage gains with which drives may lie in a cell; crossed where none can."""
    low, high = box.gain
    for axis, inductance in ((0, box.l_d), (1, box.l_q)):
        reference = box.decoupling[axis]
        low = max(low, cell.low[axis] * inductance[0] / reference)
        high = min(high, cell.high[axis] * inductance[1] / reference)
    most, least = cell.high[2] - box.dead_time[0], cell.low[2] - box.dead_time[1]
    if most <= 0.0:
        return (low, high) if box.r_s[0] == 0.0 and most == 0.0 else (1.0, 0.0)
    low = max(low, box.r_s[0] / most)
    high = min(high, box.r_s[1] / least) if least > 0.0 else high
    return float(low), float(high)


def shrunk(box: CurrentLoopBox, cell: Cell) -> Cell | None:
    """The part of a cell that holds drives, a hair too large; None where there are none."""
    low, high = gain_interval(box, cell)
    if low > high * (1.0 + _OUTWARD):
        return None
    low, high = low * (1.0 - _OUTWARD), high * (1.0 + _OUTWARD)
    ends = root_cell(
        CurrentLoopBox(
            box.t_s, box.kp, box.ki_ts, box.decoupling, box.r_s, box.dead_time,
            box.l_d, box.l_q, (low, high), box.omega_e,
        )
    )  # fmt: skip
    below, above = np.maximum(cell.low, ends.low), np.minimum(cell.high, ends.high)
    return Cell(below, np.maximum(below, above))


def drive_at(box: CurrentLoopBox, point: FloatArray) -> BoxDrive | None:
    """A drive of the box with given parameters, None where there is none.

    Args:
        box: The drives.
        point: b_d, b_q, s in Ohm and x.
    """
    low, high = gain_interval(box, Cell(point, point))
    if low > high * (1.0 + 1e-9):
        return None
    gain = float(np.clip(0.5 * (low + high), *box.gain))
    l_d = float(np.clip(gain * box.decoupling[0] / point[0], *box.l_d))
    l_q = float(np.clip(gain * box.decoupling[1] / point[1], *box.l_q))
    least, most = (r + c * gain for r, c in zip(box.r_s, box.dead_time, strict=True))
    return BoxDrive(
        float(np.clip(point[2] * gain, least, most)), l_d, l_q, gain, float(point[3]) / box.t_s
    )


def parameters_of(box: CurrentLoopBox, drive: BoxDrive) -> FloatArray:
    """b_d, b_q, s in Ohm and x of a drive, shape (4,)."""
    g = drive.gain
    return np.array(
        [
            g * box.decoupling[0] / drive.l_d,
            g * box.decoupling[1] / drive.l_q,
            drive.r_s / g,
            drive.omega_e * box.t_s,
        ]
    )


def loop_matrices(box: CurrentLoopBox, points: FloatArray) -> FloatArray:
    """Closed loops of (phi_d, phi_q, v_d, v_q, I_d, I_q), shape (N, 6, 6).

    Args:
        box: The control.
        points: b_d, b_q, s in Ohm and x, shape (N, 4).
    """
    b_d, b_q, s, x = np.asarray(points, dtype=np.float64).T
    scale = box.t_s / np.array(box.decoupling)
    q_d, q_q = np.array(box.ki_ts) * scale
    both_d, both_q = (np.array(box.kp) + np.array(box.ki_ts)) * scale
    flow = np.zeros((len(x), 4, 4))
    flow[:, 0, 0], flow[:, 1, 1] = -s * scale[0] * b_d, -s * scale[1] * b_q
    flow[:, 0, 1] = flow[:, 2, 3] = x
    flow[:, 1, 0] = flow[:, 3, 2] = -x
    flow[:, 0, 2] = flow[:, 1, 3] = 1.0
    held = _exponential(flow)
    cosine, sine = np.cos(0.5 * x), np.sin(0.5 * x)
    turned = held[:, :2, 2:]
    matrix = np.zeros((len(x), 6, 6))
    matrix[:, :2, :2] = held[:, :2, :2]
    matrix[:, :2, 2] = turned[:, :, 0] * cosine[:, None] + turned[:, :, 1] * sine[:, None]
    matrix[:, :2, 3] = turned[:, :, 1] * cosine[:, None] - turned[:, :, 0] * sine[:, None]
    matrix[:, 2, 0], matrix[:, 3, 1] = -both_d * b_d, -both_q * b_q
    matrix[:, 2, 1], matrix[:, 3, 0] = -x * b_q, x * b_d
    matrix[:, 2, 4] = matrix[:, 3, 5] = matrix[:, 4, 4] = matrix[:, 5, 5] = 1.0
    matrix[:, 4, 0], matrix[:, 5, 1] = -q_d * b_d, -q_q * b_q
    return matrix


def _exponential(flow: FloatArray) -> FloatArray:
    """Exponentials of matrices, shape (N, n, n), by their series, halved until it converges."""
    largest = float(np.abs(flow).sum(axis=2).max())
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300)))))
    small = flow / 2.0**halvings
    unit = np.eye(flow.shape[1])
    found = unit + small / _TERMS
    for order in range(_TERMS - 1, 0, -1):
        found = unit + small @ found / order
    for _ in range(halvings):
        found = found @ found
    return np.asarray(found, dtype=np.float64)


def corner_points(cell: Cell) -> FloatArray:
    """Corners of a cell, each once, shape (V, D); a parameter that does not vary has one end."""
    ends = [
        (low,) if low == high else (low, high)
        for low, high in zip(cell.low, cell.high, strict=True)
    ]
    return np.array(list(itertools.product(*ends)))


def slopes(box: CurrentLoopBox, cell: Cell) -> FloatArray:
    """Largest size of the derivative of F with each parameter, in the 2-norm, shape (4,)."""
    rho_d, rho_q = box.t_s / box.decoupling[0], box.t_s / box.decoupling[1]
    s = max(abs(cell.low[2]), abs(cell.high[2]))
    return np.array([s * rho_d, s * rho_q, max(rho_d * cell.high[0], rho_q * cell.high[1]), 1.0])


def remainder(box: CurrentLoopBox, cell: Cell) -> Remainder:
    """What the corners of a cell leave out of Phi and Gam.

    Multilinear interpolation errs by at most the sum of w^2/8 times the second derivative in each
    parameter alone; exp(F u) does not grow while no resistance is negative, and by exp(r) where
    one is.
    """
    largest = slopes(box, cell)
    steps = cell.width * largest
    growth = np.exp(max(0.0, -cell.low[2]) * largest[2])
    e_phi = float(growth * np.sum(steps**2) / 8.0)
    e_gam = float(growth * (np.sum(steps[:3] ** 2) / 24.0 + steps[3] ** 2 / 12.0))
    return Remainder((0, 1), (((0, 1), e_phi), ((2, 3), e_gam)))


def largest_moduli(matrices: FloatArray) -> FloatArray:
    """Largest modulus of the eigenvalues of each matrix, shape (N,)."""
    return np.asarray(np.max(np.abs(np.linalg.eigvals(matrices)), axis=1), dtype=np.float64)
