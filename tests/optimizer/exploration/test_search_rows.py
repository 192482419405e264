"""The seam between a search and its rows."""

from __future__ import annotations

import pickle
import sys

import numpy as np
import pytest
from search_problems import opened, ranges
from searched_rows import FRONT, ONE_GOAL, searched, study_of

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.exploration.study import Search
from dqforge.optimizer.control_design.gain_set import solve_current_loops
from dqforge.optimizer.exploration.acceptance import AcceptedRange, GoalColumn
from dqforge.optimizer.exploration.row_block import STATES
from dqforge.optimizer.exploration.study_plan import StudyPlan
from dqforge.optimizer.exploration.study_search import SearchVariable, generation_batch, outcomes_of


def test_outcomes_are_small_where_rows_are_good() -> None:
    columns = {
        "out.loss": np.array([5.0, 4.0, np.nan, 3.0, 2.0]),
        "out.margin": np.array([1.0, 0.5, 1.0, 0.9, 1.2]),
    }
    states = np.array([STATES.index(s) for s in ("ok", "limit", "ok", "crashed", "ok")], np.int8)
    found = outcomes_of(
        (GoalColumn("out.loss"), GoalColumn("out.margin", minimise=False)),
        (AcceptedRange("out.margin", "margin", above=0.8),),
        columns,
        states,
    )
    assert found.known.tolist() == [True, True, False, False, True]
    assert found.goals[0].tolist() == [5.0, -1.0]
    assert found.excess[:, 0] == pytest.approx([-0.25, 0.375, -0.25, -0.125, -0.5])


def test_a_limit_met_within_the_margin_of_verdicts_is_kept() -> None:
    columns = {"y": np.array([1.0 + 1e-12])}
    limit = AcceptedRange("y", "y", below=1.0)
    found = outcomes_of((GoalColumn("y"),), (limit,), columns, np.zeros(1, np.int8))
    assert found.excess[0, 0] <= 0.0


def test_a_row_beyond_a_limit_of_somebody_else_counts_as_lost() -> None:
    columns = {"y": np.array([0.5, 0.5, 2.0])}
    states = np.array([STATES.index(s) for s in ("ok", "limit", "limit")], np.int8)
    limit = AcceptedRange("y", "y", below=1.0)
    found = outcomes_of((GoalColumn("y"),), (limit,), columns, states)
    assert found.known.tolist() == [True, False, True]
    free = outcomes_of((GoalColumn("y"),), (), columns, states)
    assert free.known.tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("population", "largest", "expected"),
    [(200, 1000, 50), (200, 20, 20), (40, 1000, 10), (97, 1000, 97), (101, 7, 1), (1, 5, 1)],
)
def test_no_part_lies_in_two_generations(population: int, largest: int, expected: int) -> None:
    batch = generation_batch(population, largest)
    assert batch == expected
    assert population % batch == 0


def test_what_does_not_suit_a_search_is_refused_in_one_line() -> None:
    nlopt, nsga2 = Search("nlopt", 4, 10, 1), Search("nsga2", 4, 10, 1)
    with pytest.raises(InputError, match="nlopt has one goal, the study has 2; write method: nsga"):
        opened(nlopt, ranges(2), 2)
    listed = (*ranges(1), SearchVariable(("inverter.device",), "choice", count=3))
    with pytest.raises(InputError, match=r"varies ranges, and inverter\.device has listed values"):
        opened(nlopt, listed, 1)
    with pytest.raises(InputError, match="search: nothing is made small"):
        opened(nsga2, ranges(2), 0)


def test_without_pymoo_it_is_told_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymoo.algorithms.moo.nsga2", None)
    with pytest.raises(InputError, match=r"needs pymoo; install it with: pip install 'dqforge\["):
        opened(Search("nsga2", 4, 10, 1), ranges(2))


@pytest.mark.parametrize("text", [FRONT, ONE_GOAL], ids=["front", "one-goal"])
def test_rows_of_a_search_are_the_designs_at_its_points(text: str) -> None:
    """Two generations, row by row by the single path; what is told has the sign of its goal."""
    study = searched(StudyPlan(study_of(text)))
    run = study.begun()
    size = study.search.population
    for number in range(2):
        points = run.ask()
        rows = study.generation(number, points)
        assert (rows.start, rows.size) == (number * size, size)
        assert rows.count == size * study.search.generations
        block = rows.rows(rows.start, rows.start + size)
        travelled = pickle.loads(pickle.dumps(rows)).rows(rows.start + 1, rows.start + 3)
        assert np.array_equal(rows.keys(rows.start, rows.start + size), block.keys)
        assert np.array_equal(travelled.keys, block.keys[1:3])
        columns = {name: block.columns[name] for name in study.judged_columns}
        told = study.outcomes(columns, block.states)
        frequencies = (
            points[:, 2]
            if text == ONE_GOAL
            else np.array([5e3, 8e3, 10e3])[points[:, 2].astype(int)]
        )
        assert np.all((points[:, 0] >= 2.0) & (points[:, 0] <= 3.0))
        for place in (0, size - 1):
            settings = [
                f"machine.resistance={float(points[place, 0])!r} Ohm",
                f"machine.inductance_q={float(points[place, 1])!r} H",
                f"control.sampling_frequency={float(frequencies[place])!r} Hz",
            ]
            name = "paper001-pmsm-bench"
            design = load_text(catalogue.read_text(name), name, settings=settings)
            gains = solve_current_loops(design)[1].margins
            margin, crossover = gains.phase_margin, gains.crossover
            if text == ONE_GOAL:
                goals, excess = [-crossover], 1.0 - margin / np.radians(60.0)
            else:
                goals, excess = [-margin, -crossover], 1.0 - crossover / (2.0 * np.pi * 100.0)
            assert told.goals[place] == pytest.approx(goals, rel=1e-9)
            assert told.excess[place] == pytest.approx([excess], rel=1e-9, abs=1e-12)
            assert (block.states[place] == STATES.index("limit")) == (excess > 0.0)
        run.tell(told)
    assert run.generation == 2
