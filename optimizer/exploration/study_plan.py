"""The rows of a study: which there are, and how a block of them is computed.

Rows go in groups that share everything but numbers of a linear drive; what formulas for many
machines give is computed together, the rest one design at a time, each step once for equal inputs.
A block holds the same numbers wherever and whenever it is computed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.design.design import Design
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import row_count
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.audit import audited_rows, deviations, largest
from dqforge.optimizer.exploration.block_groups import LEAST_TOGETHER, Grouping, key_bounds
from dqforge.optimizer.exploration.block_rows import BlockRows
from dqforge.optimizer.exploration.group_rows import fill_group, goes_together
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    ColumnKind,
    ColumnSpec,
    RowBlock,
)
from dqforge.optimizer.exploration.row_inputs import (
    Inputs,
    input_columns,
    input_keys,
    row_inputs,
)
from dqforge.optimizer.exploration.row_keys import row_keys
from dqforge.optimizer.exploration.study_limits import NamedLimit, hold_limits, study_limits
from dqforge.optimizer.exploration.yield_rows import YieldStudy, fill_yields, nominal_inverter
from dqforge.optimizer.variant_steps.asked_steps import Asked
from dqforge.optimizer.variant_steps.exact_steps import ExactSteps
from dqforge.optimizer.variant_steps.loss_tables import LossGrid
from dqforge.optimizer.variant_steps.outputs import Output, named_outputs, study_outputs
from dqforge.optimizer.variant_steps.step_cache import Work
from dqforge.optimizer.variant_steps.variation import batch_keys, variation
from dqforge.optimizer.yields.fixed_header import FixedHeader, nominal_header
from dqforge.optimizer.yields.yield_outputs import check_outputs

# Rows per part: of machines under a fixed header, of rows that formulas compute together, and of
# designs made one by one.
YIELD_BATCH, TOGETHER_BATCH, SINGLE_BATCH = 10_000, 1_000, 25
_CARRIER_KEY, _MODULATORS_KEY = "inverter.switching_frequency", "losses.modulations"


@dataclass(frozen=True, slots=True, eq=False)
class StudyPlan:
    """Rows of a study (a `RowSource`).

    Args:
        study: The study.
        header: The header that it names, read; None where it names none, or one that is made now.

    Raises:
        InputError: The study asks for what its design cannot give; with the place in the study.
    """

    study: Study
    header: FixedHeader | None = None
    _made: _Made = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Check names, and find out what goes together."""
        object.__setattr__(self, "_made", _prepared(self.study, self.header))

    def __reduce__(self) -> tuple[type[StudyPlan], tuple[object, ...]]:
        """Travel as what it was made of; what is known of steps stays."""
        return StudyPlan, (self.study, self.header)

    @property
    def count(self) -> int:
        """Number of rows."""
        return row_count(self.study)

    @property
    def batch(self) -> int:
        """Rows per part, by the kind of the study."""
        return self._made.batch

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        """Columns of every block: what went in, then what came out."""
        outputs = tuple(_column(output) for output in self._made.asked.outputs)
        return input_columns(self.study) + outputs

    @property
    def work(self) -> Work:
        """Steps that were computed here so far, those of audited rows left out."""
        return self._made.steps.work

    @property
    def base(self) -> Design:
        """The design that the study starts from, with what it sets."""
        return self._made.base

    def rows(self, first: int, end: int) -> RowBlock:
        """Rows first to end - 1 of the study, computed.

        Args:
            first, end: Range of rows, 0 <= first < end <= ``count``.

        Raises:
            ValueError: The rows are those of a search, which follow from each other.
        """
        return self.rows_of(self.inputs(first, end), first, end - first)

    def inputs(self, first: int, end: int) -> Inputs:
        """What goes into rows first to end - 1, by key; the range as for `rows`.

        Args:
            first, end: Range of rows.
        """
        if self.study.search is not None:
            raise ValueError("rows of a search have inputs of their own: ask rows_of")
        return row_inputs(self.study, first, end)

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        """Keys of rows first to end - 1, shape (n, 16); the range as for `rows`.

        Args:
            first, end: Range of rows.
        """
        return self.keys_of(self.inputs(first, end))

    def keys_of(self, inputs: Inputs) -> NDArray[np.uint8]:
        """Keys of rows with inputs that somebody chose, shape (n, 16).

        Args:
            inputs: As for `rows_of`.
        """
        return row_keys(self.study, inputs, self._names)

    @property
    def _names(self) -> list[str]:
        return [output.name for output in self._made.asked.outputs]

    def rows_of(self, inputs: Inputs, first: int, count: int) -> RowBlock:
        """Rows with inputs that somebody chose, such as a search.

        Args:
            inputs: By key, shape (N,): as `row_inputs` gives them.
            first: Index of the first of them in the study.
            count: Number of rows N.
        """
        made = self._made
        block = BlockRows(count, made.asked.outputs)
        for group in made.grouping.groups(inputs, count):
            if made.yields is not None:
                fill_yields(made.yields, block, group)
            else:
                fill_group(made.steps, made.asked, block, group)
        hold_limits(block, made.limits)
        values = {INPUT_COLUMN + name: column for name, column in inputs.items()}
        found = {OUTPUT_COLUMN + name: column for name, column in block.plain().items()}
        return RowBlock(
            first=first,
            columns={spec.name: {**values, **found}[spec.name] for spec in self.columns},
            keys=self.keys_of(inputs),
            states=block.states,
            messages=tuple(block.messages),
            audited=self._audited(inputs, first, block),
        )

    def _audited(self, inputs: Inputs, first: int, block: BlockRows) -> Mapping[str, float]:
        """Largest deviations of rows that are computed once more, one design at a time."""
        made = self._made
        found = []
        for index in audited_rows(first, first + block.count):
            row = index - first
            alone = {name: column[row : row + 1] for name, column in inputs.items()}
            single = BlockRows(1, made.asked.outputs)
            self._single(alone, single)
            outputs = made.asked.outputs
            found.append(deviations(outputs, row, block.columns, single.columns))
        return largest(found)

    def _single(self, inputs: Inputs, block: BlockRows) -> None:
        """One row by the single path, with nothing that is known of others."""
        made = self._made
        for group in Grouping(self.study, {}, Work()).groups(inputs, 1):
            if made.yields is not None:
                fill_yields(made.yields, block, group)
            else:
                fill_group(ExactSteps(), made.asked, block, group)


@dataclass(frozen=True, slots=True, eq=False)
class _Made:
    """What follows from a study before any of its rows."""

    base: Design
    asked: Asked
    limits: tuple[NamedLimit, ...]
    steps: ExactSteps
    grouping: Grouping
    yields: YieldStudy | None
    batch: int


def _prepared(study: Study, header: FixedHeader | None) -> _Made:
    base = design_of(study, {})
    asked = Asked(study_outputs(study, base), named_outputs(study, base))
    steps = ExactSteps(_grid(study, base))
    fixed = _header(study, base, header)
    bounds = key_bounds(study)
    drawn = [tolerance.key for tolerance in study.tolerances]
    grouping = Grouping(study, bounds, steps.work)
    make = grouping.corner_maker({})
    usable = [key for key in batch_keys(make, bounds) if fixed is None or key in drawn]
    if not _many(study, usable):
        usable = []
    grouping.bounds = {key: bounds[key] for key in usable}
    batch = SINGLE_BATCH
    if fixed is not None:
        batch = YIELD_BATCH
    elif usable:
        found = variation(make, grouping.bounds)
        if found is not None and goes_together(steps, asked, found, LEAST_TOGETHER):
            batch = TOGETHER_BATCH
    steps.work.designs = 0
    yields = None
    if fixed is not None:
        check_outputs(fixed, [o.name for o in asked.outputs if o.step != "losses"])
        yields = YieldStudy(fixed, asked, nominal_inverter(base, drawn))
    return _Made(base, asked, study_limits(study, base), steps, grouping, yields, batch)


def _column(output: Output) -> ColumnSpec:
    kind: ColumnKind = "choice" if output.choices else "number"
    return ColumnSpec(OUTPUT_COLUMN + output.name, output.unit, kind, output.choices)


def _header(study: Study, base: Design, header: FixedHeader | None) -> FixedHeader | None:
    """The fixed header of the study, made now where it says so; None without one."""
    if study.header == "nominal":
        return nominal_header(base)
    return header if study.header else None


def _grid(study: Study, base: Design) -> LossGrid:
    """Modulators and frequencies that the rows have."""
    modulations: set[str] = set() if base.losses is None else set(base.losses.modulations)
    frequencies = {base.inverter.f_sw}
    for entry in input_keys(study):
        if entry.key.name == _CARRIER_KEY:
            frequencies = set() if entry.values is None else set(map(float, entry.values))
        if entry.key.name == _MODULATORS_KEY:
            modulations = {name for step in entry.steps for name in _names(step)}
    order = [name for name in MODULATORS if name in modulations]
    return LossGrid(tuple(order), tuple(sorted(frequencies)))


def _names(step: YamlValue) -> list[str]:
    return [str(name) for name in step] if isinstance(step, list) else []


def _many(study: Study, usable: Sequence[str]) -> bool:
    """Whether enough rows share everything but these keys."""
    if not {tolerance.key for tolerance in study.tolerances} <= set(usable):
        return False
    others = 1
    for axis in study.axes:
        if not set(axis.keys) <= set(usable):
            if study.search is not None and axis.continuous:
                return False
            others *= len(axis.steps)
    return row_count(study) >= LEAST_TOGETHER * others
