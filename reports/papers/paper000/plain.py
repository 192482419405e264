"""Paper 000 as plain data."""

from __future__ import annotations

from dataclasses import asdict

from dqforge.reports.papers.paper000.core_costs import PRINTED_MICROSECONDS, CoreCosts, Cost
from dqforge.reports.papers.paper000.heat import HeatCurve
from dqforge.reports.papers.paper000.ipmsm_tables import Reproduction
from dqforge.reports.papers.paper000.load_test import LoadTest
from dqforge.reports.papers.paper000.printed_polynomial import PrintedPolynomial
from dqforge.reports.papers.paper000.stated_method import StatedMethod
from dqforge.reports.papers.paper000.whole_paper import WholePaper
from dqforge.reports.plain_data import PlainData


def plain_whole(found: WholePaper) -> PlainData:
    """Everything by the keys of docs/reference/json.md."""
    return {
        **plain_reproduction(found.tables),
        "table_2_by_stated_method": _coefficients(found.stated),
        "table_3": _costs(found.costs),
        "table_3_left_out": dict(sorted(found.costs.left_out.items())),
        "figure_3": [
            {"degree": row.degree, "best": list(row.best), "printed": list(row.printed)}
            for row in found.stated.maps
        ],
        "figure_4": [
            {
                "degree": row.degree,
                "axis": row.axis,
                "torque_Nm": row.place,
                "largest_error_A": row.largest,
                "share": row.share,
            }
            for row in found.stated.errors
        ],
        "figure_5": plain_load_tests(found.load_tests) if found.load_tests else None,
        "figure_5_heat": [_heat(curve) for curve in found.heat] if found.heat else None,
        "figure_5_left_out": found.left_out,
        "header_of_the_paper": _header(found.header),
    }


def plain_reproduction(reproduction: Reproduction) -> PlainData:
    """The three tables as plain data."""
    return {
        "table_1": [asdict(row) for row in reproduction.breakpoints],
        "table_2": [asdict(row) for row in reproduction.polynomials],
        "table_4": [asdict(row) for row in reproduction.losses],
    }


def _coefficients(found: StatedMethod) -> list[PlainData]:
    return [
        {
            "axis": row.axis,
            "degree": row.degree,
            "segment": row.segment,
            "printed": list(row.printed),
            "stated": list(row.stated),
            "marked": list(row.marked),
            "apart_A": row.largest,
        }
        for row in found.segments
    ]


def _cost(cost: Cost | None) -> PlainData | None:
    if cost is None:
        return None
    return {"instructions": cost.instructions, "cycles": list(cost.cycles)}


def _costs(found: CoreCosts) -> list[PlainData]:
    return [
        {
            "core": row.core,
            "method": row.method,
            "printed_us": PRINTED_MICROSECONDS.get(row.method),
            "unoptimised": _cost(row.plain),
            "optimised": _cost(row.optimised),
            "float32": _cost(row.single),
        }
        for row in found.rows
    ]


def _heat(curve: HeatCurve) -> PlainData:
    return {
        "alternative": curve.name,
        "printed_W": curve.printed_total,
        "found_W": curve.total,
        "printed_degC": curve.printed_junction,
        "found_degC": curve.junction,
        "found_slow_degC": curve.slow_junction,
    }


def _header(found: PrintedPolynomial) -> PlainData:
    return {
        "degree": found.degree,
        "torque_max_Nm": found.torque_max,
        "breakpoints_Nm": list(found.breakpoints),
        "errors_A": [asdict(row) for row in found.errors],
        "compared": found.compared,
        "missing": found.missing,
    }


def plain_load_tests(tests: tuple[LoadTest, ...]) -> list[PlainData]:
    """The figures as plain data."""
    return [
        {
            "alternative": test.name,
            "largest_deviation_rad_per_s": test.deviation,
            "end_error_rad_per_s": test.end_error,
            "torque_Nm": test.torque,
            "current_A": test.current,
            "current_by_equation_A": test.expected,
        }
        for test in tests
    ]
