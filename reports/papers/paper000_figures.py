"""Figures 2 to 5 of paper 000: the split curves, the map of breakpoints, errors, and the drive
under a growing load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.reports.pages.figures_style import (
    BLUE,
    MAP_INK,
    MUTED,
    ORANGE,
    TEAL,
    new_figure,
    style,
)
from dqforge.reports.pages.scaled import DrawnGrid, draw_filled
from dqforge.reports.papers.explanations import plain_explanation
from dqforge.reports.papers.paper000_load_test import (
    PRINTED_MICROSECONDS,
    CoreCosts,
    Cost,
    LoadTest,
)
from dqforge.reports.papers.paper000_stated_method import (
    DOMAIN,
    ErrorCurve,
    ErrorMap,
    PrintedPolynomial,
    Reproduction,
    StatedMethod,
    curve_of,
)
from dqforge.reports.papers.paper000_whole_paper import HeatCurve, WholePaper
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS = (ORANGE, BLUE, TEAL)
_POINTS = 600
_SPLIT = 2.5  # Where Figure 2 divides both curves; the paper says: anywhere.


def figures_of(found: WholePaper) -> dict[str, Callable[[], Figure]]:
    """Figures by file name, drawn when called; the last where it was simulated."""
    drawn: dict[str, Callable[[], Figure]] = {
        "figures-2-and-3.svg": lambda: plot_split(found.stated),
        "figure-4.svg": lambda: plot_errors_over_torque(found.stated.errors),
    }
    if found.load_tests:
        drawn["figure-5.svg"] = lambda: plot_load_tests(found.load_tests, found.heat)
    return drawn


def _every(size: int) -> slice:
    return slice(None, None, max(1, size // _POINTS))


def plot_split(found: StatedMethod) -> Figure:
    """Figure 2: both curves in two segments; Figure 3: reduction of epsilon over breakpoints."""
    with style():
        figure = new_figure(
            "paper-000-figures-2-and-3", 5.2, "Division of the MTPA curves and its merit"
        )
        torque = np.linspace(0.0, DOMAIN, 401)
        for axis, left in (("q", 0.09), ("d", 0.585)):
            axes = figure.add_axes((left, 0.61, 0.39, 0.31))
            for chosen, colour in ((torque <= _SPLIT, ORANGE), (torque >= _SPLIT, BLUE)):
                axes.plot(torque[chosen], curve_of(axis, torque[chosen]), color=colour)
            axes.axvline(_SPLIT, color=MUTED, linewidth=0.8, linestyle="dashed")
            axes.set(
                title=f"Figure 2: $i_{axis}$ in two segments",
                xlabel="Torque in p.u.",
                ylabel="p.u.",
                xlim=(0.0, DOMAIN),
            )
        for k, one in enumerate(found.maps):
            axes = figure.add_axes((0.075 + 0.325 * k, 0.1, 0.255, 0.34))
            _map(figure, axes, one)
    return figure


def _map(figure: Figure, axes: Axes, found: ErrorMap) -> None:
    """Levels where the loss of epsilon falls by tens: they are what tells the best points."""
    left = 100.0 - found.reduction
    grid = DrawnGrid(found.points, found.points, found.reduction, "reduction in %")
    shown = draw_filled(axes, grid, np.log10(left), levels=16, cmap="Blues_r", antialiased=True)
    axes.plot(*found.printed[::-1], "+", color=ORANGE, markersize=9, label="printed")
    axes.plot(*found.best[::-1], "x", color=MAP_INK, markersize=6, label="best")
    axes.set(
        title=f"Figure 3: degree {found.degree}",
        xlabel="$\u03c6_q$ in p.u.",
        ylabel="$\u03c6_d$ in p.u.",
    )
    axes.grid(visible=False)
    axes.legend(frameon=False, loc="upper right", fontsize=6.5)
    bar = figure.colorbar(shown, ax=axes, location="bottom", pad=0.24, fraction=0.06)
    ticks = np.array([0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0])
    ticks = ticks[(ticks >= left.min()) & (ticks <= left.max())]
    bar.set_ticks(np.log10(ticks).tolist(), labels=[f"{100.0 - tick:g}" for tick in ticks])
    bar.ax.tick_params(labelsize=6.0)
    bar.set_label("reduction in %", fontsize=6.5)


def plot_errors_over_torque(curves: Sequence[ErrorCurve]) -> Figure:
    """Figure 4: currents of the printed polynomials with the exact ones, and their errors."""
    with style():
        figure = new_figure("paper-000-figure-4", 5.4, "Printed polynomials against the exact MTPA")
        for axis, left in (("q", 0.09), ("d", 0.585)):
            above = figure.add_axes((left, 0.61, 0.39, 0.31))
            below = figure.add_axes((left, 0.14, 0.39, 0.31))
            above.plot(
                curves[0].torque, curves[0].exact[axis], color=MUTED, linewidth=2.4, label="exact"
            )
            for curve, colour in zip(curves, _COLOURS, strict=True):
                name = f"degree {curve.degree}"
                above.plot(
                    curve.torque, curve.printed[axis], color=colour, linewidth=0.9, label=name
                )
                for values, dashes, whose in (
                    (curve.printed, "-", "printed"),
                    (curve.stated, ":", "stated method"),
                ):
                    gap = np.abs(values[axis] - curve.exact[axis])
                    below.semilogy(
                        curve.torque,
                        np.maximum(gap, 1e-4),
                        color=colour,
                        linestyle=dashes,
                        linewidth=1.0,
                        label=f"{curve.degree}, {whose}",
                    )
            above.set(title=f"Figure 4: $i_{axis}$", xlabel="Torque in N m", ylabel="A (peak)")
            below.set(
                title=f"Absolute error of $i_{axis}$",
                xlabel="Torque in N m",
                ylabel="A",
                ylim=(1e-3, 4.0),
            )
            above.legend(frameon=False, loc="best", fontsize=6.5)
        figure.legend(
            *below.get_legend_handles_labels(),
            frameon=False,
            loc="lower center",
            fontsize=6.5,
            ncols=6,
        )
    return figure


def plot_load_tests(tests: Sequence[LoadTest], heat: Sequence[HeatCurve] = ()) -> Figure:
    """Speed, torque and currents of the three alternatives over 6 s; with their losses and
    temperatures where these are given.
    """
    rows = 3 if heat else 2
    with style():
        figure = new_figure(
            "paper-000-figure-5", 2.4 * rows, "Speed, torque and currents under a growing load"
        )
        places = [
            (x, 1.0 - (row + 0.84) / rows, 0.39, 0.66 / rows)
            for row in range(rows)
            for x in (0.09, 0.585)
        ]
        speed, torque, i_d, size, *hot = (figure.add_axes(place) for place in places)
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
        if heat:
            _plot_heat(hot, heat)
        for axes in (speed, torque, i_d, size, *hot):
            axes.set(xlim=(0.0, 6.0), xlabel="Time in s")
        size.legend(frameon=False, loc="upper left", fontsize=6.5)
        torque.legend(frameon=False, loc="upper left", fontsize=6.5)
    return figure


def _plot_heat(hot: Sequence[Axes], heat: Sequence[HeatCurve]) -> None:
    loss, temperature = hot
    for curve, colour in zip(heat, _COLOURS, strict=True):
        loss.plot(curve.t, curve.loss, color=colour, linewidth=1.1)
        temperature.plot(curve.t, curve.junction_temperature, color=colour, linewidth=1.1)
        for axes, value in ((loss, curve.printed_total), (temperature, curve.printed_junction)):
            axes.plot([5.95], [value], "_", color=colour, markersize=10)
    loss.plot([], [], "_", color=MUTED, label="Table 4, printed")
    loss.set(title="Whole loss", ylabel="W", ylim=(0.0, 1300.0))
    temperature.set(title="Junction temperature (0.1 s assumed)", ylabel="degC", ylim=(60.0, 120.0))
    loss.legend(frameon=False, loc="upper left", fontsize=6.5)


# Paper 000 as plain data.


def plain_whole(found: WholePaper) -> PlainData:
    """Everything by the keys of docs/reference/json.md."""
    return {
        **plain_reproduction(found.tables),
        "table_2_by_stated_method": _coefficients(found.stated),
        "table_2_explanation": plain_explanation(found.coefficients),
        "figure_4_explanation": plain_explanation(found.largest_error),
        "table_4_ripple_explanation": plain_explanation(found.ripple),
        "table_3": _costs(found.costs),
        "table_3_left_out": dict(sorted(found.costs.left_out.items())),
        "figure_3": [
            {"degree": row.degree, "best": list(row.best), "printed": list(row.printed)}
            for row in found.stated.maps
        ],
        "figure_4": [
            {
                "degree": row.degree,
                "axis": row.axis,
                "torque_Nm": row.place,
                "largest_error_A": row.largest,
                "share": row.share,
            }
            for row in found.stated.errors
        ],
        "figure_5": plain_load_tests(found.load_tests) if found.load_tests else None,
        "figure_5_heat": [_heat(curve) for curve in found.heat] if found.heat else None,
        "figure_5_left_out": found.left_out,
        "header_of_the_paper": _header(found.header),
    }


def plain_reproduction(reproduction: Reproduction) -> PlainData:
    """The three tables as plain data."""
    return {
        "table_1": [asdict(row) for row in reproduction.breakpoints],
        "table_2": [asdict(row) for row in reproduction.polynomials],
        "table_4": [asdict(row) for row in reproduction.losses],
    }


def _coefficients(found: StatedMethod) -> list[PlainData]:
    return [
        {
            "axis": row.axis,
            "degree": row.degree,
            "segment": row.segment,
            "printed": list(row.printed),
            "stated": list(row.stated),
            "marked": list(row.marked),
            "apart_A": row.largest,
        }
        for row in found.segments
    ]


def _cost(cost: Cost | None) -> PlainData | None:
    if cost is None:
        return None
    return {"instructions": cost.instructions, "cycles": list(cost.cycles)}


def _costs(found: CoreCosts) -> list[PlainData]:
    return [
        {
            "core": row.core,
            "method": row.method,
            "printed_us": PRINTED_MICROSECONDS.get(row.method),
            "unoptimised": _cost(row.plain),
            "optimised": _cost(row.optimised),
            "float32": _cost(row.single),
        }
        for row in found.rows
    ]


def _heat(curve: HeatCurve) -> PlainData:
    return {
        "alternative": curve.name,
        "printed_W": curve.printed_total,
        "found_W": curve.total,
        "printed_degC": curve.printed_junction,
        "found_degC": curve.junction,
        "found_slow_degC": curve.slow_junction,
    }


def _header(found: PrintedPolynomial) -> PlainData:
    return {
        "degree": found.degree,
        "torque_max_Nm": found.torque_max,
        "breakpoints_Nm": list(found.breakpoints),
        "errors_A": [asdict(row) for row in found.errors],
        "compared": found.compared,
        "missing": found.missing,
    }


def plain_load_tests(tests: tuple[LoadTest, ...]) -> list[PlainData]:
    """The figures as plain data."""
    return [
        {
            "alternative": test.name,
            "largest_deviation_rad_per_s": test.deviation,
            "end_error_rad_per_s": test.end_error,
            "torque_Nm": test.torque,
            "current_A": test.current,
            "current_by_equation_A": test.expected,
        }
        for test in tests
    ]
