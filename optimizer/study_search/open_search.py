"""The search that a study asks for."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.study_search.descents import open_descents
from dqforge.optimizer.study_search.evolution import open_evolution
from dqforge.optimizer.study_search.search_rows import SearchRows
from dqforge.optimizer.study_search.search_space import SearchVariable


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
