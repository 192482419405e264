"""What a firmware without d current costs: torque at the current limit, copper loss at a torque."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dqforge.machines.dq_machines.synchronous import Machine, copper_loss

_ANGLES = 1801


@dataclass(frozen=True, slots=True)
class IdZeroCost:
    """No d current against the best angle at each current.

    Parameters
    ----------
    torque, best_torque:
        In N m at the current limit, without d current and with the best angle.
    loss, best_loss:
        Copper loss in W at ``torque`` of both.
    """

    torque: float
    best_torque: float
    loss: float
    best_loss: float

    @property
    def lost_torque(self) -> float:
        """Share of the best torque that is missing."""
        return 1.0 - self.torque / self.best_torque

    @property
    def more_loss(self) -> float:
        """Share by which the copper loss is larger."""
        return self.loss / self.best_loss - 1.0


def id_zero_cost(machine: Machine, i_max: float) -> IdZeroCost | None:
    """Compare at the current limit; None of a machine that makes no torque without d current.

    Parameters
    ----------
    machine:
        The machine, saturated or not.
    i_max:
        Current limit in A (peak).
    """
    torque = float(machine.torque(np.zeros(1), np.full(1, i_max))[0])
    if not torque > 0.0:
        return None
    current = _least_current(machine, torque, i_max)
    r_s = machine.r_s
    losses = copper_loss(r_s, np.zeros(2), np.array([i_max, current]))
    return IdZeroCost(torque, _best_torque(machine, i_max), float(losses[0]), float(losses[1]))


def _best_torque(machine: Machine, current: float) -> float:
    """Largest torque in N m on the circle of a current in A, where the machine has data."""
    angle = np.linspace(0.0, math.pi, _ANGLES)
    i_d, i_q = current * np.cos(angle), current * np.sin(angle)
    torque = np.where(machine.known(i_d, i_q), machine.torque(i_d, i_q), -math.inf)
    alone = float(machine.torque(np.zeros(1), np.full(1, current))[0])
    return max(float(np.max(torque)), alone)


def _least_current(machine: Machine, torque: float, i_max: float) -> float:
    """Least current in A whose best torque is a given one."""
    from scipy.optimize import brentq

    def excess(current: float) -> float:
        return _best_torque(machine, current) - torque

    if excess(i_max) <= 0.0:
        return i_max
    return float(brentq(excess, 1e-6 * i_max, i_max, rtol=1e-9))
