"""Figure of a two-dimensional reference: its errors over the available
flux linkage and the torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.optimizer.field_weakening.form import SurfaceSamples, error_map
from dqforge.optimizer.operating_points.point_problem import Active
from dqforge.reports.pages.figures_style import INK, MUTED, label_in_unit, new_figure, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COUNT = 56


_STEPS = 10


def _samples(fit: WeakeningFit) -> SurfaceSamples:
    """Even grid up to the largest torque of each flux linkage, flux linkages along the first
    axis.
    """
    region = fit.region
    flux = np.linspace(region.flux_min, 1.04 * region.flux_max, _COUNT)
    most = region.largest_torque(flux)
    torque = np.linspace(0.0, 1.0, _COUNT) * most[:, np.newaxis]
    spread, limits = (
        np.broadcast_to(row[:, np.newaxis], torque.shape).ravel() for row in (flux, most)
    )
    return SurfaceSamples(torque.astype(np.float32).ravel(), spread.astype(np.float32), limits)


def _mark_borders(axes: Axes, fit: WeakeningFit) -> None:
    """The MTPA locus, above which the field is weakened, the largest torque,
    and where MTPV begins.
    """
    region = fit.region
    torque = np.linspace(0.0, region.torque_max, 200)
    taken = region.flux(*region.mtpa(torque))
    seen = taken >= region.flux_min
    axes.plot(taken[seen], torque[seen], color=INK, linewidth=1.1)
    flux = np.linspace(region.flux_min, 1.04 * region.flux_max, 200)
    points = region.points(np.full(flux.size, 2.0 * region.torque_max), flux)
    axes.plot(flux, points.torque, color=INK, linewidth=1.1)
    touching = np.flatnonzero(points.active == Active.MTPV)
    if touching.size:
        last = touching[-1]
        axes.plot(flux[: last + 1], points.torque[: last + 1], color=INK, linewidth=2.4)
        axes.annotate(
            "MTPV",
            (float(flux[last]), float(points.torque[last])),
            (-4, 6),
            textcoords="offset points",
            ha="right",
            color=MUTED,
            fontsize=7.5,
        )
    middle = np.flatnonzero(seen)[int(0.55 * np.count_nonzero(seen))]
    axes.annotate(
        "MTPA",
        (float(taken[middle]), float(torque[middle])),
        (5, -3),
        textcoords="offset points",
        color=MUTED,
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
    filled = axes.contourf(
        *grid, np.clip(percent, -permitted, permitted), levels=levels, cmap="PuOr_r"
    )
    bar = axes.figure.colorbar(filled, ax=axes, pad=0.02, aspect=28, ticks=levels[::5])
    bar.ax.tick_params(labelsize=7)
    axes.set_title(title)


def plot_weakening(fit: WeakeningFit) -> Figure:
    """Torque error and voltage excess over available flux linkage and torque,
    with the borders of the regions.
    """
    samples = _samples(fit)
    found = error_map(fit.region, fit.reference, samples)
    shape = (_COUNT, _COUNT)
    flux, torque = (
        values.astype(np.float64).reshape(shape) for values in (samples.flux, samples.torque)
    )
    settings, region = fit.settings, fit.region
    with style():
        figure = new_figure(
            "weakening", 3.1, "Errors of torque and voltage over flux linkage and torque"
        )
        left, right = figure.subplots(1, 2, sharey=True)
        figure.subplots_adjust(left=0.09, right=0.97, top=0.9, bottom=0.16, wspace=0.08)
        error = (100.0 * found.torque / region.torque_max).reshape(shape)
        _draw(
            left,
            (flux, torque),
            error,
            100.0 * settings.torque_error,
            "Torque error in % of the largest",
        )
        # Where MTPA takes less than is available, that is what is aimed at.
        aim = np.minimum(region.flux(*region.mtpa(torque.ravel())), flux.ravel())
        excess = 100.0 * (
            region.flux(found.i_d, found.i_q) / np.maximum(aim, 0.5 * region.flux_min) - 1.0
        )
        excess = np.where(aim < region.flux_min, np.minimum(excess, 0.0), excess).reshape(shape)
        _draw(
            right,
            (flux, torque),
            excess,
            100.0 * settings.voltage_excess,
            "Voltage error in % of the optimum's",
        )
        for axes in (left, right):
            _mark_borders(axes, fit)
            axes.margins(0.0)
            label_in_unit(axes.xaxis, "Available flux linkage in {}", region.flux_max, "Wb")
        label_in_unit(left.yaxis, "Torque in {}", region.torque_max, "N m")
    return figure
