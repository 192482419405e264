"""Figures 6.9 to 6.18 of paper 002 with the emitted C in the loop, every switching instant
simulated: the circuit of the thesis beside circuits that can carry its neutral current.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.phase_machines.frame_transforms import thesis_shapes, to_frame
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import Profile, Scenario, Sensorless, constant
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.loops.loop_gains import LoopGains, tune_current_loop, tune_speed_loop
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.phase_control.phase_controller import (
    AxisGains,
    HarmonicGains,
    MidpointGains,
    PhaseControl,
    PhaseShape,
)
from dqforge.optimizer.solution import Solution, solve_control
from dqforge.optimizer.waveforms.constraint_rows import spectrum, unit_currents
from dqforge.reports.c_code.harness import title
from dqforge.reports.main_header import header_files
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.templating import render
from dqforge.reports.papers.paper002_bench_currents import BENCH_TORQUE, DESIGN_NAME, bench_machine
from dqforge.reports.papers.paper002_compensation import TRAPEZOID_FLUX
from dqforge.reports.papers.transients import RPM
from dqforge.reports.phase_control.header import (
    Surroundings,
    header_context,
    plain_phase_control,
    preamble,
)
from dqforge.reports.simulation.design_run import angle_error, simulate_design
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

BENCH_SPEED = 750.0 * RPM  # rad/s, section 6.2.
_STEADY, _TAIL = 1.2, 0.4  # s: until the integrators have settled, and what is judged
_WORKERS = 2
_STEP_AT, _STEP_END = 0.3, 0.7  # s: once the start has died away, and the end


@dataclass(frozen=True, slots=True, eq=False)
class LoopCurves:
    """Curves of a case: over the last electrical period at constant speed, and over a load step.

    Currents power-invariant in A: ``dqy`` and ``dqx`` divided by a_y and a_x, ``stationary`` alpha,
    beta and 0, shape (3, N), ``phase_a`` (N,), over ``theta`` in rad. ``time`` in s from the step,
    ``torque`` in N m (means over control periods) and ``speed`` in rad/s.
    """

    theta: FloatArray
    dqy: FloatArray
    dqx: FloatArray
    stationary: FloatArray
    phase_a: FloatArray
    time: FloatArray
    torque: FloatArray
    speed: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LoopRun:
    """A case at 750 rpm and 1 N m, and through a load step from 0 to 1 N m.

    ``torque`` is the mean in N m; ``ripple_means`` peak to peak of its means over PWM periods and
    ``ripple`` of itself, in N m; ``ripple_averaged`` that of an averaged inverter, no dead time;
    ``neutral_rms`` in A (sum of the phases), ``zero_rms`` and
    ``zero_third`` (order 3, peak) of i_0 in A, power-invariant; ``i_qy`` mean, least and largest at
    the samples in A; ``phase_rms`` and ``copper`` in A and W. ``asked`` are the means over a period
    of the zero-sequence voltage (mean of the phases) that the controller asks for in V, at a
    quarter of the run and at its end, nan where it asks for none. ``dip`` in rad/s and
    ``dip_after`` in s: how far the load step slows the drive, and when.
    """

    case: LoopCase
    torque: float
    ripple_means: float
    ripple: float
    ripple_averaged: float
    neutral_rms: float
    zero_rms: float
    zero_third: float
    i_qy: tuple[float, float, float]
    phase_rms: float
    copper: float
    asked: tuple[float, float]
    dip: float
    dip_after: float
    curves: LoopCurves


@dataclass(frozen=True, slots=True, eq=False)
class LedRun:
    """dqy on four legs with its angle from an encoder or from an observer.

    From 750 rpm without load to 1 N m. ``time`` in s from the step, ``torque`` (means over control
    periods) in N m, ``speed`` in rad/s and ``angle_error`` of the observer in rad (electrical),
    shape (N,) each. Of the last 0.1 s: ``mean`` of the torque and ``ripple`` of its means, peak to
    peak, in N m; ``bias`` and ``swing`` of the angle error, mean and peak to peak, in rad.
    """

    led_by: str
    mean: float
    ripple: float
    bias: float
    swing: float
    dip: float
    time: FloatArray
    torque: FloatArray
    speed: FloatArray
    angle_error: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ClosedLoops:
    """All cases, as `CASES`, and dqy led by an encoder and by an observer."""

    runs: tuple[LoopRun, ...]
    led: tuple[LedRun, ...]


def _shape_at(machine: PhaseMachine, theta: FloatArray) -> FloatArray:
    """Back-EMF over its peak at angles in rad, shape (3, N), from its harmonics."""
    lines = np.fft.rfft(machine.flux, axis=1) * (2.0 / machine.angles)
    orders = np.arange(1, machine.angles // 2)
    kept = orders[np.max(np.abs(lines[:, orders]), axis=0) > 1e-9 * np.max(np.abs(lines))]
    turned = np.exp(1j * kept[:, np.newaxis] * theta)
    flux = np.real(lines[:, kept] @ turned)
    return np.asarray(flux / np.max(np.abs(machine.flux)), dtype=np.float64)


# 1 N m at 750 rpm, the shaft held.
STEADY = Scenario(
    _STEADY,
    "torque",
    constant(BENCH_TORQUE),
    shaft=constant(BENCH_SPEED),
    inverter="switched",
    omega_m=BENCH_SPEED,
)

# The same without switching and dead time.
AVERAGED = replace(STEADY, inverter="averaged", dead_time=0.0)
TAIL = 1.0 - _TAIL / _STEADY  # Share of a steady run from which on it is judged.


# 750 rpm, free shaft, 0 to 1 N m of load.
_LOAD_STEP = Scenario(
    _STEP_END,
    "speed",
    constant(BENCH_SPEED),
    load=Profile((0.0, _STEP_AT), (0.0, BENCH_TORQUE)),
    omega_m=BENCH_SPEED,
)


def _asked(found: Simulation, case: LoopCase, count: int) -> tuple[float, float]:
    """Zero-sequence voltage asked for in V, means over `count` samples: early, and at the end."""
    duty = found.phases.duty_legs if found.phases is not None else found.duty
    against = duty[:, 3] if case.firmware == "four-leg" else np.full(duty.shape[0], 0.5)
    if case.firmware not in ("four-leg", "split-capacitor"):
        return float("nan"), float("nan")
    asked = (np.mean(duty[:, :3], axis=1) - against) * found.v_dc
    early = asked.size // 4
    return float(np.mean(asked[early - count : early])), float(np.mean(asked[-count:]))


def _curves(machine: PhaseMachine, steady: Simulation, step: Simulation, count: int) -> LoopCurves:
    """The last electrical period, from the first sample behind theta = 0."""
    assert steady.phases is not None
    assert step.phases is not None
    theta = np.mod(steady.theta_e, 2.0 * np.pi)
    first = int(np.flatnonzero(np.diff(theta[: theta.size - count]) < 0.0)[-1]) + 1
    chosen = slice(first, first + count)
    angle, phases = theta[chosen], np.ascontiguousarray(steady.phases.i_phases[chosen].T)
    shape = _shape_at(machine, angle)
    late = step.t >= _STEP_AT - 0.01
    return LoopCurves(
        theta=angle,
        dqy=to_frame("dqy", angle, shape, phases, scaled=True),
        dqx=to_frame("dqx", angle, shape, phases, scaled=True),
        stationary=to_frame("alphabeta0", angle, shape, phases),
        phase_a=phases[0],
        time=step.t[late] - _STEP_AT,
        torque=step.phases.torque_mean[late],
        speed=step.omega_m[late],
    )


def run_case(case: LoopCase) -> LoopRun:
    """Compile a case's controller into its circuit and run it.

    Raises:
        VerificationError: There is no compiler.
        NoSolutionError: The currents leave all bounds.
    """
    design, machine = case_design(case), bench_machine()
    headers = controller_files(case, design, machine)
    settings = design.control.speed_loop
    assert settings is not None
    drive = Drive(design.machine, design.inverter, design.control.t_s, settings.ratio, machine)
    with simulator(headers, design.export.prefix, topology=case.firmware) as made:
        # Its C drives the legs of another circuit on purpose.
        program = replace(made, topology=case.plant)
        averaged = simulate(program, drive, AVERAGED, stride=1000, tail=TAIL)
        steady = simulate(program, drive, STEADY, tail=TAIL)
        step = simulate(program, drive, replace(_LOAD_STEP, inverter="switched"))
    if not (bool(steady.figures.bounded[0]) and bool(step.figures.bounded[0])):
        raise NoSolutionError(f"{case.circuit}, {case.controller}: the currents leave all bounds")
    count = round(2.0 * np.pi / (machine.pole_pairs * BENCH_SPEED * design.control.t_s))
    curves = _curves(machine, steady, step, count)
    return _read_off(case, machine, (steady, averaged), curves, count)


def _read_off(
    case: LoopCase,
    machine: PhaseMachine,
    runs: tuple[Simulation, Simulation],
    curves: LoopCurves,
    count: int,
) -> LoopRun:
    """``runs``: switched and averaged; ``count`` samples are an electrical period."""
    steady, averaged = runs
    figures, zero, i_qy = steady.figures, curves.stationary[2], curves.dqy[1]
    copper = sum(
        float(part[0])
        for part in (figures.tail_copper_a, figures.tail_copper_b, figures.tail_copper_c)
    )
    lowest = int(np.argmin(curves.speed))
    return LoopRun(
        case=case,
        torque=float(figures.tail_torque[0]),
        ripple_means=float(figures.tail_ripple_means[0]),
        ripple=float(figures.tail_ripple[0]),
        ripple_averaged=float(averaged.figures.tail_ripple_means[0]),
        neutral_rms=float(figures.tail_neutral_rms[0]),
        zero_rms=float(figures.tail_neutral_rms[0]) / 3.0**0.5,
        zero_third=float(spectrum(zero[np.newaxis])[0][0, 3]),
        i_qy=(float(np.mean(i_qy)), float(np.min(i_qy)), float(np.max(i_qy))),
        phase_rms=float(np.sqrt(copper / (3.0 * machine.r_s))),
        copper=copper,
        asked=_asked(steady, case, count),
        dip=BENCH_SPEED - float(curves.speed[lowest]),
        dip_after=float(curves.time[lowest]),
        curves=curves,
    )


def run_loops() -> ClosedLoops:
    """All cases; raises as `run_case`."""
    # The work is that of other processes: compilers and simulations.
    with ThreadPoolExecutor(_WORKERS) as pool:
        runs = pool.map(run_case, CASES)
        led = pool.submit(run_led)
        return ClosedLoops(tuple(runs), led.result())


# The closed loops of Figures 6.9 to 6.18 of paper 002: circuits and controllers, with the C
# that is emitted for each.
#
# Here the controllers of the thesis run where no design lets them: dqy on a neutral between diodes.
# Its three phases are then modulated each for itself against half the link, as the thesis says of
# that circuit ("each phase works by itself"); the emitted C is that of a split link whose midpoint
# does not move, on the plant with the diodes.

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
_OPEN, _ISOLATED = "open winding (5.1 b)", "open, two links (5.1 a)"

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
        "open_decoupled", _OPEN, "dqy, decoupled", "six-leg", "six-leg", "dqy", "measured",
    ),
    LoopCase(
        "isolated_dqx", _ISOLATED, "dqx, references", "six-leg-isolated", "six-leg-isolated", "dqx",
        "references",
    ),
    LoopCase(
        "star_table", "star", "dqx table, harmonics", "three-wire", "three-wire", "table",
        "references", harmonics=True,
    ),
)  # fmt: skip


# What the thesis leaves to others (its chapter 7): dqy without an encoder, by the flux observer of
# the design, from this speed on in rpm.
_LED = ("encoder", "observer")
_OBSERVED_FROM = 300.0
_SETTINGS = (
    "control.observer={method: flux}",
    "control.current_loop.bandwidth=500 Hz",
    "control.current_loop.frame=dqy",
    "control.current_loop.feedforward=measured",
)


def run_led() -> tuple[LedRun, ...]:
    """Run the shipped drive's dqy, led by the encoder and by the observer.

    Raises:
        VerificationError: There is no compiler.
    """
    design = _with_speed_loop(catalogue.load(DESIGN_NAME, _SETTINGS))
    solution = solve_control(design)
    return tuple(_led_by(solution, led_by) for led_by in _LED)


def _led_by(solution: Solution, led_by: str) -> LedRun:
    observed = Sensorless(_OBSERVED_FROM * RPM, 0.8 * _OBSERVED_FROM * RPM)
    scenario = replace(_LOAD_STEP, sensorless=None if led_by == "encoder" else observed)
    design = replace(solution.design, simulation=scenario)
    run = simulate_design(design, solution=solution).run
    error = angle_error(run)
    kept = run.t >= _STEP_AT - 0.01
    last = run.t >= _STEP_END - 0.1
    means = run.torque[last]
    return LedRun(
        led_by=led_by,
        mean=float(np.mean(means)),
        ripple=float(np.ptp(means)),
        bias=float(np.mean(error[last])),
        swing=float(np.ptp(error[last])),
        dip=BENCH_SPEED - float(np.min(run.omega_m[kept])),
        time=run.t[kept] - _STEP_AT,
        torque=run.torque[kept],
        speed=run.omega_m[kept],
        angle_error=error[kept],
    )


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
        torque_max=torque_per_ampere(machine.pole_pairs, machine.psi_pm) * machine.i_max,
        # The midpoint is half of a link that does not move: nothing is balanced, nothing fades.
        midpoint=MidpointGains(0.0, 0.0) if TOPOLOGIES[case.firmware].midpoint else None,
    )


def case_design(case: LoopCase) -> Design:
    """The shipped design on the circuit of a case, with a speed loop."""
    design = _with_speed_loop(catalogue.load(DESIGN_NAME))
    return replace(design, inverter=replace(design.inverter, topology=case.plant))


def _with_speed_loop(design: Design) -> Design:
    inertia = design.machine.inertia
    assert inertia is not None
    kp = inertia * SPEED_BANDWIDTH
    speed = SpeedLoopSettings(method="given", kp=kp, ki=0.25 * kp * SPEED_BANDWIDTH)
    return replace(design, control=replace(design.control, speed_loop=speed))


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


# The closed loops of paper 002 in tables: the circuit of the thesis beside others.

_TITLE = "Paper 002, Figures 6.9 to 6.17 with the emitted C in the loop: 750 rpm, 1 N m"


def _row(run: LoopRun) -> tuple[str, ...]:
    _, least, largest = run.i_qy
    return (
        run.case.circuit,
        run.case.controller,
        run.case.shown or "-",
        f"{run.torque:.3f}",
        f"{100.0 * run.ripple_averaged:.2f}",
        f"{100.0 * run.ripple_means:.2f}",
        f"{100.0 * run.ripple:.0f}",
        f"{least:.2f} to {largest:.2f}",
        f"{run.neutral_rms:.3f}",
        f"{run.zero_third:.3f}",
        f"{run.phase_rms:.3f}",
    )


def _currents(runs: tuple[LoopRun, ...]) -> Table:
    return Table(
        _TITLE,
        (
            "circuit",
            "controller",
            "Figure",
            "T N m",
            "p-p %, averaged",
            "p-p %, per PWM period",
            "p-p %, with PWM",
            "i_qy A",
            "i_n A r.m.s.",
            "i_0, order 3 A",
            "i_a A r.m.s.",
        ),
        tuple(_row(run) for run in runs),
        (
            "dqy runs on diodes on purpose: designs refuse it there. Averaged: no dead time.",
            "Torque ripple p-p of 1 N m: averaged inverter; means of PWM periods; every instant.",
            f"Dead time 1 us (inferred); {BANDWIDTH:.0f} Hz per axis (chosen: none are printed).",
        ),
    )


def _path(path: DiodePath, runs: tuple[LoopRun, ...]) -> Table:
    rows = tuple(
        (
            f"{run.case.circuit}, {run.case.controller}",
            f"{run.neutral_rms:.3f}",
            _requested(run.asked),
        )
        for run in runs
        if run.case.frame != "dqx" and run.case.plant != "three-wire"
    )
    return Table(
        "Paper 002, Figures 6.13 and 6.15: the neutral current, and why Figure 5.4 cannot carry it",
        ("", "i_n A r.m.s.", "v_0 asked for, mean of a period, V: at 0.3 s, at 1.2 s"),
        (("by dqy at 1 N m, 750 rpm", f"{path.neutral_rms:.3f}", "-"), *rows),
        (
            "A current out of the neutral takes the upper diode: no phase voltage above 0.",
            (
                "Into it: none below 0. What dqy needs keeps that in "
                f"{100.0 * path.share:.0f} % of the period, {path.short:.0f} V beyond or more."
            ),
            "What flows is left over by the PWM; what the controller asks for grows without end.",
        ),
    )


def _requested(asked: tuple[float, float]) -> str:
    return f"{asked[0]:+.2f}, {asked[1]:+.2f}" if np.isfinite(asked[0]) else "-"


def _step(runs: tuple[LoopRun, ...]) -> Table:
    return Table(
        "Paper 002, Figure 6.18: load step from 0 to 1 N m at 750 rpm",
        ("circuit", "controller", "slowed by rpm", "after ms"),
        tuple(
            (
                run.case.circuit,
                run.case.controller,
                f"{run.dip / RPM:.1f}",
                f"{1e3 * run.dip_after:.0f}",
            )
            for run in runs
        ),
        (
            f"Inertia (inferred) and speed loop ({SPEED_BANDWIDTH:.0f} rad/s, chosen) decide it,",
            "alike with every controller: the curve of the thesis tells nothing of dqy.",
        ),
    )


def _led(led: tuple[LedRun, ...]) -> Table:
    return Table(
        "Paper 002, left to others: dqy without an encoder on four legs, load step to 1 N m",
        ("angle from", "T N m", "p-p %", "angle error deg", "p-p deg", "slowed by rpm"),
        tuple(
            (
                run.led_by,
                f"{run.mean:.3f}",
                f"{100.0 * run.ripple / BENCH_TORQUE:.2f}",
                f"{math.degrees(run.bias):+.2f}",
                f"{math.degrees(run.swing):.2f}",
                f"{run.dip / RPM:.1f}",
            )
            for run in led
        ),
        (
            f"Flux observer, from {_OBSERVED_FROM:.0f} rpm on, averaged inverter with dead time.",
            "The observer knows the fundamental alone; the other harmonics swing its angle.",
        ),
    )


def _ratios(ratios: tuple[LoopRatio, ...], closed: dict[str, float]) -> Table:
    return Table(
        "Paper 002, section 3.4: copper loss of dqx over dqy at the same constant torque",
        ("back-EMF", "closed form", "emitted C on four legs, averaged", "torques N m"),
        tuple(
            (
                row.shape,
                f"{closed[row.shape]:.4f}",
                f"{row.ratio:.4f}",
                ", ".join(f"{torque:.4f}" for torque in row.torques),
            )
            for row in ratios
        ),
    )


def loop_tables(
    loops: ClosedLoops,
    path: DiodePath,
    ratios: tuple[LoopRatio, ...],
    closed: dict[str, float],
) -> list[Table]:
    """Tables of the closed loops; ``closed`` are the loss ratios by closed form."""
    runs = loops.runs
    return [
        _currents(runs),
        _path(path, runs),
        _step(runs),
        _led(loops.led),
        _ratios(ratios, closed),
    ]


def left_out_table(reason: str) -> Table:
    """What stands in their place where nothing could be run."""
    return Table(
        _TITLE,
        notes=(f"Missing: {reason}.", "Figures 6.9 to 6.18 are then those of the definitions."),
    )


# Copper loss of dqx over dqy with the emitted C in the loop, for the shapes of Table 3.1.

_FRAMES: tuple[CurrentFrame, ...] = ("dqx", "dqy")


_NODES = 360  # as the shipped machine, with the trapezoid's corners among them


_ENOUGH = 50.0  # A


SHIPPED = "shipped drive"


@dataclass(frozen=True, slots=True)
class LoopRatio:
    """Copper loss of dqx over that of dqy of one shape on a circuit, in the loop, and the mean
    torques in N m (dqx, dqy) that were made.
    """

    shape: str
    circuit: Topology
    ratio: float
    torques: tuple[float, float]


def shaped_machines() -> dict[str, PhaseMachine]:
    """The shapes of the thesis that differ from a sine, and the shipped one, with the shipped
    windings.
    """
    # What the shapes make of the torque must not meet the current limit.
    shipped = replace(bench_machine(), i_max=_ENOUGH)
    shapes = thesis_shapes(_NODES)
    made = {
        name: replace(shipped, flux=TRAPEZOID_FLUX * shape)
        for name, shape in shapes.items()
        if name != "balanced sine"
    }
    return {**made, SHIPPED: shipped}


def _shape_bytes(flux: FloatArray) -> bytes:
    """The C structure of a back-EMF of three rows, filled up to whole doubles."""
    content = np.concatenate([flux, flux[:, :1]], axis=1).astype(np.float32).tobytes()
    return content + bytes(-len(content) % 8)


def _found(program: Simulator, scenario: Scenario, drive: Drive) -> tuple[float, float]:
    """Copper loss in W and mean torque in N m."""
    assert isinstance(drive.phases, PhaseMachine)
    run = simulate(
        program, drive, scenario, stride=1000, tail=TAIL, shape=_shape_bytes(drive.phases.flux)
    )
    figures = run.figures
    copper = figures.tail_copper_a + figures.tail_copper_b + figures.tail_copper_c
    return float(copper[0]), float(figures.tail_torque[0])


def _of_circuit(
    topology: Topology, scenario: Scenario, frame: CurrentFrame
) -> list[tuple[float, float]]:
    """Copper loss and torque of every machine with a frame on a circuit."""
    machines = shaped_machines()
    case = LoopCase("", "", "", topology, topology, frame, "references", harmonics=True)
    design = case_design(case)
    # Its phases differ: three rows, into which every other back-EMF fits.
    headers = controller_files(case, design, machines["one phase missing"])
    with simulator(headers, design.export.prefix, topology=topology) as program:
        return [
            _found(
                program,
                scenario,
                Drive(design.machine, design.inverter, design.control.t_s, 1, machine),
            )
            for machine in machines.values()
        ]


def loop_ratios(
    circuit: Topology = "four-leg", scenario: Scenario = AVERAGED
) -> tuple[LoopRatio, ...]:
    """All shapes on a circuit, by default an averaged inverter without dead time, 750 rpm, 1 N m.

    Raises:
        VerificationError: There is no compiler.
    """
    with ThreadPoolExecutor(len(_FRAMES)) as pool:
        of_x, of_y = pool.map(partial(_of_circuit, circuit, scenario), _FRAMES)
    return tuple(
        LoopRatio(name, circuit, x[0] / y[0], (x[1], y[1]))
        for name, x, y in zip(shaped_machines(), of_x, of_y, strict=True)
    )


# Why the zero-sequence current of Figures 6.13 and 6.15 of paper 002 cannot come from the circuit
# of its Figure 5.4, whose neutral returns through two diodes alone.
#
# A current out of the neutral (i_n = i_a + i_b + i_c > 0) flows through the upper diode: the
# neutral lies at the positive rail, and no leg lies above it, so that no phase voltage is above 0.
# A current into the neutral needs the lower diode, and no phase voltage below 0. Constant torque at
# least copper loss has i along the back-EMF and i_n along its sum: where i_n > 0 some phase must
# have a voltage above 0 to drive its current.


@dataclass(frozen=True, slots=True)
class DiodePath:
    """What dqy asks of a neutral at constant torque, and when two diodes could give it.

    ``neutral_rms`` in A (sum of the phases); ``share`` of the period in which the phase voltages
    that dqy needs let its neutral current flow through a diode; ``short`` in V the least by which
    the phase voltage farthest from that misses it.
    """

    neutral_rms: float
    share: float
    short: float


def diode_path(machine: PhaseMachine, torque: float, omega_m: float) -> DiodePath:
    """The path for a torque in N m and a mechanical speed in rad/s."""
    currents = torque * unit_currents(machine, "dqy")
    voltages = machine.voltage(currents, machine.pole_pairs * omega_m)
    neutral = np.sum(currents, axis=0)
    # The voltages are half a step behind the angles; so is this.
    way = np.sign(0.5 * (neutral + np.roll(neutral, -1)))
    farthest = np.max(voltages * way, axis=0)
    return DiodePath(
        float(np.sqrt(np.mean(neutral**2))),
        float(np.mean(farthest <= 0.0)),
        float(np.min(farthest)),
    )
