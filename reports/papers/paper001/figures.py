"""Figures 8.3 to 8.32 of paper 001: transients of the bench."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper001.bench_transients import Runs
from dqforge.reports.papers.transients import RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _speed(
    axes: Axes, title: str, run_t: FloatArray, reference: FloatArray, omega: FloatArray
) -> None:
    axes.plot(run_t, reference, color=MUTED, linewidth=0.9, label="reference")
    axes.plot(run_t, omega, color=BLUE, label="speed")
    axes.set(title=title, ylabel="rpm", xlabel="Time in s")


def plot_bench(runs: Runs) -> Figure:
    """Start and reversal, sine and step references, and the starts without sensor."""
    with style():
        figure = new_figure(
            "paper-001-chapter-8", 8.4, "Transients of the bench with the emitted controller"
        )
        places = tuple((x, y) for y in (0.785, 0.54, 0.295, 0.05) for x in (0.1, 0.6))
        first, second, third, fourth, fifth, sixth, seventh, eighth = (
            figure.add_axes((x, y, 0.38, 0.17)) for x, y in places
        )
        run = runs.reversal
        _speed(
            first,
            "Figures 8.3, 8.21: start, reversal",
            run.t,
            run.reference / RPM,
            run.omega_m / RPM,
        )
        second.plot(run.t, run.i_q_reference, color=MUTED, linewidth=0.9, label="reference")
        second.plot(run.t, run.i_q, color=ORANGE, label="$i_q$")
        second.plot(run.t, run.i_d, color=BLUE, linewidth=0.8, label="$i_d$, not controlled")
        second.set(
            title="Figure 8.24: currents of it",
            ylabel="A (peak)",
            xlabel="Time in s",
            ylim=(-1.2, 1.2),
        )
        run = runs.sine
        _speed(third, "Figure 8.27: sine reference", run.t, run.reference / RPM, run.omega_m / RPM)
        run = runs.steps
        _speed(
            fourth, "Figure 8.28: steps of 500 rpm", run.t, run.reference / RPM, run.omega_m / RPM
        )
        run = runs.sensorless
        _speed(
            fifth,
            "Figure 8.31: speed from the observer",
            run.t,
            run.reference / RPM,
            run.omega_m / RPM,
        )
        fifth.plot(
            run.t,
            run.omega_m_measured / RPM,
            color=TEAL,
            linewidth=0.8,
            linestyle="dashed",
            label="estimate",
        )
        sixth.plot(run.t, (run.omega_m_measured - run.omega_m) / RPM, color=TEAL)
        sixth.set(title="Its error", ylabel="rpm", xlabel="Time in s")
        run = runs.estimator
        _speed(
            seventh,
            "Speed, dead time and $\\psi$ + 0.7 %",
            run.t,
            run.reference / RPM,
            run.omega_m / RPM,
        )
        seventh.plot(
            run.t,
            run.omega_m_observed / RPM,
            color=TEAL,
            linewidth=0.8,
            linestyle="dashed",
            label="estimate",
        )
        late = run.t >= run.t[-1] - 0.03
        time = (run.t[late] - run.t[-1]) * 1e3
        for angle, colour, label in (
            (run.theta_e, BLUE, "rotor"),
            (run.theta_e_observed, TEAL, "estimate"),
        ):
            eighth.plot(time, np.degrees(angle[late]), color=colour, linewidth=0.9, label=label)
        eighth.set(
            title="Figure 8.32: position, the last 30 ms",
            ylabel="deg (electrical)",
            xlabel="Time in ms",
        )
        third.set(xlim=(0.9, 3.0), ylim=(900.0, 1500.0))
        fourth.set(xlim=(0.9, 3.0), ylim=(900.0, 2100.0))
        for axes in (first, second, fifth, seventh, eighth):
            axes.legend(frameon=False, loc="best", fontsize=6.5)
    return figure


def plot_without_encoder(runs: Runs) -> Figure:
    """Figures 8.29, 8.31 to 8.33: simulated with and without estimator, and the bench on it."""
    with style():
        figure = new_figure("paper-001-without-encoder", 4.6, "With and without estimator")
        places = tuple((x, y) for y in (0.57, 0.09) for x in (0.1, 0.6))
        first, second, third, fourth = (figure.add_axes((x, y, 0.38, 0.32)) for x, y in places)
        for run, colour, label in (
            (runs.encoder, MUTED, "without estimator"),
            (runs.sensorless, BLUE, "with it"),
        ):
            first.plot(run.t, run.omega_m / RPM, color=colour, label=label)
        estimate = runs.sensorless.omega_m_measured / RPM
        first.plot(runs.sensorless.t, estimate, color=TEAL, linewidth=0.8, label="estimate")
        first.set(title="Figure 8.29: simulated start", ylabel="rpm", xlabel="Time in s")
        run = runs.estimator
        late = run.t >= run.t[-1] - 0.03
        time = (run.t[late] - run.t[-1]) * 1e3
        second.plot(time, run.omega_m[late] / RPM, color=BLUE, label="measured")
        second.plot(time, run.omega_m_observed[late] / RPM, color=TEAL, label="estimated")
        second.set(title="Figure 8.31: speed", ylabel="rpm", xlabel="Time in ms")
        for angle, colour, label in (
            (run.theta_e, BLUE, "measured"),
            (run.theta_e_observed, TEAL, "estimated"),
        ):
            third.plot(time, np.degrees(angle[late]), color=colour, linewidth=0.9, label=label)
        third.set(title="Figure 8.32: position", ylabel="deg (electrical)", xlabel="Time in ms")
        gap = np.angle(np.exp(1j * (run.theta_e - run.theta_e_observed)[late]))
        fourth.plot(time, 100.0 * gap / (2.0 * np.pi), color=ORANGE)
        fourth.set(
            title="Figure 8.33: error of the position",
            ylabel="% of an electrical turn",
            xlabel="Time in ms",
        )
        for axes in (first, second, third):
            axes.legend(frameon=False, loc="best", fontsize=6.5)
    return figure
