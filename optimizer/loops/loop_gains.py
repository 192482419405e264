"""The gains of one loop with the evidence for them, and their per-unit numbers.

Gains are physical (current loops V/A and V/(A s), speed loop N m s/rad and N m/rad); `per_unit` and
`dqforge.optimizer.loops.integer_gains.to_q` turn them into the numbers of a firmware.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.settings import PerUnitBases
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.observed_margins import ObservedLoop
from dqforge.optimizer.loops.plants import DisturbanceResponse, PiLoop, SpeedLoop
from dqforge.optimizer.sampled_systems import LoopMargins

ComplexArray = NDArray[np.complex128]


LoopName = Literal["i_d", "i_q", "i_0", "speed"]


@dataclass(frozen=True, slots=True)
class LoopGains:
    """PI gains of one loop with the evidence for them.

    Args:
        loop: ``i_d``, ``i_q``, ``i_0`` (zero sequence) or ``speed``.
        method: The tuning method, as in the settings.
        kp, ki: Gains of the parallel form, V/A and V/(A s), or N m s/rad and N m/rad.
        t_s: Sampling period of this controller in s.
        poles: All closed-loop poles in the z plane of ``t_s``, largest modulus first, shape (n,).
        margins: Crossovers and margins of the sampled loop.
        disturbance: Answer to a unit step of the disturbance: 1 V at the winding, or 1 N m of load
            torque.
        model: The sampled loop that poles and margins are those of; of a speed loop on an encoder
            with the drive between its samples.
        inductance: Inductance of the winding in H that a current loop is meant for; None for the
            speed loop.
        observed: Of a speed loop that runs on an observer what that makes of it; poles and margins
            are then those with its lag, at the worst speed. None for all others.
    """

    loop: LoopName
    method: str
    kp: float
    ki: float
    t_s: float
    poles: ComplexArray
    margins: LoopMargins
    disturbance: DisturbanceResponse
    model: PiLoop | SpeedLoop
    inductance: float | None = None
    observed: ObservedLoop | None = None

    @property
    def ki_ts(self) -> float:
        """Integral gain per sample, ki t_s, in the unit of kp."""
        return self.ki * self.t_s

    @property
    def t_i(self) -> float:
        """Integral time T_i = kp/ki of the series form kp (1 + 1/(T_i s)), in s."""
        return self.kp / self.ki

    @property
    def velocity(self) -> tuple[float, float]:
        """(q0, q1) of the velocity form d[k] = d[k-1] + q0 e[k] + q1 e[k-1],
        in the unit of kp (paper 001, (8.9)).
        """
        return self.kp + self.ki_ts, -self.kp

    @property
    def anti_windup(self) -> float:
        """Back-calculation gain in 1/s: the integral gains anti_windup t_s (limited -
        unlimited output) per sample.

        The tracking time is T_i, but not below one sample, where the feedback is deadbeat.
        """
        return min(1.0 / self.t_i, 1.0 / self.t_s)

    @property
    def stable(self) -> bool:
        """Whether all closed-loop poles lie inside the unit circle."""
        return bool(np.all(np.abs(self.poles) < 1.0)) and (
            self.observed is None or self.observed.stable
        )

    @property
    def crossover(self) -> float:
        """Gain crossover with the smallest phase margin, in rad/s."""
        return self.margins.crossover

    @property
    def phase_margin(self) -> float:
        """Phase margin in rad."""
        return self.margins.phase_margin

    @property
    def gain_margin(self) -> float:
        """Gain margin as a factor."""
        return self.margins.gain_margin

    @property
    def delay_margin(self) -> float:
        """Delay margin in s."""
        return self.margins.delay_margin

    @property
    def delay_margin_samples(self) -> float:
        """Delay margin in sampling periods of this controller."""
        return self.margins.delay_margin / self.t_s

    @property
    def max_sensitivity(self) -> float:
        """Maximum sensitivity M_s."""
        return self.margins.max_sensitivity


@dataclass(frozen=True, slots=True)
class Decoupling:
    """Feedforward that decouples the axes: v_d += -omega_e l_q i_q, v_q +=
    omega_e (l_d i_d + psi_pm).

    ``l_d`` and ``l_q`` in H, ``psi_pm`` in Wb.
    """

    l_d: float
    l_q: float
    psi_pm: float


def decoupling(machine: Machine) -> Decoupling:
    """Decoupling values of a machine, those at zero current where it saturates."""
    return Decoupling(l_d=machine.l_d, l_q=machine.l_q, psi_pm=machine.psi_pm)


def per_unit(gains: LoopGains, in_base: float, out_base: float) -> tuple[float, float]:
    """Gains (kp, ki t_s) between per-unit quantities: physical gain times in_base/out_base.

    ``in_base`` is the base of the controlled quantity (A, or rad/s),
    ``out_base`` that of the output (V, or N m).

    Args:
        gains: The loop, gains in SI units.
        in_base: Base of the controlled quantity, in A or rad/s.
        out_base: Base of the output, in V or N m.
    """
    if not (in_base > 0.0 and out_base > 0.0):
        raise InputError(f"per-unit bases must be positive, got {in_base:g} and {out_base:g}")
    return gains.kp * in_base / out_base, gains.ki_ts * in_base / out_base


def loop_bases(bases: PerUnitBases, loop: LoopName) -> tuple[float, float]:
    """Bases of what a loop controls and of its output: A and V, or rad/s and N m.

    Args:
        bases: Per-unit bases in SI units.
        loop: Which loop.
    """
    return (bases.speed, bases.torque) if loop == "speed" else (bases.current, bases.voltage)
