"""What a study can ask of each row: names, SI units, and the step that makes them.

Names are those of ``result.json`` where it says the same; points are counted from 0 in the order
of the design. Which names a study uses, and whether its design can give them, is checked here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    AnyStrategy,
    LoadPoint,
    LossSettings,
    LossStrategy,
    PhaseStrategy,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError, KeyPath, close_matches, shown
from dqforge.machines.exploration.study import Bound, Study
from dqforge.machines.names import ModulationName
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.machine_axis import STRATEGIES, budgets_over_machines, drive_axis
from dqforge.optimizer.losses.drive_budget import PARTS, BudgetOptions, DriveBudget
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_drives
from dqforge.optimizer.losses.loss_map import budget_options

# What is computed for an output: the largest torque, the current reference, the loops, the budget,
# or what a fixed header makes of the machine.
Step = Literal["limit", "fit", "current-loops", "speed-loop", "losses", "yields"]
LOOPS = ("i_d", "i_q", "speed")
FIT_PATHS = ("batch", "exact")
_LIMIT = {"torque_max": "N m", "i_d": "A", "i_q": "A"}

FIT_ERRORS: Mapping[str, str] = {
    "i_d": "A",
    "i_q": "A",
    "torque": "N m",
    "torque_relative": "",
    "loss": "W",
    "loss_relative": "",
}

LOOP_QUANTITIES: Mapping[str, str] = {
    "phase_margin": "rad",
    "gain_margin": "",
    "delay_margin": "s",
    "crossover": "rad/s",
    "max_sensitivity": "",
    "stable": "",
    "kp": "",
    "ki": "",
}

# Means over the points by their weights.
LOSS_POWERS: Mapping[str, str] = dict.fromkeys(
    ("total", *PARTS, "input_power", "shaft_power", "friction"),
    "W",
)

# Largest ones of the points.
LOSS_PEAKS: Mapping[str, str] = {
    "junction_temperature": "degC",
    "diode_temperature": "degC",
    "winding_temperature": "degC",
    "ripple_current": "A",
    "capacitor_current": "A",
    "voltage": "V",
    "voltage_error": "V",
}

LOSS_QUANTITIES: Mapping[str, str] = {**LOSS_POWERS, **LOSS_PEAKS}
_YIELDS = {"torque_error": "", "torque_made": "N m", "loss_penalty": ""}
_MODULATIONS: tuple[str, ...] = tuple(sorted(get_args(ModulationName)))
_STRATEGIES: tuple[str, ...] = tuple(sorted({*get_args(LossStrategy), *get_args(PhaseStrategy)}))
_POINT = re.compile(r"losses\.points\.(0|[1-9]\d{0,2})\.(?:([a-z0-9-]+)\.)?([a-z_]+)", re.ASCII)
_DEFAULT_MARGINS = tuple(name for name in LOOP_QUANTITIES if name not in ("kp", "ki"))


@dataclass(frozen=True, slots=True)
class PointOutput:
    """A quantity of the losses at one operating point: of the alternative that loses least there,
    or of the one with a ``modulation`` (empty: of any).
    """

    place: int
    modulation: str
    quantity: str


@dataclass(frozen=True, slots=True)
class Output:
    """One output.

    Args:
        name: As in the study; the column is ``out.<name>``.
        unit: SI unit, empty for numbers.
        step: What makes it.
        choices: Words of an output that is none of numbers, sorted.
        point: Of losses at a point: which one.
    """

    name: str
    unit: str
    step: Step
    choices: tuple[str, ...] = ()
    point: PointOutput | None = None

    @property
    def loop(self) -> str:
        """The loop it belongs to, empty for outputs of other steps and of all loops."""
        parts = self.name.split(".")
        return parts[1] if parts[0] == "gains" and len(parts) == 3 else ""

    @property
    def quantity(self) -> str:
        """Last part of the name."""
        return self.name.rpartition(".")[2]


def _plain_outputs() -> Iterator[Output]:
    for name, unit in _LIMIT.items():
        yield Output(f"reference.{name}", unit, "limit")
    for name, unit in FIT_ERRORS.items():
        yield Output(f"fit.error.{name}", unit, "fit")
    yield Output("fit.path", "", "fit", FIT_PATHS)
    yield Output("gains.phase_margin", "rad", "speed-loop")
    for loop in LOOPS:
        step: Step = "speed-loop" if loop == "speed" else "current-loops"
        for name, unit in LOOP_QUANTITIES.items():
            yield Output(f"gains.{loop}.{name}", unit, step)
    for name, unit in LOSS_QUANTITIES.items():
        yield Output(f"losses.{name}", unit, "losses")
    for name, unit in _YIELDS.items():
        yield Output(f"reference.{name}", unit, "yields")


_PLAIN: Mapping[str, Output] = {output.name: output for output in _plain_outputs()}


def output_named(name: str) -> Output | None:
    """The output of a name, None where there is none."""
    plain = _PLAIN.get(name)
    if plain is not None:
        return plain
    found = _POINT.fullmatch(name)
    if found is None or (found[2] is not None and found[2] not in _MODULATIONS):
        return None
    point = PointOutput(int(found[1]), found[2] or "", found[3])
    if point.quantity in LOSS_QUANTITIES:
        return Output(name, LOSS_QUANTITIES[point.quantity], "losses", point=point)
    words = {"modulation": _MODULATIONS, "strategy": _STRATEGIES}.get(point.quantity)
    return None if words is None else Output(name, "", "losses", words, point)


def known_names() -> tuple[str, ...]:
    """All names but those of single points, for lists and for what an unknown one may mean."""
    return tuple(_PLAIN)


def word_index(words: tuple[str, ...], word: AnyStrategy | ModulationName | str) -> int:
    """Place of a word in the sorted words of a choice."""
    return words.index(word)


def default_outputs(design: Design, *, header: bool) -> tuple[str, ...]:
    """What a study that names no outputs gets of a design: largest torque, errors of the fit,
    margins, losses and junction temperature of every point.

    Args:
        design: The design the study starts from, with what the study sets.
        header: Whether the study names a header: its torque, loss penalty and current loops are
            what is then judged on every machine, losses where the study names them.
    """
    if header:
        loops = [f"gains.{loop}.{name}" for loop in LOOPS[:2] for name in _DEFAULT_MARGINS]
        reference = [f"reference.{name}" for name in _YIELDS]
        return (*reference, *((*loops, "gains.phase_margin") if has_loops(design) else ()))
    names = ["reference.torque_max"]
    names += [f"fit.error.{name}" for name in ("i_d", "i_q", "torque", "torque_relative")]
    names.append("fit.path")
    names += _default_margins(design)
    names += _default_losses(design)
    return tuple(names)


def _default_margins(design: Design) -> list[str]:
    if not has_loops(design):
        return []
    loops = LOOPS if design.control.speed_loop is not None else LOOPS[:2]
    found = [f"gains.{loop}.{name}" for loop in loops for name in _DEFAULT_MARGINS]
    return [*found, "gains.phase_margin"]


def _default_losses(design: Design) -> list[str]:
    points = _points(design)
    if not points:
        return []
    device = design.inverter.device is not None
    quantities = ("total", "junction_temperature") if device else ("total",)
    found = [f"losses.{name}" for name in (*quantities, "ripple_current")]
    return found + [
        f"losses.points.{place}.{name}" for place in range(len(points)) for name in quantities
    ]


def has_loops(design: Design) -> bool:
    """Whether a design has loops with gains at all."""
    control = design.control
    return (
        control.gains != "none" and control.six_step is None and not control.current_loop.switches
    )


def _points(design: Design) -> tuple[LoadPoint, ...]:
    return () if design.losses is None else design.losses.points


def bound_output(bound: Bound, design: Design) -> str:
    """Name of the output that a bound looks at: that of its point where it names one.

    Raises:
        InputError: The design has no such point, or the output is none of single points.
    """
    if bound.point is None:
        return bound.output
    torque, omega_m, modulation = bound.point
    for place, point in enumerate(_points(design)):
        if _same(point.torque, torque) and _same(point.omega_m, omega_m):
            middle = f"{modulation}." if modulation else ""
            return f"losses.points.{place}.{middle}{bound.output.removeprefix('losses.')}"
    raise InputError(
        f"{bound.output}: the design has no point {torque:g} N m at {omega_m:g} rad/s; write it "
        "under losses.points, by set in the study"
    )


def _same(first: float, second: float) -> bool:
    return abs(first - second) <= 1e-9 * max(abs(first), abs(second))


def study_outputs(study: Study, design: Design) -> tuple[Output, ...]:
    """Outputs of a study in the order of their columns: those it lists or the default ones, then
    what its limits, acceptance, goals and sensitivities look at.

    Args:
        study: The study.
        design: The design it starts from, with what it sets.

    Raises:
        InputError: A name is none of an output, or the design cannot give it; with its place in the
            study.
    """
    header = bool(study.header)
    listed = study.outputs or default_outputs(design, header=header)
    found: dict[str, Output] = {}
    for section, name, path in _asked(study, listed, design):
        output = output_named(name)
        problem = _unknown(name) if output is None else _missing(output, design, header=header)
        if not problem and output is not None and output.choices and section != "outputs":
            problem = f"{shown(name)} is a word, not a number; write it under outputs"
        if problem:
            raise _refusal(study, (section, path), problem)
        if output is not None:
            found.setdefault(name, output)
    return tuple(found.values())


def named_outputs(study: Study, design: Design) -> frozenset[str]:
    """Names that the study itself asks for, not by default.

    Args:
        study: The study.
        design: The design it starts from.
    """
    return frozenset(name for _, name, _ in _asked(study, study.outputs, design))


def _asked(study: Study, listed: tuple[str, ...], design: Design) -> Iterator[tuple[str, str, str]]:
    """Section, name of the output, and what the study calls it there."""
    for name in listed:
        yield "outputs", name, name
    sections: tuple[tuple[str, tuple[Bound, ...]], ...] = (
        ("limits", study.limits),
        ("accept", study.accept),
    )
    for section, bounds in sections:
        for bound in bounds:
            try:
                yield section, bound_output(bound, design), bound.output
            except InputError as error:
                words = error.message.removeprefix(f"{bound.output}: ")
                raise _refusal(study, (section, bound.output), words) from None
    for goal in study.goals:
        yield "pareto", goal.output, goal.output
    for name in study.sensitivity:
        yield "sensitivity", name, name


def _unknown(name: str) -> str:
    near = close_matches(name, known_names(), 1)
    hint = f"did you mean {near[0]}?" if near else "write e.g. reference.torque_max, losses.total"
    return f"{shown(name)} is no output; {hint}"


def _missing(output: Output, design: Design, *, header: bool) -> str:
    """Why a design cannot give an output, empty where it can."""
    if output.step == "yields" and not header:
        return "needs a fixed header; write header: nominal"
    if header and (output.step in ("limit", "fit") or output.quantity in ("kp", "ki")):
        return "is the same for every machine under a fixed header; omit header"
    if header and output.loop == "speed":
        return (
            f"a fixed header is evaluated by its current loops; write gains.i_q.{output.quantity}"
        )
    if output.step in ("current-loops", "speed-loop"):
        return _missing_loop(output, design)
    if output.step == "losses":
        return _missing_losses(output, design)
    return ""


def _missing_loop(output: Output, design: Design) -> str:
    if not has_loops(design):
        return "the design has no current loops with gains; omit the output"
    if output.loop == "speed" and design.control.speed_loop is None:
        quantity = output.quantity
        return f"the design has no speed loop; write gains.i_q.{quantity}"
    return ""


def _missing_losses(output: Output, design: Design) -> str:
    points = _points(design)
    if not points:
        return (
            "the design names no operating points; write set: {losses.points: "
            "[{torque: 1 N m, speed: 100 rad/s}]} in the study"
        )
    place = 0 if output.point is None else output.point.place
    if place >= len(points):
        return f"the design has {len(points)} operating points, counted from 0"
    if design.inverter.device is None and output.quantity in (
        "junction_temperature",
        "diode_temperature",
    ):
        return "the design names no inverter.device, so no junction has a temperature"
    return ""


def _refusal(study: Study, path: KeyPath, words: str) -> InputError:
    """An error on a key of the study, with its place."""
    message = f"{'.'.join(str(part) for part in path)}: {words}"
    if study.places is None:
        return InputError(message)
    line, column = study.places.of_key(path)
    return InputError(message, source=study.places.source, line=line, column=column)


# Columns of losses: of every alternative at a point the one that loses least, then means and
# largest values over the points.

_EQUAL_LOSS = 1e-9  # Totals that differ by less count as equal: the first alternative is taken.


@dataclass(frozen=True, slots=True, eq=False)
class LossRows:
    """Losses of N rows: S strategies with M modulators at P points.

    Args:
        strategies, modulations, points: Labels.
        budget: Arrays of the shape (S, M, P, N).
        reached: Whether the currents make the torque, shape (S, M, P, N).
        weights: Of the points, shape (P,), with the sum 1.
    """

    strategies: tuple[AnyStrategy, ...]
    modulations: tuple[ModulationName, ...]
    points: tuple[LoadPoint, ...]
    budget: DriveBudget
    reached: BoolArray
    weights: FloatArray

    @property
    def count(self) -> int:
        """Number of rows N."""
        return int(self.reached.shape[-1])


@dataclass(frozen=True, slots=True, eq=False)
class LossColumns:
    """Columns by name, and how each row ended.

    Args:
        columns: Numbers (N,), or places in the words of a choice.
        obstacles: Why the best alternative of a point cannot be used, by row: empty where it can.
        missing: Rows that have no numbers at a point, shape (N,).
    """

    columns: dict[str, FloatArray | NDArray[np.int32]]
    obstacles: dict[int, str]
    missing: BoolArray


def mapped(budget: DriveBudget, change: Callable[[NDArray[Any]], NDArray[Any]]) -> DriveBudget:
    """A budget with every array changed alike.

    Args:
        budget: Arrays of one shape.
        change: What becomes of each.
    """
    columns: dict[str, Any] = {
        part.name: change(getattr(budget, part.name)) for part in fields(DriveBudget)
    }
    return DriveBudget(**columns)


def loss_columns(rows: LossRows, outputs: Sequence[Output]) -> LossColumns:
    """Columns of the outputs that are asked for.

    Args:
        rows: Losses of every alternative.
        outputs: Outputs of the step ``losses``.
    """
    best = _best(rows, "")
    columns: dict[str, FloatArray | NDArray[np.int32]] = {}
    for output in outputs:
        point = output.point
        if point is None:
            columns[output.name] = _over_points(rows, best, output.quantity)
        elif output.choices:
            columns[output.name] = _word(rows, _best(rows, point.modulation), point, output.choices)
        else:
            chosen = best if not point.modulation else _best(rows, point.modulation)
            columns[output.name] = _values(rows, chosen, point.quantity)[point.place]
    total = _values(rows, best, "total")
    return LossColumns(columns, _obstacles(rows, best), np.any(np.isnan(total), axis=0))


def _flat(values: NDArray[Any]) -> NDArray[Any]:
    """(S, M, P, N) as (S M, P, N)."""
    return values.reshape(-1, *values.shape[2:])


def _usable(rows: LossRows) -> BoolArray:
    return np.asarray(rows.reached & rows.budget.feasible)


def _best(rows: LossRows, modulation: str) -> IndexArray:
    """Flat place over strategies and modulators of the alternative that loses least, (P, N).

    Those that can be used within the tables of the device come first, then those that can be used,
    then those that have numbers at all; -1 where none has.
    """
    usable = _usable(rows)
    known = rows.reached & np.isfinite(rows.budget.total)
    if modulation:
        of_it = np.array([name == modulation for name in rows.modulations])[:, None, None]
        usable, known = usable & of_it, known & of_it
    found = np.full(rows.reached.shape[2:], -1, dtype=np.intp)
    for mask in (usable & rows.budget.within_tables, usable, known):
        total = _flat(np.where(mask, rows.budget.total, np.inf))
        least = np.min(total, axis=0)
        first = np.argmax(total <= least * (1.0 + _EQUAL_LOSS), axis=0)
        found = np.where((found < 0) & np.isfinite(least), first, found)
    return found


def _taken(values: NDArray[Any], place: IndexArray) -> NDArray[Any]:
    """Values (S, M, P, N) of the alternatives at places (P, N), of the first where none is."""
    taken: NDArray[Any] = np.take_along_axis(_flat(values), np.maximum(place, 0)[None], axis=0)[0]
    return taken


def _values(rows: LossRows, place: IndexArray, quantity: str) -> FloatArray:
    """A quantity of the chosen alternatives, (P, N), NaN where there is none."""
    if quantity not in LOSS_QUANTITIES:
        raise KeyError(quantity)
    taken = _taken(getattr(rows.budget, quantity), place)
    return np.where(place >= 0, taken, np.nan).astype(np.float64)


def _over_points(rows: LossRows, place: IndexArray, quantity: str) -> FloatArray:
    values = _values(rows, place, quantity)
    if quantity in LOSS_POWERS:
        return np.asarray(np.sum(rows.weights[:, None] * values, axis=0))
    return np.asarray(np.max(values, axis=0))


def _word(
    rows: LossRows, place: IndexArray, point: PointOutput, words: tuple[str, ...]
) -> NDArray[np.int32]:
    """Modulator or strategy that was chosen at a point, as its place in the words; -1 for none."""
    at = place[point.place]
    count = len(rows.modulations)
    own = at % count if point.quantity == "modulation" else at // count
    labels = rows.modulations if point.quantity == "modulation" else rows.strategies
    known = np.array([word_index(words, label) for label in labels], dtype=np.int32)
    return np.where(at >= 0, known[np.maximum(own, 0)], np.int32(-1)).astype(np.int32)


_OBSTACLES = (
    ("steady", "the junction or the winding finds no balance of heat"),
    ("linear", "the voltage is beyond the linear range of the modulator"),
    ("cool_enough", "the junction is hotter than the device permits"),
    ("within_tables", "beyond the ends of the tables of the device"),
)


def _obstacles(rows: LossRows, best: IndexArray) -> dict[int, str]:
    """What is wrong with rows at their first point without numbers, else at the first that is not
    fine.
    """
    fine = _taken(_usable(rows) & rows.budget.within_tables, best).astype(bool) & (best >= 0)
    found = {}
    for row in np.flatnonzero(~np.all(fine, axis=0)).tolist():
        none = best[:, row] < 0
        place = int(np.argmax(none)) if np.any(none) else int(np.argmin(fine[:, row]))
        found[row] = f"losses.points[{place}]: {_reason(rows, best, place, row)}"
    return found


def _reason(rows: LossRows, best: IndexArray, place: int, row: int) -> str:
    point = rows.points[place]
    if best[place, row] < 0:
        alternatives = "no alternative makes" if _several(rows) else "the drive cannot make"
        steady = rows.reached[:, :, place, row] & ~rows.budget.steady[:, :, place, row]
        if np.any(steady):
            return _OBSTACLES[0][1]
        return f"{alternatives} {point.torque:.4g} N m at {point.omega_m:.4g} rad/s"
    at = divmod(int(best[place, row]), len(rows.modulations))
    for name, words in _OBSTACLES:
        if not getattr(rows.budget, name)[(*at, place, row)]:
            return words
    return "the torque is not made"


def _several(rows: LossRows) -> bool:
    return len(rows.strategies) * len(rows.modulations) > 1


# Losses of one drive with all modulators and carrier frequencies that the rows of a study have.

_MOST_ALTERNATIVES = 20_000  # Points times modulators times frequencies of one table of losses.


@dataclass(frozen=True, slots=True)
class LossGrid:
    """Modulators and carrier frequencies in Hz that the rows of a study have: what is computed
    together for all rows whose drives are otherwise the same.
    """

    modulations: tuple[ModulationName, ...] = ()
    frequencies: tuple[float, ...] = ()

    def holds(self, design: Design) -> bool:
        """Whether a design's alternatives are among them, and few enough for one table."""
        losses = design.losses
        if losses is None or design.phase_machine is not None:
            return False
        size = len(self.modulations) * len(self.frequencies) * len(losses.points)
        return (
            size <= _MOST_ALTERNATIVES
            and set(losses.modulations) <= set(self.modulations)
            and design.inverter.f_sw in self.frequencies
        )


@dataclass(frozen=True, slots=True, eq=False)
class LossTable:
    """Losses of one drive with every modulator and carrier frequency of a study.

    Args:
        modulations: M modulators.
        budget: Arrays of the shape (S, M, F, P), in the order of strategies, frequencies and
            points.
        reached: Whether the currents make the torque, of the same shape.
    """

    modulations: tuple[ModulationName, ...]
    budget: DriveBudget
    reached: BoolArray


@dataclass(frozen=True, slots=True)
class LossDrive:
    """What the losses of a design depend on, beside the points and what is compared there."""

    machine: Machine
    inverter: Inverter
    i_max: float
    options: BudgetOptions
    margin: float
    phases: AnyPhaseMachine | None


def loss_drive(design: Design, f_sw: float | None = None) -> LossDrive:
    """What the losses of a design depend on.

    Args:
        design: The design.
        f_sw: Carrier frequency in Hz that stands for all; None for the design's own.
    """
    inverter = replace(design.inverter, current_sensing=None)
    return LossDrive(
        design.machine,
        inverter if f_sw is None else replace(inverter, f_sw=f_sw),
        design.i_max,
        budget_options(design),
        design.operation.voltage_margin,
        design.phase_machine,
    )


def drive_table(drive: LossDrive, losses: LossSettings, grid: LossGrid) -> LossTable:
    """Losses with every modulator and frequency of a study.

    Args:
        drive: The drive.
        losses: Points and strategies.
        grid: Modulators and frequencies.

    Raises:
        DqforgeError: One of the alternatives is refused.
    """
    return _linear_table(drive, losses, grid) or _any_table(drive, losses, grid)


def _table_points(losses: LossSettings) -> tuple[FloatArray, FloatArray]:
    """Torques in N m and speeds in rad/s, shape (P,)."""
    return (
        np.array([point.torque for point in losses.points]),
        np.array([point.omega_m for point in losses.points]),
    )


def _linear_table(drive: LossDrive, losses: LossSettings, grid: LossGrid) -> LossTable | None:
    """Losses of a linear machine, its frequencies as so many drives; None where one of them
    belongs on the single path.
    """
    strategies = [name for name in STRATEGIES if name in losses.strategies]
    if not isinstance(drive.machine, LinearMachine) or len(strategies) < len(losses.strategies):
        return None
    machine = replace(drive.machine, i_max=drive.i_max)
    found = budgets_over_machines(
        drive_axis(
            MachineBatch.of([machine] * len(grid.frequencies)),
            drive.inverter,
            f_sw=np.array(grid.frequencies),
        ),
        *_table_points(losses),
        strategies,
        grid.modulations,
        options=drive.options,
        margin=drive.margin,
    )
    if not np.all(found.exact):
        return None
    order = [strategies.index(name) for name in losses.strategies if name in STRATEGIES]

    def by_frequency(values: NDArray[Any]) -> NDArray[Any]:
        return np.moveaxis(values[:, :, :, 0][:, order], 0, 2)

    budget = mapped(found.budget, by_frequency)
    return LossTable(grid.modulations, budget, by_frequency(found.reached))


def _any_table(drive: LossDrive, losses: LossSettings, grid: LossGrid) -> LossTable:
    """Losses of any machine."""
    torque, omega_m = _table_points(losses)
    found = compare_drives(
        drive.machine,
        drive.inverter,
        torque,
        omega_m,
        Alternatives(losses.strategies, grid.modulations, grid.frequencies),
        i_max=drive.i_max,
        options=drive.options,
        margin=drive.margin,
    )
    return LossTable(grid.modulations, found.budget, found.reached)


# What a study asks of its rows, and which steps that takes.

# Steps of a row without a fixed header, in the order in which refusals count.
STEPS: tuple[Step, ...] = ("limit", "fit", "current-loops", "speed-loop", "losses")


@dataclass(frozen=True, slots=True)
class Asked:
    """What a study asks of its rows.

    Args:
        outputs: All outputs.
        named: Those that the study itself names: a row without them has no solution.
    """

    outputs: tuple[Output, ...]
    named: frozenset[str] = frozenset()

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps that make them; the speed loop's makes the current loops as well."""
        wanted = {output.step for output in self.outputs}
        if "speed-loop" in wanted:
            wanted.discard("current-loops")
        return tuple(step for step in STEPS if step in wanted)

    def of_step(self, step: Step) -> tuple[Output, ...]:
        """Outputs of a step."""
        return tuple(output for output in self.outputs if output.step == step)

    @property
    def gains_named(self) -> bool:
        """Whether the study itself asks for gains or margins."""
        return any(name.startswith("gains.") for name in self.named)
