"""What `dqforge run` and `dqforge export` answer: what was written, and how it was verified."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.reports.pages.answer import Answer, Files
from dqforge.reports.verification.text import plain_verification, verification_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design


def answer_run(design: Design, *, verify: bool) -> Answer:
    """Do everything that the design asks for; raises as `run_design`."""
    from dqforge.reports.operating_system.system import prepare_drawing
    from dqforge.reports.output.folder import COMMAND, RUN, VERIFIED
    from dqforge.reports.report import run_tables
    from dqforge.reports.run import run_design

    prepare_drawing()
    output = run_design(design, verify=verify)
    tables = run_tables(output.solution, output.verification)
    plain = {"verification": plain_verification(output.verification)}
    verified = () if output.verification is None else output.verification.languages
    options = {COMMAND: "run", VERIFIED: ",".join(verified)}
    follow = (
        "read {out}/report.html, then include the headers; 'dqforge verify {out}' tries them again"
    )
    files = Files(output.files, RUN, design, options=options, follow=follow)
    return Answer(design.name, tables, plain, files=files)


def answer_export(
    design: Design,
    *,
    verify: bool,
    firmware: Sequence[str] | None = None,
    into: Path | None = None,
    elsewhere: bool = False,
) -> Answer:
    """Write and verify the headers, or the files of other firmware.

    Raises as `export_design` and `answer_export_for`.
    """
    if firmware:
        from dqforge.reports.answers.export import answer_export_for

        return answer_export_for(design, firmware, into, verify=verify, elsewhere=elsewhere)
    if into is not None:
        raise InputError("--into: say whose file it is; write --for NAME with it")
    from dqforge.reports.output.folder import COMMAND, RUN
    from dqforge.reports.run import export_design

    output = export_design(design, verify=verify)
    plain = {"verification": plain_verification(output.verification)}
    files = Files(output.files, RUN, design, options={COMMAND: "export"})
    return Answer(
        design.name, (), plain, files=files, notes=(verification_text(output.verification),)
    )
