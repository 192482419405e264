"""What `dqforge run` and `dqforge export` answer: what was written, and how it was verified."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.reports.answers.export import answer_export_for
from dqforge.reports.answers.verify import plain_verification
from dqforge.reports.output.folder import RUN
from dqforge.reports.pages.answer import Answer, Files
from dqforge.reports.run import export_design, run_design
from dqforge.reports.summary import run_tables
from dqforge.reports.verification.text import verification_text


def answer_run(design: Design, *, verify: bool) -> Answer:
    """Do everything that the design asks for; raises as `run_design`."""
    output = run_design(design, verify=verify)
    tables = run_tables(output.solution, output.verification)
    plain = {"verification": plain_verification(output.verification)}
    return Answer(design.name, tables, plain, files=Files(output.files, RUN, design))


def answer_export(
    design: Design,
    *,
    verify: bool,
    firmware: Sequence[str] | None = None,
    into: Path | None = None,
) -> Answer:
    """Write and verify the headers, or the files of other firmware.

    Raises as `export_design` and `answer_export_for`.
    """
    if firmware:
        return answer_export_for(design, firmware, into, verify=verify)
    if into is not None:
        raise InputError("--into: say whose file it is; write --for NAME with it")
    output = export_design(design, verify=verify)
    plain = {"verification": plain_verification(output.verification)}
    files = Files(output.files, RUN, design)
    return Answer(
        design.name, (), plain, files=files, notes=(verification_text(output.verification),)
    )
