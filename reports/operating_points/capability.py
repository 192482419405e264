"""The currents over torque, as one record."""

from __future__ import annotations

from dqforge.optimizer.operating_points.solve import Curves
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability
from dqforge.reports.operating_points.plain import plain_curves
from dqforge.reports.operating_points.tables import mtpa_tables
from dqforge.reports.pages.table import Table


def _tables(solution: Solution, curves: Curves) -> list[Table]:
    half = solution.negative
    return mtpa_tables(solution.design, curves, None if half is None else half.curves)


OPERATING_POINTS = Capability(
    name="mtpa",
    title="currents over torque",
    of=lambda outcome: outcome.solution.curves,
    plain=lambda _, curves: plain_curves(curves),
    tables=_tables,
)
