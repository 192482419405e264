"""Control functions in single precision and in fixed point, as records."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.optimizer.fixed_phase_control.solve import IntegerFit
from dqforge.reports.c_code.header_kind import HeaderKind, integer_kinds
from dqforge.reports.capability import Capability, Outcome, ReportPart
from dqforge.reports.pages.chapters import LOOPS
from dqforge.reports.phase_control.emitted import (
    emitted_control_files,
    emitted_control_from,
    emitted_control_plain,
    emitted_control_programme,
)
from dqforge.reports.phase_control.emitted_integers import (
    integer_files,
    integer_html,
    integer_programme,
    integer_tables,
    integers_from,
    plain_integer_evidence,
    plain_integers,
)

if TYPE_CHECKING:
    from dqforge.optimizer.solution import Solution


def _float32(outcome: Outcome) -> Solution | None:
    return outcome.solution if "float32" in outcome.design.export.control else None


FLOAT32_CONTROL = Capability(
    name="control",
    title="control functions in single precision",
    of=_float32,
    headers=(
        HeaderKind(
            name="control",
            files=lambda solution, _: emitted_control_files(solution),
            plain=lambda solution, _: emitted_control_plain(solution),
            read=emitted_control_from,
            programme=emitted_control_programme,
            vectors=False,
        ),
    ),
)


Fits = tuple[IntegerFit, ...]


_KINDS = integer_kinds(
    "control",
    width_of=lambda fit: fit.control.width,
    files=lambda solution, fit: integer_files(solution.design, fit),
    plain=plain_integers,
    read=integers_from,
    programme=integer_programme,
)


def _parts(_: Solution, fits: Fits) -> list[ReportPart]:
    data = {"tables": integer_html(fits), "kind": "loops"}
    return [ReportPart(LOOPS, "pages/tables.html.j2", data)]


FIXED_CONTROL = Capability(
    name="control_fixed",
    title="control functions in fixed point",
    of=lambda outcome: outcome.solution.fixed or None,
    plain=lambda _, fits: {fit.control.format: plain_integer_evidence(fit) for fit in fits},
    always=False,
    tables=lambda _, fits: integer_tables(fits),
    parts=_parts,
    headers=_KINDS,
)
