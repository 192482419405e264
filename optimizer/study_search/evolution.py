"""The evolutionary search NSGA-II (Deb and others 2002, doi:10.1109/4235.996017), as pymoo has it.

pymoo mates and selects; rows, seeds and the number of points are settled here. The numbers of
generation g come from the seed and g alone. Where mating finds fewer new points than a generation
has rows, as on a small grid, points at random fill it up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.study_search.search_rows import Outcomes
from dqforge.optimizer.study_search.search_space import (
    SearchVariable,
    drawn_points,
    values_of,
)

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
