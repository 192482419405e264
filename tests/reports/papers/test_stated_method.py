"""Coefficients of paper 000 by the method that it states, and the header of the printed ones."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.papers import paper000_stated_method
from dqforge.reports.papers import paper000_whole_paper as method_tables
from dqforge.reports.papers.paper000_figures import plot_errors_over_torque, plot_split
from dqforge.reports.papers.paper000_stated_method import (
    FIXED_PREFIX,
    PREFIX,
    PRINTED_TABLE_1,
    PRINTED_TABLE_2,
    PrintedPolynomial,
    StatedMethod,
    printed_header,
    printed_piecewise,
)


@pytest.fixture(scope="module")
def machine() -> LinearMachine:
    return linearised(catalogue.load("paper000-ipmsm-100kw").machine)


@pytest.fixture(scope="module")
def found(machine: LinearMachine) -> StatedMethod:
    return paper000_stated_method.by_stated_method(machine)


@pytest.fixture(scope="module")
def header() -> PrintedPolynomial:
    return printed_header(catalogue.load("paper000-ipmsm-100kw"))


def _exact(torque: float) -> tuple[float, float]:
    """Currents in A of the quartic (19) by bisection."""
    base = 0.1049 / (2.0 * 242e-6)
    asked = torque / (0.75 * 4 * 0.1049 * base)
    low, high = -asked, 0.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if middle * (2.0 - middle) ** 3 + asked**2 < 0.0 else (low, middle)
        )
    return base * low, base * asked / (2.0 - low)


def test_coefficients_interpolate_on_the_chebyshev_nodes_of_each_segment(
    found: StatedMethod,
) -> None:
    """(25) written down once more, the quartic by bisection: each polynomial meets each node."""
    base = 0.75 * 4 * 0.1049**2 / (2.0 * 242e-6)
    for row in found.segments:
        inner = PRINTED_TABLE_1[row.degree]["dq".index(row.axis)]
        a, b = ((0.0, inner), (inner, 5.0))[row.segment]
        count = row.degree + 1
        for i in range(1, count + 1):
            node = 0.5 * ((b + a) + (b - a) * np.cos((2 * i - 1) / (2 * count) * np.pi)) * base
            value = np.polyval(row.stated, node)
            assert value == pytest.approx(_exact(node)["dq".index(row.axis)], abs=1e-6)


def test_which_printed_coefficients_follow_from_the_method(found: StatedMethod) -> None:
    rows = {(row.axis, row.degree, row.segment): row for row in found.segments}
    assert set(rows) == {(axis, n, k) for axis in "dq" for n in (2, 3, 4) for k in (0, 1)}
    # degree 4, second segments: three digits, within 2 %
    for axis in "dq":
        row = rows[axis, 4, 1]
        assert not any(row.marked)
        assert row.printed == pytest.approx(row.stated, rel=0.02)
        assert row.largest < 0.1
    # every first segment is printed without the constant that interpolation leaves
    for (_, _, segment), row in rows.items():
        if segment == 0:
            assert row.printed[-1] == 0.0
            assert row.marked[-1]
    assert rows["d", 2, 0].stated == pytest.approx((-3.23e-3, -0.122, 0.73), rel=0.01)
    assert rows["d", 2, 0].marked == (False, True, True)


def test_figure_4_beside_the_printed_error(found: StatedMethod) -> None:
    second, third, fourth = found.errors
    assert second.largest == pytest.approx(paper000_stated_method.STATED_LARGEST, rel=0.025)
    assert (second.axis, third.axis) == ("d", "q")
    assert fourth.largest < 0.09
    # the printed share is of another point
    assert second.share > 0.3
    near = np.abs(second.exact["d"] + 71.2) < 5.0
    assert np.max(np.abs(second.printed["d"] - second.exact["d"])[near]) < 0.76


def test_figure_3_has_its_best_where_the_search_finds_it(found: StatedMethod) -> None:
    for one, best in zip(found.maps, ((1.435, 2.442), (1.813, 1.694), (1.9, 1.543)), strict=True):
        step = float(one.points[1] - one.points[0])
        assert one.best == pytest.approx(best, abs=step)
        assert one.reduction.max() > 99.2
        # the printed cross lies on the map's plateau
        assert one.printed == PRINTED_TABLE_1[one.degree][:2]


def test_printed_coefficients_keep_their_values_from_the_start_of_a_segment(
    machine: LinearMachine,
) -> None:
    torque = np.linspace(0.0, 341.0, 3411)
    for axis in "dq":
        fit = printed_piecewise(axis, 4, machine)
        first, second = PRINTED_TABLE_2[axis, 4]
        limit = float(fit.edges[1])
        expected = np.where(torque < limit, np.polyval(first, torque), np.polyval(second, torque))
        assert np.max(np.abs(fit(torque) - expected)) < 1e-9


def test_the_header_of_the_paper_against_the_exact_mtpa(header: PrintedPolynomial) -> None:
    """Degree 4 with the printed digits: 0.037 A and 0.017 A r.m.s. to 250 N m."""
    d, q = header.errors
    assert d.rms == pytest.approx(0.037, abs=0.001)
    assert q.rms == pytest.approx(0.017, abs=0.001)
    assert d.largest < 0.09
    assert q.largest < 0.05
    base = 0.75 * 4 * 0.1049**2 / (2.0 * 242e-6)
    assert header.torque_max == pytest.approx(5.0 * base, rel=1e-9)
    assert header.breakpoints == pytest.approx((1.9424 * base, 1.4576 * base), rel=1e-9)


def test_the_header_holds_the_printed_digits_and_runs(header: PrintedPolynomial) -> None:
    text = header.files[f"{PREFIX}.h"].decode()
    assert "((((((-4.39e-8F * t) + 2.89e-5F) * t) - 0.00697F) * t) + 0.0157F) * t;" in text
    assert "((((((8.0e-8F * t) - 2.19e-5F) * t) - 7.17e-5F) * t) + 1.59F) * torque_Nm;" in text
    assert "132.48" in text
    assert "99.418" in text
    assert (
        f"{FIXED_PREFIX}_current_reference_q15(int16_t"
        in header.fixed[f"{FIXED_PREFIX}.h"].decode()
    )
    assert header.missing == ""
    assert header.compared > 20_000


@pytest.mark.slow
def test_tables_and_figures_show_them(found: StatedMethod, header: PrintedPolynomial) -> None:
    table = method_tables.coefficient_table(found.segments)
    assert table.rows[0][3] == "-0.00333 -0.101* 0*"
    assert method_tables.error_table(found.errors).rows[0][1].startswith("1.09")
    assert len(method_tables.header_table(header).rows) == 2
    assert "<svg" in to_svg(plot_split(found))
    assert "<svg" in to_svg(plot_errors_over_torque(found.errors))
