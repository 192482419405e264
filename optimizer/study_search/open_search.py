"""The search that a study asks for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.study_search.search_rows import (
    Outcomes,
    SearchRows,
    SearchVariable,
    drawn_points,
    values_of,
)


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


@dataclass(slots=True, eq=False)
class Descents:
    """Descents under way; `dqforge.optimizer.study_search.search_rows.SearchRows`.

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
    """NSGA-II under way; `dqforge.optimizer.study_search.search_rows.SearchRows`.

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
