"""Control functions in single precision, as a record."""

from __future__ import annotations

from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_kind import HeaderKind
from dqforge.reports.capability import Capability, Outcome
from dqforge.reports.phase_control.emitted import (
    emitted_control_files,
    emitted_control_from,
    emitted_control_plain,
    emitted_control_programme,
)


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
