"""Overmodulation in result, terminal, report and answers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from drives import SURFACE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import OvermodulationName
from dqforge.optimizer.operating_points.characteristics import limited_drive, points_within
from dqforge.reports.answers.mtpa import Request, answer
from dqforge.reports.run import RunOutput, run_design
from dqforge.reports.single_headers.overmodulation import gain_text, point_rows, reach_text


def drive() -> Design:
    return catalogue.load(
        "abb-ipmsm-2k2",
        (
            "operation.overmodulation=least-magnitude-error",
            "operation.overmodulation_limit=98 %",
            "inverter.v_dc=420 V",
        ),
    )


@pytest.fixture(scope="module")
def output() -> RunOutput:
    """A drive whose current reference is exact, which saves the fit."""
    base = make_design(replace(SURFACE, omega_m_max=900.0))
    method: OvermodulationName = "least-magnitude-error"
    return run_design(
        replace(
            base,
            inverter=replace(base.inverter, overmodulation=method, overmodulation_limit=0.98),
            operation=replace(base.operation, overmodulation=method, overmodulation_limit=0.98),
            losses=None,
        ),
        verify=False,
    )


def test_run_says_what_it_gives_and_costs(output: RunOutput) -> None:
    found = output.solution.overmodulation
    assert found is not None
    assert found.largest is not None
    files = output.files
    report = files["report.html"].decode()
    assert reach_text(found).startswith("least-magnitude-error, up to 98 % of six-step operation: ")
    assert reach_text(found) in report
    assert gain_text(found.largest) in report
    for row in point_rows(found.largest):
        assert all(cell in report for cell in row)
    text = files["result.json"].decode()
    for key in ("torque_ripple_Nm", "linear_torque_Nm", "harmonics_V", "current_peak_A"):
        assert f'"{key}"' in text


def test_points_tell_their_harmonics() -> None:
    design = drive()
    asked = Request("1200 rpm", "20 N m", None, "svpwm", "0 %")
    found = answer(design, asked)
    (_, table) = found.tables
    assert table.title == "Low harmonics beyond the linear range"
    points = points_within(limited_drive(design), 20.0, 1200.0 * math.pi / 30.0)
    assert points.harmonics is not None
    assert table.rows[0][2] == f"{100.0 * points.harmonics.index[0]:.4g}"
    plain = found.plain["operating_points"]
    assert plain["limit"]["overmodulation"] == "least-magnitude-error"
    assert np.array_equal(plain["overmodulation"]["torque_6_Nm"], points.harmonics.torque_6)
    slow = answer(design, Request("300 rpm", "20 N m", None, "svpwm", "0 %"))
    assert len(slow.tables) == 1
    other = answer(design, Request("300 rpm", "20 N m", None, "spwm", "0 %"))
    assert "overmodulation" not in other.plain["operating_points"]
