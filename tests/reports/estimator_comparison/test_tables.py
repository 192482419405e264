"""The comparison as it is printed, drawn, written and costed."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import RELUCTANCE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError, VerificationError
from dqforge.optimizer.estimator_comparison.compared import estimators
from dqforge.optimizer.estimator_comparison.solve import (
    EstimatorComparison,
    compare_estimators,
)
from dqforge.optimizer.observers.methods import ekf as ekf_method
from dqforge.optimizer.observers.methods.ekf import ekf, ekf_gains
from dqforge.reports.answers.estimators import answer_estimators, pair_files, which_estimators
from dqforge.reports.estimator_comparison import observer_errors as counted_cost
from dqforge.reports.estimator_comparison.observer_errors import (
    estimator_tables,
    pair_lines,
    plain_comparison,
    steady_rows,
    with_cost,
)
from dqforge.reports.observers.position_header import observer_files
from dqforge.reports.pages.figures_style import save
from dqforge.reports.pages.templating import to_text

BENCH = "paper001-pmsm-bench"


@pytest.fixture(scope="module")
def bench() -> EstimatorComparison:
    chosen = [c for c in estimators() if c.name in {"reduced-order", "extended-emf", "flux"}]
    return with_cost(compare_estimators(catalogue.load(BENCH), candidates=chosen))


def test_tables_show_the_figures(bench: EstimatorComparison) -> None:
    main, sensitive, won, starts, refused = estimator_tables(catalogue.load(BENCH), bench)
    assert [line[0] for line in main.rows] == ["extended-emf", "flux"]
    assert [line[-1] for line in main.rows] == ["flash this", ""]
    figures = bench.estimator("flux").figures
    assert figures is not None
    worst = np.degrees(np.max(figures.angle[-1][bench.asked.reached[-1]]))
    assert main.rows[1][4] == f"{worst:.3g}"
    assert main.rows[1][2] == "lost"
    assert len(sensitive.rows) == 2
    assert len(won.rows) == len(bench.asked.omega)
    assert won.rows[-1][2:] == ("-",) * 5
    assert refused.rows[0] == (
        "reduced-order",
        "it observes the speed alone, in the angle of an encoder",
    )
    begun = {row.candidate.name: row.figures for row in bench.starts}
    assert [line[0] for line in starts.rows] == [name for name in begun if begun[name]]
    assert {line[0] for line in refused.rows[1:]} == {name for name in begun if not begun[name]}
    assert main.notes[0].startswith("flash extended-emf at speed")


def test_plain_data_are_json_and_hold_the_same(bench: EstimatorComparison) -> None:
    plain = json.loads(to_text("estimators", "x", {"estimators": plain_comparison(bench)}))
    found = plain["estimators"]
    by_name = {entry["name"]: entry for entry in found["candidates"]}
    flux = bench.estimator("flux").figures
    assert flux is not None
    assert by_name["flux"]["angle_rad"][0] == [None] * 5  # lost at standstill
    assert by_name["flux"]["angle_rad"][-1] == pytest.approx(flux.angle[-1].tolist(), rel=1e-6)
    assert by_name["reduced-order"]["refusal"]
    assert found["winner"][0] == [None] * 5
    assert found["winner"][-1][2] == "extended-emf"
    assert found["pair"]["at_speed"] == "extended-emf"
    assert len(by_name["flux"]["capture"]["outcome"]) == 4


def test_a_step_costs_what_its_instructions_are(bench: EstimatorComparison) -> None:
    """Within what docs/reference/control-cost.md has of another machine and rougher inputs."""
    if bench.uncounted:
        pytest.skip(bench.uncounted)
    flux, emf = bench.estimator("flux"), bench.estimator("extended-emf")
    assert flux.instructions == pytest.approx(170, rel=0.1)
    assert emf.instructions == pytest.approx(241, rel=0.1)
    assert (flux.flash, emf.flash) == pytest.approx((1344, 1612), rel=0.05)
    assert flux.cycles is not None
    assert flux.instructions is not None
    assert flux.instructions < flux.cycles[0] < flux.cycles[1]
    assert bench.estimator("reduced-order").cycles is None


def test_without_the_tools_the_comparison_says_so(
    bench: EstimatorComparison, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(*_: Any) -> Any:
        raise VerificationError("arm-none-eabi-gcc is missing: install the Debian package")

    monkeypatch.setattr(counted_cost, "cost_of_calls", missing)
    found = with_cost(replace(bench, uncounted="not yet"))
    assert found.uncounted.startswith("arm-none-eabi-gcc is missing")
    notes = estimator_tables(catalogue.load(BENCH), found)[0].notes
    assert any(note.startswith("no cycles: arm-none-eabi-gcc") for note in notes)


def test_the_samples_of_the_cost_are_those_of_a_steady_drive(bench: EstimatorComparison) -> None:
    design = bench.asked.design
    rows = steady_rows(design, 500.0).astype(float)
    machine = linearised(design.machine)
    assert np.hypot(rows[:, 2], rows[:, 3]) == pytest.approx(0.5 * machine.i_max)
    power = 1.5 * np.sum(rows[:, :2] * rows[:, 2:], axis=1)
    i_q = 0.5 * machine.i_max
    assert power == pytest.approx(1.5 * (machine.r_s * i_q**2 + 500.0 * machine.psi_pm * i_q))


def test_the_pair_is_written_as_the_designs_own_header(bench: EstimatorComparison) -> None:
    design = catalogue.load(BENCH)
    files = pair_files(design, replace(bench, pair=replace(bench.pair, start=None)))
    figures = bench.estimator("extended-emf").figures
    assert figures is not None
    assert figures.observer is not None
    assert files == observer_files(design, figures.observer)
    assert list(files) == ["bench001_observer.h"]


@pytest.mark.slow
def test_the_pair_with_its_start_compiles_as_one(tmp_path: Path) -> None:
    """Control, both estimators and the state machine, with the hand-over of the pair."""
    design = catalogue.load("abb-ipmsm-2k2")
    chosen = [c for c in estimators() if c.name in {"extended-emf", "injection"}]
    found = compare_estimators(design, chosen)
    files = pair_files(design, found)
    assert {"abb2k2_observer.h", "abb2k2_start_observer.h", "abb2k2_startup.h"} <= set(files)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    lines = ['#include "abb2k2_startup.h"', "int main(void) { return 0; }", ""]
    (tmp_path / "all.c").write_text("\n".join(lines))
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "all.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert found.pair.up is not None
    assert f"{found.pair.up / (2.0 * np.pi):.4g} Hz" in files["abb2k2_startup.h"].decode()
    keys = found.pair.start, found.pair.from_standstill, found.pair.at_speed
    assert keys == ("saliency", "injection", "extended-emf")


@pytest.mark.slow
def test_starts_are_tried_with_the_emitted_c_where_they_are_asked_for() -> None:
    """Two starts of each kind against no load and 30 %: all of them, by name and number."""
    design = catalogue.load("abb-ipmsm-2k2")
    found = which_estimators(design, "extended-emf,injection", 2)
    tried = {row.candidate.name: row.figures.tried for row in found.starts if row.figures}
    assert set(tried) >= {"i-f", "saliency"}
    for rates in tried.values():
        assert [(rate.load, rate.count) for rate in rates] == [(0.0, 2), (0.3, 2)]
    plain = {entry["name"]: entry for entry in plain_comparison(found)["starts"]}
    assert plain["i-f"]["success"] == min(rate.rate for rate in tried["i-f"])
    assert plain["i-f"]["tried"][1]["succeeded"] == tried["i-f"][1].succeeded


def test_wrong_options_are_told_in_one_line() -> None:
    design = catalogue.load(BENCH)
    with pytest.raises(InputError, match="--starts must lie between 0 and 1000, got 1001"):
        which_estimators(design, starts=1001)
    with pytest.raises(InputError, match="--only: no estimator is named flax; write some of"):
        which_estimators(design, "flux, flax")
    with pytest.raises(InputError, match="--only: no estimator is named nothing"):
        which_estimators(design, " , ")


def test_where_nothing_holds_there_is_no_pair() -> None:
    """A machine without magnet and with hardly any saliency."""
    design = make_design(replace(RELUCTANCE, l_q=0.95 * RELUCTANCE.l_d))
    answer = answer_estimators(design, write=False)
    assert answer.tables[0].notes == (
        "flash none of these: no estimator holds at any speed and load of this drive",
    )
    assert answer.files is None
    with pytest.raises(NoSolutionError, match="there is no pair to write"):
        answer_estimators(design, write=True)


def test_the_figure_is_the_same_bytes_every_time(
    bench: EstimatorComparison, tmp_path: Path
) -> None:
    from dqforge.reports.answers.estimators import plot_comparison

    for name in ("a.svg", "b.svg"):
        save(plot_comparison(bench), tmp_path / name)
    first = (tmp_path / "a.svg").read_bytes()
    assert first == (tmp_path / "b.svg").read_bytes()
    assert b"extended-emf" in first
    assert b"beyond the voltage" not in first


@pytest.mark.slow
def test_the_whole_answer_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every estimator of today, the same both times."""
    monkeypatch.setattr(
        ekf_method, "_consistent", lambda m, t_s, top: ekf_gains(ekf(m, t_s, 1e-2, 1e5, 1e-5, top))
    )
    design = catalogue.load("abb-ipmsm-2k2")
    first, second = (answer_estimators(design, write=True) for _ in range(2))
    assert to_text("estimators", "x", first.plain) == to_text("estimators", "x", second.plain)
    assert first.tables == second.tables
    assert first.files is not None
    assert second.files is not None
    assert first.files.contents == second.files.contents


def test_an_estimator_from_standstill_alone_is_advised_as_such(
    bench: EstimatorComparison,
) -> None:
    alone = replace(bench.pair, at_speed=None, from_standstill="injection", start=None, held=0.75)
    (line,) = pair_lines(bench.asked, alone)
    assert line.startswith("flash injection: it holds in 75 %")


@pytest.mark.parametrize("hand_over", [None, 200.0])
def test_the_advised_keys_are_those_of_a_design(
    bench: EstimatorComparison, hand_over: float | None
) -> None:
    """What stands behind 'write' is a design that loads, with a speed of the hand-over or none."""
    pair = replace(bench.pair, start="i-f", from_standstill=None, up=hand_over, down=hand_over)
    (told,) = [line for line in pair_lines(bench.asked, pair) if line.startswith("write ")]
    keys = told.removeprefix("write ").split(" and ")
    settings = [key.replace(": ", "=", 1) for key in keys]
    made = catalogue.load(BENCH, ["export.control=float32", *settings])
    start = made.control.start_up
    assert start is not None
    assert (start.hand_over is None) == (hand_over is None)
