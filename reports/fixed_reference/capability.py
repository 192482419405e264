"""Current references in fixed point, as a record."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit
from dqforge.reports.c_code.header_kind import HeaderKind, integer_kinds
from dqforge.reports.capability import Capability, ReportPart, Rows
from dqforge.reports.fixed_reference.header import plain_mesh, reference_files, reference_programme
from dqforge.reports.fixed_reference.mesh_reading import mesh_from
from dqforge.reports.fixed_reference.tables import reference_html, reference_tables
from dqforge.reports.fixed_reference.text import error_words, size_words
from dqforge.reports.pages.chapters import REFERENCE

if TYPE_CHECKING:
    from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData

Fits = tuple[FixedReferenceFit, ...]


_KINDS: tuple[HeaderKind[Fits, CurrentMesh], ...] = integer_kinds(
    "reference",
    width_of=lambda fit: fit.reference.width,
    files=lambda solution, fit: reference_files(solution.design, fit),
    plain=lambda fit: plain_mesh(fit.reference),
    read=lambda own, width, _: mesh_from(own, width),
    programme=reference_programme,
)


def _summary(_: Solution, fits: Fits) -> Rows:
    return [
        (f"reference {fit.reference.format}", f"{size_words(fit)}; {error_words(fit)}")
        for fit in fits
    ]


def _plain(_: Solution, fits: Fits) -> PlainData:
    return {fit.reference.format: _evidence(fit) for fit in fits}


def _evidence(fit: FixedReferenceFit) -> PlainData:
    errors, mesh, fullest = fit.errors, fit.reference, fit.fullest
    return {
        "rows": mesh.rows,
        "columns": mesh.columns - 1,
        "bytes": mesh.table_bytes,
        "torque_max_Nm": mesh.end_torque,
        "omega_m_rad_per_s": fit.speed,
        "errors": {
            "torque_Nm": errors.torque,
            "torque_relative": errors.torque_relative,
            "current_A": errors.current,
            "current_excess": errors.current_excess,
            "voltage_excess": errors.voltage_excess,
            "loss_relative": errors.loss_relative,
            "samples": errors.samples,
        },
        "proven": {
            "current_excess": fit.proven.current,
            "voltage_excess": fit.proven.voltage,
        },
        "ranges": [
            {"name": reach.name, **asdict(reach.range), "bits": reach.bits} for reach in fit.reaches
        ],
        "fullest": {"name": fullest.name, "share": fullest.share},
    }


def _parts(_: Solution, fits: Fits) -> list[ReportPart]:
    data = {"tables": reference_html(fits), "kind": "reference"}
    return [ReportPart(REFERENCE, "pages/tables.html.j2", data)]


FIXED_REFERENCE = Capability(
    name="reference_fixed",
    title="current references in fixed point",
    of=lambda outcome: outcome.solution.fixed_references or None,
    plain=_plain,
    always=False,
    summary=_summary,
    tables=lambda _, fits: reference_tables(fits),
    parts=_parts,
    headers=_KINDS,
)
