"""What is read off the answer to a step, on answers whose course is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dqforge.reports.firmware.target import Outcome, step_answer

TIME = np.linspace(0.0, 1.0, 2001)


@pytest.mark.parametrize(
    ("value", "outcome"),
    [
        (2.0 + 8.0 * -np.expm1(-TIME / 0.05), "settles"),
        (10.0 + 0.2 * np.sin(80.0 * TIME), "settles"),  # within the band of 0.4
        (10.0 + 3.0 * np.sin(80.0 * TIME), "limit cycle"),
        (10.0 + np.exp(3.0 * TIME) * np.sin(80.0 * TIME), "limit cycle"),
        (10.0 + 6.0 * np.exp(-2.0 * TIME) * np.sin(80.0 * TIME), "never reaches"),
        (2.0 + 8.0 * -np.expm1(-TIME / 1.0), "never reaches"),
        (2.0 + 7.0 * -np.expm1(-TIME / 0.05), "steady error"),
        (np.full(TIME.size, 2.0), "steady error"),
    ],
)
def test_names_what_happened(value: np.ndarray, outcome: Outcome) -> None:
    assert step_answer(TIME, value, 2.0, 10.0).outcome == outcome


def test_settling_is_when_the_band_is_entered_for_good() -> None:
    found = step_answer(TIME, 2.0 + 8.0 * -np.expm1(-TIME / 0.05), 2.0, 10.0)
    assert found.settling == pytest.approx(0.05 * math.log(20.0), abs=1e-3)


def test_a_limit_cycle_has_its_ends_and_its_period() -> None:
    found = step_answer(TIME, 10.0 + 3.0 * np.sin(80.0 * TIME), 2.0, 10.0)
    assert (found.lowest, found.highest) == pytest.approx((7.0, 13.0), abs=1e-2)
    assert found.period == pytest.approx(2.0 * math.pi / 80.0, rel=0.01)


def test_a_steady_error_has_its_mean() -> None:
    found = step_answer(TIME, 2.0 + 7.0 * -np.expm1(-TIME / 0.05), 2.0, 10.0)
    assert found.mean == pytest.approx(9.0, abs=1e-3)


def test_the_span_of_another_quantity_can_be_the_measure() -> None:
    value = np.full(TIME.size, 0.3)
    assert step_answer(TIME, value, 0.0, 0.0, span=10.0).outcome == "settles"
    assert step_answer(TIME, value, 0.0, 0.0, span=5.0).outcome == "steady error"


def test_a_run_that_ended_early_diverges_whatever_its_last_values() -> None:
    value = np.full(TIME.size, 10.0)
    assert step_answer(TIME, value, 2.0, 10.0, bounded=False).outcome == "divergence"
    none = step_answer(TIME[:3], np.array([0.0, np.nan, np.inf]), 2.0, 10.0)
    assert none.outcome == "divergence"
