"""Figure of a two-dimensional reference: its errors over the available
flux linkage and the torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.field_weakening.error_chart import DomainBorders
from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.reports.figure_data.scaled import DrawnGrid, draw_filled
from dqforge.reports.pages.figures_style import MAP_INK, MAP_MUTED, label_in_unit, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_STEPS = 10


def _mark_borders(axes: Axes, borders: DomainBorders) -> None:
    """The MTPA locus, above which the field is weakened, the largest torque,
    and where MTPV begins.
    """
    axes.plot(borders.mtpa_flux, borders.mtpa_torque, color=MAP_INK, linewidth=1.1, label="_MTPA")
    flux, torque = borders.flux, borders.largest_torque
    axes.plot(flux, torque, color=MAP_INK, linewidth=1.1, label="_largest torque")
    touching = np.flatnonzero(borders.mtpv)
    if touching.size:
        last = touching[-1]
        axes.plot(flux[: last + 1], torque[: last + 1], color=MAP_INK, linewidth=2.4, label="_MTPV")
        axes.annotate(
            "MTPV",
            (float(flux[last]), float(torque[last])),
            (-4, 6),
            textcoords="offset points",
            ha="right",
            color=MAP_MUTED,
            fontsize=7.5,
        )
    middle = int(0.55 * borders.mtpa_flux.size)
    axes.annotate(
        "MTPA",
        (float(borders.mtpa_flux[middle]), float(borders.mtpa_torque[middle])),
        (5, -3),
        textcoords="offset points",
        color=MAP_MUTED,
        fontsize=7.5,
        va="top",
    )


def _draw(
    axes: Axes,
    grid: tuple[FloatArray, FloatArray],
    percent: FloatArray,
    permitted: float,
    title: str,
) -> None:
    """Filled steps of an error in percent from minus to plus the permitted one."""
    levels = np.linspace(-permitted, permitted, 2 * (_STEPS // 2) + 1)
    filled = draw_filled(
        axes,
        DrawnGrid(*grid, percent, title),
        np.clip(percent, -permitted, permitted),
        levels=levels,
        cmap="PuOr_r",
    )
    bar = axes.figure.colorbar(filled, ax=axes, pad=0.02, aspect=28, ticks=levels[::5])
    bar.ax.tick_params(labelsize=7)
    axes.set_title(title)


def plot_weakening(fit: WeakeningFit) -> Figure:
    """Torque error and voltage excess over available flux linkage and torque,
    with the borders of the regions.
    """
    chart, settings, region = fit.chart, fit.settings, fit.region
    grid = chart.flux, chart.torque
    with style():
        figure = new_figure(
            "weakening", 3.1, "Errors of torque and voltage over flux linkage and torque"
        )
        left, right = figure.subplots(1, 2, sharey=True)
        figure.subplots_adjust(left=0.09, right=0.97, top=0.9, bottom=0.16, wspace=0.08)
        error, excess = 100.0 * chart.torque_error, 100.0 * chart.voltage_error
        _draw(left, grid, error, 100.0 * settings.torque_error, "Torque error in % of the largest")
        _draw(
            right,
            grid,
            excess,
            100.0 * settings.voltage_excess,
            "Voltage error in % of the optimum's",
        )
        for axes in (left, right):
            _mark_borders(axes, chart.borders)
            axes.margins(0.0)
            label_in_unit(axes.xaxis, "Available flux linkage in {}", region.flux_max, "Wb")
        label_in_unit(left.yaxis, "Torque in {}", region.torque_max, "N m")
    return figure
