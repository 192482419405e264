"""Figures 6.9 to 6.18 of paper 002 with the emitted C in the loop, every switching instant
simulated: the circuit of the thesis beside circuits that can carry its neutral current.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.phase_machines.frame_transforms import to_frame
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.plants.scenario import Profile, Scenario, constant
from dqforge.machines.records import dataclass
from dqforge.optimizer.waveforms.phase_currents import spectrum
from dqforge.reports.papers.paper002_definitions.bench_currents import BENCH_TORQUE, bench_machine
from dqforge.reports.papers.paper002_loops.loop_cases import (
    CASES,
    LoopCase,
    case_design,
    controller_files,
)
from dqforge.reports.simulation.compiled_plant import Simulator, simulate, simulator
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulation

RPM = np.pi / 30.0
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
class ClosedLoops:
    """All cases, as `CASES`."""

    runs: tuple[LoopRun, ...]


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


def _load_step(program: Simulator, drive: Drive) -> Simulation:
    """750 rpm, free shaft, 0 to 1 N m of load."""
    scenario = Scenario(
        _STEP_END,
        "speed",
        constant(BENCH_SPEED),
        load=Profile((0.0, _STEP_AT), (0.0, BENCH_TORQUE)),
        inverter="switched",
        omega_m=BENCH_SPEED,
    )
    return simulate(program, drive, scenario)


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
        steady, step = simulate(program, drive, STEADY, tail=TAIL), _load_step(program, drive)
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
        return ClosedLoops(tuple(pool.map(run_case, CASES)))
