"""Figures of operating points over speed, and their chapter of the report: currents at one speed,
and the torque-speed map with its regions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.operating_points.characteristics import (
    Characteristics,
    Envelope,
    OperatingMap,
    VoltageLimit,
)
from dqforge.optimizer.operating_points.mtpa_locus import Active
from dqforge.optimizer.operating_points.points import OptimalPoints
from dqforge.optimizer.operating_points.solve import Curves
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability
from dqforge.reports.operating_points.map_tables import mtpa_tables, plain_curves
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import (
    AXIS_COLOURS,
    INK,
    MAP_MUTED,
    MAP_ORANGE,
    MUTED,
    ORANGE,
    PAPER,
    label_in_unit,
    new_figure,
    style,
    vertical_marks,
)
from dqforge.reports.pages.html_text import HtmlTable, Row, heading_cells, number, share, watts
from dqforge.reports.pages.scaled import DrawnGrid, draw_filled
from dqforge.reports.pages.templating import WINNERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.contour import ContourSet
    from matplotlib.figure import Figure


# Efficiencies in percent that a line may stand for.
_LEVELS = np.array(
    [10, 20, 30, 40, 50, 60, 70, 75, 80, 82, 84, 86, 88, *range(90, 99), 98.5, 99, 99.5, 99.8]
)

# Shares of the map that lie below the lines, as nearly as the levels allow.
_SHARES = (0.04, 0.12, 0.25, 0.42, 0.6, 0.78, 0.92)
_SHADES = ("#f7f9fc", "#ebf1f8", "#dbe7f3", "#c7daed", "#aecae4", "#94b8da", "#78a4ce", "#5f91c1")

_SPEEDS_NAMED = 12  # in the legend of a figure

_REGIONS = {
    Active.VOLTAGE: "field weakening",
    Active.CURRENT: "current limit",
    Active.BOTH: "both limits",
    Active.MTPV: "MTPV",
    Active.DATA: "held by the data",
}


def _mark_regions(upper: Axes, lower: Axes, points: OptimalPoints) -> None:
    """Where what holds the points changes before the last one, with the name of what begins
    there.
    """
    changes = np.flatnonzero(np.diff(points.active)) + 1
    for k in changes[changes < points.torque.size - 1]:
        torque = float(points.torque[k])
        name = _REGIONS.get(Active(int(points.active[k])), "")
        for axes in (upper, lower):
            vertical_marks(axes, np.array([torque]), f"{name} from")
        upper.annotate(
            name,
            (torque, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(4, -2),
            textcoords="offset points",
            color=MUTED,
            fontsize=7.5,
            va="top",
        )


def plot_points(
    i_d: FloatArray, i_q: FloatArray, torque: FloatArray, omega_m: FloatArray
) -> Figure:
    """Operating points in the plane of the currents, in A; those of one speed are joined.

    Arrays of one shape; torque in N m orders the points of a speed in rad/s.
    """
    d, q, made, speed = (np.ravel(part) for part in (i_d, i_q, torque, omega_m))
    with style():
        figure = new_figure("points", 3.6, "Currents of the operating points")
        axes = figure.add_axes((0.1, 0.13, 0.62, 0.79))
        for k, one in enumerate(np.unique(speed)):
            order = np.flatnonzero(speed == one)
            order = order[np.argsort(made[order], kind="stable")]
            axes.plot(
                d[order],
                q[order],
                "o-",
                color=WINNERS[k % len(WINNERS)],
                markersize=3.5,
                linewidth=1.2,
                label=f"{in_rpm(one):.5g} rpm" if k < _SPEEDS_NAMED else f"_{k}",
            )
        axes.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
        axes.axvline(0.0, color=MUTED, linewidth=0.8, zorder=1)
        axes.margins(0.1)
        axes.legend(loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False, borderaxespad=0.0)
        label_in_unit(axes.xaxis, "Current $i_d$ in {} (peak)", float(np.max(np.abs(d))), "A")
        label_in_unit(axes.yaxis, "Current $i_q$ in {} (peak)", float(np.max(np.abs(q))), "A")
    return figure


def plot_speed(points: OptimalPoints, limit: VoltageLimit) -> Figure:
    """Currents and voltage over torque at one speed.

    Points are those of one speed, torque ascending.
    """
    kept = points.reached
    with style():
        figure = new_figure("speed", 3.6, "Currents and phase voltage over torque at one speed")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        figure.subplots_adjust(left=0.1, right=0.94, top=0.92, bottom=0.13, hspace=0.14)
        for axis, current in (("d", points.i_d), ("q", points.i_q)):
            upper.plot(
                points.torque[kept],
                current[kept],
                color=AXIS_COLOURS[axis],
                linewidth=1.6,
                label=f"_$i_{axis}$",
            )
            end = (float(points.torque[kept][-1]), float(current[kept][-1]))
            upper.annotate(
                f"$i_{axis}$",
                end,
                xytext=(5, 0),
                textcoords="offset points",
                color=AXIS_COLOURS[axis],
                va="center",
            )
        upper.axhline(0.0, color=MUTED, linewidth=0.8, zorder=1)
        upper.margins(y=0.12)
        upper.set_title(f"{in_rpm(points.omega_m[0]):.5g} rpm")
        _mark_regions(upper, lower, points)
        label_in_unit(upper.yaxis, "Current in {} (peak)", float(np.max(np.abs(points.i_q))), "A")
        lower.plot(points.torque[kept], points.voltage[kept], color=INK, linewidth=1.3)
        lower.axhline(
            limit.v_max, color=ORANGE, linewidth=1.0, linestyle=(0, (4.0, 2.0)), label="_limit"
        )
        lower.text(
            float(points.torque[0]),
            limit.v_max,
            f" {limit.made_by} limit",
            color=ORANGE,
            va="bottom",
            fontsize=7,
        )
        lower.set(ylim=(0.0, 1.25 * limit.v_max), ylabel="Voltage in V")
        label_in_unit(lower.xaxis, "Torque in {}", float(np.max(points.torque)), "N m")
    return figure


def _filled(efficiency: FloatArray) -> FloatArray:
    """Efficiency in percent with the last value of each speed carried on to where there is none,
    for drawing alone.
    """
    percent = 100.0 * efficiency
    for row in range(1, percent.shape[0]):
        percent[row] = np.where(np.isnan(percent[row]), percent[row - 1], percent[row])
    for row in range(percent.shape[0] - 2, -1, -1):
        percent[row] = np.where(np.isnan(percent[row]), percent[row + 1], percent[row])
    return percent


def _chosen_levels(efficiency: FloatArray) -> list[float]:
    """Levels in percent that divide the map as `_SHARES` says, ascending.

    Empty where there is nothing to divide.
    """
    known = 100.0 * efficiency[np.isfinite(efficiency)]
    if known.size == 0:
        return []
    nearest = {
        float(_LEVELS[np.argmin(np.abs(_LEVELS - np.quantile(known, share)))]) for share in _SHARES
    }
    return sorted(level for level in nearest if known.min() < level < known.max())


def _label_places(
    axes: Axes, lines: ContourSet, curves: list[FloatArray]
) -> list[tuple[float, float]]:
    """One place per level, on its longest piece, as far from other labels,
    curves and edges as it can be.

    ``curves`` are drawn lines in data coordinates, shape (K, 2) each.
    """
    ends = np.array([(axes.get_xlim()[k], axes.get_ylim()[k]) for k in (0, 1)])
    # The axes are wider than high: distances are measured in their heights.
    scale = np.array([1.8, 1.0]) / (ends[1] - ends[0])
    curve = np.vstack(curves) * scale
    taken: list[FloatArray] = []
    places = []
    for path in lines.get_paths():
        pieces = [
            np.array(piece, dtype=np.float64) for piece in path.to_polygons(closed_only=False)
        ]
        if not pieces:
            continue
        piece = max(
            pieces, key=lambda points: float(np.sum(np.hypot(*np.diff(points * scale, axis=0).T)))
        )
        spot = (piece - ends[0]) * scale
        # Lines matter within the length of a label only; other labels may well be far away.
        near = np.min(np.hypot(*(spot[:, np.newaxis] - curve).T), axis=0)
        clear = (
            np.minimum(
                np.column_stack([spot, [1.8, 1.0] - spot]).min(axis=1), np.minimum(near, 0.1)
            )
            * 2.0
        )
        for other in taken:
            clear = np.minimum(clear, np.hypot(*(spot - other).T))
        best = int(np.argmax(clear))
        if clear[best] > 0.08:
            taken.append(spot[best])
            places.append((float(piece[best, 0]), float(piece[best, 1])))
    return places


def _draw_efficiency(axes: Axes, chart: OperatingMap, envelope: Envelope, top: float) -> None:
    levels = _chosen_levels(chart.efficiency)
    if not levels:
        return
    speed = in_rpm(chart.omega_m[1:])
    percent = np.ma.masked_invalid(_filled(chart.efficiency.copy())[:, 1:])
    shades = [_SHADES[round(k * (len(_SHADES) - 1) / len(levels))] for k in range(len(levels) + 1)]
    edges = [min(0.0, float(percent.min())) - 1.0, *levels, 101.0]
    known = DrawnGrid(speed, chart.torque, 100.0 * chart.efficiency[:, 1:], "Efficiency in %")
    draw_filled(axes, known, percent, levels=edges, colors=shades, zorder=1)
    # Without the torque zero, to which the fill was only carried on;
    # the lines beyond the envelope are covered.
    lines = axes.contour(
        speed,
        chart.torque[1:],
        percent[1:],
        levels=levels,
        colors=MAP_MUTED,
        linewidths=0.6,
        zorder=2,
    )
    points = envelope.points
    axes.fill_between(
        in_rpm(points.omega_m), points.torque, top, color=PAPER, linewidth=0, zorder=2.5
    )
    real = np.ma.masked_invalid(100.0 * chart.efficiency[:, 1:])
    guide = axes.contour(speed, chart.torque, real, levels=levels, linewidths=0.0)
    begin = np.linspace(0.0, float(envelope.weakening_torque[-1]), 60)
    curves = [
        np.column_stack([in_rpm(points.omega_m), points.torque]),
        np.column_stack(
            [in_rpm(np.interp(begin, envelope.weakening_torque, envelope.weakening_speed)), begin]
        ),
    ]
    places = _label_places(axes, guide, curves)
    guide.remove()
    if places:
        axes.clabel(lines, fmt="%g %%", fontsize=6.5, inline_spacing=2, manual=places, zorder=2.2)


def _mark(axes: Axes, speed: float, torque: float, text: str) -> None:
    """A dot on the envelope with its text above, inside the axes."""
    left = speed > 0.62 * axes.get_xlim()[1]
    axes.plot([speed], [torque], "o", color=INK, markersize=4, zorder=4, label=f"_{text}")
    axes.annotate(
        text,
        (speed, torque),
        xytext=(4 if left else 6, 6 if left else 4),
        textcoords="offset points",
        fontsize=7.5,
        ha="right" if left else "left",
        zorder=4,
    )


def _draw_envelope(axes: Axes, figures: Characteristics, envelope: Envelope) -> None:
    """Most torque, where the field begins to be weakened, and the speeds where what
    holds the torque changes.
    """
    points = envelope.points
    speed, end = in_rpm(points.omega_m), axes.get_xlim()[1]
    begin = in_rpm(envelope.weakening_speed)
    dashes = (0, (4.0, 2.0))
    label = "field weakening begins"
    if float(np.min(begin)) < end:
        axes.plot(
            begin,
            envelope.weakening_torque,
            color=MAP_ORANGE,
            linewidth=1.2,
            linestyle=dashes,
            label=label,
            zorder=3,
        )
    axes.plot(speed, points.torque, color=INK, linewidth=1.6, label="most torque", zorder=3)
    base = in_rpm(figures.base_speed)
    if base < end:
        _mark(axes, base, figures.torque_max, f"base speed {base:.4g} rpm")
    touching = np.flatnonzero(points.active == Active.MTPV)
    if touching.size:
        k = int(touching[0])
        _mark(axes, float(speed[k]), float(points.torque[k]), f"MTPV from {speed[k]:.4g} rpm")


def plot_operating_map(figures: Characteristics, envelope: Envelope, chart: OperatingMap) -> Figure:
    """Efficiency over speed and torque, the envelope with what holds it,
    and the line where field weakening begins.
    """
    top = 1.1 * figures.torque_max
    iron, inverter = bool(np.any(chart.losses.iron > 0.0)), chart.with_inverter
    losses = "copper" + ", iron" * iron + ", inverter" * inverter
    with style():
        figure = new_figure(
            "map", 4.2, "Efficiency over speed and torque within the limits of current and voltage"
        )
        axes = figure.add_axes((0.09, 0.115, 0.87, 0.81))
        axes.set(
            xlim=(0.0, in_rpm(float(chart.omega_m[-1]))), ylim=(0.0, top), xlabel="Speed in rpm"
        )
        _draw_efficiency(axes, chart, envelope, top)
        _draw_envelope(axes, figures, envelope)
        axes.set_title(f"Efficiency ({losses})")  # short: the legend is on the same line
        label_in_unit(axes.yaxis, "Torque in {}", figures.torque_max, "N m")
        axes.grid(visible=False)
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=2,
            frameon=False,
            fontsize=7.5,
            borderaxespad=0.3,
        )
    return figure


# Operating points in the report.

_SHARES_OF_TORQUE = (0.1, 0.25, 0.5, 0.75, 1.0)


def differs_from_id0(design: Design) -> bool:
    """Whether the design's strategy is anything else than i_d = 0."""
    return design.strategy != "id0" and design.machine.saliency != 0.0


def operating_table(design: Design, curves: Curves) -> HtmlTable:
    """Currents and copper loss at a few torques, beside those of i_d = 0."""
    chosen, id0 = curves.chosen, curves.id0 if differs_from_id0(design) else None
    rows = []
    for part in _SHARES_OF_TORQUE:
        k = round(part * (chosen.torque.size - 1))
        cells = [number(chosen.torque[k]), number(chosen.i_d[k]), number(chosen.i_q[k])]
        cells += [
            number(float(np.hypot(chosen.i_d[k], chosen.i_q[k]))),
            watts(float(chosen.copper[k])),
        ]
        if id0 is not None:
            if id0.limited[k]:
                cells += ["beyond the limit", "\u2013"]
            else:
                saved = 1.0 - float(chosen.copper[k] / id0.copper[k])
                cells += [watts(float(id0.copper[k])), share(saved, 3)]
        rows.append(Row(tuple(cells)))
    columns = ["Torque N m", "i_d A", "i_q A", "|i| A", "copper loss"]
    columns += [] if id0 is None else ["copper loss at i_d = 0", "saved"]
    return HtmlTable(
        "Operating points, exact (currents are peak of phase)",
        heading_cells(*columns),
        tuple(rows),
        0,
    )


# The currents over torque, as one record.


def _tables(solution: Solution, curves: Curves) -> list[Table]:
    half = solution.negative
    return mtpa_tables(solution.design, curves, None if half is None else half.curves)


OPERATING_POINTS = Capability(
    name="mtpa",
    title="currents over torque",
    of=lambda outcome: outcome.solution.curves,
    plain=lambda _, curves: plain_curves(curves),
    tables=_tables,
)
