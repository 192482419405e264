"""Figures of the papers' transients: Figure 5 of paper 000, Figures 8.3 to 8.31 of paper 001."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper000_transient import LoadTest
from dqforge.reports.papers.paper001 import Runs
from dqforge.reports.papers.transients import RPM

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = (ORANGE, BLUE, TEAL)


_POINTS = 600


def _every(size: int) -> slice:
    return slice(None, None, max(1, size // _POINTS))


def plot_load_tests(tests: tuple[LoadTest, ...]) -> Figure:
    """Speed, torque and currents of the three alternatives over 6 s."""
    with style():
        figure = new_figure(
            "paper-000-figure-5", 4.8, "Speed, torque and currents under a growing load"
        )
        places = ((0.09, 0.58), (0.585, 0.58), (0.09, 0.1), (0.585, 0.1))
        speed, torque, i_d, size = (figure.add_axes((x, y, 0.39, 0.33)) for x, y in places)
        for place, (test, colour) in enumerate(zip(tests, _COLOURS, strict=True)):
            run = test.run
            few = _every(run.t.size)
            dashes: Any = (0, (3.0, 2.0)) if place == 2 else "-"
            for axes, values in (
                (speed, run.omega_m),
                (torque, run.torque),
                (i_d, run.i_d),
                (size, np.hypot(run.i_d, run.i_q)),
            ):
                axes.plot(run.t[few], values[few], color=colour, linestyle=dashes, label=test.name)
        few = _every(tests[0].run.t.size)
        torque.plot(
            tests[0].run.t[few],
            tests[0].run.torque_load[few],
            color=MUTED,
            linewidth=0.8,
            label="load",
        )
        speed.set(title="Speed", ylabel="rad/s", ylim=(270.0, 310.0))
        torque.set(title="Torque and load", ylabel="N m", ylim=(0.0, 180.0))
        i_d.set(title="$i_d$", ylabel="A (peak)", ylim=(-150.0, 20.0))
        size.set(title="Magnitude of the current", ylabel="A (peak)", ylim=(0.0, 260.0))
        for axes in (speed, torque, i_d, size):
            axes.set(xlim=(0.0, 6.0), xlabel="Time in s")
        size.legend(frameon=False, loc="upper left", fontsize=6.5)
        torque.legend(frameon=False, loc="upper left", fontsize=6.5)
    return figure


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
