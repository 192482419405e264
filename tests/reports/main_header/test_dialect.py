"""Dialects of the main header: the neutral one names every constant, and one from outside the
package makes a header that holds.
"""

from __future__ import annotations

import math

import pytest
from drives import make_design
from figure_pages import blank_figure
from toys.vendor import NAMES, VENDOR

from dqforge.machines.design.settings import FitSettings
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.comparison.sources import header_macros
from dqforge.reports.main_header import DIALECTS, NEUTRAL, constant_groups, header_files
from dqforge.reports.main_header import NAMES as NEUTRAL_NAMES
from dqforge.reports.report import render_report
from dqforge.reports.verification.host import verify_files


@pytest.fixture(scope="module", params=["float32", pytest.param("q15", marks=pytest.mark.slow)])
def solution(request: pytest.FixtureRequest) -> Solution:
    return solve(
        make_design(fit=FitSettings(form="polynomial", degree=3, segments=1, format=request.param))
    )


def test_every_dialect_is_listed_under_its_name() -> None:
    assert DIALECTS == {"neutral": NEUTRAL}


def test_constants_have_quantities_of_their_own_and_neutral_names(solution: Solution) -> None:
    found = [constant for group in constant_groups(solution) for constant in group.constants]
    quantities = [constant.quantity for constant in found]
    assert len(set(quantities)) == len(quantities) > 30
    assert set(quantities) <= set(NEUTRAL_NAMES)
    names = [NEUTRAL.entry(constant) for constant in found]
    assert len({entry.name for entry in names if entry is not None}) == len(quantities)


def test_a_dialect_from_outside_keeps_the_currents_and_takes_its_own_names(
    solution: Solution,
) -> None:
    files = header_files(solution, VENDOR)
    verification = verify_files(files, "drive", solution.reference, 256)
    assert verification.languages == ("c99", "c++11")
    header = files["drive.h"].decode("ascii")
    macros = header_macros(header, "drive")
    assert set(macros) <= {name for name, _ in NAMES.values()}
    assert float(macros["LD_MH"].removesuffix("F")) == pytest.approx(0.35)
    rpm = float(macros["MAX_APPLICATION_SPEED_RPM"].removesuffix("F"))
    bases = solution.design.control.bases
    assert rpm == pytest.approx(bases.speed * 30.0 / math.pi, rel=1e-6)
    neutral = header_files(solution)
    assert files["drive_vectors.h"] == neutral["drive_vectors.h"]
    assert "TORQUE_MAX_NM" not in header
    assert solution.gains.i_d.kp == pytest.approx(float(macros["FLUX_KP"].removesuffix("F")))


def test_the_report_lists_the_macros_of_the_dialect(
    monkeypatch: pytest.MonkeyPatch, solution: Solution
) -> None:
    monkeypatch.setattr("dqforge.reports.report.page_figure", blank_figure)
    report = render_report(solution, None, dialect=VENDOR)
    assert "DRIVE_FLUX_KP" in report
    assert "DRIVE_ID_KP_V_PER_A" not in report
