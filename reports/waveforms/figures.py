"""Figure of phase currents: back-EMF, currents by rule, torque, and spectra."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.waveforms.comparison import RuleCurrents, WaveformComparison
from dqforge.reports.pages.figures_style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    prefixed,
    style,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PHASE_COLOURS = {"a": BLUE, "b": ORANGE, "c": TEAL}


RULE_COLOURS = {"dq": MUTED, "dqx": ORANGE, "dqy": BLUE, "limited": INK}


_TITLES = {"dq": "dq", "dqx": "dqx", "dqy": "dqy", "limited": "within all limits"}


_ORDERS = 13


def _closed(values: FloatArray) -> FloatArray:
    """Values over the period with the first repeated at its end."""
    return np.concatenate([values, values[..., :1]], axis=-1)


def _draw_phases(axes: Axes, values: FloatArray, title: str, turns: int, *, neutral: bool) -> None:
    end = 360.0 * turns
    theta = np.linspace(0.0, end, values.shape[1] + 1)
    for (phase, colour), line in zip(PHASE_COLOURS.items(), values, strict=True):
        axes.plot(theta, _closed(line), color=colour, linewidth=1.0, label=phase)
    if neutral and np.max(np.abs(np.sum(values, axis=0))) > 1e-6 * np.max(np.abs(values)):
        axes.plot(
            theta,
            _closed(np.sum(values, axis=0)),
            color=MUTED,
            linewidth=0.9,
            linestyle="dashed",
            label="neutral",
        )
    axes.set(title=title, xlim=(0.0, end), xticks=np.arange(0, 360, 120) * turns)
    axes.set_xlabel("Angle in deg")


def _draw_torque(axes: Axes, rules: tuple[RuleCurrents, ...], turns: int) -> None:
    end = 360.0 * turns
    for found in rules:
        theta = np.linspace(0.0, end, found.torque.size + 1)
        axes.plot(
            theta,
            _closed(found.torque),
            color=RULE_COLOURS[found.rule],
            linewidth=1.0,
            label=_TITLES[found.rule],
        )
    low, high = axes.get_ylim()
    middle, half = 0.5 * (low + high), max(0.5 * (high - low), 0.1 * abs(0.5 * (low + high)))
    axes.set(
        title="Torque",
        xlabel="Electrical angle in deg",
        ylabel="N m",
        xlim=(0.0, end),
        xticks=np.arange(0, 361, 120) * turns,
        ylim=(middle - 1.5 * half, middle + 1.5 * half),
    )


def _draw_spectra(axes: Axes, rules: tuple[RuleCurrents, ...], turns: int) -> None:
    orders = np.arange(1, _ORDERS + 1)
    width = 0.2 / turns
    largest = max(float(np.max(found.harmonics[0])) for found in rules)
    floor = 1e-3 * largest
    for place, found in enumerate(rules):
        shown = slice(1, _ORDERS * turns + 1)
        shift = width * (place - 0.5 * (len(rules) - 1))
        values = found.harmonics[0, shown]
        bars = axes.bar(
            found.orders[shown] + shift,
            np.where(values > floor, values, np.nan),  # what is below is not seen, or is rounding
            0.19 / turns,
            color=RULE_COLOURS[found.rule],
            label=_TITLES[found.rule],
        )
        for bar, order in zip(bars, found.orders[shown].tolist(), strict=True):
            bar.set_gid(f"{order:g}")
    axes.set(
        title="Harmonics of phase a", xlabel="Order", ylabel="A", xticks=orders[::2], yscale="log"
    )
    axes.set_ylim(floor, 2.0 * largest)
    axes.legend(frameon=False, loc="upper right", ncols=2, fontsize=6.5)


def plot_waveforms(comparison: WaveformComparison) -> Figure:
    """Back-EMF and the currents of every rule over the angle, the torque they make,
    and their harmonics.
    """
    rules, turns = comparison.rules, comparison.machine.turns
    with style():
        figure = new_figure(
            "waveforms", 5.0, "Back-EMF, phase currents by rule, torque and harmonics"
        )
        width = 0.86 / (len(rules) + 1)
        largest = max(float(np.max(np.abs(found.currents))) for found in rules)
        factor, unit = prefixed(float(np.max(np.abs(comparison.machine.flux))), "Wb")
        emf = figure.add_axes((0.085, 0.59, width - 0.035, 0.31))
        _draw_phases(
            emf,
            comparison.machine.flux * factor,
            "e / $\u03c9_e$",
            turns,
            neutral=False,
        )
        emf.set_ylabel(unit)
        first = None
        for place, found in enumerate(rules, start=1):
            box = (0.125 + place * width, 0.59, width - 0.035, 0.31)
            axes = figure.add_axes(box, sharey=first)
            _draw_phases(axes, found.currents, _TITLES[found.rule], turns, neutral=True)
            if first is None:
                first = axes
                axes.set(ylabel="Current in A", ylim=(-1.15 * largest, 1.15 * largest))
            else:
                axes.tick_params(labelleft=False)
            if place == len(rules):
                handles, labels = axes.get_legend_handles_labels()
                figure.legend(
                    handles,
                    labels,
                    frameon=False,
                    loc="upper center",
                    ncols=4,
                    bbox_to_anchor=(0.5, 1.0),
                )
        left, right = (
            figure.add_axes((0.085, 0.1, 0.385, 0.34)),
            figure.add_axes((0.57, 0.1, 0.4, 0.34)),
        )
        _draw_torque(left, rules, turns)
        _draw_spectra(right, rules, turns)
    return figure
