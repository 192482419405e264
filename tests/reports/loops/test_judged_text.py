"""The judgement of the currents of a phase machine in tables, report and JSON."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import Tolerances
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.reports.loops.capability import judged_tables
from dqforge.reports.loops.proven_text import (
    gains_tables,
    judged_lines,
    judged_sentence,
    judged_words,
    plain_gains,
)

DESIGN = catalogue.load("paper002-phase-waveforms")
SPLIT = replace(
    DESIGN,
    control=replace(DESIGN.control, tolerances=Tolerances(r_s=0.3)),
    inverter=replace(DESIGN.inverter, topology="split-capacitor", midpoint_capacitance=4e-3),
)


@pytest.fixture(scope="module")
def gains() -> GainSet:
    return solve_gains(SPLIT)


def test_the_terminal_shows_the_zero_sequence_and_the_radii(gains: GainSet) -> None:
    tables = {table.title: table for table in gains_tables(SPLIT, gains)}
    first = next(iter(tables.values()))
    assert [row[0] for row in first.rows] == ["i_d", "i_q", "i_0"]
    found = tables["Currents over a period of the back-EMF"]
    assert len(found.columns) == len(found.rows[0]) == 8
    assert [row[0] for row in found.rows] == ["0", "450", "900", "1350", "1800"]
    assert found.rows[0][1] == "at rest"
    assert found.rows[-1][5] == "r_s +30 %"
    assert found.rows[-1][6] == "-5, 7, -11, 13; zero sequence 3, 9"
    assert any("midpoint returns to 1/e in 4" in note or "in 5" in note for note in found.notes)
    assert [curve.gains.loop for curve in gains.responses()] == ["i_d", "i_q", "i_0"]
    plain = gains_tables(DESIGN, solve_gains(DESIGN))
    assert len(next(table for table in plain if table.title == found.title).columns) == 6


def test_report_and_summary_say_the_same(gains: GainSet) -> None:
    assert gains.phases is not None
    judged = gains.phases.judged
    assert judged is not None
    [table] = judged_tables(gains)
    assert len(table.rows) == 5
    assert judged.slowest.worst is not None
    value = f"{judged.slowest.worst.value:.4f}"
    assert value in judged_words(judged)
    assert value in judged_sentence(judged)
    assert " ".join(judged_lines(judged)) == judged_sentence(judged)


def test_json_has_every_figure(gains: GainSet) -> None:
    plain = plain_gains(SPLIT, gains)
    assert plain["i_0"]["kp"] == pytest.approx(gains.i_q.kp * 5.0 / 8.0)
    found = plain["currents"]
    assert found["radius"] == max(speed["worst"]["value"] for speed in found["speeds"])
    assert (found["frame"], found["corners"], found["inside"]) == ("table", 2, 0)
    assert found["midpoint_time_s"] == pytest.approx(0.05, rel=0.05)
    still, *_, last = found["speeds"]
    assert still["samples_per_period"] is None
    assert last["worst"]["at"] == "r_s +30 %"
    assert last["orders"] == {"plane": [-5, 7, -11, 13], "zero": [3, 9]}
    sine = catalogue.load("paper001-pmsm-bench")
    assert not {"i_0", "currents"} & set(plain_gains(sine, solve_gains(sine)))
