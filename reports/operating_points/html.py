"""Operating points in the report."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.optimizer.operating_points.solve import Curves
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability
from dqforge.reports.operating_points.plain import mtpa_tables, plain_curves
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, heading_cells, number, share
from dqforge.reports.pages.labels import watts

_SHARES_OF_TORQUE = (0.1, 0.25, 0.5, 0.75, 1.0)


def differs_from_id0(design: Design) -> bool:
    """Whether the design's strategy is anything else than i_d = 0."""
    return design.strategy != "id0" and design.machine.saliency != 0.0


def operating_table(design: Design, curves: Curves) -> HtmlTable:
    """Currents and copper loss at a few torques, beside those of i_d = 0."""
    chosen, id0 = curves.chosen, curves.id0 if differs_from_id0(design) else None
    rows = []
    for part in _SHARES_OF_TORQUE:
        k = round(part * (chosen.torque.size - 1))
        cells = [number(chosen.torque[k]), number(chosen.i_d[k]), number(chosen.i_q[k])]
        cells += [
            number(float(np.hypot(chosen.i_d[k], chosen.i_q[k]))),
            watts(float(chosen.copper[k])),
        ]
        if id0 is not None:
            if id0.limited[k]:
                cells += ["beyond the limit", "\u2013"]
            else:
                saved = 1.0 - float(chosen.copper[k] / id0.copper[k])
                cells += [watts(float(id0.copper[k])), share(saved, 3)]
        rows.append(Row(tuple(cells)))
    columns = ["Torque N m", "i_d A", "i_q A", "|i| A", "copper loss"]
    columns += [] if id0 is None else ["copper loss at i_d = 0", "saved"]
    return HtmlTable(
        "Operating points, exact (currents are peak of phase)",
        heading_cells(*columns),
        tuple(rows),
        0,
    )


# The currents over torque, as one record.


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
