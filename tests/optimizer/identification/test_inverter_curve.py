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
    # Linear least squares at the true width and its neighbourhood, by finite differences.
    current, width = np.linspace(-3.15, 3.15, 40), analysis.of("inverter_width")
    assert width is not None
    assert width.value == pytest.approx(0.4 if shape == "tanh" else 0.2, rel=0.15)

    def law(size: float, width: float, series: float) -> np.ndarray:
        form = np.tanh if shape == "tanh" else lambda x: 2.0 / np.pi * np.arctan(x)
        return np.asarray(size * form(current / width) + series * current)

    series = analysis.of("inverter_resistance")
    assert series is not None
    assert series.value == pytest.approx(0.1, abs=2.5 * series.sigma)
    best = np.array([size.value, width.value, series.value])
    columns = np.column_stack(
        [(law(*(best + h)) - law(*(best - h))) / 2e-5 for h in 1e-5 * np.eye(3)]
    )
    sigmas = left.rms * np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    found = [size.sigma, width.sigma, series.sigma]
    np.testing.assert_allclose(found, sigmas, rtol=0.5)
    assert f"V0 {shape}(i/width)" in analysis.terms[0]


def test_a_shape_that_no_law_has_is_a_table() -> None:
    current = np.linspace(-3.0, 3.0, 61)
    voltage = 4.0 * np.tanh(current / 0.4) + 0.6 * np.sin(3.0 * current)
    analysis = analyse_table(InverterTable("table", current, voltage))
    assert "the table itself is taken" in analysis.remarks[0]
    order = np.argsort(-np.abs(np.sin(9.0 * current)))
    shuffled = analyse_table(InverterTable("table", current[order], voltage[order]))
    # Even spacing: a point between its neighbours lies off their mean.
    gap = voltage[1:-1] - 0.5 * (voltage[:-2] + voltage[2:])
    rms = f"a table {1e3 * float(np.linalg.norm(gap)) / np.sqrt(gap.size):.3g} mV"
    assert rms in analysis.remarks[0]
    assert shuffled.remarks == analysis.remarks


def test_dead_time_is_not_separable_at_one_voltage() -> None:
    dead = measured("tanh", 0.05).of("dead_time")
    assert dead is not None
    assert dead.status == "not identified"
    assert "not separable from the drop" in dead.why


def test_few_points() -> None:
    assert "3 points" in table_fault(InverterTable("table", np.arange(3.0), np.arange(3.0)))
