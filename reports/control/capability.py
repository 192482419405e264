"""Control functions in fixed point, as a record."""

from __future__ import annotations

from typing import Literal

from dqforge.optimizer.fixed_control.design import FixedControlFit
from dqforge.optimizer.fixed_control.step import FixedControl
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, ReportPart
from dqforge.reports.control.fixed_header import (
    control_fixed_files,
    control_fixed_programme,
    plain_fixed_control,
    plain_fixed_evidence,
)
from dqforge.reports.control.fixed_reading import fixed_control_from
from dqforge.reports.control.fixed_tables import control_fixed_html, control_fixed_tables
from dqforge.reports.pages.chapters import LOOPS
from dqforge.reports.plain_data import PlainData

Fits = tuple[FixedControlFit, ...]


def _fit(fits: Fits, width: int) -> FixedControlFit | None:
    return next((fit for fit in fits if fit.control.width == width), None)


def _fixed_kind(width: Literal[16, 32]) -> HeaderKind[Fits, FixedControl]:
    def files(solution: Solution, fits: Fits) -> dict[str, bytes]:
        fit = _fit(fits, width)
        return {} if fit is None else control_fixed_files(solution.design, fit)

    def plain(_: Solution, fits: Fits) -> PlainData | None:
        fit = _fit(fits, width)
        return None if fit is None else plain_fixed_control(fit.control)

    return HeaderKind(
        name=f"control_q{width - 1}",
        files=files,
        plain=plain,
        read=lambda own, _: fixed_control_from(own, width),
        programme=control_fixed_programme,
    )


def _parts(_: Solution, fits: Fits) -> list[ReportPart]:
    data = {"tables": control_fixed_html(fits), "kind": "loops"}
    return [ReportPart(LOOPS, "pages/tables.html.j2", data)]


FIXED_CONTROL = Capability(
    name="control_fixed",
    title="control functions in fixed point",
    of=lambda outcome: outcome.solution.fixed or None,
    plain=lambda _, fits: {fit.control.format: plain_fixed_evidence(fit) for fit in fits},
    always=False,
    tables=lambda _, fits: control_fixed_tables(fits),
    parts=_parts,
    headers=(_fixed_kind(16), _fixed_kind(32)),
)
