"""Losses and junction temperature over time, from a run that is written down here."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.reports.papers import paper000_whole_paper as heat
from dqforge.reports.papers import paper000_whole_paper as method_tables
from dqforge.reports.papers.paper000_load_test import ALTERNATIVES, LoadTest
from dqforge.reports.papers.paper000_stated_method import PRINTED_TABLE_4


def test_a_step_of_loss_warms_as_one_resistance_and_one_capacity() -> None:
    time = np.linspace(0.0, 2.0, 401)
    found = heat.warmed(time, np.full(time.size, 100.0), 0.05, 64.0, 0.1)
    assert found == pytest.approx(64.0 + 5.0 * (1.0 - np.exp(-time / 0.1)), abs=1e-9)


def _resting(name: str, i_d: float, i_q: float) -> LoadTest:
    """A run that rests at 130 N m from 4 s on, without any current before."""
    time = np.linspace(0.0, 6.0, 6001)
    on = time >= 4.0
    run: Any = SimpleNamespace(
        t=time, i_d=i_d * on, i_q=i_q * on, omega_m=np.full(time.size, 300.0)
    )
    return LoadTest(name, run, 0.0, 0.0, 130.0, float(np.hypot(i_d, i_q)), 0.0)


@pytest.fixture(scope="module")
def curves() -> tuple[heat.HeatCurve, ...]:
    i_d = np.linspace(-90.0, -40.0, 50_001)
    i_q = 130.0 / (6.0 * (0.1049 + 242e-6 * -i_d))
    best = int(np.argmin(i_d**2 + i_q**2))
    points = [(0.0, 130.0 / (6.0 * 0.1049)), *[(float(i_d[best]), float(i_q[best]))] * 2]
    tests = [_resting(ALTERNATIVES[k][0], *point) for k, point in enumerate(points)]
    return heat.heat_curves(catalogue.load("paper000-ipmsm-100kw"), tests)


def test_the_end_is_table_4(curves: tuple[heat.HeatCurve, ...]) -> None:
    for curve, total in zip(curves, (1064.0, 932.9, 781.2), strict=True):
        assert curve.total == pytest.approx(total, abs=0.3)
        assert curve.junction == pytest.approx(curve.printed_junction, abs=0.7)
        assert abs(curve.slow_junction - curve.junction) < 0.4
    assert [(curve.printed_total, curve.printed_junction) for curve in curves] == [
        column[2:4] for column in PRINTED_TABLE_4
    ]
    first, second, third = curves
    assert first.junction > second.junction > third.junction


def test_losses_split_into_machine_and_inverter(curves: tuple[heat.HeatCurve, ...]) -> None:
    first = curves[0]
    late = first.t > 5.0
    square = (130.0 / (6.0 * 0.1049)) ** 2
    assert first.machine_loss[late] == pytest.approx(1.5 * 2e-3 * square, rel=1e-3)
    assert first.loss == pytest.approx(first.machine_loss + first.inverter_loss)
    assert first.junction_temperature[0] == 64.0
    # 0.051 K per watt of inverter loss over 64 degC
    rise = first.junction - 64.0
    assert rise / first.inverter_loss[late].mean() == pytest.approx(0.051, rel=1e-3)


def test_a_drive_without_device_is_refused() -> None:
    design = catalogue.load("paper000-ipmsm-100kw")
    bare = replace(design, inverter=replace(design.inverter, device=None))
    with pytest.raises(ValueError, match="device"):
        heat.heat_curves(bare, [_resting("i_d = 0, SPWM", 0.0, 200.0)])


def test_the_table_says_what_is_assumed(curves: tuple[heat.HeatCurve, ...]) -> None:
    table = method_tables.heat_table(curves)
    assert [row[1] for row in table.rows] == ["1064", "934", "759"]
    assert any("is assumed" in note for note in table.notes)
