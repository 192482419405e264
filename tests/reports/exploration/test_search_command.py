"""`dqforge explore` with a search: its lines, its folder, and the front that it finds."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from explore_calls import Call, explore_call
from pyarrow import parquet
from searched_rows import FRONT, ONE_GOAL
from study_runs import parts_hash, rows_there

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.exploration import study_checks as catalogue
from dqforge.machines.exploration.study_checks import study_of_text
from dqforge.reports.exploration.part_store import PartStore


@pytest.fixture
def call(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Call:
    """The command in a folder with two studies, in one process: exit code and what it printed."""
    monkeypatch.chdir(tmp_path)
    Path("front.yaml").write_text(FRONT, encoding="utf-8")
    Path("one.yaml").write_text(ONE_GOAL, encoding="utf-8")

    return explore_call(capsys)


def test_a_search_is_estimated_limited_finished_and_looked_into(call: Call) -> None:
    code, out, _ = call("front.yaml", "--dry-run")
    assert code == 0
    assert "32 rows in 16 parts of 2, 4 generations of 8 rows" in out
    assert "(from 8 rows)" in out
    assert "last row" not in out
    estimate = json.loads(call("front.yaml", "--dry-run", "--json")[1])["study"]
    assert (estimate["rows"], estimate["generations"], estimate["population"]) == (32, 4, 8)
    assert not Path("out").exists()
    code, out, _ = call("front.yaml", "--workers", 1, "--limit", 9)
    assert (code, "10 of 32 rows" in out) == (0, True)
    assert rows_there(Path("out/front")) == list(range(10))
    code, out, err = call("front.yaml", "--workers", 1)
    assert (code, err) == (0, "")
    assert "computed now: 22 rows" in out
    assert re.search(r"Front of \d+ rows", out)
    before = parts_hash(Path("out/front"))
    plain = json.loads(call("front.yaml", "--json")[1])["study"]
    assert plain["states"]["ok"] + plain["states"]["limit"] == 32
    assert (
        plain == json.loads(call("front.yaml", "--restart", "--workers", 1, "--json")[1])["study"]
    )
    assert parts_hash(Path("out/front")) == before
    assert Path("out/front/report.html").read_text(encoding="utf-8").count("Front") > 0
    code, out, _ = call("out/front", "--table", "machine.resistance", "--first", 3)
    assert (code, "Ohm" in out) == (0, True)


def test_the_winner_of_a_search_is_the_design_of_its_stored_inputs(call: Call) -> None:
    assert call("one.yaml", "--workers", 1, "-o", "one")[0] == 0
    code, out, err = call("one", "--export", "front")
    assert (code, err) == (0, "")
    table = parquet.read_table("one/front.parquet").to_pylist()
    assert len(table) == 1
    (row,) = table
    folder = Path(f"one/winners/row-{row['index']:06d}")
    assert str(folder) in out
    design = load_design(folder / "dqforge-input" / "design.yaml")
    assert design.machine.r_s == row["in.machine.resistance"]
    assert design.machine.l_q == row["in.machine.inductance_q"]
    assert 2e-3 < design.machine.l_q < 8e-3  # between the two steps of a grid
    loop = json.loads((folder / "result.json").read_bytes())["gains"]["i_q"]
    assert loop["crossover_rad_per_s"] == pytest.approx(row["out.gains.i_q.crossover"], rel=1e-8)


def test_what_a_search_cannot_do_is_one_line(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call("front.yaml", "--workers", 1, "-o", "there", "--limit", 2)[0] == 0
    code, _, err = call("front.yaml", "--reuse", "there")
    assert (code, "--reuse: a search computes all rows that it chooses" in err) == (2, True)
    monkeypatch.setitem(sys.modules, "pymoo.algorithms.moo.nsga2", None)
    code, _, err = call("front.yaml", "-o", "nowhere")
    assert (code, "pip install 'dqforge[explore]'" in err) == (2, True)
    assert not Path("nowhere").exists()


THINNED = """\
dqforge_study: 1
name: Modules and modulators, thinned
design: paper000-ipmsm-100kw
vary:
  inverter.device: [{name: fuji-2mbi300xbe120-50}, {name: infineon-ff200r12ke3},
                    {name: mitsubishi-cm200dy-24t}, {name: sirectifier-sii400s12}]
  inverter.switching_frequency: CARRIERS
  losses.modulations: [[gdpwm], [svpwm], [dpwm1], [dpwm3]]
set:
  control.sampling_frequency: 16 kHz
  losses.points:
    - {torque: 40 N m, speed: 450 rad/s, weight: 60 %}
    - {torque: 130 N m, speed: 300 rad/s, weight: 30 %}
    - {torque: 180 N m, speed: 200 rad/s, weight: 10 %}
outputs: [losses.total]
limits: {losses.ripple_current: 6 A, losses.junction_temperature: 150 degC}
pareto: {minimise: [losses.total, losses.ripple_current]}
"""
GOALS = ("out.losses.total", "out.losses.ripple_current")


def listed(carriers: np.ndarray) -> str:
    return f"[{', '.join(f'{float(value)!r} Hz' for value in carriers)}]"


def front_and_rows(folder: Path) -> tuple[np.ndarray, int]:
    """Goals of the front, the smallest first, and the number of different rows."""
    table = parquet.read_table(folder / "front.parquet", columns=list(GOALS))
    goals = np.column_stack([table[name].to_numpy() for name in GOALS])
    keys = [part.keys for part in PartStore.existing(folder).read(["key"])]
    return goals[np.lexsort(goals.T[::-1])], len(np.unique(np.concatenate(keys), axis=0))


def check_fronts(call: Call, grid: str, search: str) -> tuple[int, int, int]:
    """Run both; the search finds the front of the grid. Sizes of the front and of both."""
    Path("grid.yaml").write_text(grid, encoding="utf-8")
    Path("searched.yaml").write_text(grid + search, encoding="utf-8")
    for name in ("grid", "searched"):
        assert call(f"{name}.yaml", "--workers", 1)[0] == 0
    expected, whole = front_and_rows(Path("out/grid"))
    found, tried = front_and_rows(Path("out/searched"))
    assert found == pytest.approx(expected, rel=1e-12)
    return len(expected), whole, tried


def test_a_search_finds_the_front_of_a_small_grid(call: Call) -> None:
    grid = THINNED.replace("CARRIERS", listed(np.geomspace(8e3, 1e5, 20)[::2]))
    search = "search: {population: 20, generations: 8, seed: 4}\n"
    front, whole, tried = check_fronts(call, grid, search)
    assert (front, whole) == (10, 160)
    assert tried < 0.72 * whole


@pytest.mark.slow
def test_a_search_finds_the_front_of_the_shipped_grid(call: Call) -> None:
    text = catalogue.read_text("modules-and-modulators").decode()
    carriers = listed(np.geomspace(8e3, 1e5, 20))
    grid, count = re.subn(r"\{range: \{from: 8 kHz.*\}\}", carriers, text)
    assert count == 1
    search = "search: {population: 40, generations: 30, seed: 5}\n"
    front, whole, tried = check_fronts(call, f"{grid}outputs: [losses.total]\n", search)
    assert (front, whole) == (20, 1440)
    assert tried < 0.55 * whole


def shipped(generations: int) -> str:
    text = catalogue.read_text("magnets-and-inductances").decode()
    assert "population: 64, generations: 16" in text
    return text.replace("generations: 16", f"generations: {generations}")


def test_the_shipped_search_begins_as_it_says(call: Call) -> None:
    study = study_of_text(shipped(2).encode(), "study.yaml")
    assert [axis.continuous for axis in study.axes] == [True, True, True]
    Path("magnets.yaml").write_text(shipped(2), encoding="utf-8")
    code, out, _ = call("magnets.yaml", "--workers", 1)
    assert (code, "128 of 128 rows" in out) == (0, True)
    names = [f"in.{axis.keys[0]}" for axis in study.axes]
    for part in PartStore.existing(Path("out/magnets")).read(names):
        for name, axis in zip(names, study.axes, strict=True):
            assert np.all(part.columns[name] >= axis.numbers[0][0])
            assert np.all(part.columns[name] <= axis.numbers[-1][0])


@pytest.mark.slow
def test_between_the_steps_of_a_grid_the_shipped_search_finds_better_drives(call: Call) -> None:
    """As many rows each: 16 generations of 64, and 10 x 10 x 10 steps."""
    Path("magnets.yaml").write_text(shipped(16), encoding="utf-8")
    Path("steps.yaml").write_text(shipped(16).partition("search:")[0], encoding="utf-8")
    fronts = []
    for name in ("magnets", "steps"):
        assert call(f"{name}.yaml", "--workers", 1)[0] == 0
        table = parquet.read_table(f"out/{name}/front.parquet")
        loss = table["out.losses.total"].to_numpy()
        fronts.append((loss, table["out.reference.torque_max"].to_numpy()))
    levels = np.linspace(275.0, 300.0, 101)
    searched, steps = (
        np.mean([np.min(loss[torque >= level]) for level in levels]) for loss, torque in fronts
    )
    assert len(fronts[0][0]) > 4 * len(fronts[1][0])
    assert searched < steps - 2.0
