"""Figures of the current reference: the MTPA plane, the currents over torque,
and what the reference errs by.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.fit import ReferenceFit
from dqforge.optimizer.current_reference.forms import PENALTY_FROM, ErrorCurves
from dqforge.optimizer.operating_points.solve import Curves
from dqforge.reports.pages.figures_style import (
    AXIS_COLOURS,
    BLUE,
    INK,
    MUTED,
    ORANGE,
    PALE,
    PAPER,
    SKY,
    TEAL,
    label_in_unit,
    new_figure,
    prefixed,
    style,
    thinned,
    vertical_marks,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_DASHES = (0, (4.0, 2.0))
_LABELLED_BREAKPOINTS = 3
ROUNDING = 1e-11  # Relative loss penalty that is nothing but the rounding of double precision.


def breakpoints(fit: ReferenceFit) -> FloatArray:
    """Breakpoints of both axes in N m, ascending, shape (B,)."""
    found = [polynomial.breakpoints for polynomial in (fit.d, fit.q) if polynomial is not None]
    return np.unique(np.concatenate(found)) if found else np.empty(0)


def _at(fit: ReferenceFit, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    i_d, i_q = fit.reference.currents(torque.astype(np.float32))
    return i_d.astype(np.float64), i_q.astype(np.float64)


def _torque_levels(largest: float) -> FloatArray:
    from matplotlib.ticker import MaxNLocator

    levels = np.asarray(
        MaxNLocator(nbins=6, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, largest), dtype=np.float64
    )
    return levels[(levels > 0.0) & (levels <= largest * (1.0 + 1e-9))]


def _torque_line(machine: Machine, level: float, i_d: FloatArray, most: float) -> FloatArray:
    """The q current in A up to ``most`` that makes a torque in N m at each d current,
    NaN where none does.
    """
    grid = np.linspace(0.0, most, 601)
    torque = machine.torque(*np.broadcast_arrays(i_d[:, np.newaxis], grid))
    above = torque >= level
    after = np.maximum(np.argmax(above, axis=1), 1)
    rows = np.arange(i_d.size)
    low, high = torque[rows, after - 1], torque[rows, after]
    share = (level - low) / np.where(high > low, high - low, 1.0)
    return np.where(above.any(axis=1), grid[after - 1] + share * (grid[1] - grid[0]), np.nan)


def _draw_torque_lines(axes: Axes, design: Design, side: float, largest: float) -> None:
    """Curves of constant torque, labelled beyond the current limit."""
    i_max = design.i_max
    i_d = side * np.linspace(-0.42, 1.25, 120) * i_max
    factor, unit = prefixed(largest, "N m")
    for level in _torque_levels(largest):
        i_q = _torque_line(design.machine, float(level), i_d, 6.0 * i_max)
        reachable = np.isfinite(i_q)
        if not reachable.any():
            continue
        text = f"{level * factor:g} {unit}"
        axes.plot(
            i_d[reachable],
            i_q[reachable],
            color=PALE,
            linewidth=0.6,
            zorder=1,
            label=f"_torque {text}",
        )
        label_at = 1.145 * side * i_max
        order = np.argsort(i_d[reachable])
        axes.text(
            label_at,
            float(np.interp(label_at, i_d[reachable][order], i_q[reachable][order])),
            text,
            color=MUTED,
            fontsize=7,
            ha="center",
            va="center",
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0},
            zorder=2,
        )


def _draw_limit(axes: Axes, i_max: float, side: float) -> None:
    angle = np.linspace(0.0, np.pi, 181)
    axes.plot(
        i_max * np.cos(angle),
        i_max * np.sin(angle),
        color=INK,
        linewidth=1.0,
        zorder=3,
        label="_current limit",
    )
    axes.text(
        0.03 * side * i_max,
        1.025 * i_max,
        f"current limit {format_quantity(i_max, 'A', 4)} (peak)",
        ha="left" if side > 0.0 else "right",
        va="bottom",
        fontsize=7.5,
        bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 1.0},
    )


def _draw_reference(
    axes: Axes, fit: ReferenceFit, torque: FloatArray, side: float, i_max: float
) -> None:
    i_d, i_q = _at(fit, torque)
    axes.plot(
        i_d, i_q, color=INK, linewidth=1.2, linestyle=_DASHES, label="firmware reference", zorder=5
    )
    marks = breakpoints(fit)
    if marks.size == 0:
        return
    i_d, i_q = _at(fit, marks)
    axes.plot(
        i_d,
        i_q,
        "o",
        color=PAPER,
        markeredgecolor=INK,
        markersize=5,
        markeredgewidth=1.1,
        label="breakpoint",
        zorder=6,
    )
    for torque_at, x, y in (
        zip(marks, i_d, i_q, strict=True) if marks.size <= _LABELLED_BREAKPOINTS else ()
    ):
        axes.text(
            float(x) + 0.035 * side * i_max,
            float(y),
            format_quantity(float(torque_at), "N m", 4).replace(" u", " \u00b5"),
            ha="left" if side > 0.0 else "right",
            va="center",
            fontsize=7.5,
            bbox={"facecolor": PAPER, "edgecolor": "none", "pad": 0.8},
            zorder=4,
        )


def plot_mtpa(design: Design, curves: Curves, fit: ReferenceFit | None = None) -> Figure:
    """The plane of the currents: constant torque, the current limit, the exact trajectory
    and the fitted reference.

    Args:
        design: The design, for its machine and its current limit.
        curves: Exact operating points.
        fit: The reference that the firmware evaluates; left out where None.
    """
    i_max, side = design.i_max, 1.0 if design.machine.saliency < 0.0 else -1.0
    with style():
        figure = new_figure(
            "mtpa",
            4.75,
            "Currents in the d-q plane with curves of constant torque and current limit",
        )
        axes = figure.add_axes((0.085, 0.105, 0.895, 0.875))
        _draw_torque_lines(axes, design, side, float(np.max(curves.chosen.torque)))
        _draw_limit(axes, i_max, side)
        if curves.id0 is not None and design.strategy != "id0" and design.machine.saliency != 0.0:
            free = ~curves.id0.limited
            axes.plot(
                curves.id0.i_d[free],
                curves.id0.i_q[free],
                color=ORANGE,
                linewidth=1.6,
                linestyle=(0, (1.0, 1.4)),
                label="$i_d$ = 0",
                zorder=4,
            )
        label = "exact MTPA" if design.strategy == "mtpa" else "exact $i_d$ = 0"
        axes.plot(
            curves.chosen.i_d,
            curves.chosen.i_q,
            color=SKY,
            linewidth=4.0,
            label=label,
            zorder=4,
        )
        if fit is not None:
            _draw_reference(axes, fit, curves.chosen.torque, side, i_max)
        limits = np.sort(np.array([-0.42, 1.25]) * side) * i_max
        axes.set(xlim=tuple(limits), ylim=(0.0, 1.1 * i_max))
        label_in_unit(axes.xaxis, "$i_d$ in {} (peak)", i_max, "A")
        label_in_unit(axes.yaxis, "$i_q$ in {} (peak)", i_max, "A")
        axes.set_aspect("equal", anchor="C")
        axes.grid(visible=False)
        axes.legend(
            loc="lower left" if side > 0.0 else "lower right",
            frameon=True,
            facecolor=PAPER,
            edgecolor="none",
            framealpha=0.92,
            fontsize=7.5,
            handlelength=2.6,
        )
    return figure


def _plot_thinned(
    axes: Axes, torque: FloatArray, value: FloatArray, colour: str, **options: Any
) -> None:
    axes.plot(*thinned(torque, value), color=colour, linewidth=1.0, **options)


def _draw_currents(axes: Axes, curves: ErrorCurves, fit: ReferenceFit) -> None:
    torque = np.linspace(0.0, fit.torque_max, 201)
    for axis, error, drawn in zip("dq", (curves.i_d, curves.i_q), _at(fit, torque), strict=True):
        exact = np.interp(torque, curves.torque, _at(fit, curves.torque)[axis == "q"] - error)
        wide = axes.plot(
            torque,
            exact,
            color=AXIS_COLOURS[axis],
            linewidth=3.6,
            alpha=0.75,
            label=f"_exact $i_{axis}$",
        )
        thin = axes.plot(
            torque,
            drawn,
            color=INK,
            linewidth=1.1,
            linestyle=_DASHES,
            label=f"_firmware reference $i_{axis}$",
        )
        axes.annotate(
            f"$i_{axis}$",
            (fit.torque_max, float(drawn[-1])),
            xytext=(5, 0),
            textcoords="offset points",
            color=AXIS_COLOURS[axis],
            va="center",
            fontsize=9,
            fontweight="bold",
        )
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    axes.legend(
        [*wide, *thin],
        ["exact", "firmware reference"],
        loc="upper left",
        facecolor=PAPER,
        edgecolor="none",
        framealpha=1.0,
        fontsize=7.5,
        handlelength=2.6,
    )


def _draw_current_error(axes: Axes, torque: FloatArray, error: FloatArray, axis: str) -> None:
    factor, unit = prefixed(float(np.max(np.abs(error))), "A")
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    _plot_thinned(axes, torque, error * factor, AXIS_COLOURS[axis])
    axes.set_ylabel(f"$i_{axis}$ error in {unit}")
    axes.locator_params(axis="y", nbins=4)
    if not error.any():
        axes.set_yticks([0.0])


def plot_fit(design: Design, fit: ReferenceFit) -> Figure:
    """The currents over torque, exact and as the firmware evaluates them,
    and the error of each axis below.
    """
    curves = fit.curves
    with style():
        figure = new_figure(
            "fit", 5.2, "Exact and fitted currents over torque, and the error of each axis"
        )
        rows = figure.subplots(3, 1, sharex=True, height_ratios=[2.3, 1.0, 1.0])
        figure.subplots_adjust(left=0.1, right=0.95, bottom=0.085, top=0.98, hspace=0.14)
        _draw_currents(rows[0], curves, fit)
        label_in_unit(rows[0].yaxis, "Current in {} (peak)", design.i_max, "A")
        _draw_current_error(rows[1], curves.torque, curves.i_d, "d")
        _draw_current_error(rows[2], curves.torque, curves.i_q, "q")
        label_in_unit(rows[2].xaxis, "Torque in {}", fit.torque_max, "N m")
        rows[2].set_xlim(0.0, fit.torque_max)
        for axes in rows:
            vertical_marks(axes, breakpoints(fit), "breakpoint")
        figure.align_ylabels(rows)
    return figure


def _small_share(share: float) -> tuple[float, str]:
    """Factor and unit for a share of one: percent, or parts per million or
    billion where that is tiny.
    """
    return next(
        (
            (factor, unit)
            for least, factor, unit in ((1e-4, 1e2, "%"), (1e-6, 1e6, "ppm"))
            if share >= least
        ),
        (1e9, "ppb"),
    )


def _draw_torque_error(axes: Axes, curves: ErrorCurves, torque_max: float) -> None:
    largest = float(np.max(np.abs(curves.torque_error)))
    factor, unit = prefixed(largest, "N m")
    axes.axhline(0.0, color=MUTED, linewidth=0.6)
    _plot_thinned(axes, curves.torque, curves.torque_error * factor, BLUE)
    axes.set_ylabel(f"Torque error in {unit}")
    span = 1.15 * largest * factor or 1.0
    axes.set_ylim(-span, span)
    share, share_unit = _small_share(largest / torque_max)
    twin = axes.twinx()
    twin.set_ylim(-span / factor / torque_max * share, span / factor / torque_max * share)
    twin.set_ylabel(f"{share_unit} of largest torque")
    twin.spines["right"].set_visible(True)
    twin.grid(visible=False)


def _power_label(value: float, _position: int | None = None) -> str:
    """A tick such as 10 with its exponent raised, written in plain text."""
    exponent = round(math.log10(value)) if value > 0.0 else 0
    if -2 <= exponent <= 3:
        return f"{value:g}"
    return "10" + str(exponent).translate(
        str.maketrans(
            "-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079"
        )
    )


def _draw_penalty(
    axes: Axes, torque: FloatArray, penalty: FloatArray, label: str, colour: str, *, shown: bool
) -> None:
    """A loss penalty on a logarithmic scale that ends five decades below its largest value."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_ylabel(label)
    largest = float(np.max(penalty))
    if not shown or not largest > 0.0:
        axes.text(
            0.5,
            0.5,
            "none but rounding",
            transform=axes.transAxes,
            ha="center",
            va="center",
            color=MUTED,
        )
        axes.set_yticks([])
        return
    top = 10.0 ** math.ceil(math.log10(largest) + 0.1)
    floor = top * 1e-5
    exponents = np.log10(np.maximum(penalty, floor))
    drawn_torque, drawn = thinned(torque, exponents)
    axes.set_yscale("log")
    axes.plot(drawn_torque, 10.0**drawn, color=colour, linewidth=1.0)
    axes.set_ylim(floor, top)
    axes.yaxis.set_major_locator(LogLocator(numticks=6))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(FuncFormatter(_power_label))


def plot_errors(fit: ReferenceFit) -> Figure:
    """Torque error and copper loss above the least over torque, of the float32
    arithmetic of the firmware.
    """
    curves = fit.curves
    shown = fit.errors.loss_relative > ROUNDING
    loaded = curves.torque >= PENALTY_FROM * fit.torque_max
    with style():
        figure = new_figure(
            "errors", 5.0, "Torque error and copper loss above the least over torque"
        )
        rows = figure.subplots(3, 1, sharex=True)
        figure.subplots_adjust(left=0.1, right=0.9, bottom=0.088, top=0.98, hspace=0.14)
        _draw_torque_error(rows[0], curves, fit.torque_max)
        _draw_penalty(
            rows[1], curves.torque, curves.loss, "Extra copper loss in W", ORANGE, shown=shown
        )
        _draw_penalty(
            rows[2],
            curves.torque[loaded],
            100.0 * curves.loss_relative[loaded],
            "Extra copper loss in %",
            TEAL,
            shown=shown,
        )
        label_in_unit(rows[2].xaxis, "Torque in {}", fit.torque_max, "N m")
        rows[2].set_xlim(0.0, fit.torque_max)
        for axes in rows:
            vertical_marks(axes, breakpoints(fit), "breakpoint")
        figure.align_ylabels(rows)
    return figure
