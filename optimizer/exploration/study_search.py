"""The rows of a study that a search chooses: one generation after the other."""

from __future__ import annotations

import pickle
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Axis, Search
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.acceptance import (
    AcceptedRange,
    GoalColumn,
    bound_column,
    goal_columns,
)
from dqforge.optimizer.exploration.row_block import (
    STATES,
    ColumnSpec,
    Inputs,
    RowBlock,
    chosen_inputs,
)
from dqforge.optimizer.exploration.study_plan import StudyPlan


@dataclass(frozen=True, slots=True, eq=False)
class GenerationRows:
    """Rows of one generation (a `RowSource`), at their places in the study.

    Args:
        plan: How rows are computed.
        batch: Rows per part.
        start: Index of the first row of the generation.
        points: What the search chose for its rows, shape (P, axes).
    """

    plan: StudyPlan
    batch: int
    start: int
    points: FloatArray

    def __reduce__(self) -> tuple[object, ...]:
        """Travel with the plan in one piece: whoever knows it has its steps already."""
        return _arrived, (pickle.dumps(self.plan), self.batch, self.start, self.points)

    @property
    def count(self) -> int:
        """Rows of the whole study."""
        return self.plan.count

    @property
    def size(self) -> int:
        """Rows of the generation."""
        return len(self.points)

    @property
    def columns(self) -> tuple[ColumnSpec, ...]:
        """Columns of every block."""
        return self.plan.columns

    def inputs(self, first: int, end: int) -> Inputs:
        """What goes into rows first to end - 1 of the study, by key.

        Args:
            first, end: Range of rows of this generation.
        """
        return chosen_inputs(self.plan.study, self.points[first - self.start : end - self.start])

    def keys(self, first: int, end: int) -> NDArray[np.uint8]:
        """Keys of rows first to end - 1 of the study, shape (n, 16).

        Args:
            first, end: Range of rows of this generation.
        """
        return self.plan.keys_of(self.inputs(first, end))

    def rows(self, first: int, end: int) -> RowBlock:
        """Rows first to end - 1 of the study, computed.

        Args:
            first, end: Range of rows of this generation.
        """
        return self.plan.rows_of(self.inputs(first, end), first, end - first)


def _arrived(packed: bytes, batch: int, start: int, points: FloatArray) -> GenerationRows:
    return GenerationRows(_plan(packed), batch, start, points)


@lru_cache(maxsize=1)
def _plan(packed: bytes) -> StudyPlan:
    """The plan of the study that this process computes, with what is known of its steps."""
    found: StudyPlan = pickle.loads(packed)
    return found


@dataclass(frozen=True, slots=True, eq=False)
class SearchedStudy:
    """A study with a search.

    Args:
        plan: How its rows are computed.
        search: What its file says of the search.
    """

    plan: StudyPlan
    search: Search

    @property
    def batch(self) -> int:
        """Rows per part; no part lies in two generations."""
        return generation_batch(self.search.population, self.plan.batch)

    @property
    def parts_of_generation(self) -> int:
        """Number of parts of a generation."""
        return self.search.population // self.batch

    def begun(self) -> SearchRows:
        """The search before its first generation.

        Raises:
            InputError: The method does not suit the study, or its library is not installed.
        """
        study = self.plan.study
        variables = search_variables(study.axes)
        return open_search(self.search, variables, len(study.goals), len(study.limits))

    def generation(self, number: int, points: FloatArray) -> GenerationRows:
        """Rows of a generation.

        Args:
            number: Of the generation, from 0.
            points: What the search chose, shape (P, axes).
        """
        return GenerationRows(self.plan, self.batch, number * self.search.population, points)

    @property
    def _goals(self) -> tuple[GoalColumn, ...]:
        return goal_columns(self.plan.study)

    @property
    def _limits(self) -> tuple[AcceptedRange, ...]:
        return tuple(bound_column(bound, self.plan.base) for bound in self.plan.study.limits)

    @property
    def judged_columns(self) -> tuple[str, ...]:
        """Columns that the outcomes of rows follow from."""
        names = [goal.column for goal in self._goals] + [limit.column for limit in self._limits]
        return tuple(dict.fromkeys(names))

    def outcomes(
        self, columns: Mapping[str, FloatArray | NDArray[np.int32]], states: NDArray[np.int8]
    ) -> Outcomes:
        """What a search is told of a generation.

        Args:
            columns: `judged_columns` of its rows in their order, shape (P,).
            states: Places in `STATES`, shape (P,).
        """
        return outcomes_of(self._goals, self._limits, columns, states)


# The search that a study asks for.


def open_search(
    search: Search, variables: Sequence[SearchVariable], goals: int, limits: int
) -> SearchRows:
    """A search of a study, before its first generation.

    Args:
        search: Method, rows per generation and seed.
        variables: What varies.
        goals, limits: Numbers of goals and of limits.

    Raises:
        InputError: The method does not suit the study, or pymoo is not installed.
    """
    if goals == 0:
        raise InputError("search: nothing is made small; write goals under pareto: {minimise: ...}")
    if search.method == "nlopt":
        return open_descents(search, variables, goals)
    return open_evolution(search, variables, goals, limits)


# A search for one goal without derivatives: several descents of COBYLA side by side.
#
# NLopt asks for one point after the other, which would leave all but one worker idle. Here every
# row of a generation belongs to a descent of its own, from a start of its own; a descent that has
# come to its end begins again at another start. COBYLA (Powell 1994,
# doi:10.1007/978-94-015-8330-5_4) keeps linear models of the goal and of each limit over a simplex,
# so that limits need no weights.
#
# NLopt cannot be halted between two values. It is run again from the start with all values that are
# known, and left at the first one that is not: it is deterministic, and a value that is known costs
# next to nothing.

_FIRST_STEP = 0.2  # First step of a descent, as a share of every range.
_LAST_STEP = 1e-5  # Step at which a descent ends.

# What a row without values counts with, in spreads of the goal above the worst one known.
_LOST = 10.0


@dataclass(slots=True, eq=False)
class Descent:
    """One descent: its start and what it has been told, point by point in the order asked.

    Args:
        start: Shares of the ranges, shape (V,).
        points, goals, limits: Points asked for, their goal, and the excess of each limit, shape
            (L,) each.
    """

    start: FloatArray
    points: list[FloatArray] = field(default_factory=list)
    goals: list[float] = field(default_factory=list)
    limits: list[FloatArray] = field(default_factory=list)

    def next_point(self) -> FloatArray | None:
        """The first point whose value is not known, shape (V,); None at the end of the descent."""
        import nlopt

        size = self.start.size
        known = {point.tobytes(): place for place, point in enumerate(self.points)}
        missing: list[FloatArray] = []

        def place_of(x: FloatArray) -> int:
            inside = np.clip(x, 0.0, 1.0)
            place = known.get(inside.tobytes())
            if place is None:
                missing.append(inside.copy())
                raise nlopt.ForcedStop
            return place

        def goal(x: FloatArray, _gradient: FloatArray) -> float:
            return self.goals[place_of(x)]

        def excess(result: FloatArray, x: FloatArray, _gradient: FloatArray) -> None:
            result[:] = self.limits[place_of(x)]

        method = nlopt.opt(nlopt.LN_COBYLA, size)
        method.set_lower_bounds(np.zeros(size))
        method.set_upper_bounds(np.ones(size))
        method.set_initial_step(_FIRST_STEP)
        method.set_xtol_abs(_LAST_STEP)
        method.set_min_objective(goal)
        if self.limits and self.limits[0].size:
            method.add_inequality_mconstraint(excess, np.zeros(self.limits[0].size))
        try:
            method.optimize(self.start)
        except nlopt.ForcedStop:
            return missing[0]
        except nlopt.RoundoffLimited:
            return None
        return None

    def learn(self, point: FloatArray, goal: float, limits: FloatArray) -> None:
        """The value at the point asked for."""
        self.points.append(point)
        self.goals.append(goal)
        self.limits.append(limits)


# What a search varies: ranges between their ends, steps in an order, and choices without one.

VariableKind = Literal["range", "steps", "choice"]


@dataclass(frozen=True, slots=True)
class SearchVariable:
    """One axis of a study as a search sees it.

    Args:
        keys: What varies, in step.
        kind: ``range``: any number from ``low`` to ``high``; ``steps``: one of ``count`` steps
            whose numbers ascend or descend; ``choice``: one of ``count`` without an order.
        low, high: Ends of a range in SI units.
        logarithmic: Whether equal ratios of a range count alike, not equal differences.
        count: Number of steps.
    """

    keys: tuple[str, ...]
    kind: VariableKind
    low: float = 0.0
    high: float = 0.0
    logarithmic: bool = False
    count: int = 0

    def value(self, share: FloatArray) -> FloatArray:
        """Numbers in SI units at shares of a range, any shape, or the places of steps as they
        are.
        """
        if self.kind != "range":
            return share
        if self.logarithmic:
            value = self.low * (self.high / self.low) ** share
        else:
            value = self.low + (self.high - self.low) * share
        return np.clip(value, min(self.low, self.high), max(self.low, self.high))


@dataclass(slots=True, eq=False)
class Descents:
    """Descents under way; `dqforge.optimizer.exploration.study_search.SearchRows`.

    Args:
        variables: What varies: ranges alone.
        population: Number of descents, rows of each generation.
        seed: Of the starts.
        generation: Generations that have been told.
    """

    variables: tuple[SearchVariable, ...]
    population: int
    seed: int
    generation: int = 0
    descents: list[Descent] = field(default_factory=list)
    starts: int = 0
    asked: FloatArray | None = None
    least: float = np.inf
    worst: float = -np.inf

    def _started(self) -> Descent:
        random = np.random.default_rng([self.seed, self.starts])
        self.starts += 1
        return Descent(random.random(len(self.variables)))

    def ask(self) -> FloatArray:
        """Inputs of the next generation, shape (population, V)."""
        if self.asked is None:
            while len(self.descents) < self.population:
                self.descents.append(self._started())
            self.asked = np.array([self._point(place) for place in range(self.population)])
        return values_of(self.variables, self.asked)

    def _point(self, place: int) -> FloatArray:
        """Next point of a descent; one at its end makes room for another."""
        point = self.descents[place].next_point()
        while point is None:
            self.descents[place] = self._started()
            point = self.descents[place].next_point()
        return point

    def tell(self, outcomes: Outcomes) -> None:
        """What became of the rows of the generation asked for."""
        self.ask()
        assert self.asked is not None
        goals = outcomes.goals[:, 0]
        found = goals[outcomes.known]
        if found.size:
            self.least = min(self.least, float(np.min(found)))
            self.worst = max(self.worst, float(np.max(found)))
        spread = self.worst - self.least
        lost = self.worst + _LOST * max(spread, abs(self.worst)) if np.isfinite(spread) else 1.0
        for place, descent in enumerate(self.descents):
            known = bool(outcomes.known[place])
            excess = outcomes.excess[place] if known else np.ones_like(outcomes.excess[place])
            descent.learn(self.asked[place], float(goals[place]) if known else lost, excess)
        self.asked = None
        self.generation += 1


def open_descents(search: Search, variables: Sequence[SearchVariable], goals: int) -> Descents:
    """Descents before their first generation.

    Args:
        search: Rows per generation, which is the number of descents, and seed.
        variables: What varies.
        goals: Number of goals.

    Raises:
        InputError: There is more than one goal, or something varies that has no values between two
            steps.
    """
    if goals != 1:
        raise InputError(
            f"search.method: nlopt has one goal, the study has {goals}; write method: nsga2"
        )
    steps = [each for each in variables if each.kind != "range"]
    if steps:
        raise InputError(
            f"search.method: nlopt varies ranges, and {steps[0].keys[0]} has listed values; write "
            "a range, or method: nsga2"
        )
    return Descents(tuple(variables), search.population, search.seed)


# The evolutionary search NSGA-II (Deb and others 2002, doi:10.1109/4235.996017), as pymoo has it.
#
# pymoo mates and selects; rows, seeds and the number of points are settled here. The numbers of
# generation g come from the seed and g alone. Where mating finds fewer new points than a generation
# has rows, as on a small grid, points at random fill it up.

# Excess that a row without values counts with: more than any limit can be broken by.
_OUT_OF_REACH = 1e9


@dataclass(slots=True, eq=False)
class Evolution:
    """NSGA-II under way; `dqforge.optimizer.exploration.study_search.SearchRows`.

    Args:
        variables: What varies.
        population: Rows of each generation.
        seed: Of all numbers at random.
        algorithm: That of pymoo.
        generation: Generations that have been told.
        asked: Individuals of the generation that was asked for and not yet told.
    """

    variables: tuple[SearchVariable, ...]
    population: int
    seed: int
    algorithm: Any
    generation: int = 0
    asked: Any = None

    def ask(self) -> FloatArray:
        """Inputs of the next generation, shape (population, V)."""
        if self.asked is None:
            self.algorithm.random_state = np.random.default_rng([self.seed, self.generation])
            self.asked = self._filled(self.algorithm.ask())
        return values_of(self.variables, points_of(self.asked))

    def _filled(self, found: Any) -> Any:
        """Individuals as many as a generation has rows."""
        from pymoo.core.population import Population

        have = 0 if found is None else len(found)
        random = np.random.default_rng([self.seed, self.generation, 1])
        drawn = drawn_points(self.variables, self.population - have, random)
        further = Population.new(X=_individuals(self.variables, drawn))
        return further if found is None else Population.merge(found, further)

    def tell(self, outcomes: Outcomes) -> None:
        """What became of the rows of the generation asked for."""
        self.ask()
        for place, individual in enumerate(self.asked):
            known = bool(outcomes.known[place])
            excess = (
                outcomes.excess[place]
                if known
                else np.full_like(outcomes.excess[place], _OUT_OF_REACH)
            )
            broken = 0.0 if known else _OUT_OF_REACH
            individual.F = outcomes.goals[place] if known else np.zeros(outcomes.goals.shape[1])
            individual.G = np.append(excess, broken)
            individual.H = np.zeros(0)
            individual.evaluated = {"F", "G", "H"}
        self.algorithm.tell(infills=self.asked)
        self.asked = None
        self.generation += 1


def points_of(individuals: Any) -> FloatArray:
    """Shares of ranges and places of steps of pymoo's individuals, shape (n, V).

    Args:
        individuals: A population of pymoo.
    """
    rows = [[each.X[_name(place)] for place in range(len(each.X))] for each in individuals]
    return np.array(rows, dtype=np.float64)


def _individuals(
    variables: Sequence[SearchVariable], points: FloatArray
) -> list[dict[str, float | int]]:
    return [
        {
            _name(place): float(value) if variable.kind == "range" else round(float(value))
            for place, (variable, value) in enumerate(zip(variables, row, strict=True))
        }
        for row in points
    ]


def _name(place: int) -> str:
    return f"x{place}"


def _pymoo_variable(variable: SearchVariable) -> Any:
    """A variable as pymoo knows it."""
    from pymoo.core.variable import Choice, Integer, Real

    if variable.kind == "range":
        return Real(bounds=(0.0, 1.0))
    if variable.kind == "steps":
        return Integer(bounds=(0, variable.count - 1))
    return Choice(options=list(range(variable.count)))


def open_evolution(
    search: Search, variables: Sequence[SearchVariable], goals: int, limits: int
) -> Evolution:
    """NSGA-II before its first generation.

    Args:
        search: Rows per generation and seed.
        variables: What varies.
        goals, limits: Numbers of goals and of limits.

    Raises:
        InputError: pymoo is not installed.
    """
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.duplicate import DefaultDuplicateElimination
        from pymoo.core.mixed import MixedVariableMating, MixedVariableSampling
        from pymoo.core.problem import Problem
        from pymoo.core.termination import NoTermination
    except ImportError as error:
        raise InputError(
            "search.method: nsga2 needs pymoo; install it with: pip install 'dqforge[explore]'"
        ) from error
    unlike = DefaultDuplicateElimination(func=points_of)
    algorithm = NSGA2(
        pop_size=search.population,
        sampling=MixedVariableSampling(),
        mating=MixedVariableMating(eliminate_duplicates=unlike),
        eliminate_duplicates=unlike,
    )
    problem = Problem(
        vars={_name(place): _pymoo_variable(each) for place, each in enumerate(variables)},
        n_obj=goals,
        n_ieq_constr=limits + 1,
    )
    algorithm.setup(problem, termination=NoTermination(), seed=search.seed, verbose=False)
    return Evolution(tuple(variables), search.population, search.seed, algorithm)


# The seam between a search and whoever computes its rows.
#
# A search hands out one generation after the other: `ask` gives the inputs of all its rows at
# once, `tell` takes their outcomes, in the order of the rows, whenever the last of them is in. In
# which order they were computed therefore cannot matter. Row i of generation g is row g P + i of
# the study, P rows per generation. A search is deterministic in its seed and its outcomes: one
# that was cut off goes on after the finished generations have been asked for and told again, which
# computes no row.

PARTS = 4  # Parts of a generation, about: enough for the workers of one machine.


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """What became of the rows of one generation, in their order.

    Args:
        goals: What is made small, shape (n, G); anything where a row has no values.
        excess: How far each limit is broken, as a share of it, shape (n, L); at most 0 where it is
            kept.
        known: Whether a row has values, shape (n,).
    """

    goals: FloatArray
    excess: FloatArray
    known: NDArray[np.bool_]


class SearchRows(Protocol):
    """A search under way."""

    @property
    def variables(self) -> tuple[SearchVariable, ...]:
        """What it varies, in the order of the columns of its points."""
        ...

    @property
    def population(self) -> int:
        """Rows of each generation."""
        ...

    @property
    def generation(self) -> int:
        """Generations that have been told."""
        ...

    def ask(self) -> FloatArray:
        """Inputs of the next generation, shape (population, V): a number in the SI unit of its key
        for a range, the place of the step of its axis for others. The same until it is told.
        """
        ...

    def tell(self, outcomes: Outcomes) -> None:
        """What became of the rows of the generation asked for."""
        ...


def generation_batch(population: int, largest: int) -> int:
    """Rows of a part: a divisor of the population, so that no part lies in two generations; about
    a quarter of it and no more than ``largest``.

    Args:
        population: Rows of a generation.
        largest: Rows that a part may have by the kind of the study.
    """
    wish = max(min(population // PARTS, largest), 1)
    divisors = [size for size in range(wish, 0, -1) if population % size == 0]
    below = divisors[0]
    # A prime number of rows would make parts of one row each: better one part of all.
    return population if below * 16 < wish and population <= largest else below


def outcomes_of(
    goals: Sequence[GoalColumn],
    limits: Sequence[AcceptedRange],
    columns: Mapping[str, FloatArray | NDArray[np.int32]],
    states: NDArray[np.int8],
) -> Outcomes:
    """Outcomes of the rows of a generation from their columns.

    Args:
        goals: What is made small or large.
        limits: Limits of the study.
        columns: Columns of the rows by name, shape (n,).
        states: Places in `STATES`, shape (n,).
    """
    signed = [
        np.asarray(columns[each.column], dtype=np.float64) * (1.0 if each.minimise else -1.0)
        for each in goals
    ]
    broken = [_excess(each, np.asarray(columns[each.column], dtype=np.float64)) for each in limits]
    found = np.column_stack(signed)
    excess = np.column_stack(broken) if broken else np.zeros((states.size, 0))
    ended = np.isin(states, [STATES.index("ok"), STATES.index("limit")])
    known = ended & np.all(np.isfinite(found), axis=1) & np.all(np.isfinite(excess), axis=1)
    # A row may be beyond a limit that is none of the study's, such as the end of a table.
    elsewhere = (states == STATES.index("limit")) & ~np.any(excess > 0.0, axis=1)
    return Outcomes(found, excess, known & ~elsewhere)


def _excess(limit: AcceptedRange, values: FloatArray) -> FloatArray:
    """How far values lie beyond a limit, as a share of it; negative within."""
    bounds = [abs(bound) for bound in (limit.below, limit.above) if bound is not None]
    size = max([bound for bound in bounds if bound > 0.0], default=1.0)
    share = limit.excess(values) / size
    return np.asarray(np.where(limit.met(values), np.minimum(share, 0.0), share))


def search_variables(axes: Sequence[Axis]) -> tuple[SearchVariable, ...]:
    """What a search varies, one variable per axis.

    Args:
        axes: Axes of the study.

    Raises:
        InputError: Nothing varies.
    """
    if not axes:
        raise InputError("search: nothing varies; write the keys to search over under vary")
    return tuple(_variable(axis) for axis in axes)


def _variable(axis: Axis) -> SearchVariable:
    count = len(axis.steps)
    numbers = np.array(axis.numbers, dtype=np.float64)
    if axis.continuous:
        low, high = float(numbers[0, 0]), float(numbers[-1, 0])
        return SearchVariable(axis.keys, "range", low, high, axis.spacing == "log")
    steps = np.diff(numbers[:, 0]) if axis.numbers else np.zeros(0)
    ordered = axis.numbers and (bool(np.all(steps > 0.0)) or bool(np.all(steps < 0.0)))
    return SearchVariable(axis.keys, "steps" if ordered else "choice", count=count)


def values_of(variables: Sequence[SearchVariable], points: FloatArray) -> FloatArray:
    """Points as rows have them, shape (n, V): numbers of ranges in SI units, places of steps.

    Args:
        variables: What varies.
        points: Shares of ranges from 0 to 1, and places of steps, shape (n, V).
    """
    columns = [each.value(points[:, place]) for place, each in enumerate(variables)]
    return np.column_stack(columns)


def drawn_points(
    variables: Sequence[SearchVariable], count: int, random: np.random.Generator
) -> FloatArray:
    """Points at random, shares of ranges and places of steps, shape (count, V).

    Args:
        variables: What varies.
        count: Number of points.
        random: Source of the numbers.
    """
    columns = [
        random.random(count)
        if each.kind == "range"
        else random.integers(0, each.count, count).astype(np.float64)
        for each in variables
    ]
    return np.column_stack(columns)
