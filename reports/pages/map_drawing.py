"""Maps over torque and speed as figures draw them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


WINNERS = ("#9ec5e8", "#f0b36b", "#8fc9b9", "#d9a0c7", "#e6dc8c", "#b8aee0", "#c4a484", "#9fb0bd")


OTHERS = "#dfe3e8"


def cell_edges(values: FloatArray) -> FloatArray:
    """Borders of cells around ascending values."""
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate(
        [[1.5 * values[0] - 0.5 * values[1]], middle, [1.5 * values[-1] - 0.5 * values[-2]]]
    )


def _blocks(code: NDArray[np.int64]) -> list[tuple[int, int, int, int, int]]:
    """Rectangles (code, first row, end row, first column, end column) of equal cells.

    Rows join where they repeat.
    """
    found: list[tuple[int, int, int, int, int]] = []
    growing: dict[tuple[int, int, int], int] = {}
    for i in range(code.shape[0] + 1):
        runs: set[tuple[int, int, int]] = set()
        if i < code.shape[0]:
            bounds = [0, *(np.flatnonzero(np.diff(code[i])) + 1).tolist(), code.shape[1]]
            runs = {(int(code[i, a]), a, b) for a, b in pairwise(bounds) if code[i, a] >= 0}
        found += [
            (run[0], start, i, run[1], run[2]) for run, start in growing.items() if run not in runs
        ]
        growing = {run: growing.get(run, i) for run in sorted(runs)}
    return found


def draw_cells(
    axes: Axes,
    code: NDArray[np.int64],
    speed: FloatArray,
    torque: FloatArray,
    colours: Sequence[str] = (*WINNERS, OTHERS),
    names: Sequence[str] = (),
) -> None:
    """Cells in the colours of their codes, none where negative, as few rectangles.

    Borders in rpm and N m. ``names`` are those of the codes in the data, where no legend says them.
    """
    from matplotlib.patches import Rectangle

    for kind, low, high, left, right in _blocks(code):
        size = (float(speed[right] - speed[left]), float(torque[high] - torque[low]))
        corner = (float(speed[left]), float(torque[low]))
        # A thin line of the same colour closes the seams between rectangles.
        axes.add_patch(
            Rectangle(
                corner,
                *size,
                facecolor=colours[kind],
                edgecolor=colours[kind],
                linewidth=0.4,
                label=f"_{names[kind]}" if names else "",
            )
        )


def inside(mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> tuple[int, int]:
    """The cell of a region farthest from its border, by shrinking it as long as anything is
    left.
    """
    rest = mask.copy()
    while True:
        padded = np.pad(rest, 1)
        less = rest & padded[2:, 1:-1] & padded[:-2, 1:-1] & padded[1:-1, 2:] & padded[1:-1, :-2]
        if not np.any(less):
            break
        rest = less
    rows, columns = np.nonzero(rest)
    middle = int(np.argmin(np.hypot(rows - np.mean(rows), columns - np.mean(columns))))
    return int(rows[middle]), int(columns[middle])
