"""What `dqforge mtpa` answers: currents over torque, and operating points
within the voltage limit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.optimizer.current_reference.fit import signed_designs
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.overmodulation import solve_overmodulation
from dqforge.reports.operating_points.plain import mtpa_tables, plain_curves
from dqforge.reports.operating_points.question import Request, answer
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = ["Request", "answer_mtpa"]


def answer_mtpa(design: Design, request: Request) -> Answer:
    """Currents over torque; with a speed, a torque or a map what is asked for;
    raises as `answer`.
    """
    stage("solving")
    return answer(design, request) if request.within_voltage else _curves(design)


def _curves(design: Design) -> Answer:
    positive, negative = signed_designs(design)
    curves = solve_curves(positive)
    mirrored = None if negative is None else solve_curves(negative)

    def figure() -> Figure:
        from dqforge.reports.current_reference.figures import plot_mtpa

        return plot_mtpa(positive, curves)

    plain: PlainData = {"mtpa": plain_curves(curves)}
    if mirrored is not None:
        plain["mtpa_negative"] = plain_curves(mirrored)
    tables, beyond = mtpa_tables(design, curves, mirrored), solve_overmodulation(design)
    if beyond is not None:
        from dqforge.reports.single_headers.overmodulation import (
            overmodulation_tables,
            plain_overmodulation,
        )

        plain["overmodulation"] = plain_overmodulation(beyond)
        tables = [*tables, *overmodulation_tables(beyond)]
    return Answer(design.name, tables, plain, figure)
