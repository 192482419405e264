"""Keys of rows: of what a row is, not of how a study writes it or what else the study asks."""

from __future__ import annotations

import numpy as np
import pytest
from broken_studies import BASE, changed
from numpy.typing import NDArray

from dqforge.machines.exploration import study_checks as catalogue
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import row_count, study_of_text
from dqforge.optimizer.exploration.row_block import KEY_BYTES, RowKeys, row_inputs, row_keys

OUTPUTS = ("losses.total", "gains.phase_margin")


def read(text: str) -> Study:
    return study_of_text(text.encode(), "study.yaml")


def keys(text: str, outputs: tuple[str, ...] = OUTPUTS) -> NDArray[np.uint8]:
    study = read(text)
    return row_keys(study, row_inputs(study, 0, row_count(study)), outputs)


def test_every_row_has_its_key() -> None:
    found = keys(BASE)
    assert found.shape == (60, KEY_BYTES)
    assert len({bytes(key) for key in found}) == 60


@pytest.mark.parametrize(
    "text",
    [
        "# a comment\n" + BASE,
        changed(("name: Trial", "name: Other\nabout: b")),
        changed(("60 kHz", "0.06 MHz")),
        changed(("fit.degree: 3", "machine.resistance: 2e-3\n  fit.degree: 3")),
        changed(("fit.degree: 3", "machine.resistance: {value: 2 mOhm, note: n}\n  fit.degree: 3")),
        # Goals, limits and what is told of the rows afterwards are no part of a row.
        changed(("900 W", "901 W")),
        changed(("{minimise: [losses.total]}", "{maximise: [losses.total]}")),
        changed(("gains.phase_margin: {above: 60 deg}", "gains.phase_margin: {above: 61 deg}")),
    ],
)
def test_spelling_changes_no_key(text: str) -> None:
    np.testing.assert_array_equal(keys(text), keys(BASE))


@pytest.mark.parametrize(
    "text",
    [
        changed(("900 W", "{below: 900 W, point: {torque: 130 N m, speed: 300 rad/s}}")),
        changed(("fit.degree: 3", "fit.degree: 2")),
        changed(("fit.degree: 3", "machine.poles: 6")),
        changed(("seed: 1", "seed: 2")),
        changed(("draw:", "header: nominal\ndraw:")),
        changed(("fit.degree: 3", "inverter.dead_time: 300 ns")),
    ],
)
def test_another_row_has_another_key(text: str) -> None:
    assert not {bytes(key) for key in keys(text)} & {bytes(key) for key in keys(BASE)}


def test_other_outputs_are_other_rows() -> None:
    assert not np.any(np.all(keys(BASE, OUTPUTS[:1]) == keys(BASE), axis=1))
    np.testing.assert_array_equal(keys(BASE, OUTPUTS[::-1]), keys(BASE))


def test_one_more_value_keeps_the_keys_of_the_others() -> None:
    before = {bytes(key) for key in keys(BASE)}
    more = keys(changed(("[mtpa, id0]", "[id0, mtpa]"), ("count: 3}", "count: 5}")))
    assert before < {bytes(key) for key in more}


def test_which_keys_vary_is_no_part_of_a_key() -> None:
    """A grid over two voltages has the rows of two studies that set them."""
    head = "dqforge_study: 1\nname: a\ndesign: paper000-ipmsm-100kw\n"
    words = "  operation.strategy: [mtpa, id0]\n"
    grid = keys(f"{head}vary:\n  inverter.v_dc: [480 V, 500 V]\n{words}")
    singles = [
        keys(f"{head}vary:\n{words}set: {{inverter.v_dc: {v_dc}}}\n")
        for v_dc in ("480 V", "0.5 kV")
    ]
    np.testing.assert_array_equal(grid, np.concatenate(singles))
    devices = "[{name: sirectifier-sii400s12}, {name: fuji-2mbi300xbe120-50}]"
    both = keys(f"{head}vary:\n  inverter.device: {devices}\n{words}")
    set_word = keys(
        f"{head}vary: {{inverter.device: {devices}}}\nset: {{operation.strategy: id0}}\n"
    )
    np.testing.assert_array_equal(both[1::2], set_word)


def test_words_put_together_are_those_of_the_whole_design() -> None:
    """Keys of combinations come from their axes one by one; a design read whole has the same."""
    study = catalogue.load("modules-and-modulators")
    inputs = row_inputs(study, 0, 1440)
    found = row_keys(study, inputs, OUTPUTS)
    assert len({bytes(key) for key in found}) == 1440
    for row in (0, 500, 1439):
        one = {key: column[row : row + 1] for key, column in inputs.items()}
        fresh = RowKeys(study, OUTPUTS)
        words = tuple(int(one[key][0]) for key in ("inverter.device", "losses.modulations"))
        whole = fresh._read(words)
        assert whole is not None
        fresh._resolved[(0, 0)] = whole
        np.testing.assert_array_equal(fresh.of(one)[0], found[row])


def test_zero_has_no_sign_and_rows_may_be_taken_alone() -> None:
    study = read(BASE)
    inputs = row_inputs(study, 0, 60)
    whole = row_keys(study, inputs, OUTPUTS)
    alone = row_keys(study, row_inputs(study, 17, 18), OUTPUTS)
    np.testing.assert_array_equal(alone[0], whole[17])
    zeros = [{**inputs, "machine.resistance": np.full(60, zero)} for zero in (0.0, -0.0)]
    one, other = (row_keys(study, each, OUTPUTS) for each in zeros)
    np.testing.assert_array_equal(one, other)


def test_keys_of_a_search_are_those_of_a_grid() -> None:
    study = read(BASE)
    inputs = row_inputs(study, 0, 60)
    order = np.random.default_rng(1).permutation(60)
    shuffled = {key: column[order] for key, column in inputs.items()}
    np.testing.assert_array_equal(
        row_keys(study, shuffled, OUTPUTS), row_keys(study, inputs, OUTPUTS)[order]
    )


def test_rows_that_no_design_may_have_have_keys() -> None:
    study = read(changed(("{range: {from: 60 kHz, to: 100 kHz, count: 3}}", "[1e12, 80 kHz]")))
    found = row_keys(study, row_inputs(study, 0, 40), OUTPUTS)
    assert len({bytes(key) for key in found}) == 40
