"""The closed loops of Figures 6.9 to 6.18 of paper 002: circuits and controllers, with the C
that is emitted for each.

Here the controllers of the thesis run where no design lets them: dqy on a neutral between diodes.
Its three phases are then modulated each for itself against half the link, as the thesis says of
that circuit ("each phase works by itself"); the emitted C is that of a split link whose midpoint
does not move, on the plant with the diodes.
"""

from __future__ import annotations

import math
from dataclasses import replace

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.loops.gains import tune_current_loop, tune_speed_loop
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.phase_control.phase_controller import (
    AxisGains,
    HarmonicGains,
    MidpointGains,
    PhaseControl,
    PhaseShape,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.title import title
from dqforge.reports.main_header.header import header_files
from dqforge.reports.pages.templating import render
from dqforge.reports.papers.paper002_definitions.bench_currents import DESIGN_NAME
from dqforge.reports.phase_control.header import header_context, preamble
from dqforge.reports.phase_control.plain import Surroundings, plain_phase_control

# Of the current loops in Hz, kp = omega_c L and ki = kp omega_c/10 on every axis; chosen, the
# thesis prints no gains.
BANDWIDTH = 500.0

# Of the speed loop in rad/s, kp = J omega_c and ki = kp omega_c/4; chosen likewise.
SPEED_BANDWIDTH = 50.0

# Orders in alpha and beta, and of the zero sequence, where phases are alike and where not.
_EQUAL = ((-5, 7, -11, 13), (3, 9))
_UNEQUAL = ((-1, 3, -3, -5, 7, -11, 13), (1, 3, 9))
_RATE, _ERROR_MAX = 60.0, 1.0  # 1/s; A


@dataclass(frozen=True, slots=True)
class LoopCase:
    """A controller on a circuit.

    ``plant`` is the circuit that is simulated, ``firmware`` the one that the C is emitted for.
    ``shown`` says what of the thesis it is, empty where it is none of it.
    """

    name: str
    circuit: str
    controller: str
    plant: Topology
    firmware: Topology
    frame: CurrentFrame
    feedforward: Feedforward
    harmonics: bool = False
    shown: str = ""


_DIODES, _LEGS = "diodes (5.4)", "four legs (5.2)"

# What is run, the thesis's own circuit and controllers first.
CASES = (
    LoopCase(
        "diodes_pi", _DIODES, "dqy, PI", "diode-neutral", "split-capacitor", "dqy", "none",
        shown="4.2, the bench",
    ),
    LoopCase(
        "diodes_decoupled", _DIODES, "dqy, decoupled", "diode-neutral", "split-capacitor", "dqy",
        "measured", shown="4.3",
    ),
    LoopCase(
        "diodes_dqx", _DIODES, "dqx, references", "diode-neutral", "diode-neutral", "dqx",
        "references",
    ),
    LoopCase(
        "legs_pi", _LEGS, "dqy, PI", "four-leg", "four-leg", "dqy", "none",
        shown="4.2",
    ),
    LoopCase(
        "legs_decoupled", _LEGS, "dqy, decoupled", "four-leg", "four-leg", "dqy", "measured",
        shown="4.3",
    ),
    LoopCase(
        "legs_table", _LEGS, "table, harmonics", "four-leg", "four-leg", "table", "references",
        harmonics=True,
    ),
    LoopCase(
        "star_table", "star", "dqx table, harmonics", "three-wire", "three-wire", "table",
        "references", harmonics=True,
    ),
)  # fmt: skip


def _axis(inductance: float) -> AxisGains:
    omega_c = 2.0 * math.pi * BANDWIDTH
    return AxisGains(omega_c * inductance, 0.1 * omega_c * omega_c * inductance)


def _harmonics(neutral: bool, alike: bool, t_s: float) -> HarmonicGains:
    orders, zero_orders = _EQUAL if alike else _UNEQUAL
    frequency_max = 1.0 / (6.0 * t_s)
    return HarmonicGains(orders, zero_orders if neutral else (), _RATE, frequency_max, _ERROR_MAX)


def phase_control(case: LoopCase, machine: PhaseMachine, t_s: float) -> PhaseControl:
    """Current control of a case, sampled every ``t_s`` in s."""
    neutral = TOPOLOGIES[case.firmware].neutral
    plane, zero = machine.l_s - machine.m_s, machine.l_s + 2.0 * machine.m_s
    alike = machine.symmetry != "none"
    whole = machine.flux[:1] if alike else machine.flux
    return PhaseControl(
        frame=case.frame,
        feedforward=case.feedforward,
        topology=case.firmware,
        shape=PhaseShape(whole),
        pole_pairs=machine.pole_pairs,
        r_s=machine.r_s,
        psi_pm=machine.psi_pm,
        inductances=(plane, plane, zero),
        gains=(_axis(plane), _axis(plane), _axis(zero) if neutral else AxisGains(0.0, 0.0)),
        harmonics=_harmonics(neutral, alike, t_s) if case.harmonics else None,
        t_s=t_s,
        torque_max=1.5 * machine.pole_pairs * machine.psi_pm * machine.i_max,
        # The midpoint is half of a link that does not move: nothing is balanced, nothing fades.
        midpoint=MidpointGains(0.0, 0.0) if TOPOLOGIES[case.firmware].midpoint else None,
    )


def case_design(case: LoopCase) -> Design:
    """The shipped design on the circuit of a case, with a speed loop."""
    design = catalogue.load(DESIGN_NAME)
    inertia = design.machine.inertia
    assert inertia is not None
    kp = inertia * SPEED_BANDWIDTH
    speed = SpeedLoopSettings(method="given", kp=kp, ki=0.25 * kp * SPEED_BANDWIDTH)
    control = replace(design.control, speed_loop=speed)
    inverter = replace(design.inverter, topology=case.plant)
    return replace(design, control=control, inverter=inverter)


def _speed_loop(design: Design) -> LoopGains:
    machine, control = design.machine, design.control
    q_axis = tune_current_loop(machine.r_s, machine.l_q, control.t_s, control.current_loop)
    return tune_speed_loop(machine, q_axis, control)


def _main_header(design: Design) -> dict[str, bytes]:
    """The header that the control includes, of nothing but the current reference."""
    fit = solve_fit(design).fit
    return header_files(Solution(design, solve_curves(design), fit, (), None, None))


def controller_files(case: LoopCase, design: Design, machine: PhaseMachine) -> dict[str, bytes]:
    """Names and bytes of the headers of a case."""
    settings = design.control.speed_loop
    assert settings is not None
    around = Surroundings(
        design.operation.modulation, speed=_speed_loop(design), ratio=settings.ratio
    )
    plain = plain_phase_control(phase_control(case, machine, design.control.t_s), around)
    context = {**title(design), **header_context(plain), "preamble": preamble(plain)}
    text = render("phase_control/phase_control.h.j2", context)
    name = f"{design.export.prefix}_control.h"
    return {**_main_header(design), name: text.encode("ascii")}
