"""Current control of a design's phase machine: gains, tables and limits from its settings."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.frame_choice import (
    controlled_frame,
    frame_obstacle,
    uses_zero_sequence,
    zero_sequence_inductance,
)
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.tolerance_box import DriveBox
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.phase_control.axis_gains import axis_gains, zero_loop
from dqforge.optimizer.phase_control.harmonic_orders import harmonic_gains, harmonic_orders
from dqforge.optimizer.phase_control.judged_box import JudgedLoops, judge_loops
from dqforge.optimizer.phase_control.limited_shapes import LimitedFit, fit_limited
from dqforge.optimizer.phase_control.midpoint_balance import SWING, midpoint_gains
from dqforge.optimizer.phase_control.phase_controller import (
    HarmonicGains,
    PhaseControl,
    TorqueLimit,
)
from dqforge.optimizer.phase_control.salient_limit import (
    Ladder,
    dq_currents,
    salient_torques,
    table_currents,
)
from dqforge.optimizer.phase_control.shape_table import ShapeFit, fit_shape
from dqforge.optimizer.phase_control.shape_vectors import (
    PHASES,
    flux_at,
    unit_currents,
)
from dqforge.optimizer.phase_control.torque_limit import (
    MARGIN,
    largest_torques,
    no_load_speed,
    torque_limit,
)
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits

_ANGLES = 2880


@dataclass(frozen=True, slots=True)
class PhaseLoops:
    """Current control of a phase machine with the evidence for it.

    Args:
        control: What the firmware runs.
        shape: Its table of the back-EMF and what that errs by.
        zero: The loop of the zero-sequence current, None where nothing drives one.
        limited: The currents beyond the torque limit, None where none are asked for or the link
            ends none.
        judged: How fast all of it forgets a disturbance over speeds and tolerances; None until
            judged.
    """

    control: PhaseControl
    shape: ShapeFit
    zero: LoopGains | None
    limited: LimitedFit | None = None
    judged: JudgedLoops | None = None


def phase_control(
    design: Design, i_d: LoopGains, i_q: LoopGains, *, within_link: bool = True
) -> PhaseLoops:
    """Current control of a design's phase machine.

    Args:
        design: The design, with a phase machine.
        i_d, i_q: Its current loops.
        within_link: Whether it knows where the link ends the torque, which takes a second to find;
            without it stands for points that are known to lie within.

    Raises:
        InputError: The frame is one that machine and topology cannot have.
        NoSolutionError: The loop of the zero sequence does not hold, or no table follows the
            back-EMF.
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
    l_0 = zero_sequence_inductance(machine, inverter.neutral_inductance)
    zero = zero_loop(control, i_q, machine.r_s, l_q, l_0) if neutral else None
    fit = fit_shape(phases, zero=uses_zero, turns=phases.turns, currents=frame != "dq")
    period = 2.0 * np.pi * phases.turns
    angle = period * np.arange(_ANGLES * phases.turns) / (_ANGLES * phases.turns)
    flux = flux_at(fit.shape, angle)
    sine = machine.psi_pm * np.stack([-np.sin(angle), np.cos(angle), 0.0 * angle])
    used = sine if frame == "dq" else flux
    unit = unit_currents(used, phases.pole_pairs, zero=uses_zero)
    if isinstance(machine, SalientPhaseMachine):
        torque_max = float(_ladder(design, machine, frame).torques[-1])
    elif frame == "dq":
        torque_max = _choice(design).largest_torque()
    else:
        torque_max = design.i_max / float(np.max(np.abs(PHASES @ unit)))
    midpoint = None
    if TOPOLOGIES[topology].midpoint and inverter.midpoint_capacitance is not None:
        midpoint = midpoint_gains(
            unit[2], phases.turns, torque_max, inverter.midpoint_capacitance, inverter.v_dc
        )
    loops = [(i_d.kp, l_d), (i_q.kp, l_q), *([] if zero is None else [(zero.kp, l_0)])]
    unlimited = PhaseControl(
        frame=frame,
        feedforward=settings.feedforward,
        topology=topology,
        shape=fit.shape,
        pole_pairs=phases.pole_pairs,
        r_s=machine.r_s,
        psi_pm=machine.psi_pm,
        inductances=(l_d, l_q, l_0),
        gains=(axis_gains(i_d), axis_gains(i_q), axis_gains(zero)),
        harmonics=_harmonics(design, PHASES @ unit, PHASES @ flux, loops),
        t_s=control.t_s,
        torque_max=torque_max,
        midpoint=midpoint,
    )
    limit = _torque_limit(design, unlimited) if within_link else None
    found = replace(unlimited, torque_limit=limit)
    limited = _limited(design, phases, found) if settings.limited_waveforms else None
    found = replace(found, limited=None if limited is None else limited.shapes)
    return PhaseLoops(found, fit, zero, limited)


def voltage_margin(design: Design) -> float:
    """Share of the voltage region that steady currents leave free, of 0 to 1.

    What the firmware leaves free by the design, `MARGIN` for its PI controllers, and what dead time
    takes off either end.
    """
    inverter = design.inverter
    return design.operation.voltage_margin + MARGIN + 2.0 * inverter.dead_time * inverter.f_sw


def _harmonics(
    design: Design,
    currents: FloatArray,
    flux: FloatArray,
    loops: list[tuple[float, float]],
) -> HarmonicGains | None:
    """Harmonic integrators for currents per torque and back-EMF of the phases, shape (3, N).

    ``loops`` are (kp, inductance) of each axis that is controlled.
    """
    control, machine = design.control, design.phase_machine
    if machine is None or not control.current_loop.harmonic_integrators:
        return None
    phases = machine.phases if isinstance(machine, SalientPhaseMachine) else machine
    return harmonic_gains(
        harmonic_orders(currents, flux, phases.turns),
        control.t_s,
        min(kp / inductance for kp, inductance in loops),
        design.i_max,
        _top_speed(design),
        neutral=TOPOLOGIES[design.inverter.topology].neutral,
    )


def _torque_limit(design: Design, control: PhaseControl) -> TorqueLimit:
    """Where the link ends the torque; the swing of a split link's midpoint is taken off."""
    v_dc, margin, machine = design.inverter.v_dc, voltage_margin(design), design.phase_machine
    last = no_load_speed(control, v_dc, margin)
    if control.midpoint is not None:
        margin += SWING * min(1.0, control.midpoint.omega_e_min / last)
        last = no_load_speed(control, v_dc, margin)
    if isinstance(machine, SalientPhaseMachine):
        ladder = _ladder(design, machine, control.frame)
        largest = salient_torques(machine, ladder, control.topology, margin)
    else:
        largest = partial(largest_torques, control, margin=margin)
    return torque_limit(v_dc, last, largest)


def _ladder(design: Design, machine: SalientPhaseMachine, frame: CurrentFrame) -> Ladder:
    """Torques of a salient machine with the currents that the firmware gives them."""
    if frame == "dq":
        return dq_currents(machine, _choice(design))
    inverter = design.inverter
    topology: Topology = "three-wire" if TOPOLOGIES[inverter.topology].diodes else inverter.topology
    return table_currents(machine, WaveformLimits(inverter.v_dc, topology, design.i_max))


def _limited(design: Design, machine: PhaseMachine, control: PhaseControl) -> LimitedFit | None:
    """Currents beyond the torque limit."""
    omega_m = design.machine.omega_m_max
    top = None if omega_m is None else machine.pole_pairs * omega_m
    margin = voltage_margin(design)
    return fit_limited(control, machine, design.inverter.v_dc, design.i_max, top, margin)


def judged(design: Design, box: DriveBox, loops: PhaseLoops) -> PhaseLoops:
    """The control with the judgement of its currents over speeds and tolerances.

    Args:
        design: The design, with a phase machine.
        box: Its tolerances.
        loops: Its control.

    Raises:
        NoSolutionError: The currents are unstable at a speed and a point of the box, which are
            named.
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


def _choice(design: Design) -> CurrentChoice:
    """The constant dq currents of a torque."""
    return CurrentChoice(design.machine, design.strategy, design.i_max)
