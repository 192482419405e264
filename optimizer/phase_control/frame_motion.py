"""Where the frames of a phase machine point, sample by sample, as the firmware finds them from the
nodes of the back-EMF.

Vectors here are power-invariant and seen from the rotor: d, q and 0 of the angle theta. A frame is
the three unit vectors of its axes, the factor a by which paper 002 divides quantities in it, and
how both change with the angle: n_j' = Omega x n_j, a' = growth a.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import CurrentFrame
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.phase_controller import PhaseShape

TO_AXES = clarke_matrix(power_invariant=True)


@dataclass(frozen=True, slots=True, eq=False)
class FrameMotion:
    """A frame at K angles.

    Args:
        axes: Unit vectors of the frame's axes in rows, in d, q and 0 of the rotor; shape (K, 3, 3).
        factor: What quantities on each axis are divided by, shape (K, 3), known up to a constant;
            the zero sequence of dqx is left as it is.
        growth: Its relative derivative by the angle in 1/rad, shape (K, 3).
        turning: Omega, by which the axes turn in the stator per radian, in d, q and 0; shape (K,
            3).
    """

    axes: FloatArray
    factor: FloatArray
    growth: FloatArray
    turning: FloatArray


def shape_at(shape: PhaseShape, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Back-EMF over speed between its nodes and its slope there, of the phases.

    Args:
        shape: The nodes, joined by straight lines.
        theta: Electrical angles in rad, shape (K,), any; at a node the line behind it counts.

    Returns:
        Values in Wb and slopes in Wb/rad, each of shape (3, K)
    """
    rows, count = shape.flux.shape
    step = 2.0 * np.pi * shape.turns / count
    phase = np.arange(3)[:, np.newaxis]
    lag = phase * (2.0 * np.pi / 3.0) if rows == 1 else 0.0 * phase
    place = np.mod((theta - lag) / step, count)
    node = np.minimum(place.astype(np.int64), count - 1)
    row = 0 * phase if rows == 1 else phase
    here, there = shape.flux[row, node], shape.flux[row, (node + 1) % count]
    return here + (place - node) * (there - here), (there - here) / step


def frame_motion(frame: CurrentFrame, shape: PhaseShape, theta: FloatArray) -> FrameMotion:
    """The frame of a controller at angles; ``dq`` and ``table`` turn with the rotor.

    Args:
        frame: Where the integrators live.
        shape: Back-EMF over the angle.
        theta: Electrical angles in rad, shape (K,).
    """
    count = theta.size
    upright = np.zeros((count, 3))
    upright[:, 2] = 1.0
    if frame in ("dq", "table"):
        same = np.tile(np.eye(3), (count, 1, 1))
        return FrameMotion(same, np.ones((count, 3)), np.zeros((count, 3)), upright)
    flux, slope = (TO_AXES @ part for part in shape_at(shape, theta))
    size = np.hypot(flux[0], flux[1])
    size_rate = (flux[0] * slope[0] + flux[1] * slope[1]) / size
    turn = (flux[0] * slope[1] - flux[1] * slope[0]) / size**2
    cosine, sine = np.cos(theta), np.sin(theta)
    along = np.stack(  # the direction of the shape in the plane, seen from the rotor
        [
            (flux[0] * cosine + flux[1] * sine) / size,
            (flux[1] * cosine - flux[0] * sine) / size,
            np.zeros(count),
        ],
        axis=1,
    )
    across = np.stack([-along[:, 1], along[:, 0], np.zeros(count)], axis=1)
    turning = turn[:, np.newaxis] * upright
    if frame == "dqx":
        scaled = np.array([1.0, 1.0, 0.0])
        return FrameMotion(
            np.stack([across, along, upright], axis=1),
            (1.0 / size)[:, np.newaxis] ** scaled,
            (-size_rate / size)[:, np.newaxis] * scaled,
            turning,
        )
    whole = np.hypot(size, flux[2])
    lift = (size * slope[2] - flux[2] * size_rate) / whole**2
    q = (size[:, np.newaxis] * along + flux[2][:, np.newaxis] * upright) / whole[:, np.newaxis]
    return FrameMotion(
        np.stack([across, q, np.cross(across, q)], axis=1),
        np.tile((1.0 / whole)[:, np.newaxis], 3),
        np.tile((-(size * size_rate + flux[2] * slope[2]) / whole**2)[:, np.newaxis], 3),
        turning - lift[:, np.newaxis] * across,
    )
