"""Tables of the frames dqx and dqy, as a record."""

from __future__ import annotations

from dqforge.optimizer.frame_tables.fit import FrameTables
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Quantity, ReportPart
from dqforge.reports.frame_tables.float32_model import (
    FrameModel,
    frame_model_from,
    plain_frame_model,
)
from dqforge.reports.frame_tables.header import frame_files, frame_programme
from dqforge.reports.frame_tables.tables import frame_part, frame_rows, frame_table, plain_frames
from dqforge.reports.pages.chapters import WAVEFORMS as CHAPTER

_HEADER: HeaderKind[FrameTables, FrameModel] = HeaderKind(
    name="frames",
    files=lambda solution, found: frame_files(solution.design, found),
    plain=lambda _, found: plain_frame_model(found.chosen.table),
    read=lambda own, _: frame_model_from(own),
    programme=frame_programme,
    vectors=False,
)

FRAME_TABLES = Capability(
    name="frame_tables",
    title="frames dqx and dqy in the firmware",
    of=lambda outcome: outcome.solution.frame_tables,
    plain=lambda _, found: plain_frames(found),
    always=False,
    summary=lambda _, found: frame_rows(found),
    tables=lambda _, found: [frame_table(found)],
    parts=lambda solution, found: [
        ReportPart(
            CHAPTER,
            "frame_tables/report.html.j2",
            frame_part(found, solution.design.export.prefix),
        )
    ],
    headers=(_HEADER,),
    quantities=(Quantity("phase currents", "phi_m", "Wb", ("frame_tables", "phi_m_Wb")),),
)
