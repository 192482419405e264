"""What a design asks a firmware to hold: constants of its drive, and its gains."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.configuration import DriveValues, PiGains
from dqforge.optimizer.firmware.firmware_method import Asked

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.loops.loop_gains import LoopGains


def drive_values(design: Design) -> DriveValues:
    """Constants of the design's machine, inverter and timing.

    Of a saturating machine the inductances are the incremental ones at zero current.
    """
    machine, inverter, control = design.machine, design.inverter, design.control
    speed = control.speed_loop
    return DriveValues(
        pole_pairs=machine.pole_pairs,
        r_s=machine.r_s,
        l_d=machine.l_d,
        l_q=machine.l_q,
        psi_pm=machine.psi_pm,
        inertia=machine.inertia,
        viscous=machine.friction,
        i_max=design.i_max,
        omega_m_max=machine.omega_m_max,
        v_dc=inverter.v_dc,
        f_sw=inverter.f_sw,
        dead_time=inverter.dead_time,
        t_s=control.t_s,
        t_speed=None if speed is None else speed.ratio * control.t_s,
    )


def asked(design: Design, i_d: LoopGains, i_q: LoopGains, speed: LoopGains | None) -> Asked:
    """What is asked of a firmware where the design's own gains are wished for.

    The speed controller of other firmware commands q current: its gains are those of the torque
    over the torque per ampere at zero current.
    """
    return Asked(
        design,
        drive_values(design),
        PiGains(i_d.kp, i_d.ki),
        PiGains(i_q.kp, i_q.ki),
        None if speed is None else _per_ampere(speed, design),
    )


def _per_ampere(loop: LoopGains, design: Design) -> PiGains | None:
    """Gains in A s/rad and A/rad; None for a machine that makes no torque without d current."""
    constant = 1.5 * design.machine.pole_pairs * design.machine.psi_pm
    if not math.isfinite(constant) or constant <= 0.0:
        return None
    return PiGains(loop.kp / constant, loop.ki / constant)
