"""Figures of the pages on what control and references cost, of the tables that stand there."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from page_text import table

from dqforge.reports.pages.figures_style import (
    BLUE,
    BROWN,
    MUTED,
    OLIVE,
    ORANGE,
    PALE,
    PURPLE,
    RED,
    TEAL,
    new_figure,
    save,
    style,
)

_FUNCTIONS = {
    "torque reference": "torque reference",
    "current control": "current control",
    "the same of CMSIS-DSP 1.10.3": "the same of CMSIS-DSP",
    "speed control, the whole step": "speed control, whole step",
    "position observer flux": "flux observer",
    "position observer extended-emf": "extended-EMF observer",
    "position observer ekf": "Kalman filter",
    "modulator svpwm": "space vectors (svpwm)",
}

_COLUMNS: Mapping[str, tuple[str, str, str]] = {
    "M4F float32": ("Cortex-M4F, float32", BLUE, "o"),
    "M4F q15": ("Cortex-M4F, Q15", TEAL, "s"),
    "M0+ q15": ("Cortex-M0+, Q15", OLIVE, "D"),
    "M0+ q31": ("Cortex-M0+, Q31", ORANGE, "^"),
    "M0+ float32": ("Cortex-M0+, float32", RED, "v"),
}

_FAMILIES: Mapping[str, tuple[str, str]] = {
    "polynomial": (BLUE, "o"),
    "even-odd": (TEAL, "s"),
    "torque-exact": (ORANGE, "^"),
    "closed-form": (PURPLE, "D"),
    "q15": (OLIVE, "P"),
    "q31": (BROWN, "X"),
    "table": (MUTED, "v"),
    "i_d = 0": (RED, "*"),
    "i_d from": (PALE, "<"),
}

_WORDS = {
    "i_d = 0": "$i_d$ = 0",
    "i_d from": "$i_d$ from $i_q$ by a root",
    "q15": "Q15",
    "q31": "Q31",
}


def _instructions(cell: str) -> float:
    return float(cell.split("/", maxsplit=1)[0])


def _cycles(cell: str) -> float:
    """The upper end of the estimated cycles."""
    return float(cell.split("/")[1].rsplit("-", maxsplit=1)[-1])


@style()
def control(path: Path) -> None:
    """Instructions of a call by function, core and format."""
    rows = table("reference/control-cost.md", "function, over 300 calls, 16 on M0+")
    figure = new_figure("control-cost", 3.6, "Instructions of one call of each function")
    axes = figure.add_axes((0.25, 0.13, 0.73, 0.72))
    names = list(_FUNCTIONS)[::-1]
    for column, (label, colour, mark) in _COLUMNS.items():
        points = [
            (_instructions(rows[name][column]), place)
            for place, name in enumerate(names)
            if rows[name][column]
        ]
        look: dict[str, Any] = {"color": colour, "marker": mark, "label": label}
        axes.plot(*zip(*points, strict=True), linestyle="", markersize=6.0, **look)
    axes.set_yticks(range(len(names)), [_FUNCTIONS[name] for name in names])
    axes.set(xscale="log", xlim=(20.0, 1e5), xlabel="Instructions of one call, mean")
    axes.set_ylim(-0.6, len(names) - 0.4)
    figure.legend(loc="upper center", ncols=3, columnspacing=1.4)
    save(figure, path)


@style()
def reference(path: Path) -> None:
    """Current error over cycles of every form, on a core with and on one without floating point."""
    rows = table("reference/reference-cost.md", "form")
    figure = new_figure("reference-cost", 3.4, "Current error over cycles by form")
    for place, (column, title) in enumerate(
        (("M4F", "Cortex-M4F, floating point"), ("M0+", "Cortex-M0+, without floating point"))
    ):
        axes = figure.add_axes((0.085 + 0.49 * place, 0.135, 0.405, 0.63))
        for family, (colour, mark) in _FAMILIES.items():
            points = [
                (_cycles(row[column]), float(row["current"]))
                for name, row in rows.items()
                if name.startswith(family)
            ]
            look: dict[str, Any] = {"color": colour, "marker": mark, "markersize": 6.0}
            label = _WORDS.get(family, family) if place == 0 else None
            axes.plot(*zip(*points, strict=True), linestyle="", label=label, **look)
        axes.set(
            title=title,
            yscale="log",
            ylim=(3e-6, 100.0),
            xlabel="Cycles of one call, upper estimate",
        )
        axes.axhline(0.1, color=PALE, linewidth=0.8, linestyle="--")
        axes.text(
            0.99, 0.13, "0.1 %", transform=axes.get_yaxis_transform(), ha="right", color=MUTED
        )
        if column == "M4F":
            axes.set(xlim=(0.0, 130.0), ylabel="Largest current error in %")
        else:
            axes.set(xlim=(0.0, 2200.0))
            axes.tick_params(labelleft=False)
    figure.legend(loc="upper center", ncols=5, columnspacing=1.2)
    save(figure, path)
