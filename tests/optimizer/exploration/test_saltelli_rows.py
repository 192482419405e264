"""Rows of a study that are made for sensitivities, all the way to the sensitivities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from dqforge.machines.exploration.study import Axis, Draw, Study, Tolerance
from dqforge.optimizer.exploration.acceptance import StudyQuestion, summarise
from dqforge.optimizer.exploration.row_block import row_inputs

KEYS = ("machine.resistance", "machine.inductance_d", "inverter.v_dc")
STUDY = Study(
    name="made by the tests",
    about="",
    design_text=b"",
    design_source="none",
    digest="",
    tolerances=tuple(
        Tolerance(key, "between", low=-np.pi, high=np.pi, relative=False) for key in KEYS
    ),
    draw=Draw(5 * 1024, 3, "sobol"),
    sensitivity=("losses.total",),
)


@dataclass(frozen=True)
class Rows:
    """A part."""

    first: int
    columns: dict[str, np.ndarray]
    messages: tuple[str, ...] = ()

    @property
    def states(self) -> np.ndarray:
        return np.zeros(self.columns["y"].size, dtype=np.int8)


def part(first: int, end: int) -> Rows:
    """Ishigami's function of the three keys, in an order that is not theirs by name."""
    inputs = row_inputs(STUDY, first, end)
    one, two, three = (np.asarray(inputs[key], dtype=float) for key in KEYS)
    output = np.sin(one) + 7.0 * np.sin(two) ** 2 + 0.1 * three**4 * np.sin(one)
    return Rows(first, dict(zip(KEYS, (one, two, three), strict=True)) | {"y": output})


def test_first_order_and_total_sensitivities_come_out_for_the_right_keys() -> None:
    assert STUDY.saltelli
    question = StudyQuestion(drawn=KEYS, sensitivity=("y",), saltelli=True)
    found = summarise(question, (part(k, min(k + 700, 5120)) for k in range(0, 5120, 700)))
    single = found.sensitivities[0]
    assert single.inputs == KEYS
    assert single.total is not None
    assert single.first == pytest.approx([0.3139, 0.4424, 0.0], abs=0.04)
    assert single.total == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.04)


def test_rows_are_the_same_from_any_batch() -> None:
    whole = row_inputs(STUDY, 0, 200)
    for first, end in ((0, 1), (3, 17), (64, 200)):
        piece = row_inputs(STUDY, first, end)
        for key in KEYS:
            assert np.array_equal(piece[key], whole[key][first:end])
    table = np.column_stack([whole[key] for key in sorted(KEYS)]).reshape(40, 5, 3)
    for place in range(3):
        changed = table[:, 2 + place] != table[:, 0]
        assert np.array_equal(np.flatnonzero(changed.any(axis=0)), [place])
        assert np.array_equal(table[:, 2 + place, place], table[:, 1, place])


def test_other_studies_keep_plain_points() -> None:
    draw = Draw(100, 3, "sobol", ((KEYS[0], KEYS[1], 0.5),))
    axis = Axis(("inverter.v_dc",), ((400.0,), (500.0,)), ((400.0,), (500.0,)))
    for changed in (
        replace(STUDY, sensitivity=()),
        replace(STUDY, draw=draw),
        replace(STUDY, draw=Draw(100, 3)),
        replace(STUDY, draw=None),
        replace(STUDY, axes=(axis,)),
    ):
        assert not changed.saltelli
