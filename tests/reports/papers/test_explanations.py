"""What explains a printed number: planted choices are found, and those of the papers hold."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents, per_unit_base
from dqforge.reports.papers.explanations import (
    Alternative,
    Coefficients,
    Explanation,
    Printed,
    explain,
    explain_coefficients,
    explanation_table,
    plain_explanation,
)
from dqforge.reports.papers.paper000_stated_method import (
    DESIGN_NAME,
    PRINTED_TABLE_1,
    PRINTED_TABLE_2,
)
from dqforge.reports.papers.paper001_bench_transients import Reproduction

BREAKPOINTS = {degree: row[:2] for degree, row in PRINTED_TABLE_1.items()}


@pytest.fixture(scope="module")
def machine() -> LinearMachine:
    return linearised(catalogue.load(DESIGN_NAME).machine)


@pytest.fixture(scope="module")
def of_table_2(machine: LinearMachine) -> Explanation:
    return explain_coefficients(machine, PRINTED_TABLE_2, BREAKPOINTS)


def test_what_is_explained_counts_beyond_what_was_fitted() -> None:
    printed = [Printed("x", "A", 1.0, 0.1), Printed("y", "A", 2.0, 0.1)]
    all_fitted = Alternative("each number by itself", 2, (1.0, 2.0))
    one = Alternative("one number", 1, (1.05, 2.05))
    none = Alternative("nothing", 0, (1.5, float("nan")))
    found = explain("", printed, [none, all_fitted, one], "")
    assert [of.assumed for of in found.alternatives] == ["one number", *found_words(found)[1:]]
    assert [found.beyond(of) for of in found.alternatives] == [1, 0, 0]
    assert found.alternatives[1] is all_fitted  # misses nothing
    assert found.as_good == ()
    stays = explain("", printed, [none, all_fitted], "")
    assert any("stays open" in line for line in explanation_table(stays).notes)
    assert plain_explanation(stays)["alternatives"][1]["found"] == [1.5, None]


def found_words(found: Explanation) -> list[str]:
    return [of.assumed for of in found.alternatives]


def planted(machine: LinearMachine, edges: dict[str, float]) -> Coefficients:
    """Three digits of degree 3 through the Chebyshev extrema of both segments, by numpy in N m."""
    torque = per_unit_base(machine).torque
    table: Coefficients = {}
    for axis, edge in edges.items():
        rows: list[tuple[float, ...]] = []
        for low, high in ((0.0, edge), (edge, 5.0)):
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            at = torque * (middle - half * np.cos(np.pi * np.arange(4) / 3))
            current = mtpa_currents(machine, at)["dq".index(axis)]
            fitted = np.polyfit(at, current, 3)
            fitted[3] = 0.0 if low == 0.0 else fitted[3]
            rows.append(tuple(float(f"{value:.2e}") for value in fitted))
        table[axis, 3] = (rows[0], rows[1])
    return table


def test_planted_nodes_and_breakpoints_are_found(machine: LinearMachine) -> None:
    printed = planted(machine, {"d": 1.7, "q": 2.2})
    found = explain_coefficients(machine, printed, {3: (1.8455, 1.5545)})
    assert found.winner.assumed == ("Chebyshev extrema, other breakpoints, base as identified")
    assert all(found.explained(found.winner))
    # with its breakpoints printed, nothing has to be fitted
    stated = explain_coefficients(machine, printed, {3: (1.7, 2.2)})
    assert (stated.winner.fitted, stated.beyond(stated.winner)) == (0, 16)


def test_digits_of_table_2_follow_from_nodes_at_both_ends(of_table_2: Explanation) -> None:
    """Nodes that include the ends, over other breakpoints; the stated nodes explain less."""
    assert sum(of_table_2.explained(of_table_2.winner)) >= 36
    assert of_table_2.beyond(of_table_2.winner) >= 22
    assert "with both ends" in of_table_2.winner.assumed
    stated = next(
        of
        for of in of_table_2.alternatives
        if of.assumed == "Chebyshev nodes, printed breakpoints, base as identified"
    )
    assert stated.fitted == 0
    assert of_table_2.beyond(stated) < 10


def test_times_and_speed_of_the_bench_follow_together(reproduced: Reproduction) -> None:
    """220 V rectified, dry friction and a limit of 3 A: both times and the speed of the figures."""
    found = reproduced.program.explanation
    assert found.explained(found.winner) == (True, True, True, True, False)
    assert found.winner.fitted == 2
    assert found.winner.assumed.startswith("311 V")
    start, reversal = found.winner.found[:2]
    # longer than the torque of the limit needs, less the friction, against it while braking: the
    # rest is the integral's, which rests for errors up to the dead band
    torque, speed, inertia = 1.5 * 3 * 0.06 * 3.0, 1200.0 * np.pi / 30.0, 200e-6
    assert start > inertia * speed / (torque - 0.2)
    assert reversal > inertia * speed * (1.0 / (torque - 0.2) + 1.0 / (torque + 0.2))
    assert found.winner.found[3] == pytest.approx(2700.0 * 155 / 155.3445, rel=2e-4)
