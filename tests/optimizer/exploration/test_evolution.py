"""The evolutionary search on problems whose front is known."""

from __future__ import annotations

from functools import cache
from typing import get_args

import numpy as np
import pytest
from search_problems import free, opened, ranges, searched, zdt1

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.exploration.study import Search
from dqforge.machines.names import ModulationName
from dqforge.optimizer.exploration.acceptance import Front, front_of
from dqforge.optimizer.exploration.study_search import Outcomes, SearchVariable
from dqforge.optimizer.losses.drive_budget import drive_budget
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.operating_points.solve import current_choice


def front_of_all(outcomes: list[Outcomes]) -> Front:
    goals = np.concatenate([each.goals for each in outcomes])
    fine = np.concatenate([each.known & np.all(each.excess <= 0.0, axis=1) for each in outcomes])
    places = np.flatnonzero(fine)
    return front_of(places, goals[places])


def test_the_front_of_a_known_problem_is_reached() -> None:
    run = opened(Search("nsga2", 60, 100, 3), ranges(5))
    _, outcomes = searched(run, zdt1, 100)
    front = front_of_all(outcomes).goals
    assert np.max(front[:, 1] - (1.0 - np.sqrt(front[:, 0]))) < 0.02
    assert np.max(np.diff(np.sort(front[:, 0]))) < 0.05
    # Points at random of the same number stay far away.
    far = zdt1(np.random.default_rng(3).random((6000, 5))).goals
    assert np.min(far[:, 1] - (1.0 - np.sqrt(far[:, 0]))) > 0.02


def mixed() -> tuple[SearchVariable, ...]:
    return (
        SearchVariable(("f",), "range", 1.0, 100.0, logarithmic=True),
        SearchVariable(("n",), "steps", count=9),
        SearchVariable(("device",), "choice", count=4),
    )


def mixed_goals(points: FloatArray) -> FloatArray:
    frequency, steps, device = points.T
    price = np.array([5.0, 1.0, 3.0, 2.0])[device.astype(int)]
    return np.column_stack([frequency * (1.0 + steps) / price, price + 10.0 / frequency + steps])


def bounded(points: FloatArray) -> Outcomes:
    """Limits keep the frequency above 3; rows of the third device have no values."""
    goals = mixed_goals(points)
    excess = (3.0 - points[:, :1]) / 3.0
    return Outcomes(goals, excess, points[:, 2] != 2.0)


def test_points_are_numbers_of_ranges_and_places_of_steps() -> None:
    run = opened(Search("nsga2", 30, 8, 1), mixed(), 2, 1)
    points, _ = searched(run, bounded, 8)
    every = np.concatenate(points)
    assert every.shape == (240, 3)
    assert np.all((every[:, 0] >= 1.0) & (every[:, 0] <= 100.0))
    assert set(every[:, 1]) <= set(map(float, range(9)))
    assert set(every[:, 2]) == {0.0, 1.0, 2.0, 3.0}
    # The last generations have left what breaks the limit or has no values.
    assert np.mean(bounded(points[-1]).known) > 0.8
    assert np.mean(points[-1][:, 0] >= 3.0) > 0.8


def test_the_same_seed_takes_the_same_way_and_another_one_another() -> None:
    ways = [
        searched(opened(Search("nsga2", 20, 6, seed), mixed(), 2, 1), bounded, 6)[0]
        for seed in (4, 4, 5)
    ]
    assert np.array_equal(ways[0], ways[1])
    assert not np.array_equal(ways[0], ways[2])


def test_a_search_that_was_cut_off_goes_on_from_its_outcomes() -> None:
    search = Search("nsga2", 20, 9, 4)
    points, outcomes = searched(opened(search, mixed(), 2, 1), bounded, 9)
    again = opened(search, mixed(), 2, 1)
    for known in outcomes[:5]:
        again.tell(known)
    assert again.generation == 5
    for generation in range(5, 9):
        assert np.array_equal(again.ask(), points[generation])
        assert np.array_equal(again.ask(), points[generation])  # asking twice changes nothing
        again.tell(outcomes[generation])


@pytest.mark.slow
def test_a_space_smaller_than_a_generation_still_fills_every_row() -> None:
    few = (SearchVariable(("a",), "steps", count=3), SearchVariable(("b",), "choice", count=2))
    run = opened(Search("nsga2", 20, 5, 4), few)
    points, _ = searched(run, lambda at: free(np.column_stack([at[:, 0], -at[:, 1]])), 5)
    assert all(each.shape == (20, 2) for each in points)
    assert len(np.unique(np.concatenate(points), axis=0)) == 6


def test_a_generation_without_any_values_ends_nothing() -> None:
    run = opened(Search("nsga2", 12, 4, 4), mixed(), 2, 1)

    def nothing(points: FloatArray) -> Outcomes:
        lost = np.full((len(points), 2), np.nan)
        return Outcomes(lost, np.full((len(points), 1), np.nan), np.zeros(len(points), np.bool_))

    points, _ = searched(run, nothing, 3)
    assert np.all(np.isfinite(np.concatenate(points)))


# The drive's own device, and those of the library that have its voltage.
DEVICES = (
    "",
    "fuji-2mbi300xbe120-50",
    "infineon-ff200r12ke3",
    "mitsubishi-cm200dy-24t",
    "sirectifier-sii400s12",
    "microchip-mscsm70am10ct3ag",
    "wolfspeed-c2m0045170d",
)

MODULATIONS = get_args(ModulationName)
FREQUENCIES = np.geomspace(8e3, 100e3, 20)


@cache
def drive_grid() -> tuple[FloatArray, BoolArray]:
    """Weighted loss in W and largest ripple in A of a drive, shape (devices, frequencies,
    modulators, 2), and whether the drive can run so.
    """
    name, goals, runs = "paper000-ipmsm-100kw", [], []
    for device in DEVICES:
        settings = [f"inverter.device={{name: {device}}}"] if device else []
        design = load_text(catalogue.read_text(name), name, settings=settings)
        budget = drive_budget(
            design.machine,
            design.inverter,
            *current_choice(design).currents(np.array([40.0, 130.0, 180.0])),
            np.array([450.0, 300.0, 200.0]),
            MODULATIONS,
            FREQUENCIES,
            options=budget_options(design),
        )
        loss = budget.total @ np.array([0.6, 0.3, 0.1])
        goals.append(np.stack([loss, np.max(budget.ripple_current, axis=2)], axis=-1))
        runs.append(np.all(budget.feasible & budget.within_tables, axis=2))
    return np.swapaxes(np.array(goals), 1, 2), np.swapaxes(np.array(runs), 1, 2)


@pytest.mark.slow
def test_on_the_grid_of_a_drive_the_search_finds_the_front_of_the_whole_grid() -> None:
    """Device, carrier frequency and modulator, with a limit of 6 A on the ripple.

    Two settings of the front differ by 5e-6 W and 0.8 % of ripple: which of them is met follows the
    last digits of the processor.
    """
    grid, runs = drive_grid()
    whole = grid.reshape(-1, 2)
    fine = runs.ravel() & (whole[:, 1] <= 6.0)
    expected = front_of(np.flatnonzero(fine), whole[fine]).goals
    variables = (
        SearchVariable(("inverter.device",), "choice", count=len(DEVICES)),
        SearchVariable(("inverter.switching_frequency",), "steps", count=FREQUENCIES.size),
        SearchVariable(("losses.modulations",), "choice", count=len(MODULATIONS)),
    )

    def judged(points: FloatArray) -> Outcomes:
        place = tuple(points.astype(int).T)
        return Outcomes(grid[place], grid[place][:, 1:] / 6.0 - 1.0, runs[place])

    run = opened(Search("nsga2", 100, 12, 7), variables, 2, 1)
    points, outcomes = searched(run, judged, 12)
    found = front_of_all(outcomes).goals
    assert 10 < len(expected) < 0.05 * len(whole)
    beside = np.min(np.max(found / expected[:, np.newaxis], axis=2), axis=1)
    assert np.max(beside) < 1.01
    assert np.count_nonzero(beside <= 1.0) >= len(expected) - 1
    assert len(np.unique(np.concatenate(points), axis=0)) < 0.6 * len(whole)
