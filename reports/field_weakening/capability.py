"""The current reference with field weakening, as one record."""

from __future__ import annotations

from collections.abc import Mapping

from dqforge.optimizer.field_weakening.fit import WeakeningFit
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Draw, Quantity, ReportPart, Rows
from dqforge.reports.field_weakening.header import (
    plain_weakening,
    weakening_files,
    weakening_from,
    weakening_programme,
)
from dqforge.reports.field_weakening.plain import plain_weakening_fit
from dqforge.reports.field_weakening.tables import weakening_part, weakening_tables
from dqforge.reports.field_weakening.text import (
    domain_text,
    errors_text,
    nominal_text,
    proof_text,
)
from dqforge.reports.pages.chapters import WEAKENING as CHAPTER


def _summary(_: Solution, fit: WeakeningFit) -> Rows:
    rows = [
        ("field weakening", domain_text(fit)),
        ("  largest errors", errors_text(fit)),
        ("  over the dc link", nominal_text(fit)),
    ]
    proven = proof_text(fit)
    return rows if proven is None else [*rows, ("  proven bounds", proven)]


def _figures(_: Solution, fit: WeakeningFit) -> Mapping[str, Draw]:
    from dqforge.reports.field_weakening.figures import plot_weakening

    return {"weakening": lambda: plot_weakening(fit)}


def _parts(solution: Solution, fit: WeakeningFit) -> list[ReportPart]:
    data = weakening_part(fit, solution.design.export.prefix)
    return [ReportPart(CHAPTER, "field_weakening/report.html.j2", data)]


WEAKENING = Capability(
    name="weakening",
    title="field weakening",
    of=lambda outcome: outcome.solution.weakening,
    plain=lambda _, fit: plain_weakening_fit(fit),
    summary=_summary,
    tables=lambda _, fit: weakening_tables(fit),
    figures=_figures,
    parts=_parts,
    headers=(
        HeaderKind(
            name="weakening",
            files=lambda solution, fit: weakening_files(solution.design, fit),
            plain=lambda _, fit: plain_weakening(fit.step),
            read=lambda own, _: weakening_from(own),
            programme=weakening_programme,
        ),
    ),
    quantities=(
        Quantity("current reference", "bytes of the surface", "", ("weakening", "flash_B")),
        Quantity("current reference", "surface up to", "rpm", ("weakening", "omega_m_rad_per_s")),
    ),
)
