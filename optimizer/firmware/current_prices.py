"""What currents by another rule cost against those of most torque per ampere of the machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.dq_machines.synchronous import Machine

# Currents (i_d, i_q) in A for amplitudes in A, shape (N,).
CurrentRule = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
_AMPLITUDES = 60
_ANGLES = 721


@dataclass(frozen=True, slots=True)
class CurrentPrice:
    """What a rule costs at the current limit.

    Args:
        torque: Share of the torque that is lost with the same current.
        copper_loss: Share of copper loss more than the same torque needs.
    """

    torque: float
    copper_loss: float


def price_of(machine: Machine, i_max: float, rule: CurrentRule) -> CurrentPrice:
    """Price of a rule on a machine, which may saturate, at its current limit.

    Args:
        machine: The machine.
        i_max: Current limit in A (peak).
        rule: The currents for an amplitude.
    """
    amplitudes = np.linspace(0.0, i_max, _AMPLITUDES + 1)[1:]
    most = _most_torque(machine, amplitudes)
    i_d, i_q = rule(amplitudes[-1:])
    made = float(machine.torque(i_d, i_q)[0])
    if made >= most[-1]:
        return CurrentPrice(0.0, 0.0)
    needed = float(np.interp(made, most, amplitudes))
    return CurrentPrice(1.0 - made / float(most[-1]), (i_max / needed) ** 2 - 1.0)


def linear_rule(psi_pm: float, saliency: float) -> CurrentRule:
    """The closed form for linear machines: i_d = (psi - sqrt(psi^2 + 8 (dL i)^2))/(4 dL).

    Args:
        psi_pm: Flux linkage of the magnets in Wb.
        saliency: dL = L_q - L_d in H; with 0 all current is q current.
    """

    def currents(amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        if saliency == 0.0:
            return np.zeros_like(amplitude), amplitude
        root = np.sqrt(psi_pm * psi_pm + 8.0 * (saliency * amplitude) ** 2)
        i_d = (psi_pm - root) / (4.0 * saliency)
        return i_d, np.sqrt(np.maximum(amplitude**2 - i_d**2, 0.0))

    return currents


def _most_torque(machine: Machine, amplitudes: FloatArray) -> FloatArray:
    """Largest torque in N m of each amplitude in A, shape (N,)."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _ANGLES)
    i_d = amplitudes[:, np.newaxis] * np.sin(angle)
    i_q = amplitudes[:, np.newaxis] * np.cos(angle)
    torque = np.where(machine.known(i_d, i_q), machine.torque(i_d, i_q), -np.inf)
    return np.asarray(np.max(torque, axis=1), dtype=np.float64)
