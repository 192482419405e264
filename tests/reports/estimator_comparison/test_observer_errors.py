"""Warm machines and starts as tables and JSON of `dqforge tune`."""

from __future__ import annotations

import json

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.estimator_comparison.candidate import ObserverEvidence, observer_evidence
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.reports.answers.tune import answer_tune
from dqforge.reports.pages.templating import to_text
from dqforge.reports.session.result import tune


def design_with(method: ObserverMethodName) -> Design:
    """The speed loop leaves its spread open, so that it is chosen with the observer."""
    text = catalogue.template().decode()
    assert text.count("    pole: 400 rad/s") == text.count("    spread: 3\n") == 1
    made = text.replace("    pole: 400 rad/s", f"    method: {method}").replace(
        "    spread: 3\n", ""
    )
    return load_text(made.encode(), "d.yaml")


@pytest.mark.slow
def test_tune_shows_warm_machines_and_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[ObserverEvidence | None] = []

    def found_once(design: Design, observer: PositionObserver | None) -> ObserverEvidence | None:
        kept.append(observer_evidence(design, observer))
        return kept[-1]

    monkeypatch.setattr(
        "dqforge.optimizer.estimator_comparison.candidate.observer_evidence", found_once
    )
    answer = answer_tune(design_with("matsui-current"))
    warm = next(table for table in answer.tables if "warm machine" in table.title)
    starts = next(table for table in answer.tables if "it locks" in table.title)
    (found,) = kept
    assert found is not None
    errors = found.warm
    hot, cells = len(errors.states) - 1, warm.rows[0][2:]
    assert warm.rows[0][:2] == ("+80 K, +40 K", f"{errors.omega[0] / (2.0 * np.pi):.4g}")
    angle, speed = errors.angle[hot, -1, 0], errors.speed[hot, -1, 0]
    assert cells[-1] == f"{np.degrees(angle):+.3g}, {100.0 * speed / errors.omega[0]:+.2g} %"
    assert "R +31.4 %, psi -4.4 %" in warm.notes[0]
    assert len(starts.rows) == len(found.capture.omega)
    assert starts.rows[0][3] == f"{100.0 * found.capture.share[0]:.0f}"
    plain = json.loads(to_text("tune", "x", answer.plain))
    assert plain["observer_warm"]["states"][hot]["r_s"] == pytest.approx(0.3144)
    assert np.shape(plain["observer_capture"]["outcome"]) == found.capture.outcome.shape


@pytest.mark.slow
def test_a_session_finds_what_the_command_shows() -> None:
    design = design_with("matsui-current")
    session, command = tune(design).plain(), answer_tune(design).plain
    for key in ("observer_warm", "observer_capture"):
        assert to_text("tune", "x", {key: session[key]}) == to_text(
            "tune", "x", {key: command[key]}
        )


def test_tune_with_an_encoder_says_nothing_of_either() -> None:
    answer = answer_tune(catalogue.load("paper001-pmsm-bench"))
    assert not [table for table in answer.tables if "warm" in table.title]
    assert not {"observer_warm", "observer_capture"} & set(answer.plain)
