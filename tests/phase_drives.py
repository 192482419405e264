"""Phase machines of the tests and a plain control for them, without the design of one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.phase_control.phase_controller import (
    AxisGains,
    HarmonicGains,
    MidpointGains,
    PhaseControl,
    PhaseShape,
)

T_S = 1e-4

PLANE, ZERO = (-5, 7, -11, 13), (3, 9)


def near_sinusoidal(nodes: int = 192) -> PhaseMachine:
    """The machine of paper002-phase-waveforms: orders 3, 5 and 7 beside the fundamental."""
    return PhaseMachine.from_harmonics(
        [1, 3, 5, 7], 0.2233 * np.array([1.0, 0.12, 0.03, 0.01]), np.zeros(4),
        pole_pairs=2, r_s=1.0, l_s=7e-3, m_s=-1e-3, i_max=5.94, angles=nodes,
    )  # fmt: skip


def trapezoidal(nodes: int = 192) -> PhaseMachine:
    """A back-EMF that is flat for 120 degrees at 0.2 Wb, else as `near_sinusoidal`."""
    theta = 2.0 * np.pi * np.arange(nodes) / nodes

    def flat(angle: Any) -> Any:
        turned = np.mod(angle, 2.0 * np.pi)
        rising = np.where(turned > np.pi, 2.0 * np.pi - turned, turned)
        return (
            -0.2
            * np.sign(np.pi - turned)
            * np.minimum(1.0, np.minimum(rising, np.pi - rising) / (np.pi / 6.0))
        )

    flux = np.stack([flat(theta - 2.0 * np.pi / 3.0 * k) for k in range(3)])
    return PhaseMachine(2, 1.0, 7e-3, -1e-3, flux, 5.94)


def plain_control(
    machine: PhaseMachine,
    topology: Topology = "four-leg",
    frame: CurrentFrame = "table",
    feedforward: Feedforward = "references",
    bandwidth: float = 500.0,
    **changes: Any,
) -> PhaseControl:
    """Gains by kp = omega_c L and ki = kp omega_c / 10 on every axis, ``bandwidth`` in Hz."""
    rule = TOPOLOGIES[topology]
    l_ab, l_0 = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
    omega_c = 2.0 * math.pi * bandwidth

    def axis(inductance: float) -> AxisGains:
        return AxisGains(omega_c * inductance, omega_c * inductance * omega_c / 10.0)

    equal = machine.symmetry != "none"
    control = PhaseControl(
        frame=frame,
        feedforward=feedforward,
        topology=topology,
        shape=PhaseShape(machine.flux[:1] if equal else machine.flux),
        pole_pairs=machine.pole_pairs,
        r_s=machine.r_s,
        psi_pm=machine.psi_pm,
        inductances=(l_ab, l_ab, l_0),
        gains=(axis(l_ab), axis(l_ab), axis(l_0) if rule.neutral else AxisGains(0.0, 0.0)),
        harmonics=HarmonicGains(PLANE, ZERO if rule.neutral else (), 60.0, 1.0 / (6.0 * T_S), 1.0),
        t_s=T_S,
        torque_max=4.0,
        midpoint=MidpointGains(0.05, 20.0) if rule.midpoint else None,
    )
    return replace(control, **changes)
