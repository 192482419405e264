"""Voltage errors of inverters whose law is known."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.optimizer.identification.inverter_curve import (
    InverterTable,
    analyse_table,
    table_fault,
)
from dqforge.optimizer.identification.parameters import Analysis


def measured(shape: str, noise: float) -> Analysis:
    """Forty points up to 3.15 A, as of an inverter at 180 V."""
    current = np.linspace(-3.15, 3.15, 40)
    bent = np.tanh(current / 0.4) if shape == "tanh" else 2.0 / np.pi * np.arctan(current / 0.2)
    rng = np.random.default_rng(2)
    voltage = 4.2 * bent + 0.1 * current + rng.normal(0.0, noise, 40)
    return analyse_table(InverterTable("table", current, voltage))


@pytest.mark.parametrize("shape", ["tanh", "2/pi atan"])
def test_the_law_is_found_and_beats_the_sign(shape: str) -> None:
    analysis = measured(shape, 0.05)
    size = analysis.of("inverter_voltage")
    assert size is not None
    assert size.status == "identified"
    assert size.low <= 4.2 <= size.high
    (left,) = analysis.residuals
    assert left.rms < 0.07
    assert f"V0 {shape}(i/width)" in analysis.terms[0]


def test_a_shape_that_no_law_has_is_a_table() -> None:
    current = np.linspace(-3.0, 3.0, 61)
    voltage = 4.0 * np.tanh(current / 0.4) + 0.6 * np.sin(3.0 * current)
    analysis = analyse_table(InverterTable("table", current, voltage))
    assert "the table itself is taken" in analysis.remarks[0]


def test_dead_time_is_not_separable_at_one_voltage() -> None:
    dead = measured("tanh", 0.05).of("dead_time")
    assert dead is not None
    assert dead.status == "not identified"
    assert "not separable from the drop" in dead.why


def test_few_points() -> None:
    assert "3 points" in table_fault(InverterTable("table", np.arange(3.0), np.arange(3.0)))
