"""The rows of a study: which there are, and how a block of them is computed.

Rows go in groups that share everything but numbers of a linear drive; what formulas for many
machines give is computed together, the rest one design at a time, each step once for equal inputs.
A block holds the same numbers wherever and whenever it is computed.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, ScaledMachines
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Bound, Study
from dqforge.machines.exploration.study_checks import row_count
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.exploration.block_rows import (
    LEAST_TOGETHER,
    BlockRows,
    Column,
    ExactSteps,
    Group,
    Grouping,
    fill_group,
    goes_together,
    key_bounds,
    put_losses,
)
from dqforge.optimizer.exploration.row_block import (
    INPUT_COLUMN,
    OUTPUT_COLUMN,
    STATES,
    ColumnKind,
    ColumnSpec,
    Inputs,
    RowBlock,
    input_columns,
    input_keys,
    row_inputs,
    row_keys,
    within,
)
from dqforge.optimizer.exploration.row_outputs import (
    Asked,
    LossColumns,
    LossGrid,
    LossRows,
    Output,
    bound_output,
    loss_columns,
    mapped,
    named_outputs,
    output_named,
    study_outputs,
)
from dqforge.optimizer.exploration.variation import (
    BatchRows,
    Work,
    batch_keys,
    point_weights,
    variation,
)
from dqforge.optimizer.exploration.yields import (
    FixedDrive,
    FixedHeader,
    Machines,
    check_outputs,
    header_budget,
    nominal_header,
    yield_outputs,
)
from dqforge.optimizer.losses.loss_map import budget_options

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
            raise ValueError("rows of a search have their own inputs: use rows_of")
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


# Rows of a study whose header is fixed: what it makes of every machine.


@dataclass(frozen=True, slots=True)
class YieldStudy:
    """A header and what is asked of it.

    Args:
        header: What is flashed to every drive.
        asked: What the study asks for.
        nominal: Fields of the inverter that are drawn, with their values in the design itself:
            losses are those at its link and carrier.
    """

    header: FixedHeader
    asked: Asked
    nominal: Mapping[str, float]

    def point_drive(self, design: Design) -> Design:
        """A design with the link and the carrier at which losses are stated."""
        nominal: dict[str, Any] = dict(self.nominal)
        return replace(design, inverter=replace(design.inverter, **nominal))


_DRAWN_FIELDS = {
    "inverter.v_dc": "v_dc",
    "inverter.switching_frequency": "f_sw",
    "inverter.max_current": "i_max",
}


def nominal_inverter(base: Design, drawn: Collection[str]) -> dict[str, float]:
    """Fields of the inverter that are drawn, with their values in the design itself.

    Args:
        base: The design that the study starts from.
        drawn: Keys that are drawn.
    """
    found = {
        name: getattr(base.inverter, name) for key, name in _DRAWN_FIELDS.items() if key in drawn
    }
    return {name: value for name, value in found.items() if value is not None}


def fill_yields(study: YieldStudy, block: BlockRows, group: Group) -> None:
    """Compute all outputs of the machines of a group.

    Args:
        study: Header and outputs.
        block: Filled; rows whose design is refused end there.
        group: The rows.
    """
    if group.variation is not None:
        rows = BatchRows(group.variation.base, group.variation.columns(group.numbers), study.asked)
        machines, fine = rows.drawn_machines()
        voltage = rows.of("inverter").get("v_dc", np.array(rows.base.inverter.v_dc))
        voltage = np.broadcast_to(voltage, (rows.count,))[fine]
        drive = study.point_drive(rows.base)
        _fill(study, block, group.rows[fine], (machines, voltage), drive)
        left = np.flatnonzero(~fine)
    else:
        left = np.arange(group.rows.size)
    for place in left.tolist():
        row = group.rows[place : place + 1]
        try:
            design = group.design(place)
            machines = _one_machine(design)
            voltage = np.array([design.inverter.v_dc])
            _fill(study, block, row, (machines, voltage), study.point_drive(design))
        except DqforgeError as error:
            block.refuse(row, error)


def _one_machine(design: Design) -> Machines:
    """The machine of a design as a batch of one, with its own map where it has one."""
    machine = design.machine
    if design.phase_machine is None and isinstance(machine, LinearMachine):
        return MachineBatch.of([machine])
    if design.phase_machine is None and isinstance(machine, SaturatedMachine):
        return ScaledMachines.varied(machine, 1, {})
    raise InputError("header: a fixed header is tried on machines with sinusoidal back-EMF alone")


def _fill(
    study: YieldStudy,
    block: BlockRows,
    rows: IndexArray,
    drives: tuple[Machines, FloatArray],
    design: Design,
) -> None:
    """Fill in all outputs of machines with their link voltages in V."""
    machines, v_dc = drives
    names = [output.name for output in study.asked.outputs if output.step != "losses"]
    block.put(rows, yield_outputs(study.header, machines, names, v_dc))
    if study.asked.of_step("losses"):
        put_losses(block, rows, _losses(study, machines, design))


def _losses(study: YieldStudy, machines: Machines, design: Design) -> LossColumns:
    """Columns of losses, with the currents of the header, by the inverter of a design."""
    losses, outputs = design.losses, study.asked.of_step("losses")
    if losses is None or not losses.points:
        raise InputError("losses: this variant names no operating points")
    modulations = _modulations(outputs, losses.modulations)
    found = header_budget(
        FixedDrive(study.header, design.inverter, budget_options(design)),
        machines,
        np.array([point.torque for point in losses.points]),
        np.array([point.omega_m for point in losses.points]),
        modulations,
    )
    count = len(losses.points)

    def by_point(values: NDArray[Any]) -> NDArray[Any]:
        return np.swapaxes(values[:, 0].reshape(-1, machines.count, count), -1, -2)[None]

    budget = mapped(found, by_point)
    rows = LossRows(
        ("mtpa",),
        modulations,
        losses.points,
        budget,
        np.ones(budget.total.shape, dtype=np.bool_),
        point_weights(losses.points),
    )
    return loss_columns(rows, outputs)


def _modulations(
    outputs: tuple[Output, ...], listed: tuple[ModulationName, ...]
) -> tuple[ModulationName, ...]:
    """Modulators of the design that the outputs look at: all, unless each names its own."""
    named = {"" if output.point is None else output.point.modulation for output in outputs}
    return listed if "" in named else tuple(name for name in listed if name in named)


# Limits of a study held against the columns of a block.

_DIGITS = 6


@dataclass(frozen=True, slots=True)
class NamedLimit:
    """A limit with the output that it looks at, in SI units, and its place in the study."""

    output: str
    unit: str
    place: str
    bound: Bound

    def broken(self, values: FloatArray) -> BoolArray:
        """Where values lie beyond the limit, or do not exist.

        Args:
            values: Values in SI units, any shape.
        """
        return ~within(values, self.bound.below, self.bound.above)

    def words(self, value: float) -> str:
        """What is wrong with a value that breaks the limit."""
        if np.isnan(value):
            return f"{self.place}: there is no value"
        low, high = self.bound.above, self.bound.below
        above = high is not None and value > high
        end, side = (high, "above") if above else (low, "below")
        assert end is not None
        found, bound = (format_quantity(each, self.unit, _DIGITS) for each in (value, end))
        return f"{self.place}: {found} is {side} {bound}"


def study_limits(study: Study, design: Design) -> tuple[NamedLimit, ...]:
    """The limits of a study whose names are checked.

    Args:
        study: The study.
        design: The design it starts from.
    """
    found = []
    for bound in study.limits:
        name = bound_output(bound, design)
        output = output_named(name)
        assert output is not None
        found.append(NamedLimit(name, output.unit, _place(study, bound.output), bound))
    return tuple(found)


def _place(study: Study, name: str) -> str:
    if study.places is None:
        return f"limits.{name}"
    line, column = study.places.of_key(("limits", name))
    return f"{study.places.source}:{line}:{column}: limits.{name}"


def hold_limits(block: BlockRows, limits: Sequence[NamedLimit]) -> None:
    """End rows whose numbers break a limit.

    Args:
        block: Rows with all their columns.
        limits: The limits.
    """
    ended = block.states > STATES.index("limit")
    for limit in limits:
        values = np.asarray(block.columns[limit.output], dtype=np.float64)
        for row in np.flatnonzero(limit.broken(values) & ~ended).tolist():
            block.end(row, "limit", limit.words(float(values[row])))


# Rows that were computed together, computed once more one by one: how far the two are apart.

EVERY = 1000  # Of every so many rows of a study one is computed by both paths.


def audited_rows(first: int, end: int) -> range:
    """Rows first to end - 1 that both paths compute.

    Args:
        first, end: Rows of a block.
    """
    return range(first + (-first) % EVERY, end, EVERY)


def deviations(
    outputs: Sequence[Output],
    row: int,
    batch: Mapping[str, Column],
    single: Mapping[str, Column],
) -> dict[str, float]:
    """Relative deviation of every number of a row from the single path's, by output.

    A number that only one of the two paths has deviates infinitely; so does another choice. What
    says which path was taken is no number of the design.

    Args:
        outputs: What was asked for.
        row: Place of the row in ``batch``.
        batch: Columns of the block.
        single: Columns of the row alone.
    """
    return {
        output.name: _apart(float(batch[output.name][row]), float(single[output.name][0]))
        for output in outputs
        if output.name != "fit.path"
    }


def _apart(batch: float, single: float) -> float:
    if batch == single or (np.isnan(batch) and np.isnan(single)):
        return 0.0
    if not (np.isfinite(batch) and np.isfinite(single)):
        return float("inf")
    return abs(batch - single) / max(abs(single), abs(batch))


def largest(found: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Largest deviations of several rows, by output in the order of the first.

    Args:
        found: Deviations of each row.
    """
    names = found[0] if found else ()
    return {name: max(each[name] for each in found) for name in names}
