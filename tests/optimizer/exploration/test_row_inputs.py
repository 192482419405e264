"""Inputs of rows: order of the grid, words, values as designs take them."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from broken_studies import BASE, changed

from dqforge.machines.exploration import study_checks as catalogue
from dqforge.machines.exploration.row_designs import design_of
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import row_count, study_of_text
from dqforge.optimizer.exploration.row_block import (
    chosen_inputs,
    input_columns,
    input_keys,
    row_assignments,
    row_inputs,
)


def read(text: str) -> Study:
    return study_of_text(text.encode(), "study.yaml")


def test_the_last_axis_is_quickest_and_draws_are_innermost() -> None:
    study = read(BASE)
    found = row_inputs(study, 0, 60)
    carriers = np.repeat([60e3, 80e3, 100e3], 20)
    np.testing.assert_array_equal(found["inverter.switching_frequency"], carriers)
    words = np.tile(np.repeat([1, 0], 10), 3)
    np.testing.assert_array_equal(found["operation.strategy"], words)
    specs = {spec.name: spec for spec in input_columns(study)}
    assert specs["in.operation.strategy"].choices == ("id0", "mtpa")
    assert specs["in.inverter.switching_frequency"].unit == "Hz"
    assert list(specs) == [f"in.{key}" for key in found]
    for key in ("inverter.v_dc", "machine.resistance"):
        # Every point of the grid has the same machines.
        np.testing.assert_array_equal(found[key], np.tile(found[key][:10], 6))
        assert len(set(found[key])) == 10


SHIPPED = [catalogue.read_text(name).decode() for name in catalogue.names()]
# Rows of a search follow from each other: they have no inputs of their own.
DRAWN_OR_ON_A_GRID = [BASE, *(text for text in SHIPPED if "\nsearch:" not in text)]


@pytest.mark.parametrize("text", DRAWN_OR_ON_A_GRID)
def test_any_range_of_rows_is_that_of_all(text: str) -> None:
    study = read(text)
    count = min(row_count(study), 1440)
    whole = row_inputs(study, 0, count)
    for first, end in [(0, 1), (7, 33), (count - 5, count), (11, 11), (19, 41)]:
        part = row_inputs(study, first, end)
        assert list(part) == list(whole)
        for key, column in part.items():
            np.testing.assert_array_equal(column, whole[key][first:end])
            assert column.dtype == whole[key].dtype


def test_the_grid_is_that_of_nested_loops() -> None:
    study = catalogue.load("modules-and-modulators")
    found = row_inputs(study, 0, 1440)
    rows = itertools.product(*(axis.steps for axis in study.axes))
    for place, row in enumerate(rows):
        if place % 97 == 0:
            assigned = row_assignments(study, found, place)
            assert assigned["inverter.device"] == row[0][0]
            assert assigned["losses.modulations"] == row[2][0]
            assert assigned["inverter.switching_frequency"] == row[1][0]


def test_a_row_is_the_design_of_its_inputs() -> None:
    study = read(BASE)
    found = row_inputs(study, 0, 60)
    for place in (0, 13, 59):
        design = design_of(study, row_assignments(study, found, place))
        assert design.machine.r_s == found["machine.resistance"][place]
        assert design.inverter.v_dc == found["inverter.v_dc"][place]
        assert design.inverter.f_sw == found["inverter.switching_frequency"][place]
        word = ("id0", "mtpa")[int(found["operation.strategy"][place])]
        assert design.strategy == word
        assert design.fit.degree == 3


def test_labels_tell_values_of_one_name_apart() -> None:
    values = (
        "[{name: sirectifier-sii400s12}, {name: sirectifier-sii400s12, junction_temperature: 80}]"
    )
    study = read(changed(("operation.strategy: [mtpa, id0]", f"inverter.device: {values}")))
    spec = next(each.spec for each in input_keys(study) if each.spec.kind == "choice")
    assert spec.choices == (
        '{"junction_temperature": 80, "name": "sirectifier-sii400s12"}',
        '{"name": "sirectifier-sii400s12"}',
    )


def test_whole_numbers_and_kinds_reach_the_design() -> None:
    text = changed(
        (
            "  operation.strategy: [mtpa, id0]",
            (
                "  fit.segments: {range: {from: 1, to: 2, count: 2}}\n"
                "  machine.inductance_q:\n    - {value: 1.2 mH, kind: line-to-line}\n"
                "    - {value: 1.3 mH, kind: line-to-line}"
            ),
        )
    )
    study = read(text)
    found = row_inputs(study, 0, row_count(study))
    assert set(found["machine.inductance_q"]) == {1.2e-3, 1.3e-3}
    assigned = row_assignments(study, found, 35)
    design = design_of(study, assigned)
    assert design.fit.segments == found["fit.segments"][35]
    assert assigned["machine.inductance_q"] == {
        "value": f"{found['machine.inductance_q'][35]} H",
        "kind": "line-to-line",
    }


def test_kinds_within_texts_reach_the_design() -> None:
    # The base has 2 mOhm of a phase; half of what lies between two terminals is that of a phase.
    varied = {
        "[4 mOhm terminal, 6 mOhm phase-to-phase]": [2e-3, 3e-3],
        "{range: {from: 4 mOhm l-l, to: 6 mOhm line to line, count: 3}}": [2e-3, 2.5e-3, 3e-3],
        "[4 mOhm terminal, 6 mOhm per phase]": [2e-3, 6e-3],
        "[4 mOhm, {value: 6 mOhm, kind: Terminal}]": [4e-3, 3e-3],
    }
    for values, resistances in varied.items():
        study = read(
            "dqforge_study: 1\nname: a\ndesign: paper000-ipmsm-100kw\n"
            f"vary:\n  machine.resistance: {values}\n"
        )
        found = row_inputs(study, 0, row_count(study))
        rows = [design_of(study, row_assignments(study, found, k)) for k in range(row_count(study))]
        assert [row.machine.r_s for row in rows] == pytest.approx(resistances)
        assert sorted(row.machine.r_s for row in rows) == pytest.approx(sorted(resistances))


def test_a_study_without_anything_has_one_row() -> None:
    study = read("dqforge_study: 1\nname: a\ndesign: paper000-ipmsm-100kw\n")
    assert row_count(study) == 1
    assert row_inputs(study, 0, 1) == {}
    assert row_assignments(study, {}, 0) == {}


SEARCHED = """\
dqforge_study: 1
name: Trial
design: paper000-ipmsm-100kw
vary:
  inverter.switching_frequency: {range: {from: 60 kHz, to: 100 kHz, count: 3}}
  operation.strategy: [mtpa, id0]
  steps: {together: {machine.resistance: [3 mOhm, 4 mOhm], inverter.v_dc: [500 V, 450 V]}}
pareto: {minimise: [losses.total]}
"""


def test_chosen_points_are_numbers_between_ends_and_places_of_steps() -> None:
    study = read(SEARCHED)
    points = np.array([[61234.5, 1.0, 0.0], [1e5, 0.0, 1.0]])
    found = chosen_inputs(study, points)
    assert found["inverter.switching_frequency"].tolist() == [61234.5, 1e5]
    assert found["machine.resistance"] == pytest.approx([3e-3, 4e-3], rel=1e-14)
    assert found["inverter.v_dc"].tolist() == [500.0, 450.0]
    words = row_assignments(study, found, 0)
    assert words["operation.strategy"] == "id0"
    design = design_of(study, row_assignments(study, found, 1))
    assert (design.inverter.f_sw, design.inverter.v_dc) == (1e5, 450.0)
    assert row_assignments(study, found, 1)["operation.strategy"] == "mtpa"


def test_a_chosen_point_of_a_grid_has_the_inputs_of_its_row() -> None:
    study = read(SEARCHED)
    places = np.array([[k // 4, k // 2 % 2, k % 2] for k in range(12)], dtype=np.float64)
    carriers = np.array(study.axes[0].numbers)[:, 0]
    points = np.column_stack([carriers[places[:, 0].astype(int)], places[:, 1:]])
    grid, found = row_inputs(study, 0, 12), chosen_inputs(study, points)
    assert list(found) == list(grid)
    assert all(np.array_equal(found[name], grid[name]) for name in grid)
