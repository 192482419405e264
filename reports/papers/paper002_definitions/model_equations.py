"""Paper 002, chapter 4: the terms (4.10) to (4.18) of the model in dqy, as they hold and as they
are printed.

The thesis names nine blocks A to I; times omega_e and a current of dqy they are the voltages that
couple the axes (A to F) and those of the axis itself (G to I). They are the entries of

    omega_e [ (a_y'/a_y) D + N L (N^T)' ]      ' = d/dtheta,  D = N L N^T,  N = T_dqy T_dqx

as (E.13) to (E.49) derive it. They are judged by voltages of a machine in alpha, beta and 0,
carried into dqy by unit vectors of the back-EMF alone, without its angles.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.frame_transforms import frame_rates, to_frame
from dqforge.machines.phase_machines.frames import CLARKE
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import POWER_INVARIANT

BLOCKS = ("A", "B", "C", "D", "E", "F", "G", "H", "I")

# Axis of the voltage and axis of the current of each block: 0 dy, 1 qy, 2 0y.
PLACES = {
    "A": (0, 1),
    "B": (0, 2),
    "C": (1, 0),
    "D": (1, 2),
    "E": (2, 0),
    "F": (2, 1),
    "G": (0, 0),
    "H": (1, 1),
    "I": (2, 2),
}


@dataclass(frozen=True, slots=True, eq=False)
class ShapedMachine:
    """A machine without saliency at N angles.

    ``theta`` in rad, shape (N,); ``shape`` and ``slope``: F and its derivative by theta in 1/rad,
    shape (3, N); ``l_s``, ``m_s`` in H, ``r_s`` in Ohm, ``phi_m`` in Wb.
    """

    theta: FloatArray
    shape: FloatArray
    slope: FloatArray
    l_s: float
    m_s: float
    r_s: float
    phi_m: float


@dataclass(frozen=True, slots=True, eq=False)
class FrameQuantities:
    """What the equations of chapter 4 are written in, arrays of shape (N,).

    Sine and cosine of theta_y; ``turn`` 1 + theta_x', ``rate`` theta_y', ``growth`` a_y'/a_y, in
    1/rad; ``a_x`` and ``a_y``.
    """

    sine: FloatArray
    cosine: FloatArray
    turn: FloatArray
    rate: FloatArray
    growth: FloatArray
    a_x: FloatArray
    a_y: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Currents of dqy and their derivatives by time, power-invariant and divided by a_y, in A and
    A/s, shape (3, N); ``omega_e`` in rad/s.
    """

    currents: FloatArray
    slopes: FloatArray
    omega_e: float


def frame_quantities(machine: ShapedMachine) -> FrameQuantities:
    """Angles, rates and factors of dqy for a machine."""
    rates = frame_rates(machine.theta, machine.shape, machine.slope)
    _, size, zero = to_frame("dqx", machine.theta, machine.shape, machine.shape)
    whole = np.hypot(size, zero)
    return FrameQuantities(
        sine=-size / whole,
        cosine=zero / whole,
        turn=1.0 + rates.theta_x,
        rate=rates.theta_y,
        growth=rates.growth_y,
        a_x=POWER_INVARIANT / size,
        a_y=POWER_INVARIANT / whole,
    )


def model_blocks(frame: FrameQuantities, l_s: float, m_s: float) -> dict[str, FloatArray]:
    """Blocks A to I as they hold, in H, shape (N,) each."""
    s, c, rate, growth = frame.sine, frame.cosine, frame.rate, frame.growth
    mixed = 3.0 * m_s * s * c
    square = 3.0 * m_s * s * s
    along, across = l_s + 2.0 * m_s - square, l_s - m_s + square
    plane = (l_s - m_s) * frame.turn
    return {
        "A": s * plane,
        "B": -c * plane,
        "C": -s * plane,
        "D": growth * mixed + rate * along,
        "E": c * plane,
        "F": growth * mixed - rate * (l_s + 0.5 * m_s - 1.5 * m_s * (c * c - s * s)),
        "G": growth * (l_s - m_s),
        "H": growth * along - rate * mixed,
        "I": growth * across + rate * mixed,
    }


def printed_blocks(frame: FrameQuantities, l_s: float, m_s: float) -> dict[str, FloatArray]:
    """Blocks A, C and H as they are printed, in H, shape (N,) each; the others are printed right.

    G, printed without an inductance, is none.
    """
    s, c = frame.sine, frame.cosine
    wrong = s * (l_s + 2.0 * m_s) * frame.turn
    bracket = frame.growth * (l_s + 2.0 * m_s - 3.0 * m_s) * s * s
    return {"A": wrong, "C": -wrong, "H": bracket - frame.rate * 3.0 * m_s * s * c}


def block_voltages(
    machine: ShapedMachine, motion: Motion, blocks: dict[str, FloatArray]
) -> FloatArray:
    """Voltages of dqy in V, shape (3, N), with given blocks: (3.3) to (3.5), with the torque on qy
    alone.
    """
    frame = frame_quantities(machine)
    s, c, i, di = frame.sine, frame.cosine, motion.currents, motion.slopes
    mixed, square = 3.0 * machine.m_s * s * c, 3.0 * machine.m_s * s * s
    plane, zero = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
    v = machine.r_s * i
    v[0] += plane * di[0]
    v[1] += (zero - square) * di[1] + mixed * di[2]
    v[2] += mixed * di[1] + (plane + square) * di[2]
    for name, (axis, cause) in PLACES.items():
        v[axis] += motion.omega_e * blocks[name] * i[cause]
    v[1] += motion.omega_e * machine.phi_m * POWER_INVARIANT / frame.a_y**2
    return v


def _unit(vector: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Vectors of length 1 along given ones, shape (3, N), and their derivative."""
    length = np.sqrt(np.sum(vector**2, axis=0))
    growth = np.sum(vector * slope, axis=0) / length
    return vector / length, (slope - vector * growth / length) / length


def _axes(machine: ShapedMachine) -> tuple[FloatArray, FloatArray]:
    """N / a_y and its derivative by theta, shape (3, 3, N): unit vectors of F, at right angles to
    it in the plane, and to both, times the length of F.
    """
    f, df = CLARKE @ machine.shape, CLARKE @ machine.slope
    nothing = np.zeros_like(f[0])
    rows = (
        (np.stack([f[1], -f[0], nothing]), np.stack([df[1], -df[0], nothing])),
        (f, df),
        (
            np.stack([f[0] * f[2], f[1] * f[2], -(f[0] ** 2) - f[1] ** 2]),
            np.stack(
                [
                    df[0] * f[2] + f[0] * df[2],
                    df[1] * f[2] + f[1] * df[2],
                    -2.0 * (f[0] * df[0] + f[1] * df[1]),
                ]
            ),
        ),
    )
    length = np.sqrt(np.sum(f**2, axis=0)) / POWER_INVARIANT
    growth = np.sum(f * df, axis=0) / (length * POWER_INVARIANT**2)
    units = [_unit(vector, slope) for vector, slope in rows]
    into = np.stack([unit * length for unit, _ in units])
    return into, np.stack([slope * length + unit * growth for unit, slope in units])


def stationary_voltages(
    machine: ShapedMachine, currents: FloatArray, slopes: FloatArray, omega_e: float
) -> tuple[FloatArray, Motion]:
    """Voltages that currents of alpha, beta and 0 need, in V and in dqy, shape (3, N), and the
    motion in dqy that these currents are.

    Args:
        machine: The machine.
        currents, slopes: Power-invariant, in A and A/s, shape (3, N).
        omega_e: In rad/s.
    """
    plane, zero = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
    inductance = np.array([[plane], [plane], [zero]])
    emf = omega_e * machine.phi_m * (CLARKE @ machine.shape)
    v = machine.r_s * currents + inductance * slopes + emf
    into, turn = _axes(machine)

    def seen(matrix: FloatArray, vector: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("kmn,mn->kn", matrix, vector))

    moving = seen(into, slopes) + omega_e * seen(turn, currents)
    return seen(into, v), Motion(seen(into, currents), moving, omega_e)
