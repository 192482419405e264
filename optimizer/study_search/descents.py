"""A search for one goal without derivatives: several descents of COBYLA side by side.

NLopt asks for one point after the other, which would leave all but one worker idle. Here every row
of a generation belongs to a descent of its own, from a start of its own; a descent that has come to
its end begins again at another start. COBYLA (Powell 1994, doi:10.1007/978-94-015-8330-5_4) keeps
linear models of the goal and of each limit over a simplex, so that limits need no weights.

NLopt cannot be halted between two values. It is run again from the start with all values that are
known, and left at the first one that is not: it is deterministic, and a value that is known costs
next to nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.study_search.search_rows import Outcomes
from dqforge.optimizer.study_search.search_space import SearchVariable, values_of

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
