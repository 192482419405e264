"""Figure of the comparison: who wins where, errors over the speed, and the starts from which the
chosen estimator locks.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.estimator_comparison.candidate import HALF_TURN, LOCKED, CaptureMap
from dqforge.optimizer.estimator_comparison.solve import NOBODY, EstimatorComparison
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT
from dqforge.reports.pages.figures_style import FAINT, MAP_INK, MUTED, SERIES, new_figure, style
from dqforge.reports.pages.templating import OTHERS, WINNERS, draw_cells

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from dqforge.optimizer.estimator_comparison.compared import ComparedEstimator

_TURN = 2.0 * math.pi

_LARGEST, _LEAST = 90.0, 0.1  # deg of the errors that are drawn

_DASHES = ("-", "--", ":")  # estimators that agree lie on each other

_HALF_TURN_COLOUR = WINNERS[1]


def plot_comparison(found: EstimatorComparison) -> Figure:
    """Winners over speed and load, errors over the speed, starts that lock.

    Args:
        found: The comparison.
    """
    known = _by_cells(found)
    chosen = _chosen(found)
    capture = None if chosen is None or chosen.figures is None else chosen.figures.capture
    height = 3.1 if capture is None else 5.4
    with style():
        figure = new_figure(
            "estimators",
            height,
            "Estimator with the least error over speed and load, and its errors",
        )
        upper = figure.add_axes((0.085, 1.0 - 2.2 / height, 0.4, 1.85 / height))
        _draw_winners(upper, found, known)
        right = figure.add_axes((0.585, 1.0 - 2.2 / height, 0.4, 1.85 / height))
        _draw_errors(right, found, known)
        if capture is not None and chosen is not None:
            _draw_captures(figure, capture, chosen.candidate.name, height)
    return figure


def _chosen(found: EstimatorComparison) -> ComparedEstimator | None:
    name = found.pair.at_speed
    return None if name is None else found.estimator(name)


def _by_cells(found: EstimatorComparison) -> list[ComparedEstimator]:
    """Estimators that are not refused, those that win most cells first: colours are few."""
    cells = np.bincount(found.winner[found.winner >= 0], minlength=len(found.estimators))
    known = [k for k, row in enumerate(found.estimators) if row.figures is not None]
    return [found.estimators[k] for k in sorted(known, key=lambda k: -int(cells[k]))]


def _colour(place: int) -> str:
    return WINNERS[place] if place < len(WINNERS) else OTHERS


def _draw_winners(axes: Axes, found: EstimatorComparison, known: list[ComparedEstimator]) -> None:
    """A cell per speed and load, equally wide; white where nobody holds, hatched out of reach."""
    from matplotlib.patches import Patch

    places = {found.estimators.index(row): k for k, row in enumerate(known)}
    code = np.array(
        [
            [places.get(int(index), -1 if index == NOBODY else len(known)) for index in line]
            for line in found.winner.T
        ]
    )
    colours = [_colour(k) for k in range(len(known))] + [FAINT]
    speeds, loads = len(found.asked.omega), len(found.asked.shares)
    draw_cells(axes, code, np.arange(speeds + 1.0), np.arange(loads + 1.0), colours)
    shares = 100.0 * found.asked.omega / found.asked.omega_max
    axes.set_xticks(np.arange(speeds) + 0.5, [f"{share:.3g}" for share in shares.tolist()])
    axes.set_yticks(
        np.arange(loads) + 0.5, [f"{100.0 * share:.0f}" for share in found.asked.shares.tolist()]
    )
    axes.tick_params(labelsize=7.0)
    axes.set(
        xlim=(0, speeds),
        ylim=(0, loads),
        xlabel="Speed in % of the largest",
        ylabel="Torque in % of the largest",
        title="Least error of those that hold",
    )
    axes.grid(visible=False)
    shown = [k for k in range(len(known)) if np.any(code == k)]
    handles = [Patch(color=_colour(k), label=known[k].candidate.name) for k in shown]
    if np.any(code == len(known)):
        handles.append(Patch(color=FAINT, label="beyond the voltage"))
    if handles:
        axes.legend(
            handles=handles,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.24),
            frameon=False,
            fontsize=6.5,
            ncols=3,
            handlelength=1.0,
        )


def _draw_errors(axes: Axes, found: EstimatorComparison, known: list[ComparedEstimator]) -> None:
    """Error of the angle at the worst load over the speed."""
    omega, reached = found.asked.omega, found.asked.reached
    for k, row in enumerate(known):
        assert row.figures is not None
        worst = np.degrees(np.max(np.where(reached, row.figures.angle, 0.0), axis=1))
        shown = np.where(np.isfinite(worst) & (worst > 0.0), worst, np.nan)
        axes.plot(
            100.0 * omega[1:] / found.asked.omega_max,
            shown[1:],
            color=SERIES[k % len(SERIES)],
            label=row.candidate.name,
            linestyle=_DASHES[k % len(_DASHES)],
            marker=".",
        )
    axes.axhline(math.degrees(ANGLE_LIMIT), color=MUTED, linewidth=0.7, linestyle="--")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set(
        ylim=(_LEAST, _LARGEST),
        xlabel="Speed in % of the largest",
        ylabel="Angle in deg r.m.s.",
        title="Error at the worst load",
    )
    if known:
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, -0.24),
            frameon=False,
            fontsize=6.5,
            ncols=3,
            handlelength=1.4,
        )


def draw_capture(axes: Axes, found: CaptureMap, speed: int) -> None:
    """Starts at one speed: coloured where they lock, white where they are lost.

    Args:
        axes: To draw into.
        found: The map.
        speed: Index of the speed.
    """
    outcome = found.outcome[speed]
    code = np.where(outcome == LOCKED, 0, np.where(outcome == HALF_TURN, 1, -1))
    draw_cells(
        axes,
        code.astype(np.int64),
        _edges(np.degrees(found.angles)),
        _edges(100.0 * found.speeds),
        (WINNERS[2], _HALF_TURN_COLOUR),
        ("locks", "half a turn off"),
    )
    axes.set(
        xlim=(-180, 180),
        ylim=(100.0 * found.speeds[0], 100.0 * found.speeds[-1]),
        title=f"{found.omega[speed] / _TURN:.3g} Hz",
    )
    axes.set_xticks([-180, -90, 0, 90, 180])
    axes.tick_params(labelsize=7.0)
    axes.plot([0.0], [0.0], marker="+", color=MAP_INK, label="_")
    axes.grid(visible=False)


def _edges(
    values: np.ndarray[tuple[int, ...], np.dtype[np.float64]],
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Borders halfway between ascending values that lie unevenly."""
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([values[:1], middle, values[-1:]])


def _draw_captures(figure: Figure, found: CaptureMap, name: str, height: float) -> None:
    count = len(found.omega)
    width = 0.9 / count
    first = None
    for k in range(count):
        box = (0.085 + k * width, 0.45 / height, 0.82 * width, 1.25 / height)
        axes = figure.add_axes(box, sharey=first)
        draw_capture(axes, found, k)
        axes.set_xlabel("Start angle off by deg", fontsize=7.5)
        if first is None:
            first = axes
            axes.set_ylabel("Speed off by %")
        else:
            axes.tick_params(labelleft=False)
    figure.text(
        0.5,
        1.98 / height,
        f"Starts from which {name} locks (orange: half a turn off)",
        ha="center",
        fontsize=8,
    )
