"""Figures of the pages on loops and the observer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.loops.loop_gains import analyse_current_loop, current_step_response
from dqforge.optimizer.observers.reduced_order import steady_state_error
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, new_figure, save, style

_METHODS_HZ = {"crossover at 1/30 of the sampling rate": 30.0, "1/12": 12.0, "1/8": 8.0}


@style()
def current_loop_step(path: Path) -> None:
    """Step of i_q of paper 001's machine for three bandwidths, and the phase margin each has
    left.
    """
    design = catalogue.load("paper001-pmsm-bench")
    machine, t_s = design.machine, design.control.t_s
    figure = new_figure(
        "current-loop-step", 2.9, "Step of the q current for three bandwidths", arranged=True
    )
    axes = figure.add_subplot()
    for label, ratio in _METHODS_HZ.items():
        omega = 2.0 * np.pi / (ratio * t_s)
        gains = analyse_current_loop(
            machine.r_s, machine.l_q, t_s, omega * machine.l_q, omega * machine.r_s, "bandwidth"
        )
        step = current_step_response(machine.r_s, machine.l_q, gains, 50 * t_s)
        margin = np.degrees(gains.phase_margin)
        axes.step(
            step.times * 1e3,
            step.reference,
            where="post",
            label=f"{label}: {margin:.0f} deg phase margin",
        )
    axes.axhline(1.0, color=MUTED, linewidth=0.8)
    axes.set(
        xlabel="Time in ms", ylabel="$i_q$ in A after a step of 1 A", xlim=(0.0, 50 * t_s * 1e3)
    )
    axes.legend(loc="lower right")
    save(figure, path)


@style()
def observer_error(path: Path) -> None:
    """Steady speed error of the observer of paper 001 over load, for a resistance
    that is right or 30 % wrong.
    """
    design = catalogue.load("paper001-pmsm-bench")
    machine, t_s = design.machine, design.control.t_s
    omega = 1500.0 * np.pi / 30.0
    load = np.linspace(0.0, 0.47, 20)
    figure = new_figure(
        "observer-error", 2.9, "Speed error of the observer over load", arranged=True
    )
    axes = figure.add_subplot()
    for label, error in (("R right", 0.0), ("R + 30 %", 0.3), ("R - 30 %", -0.3)):
        percent = [
            100.0
            * steady_state_error(
                machine, 900.0, t_s, omega, torque_load=float(t), r_error=error
            ).relative
            for t in load
        ]
        axes.plot(load, percent, label=label)
    axes.axhline(0.0, color=MUTED, linewidth=0.8)
    axes.set(xlabel="Load torque in N m", ylabel="Speed error in % at 1500 rpm", xlim=(0.0, 0.47))
    axes.legend()
    save(figure, path)


@style()
def gain_schedule(path: Path) -> None:
    """Crossover and phase margin of both axes of a saturated reluctance machine,
    with constant and scheduled gains.
    """
    design = catalogue.load("abb-syrm-6k7-saturated")
    settings = CurrentLoopSettings("optimised", schedule=True)
    control = replace(design.control, current_loop=settings, speed_loop=None)
    schedule = solve_gains(replace(design, control=control)).schedule
    if schedule is None:
        raise ValueError("the design asks for a schedule")
    figure = new_figure(
        "gain-schedule", 2.9, "Crossover and phase margin over the current", arranged=True
    )
    left, right = figure.subplots(1, 2)
    for axis, colour in zip(schedule.axes, (BLUE, ORANGE), strict=True):
        for name, margins, dashes in (
            ("scheduled", axis.scheduled, "-"),
            ("constant", axis.constant, "--"),
        ):
            label = f"${axis.axis}$, {name}"
            left.plot(
                schedule.i_q, margins.crossover / (2.0 * np.pi), dashes, color=colour, label=label
            )
            right.plot(
                schedule.i_q,
                np.degrees(np.abs(margins.phase_margin)),
                dashes,
                color=colour,
                label=label,
            )
    left.set(xlabel="$i_q$ in A along the MTPA locus", ylabel="Crossover in Hz", ylim=(0.0, None))
    right.set(
        xlabel="$i_q$ in A along the MTPA locus", ylabel="Phase margin in deg", ylim=(0.0, None)
    )
    right.legend(loc="lower right")
    save(figure, path)
