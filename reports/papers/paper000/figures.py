"""Figure 5 of paper 000: speed, torque and currents under a growing load."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.paper000.load_test import LoadTest

if TYPE_CHECKING:
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
