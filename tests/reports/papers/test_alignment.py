"""The start of section 8.3 of paper 001: alignment with a phase, by the integers of the listing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.reports.papers import paper001_tables as estimator_tables
from dqforge.reports.papers.paper001_bench_transients import bench_design
from dqforge.reports.papers.paper001_emitted_control import (
    FRICTIONS,
    SECONDS,
    Alignment,
    alignments,
    program_bench,
)


@pytest.fixture(scope="module")
def found() -> tuple[Alignment, ...]:
    with program_bench(bench_design()) as place:
        return alignments(place)


def test_the_current_is_that_of_three_quarters_and_a_half(found: tuple[Alignment, ...]) -> None:
    """2/3 of a quarter of 214 V, less what the dead time of 4.88 us takes of a phase and gives
    back of the other two, over 2.35 Ohm.
    """
    lost = 4.88e-6 / 200e-6 * 214.0
    volts = 2.0 / 3.0 * (737.0 / 2949.0 * 214.0 - 2.0 * lost)
    for row in found:
        assert row.current == pytest.approx(volts / 2.35, rel=0.01)


def test_the_rotor_misses_by_no_more_than_the_dead_band(found: tuple[Alignment, ...]) -> None:
    assert [row.friction for row in found] == list(FRICTIONS)
    assert found[0].error_deg < 0.01
    for row in found:
        # K_T = 3/2 p psi
        dead_band = np.degrees(np.arcsin(row.friction / (1.5 * 3 * 0.06 * row.current)))
        assert row.formula_deg == pytest.approx(dead_band, rel=1e-6)
        assert row.error_deg <= row.formula_deg + 0.01
    assert found[1].error_deg > 0.5 * found[1].formula_deg


def test_the_program_starts_from_the_angle_that_it_set_to_zero(
    found: tuple[Alignment, ...],
) -> None:
    for row in found:
        assert row.reached_rpm == pytest.approx(1197.0, abs=2.0)
        assert 0.09 < row.seconds < 0.14
        assert row.seconds >= found[0].seconds


def test_half_a_turn_off_it_stays_and_runs_away(found: tuple[Alignment, ...]) -> None:
    for row in found:
        assert row.stuck_deg == (180,)
        assert row.backwards_rpm < -2000.0


def test_table_and_plain_data_show_it(found: tuple[Alignment, ...]) -> None:
    table = estimator_tables.alignment_table(found)
    assert len(table.rows) == len(FRICTIONS)
    assert f"{SECONDS:g} s" in " ".join(table.notes)
    assert table.rows[0][4] == "180"
    nowhere = replace(found[0], stuck_deg=(), seconds=float("nan"), backwards_rpm=float("nan"))
    assert estimator_tables.alignment_table((nowhere,)).rows[0][4:6] == ("-", "-")
    assert estimator_tables.plain_alignment(found)[1]["error_deg"] == found[1].error_deg
