"""Current control of a design's phase machine: gains, tables and limits from its settings."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.frame_choice import (
    controlled_frame,
    frame_obstacle,
    uses_zero_sequence,
)
from dqforge.machines.phase_machines.salient_phase_machine import (
    AnyPhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.tolerance_box import DriveBox
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.phase_control.axis_gains import axis_gains, zero_loop
from dqforge.optimizer.phase_control.harmonic_orders import harmonic_gains, harmonic_orders
from dqforge.optimizer.phase_control.judged_box import JudgedLoops, judge_loops
from dqforge.optimizer.phase_control.midpoint_balance import midpoint_gains
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.phase_control.shape_table import ShapeFit, fit_shape
from dqforge.optimizer.phase_control.shape_vectors import PHASES, flux_at, unit_currents

_ANGLES = 2880


@dataclass(frozen=True, slots=True)
class PhaseLoops:
    """Current control of a phase machine with the evidence for it.

    Parameters
    ----------
    control:
        What the firmware runs.
    shape:
        Its table of the back-EMF and what that errs by.
    zero:
        The loop of the zero-sequence current, None where nothing drives one.
    judged:
        How fast all of it forgets a disturbance over speeds and tolerances; None until judged.
    """

    control: PhaseControl
    shape: ShapeFit
    zero: LoopGains | None
    judged: JudgedLoops | None = None


def zero_sequence_inductance(machine: AnyPhaseMachine, inverter: Inverter) -> float:
    """Inductance L_0 in H that a zero-sequence current meets: L_s + 2 M_s, and 3 L_n of a choke.

    That of a salient machine is the mean over the angle.
    """
    if isinstance(machine, SalientPhaseMachine):
        own = float(np.mean(np.sum(machine.inductance, axis=(1, 2))) / 3.0)
    else:
        own = machine.l_s + 2.0 * machine.m_s
    return own + 3.0 * inverter.neutral_inductance


def phase_control(design: Design, i_d: LoopGains, i_q: LoopGains) -> PhaseLoops:
    """Current control of a design's phase machine.

    Parameters
    ----------
    design:
        The design, with a phase machine.
    i_d, i_q:
        Its current loops.

    Raises
    ------
    InputError
        The frame is one that machine and topology cannot have.
    NoSolutionError
        The loop of the zero sequence does not hold, or no table follows the back-EMF.
    """
    machine, inverter, control = design.phase_machine, design.inverter, design.control
    if machine is None:
        raise InputError(
            "this design's machine has a sinusoidal back-EMF: its control is that of dq"
        )
    settings, topology = control.current_loop, inverter.topology
    frame = controlled_frame(settings.frame, machine, topology)
    obstacle = frame_obstacle(frame, machine, topology)
    if obstacle:
        raise InputError(f"control.current_loop.frame: {obstacle}")
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    neutral = TOPOLOGIES[topology].neutral
    uses_zero = uses_zero_sequence(frame, topology)
    l_d, l_q = design.machine.l_d, design.machine.l_q
    l_0 = zero_sequence_inductance(machine, inverter)
    zero = zero_loop(control, i_q, machine.r_s, l_q, l_0) if neutral else None
    turns = 1
    fit = fit_shape(phases, zero=uses_zero, turns=turns, currents=frame != "dq")
    angle = 2.0 * np.pi * turns * np.arange(_ANGLES * turns) / (_ANGLES * turns)
    flux = flux_at(fit.shape, angle)
    if frame == "dq":
        sine = machine.psi_pm * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
        unit, torque_max = unit_currents(sine, phases.pole_pairs, zero=False), _largest_dq(design)
    else:
        unit = unit_currents(flux, phases.pole_pairs, zero=uses_zero)
        torque_max = design.i_max / float(np.max(np.abs(PHASES @ unit)))
    harmonics = None
    if settings.harmonic_integrators:
        loops = [(i_d.kp, l_d), (i_q.kp, l_q), *([] if zero is None else [(zero.kp, l_0)])]
        harmonics = harmonic_gains(
            harmonic_orders(PHASES @ unit, PHASES @ flux, turns),
            control.t_s,
            min(kp / inductance for kp, inductance in loops),
            design.i_max,
            _top_speed(design),
            neutral=neutral,
        )
    midpoint = None
    if TOPOLOGIES[topology].midpoint and inverter.midpoint_capacitance is not None:
        midpoint = midpoint_gains(
            unit[2], turns, torque_max, inverter.midpoint_capacitance, inverter.v_dc
        )
    found = PhaseControl(
        frame=frame,
        feedforward=settings.feedforward,
        topology=topology,
        shape=fit.shape,
        pole_pairs=phases.pole_pairs,
        r_s=machine.r_s,
        psi_pm=machine.psi_pm,
        inductances=(l_d, l_q, l_0),
        gains=(axis_gains(i_d), axis_gains(i_q), axis_gains(zero)),
        harmonics=harmonics,
        t_s=control.t_s,
        torque_max=torque_max,
        midpoint=midpoint,
    )
    return PhaseLoops(found, fit, zero)


def judged(design: Design, box: DriveBox, loops: PhaseLoops) -> PhaseLoops:
    """The control with the judgement of its currents over speeds and tolerances.

    Parameters
    ----------
    design:
        The design, with a phase machine.
    box:
        Its tolerances.
    loops:
        Its control.

    Raises
    ------
    NoSolutionError
        The currents are unstable at a speed and a point of the box, which are named.
    """
    found = judge_loops(
        loops.control,
        box,
        _top_speed(design) / loops.control.pole_pairs,
        design.inverter.midpoint_capacitance,
        named=design.control.tolerances is not None,
    )
    return replace(loops, judged=found)


def _top_speed(design: Design) -> float:
    """Electrical top speed in rad/s: the machine's, else the base of the speed."""
    omega_m = design.machine.omega_m_max
    return design.machine.pole_pairs * (design.control.bases.speed if omega_m is None else omega_m)


def _largest_dq(design: Design) -> float:
    """Largest torque of constant dq currents in N m."""
    return CurrentChoice(design.machine, design.strategy, design.i_max).largest_torque()
