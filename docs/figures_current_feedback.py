"""Figures of docs/current-feedback-pwm.md: the three regulators on the bench drive of paper 001."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.plants.current_feedback import (
    Hysteresis,
    Predictive,
    RampComparison,
    Scheme,
    hysteresis_frequency,
    simulate_currents,
)
from dqforge.machines.plants.current_trace import CurrentTrace
from dqforge.machines.plants.fed_machine import BridgeDrive

BAND = 0.4
SCHEMES: dict[str, tuple[Scheme, str]] = {
    "hysteresis, 0.4 A": (Hysteresis(BAND), "#1d4ed8"),
    "ramp comparison, 10 kHz": (RampComparison(3.0, 1500.0, 10e3), "#d97706"),
    "predictive, 20 us": (Predictive(20e-6), "#047857"),
}
I_Q = 3.0
OMEGA_M = 1200.0 * math.pi / 30.0


def drive() -> BridgeDrive:
    """The bench of paper 001."""
    design = catalogue.load("paper001-pmsm-bench")
    return BridgeDrive(linearised(design.machine), design.inverter.v_dc)


def regulators(path: Path) -> None:
    """Draw current and error of a phase and the spectrum for each regulator, as an SVG."""
    figure = Figure(figsize=(9.6, 7.2), layout="constrained")
    for row, (label, (scheme, colour)) in zip(figure.subplots(3, 3), SCHEMES.items(), strict=True):
        trace = simulate_currents(drive(), scheme, 0.0, I_Q, OMEGA_M, settling=2)
        _draw_run(row, trace, colour)
        frequency = trace.switching_frequency().average[0]
        row[0].set_title(f"{label}: {frequency / 1e3:.1f} kHz", fontsize="small")
        row[1].set_title(f"error, r.m.s. {trace.rms_error()[0]:.2f} A", fontsize="small")
        row[2].set_title(
            f"spectrum, distortion {100.0 * trace.current_thd()[0]:.1f} %", fontsize="small"
        )
    _save(figure, path)


def _draw_run(row: list[Axes], trace: CurrentTrace, colour: str) -> None:
    current_axes, error_axes, spectrum_axes = row
    start, period = trace.time[0, 0], trace.duration[0]
    time = start + np.linspace(0.0, period, 1600)
    current, reference = trace.phase_currents(0, time)[:, 0], trace.references(0, time)[:, 0]
    elapsed = 1e3 * (time - start)
    current_axes.plot(elapsed, current, color=colour, linewidth=0.7)
    current_axes.plot(elapsed, reference, color="#111827", linewidth=0.7, linestyle="--")
    current_axes.set_ylabel("phase a in A")
    error_axes.plot(elapsed, current - reference, color=colour, linewidth=0.6)
    for level, style in ((BAND, ":"), (2.0 * BAND, "--")):
        error_axes.axhline(level, color="#9ca3af", linestyle=style)
        error_axes.axhline(-level, color="#9ca3af", linestyle=style)
    error_axes.set_ylim(-2.6 * BAND, 2.6 * BAND)
    error_axes.set_ylabel("A")
    orders = np.arange(2, 451)
    lines = np.abs(trace.spectrum(orders)[:, 0, 0])
    kilohertz = orders * trace.plant.omega_e[0] / (2.0e3 * math.pi)
    spectrum_axes.vlines(kilohertz, 0.0, lines, color=colour, linewidth=0.7)
    spectrum_axes.set_ylim(0.0, 0.15)
    spectrum_axes.set_ylabel("A (peak)")
    for axes in (current_axes, error_axes):
        axes.set_xlabel("time in ms")
        axes.grid(alpha=0.3)
    spectrum_axes.set_xlabel("kHz")
    spectrum_axes.grid(alpha=0.3)


def hysteresis_over_speed(path: Path) -> None:
    """Draw the switching frequency of hysteresis over speed, simulated and by the formula,
    as an SVG.
    """
    figure = Figure(figsize=(6.4, 3.8), layout="constrained")
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
        color="#1d4ed8",
        alpha=0.15,
        label="range, isolated",
    )
    axes.plot(rpm, found.average / 1e3, "o-", color="#1d4ed8", label="average, isolated star point")
    voltage = np.hypot(*machine.voltage(0.0 * fine, 0.0 * fine + I_Q, machine.pole_pairs * fine))
    formula = hysteresis_frequency(isolated.v_dc, inductance, BAND, voltage / math.sqrt(2.0))
    axes.plot(
        fine * 30.0 / math.pi,
        formula / 1e3,
        "--",
        color="#111827",
        label="average, star point tied (formula)",
    )
    axes.set_xlabel("speed in rpm")
    axes.set_ylabel("switching frequency in kHz")
    axes.set_ylim(0.0, None)
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    """Write the same bytes every time: no date, ids from a fixed salt, text as text."""
    with mpl.rc_context({"svg.hashsalt": "dqforge", "svg.fonttype": "none"}):
        figure.savefig(path, format="svg", metadata={"Date": None})
