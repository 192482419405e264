"""Sampling drives without encoder: a drive of a method that the commit draws, and what counts as
broken.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import sensorless_samples
from benchmarks.sensorless_samples import (
    KEPT,
    METHODS,
    Course,
    Point,
    Row,
    Seen,
    accepted,
    drawn,
    gone,
    kind_of,
    main,
    plain,
    read,
    some_points,
    speed_gains,
    table,
)
from drawn_cases import turn

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.solution import Solution
from dqforge.reports.simulation.design_run import controller_files, observers_of
from dqforge.reports.simulation.recorded_run import simulator

# A Kalman filter takes ten times as long to tune as all others.
CHEAP = [method for method in METHODS if method != "ekf"]
SEEN = Seen(lost=False, early=False, swing=1e-4, wrong=1e-4, angle=5.0, lowest=100.0)


def test_a_drawn_drive_keeps_what_is_stated_or_is_refused_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of those whose runs are kept in the tree."""
    kept = min(
        (row for row in read(KEPT) if row.method in CHEAP),
        key=lambda row: turn(f"{row.method} {row.number}"),
    )
    path = tmp_path / "rows.json"
    words = ["--method", kept.method, "--first", str(kept.number), "--drives", "1"]
    assert main([*words, "--points", "5", "--rows", str(path)]) == 0
    (row,) = read(path)
    assert row.points == (0 if row.refused else 5)
    assert row.refused == kept.refused
    assert row.stated == pytest.approx(kept.stated, abs=5e-3)
    assert row.failures == []
    assert f"| {kept.method} | 1 |" in capsys.readouterr().out


def test_the_kept_runs_keep_what_is_stated() -> None:
    rows = read(KEPT)
    assert {row.method for row in rows} == set(METHODS)
    assert [row for row in rows if row.failures or row.lost or row.swings or row.wrong] == []
    assert len({(row.method, row.number) for row in rows}) == len(rows)


def test_rows_are_kept_in_place_of_those_of_their_method(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, tree = tmp_path / "rows.json", tmp_path / "tree.json"
    monkeypatch.setattr(sensorless_samples, "KEPT", tree)
    tree.write_text(plain([Row("ekf", 0, points=3), Row("flux", 7, refused="margin")]))
    path.write_text(plain([Row("flux", 0, points=2, angle=3.5)]))
    assert main(["--keep", str(path)]) == 0
    assert read(tree) == [Row("flux", 0, points=2, angle=3.5), Row("ekf", 0, points=3)]


def test_the_draw_follows_from_its_seed_alone() -> None:
    texts = [drawn(np.random.default_rng(seed), "flux") for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]
    for seed in range(30):
        design = load_text(drawn(np.random.default_rng(seed), "flux").encode(), "drawn.yaml")
        machine, loop = design.machine, design.control.speed_loop
        assert 2 <= machine.pole_pairs <= 10
        assert 1.0 <= machine.l_q / machine.l_d <= 2.51
        assert 5e3 <= design.inverter.f_sw <= 20e3
        assert design.control.tolerances is None
        assert loop is not None
        assert loop.counts_observer


def test_what_is_broken_is_counted_and_kept() -> None:
    point = Point("load", {"r_s": 0.3}, (100.0, 100.0), (0.0, 1.0, 0.0), 100.0)
    row = Row("flux", 0, stated=0.05)
    seen = (
        SEEN,
        replace(SEEN, wrong=0.0515),
        replace(SEEN, wrong=0.053),
        replace(SEEN, swing=0.0101),
        replace(SEEN, lost=True, swing=1.0, angle=170.0),
    )
    for place, each in enumerate(seen):
        row.take(place, point, each)
    assert (row.points, row.lost, row.swings, row.wrong) == (5, 1, 1, 1)
    assert [each["place"] for each in row.failures] == [2, 3, 4]
    assert row.angle == 5.0  # that of a rotor that was lost says nothing
    *_, line = table([row, Row("flux", 1, refused="margin")])
    assert line[:-1] == ("flux", "2", "1 (1 margin)", "5", "0", "1", "1", "1", "5")
    assert kind_of("x does not hold at all corners of y: holds from 1 to 2") == "not up to the top"


def _held() -> tuple[Design, Solution]:
    """A drive that is accepted."""
    text = drawn(np.random.default_rng([1, 0, 1]), "flux")
    design = load_text(text.encode(), "drawn.yaml")
    solved = accepted(design)
    assert isinstance(solved, Solution)
    return design, solved


def test_a_loop_that_is_not_judged_swings_in_the_samples() -> None:
    """The same drive with gains that its observer does not bear, judgement left out."""
    design, solved = _held()
    speed, found = speed_gains(solved)
    (point,) = some_points(np.random.default_rng(1), solved, found, 1)
    course = Course(0.5)

    def run(factor: float) -> Seen:
        fast = replace(speed, kp=factor * speed.kp, ki=factor**2 * speed.ki)
        gains = replace(solved, loops=replace(solved.gains, speed=fast))
        parts = (controller_files(gains), design.export.prefix, observers_of(gains)[1])
        with simulator(*parts) as program:
            return gone(program, design, point, course)

    assert run(8.0).breaks(found.binding.speed_error) in ("swings", "lost")


def test_a_refusal_is_no_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(design: Design) -> Solution:
        raise NoSolutionError("control.speed_loop: the speed loop is unstable at 100 rpm")

    monkeypatch.setattr(sensorless_samples, "solve", refuse)
    method: ObserverMethodName = "flux"
    row = sensorless_samples.sampled(method, 0, 3, 1)
    assert (row.refused, row.points) == ("unstable", 0)
