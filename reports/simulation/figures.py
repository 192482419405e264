"""Figure of a simulation: speed, torque, currents and duty cycles over time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import (
    AXIS_COLOURS,
    BLUE,
    FAINT,
    INK,
    MUTED,
    ORANGE,
    PALE,
    TEAL,
    new_figure,
    style,
    thinned,
)
from dqforge.reports.simulation.design_run import DriveSimulation
from dqforge.reports.simulation.recorded_run import Simulation, StartRecord
from dqforge.reports.simulation.start_figures import spans

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_RPM = 30.0 / math.pi
_PHASES = (("a", BLUE), ("b", ORANGE), ("c", TEAL))


def _line(
    axes: Axes, time: FloatArray, value: FloatArray, colour: str, label: str, width: float = 1.2
) -> None:
    axes.plot(*thinned(time, value, 600), color=colour, linewidth=width, label=label)


def _reference(axes: Axes, time: FloatArray, value: FloatArray, label: str = "reference") -> None:
    axes.plot(
        *thinned(time, value, 600), color=INK, linewidth=0.8, linestyle=(0, (3.0, 2.0)), label=label
    )


def _angle(axes: Axes, time: FloatArray, found: DriveSimulation) -> None:
    """Error of the observed angle; a bar on top where the controller ran on it."""
    _line(axes, time, np.degrees(found.angle_error), BLUE, "error of the observed angle", 0.9)
    run = found.run
    if run.scenario.sensorless is not None:
        edges = np.flatnonzero(np.diff(run.sensorless > 0.5, prepend=False, append=False))
        for number, (start, end) in enumerate(edges.reshape(-1, 2)):
            name = "control without encoder"
            axes.axvspan(
                float(time[start]), float(time[end - 1]), color=FAINT, alpha=0.35, linewidth=0.0,
                label=f"_{name}" if number else name, zorder=0,
            )  # fmt: skip
    axes.set_ylabel("Angle error in deg")


def _currents(axes: Axes, time: FloatArray, run: Simulation) -> None:
    """Currents in d and q with their references; of phase machines those of phases and neutral."""
    axes.set_ylabel("Currents in A")
    if run.phases is not None:
        for k, (phase, colour) in enumerate(_PHASES):
            _line(axes, time, run.phases.i_phases[:, k], colour, phase, 0.9)
        if np.any(run.phases.i_neutral):
            _line(axes, time, run.phases.i_neutral, MUTED, "neutral", 0.9)
        return
    for axis, value, wanted in (
        ("d", run.i_d, run.i_d_reference),
        ("q", run.i_q, run.i_q_reference),
    ):
        _line(axes, time, value, AXIS_COLOURS[axis], f"$i_{axis}$")
        _reference(axes, time, wanted, ("" if axis == "q" else "_") + f"reference of $i_{axis}$")


def _duties(axes: Axes, time: FloatArray, run: Simulation) -> None:
    """Duty cycles of the three legs, and of a fourth one where the neutral has it."""
    for k, (phase, colour) in enumerate(_PHASES):
        _line(axes, time, run.duty[:, k], colour, phase, 0.7)
    if run.phases is not None and run.phases.duty_legs.shape[1] == len(_PHASES) + 1:
        _line(axes, time, run.phases.duty_legs[:, 3], MUTED, "neutral", 0.7)
    axes.set(ylabel="Duty cycles", ylim=(-0.02, 1.02))


def _midpoint(axes: Axes, time: FloatArray, voltage: FloatArray) -> None:
    _line(axes, time, voltage, BLUE, "midpoint of the link", 0.9)
    axes.set_ylabel("Voltage in V")


def _states(axes: Axes, time: FloatArray, record: StartRecord) -> None:
    """What a start without encoder is doing, as bands behind the speed."""
    for number, (name, start, end) in enumerate(spans(record)):
        low, high = float(time[start]), float(time[min(end, time.size - 1)])
        axes.axvspan(
            low, high, color=FAINT, alpha=0.3 * (number % 2), linewidth=0.0, zorder=0,
            label=f"_{name}",
        )  # fmt: skip
        if high - low > 0.04 * float(time[-1]):
            axes.text(
                low, 0.03, f" {name}", transform=axes.get_xaxis_transform(), fontsize=6.0,
                color=MUTED, ha="left", va="bottom",
            )  # fmt: skip


def plot_simulation(found: DriveSimulation) -> Figure:
    """Speed, torque, currents and duty cycles, with their references where they have some."""
    run = found.run
    factor, unit = (1e3, "ms") if run.t[-1] < 0.5 else (1.0, "s")
    time = run.t * factor
    with style():
        seen = found.observed
        angle = seen is not None and seen.angle_rms is not None
        split = run.phases is not None and bool(np.isfinite(run.phases.v_midpoint).all())
        ratios = (1.3, 1.0, 1.3, *(0.8,) * (angle + split), 0.9)
        figure = new_figure(
            "simulation",
            6.6 + 1.3 * (angle + split),
            "Speed, torque, currents and duty cycles of the simulated drive",
        )
        axes = figure.subplots(len(ratios), 1, sharex=True, height_ratios=ratios)
        speed, torque, currents, duty = axes[0], axes[1], axes[2], axes[-1]
        if angle:
            _angle(axes[3], time, found)
        if split and run.phases is not None:
            _midpoint(axes[-2], time, run.phases.v_midpoint)
        _line(speed, time, run.omega_m * _RPM, TEAL, "speed")
        if run.start is not None:
            _states(speed, time, run.start)
        if seen is not None:
            _line(speed, time, run.omega_m_observed * _RPM, ORANGE, "observed", 0.7)
        elif run.scenario.encoder.speed != "exact" and run.scenario.encoder.lines > 0:
            _line(speed, time, run.omega_m_measured * _RPM, PALE, "measured", 0.7)
        speed.set_ylabel("Speed in rpm")
        _line(torque, time, run.torque, ORANGE, "torque")
        _line(torque, time, run.torque_load, MUTED, "load", 0.9)
        torque.set_ylabel("Torque in N m")
        _currents(currents, time, run)
        _duties(duty, time, run)
        duty.set(xlabel=f"Time in {unit}", xlim=(0.0, float(time[-1])))
        wanted_of = {"speed": (speed, run.reference * _RPM), "torque": (torque, run.reference)}
        if run.scenario.mode in wanted_of:
            _reference(wanted_of[run.scenario.mode][0], time, wanted_of[run.scenario.mode][1])
        for panel in axes:
            panel.legend(frameon=False, loc="upper right", ncols=5, fontsize=7.0)
            low, high = panel.get_ylim()
            if panel is not duty and np.isfinite(high - low):
                panel.set_ylim(low, high + 0.18 * (high - low))  # room for the legend
        figure.align_ylabels(axes)
        figure.subplots_adjust(left=0.1, right=0.985, top=0.985, bottom=0.065, hspace=0.14)
    return figure
