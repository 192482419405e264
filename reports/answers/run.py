"""What `dqforge run` and `dqforge export` answer: what was written, and how it was verified."""

from __future__ import annotations

from dqforge.machines.design.design import Design
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


def answer_export(design: Design, *, verify: bool) -> Answer:
    """Write and verify the headers; raises as `export_design`."""
    output = export_design(design, verify=verify)
    plain = {"verification": plain_verification(output.verification)}
    files = Files(output.files, RUN, design)
    return Answer(
        design.name, (), plain, files=files, notes=(verification_text(output.verification),)
    )
