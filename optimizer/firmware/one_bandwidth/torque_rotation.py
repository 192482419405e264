"""Torque over q current as moteus models it, fitted to that of a saturating machine: proportional
up to a current, a logarithm from there on.

T = K i up to i_c, and K i_c + t log2(1 + s (i - i_c)) beyond (`fw/torque_model.h` of moteus); no d
current flows. The fit makes the largest error over 0..i_max as small as it can.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.own_values import FLOAT32_DIGITS, rounded

# Current in A from which moteus counts a machine as saturated when nothing else is set.
NEVER = 10000.0

# What the other two are when nothing is set; without meaning below `NEVER`.
NO_CURRENT_SCALE, NO_TORQUE_SCALE = 0.05, 14.7
_POINTS = 241
_LINEAR_ENOUGH = 1e-4  # Largest error over the largest torque below which nothing is fitted.


@dataclass(frozen=True, slots=True)
class TorqueRotation:
    """The model of moteus of one machine.

    ``cutoff`` in A, ``current_scale`` in 1/A, ``torque_scale`` in N m; ``error`` in N m is the
    largest over 0..i_max, ``straight`` that of the torque constant alone, ``largest`` the machine's
    torque at i_max.
    """

    cutoff: float
    current_scale: float
    torque_scale: float
    error: float
    straight: float
    largest: float

    def torque(self, constant: float, current: FloatArray) -> FloatArray:
        """Torque in N m of q currents in A from zero on, any shape.

        Args:
            constant: Torque per ampere in N m/A.
            current: In A.
        """
        beyond = np.maximum(current - self.cutoff, 0.0)
        bent = self.torque_scale * np.log2(1.0 + self.current_scale * beyond)
        return constant * np.minimum(current, self.cutoff) + bent


def torque_rotation(machine: Machine, constant: float, i_max: float) -> TorqueRotation:
    """Fit the model to a machine.

    Args:
        machine: The machine.
        constant: Torque per ampere in N m/A with which moteus computes.
        i_max: Largest current in A.
    """
    current = np.linspace(0.0, i_max, _POINTS)
    torque = machine.torque(np.zeros(_POINTS), current)
    straight = float(np.max(np.abs(constant * current - torque)))
    largest = float(torque[-1])
    unused = TorqueRotation(NEVER, NO_CURRENT_SCALE, NO_TORQUE_SCALE, straight, straight, largest)
    if straight <= _LINEAR_ENOUGH * abs(largest):
        return unused
    cutoff, scale = _best_shape(current, torque, constant)
    weight, error = _best_weight(current, torque, constant, np.array([cutoff]), np.array([scale]))
    cutoff, scale, torque_scale = (
        rounded(value, FLOAT32_DIGITS) for value in (cutoff, scale, weight[0])
    )
    found = TorqueRotation(cutoff, scale, torque_scale, float(error[0]), straight, largest)
    return found if found.torque_scale > 0.0 and found.error < straight else unused


def _best_shape(current: FloatArray, torque: FloatArray, constant: float) -> tuple[float, float]:
    """Cutoff and current scale with the least largest error: a grid, refined round its best."""
    i_max = float(current[-1])
    cutoffs = np.linspace(0.0, 0.98 * i_max, 41)
    scales = np.geomspace(1e-3, 1e3, 41) / i_max
    width, factor = cutoffs[1], scales[1] / scales[0]
    for _ in range(14):
        grid = np.meshgrid(cutoffs, scales, indexing="ij")
        flat = (grid[0].ravel(), grid[1].ravel())
        best = int(np.argmin(_best_weight(current, torque, constant, *flat)[1]))
        cutoff, scale = float(flat[0][best]), float(flat[1][best])
        cutoffs = np.clip(cutoff + width * np.linspace(-1.0, 1.0, 9), 0.0, 0.98 * i_max)
        scales = scale * factor ** np.linspace(-1.0, 1.0, 9)
        width, factor = 0.6 * width, factor**0.6
    return cutoff, scale


def _best_weight(
    current: FloatArray,
    torque: FloatArray,
    constant: float,
    cutoff: FloatArray,
    scale: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Torque scale of each pair with its largest error in N m, arrays of shape (n,).

    The error is convex in the torque scale: the least of it is found by sections.
    """
    beyond = np.maximum(current - cutoff[:, None], 0.0)
    shape = np.log2(1.0 + scale[:, None] * beyond)
    rest = torque - constant * np.minimum(current, cutoff[:, None])

    def error(weight: FloatArray) -> FloatArray:
        found: FloatArray = np.max(np.abs(weight[:, None] * shape - rest), axis=1)
        return found

    low = np.zeros(cutoff.size)
    high = 2.0 * np.max(np.abs(rest), axis=1) / np.max(shape, axis=1)
    for _ in range(48):
        left, right = low + (high - low) / 3.0, high - (high - low) / 3.0
        falls = error(left) > error(right)
        low, high = np.where(falls, left, low), np.where(falls, high, right)
    weight = 0.5 * (low + high)
    return weight, error(weight)
