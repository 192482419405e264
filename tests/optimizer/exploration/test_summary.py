"""What the rows of a study say together, part by part."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.optimizer.exploration.acceptance import (
    NAMED,
    AcceptanceTally,
    AcceptedRange,
    GoalColumn,
    StudyQuestion,
    StudySummary,
    front_of,
    summarise,
    wilson,
)
from dqforge.optimizer.exploration.row_block import STATES

ACCEPT = (AcceptedRange("out.y", "y", below=1.0), AcceptedRange("out.z", "z", above=-1.0))
QUESTION = StudyQuestion(
    accept=ACCEPT,
    goals=(GoalColumn("out.y"), GoalColumn("out.z", minimise=False)),
    inputs=("in.a", "in.b"),
    drawn=("in.a", "in.b"),
    sensitivity=("out.y",),
    spread=("out.z",),
)


@dataclass(frozen=True)
class Rows:
    """A part."""

    first: int
    columns: dict[str, FloatArray]
    states: np.ndarray
    messages: tuple[str, ...] = ()


def rows(first: int, count: int) -> Rows:
    """Rows that depend on their index alone; every 50th ended badly."""
    index = np.arange(first, first + count)
    a, b = np.sin(0.7 * index**1.5), np.cos(1.3 * index**1.4)
    states = np.where(index % 50 == 13, STATES.index("crashed"), 0).astype(np.int8)
    lost = states > 0
    columns = {
        "in.a": a,
        "in.b": b,
        "out.y": np.where(lost, np.nan, 2.0 * a + 0.1 * b),
        "out.z": np.where(lost, np.nan, b - a),
    }
    messages = tuple(f"row {k} fell" if bad else "" for k, bad in zip(index, lost, strict=True))
    return Rows(first, columns, states, messages)


def parts(count: int, size: int) -> Iterator[Rows]:
    return (rows(first, min(size, count - first)) for first in range(0, count, size))


def summary(count: int, size: int) -> StudySummary:
    return summarise(QUESTION, parts(count, size))


def test_shares_are_those_of_all_rows_and_crashed_ones_count_as_bad() -> None:
    whole, found = rows(0, 5000), summary(5000, 700).acceptance
    y, z = whole.columns["out.y"], whole.columns["out.z"]
    met = (int(np.sum(y <= 1.0)), int(np.sum(z >= -1.0)))
    assert found.rows == 5000
    assert found.met == met
    assert found.met_all == int(np.sum((y <= 1.0) & (z >= -1.0)))
    assert found.share(0).interval == wilson(met[0], 5000)
    assert found.states["crashed"] == 100
    assert found.states["ok"] == 4900
    assert len(found.named) == NAMED
    assert found.named[0].index == 13
    assert found.named[0].message == "row 13 fell"
    assert [row.index for row in found.named] == [13 + 50 * place for place in range(NAMED)]


def test_the_worst_row_is_named_with_its_inputs() -> None:
    whole, found = rows(0, 5000), summary(5000, 700).acceptance
    worst = found.worst[0]
    assert worst is not None
    assert worst.index == int(np.nanargmax(whole.columns["out.y"]))
    assert worst.value == np.nanmax(whole.columns["out.y"])
    assert worst.inputs == {name: whole.columns[name][worst.index] for name in ("in.a", "in.b")}
    least = found.worst[1]
    assert least is not None
    assert least.value == np.nanmin(whole.columns["out.z"])


def test_the_front_is_that_of_all_good_rows() -> None:
    whole, found = rows(0, 5000), summary(5000, 700).front
    good = np.flatnonzero(whole.states == 0)
    goals = np.column_stack([whole.columns["out.y"], -whole.columns["out.z"]])[good]
    expected = front_of(good, goals)
    assert found is not None
    assert np.array_equal(found.index, expected.index)
    assert np.array_equal(found.goals, expected.goals)


def test_parts_of_other_lengths_tell_the_same() -> None:
    one, other = summary(5000, 700), summary(5000, 313)
    assert one.rows == other.rows == 5000
    assert one.acceptance == other.acceptance
    assert one.front is not None
    assert other.front is not None
    assert np.array_equal(one.front.index, other.front.index)
    assert one.sensitivities[0].rows == other.sensitivities[0].rows == 4900
    assert one.sensitivities[0].first == pytest.approx(other.sensitivities[0].first, abs=0.01)
    assert one.sensitivities[0].first[0] > 0.95
    assert one.spread[0].rows == other.spread[0].rows


def test_a_verdict_at_the_limit_does_not_hang_on_the_last_digit() -> None:
    limit = AcceptedRange("out.y", "y", below=0.3, above=0.1)
    edge = np.array([0.3, np.nextafter(0.3, 1.0), 0.3 + 1e-8, 0.1, np.nextafter(0.1, 0.0), np.nan])
    assert limit.met(edge).tolist() == [True, True, False, True, True, False]


def test_rows_beyond_a_limit_of_the_design_count_by_their_values() -> None:
    found = AcceptanceTally(ACCEPT)
    states = np.array([STATES.index(state) for state in ("ok", "limit", "refused")], dtype=np.int8)
    columns = {"out.y": np.array([0.5, 0.5, 0.5]), "out.z": np.zeros(3)}
    found = found.plus(Rows(0, columns, states, ("", "losses.total", "refused")))
    assert found.met == (2, 2)
    assert found.rows == 3
    assert [row.state for row in found.named] == ["refused"]


def test_a_study_without_rows_says_so_without_trouble() -> None:
    found = summarise(QUESTION, iter(()))
    assert found.rows == 0
    assert found.acceptance.share_of_all().interval == (0.0, 1.0)
    assert found.front is not None
    assert found.front.count == 0


def test_memory_does_not_grow_with_the_rows() -> None:
    question = StudyQuestion(
        accept=ACCEPT,
        inputs=("in.a", "in.b"),
        drawn=("in.a", "in.b"),
        sensitivity=("out.y",),
        spread=("out.z",),
    )
    peaks = []
    for count in (20_000, 200_000):
        tracemalloc.start()
        summarise(question, parts(count, 1000))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.2 * peaks[0] + 50_000


def test_shares_of_a_saltelli_design_count_its_independent_rows() -> None:
    question = StudyQuestion(
        accept=ACCEPT,
        inputs=("in.a",),
        drawn=("in.a", "in.b"),
        sensitivity=("out.y",),
        saltelli=True,
    )
    found = summarise(question, parts(4000, 700))
    assert found.rows == 4000
    assert found.acceptance.rows == 2000
    whole = rows(0, 4000)
    independent = np.arange(4000) % 4 < 2
    assert found.acceptance.met[0] == int(np.sum(whole.columns["out.y"][independent] <= 1.0))
    assert found.sensitivities[0].total is not None
    assert found.acceptance.states["ok"] + found.acceptance.states["crashed"] == 4000
