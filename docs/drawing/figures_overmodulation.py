"""Figure of docs/methods/modulation.md: vectors, phase voltage and harmonics of both
methods.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from dqforge.machines.modulation.dead_time import ORDERS, voltage_harmonics
from dqforge.machines.modulation.registry import (
    HEXAGON,
    INSCRIBED,
    METHODS,
    SIX_STEP,
    overmodulated,
)
from dqforge.machines.names import OvermodulationName
from dqforge.machines.transforms import Pair
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    PALE,
    SERIES,
    new_figure,
    save,
    style,
)

_INDICES = (0.93, HEXAGON / SIX_STEP, 0.98, 1.0)


_COLOURS = (MUTED, BLUE, ORANGE, INK)


@style()
def methods(path: Path) -> None:
    """Draw what both methods make of a turning vector, and its harmonics, as an SVG."""
    figure = new_figure(
        "overmodulation",
        4.9,
        "Vectors, phases and harmonics of both methods",
        arranged=True,
    )
    for row, name in zip(figure.subplots(2, 3), METHODS, strict=True):
        _draw_angle(row[0], name)
        _draw_phase(row[1], name)
        _draw_harmonics(row[2], name)
        row[0].set_title(name)
    save(figure, path)


def _vectors(name: OvermodulationName, index: float, angle: np.ndarray) -> np.ndarray:
    asked = index * SIX_STEP * np.exp(1j * angle)
    x, y = overmodulated(name, Pair(asked.real, asked.imag), np.ones(angle.shape))
    return np.asarray(x + 1j * y)


def _draw_angle(axes: Axes, name: OvermodulationName) -> None:
    """Length and phase of the vector over 60 degrees around the middle of a side."""
    angle = np.linspace(0.0, math.pi / 3.0, 91)
    for index, colour in zip(_INDICES, _COLOURS, strict=True):
        vector = _vectors(name, index, angle)
        axes.plot(
            vector.real,
            vector.imag,
            ".",
            color=colour,
            markersize=2.5,
            label=f"{100 * index:.3g} %",
        )
    corners = 2.0 / 3.0 * np.exp(1j * np.array([0.0, math.pi / 3.0]))
    axes.plot(corners.real, corners.imag, color=PALE, linewidth=0.8, zorder=0)
    circle = INSCRIBED * np.exp(1j * angle)
    axes.plot(circle.real, circle.imag, color=PALE, linewidth=0.8, zorder=0)
    axes.set_aspect("equal")
    axes.set(xlabel="$v_\u03b1$ / $v_{dc}$", ylabel="$v_\u03b2$ / $v_{dc}$")


def _draw_phase(axes: Axes, name: OvermodulationName) -> None:
    angle = np.linspace(0.0, 2.0 * math.pi, 361)
    for index, colour in zip(_INDICES, _COLOURS, strict=True):
        axes.plot(
            np.degrees(angle),
            _vectors(name, index, angle).real,
            color=colour,
            linewidth=1.0,
            label=f"{100 * index:.4g} %",
        )
    axes.set(xlabel="Angle in deg", ylabel="Phase voltage / $v_{dc}$", ylim=(-0.75, 1.35))
    axes.set_xticks(range(0, 361, 120))
    axes.legend(fontsize=6.5, title="of six-step", title_fontsize=6.5, ncols=2, loc="upper center")


def _draw_harmonics(axes: Axes, name: OvermodulationName) -> None:
    index = np.linspace(INSCRIBED, SIX_STEP, 120)
    found = 100.0 * voltage_harmonics(name, index) / index[:, None]
    for order, values, colour in zip(ORDERS, found.T, SERIES, strict=False):
        axes.plot(100.0 * index / SIX_STEP, values, color=colour, label=str(order))
    axes.set(xlabel="Fundamental in % of six-step", ylabel="Harmonic in %")
    axes.legend(fontsize=6.5, title="order", title_fontsize=6.5, loc="upper left")
