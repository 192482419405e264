"""Figures 8.3 to 8.28 of paper 001, drawn from the runs of its program's integers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper001.program_runs import ProgramRuns, compare_values, phase_current
from dqforge.reports.papers.transients import RPM
from dqforge.reports.simulation.recorded_run import Simulation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_POINTS = 900
Line = tuple[FloatArray, str, str]  # Values, colour, label (empty: none).


def _draw(
    axes: Axes,
    run: Simulation,
    span: tuple[float, float],
    title: str,
    unit: str,
    lines: Sequence[Line],
) -> None:
    """Lines over a span of time in s, in ms where it is short."""
    chosen = np.flatnonzero((run.t >= span[0]) & (run.t < span[1]))
    chosen = chosen[:: max(1, chosen.size // _POINTS)]
    short = span[1] - span[0] < 0.3
    time = (run.t[chosen] - span[0]) * 1e3 if short else run.t[chosen]
    for values, colour, label in lines:
        width = 0.9 if colour == MUTED else 1.1
        axes.plot(time, values[chosen], color=colour, linewidth=width, label=label or None)
    axes.set(title=title, ylabel=unit, xlabel="Time in ms" if short else "Time in s")
    if any(label for _, _, label in lines):
        axes.legend(frameon=False, loc="best", fontsize=6.5)


def _speed(axes: Axes, run: Simulation, span: tuple[float, float], title: str) -> None:
    lines = ((run.reference / RPM, MUTED, "reference"), (run.omega_m / RPM, BLUE, "speed"))
    _draw(axes, run, span, title, "rpm", lines)


def _currents(
    axes: Axes, run: Simulation, span: tuple[float, float], title: str, *, error: bool = False
) -> None:
    lines = [(run.i_q_reference, MUTED, "reference"), (run.i_q, ORANGE, "$i_q$")]
    if error:
        lines.append((run.i_q_reference - run.i_q, TEAL, "error"))
    _draw(axes, run, span, title, "A (peak)", lines)


def _angle(axes: Axes, run: Simulation, span: tuple[float, float], title: str) -> None:
    degrees = np.degrees(run.theta_e_measured) % 360.0
    _draw(axes, run, span, title, "deg (electrical)", ((degrees, BLUE, ""),))


def _phase(axes: Axes, run: Simulation, span: tuple[float, float], title: str) -> None:
    _draw(axes, run, span, title, "A", ((phase_current(run), BLUE, ""),))


def _places(rows: int) -> list[tuple[float, float, float, float]]:
    """Axes of two columns from the top down."""
    height = 0.96 / rows
    return [
        (x, 0.99 - (row + 1) * height + 0.27 * height, 0.38, 0.54 * height)
        for row in range(rows)
        for x in (0.09, 0.59)
    ]


def plot_at_1200(runs: ProgramRuns) -> Figure:
    """Figures 8.3 to 8.13: start to 1200 rpm, and 50 ms at that speed."""
    run, start, late = runs.reversal, (0.0, 1.0), (1.2, 1.25)
    counts = compare_values(run)
    with style():
        figure = new_figure("paper-001-8.3-to-8.13", 8.6, "Start to 1200 rpm and steady operation")
        axes = [figure.add_axes(place) for place in _places(5)]
        _speed(axes[0], run, start, "Figure 8.3: start to 1200 rpm")
        _phase(axes[1], run, late, "Figure 8.4: current of phase a")
        _draw(axes[2], run, late, "Figure 8.5: $i_d$", "A (peak)", ((run.i_d, BLUE, ""),))
        _draw(axes[3], run, late, "Figure 8.6: $i_q$", "A (peak)", ((run.i_q, ORANGE, ""),))
        _currents(axes[4], run, start, "Figures 8.7 to 8.9: the start", error=True)
        _currents(axes[5], run, late, "Figures 8.7 to 8.9: steady", error=True)
        _draw(
            axes[6],
            run,
            late,
            "Figure 8.10: reference of $v_\u03b1$",
            "V",
            ((run.v_alpha, BLUE, ""),),
        )
        _angle(axes[7], run, late, "Figure 8.11: position of the rotor")
        _draw(axes[8], run, late, "Figure 8.12: CMPR1", "of 2949", ((counts[:, 0], BLUE, ""),))
        _draw(
            axes[9],
            run,
            late,
            "Figure 8.13: CMPR1 - CMPR2",
            "counts",
            ((counts[:, 0] - counts[:, 1], BLUE, ""),),
        )
    return figure


def plot_climbs(runs: ProgramRuns) -> Figure:
    """Figures 8.14 to 8.20: 2700 rpm, and from 1200 to 2200 rpm."""
    run, late, climb = runs.climb, (2.2, 2.25), (0.3, 1.3)
    with style():
        figure = new_figure("paper-001-8.14-to-8.20", 7.0, "2700 rpm, and from 1200 to 2200 rpm")
        axes = [figure.add_axes(place) for place in _places(4)]
        lines = (
            (run.reference / RPM, MUTED, "reference"),
            (run.omega_m / RPM, BLUE, "without limit of $v_q$"),
            (runs.limited.omega_m / RPM, TEAL, "with 13000"),
        )
        _draw(axes[0], run, climb, "Figure 8.14: to 2700 rpm", "rpm", lines)
        _phase(axes[1], run, late, "Figure 8.15: current of phase a")
        _currents(axes[2], run, late, "Figure 8.16: $i_q$ and its reference")
        _angle(axes[3], run, late, "Figure 8.17: position of the rotor")
        _speed(axes[4], runs.middle, climb, "Figure 8.18: from 1200 to 2200 rpm")
        _phase(axes[5], runs.middle, (0.45, 0.7), "Figure 8.19: current of phase a")
        _draw(
            axes[6],
            runs.middle,
            (0.45, 0.7),
            "Figure 8.20: reference of $v_\u03b1$",
            "V",
            ((runs.middle.v_alpha, BLUE, ""),),
        )
        _currents(axes[7], runs.middle, climb, "its $i_q$ and reference")
    return figure


def plot_reversal(runs: ProgramRuns) -> Figure:
    """Figures 8.21 to 8.28: the reversal, the sine and the steps."""
    run, whole, turn = runs.reversal, (1.3, 2.3), (1.45, 1.7)
    with style():
        figure = new_figure("paper-001-8.21-to-8.28", 7.0, "Reversal, sine and steps of the speed")
        axes = [figure.add_axes(place) for place in _places(4)]
        _speed(axes[0], run, whole, "Figure 8.21: reversal")
        _phase(axes[1], run, turn, "Figures 8.22, 8.23: current of phase a")
        _currents(axes[2], run, whole, "Figure 8.24: $i_q$ and its reference")
        _draw(axes[3], run, whole, "Figure 8.25: $i_d$", "A (peak)", ((run.i_d, BLUE, ""),))
        _angle(axes[4], run, turn, "Figure 8.26: position of the rotor")
        _speed(axes[5], runs.sine, (1.0, 3.0), "Figure 8.27: sine reference")
        _speed(axes[6], runs.steps, (0.9, 3.0), "Figure 8.28: steps of 500 rpm")
        _currents(axes[7], runs.steps, (0.9, 3.0), "its $i_q$ and reference")
    return figure
