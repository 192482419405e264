"""Topologies and controllers of a design's machine compared at its operating point."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.leg_losses import leg_waveforms
from dqforge.machines.losses.phase_terminals import inductance_over_angle, phase_terminals
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.flashing_choice.choices import COMPARED, FlashRow, compared_frames
from dqforge.optimizer.flashing_choice.ripple_forms import ripple_figures
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.losses.leg_budgets import PhaseBudget
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.losses.phase_budget import phase_budget
from dqforge.optimizer.phase_control.design import phase_control
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.waveforms.comparison import operating_point, require_phases
from dqforge.optimizer.waveforms.open_phase import OpenPhasePrice, open_phase_price
from dqforge.optimizer.waveforms.phase_currents import dq_waveform, unit_currents

_KEY = "control.current_loop.frame: "

# Swing of the midpoint over the link's voltage that a split link is given capacitors for, where the
# design names none.
SPLIT_SWING = 0.02


@dataclass(frozen=True, slots=True)
class FlashComparison:
    """Rows at one operating point.

    Args:
        torque, omega_m: In N m and rad/s.
        v_dc: Of the design's link in V.
        rows: Every topology with every controller.
        without_device: Whether nothing is known of the switches, so that the bridge is left out.
        capacitance: Of the split link in F that its row is computed with.
        without_phase: What constant torque costs on four legs with a phase open, None where it
            cannot be made.
        unsimulated: Why no row was simulated, empty where they were; ``uncounted`` the same of the
            cycles.
    """

    torque: float
    omega_m: float
    v_dc: float
    rows: tuple[FlashRow, ...]
    without_device: bool
    capacitance: float
    without_phase: OpenPhasePrice | None = None
    unsimulated: str = "the rows were not simulated"
    uncounted: str = "the cycles were not counted"

    def row(self, topology: Topology, frame: CurrentFrame) -> FlashRow:
        """The row of a topology with a controller."""
        return next(r for r in self.rows if (r.topology, r.frame) == (topology, frame))


def variant(design: Design, topology: Topology, frame: CurrentFrame, capacitance: float) -> Design:
    """The design with another topology and controller; everything else as it is.

    Args:
        design: Any design of a phase machine.
        topology, frame: What feeds it, and how its current is controlled; ``table`` runs harmonic
            integrators.
        capacitance: Of a split link in F.
    """
    loop = replace(
        design.control.current_loop,
        frame=frame,
        feedforward="references",
        harmonic_integrators=frame == "table",
    )
    inverter = replace(design.inverter, topology=topology)
    if TOPOLOGIES[topology].midpoint and inverter.midpoint_capacitance is None:
        inverter = replace(inverter, midpoint_capacitance=capacitance)
    return replace(design, inverter=inverter, control=replace(design.control, current_loop=loop))


@on_design("waveform")
def compare_flashing(design: Design, settings: WaveformSettings | None = None) -> FlashComparison:
    """Every topology with every controller: losses, voltage, ripple and table, in closed form.

    Args:
        design: The design; its own topology is one among the others.
        settings: The operating point; that of the design when None.

    Raises:
        InputError: The machine has a sinusoidal back-EMF, or the point has no torque or no speed.
    """
    machine = require_phases(design)
    chosen = design.waveform if settings is None else settings
    torque, omega_m = operating_point(design, chosen)
    if torque == 0.0 or omega_m == 0.0:
        raise InputError("--flash compares at a torque and a speed; neither may be 0")
    capacitance = _capacitance(design, machine, torque, omega_m)
    gains = solve_gains(variant(design, "three-wire", "dq", capacitance))
    loops = gains.i_d, gains.i_q
    rows = [
        _row(variant(design, topology, frame, capacitance), loops, torque, omega_m)
        for topology in COMPARED
        for frame in compared_frames(topology)
    ]
    return FlashComparison(
        torque=torque,
        omega_m=omega_m,
        v_dc=design.inverter.v_dc,
        rows=tuple(rows),
        without_device=design.inverter.device is None,
        capacitance=capacitance,
        without_phase=open_phase_price(machine, "four-leg", chosen.open_phase or "a", torque)
        if isinstance(machine, PhaseMachine)
        else None,
    )


def _capacitance(design: Design, machine: AnyPhaseMachine, torque: float, omega_m: float) -> float:
    """Both halves of the split link in F: the design's, or what holds the midpoint at the point."""
    given = design.inverter.midpoint_capacitance
    if given is not None:
        return given
    through = np.sum(reference_currents(design, machine, "dqy", "six-leg", torque), axis=0)
    charge = np.cumsum(through - np.mean(through)) / through.size * 2.0 * math.pi
    swing = float(np.ptp(charge)) / (machine.pole_pairs * abs(omega_m))
    return max(swing / (SPLIT_SWING * design.inverter.v_dc), 1e-6)


def reference_currents(
    design: Design,
    machine: AnyPhaseMachine,
    frame: CurrentFrame,
    topology: Topology,
    torque: float,
) -> FloatArray:
    """Phase currents in A, shape (3, N), that a controller asks for.

    Args:
        design, machine: The drive.
        frame, topology: The controller; ``table`` asks for the least loss of the topology.
        torque: In N m.
    """
    zero = frame == "dqy" or (frame == "table" and TOPOLOGIES[topology].neutral)
    if frame == "dq":
        if isinstance(machine, PhaseMachine):
            i_q = torque / design.machine.torque_per_ampere
            return dq_waveform(0.0, i_q, machine.angles, machine.turns)
        return np.asarray(pointwise_dq(design, torque, machine))
    # The table of a salient machine makes no use of its saliency.
    phases = machine if isinstance(machine, PhaseMachine) else machine.phases
    return np.asarray(torque * unit_currents(phases, "dqy" if zero else "dqx"))


def pointwise_dq(design: Design, torque: float, machine: AnyPhaseMachine) -> FloatArray:
    """Sinusoidal currents in A of a salient machine by MTPA, shape (3, N).

    Args:
        design: The design, of whose machine in dq coordinates it is.
        torque: In N m.
        machine: The machine, on whose angles they are.
    """
    from dqforge.optimizer.operating_points.current_choice import CurrentChoice

    i_d, i_q = CurrentChoice(design.machine, "mtpa", design.i_max).currents(np.array([abs(torque)]))
    i_q_signed = math.copysign(float(i_q[0]), torque)
    return dq_waveform(float(i_d[0]), i_q_signed, machine.angles, machine.turns)


def _row(
    design: Design, loops: tuple[LoopGains, LoopGains], torque: float, omega_m: float
) -> FlashRow:
    """One row, or why it cannot be; ``design`` is the variant of the row."""
    topology, frame = design.inverter.topology, design.control.current_loop.frame
    assert frame is not None
    machine = require_phases(design)
    try:
        currents = reference_currents(design, machine, frame, topology, torque)
        control = phase_control(design, *loops, within_link=False).control
    except (NoSolutionError, InputError) as error:
        return _empty(topology, frame, error.message.removeprefix(_KEY))
    budget = phase_budget(
        machine,
        design.inverter,
        currents[np.newaxis],
        np.array([omega_m]),
        options=budget_options(design),
        friction=design.machine.friction,
    )
    return _filled(design, control, currents, budget, omega_m)


def _empty(topology: Topology, frame: CurrentFrame, reason: str) -> FlashRow:
    nothing = math.nan
    return FlashRow(topology, frame, reason, nothing, nothing, nothing, nothing, nothing, None, 0)


def _filled(
    design: Design,
    control: PhaseControl,
    currents: FloatArray,
    found: PhaseBudget,
    omega_m: float,
) -> FlashRow:
    """A row with its figures."""
    machine, inverter = require_phases(design), design.inverter
    terminals = phase_terminals(
        machine, currents[np.newaxis], np.array([omega_m]), inverter.topology
    )
    wave = leg_waveforms(
        inverter.topology,
        terminals.voltages,
        terminals.currents,
        inverter.v_dc,
        inductance_over_angle(machine) + inverter.neutral_inductance,
    )
    left = float(dead_time_factor("svpwm", inverter.dead_time, inverter.f_sw))
    budget, place = found.budget, (0, 0)
    link = float(found.link_demand[place]) / left if left > 0.0 else math.inf
    peak = float(np.max(np.abs(currents)))
    obstacles = [
        f"the link ends at {inverter.v_dc:.4g} V" if link > inverter.v_dc else "",
        f"{peak:.4g} A are above the limit of {design.i_max:.4g} A"
        if peak > design.i_max * (1.0 + 1e-6)
        else "",
    ]
    legs = found.leg_loss[place]
    names = TOPOLOGIES[inverter.topology].legs
    return FlashRow(
        topology=inverter.topology,
        frame=control.frame,
        obstacle=", ".join(filter(None, obstacles)),
        copper=float(budget.copper[place] + budget.ripple_copper[place]),
        bridge=float(np.sum(legs)),
        neutral_leg=float(legs[names.index("n")]) if "n" in names else math.nan,
        link=link,
        neutral=float(np.hypot(found.neutral_current[place], found.neutral_ripple[place])),
        ripple=ripple_figures(machine, inverter, control, currents, wave, omega_m),
        constants=4 * control.shape.flux.shape[0] * (control.shape.flux.shape[1] + 1),
        control=control,
    )


def with_rows(
    found: FlashComparison,
    rows: Sequence[FlashRow],
    *,
    unsimulated: str | None = None,
    uncounted: str | None = None,
) -> FlashComparison:
    """The comparison with rows that know more, and what is said of what they do not know.

    Args:
        found: The comparison.
        rows: Its rows, in their order.
        unsimulated, uncounted: As in the comparison; None leaves what it says.
    """
    return replace(
        found,
        rows=tuple(rows),
        unsimulated=found.unsimulated if unsimulated is None else unsimulated,
        uncounted=found.uncounted if uncounted is None else uncounted,
    )
