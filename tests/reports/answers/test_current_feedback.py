"""What check, tune, losses, simulate and run answer for such a design."""

from __future__ import annotations

import json

import pytest
from current_feedback_design import feedback_design

from dqforge.machines.errors import InputError
from dqforge.optimizer.current_feedback.regulator_runs import METHODS
from dqforge.reports.answers.check import answer_check
from dqforge.reports.answers.current_feedback import answer_regulator
from dqforge.reports.answers.losses import LossRequest, answer_losses
from dqforge.reports.answers.tune import answer_tune
from dqforge.reports.pages.templating import to_text
from dqforge.reports.run import run_design


def test_check_lists_the_computed_numbers_and_refuses_what_a_run_would() -> None:
    tables = answer_check(feedback_design("circle")).tables
    rows = {row[0]: row[1] for row in tables[-1].rows}
    assert rows["regulator"] == "circle"
    assert rows["radius"] == "4.167 A"
    with pytest.raises(InputError, match="less than the band"):
        answer_check(feedback_design("look-up-table", "control.current_loop.outer_band=0.1 A"))


def test_simulate_runs_the_regulator_at_the_loads() -> None:
    answer = answer_regulator(feedback_design("predictive"))
    (row,) = answer.tables[0].rows
    assert row[:2] == ("predictive", "4000")
    plain = json.loads(to_text("simulate", "feedback", answer.plain))["current_feedback"]
    (found,) = plain["simulated"]
    assert found["obstacle"] is None
    assert float(row[2]) == pytest.approx(found["frequency_Hz"] / 1e3, abs=0.01)
    assert found["input_W"] - found["total_W"] - found["shaft_W"] == pytest.approx(
        found["stored_W"], abs=1e-6
    )
    assert answer.figure is not None
    assert answer.figure().axes


@pytest.mark.slow
def test_tune_and_losses_compare_all_regulators() -> None:
    design = feedback_design("circle")
    tuned = answer_tune(design)
    own, compared = tuned.tables
    assert {"speed loop", "switching frequency", "error"} <= {row[0] for row in own.rows}
    assert {row[0] for row in compared.rows} == {
        "hysteresis", "ramp-comparison", "look-up-table", "circle", "predictive", "trajectory",
    }  # fmt: skip
    lost = answer_losses(design, LossRequest(), choice=False)
    assert {row[0] for row in lost.tables[-1].rows} == {*METHODS, "svpwm"}
    assert len(lost.plain["current_feedback"]["closed"]) == len(METHODS) + 1
    rows = {row[0]: row for row in lost.tables[-2].rows}
    assert {"circle", "trajectory", "svpwm", "ddt-gdpwm"} <= set(rows)
    assert rows["circle"][1] == rows["svpwm"][1]
    assert rows["circle"][-1] == "chosen"
    assert "losses" in lost.plain
    assert "current_feedback" in lost.plain


@pytest.mark.slow
def test_a_run_writes_report_and_result() -> None:
    output = run_design(feedback_design("hysteresis"), verify=True)
    result = json.loads(output.files["result.json"])
    assert result["current_feedback"]["regulator"]["method"] == "hysteresis"
    assert "switches the bridge itself" in result["gains_left_out"]
    assert b"Current-feedback PWM" in output.files["report.html"]
    assert b"FB_FEEDBACK_BAND_A" in output.files["fb_current_feedback.h"]
