"""Rows of a block in groups that differ in numbers alone, with what those numbers may do."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study, Tolerance
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.optimizer.exploration.group_rows import Group
from dqforge.optimizer.exploration.row_block import InputKey, Inputs, input_keys, row_assignments
from dqforge.optimizer.variant_steps.step_cache import Work
from dqforge.optimizer.variant_steps.variation import Corner, Variation, variation

# Rows of a study that share all but numbers, from which on corners are tried: fewer are quicker one
# by one. It counts those of the study, not of a block: a row has the same path in any block.
LEAST_TOGETHER = 16
_MOST_KEPT = 1024
Discrete = tuple[float, ...]


def key_bounds(study: Study) -> dict[str, tuple[float, float]]:
    """Least and largest value of each numeric key in SI units, whatever the rows.

    Args:
        study: The study.
    """
    drawn = {tolerance.key: _ends(tolerance) for tolerance in study.tolerances}
    bounds = {}
    for entry in input_keys(study):
        name = entry.key.name
        if entry.spec.kind != "number":
            continue
        if name in drawn:
            bounds[name] = drawn[name]
        elif entry.values is not None:
            bounds[name] = (float(np.min(entry.values)), float(np.max(entry.values)))
    return {name: ends for name, ends in bounds.items() if ends[0] < ends[1]}


def _ends(tolerance: Tolerance) -> tuple[float, float]:
    if tolerance.kind == "between":
        return tolerance.low, tolerance.high
    scale = abs(tolerance.centre) if tolerance.relative else 1.0
    half = tolerance.width * scale * (tolerance.cut if tolerance.kind == "normal" else 1.0)
    return tolerance.centre - half, tolerance.centre + half


@dataclass(slots=True)
class Grouping:
    """How rows of a study are put together.

    Args:
        study: The study.
        bounds: Ends of the numeric keys that are tried together.
        work: Counts designs.
    """

    study: Study
    bounds: Mapping[str, tuple[float, float]]
    work: Work
    _known: OrderedDict[Discrete, Variation | None] = field(default_factory=OrderedDict)

    @property
    def entries(self) -> Sequence[InputKey]:
        """Keys of the rows."""
        return input_keys(self.study)

    def groups(self, inputs: Inputs, count: int) -> Iterator[Group]:
        """Groups of N rows in the order of their first rows.

        Args:
            inputs: What goes into the rows.
            count: Number of rows.
        """
        fixed = [e.key.name for e in self.entries if e.key.name not in self.bounds]
        for rows in _alike([np.asarray(inputs[name], np.float64) for name in fixed], count):
            numbers = {name: np.asarray(inputs[name], np.float64)[rows] for name in self.bounds}
            shared = tuple(float(inputs[name][rows[0]]) for name in fixed)
            found = None
            if self.bounds:
                found = self._variation(shared, row_assignments(self.study, inputs, int(rows[0])))
            yield Group(rows, numbers, self._maker(inputs, rows), found)

    def _maker(self, inputs: Inputs, rows: IndexArray) -> Callable[[int], Design]:
        def made(place: int) -> Design:
            return design_of(self.study, row_assignments(self.study, inputs, int(rows[place])))

        return made

    def _variation(self, shared: Discrete, first: Mapping[str, YamlValue]) -> Variation | None:
        if shared not in self._known:
            self._known[shared] = variation(self.corner_maker(first), self.bounds)
            if len(self._known) > _MOST_KEPT:
                self._known.popitem(last=False)
        return self._known[shared]

    def corner_maker(self, first: Mapping[str, YamlValue]) -> Callable[[Corner], Design]:
        """Designs of one combination of the other keys.

        Args:
            first: All keys of one row, as a design file says them.
        """
        written = {entry.key.name: entry for entry in self.entries}

        def make(corner: Corner) -> Design:
            self.work.designs += 1
            numbers = {
                name: written[name].key.written(value, written[name].kind)
                for name, value in corner.items()
            }
            return design_of(self.study, {**first, **numbers})

        return make


def _alike(columns: Sequence[FloatArray], count: int) -> list[IndexArray]:
    """Rows that are equal in all columns, in the order of the first of each."""
    if not columns:
        return [np.arange(count)]
    table = np.column_stack([np.asarray(column, dtype=np.float64) for column in columns])
    _, first, which = np.unique(table, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(which.reshape(-1), kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(which.reshape(-1)))[:-1])
    return [parts[place] for place in np.argsort(first, kind="stable")]
