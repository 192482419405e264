"""Figures of docs/methods/current-feedback-pwm.md: the three regulators on the bench drive of
paper 001.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.plants.current_feedback import (
    Hysteresis,
    Predictive,
    RampComparison,
    Scheme,
    hysteresis_frequency,
    simulate_currents,
)
from dqforge.machines.plants.fed_machine import BridgeDrive, CurrentTrace
from dqforge.optimizer.current_feedback.regulator_runs import (
    METHODS,
    RegulatorRun,
    regulator_plan,
    run_regulator,
    speed_points,
)
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    save,
    style,
)
from dqforge.reports.single_headers.current_feedback import plot_regulators

BAND = 0.4
SCHEMES: dict[str, tuple[Scheme, str]] = {
    "hysteresis, 0.4 A": (Hysteresis(BAND), BLUE),
    "ramp comparison, 10 kHz": (RampComparison(3.0, 1500.0, 10e3), ORANGE),
    "predictive, 20 us": (Predictive(20e-6), TEAL),
}
I_Q = 3.0
OMEGA_M = 1200.0 * math.pi / 30.0


def drive() -> BridgeDrive:
    """The bench of paper 001."""
    design = catalogue.load("paper001-pmsm-bench")
    return BridgeDrive(linearised(design.machine), design.inverter.v_dc)


@style()
def regulators(path: Path) -> None:
    """Draw current and error of a phase and the spectrum for each regulator, as an SVG."""
    figure = new_figure(
        "current-feedback-runs",
        5.4,
        "Current, error and spectrum of three regulators",
        arranged=True,
    )
    for row, (label, (scheme, colour)) in zip(figure.subplots(3, 3), SCHEMES.items(), strict=True):
        trace = simulate_currents(drive(), scheme, 0.0, I_Q, OMEGA_M, settling=2)
        _draw_run(row, trace, colour)
        frequency = trace.switching_frequency().average[0]
        row[0].set_title(f"{label}: {frequency / 1e3:.1f} kHz", fontsize=7.0)
        row[1].set_title(f"error {trace.rms_error()[0]:.2f} A r.m.s.", fontsize=7.0)
        row[2].set_title(f"distortion {100.0 * trace.current_thd()[0]:.1f} %", fontsize=7.0)
    save(figure, path)


def _draw_run(row: list[Axes], trace: CurrentTrace, colour: str) -> None:
    current_axes, error_axes, spectrum_axes = row
    start, period = trace.time[0, 0], trace.duration[0]
    time = start + np.linspace(0.0, period, 1600)
    current, reference = trace.phase_currents(0, time)[:, 0], trace.references(0, time)[:, 0]
    elapsed = 1e3 * (time - start)
    current_axes.plot(elapsed, current, color=colour, linewidth=0.7)
    current_axes.plot(elapsed, reference, color=INK, linewidth=0.7, linestyle="--")
    current_axes.set_ylabel("Phase a in A")
    error_axes.plot(elapsed, current - reference, color=colour, linewidth=0.6)
    for level, dashes in ((BAND, ":"), (2.0 * BAND, "--")):
        error_axes.axhline(level, color=MUTED, linewidth=0.7, linestyle=dashes)
        error_axes.axhline(-level, color=MUTED, linewidth=0.7, linestyle=dashes)
    error_axes.set_ylim(-2.6 * BAND, 2.6 * BAND)
    error_axes.set_ylabel("Error in A")
    orders = np.arange(2, 451)
    lines = np.abs(trace.spectrum(orders)[:, 0, 0])
    kilohertz = orders * trace.plant.omega_e[0] / (2.0e3 * math.pi)
    spectrum_axes.vlines(kilohertz, 0.0, lines, color=colour, linewidth=0.7)
    spectrum_axes.set_ylim(0.0, 0.15)
    spectrum_axes.set_ylabel("Line in A (peak)")
    for axes in (current_axes, error_axes):
        axes.set_xlabel("Time in ms")
    spectrum_axes.set_xlabel("Frequency in kHz")


@style()
def hysteresis_over_speed(path: Path) -> None:
    """Draw the switching frequency of hysteresis over speed, simulated and by the formula,
    as an SVG.
    """
    figure = new_figure(
        "hysteresis-frequency", 3.2, "Switching frequency of hysteresis over speed", arranged=True
    )
    axes = figure.subplots()
    isolated = drive()
    machine, inductance = isolated.machine, 0.5 * (isolated.machine.l_d + isolated.machine.l_q)
    speed = np.linspace(300.0, 5400.0, 9) * math.pi / 30.0
    found = simulate_currents(isolated, Hysteresis(BAND), 0.0, I_Q, speed).switching_frequency()
    rpm, fine = speed * 30.0 / math.pi, np.linspace(speed[0], speed[-1], 200)
    axes.fill_between(
        rpm,
        found.lowest / 1e3,
        found.highest / 1e3,
        color=BLUE,
        alpha=0.15,
        label="range, isolated",
    )
    axes.plot(
        rpm,
        found.average / 1e3,
        "o-",
        color=BLUE,
        markersize=4,
        label="average, isolated star point",
    )
    voltage = np.hypot(*machine.voltage(0.0 * fine, 0.0 * fine + I_Q, machine.pole_pairs * fine))
    formula = hysteresis_frequency(isolated.v_dc, inductance, BAND, voltage / math.sqrt(2.0))
    axes.plot(
        fine * 30.0 / math.pi,
        formula / 1e3,
        "--",
        color=INK,
        label="average, star point tied (formula)",
    )
    axes.set(xlabel="Speed in rpm", ylabel="Switching frequency in kHz", ylim=(0.0, None))
    figure.legend(loc="outside upper center", ncols=3)
    save(figure, path)


def six_over_speed(path: Path) -> None:
    """Draw all regulators of a design over speed, as an SVG."""
    save(plot_regulators(compared()), path)


def compared() -> tuple[RegulatorRun, ...]:
    """All regulators on the bench drive with a switching frequency of 10 kHz, over speed."""
    design = catalogue.load("paper001-pmsm-bench")
    loop = CurrentLoopSettings(method="circle")
    design = replace(
        design,
        control=replace(design.control, current_loop=loop, observer=None, speed_loop=None),
        inverter=replace(design.inverter, f_sw=10e3),
        losses=None,
    )
    points = speed_points(design)
    return tuple(run_regulator(design, regulator_plan(design, name), points) for name in METHODS)
