"""Control of a phase machine in integers on an averaged plant of 220 V, sampled at 10 kHz."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from phase_drives import T_S

from dqforge.machines.arrays import FloatArray
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.fixed_phase_control.integers import (
    FixedPhaseControl,
    Measured,
    phase_at_rest,
    phase_gains,
)
from dqforge.optimizer.fixed_phase_control.phase_step import PhaseSteps
from dqforge.optimizer.steps.code_vectors import Abc, Dq
from dqforge.optimizer.steps.integer_arithmetic import Integers


@dataclass
class Loop:
    """Averaged plant with exact exponentials per axis, two periods per sampling period."""

    machine: PhaseMachine
    control: FixedPhaseControl
    omega_m: float
    code: int = 2**15

    def __post_init__(self) -> None:
        self.fine = clarke_matrix() @ np.stack(
            [
                np.interp(
                    np.arange(7200) / 20.0,
                    np.arange(self.machine.angles + 1) * (360.0 / self.machine.angles),
                    np.append(row, row[0]),
                )
                for row in self.machine.flux
            ]
        )

    def codes(self, value: float) -> Any:
        return np.array([min(max(round(value * self.code), -self.code), self.code - 1)])

    def torque(self, asked: float, constant: float, steps: int, open_phase: int = 0) -> FloatArray:
        """Mean torque of every sampling period in N m."""
        k, machine = self.control, self.machine
        current, voltage, speed, torque, _ = k.bases
        zero = np.zeros(1, dtype=np.int64)
        run, gains, state = PhaseSteps(k), phase_gains(k), phase_at_rest(k, zero)
        state.open_phase = np.array([open_phase])
        plane, none = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
        decay = np.exp(-machine.r_s / np.array([plane, plane, none]) * (T_S / 4.0))
        i, theta, duty, found = np.zeros(3), 0.0, None, np.empty(steps)
        omega_e = machine.pole_pairs * self.omega_m
        back = np.linalg.inv(clarke_matrix())
        for step in range(steps):
            phases = back @ i
            middle = self.codes(110.0 / (voltage * 2**k.dc_scale))
            measured = Measured(
                Abc(*(self.codes(x / current) for x in phases)),
                np.array([round(theta / (2.0 * math.pi) * 65536) % 65536]),
                self.codes(self.omega_m / speed),
                self.codes(220.0 / (voltage * 2**k.dc_scale)),
                middle if k.midpoint else None,
            )
            reference = Dq(zero, self.codes(constant / current))
            made = run.shaped_control(
                Integers(), gains, state, measured, self.codes(asked / torque), reference
            )
            v = np.zeros(3) if duty is None else self._voltage(duty)
            mean = 0.0
            for _ in range(4):
                flux = self.fine[:, round((theta + omega_e * T_S / 8.0) / math.tau * 7200) % 7200]
                i = i * decay + (1.0 - decay) * (v - omega_e * flux) / machine.r_s
                if not TOPOLOGIES[k.topology].neutral:
                    i[2] = 0.0
                theta += omega_e * T_S / 4.0
                flux = self.fine[:, round(theta / math.tau * 7200) % 7200]
                mean += machine.pole_pairs * (1.5 * flux[:2] @ i[:2] + 3.0 * flux[2] * i[2]) / 4.0
            duty = [float(x[0]) / self.code for x in made]
            found[step] = mean
        return found

    def _voltage(self, duty: list[float]) -> FloatArray:
        legs = np.array(duty)
        tied = {
            "four-leg": legs[3:4],
            "six-leg": legs[3:],
            "six-leg-isolated": legs[3:],
            "split-capacitor": np.array([0.5]),
        }.get(self.control.topology, np.mean(legs))
        v = clarke_matrix() @ ((legs[:3] - tied) * 220.0)
        if not TOPOLOGIES[self.control.topology].neutral:
            v[2] = 0.0
        return np.asarray(v)
