"""Rows of a block while they are computed: columns that fill, how each row ended, and rows one at
a time where numbers alone do not tell them apart.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import located, numerical_errors
from dqforge.machines.design.settings import FitSettings, LossSettings, WaveformSettings
from dqforge.machines.errors import DqforgeError, InputError, NoSolutionError
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study, Tolerance
from dqforge.machines.files.positioned_yaml import YamlValue
from dqforge.machines.losses.machine_budget import NO_EXTRA_LOSS
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import gains_or_reason, solve_current_loops
from dqforge.optimizer.current_reference.fit import signed_designs
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.exploration.row_block import (
    STATES,
    InputKey,
    Inputs,
    RowState,
    input_keys,
    row_assignments,
)
from dqforge.optimizer.exploration.row_outputs import (
    FIT_ERRORS,
    FIT_PATHS,
    LOOP_QUANTITIES,
    STEPS,
    Asked,
    LossColumns,
    LossDrive,
    LossGrid,
    LossRows,
    LossTable,
    Output,
    Step,
    drive_table,
    loss_columns,
    loss_drive,
)
from dqforge.optimizer.exploration.variation import (
    BATCH_STEPS,
    BatchRows,
    Corner,
    StepCache,
    Variation,
    Work,
    key_of,
    of_comparison,
    of_table,
    used_settings,
    variation,
)
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.losses.phase_comparison import LossComparison, compare_points
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.operating_points.solve import current_choice

Column = FloatArray | NDArray[np.int32]

# What a row is called that ends in two ways.
_RANK: Mapping[RowState, int] = {
    "ok": 0,
    "limit": 1,
    "no-solution": 2,
    "refused": 3,
    "crashed": 4,
}


def state_of(error: DqforgeError) -> RowState:
    """How a row ends that is refused with an error.

    Args:
        error: As the single command would print it.
    """
    return "no-solution" if isinstance(error, NoSolutionError) else "refused"


@dataclass(slots=True)
class BlockRows:
    """Columns of N rows by the name of the output, NaN (-1 for choices) until they are filled.

    Args:
        count: Number of rows N.
        outputs: What is asked for.
    """

    count: int
    outputs: Sequence[Output]
    columns: dict[str, Column] = field(init=False)
    states: NDArray[np.int8] = field(init=False)
    messages: list[str] = field(init=False)

    def __post_init__(self) -> None:
        """Start with nothing."""
        self.columns = {
            output.name: np.full(self.count, -1, dtype=np.int32)
            if output.choices
            else np.full(self.count, np.nan)
            for output in self.outputs
        }
        self.states = np.full(self.count, STATES.index("ok"), dtype=np.int8)
        self.messages = [""] * self.count

    def put(self, rows: IndexArray, found: Mapping[str, ArrayLike]) -> None:
        """Fill columns of some rows; what nobody asked for is left out."""
        for name, values in found.items():
            if name in self.columns:
                self.columns[name][rows] = values

    def end(self, row: int, state: RowState, message: str) -> None:
        """Say how a row ended; of several ways the worst, of equal ones the first."""
        if _RANK[state] > _RANK[STATES[self.states[row]]]:
            self.states[row] = STATES.index(state)
            self.messages[row] = message

    def refuse(self, rows: IndexArray, error: DqforgeError) -> None:
        """End rows with what the single command would print."""
        state, message = state_of(error), str(error)
        for row in rows.tolist():
            self.end(row, state, message)

    def plain(self) -> dict[str, Column]:
        """The columns with one NaN and one zero: the same bytes wherever they were computed."""
        return {name: one_kind(values) for name, values in self.columns.items()}


def one_kind(values: Column) -> Column:
    """Numbers with positive quiet NaN and without negative zero; choices as they are.

    Args:
        values: A column.
    """
    if values.dtype != np.float64:
        return values
    return np.where(np.isnan(values), np.nan, values + 0.0)


# One row, or several that share a design, by the exact path: the steps that are asked for, each
# as the single command computes it.


def exact_step(
    steps: ExactSteps, asked: Asked, block: BlockRows, rows: IndexArray, step: Step, design: Design
) -> None:
    """Compute a step of a design and fill it in for all rows that share what it depends on.

    Args:
        steps: The steps, with what is known already.
        asked: What the study asks for.
        block: Filled; rows that are refused end there.
        rows: The rows.
        step: The step.
        design: Their design.
    """
    try:
        if step == "losses":
            put_losses(block, rows, exact_losses(steps, asked, design))
        else:
            block.put(rows, _numbers(steps, step, design))
    except GainsLeftOutError as error:
        if asked.gains_named:
            block.refuse(rows, error)
    except DqforgeError as error:
        block.refuse(rows, error)


def exact_row(
    steps: ExactSteps,
    asked: Asked,
    block: BlockRows,
    row: int,
    design: Design,
    only: Collection[Step] = STEPS,
) -> None:
    """Compute the steps of one row.

    Args:
        steps, asked, block: As in `exact_step`.
        row: Its place in the block.
        design: Its design.
        only: Steps that are still missing.
    """
    for step in asked.steps:
        if step in only:
            exact_step(steps, asked, block, np.array([row]), step, design)


def _numbers(steps: ExactSteps, step: Step, design: Design) -> Numbers:
    if step == "limit":
        return steps.limit(design)
    if step == "fit":
        return {**steps.fit(design), "fit.path": FIT_PATHS.index("exact")}
    if step == "current-loops":
        return steps.current_loops(design)
    return steps.all_loops(design)


def exact_losses(steps: ExactSteps, asked: Asked, design: Design) -> LossColumns:
    """Columns of losses of one design.

    Args:
        steps, asked: As in `exact_step`.
        design: The design.

    Raises:
        DqforgeError: It names no points, or they are refused.
    """
    return loss_columns(_loss_rows(steps, design), asked.of_step("losses"))


def _loss_rows(steps: ExactSteps, design: Design) -> LossRows:
    losses = design.losses
    if losses is None or not losses.points:
        raise InputError("losses: this variant names no operating points")
    table = steps.loss_table(design)
    if table is None:
        return of_comparison(steps.losses(design))
    place = steps.grid.frequencies.index(design.inverter.f_sw)
    return of_table(table, losses, np.array([place]))


def table_losses(
    steps: ExactSteps, asked: Asked, design: Design, frequencies: Sequence[float]
) -> LossColumns | None:
    """Columns of losses of N rows that differ in carrier frequency alone, None where there is no
    table of them.

    Args:
        steps, asked: As in `exact_step`.
        design: The design of one of them.
        frequencies: Their carrier frequencies in Hz.
    """
    known = {value: place for place, value in enumerate(steps.grid.frequencies)}
    losses = design.losses
    if losses is None or not all(value in known for value in frequencies):
        return None
    table = steps.loss_table(design)
    if table is None:
        return None
    places = np.array([known[value] for value in frequencies], dtype=np.intp)
    rows = of_table(table, losses, places)
    return loss_columns(rows, asked.of_step("losses"))


def put_losses(block: BlockRows, rows: IndexArray, found: LossColumns) -> None:
    """Fill in losses, and end rows whose points are not all fine.

    Args:
        block: Filled.
        rows: The rows.
        found: Columns of as many rows, or of one that they share.
    """
    block.put(rows, found.columns)
    shared = found.missing.size == 1
    for place, row in enumerate(rows.tolist()):
        at = 0 if shared else place
        obstacle = found.obstacles.get(at)
        if obstacle is not None:
            block.end(row, "no-solution" if found.missing[at] else "limit", obstacle)


# Rows of a block that share everything but numbers of a linear drive, computed together as far as
# formulas for many machines go; the others one design at a time.

_CARRIER = "inverter.f_sw"


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Rows that differ in numbers alone.

    Args:
        rows: Their places in the block, shape (N,).
        numbers: Values of the keys that vary in SI units, arrays of shape (N,).
        design: The design of one of them by its place in the group.
        variation: How the numbers change the design; None where that is not known: then every row
            is made by itself.
    """

    rows: IndexArray
    numbers: Mapping[str, FloatArray]
    design: Callable[[int], Design]
    variation: Variation | None


def fill_group(steps: ExactSteps, asked: Asked, block: BlockRows, group: Group) -> None:
    """Compute all outputs of the rows of a group.

    Args:
        steps: The exact steps, with what is known already.
        asked: What the study asks for.
        block: Filled.
        group: The rows.
    """
    if group.variation is None:
        for place in range(group.rows.size):
            _fill_row(steps, asked, block, group, place, asked.steps)
        return
    again: dict[int, set[Step]] = {}
    for step in asked.steps:
        missed = _fill_step(steps, asked, block, group, group.variation, step)
        for place in np.flatnonzero(missed).tolist():
            again.setdefault(place, set()).add(step)
    for place, missing in sorted(again.items()):
        _fill_row(steps, asked, block, group, place, missing)


def _fill_row(
    steps: ExactSteps,
    asked: Asked,
    block: BlockRows,
    group: Group,
    place: int,
    only: Collection[Step],
) -> None:
    """One row by the exact path, refused where its design is."""
    row = int(group.rows[place])
    steps.work.designs += 1
    try:
        design = group.design(place)
    except DqforgeError as error:
        block.refuse(np.array([row]), error)
        return
    exact_row(steps, asked, block, row, design, only)


def _fill_step(
    steps: ExactSteps,
    asked: Asked,
    block: BlockRows,
    group: Group,
    variation: Variation,
    step: Step,
) -> BoolArray:
    """Fill in a step for all rows at once; returns those that are still missing, shape (N,)."""
    every = np.ones(group.rows.size, dtype=np.bool_)
    keys = variation.keys_of(partial(steps.key, step))
    if not keys:
        exact_step(steps, asked, block, group.rows, step, variation.base)
        return ~every
    columns = variation.columns(group.numbers)
    names = {name for key in keys for name, _ in variation.effects[key].factors}
    if step == "losses" and names == {_CARRIER}:
        found = table_losses(steps, asked, variation.base, columns[_CARRIER].tolist())
        if found is None:
            return every
        put_losses(block, group.rows, found)
        return ~every
    compute = BATCH_STEPS.get(step)
    if compute is None:
        return every
    rows = BatchRows(variation.base, columns, asked)
    filled = compute(rows)
    if filled is None:
        return every
    steps.work.batches += 1
    block.put(group.rows[filled.done], filled.taken())
    for place, message in filled.obstacles.items():
        block.end(int(group.rows[place]), "limit", message)
    return ~filled.done


def goes_together(steps: ExactSteps, asked: Asked, variation: Variation, count: int) -> bool:
    """Whether rows of a variation are computed together in every step that is asked for.

    Args:
        steps, asked: As in `fill_group`.
        variation: How numbers change the design.
        count: Rows to try it with, between the ends of the numbers.
    """
    share = np.linspace(0.0, 1.0, count)
    for step in asked.steps:
        keys = variation.keys_of(partial(steps.key, step))
        names = {name for key in keys for name, _ in variation.effects[key].factors}
        if not keys or (step == "losses" and names == {_CARRIER}):
            continue
        columns = variation.between(share)
        compute = BATCH_STEPS.get(step)
        rows = BatchRows(variation.base, columns, asked)
        if compute is None or compute(rows) is None:
            return False
    return True


# Rows of a block in groups that differ in numbers alone, with what those numbers may do.

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


# The steps of a row, one design at a time: what ``dqforge run`` computes of it, without proofs,
# alternatives and choices.

Numbers = Mapping[str, float]  # Values by name of the output, in SI units.


@dataclass(slots=True)
class ExactSteps:
    """Steps of designs, each computed once for equal inputs; ``work`` counts them."""

    grid: LossGrid = field(default_factory=LossGrid)
    work: Work = field(default_factory=Work)
    _limits: StepCache[Numbers] = field(default_factory=StepCache)
    _fits: StepCache[Numbers] = field(default_factory=StepCache)
    _currents: StepCache[Numbers] = field(default_factory=StepCache)
    _loops: StepCache[Numbers] = field(default_factory=StepCache)
    _losses: StepCache[LossComparison] = field(default_factory=StepCache)
    _tables: StepCache[LossTable | None] = field(default_factory=StepCache)

    def key(self, step: Step, design: Design) -> Hashable:
        """What a step of a design depends on, the same for all designs that share it.

        Args:
            step: The step.
            design: The design.
        """
        positive = _positive(design)
        if step == "limit":
            return key_of(current_choice(positive))
        if step == "fit":
            return key_of((current_choice(positive), used_settings(positive.fit)))
        if step == "current-loops" and _has_plain_currents(design):
            plain = _for_current_loops(design)
            return key_of((plain.machine, plain.control, plain.i_max))
        if step == "losses":
            return key_of((loss_drive(design), design.losses))
        return key_of(_for_gains(design))

    def limit(self, design: Design) -> Numbers:
        """Largest torque and its currents.

        Raises:
            DqforgeError: As `CurrentChoice.largest_torque`.
        """
        with located(design.places, "operation"):
            choice = current_choice(_positive(design))
            return self._limits.of(self.key("limit", design), lambda: self._limit(choice))

    def _limit(self, choice: CurrentChoice) -> Numbers:
        self.work.limits += 1
        with numerical_errors():
            return _largest(choice)

    def fit(self, design: Design) -> Numbers:
        """Errors of the current reference.

        Raises:
            DqforgeError: As `solve_fit`.
        """
        plain = _positive(design)
        with located(design.places, "fit"):
            return self._fits.of(self.key("fit", design), lambda: self._fit(plain))

    def _fit(self, plain: Design) -> Numbers:
        self.work.fits += 1
        errors = solve_fit(plain).fit.errors
        return {f"fit.error.{name}": float(getattr(errors, name)) for name in FIT_ERRORS}

    def current_loops(self, design: Design) -> Numbers:
        """Gains and margins of both current loops.

        Raises:
            DqforgeError: As `solve_gains`, which is asked where the design names tolerances.
        """
        if not _has_plain_currents(design):
            return self.all_loops(design)
        plain, key = _for_current_loops(design), self.key("current-loops", design)
        with located(design.places, "control"):
            return self._currents.of(key, lambda: self._current_loops(plain))

    def _current_loops(self, plain: Design) -> Numbers:
        self.work.gain_sets += 1
        try:
            return _loop_numbers(solve_current_loops(plain))
        except NoSolutionError as error:
            if plain.control.gains == "required":
                raise
            raise _left_out(error) from None

    def all_loops(self, design: Design) -> Numbers:
        """Gains and margins of every loop.

        Raises:
            DqforgeError: As `solve_gains`.
        """
        plain = _for_gains(design)
        with located(design.places, "control"):
            key = self.key("speed-loop", design)
            return self._loops.of(key, lambda: self._all_loops(plain))

    def _all_loops(self, plain: Design) -> Numbers:
        self.work.gain_sets += 1
        gains, reason = gains_or_reason(plain, proofs=False)
        if gains is None:
            raise _left_out(NoSolutionError(reason))
        loops = [gains.i_d, gains.i_q] + ([] if gains.speed is None else [gains.speed])
        return _loop_numbers(loops)

    def losses(self, design: Design) -> LossComparison:
        """Losses at the points of the design, which names some.

        Raises:
            DqforgeError: As `compare_points`.
        """
        drive = loss_drive(design)
        with located(design.places, "losses"):
            key = self.key("losses", design)
            return self._losses.of(key, lambda: self._points(drive, design))

    def _points(self, drive: LossDrive, design: Design) -> LossComparison:
        self.work.budget_calls += 1
        assert design.losses is not None
        with numerical_errors():
            return compare_points(
                drive.machine,
                drive.inverter,
                design.losses,
                i_max=drive.i_max,
                options=drive.options,
                margin=drive.margin,
                phases=drive.phases,
            )

    def loss_table(self, design: Design) -> LossTable | None:
        """Losses at the points of the design with every modulator and frequency of the study,
        arrays (S, M, F, P) in the order of ``grid``; None where the design is none of them, or one
        of its alternatives is refused.
        """
        losses = design.losses
        if losses is None or not self.grid.holds(design):
            return None
        drive = loss_drive(design, f_sw=self.grid.frequencies[0])
        asked = (losses.points, losses.strategies)
        return self._tables.of(key_of((drive, asked)), lambda: self._table(drive, losses))

    def _table(self, drive: LossDrive, losses: LossSettings) -> LossTable | None:
        self.work.budget_calls += 1
        try:
            with numerical_errors():
                return drive_table(drive, losses, self.grid)
        except DqforgeError:  # each row then says for itself what is wrong with it
            return None


def _largest(choice: CurrentChoice) -> Numbers:
    most = choice.largest_torque()
    i_d, i_q = choice.currents(np.array([most]))
    return {
        "reference.torque_max": most,
        "reference.i_d": float(i_d[0]),
        "reference.i_q": float(i_q[0]),
    }


def _loop_numbers(loops: Sequence[LoopGains]) -> Numbers:
    found = {
        f"gains.{loop.loop}.{name}": float(getattr(loop, name))
        for loop in loops
        for name in LOOP_QUANTITIES
    }
    return found | {"gains.phase_margin": min(loop.phase_margin for loop in loops)}


class GainsLeftOutError(NoSolutionError):
    """A design that can do without gains has none: no loop was requested and none was found."""


def _left_out(error: NoSolutionError) -> GainsLeftOutError:
    words = error.message.removeprefix("no loop was requested and none was found: ")
    return GainsLeftOutError(f"no loop was requested and none was found: {words}")


def _bare(design: Design) -> Design:
    """A design without what no step looks at."""
    return replace(
        design,
        name="",
        about="",
        waveform=WaveformSettings(),
        values=(),
        assumptions=(),
        digest="",
        weakening=None,
        modulation_choice=None,
        given=None,
        flux_evidence=(),
        places=None,
    )


def _positive(design: Design) -> Design:
    """The design as torques of the positive sign see it, without places."""
    return signed_designs(replace(design, places=None))[0]


def _has_plain_currents(design: Design) -> bool:
    """Whether the current loops hold or fail by themselves: no tolerances, no zero sequence."""
    return design.control.tolerances is None and design.phase_machine is None


def _for_current_loops(design: Design) -> Design:
    control = replace(design.control, speed_loop=None, observer=None)
    return replace(design, control=control, places=None)


def _for_gains(design: Design) -> Design:
    """Without devices and losses, and without the carrier and the link where no loop knows them."""
    inverter = replace(
        design.inverter,
        device=None,
        device_model=None,
        coolant_temperature=0.0,
        capacitor_esr=0.0,
    )
    if not _knows_the_bridge(design):
        inverter = replace(inverter, f_sw=1.0, dead_time=0.0)
    bare = _bare(design)
    return replace(
        bare,
        inverter=inverter,
        machine_loss=NO_EXTRA_LOSS,
        fit=FitSettings(),
        losses=None,
        winding=None,
    )


def _knows_the_bridge(design: Design) -> bool:
    """Whether gains depend on carrier frequency and dead time: all but the plainest do."""
    control = design.control
    observer = control.observer
    return (
        design.phase_machine is not None
        or control.tolerances is not None
        or control.start_up is not None
        or control.firmware is not None
        or (observer is not None and observer.pole is None)
    )
