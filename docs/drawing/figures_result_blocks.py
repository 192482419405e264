"""Block drawings of what a run and a study write: a tree of results, keys by command, rows."""

from __future__ import annotations

import json
import math
import re
import textwrap
from pathlib import Path
from typing import Any

from blocks import Block, arrow, draw, label, sheet, write
from figures_explore import shipped
from matplotlib.axes import Axes
from page_text import DOCS, table

from dqforge import emit, load_design
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.reports.pages.figures_style import (
    BLUE,
    FAINT,
    MUTED,
    ORANGE,
    PURPLE,
    TEAL,
    save,
    style,
)

_TREE = (
    "format",
    "input",
    "input.assumptions",
    "fit",
    "fit.torque_max_Nm",
    "fit.certificate",
    "fit.certificate.torque_relative",
    "gains",
    "gains.speed",
    "gains.speed.kp",
    "gains.speed.crossover_rad_per_s",
    "gains.speed.phase_margin_rad",
    "losses",
)

_ROW, _INDENT = 0.235, 0.3


@style()
def tree(path: Path) -> None:
    """Some keys of a result with their values, and what they are in other units."""
    result = json.loads(
        emit(load_design(DOCS / "how-to" / "files" / "hub.yaml")).files["result.json"]
    )
    height = 0.3 + _ROW * (len(_TREE) + 1)
    figure, axes = sheet("result-tree", height, "Keys of a result and their values")
    top = height - 0.22
    write(axes, (0.15, top), "result.json of hub.yaml", bold=True)
    last: dict[int, float] = {-1: top}
    for place, dotted in enumerate(_TREE, start=1):
        depth, y = dotted.count("."), top - _ROW * place
        last[depth] = y
        _branch(axes, depth, last[depth - 1], y)
        name = dotted.rpartition(".")[2]
        write(axes, (0.15 + _INDENT * (depth + 1), y), name)
        value, meaning = _told(result, dotted)
        write(axes, (3.75, y), value, bold=True)
        label(axes, (4.75, y), meaning, "left")
    save(figure, path)


def _branch(axes: Axes, depth: int, above: float, y: float) -> None:
    """The corner that leads from the key above to this one."""
    x = 0.22 + _INDENT * depth
    axes.plot([x, x, x + 0.16], [above - 0.11, y, y], color=FAINT, linewidth=1.2)


def _told(result: dict[str, Any], dotted: str) -> tuple[str, str]:
    """Text of a value, empty of a mapping, and what it means."""
    value: Any = result
    for name in dotted.split("."):
        value = value[name]
    if value is None:
        return "null", "not requested"
    if isinstance(value, list):
        return str(len(value)), "sentences"
    if isinstance(value, dict):
        return "", ""
    meanings = {
        "format": "version of the keys",
        "kp": "N m s/rad",
        "torque_max_Nm": "N m",
        "torque_relative": "proven, a share",
        "crossover_rad_per_s": f"{value / (2.0 * math.pi):.1f} Hz",
        "phase_margin_rad": f"{math.degrees(value):.1f} deg",
    }
    return f"{value:.4g}", meanings[dotted.rpartition(".")[2]]


_COMMANDS = (
    ("check", TEAL, 0),
    ("mtpa", BLUE, 0),
    ("fit", BLUE, 0),
    ("losses", ORANGE, 0),
    ("dqy", ORANGE, 0),
    ("tune", PURPLE, 1),
    ("simulate", PURPLE, 1),
    ("verify", TEAL, 1),
    ("export", MUTED, 1),
)


@style()
def keys(path: Path) -> None:
    """Keys at the top by the command that prints them, from the table of the page."""
    found: dict[str, list[str]] = {name: [] for name, _, _ in _COMMANDS}
    for names, row in table("reference/json.md", "key").items():
        commands = {words.split()[0] for words in re.findall(r"`([^`]+)`", row["from"])}
        for command in commands & set(found):
            found[command] += re.findall(r"`([^`]+)`", names)
    height = 3.8
    figure, axes = sheet("result-keys", height, "Keys at the top by the command that prints them")
    low = [height - 0.1] * 2
    for command, colour, column in _COMMANDS:
        lines = textwrap.wrap(", ".join(dict.fromkeys(found[command])), 42, break_on_hyphens=False)
        block = Block(
            0.1 + 3.45 * column, low[column], 3.35, f"dqforge {command}", tuple(lines), colour
        )
        draw(axes, block)
        low[column] -= block.height + 0.1
    save(figure, path)


@style()
def study(path: Path) -> None:
    """From the keys of a study file to rows, and from these to answers."""
    grid, drawn = shipped("modules-and-modulators"), shipped("production-yield")
    assert drawn.draw is not None
    sizes = " x ".join(str(len(axis.steps)) for axis in grid.axes)
    rows = StudyPlan(grid).count
    figure, axes = sheet("study-course", 3.3, "From the keys of a study file to its answers")
    asked = (
        Block(0.1, 3.2, 2.35, "design, set", ("one drive, keys changed",), TEAL),
        Block(0.1, 2.4, 2.35, "vary", (f"all of {sizes} values",)),
        Block(0.1, 1.6, 2.35, "tolerances, draw", (f"{drawn.draw.count} machines",)),
        Block(0.1, 0.8, 2.35, "search", ("between ends of ranges",)),
    )
    made = Block(
        2.95, 2.2, 1.4, "rows", (f"{rows} of a grid", "one design each", "outputs"), ORANGE
    )
    told = (
        Block(4.85, 3.2, 2.05, "limits", ("ok, limit, refused",), PURPLE),
        Block(4.85, 2.4, 2.05, "pareto", ("the front",), PURPLE),
        Block(4.85, 1.6, 2.05, "accept", ("the yield",), PURPLE),
        Block(4.85, 0.8, 2.05, "sensitivity", ("what it depends on",), PURPLE),
    )
    draw(axes, *asked, made, *told)
    for block in asked:
        arrow(axes, block.right, (2.7, block.right[1]), (2.7, made.left[1]), made.left)
    for block in told:
        arrow(axes, made.right, (4.6, made.right[1]), (4.6, block.left[1]), block.left)
    save(figure, path)
