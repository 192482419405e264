"""From the index of a row to what goes into it: the values of all keys that vary or are drawn.

Rows are the points of the grid, the last axis quickest; where something is drawn, each point has
``draw.count`` rows, and every point has the same draws: its machines are those of its neighbours.
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.design_keys import DesignKey, design_key
from dqforge.machines.exploration.recent import Recent
from dqforge.machines.exploration.study import Axis, Study
from dqforge.machines.exploration.study_checks import grid_rows
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.draws import draw_values
from dqforge.optimizer.exploration.row_block import INPUT_COLUMN, ColumnSpec

# By key, shape (n,): numbers in SI units, or places in the words of its `ColumnSpec`.
Inputs = Mapping[str, FloatArray | NDArray[np.int32]]


@dataclass(frozen=True, slots=True, eq=False)
class InputKey:
    """A key whose value differs between rows.

    Args:
        key: What stands there in a design.
        spec: Its column.
        steps: Values of its axis as a design file writes them, empty where it is drawn.
        values: Of each step the number in SI units, or the place of its word in ``spec.choices``.
        kind: Convention that the values of the study name (``line-to-line``), None for that of the
            design.
    """

    key: DesignKey
    spec: ColumnSpec
    steps: tuple[YamlValue, ...] = ()
    values: FloatArray | NDArray[np.int32] | None = None
    kind: str | None = None

    def assigned(self, value: float) -> YamlValue:
        """What a design file says for a number in SI units, or for the place of a word."""
        if self.spec.kind == "number":
            return self.key.written(float(value), self.kind)
        places = [] if self.values is None else list(self.values)
        return self.steps[places.index(value)]


def _input_keys(study: Study) -> tuple[InputKey, ...]:
    found = [_of_axis(axis, place) for axis in study.axes for place in range(len(axis.keys))]
    for tolerance in study.tolerances:
        key = _known(tolerance.key)
        found.append(InputKey(key, ColumnSpec(INPUT_COLUMN + tolerance.key, key.unit)))
    return tuple(found)


_KEYS = Recent(_input_keys)


def input_keys(study: Study) -> tuple[InputKey, ...]:
    """Keys that differ between rows: those of the axes in their order, then those drawn."""
    return _KEYS.of(study)


def input_columns(study: Study) -> tuple[ColumnSpec, ...]:
    """Their columns."""
    return tuple(entry.spec for entry in input_keys(study))


def row_inputs(study: Study, first: int, end: int) -> Inputs:
    """What goes into rows first to end - 1 of a study on a grid, by key.

    Args:
        study: With axes, tolerances or neither.
        first, end: Range of rows, 0 <= first <= end <= `row_count`.
    """
    rows = np.arange(first, end, dtype=np.int64)
    draws = 1 if study.draw is None else study.draw.count
    places = np.unravel_index(
        rows // draws, tuple(len(axis.steps) for axis in study.axes) or (grid_rows(study),)
    )
    found: dict[str, FloatArray | NDArray[np.int32]] = {}
    entries = iter(input_keys(study))
    for axis, place in zip(study.axes, places, strict=False):
        for _ in axis.keys:
            entry = next(entries)
            if entry.values is not None:
                found[entry.key.name] = entry.values[place]
    if study.draw is not None:
        found |= _drawn(study, first, end)
    return found


def chosen_inputs(study: Study, points: FloatArray) -> Inputs:
    """What goes into rows that a search chose, by key.

    Args:
        study: With axes alone.
        points: One column per axis, shape (n, A): numbers in SI units where it is continuous, else
            the places of its steps.
    """
    found: dict[str, FloatArray | NDArray[np.int32]] = {}
    entries = iter(input_keys(study))
    for axis, column in zip(study.axes, points.T, strict=True):
        for _ in axis.keys:
            entry = next(entries)
            if axis.continuous:
                found[entry.key.name] = column.copy()
            elif entry.values is not None:
                found[entry.key.name] = entry.values[column.astype(np.intp)]
    return found


def row_assignments(study: Study, inputs: Inputs, place: int) -> dict[str, YamlValue]:
    """Keys of one row as `design_of` takes them.

    Args:
        study: The study.
        inputs: As `row_inputs`, or chosen by a search.
        place: Of the row in them.
    """
    return {
        entry.key.name: entry.assigned(inputs[entry.key.name][place]) for entry in input_keys(study)
    }


def _drawn(study: Study, first: int, end: int) -> dict[str, FloatArray]:
    """Drawn values of rows first to end - 1; each point of the grid begins with the first draw."""
    draw = study.draw
    if draw is None or first == end:
        return {tolerance.key: np.empty(0) for tolerance in study.tolerances}
    pieces = []
    while first < end:
        begin = first % draw.count
        count = min(end - first, draw.count - begin)
        pieces.append(
            draw_values(draw, study.tolerances, begin, begin + count, saltelli=study.saltelli)
        )
        first += count
    return {key: np.concatenate([piece[key] for piece in pieces]) for key in pieces[0]}


def _known(name: str) -> DesignKey:
    key = design_key(name)
    if key is None:
        raise InputError(f"{name}: no such key in a design")
    return key


def _of_axis(axis: Axis, place: int) -> InputKey:
    """One key of an axis: numbers, or words in sorted order."""
    key = _known(axis.keys[place])
    steps = tuple(step[place] for step in axis.steps)
    name = INPUT_COLUMN + key.name
    if axis.numbers:
        _, kind = key.number(steps[0])
        numbers = np.array([step[place] for step in axis.numbers])
        return InputKey(key, ColumnSpec(name, key.unit), steps, numbers, kind)
    labels = labels_of(steps)
    choices = tuple(sorted(set(labels)))
    codes = np.array([choices.index(label) for label in labels], dtype=np.int32)
    return InputKey(key, ColumnSpec(name, "", "choice", choices), steps, codes)


def labels_of(steps: tuple[YamlValue, ...]) -> tuple[str, ...]:
    """What tables call the values of an axis: their one word, or all of them where that leaves
    open which is meant.
    """
    short = tuple(_short(step) for step in steps)
    distinct = {json.dumps(step, sort_keys=True) for step in steps}
    return short if len(set(short)) == len(distinct) else tuple(_long(step) for step in steps)


def _short(value: YamlValue) -> str:
    if isinstance(value, dict):
        for key in ("name", "file"):
            if isinstance(value.get(key), str):
                return str(value[key])
    if isinstance(value, list) and len(value) == 1:
        return _short(value[0])
    return _long(value)


def _long(value: YamlValue) -> str:
    return (
        value if isinstance(value, str) else json.dumps(value, sort_keys=True, ensure_ascii=False)
    )
