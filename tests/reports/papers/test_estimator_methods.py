"""Chapter 7 of paper 001 as a table: what the thesis says of every method, what is found."""

from __future__ import annotations

from math import isfinite, isnan

import pytest

from dqforge.reports.papers import paper001_tables as estimator_tables
from dqforge.reports.papers.paper001_bench_sensorless import (
    BENCH,
    CAUSES,
    INTEGERS,
    METHODS,
    MethodFound,
)
from dqforge.reports.papers.paper001_bench_transients import Reproduction


@pytest.mark.slow
def test_every_method_of_the_chapter_is_found_or_refused_with_its_reason(
    reproduced: Reproduction,
) -> None:
    rows = {row.stated.name: row for row in reproduced.methods}
    assert [row.stated for row in reproduced.methods] == list(METHODS)
    for name in ("injection", "inform", "inductance-mapping"):
        assert "1.08" in rows[name].refusal
    assert "third harmonic" in rows["third-harmonic"].refusal
    # Conduction is seen once a period, voltages have a line between them.
    assert rows["diode-conduction"].high_hz < rows["zero-crossing"].high_hz
    for row in reproduced.methods:
        assert row.refusal or (len(row.angle_deg) == 2 and len(row.slopes_deg) == len(CAUSES))
    # what the thesis says of the open-loop flux and of Matsui's current model does not hold here
    assert rows["open-loop-flux"].low_hz > rows["extended-emf"].low_hz
    dead_time = list(CAUSES).index("dead_time")
    current, voltage = rows["matsui-current"], rows["matsui-voltage"]
    assert abs(current.slopes_deg[dead_time]) > 10.0 * abs(voltage.slopes_deg[dead_time])
    # no error of a parameter is made good by the filter
    assert abs(rows["ekf"].slopes_deg[2]) > 3.0


@pytest.mark.slow
def test_figures_8_29_to_8_33_are_found_or_named(reproduced: Reproduction) -> None:
    rows = {row.numbers: row for row in reproduced.figures}
    assert list(rows) == [f"8.{number}" for number in range(29, 34)]
    assert [number for number, row in rows.items() if not row.found] == ["8.30"]
    values = {(n, q.name): q.value for n, row in rows.items() for q in row.found}
    assert values["8.29", "largest error of the estimate on the way"] < 15.0
    assert values["8.31", "apart"] == pytest.approx(60.0, abs=3.0)
    assert 2.0 < values["8.33", "mean"] < 5.0
    assert values["8.33", "mechanical, mean"] == pytest.approx(values["8.33", "mean"] / 3.0)
    # the words of the program change little of what float32 has
    errors = {row.name: row for row in reproduced.estimator}
    single, words = errors[BENCH], errors[INTEGERS]
    assert words.speed_error == pytest.approx(single.speed_error, abs=1e-3)
    assert words.angle_error == pytest.approx(single.angle_error, abs=1e-3)
    turn = 60e3 / 3.0 / values["8.31", "measured"]
    assert values["8.32", "electrical turn"] == pytest.approx(turn, rel=1e-3)


def test_a_method_is_named_once_and_known_here() -> None:
    names = [row.name for row in METHODS if row.name]
    assert len(set(names)) == len(names)
    assert {"extended-emf", "reduced-order", "ekf", "third-harmonic"} <= set(names)


def test_rows_of_the_table() -> None:
    held = MethodFound(METHODS[0], "", 18.2, 271.0, (1.2, float("inf")), 0.1, (0.1, 0.5, 0.0, 0.9))
    refused = MethodFound(METHODS[6], "third-harmonic needs a third harmonic; write another")
    first, second = estimator_tables.methods_table((held, refused)).rows
    assert first[3:6] == ("18.2 to 271 Hz", "1.2", "lost")
    assert second[3] == "no: needs a third harmonic"
    plain = estimator_tables.plain_methods((held, refused))
    assert isfinite(plain[0]["holds_Hz"][0])
    assert isnan(plain[1]["noise_deg"])
    assert plain[0]["slopes_deg"] == dict(zip(CAUSES, held.slopes_deg, strict=True))
    assert plain[1]["refusal"].endswith("write another")
