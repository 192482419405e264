"""The drive as motulator has it: its machine, converter and shaft around control functions of ours
in single precision, which are those of the emitted C bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from motulator.drive.model import (
    CarrierComparison,
    Drive,
    Simulation,
    StiffMechanicalSystem,
    SynchronousMachine,
    VoltageSourceConverter,
)
from motulator.drive.utils import SynchronousMachinePars

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine

# Steps of its solver in a control period.
_STEPS = 3

# Duty cycles, one of each leg, for samples of shape (1, 6): currents of the phases, angle, speed,
# voltage of the link.
Control = Callable[[Any], Any]


class _Sampled:
    """What motulator calls at each sample; ``seen`` has speed (rad/s), i_d and i_q (A) of each."""

    def __init__(self, control: Control, t_s: float, v_dc: float) -> None:
        self.control, self.t_s, self.v_dc = control, t_s, v_dc
        self.seen: list[tuple[float, ...]] = []

    def __call__(self, drive: Any) -> tuple[float, FloatArray]:
        omega, machine = float(drive.mechanics.meas_speed()), drive.machine
        angle = float(np.angle(machine.state.exp_j_theta_m))
        samples = [*machine.meas_currents(), angle, omega, self.v_dc]
        duty = self.control(np.array([samples], dtype=np.float32))
        self.seen.append((omega, machine.i_s.real, machine.i_s.imag))
        return self.t_s, np.array([float(each[0]) for each in duty])

    def post_process(self) -> None:
        """Nothing of the control is kept but what it saw."""


def _centred(t_s: float, duties: FloatArray) -> tuple[FloatArray, Any]:
    """Edges of a carrier that rises and falls within a period."""
    carrier = CarrierComparison(N=2**24)
    parts = [carrier(0.5 * t_s, duties) for _ in range(2)]
    return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])


def run(
    design: Design,
    control: Control,
    duration: float,
    load: Callable[[Any], Any] = np.zeros_like,
    *,
    switched: bool = False,
) -> FloatArray:
    """Speed (rad/s), i_d and i_q (A) at the samples from rest under a load in N m over time, shape
    (N, 3).
    """
    machine, t_s, v_dc = design.machine, design.control.t_s, design.inverter.v_dc
    assert isinstance(machine, LinearMachine)
    parameters = SynchronousMachinePars(
        n_p=machine.pole_pairs,
        R_s=machine.r_s,
        L_d=machine.l_d,
        L_q=machine.l_q,
        psi_f=machine.psi_pm,
    )
    drive = Drive(
        VoltageSourceConverter(v_dc),
        SynchronousMachine(parameters),
        StiffMechanicalSystem(J=machine.inertia, B_L=machine.friction, tau_L=load),
    )
    if switched:
        drive.pwm = _centred
    # Until the first duty cycles act the legs make no voltage.
    drive.delay.data = [np.full(3, 0.5)]
    sampled = _Sampled(control, t_s, v_dc)
    Simulation(drive, sampled).simulate(t_stop=duration, max_step=t_s / _STEPS)
    return np.array(sampled.seen)
