"""What `dqforge run` and `dqforge export` answer: the files of a design, proven, or its headers
alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import read_regular_file
from dqforge.optimizer.firmware.firmware_method import check_drivable
from dqforge.optimizer.firmware.solve import FirmwareFit, method_of
from dqforge.reports.firmware.target import MOST_BYTES, TARGETS, decoded_file
from dqforge.reports.firmware.written_files import (
    check_existing,
    fit_tables,
    plain_fit,
    read_files,
    target_named,
)
from dqforge.reports.firmware_keys import next_steps
from dqforge.reports.output.folder import EXISTING, FIRMWARE, FIRMWARES
from dqforge.reports.pages.answer import Answer, Files, stage
from dqforge.reports.run import solved_files
from dqforge.reports.verification.text import plain_verification, verification_text

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.reports.pages.answer import Table
    from dqforge.reports.plain_data import PlainData


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
        "read {out}/report.html, then include the headers; 'dqforge verify {out}' tests them again"
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
        return answer_export_for(design, firmware, into, verify=verify, elsewhere=elsewhere)
    if into is not None:
        raise InputError("--into: its firmware is unknown; add --for NAME")
    from dqforge.reports.output.folder import COMMAND, RUN
    from dqforge.reports.run import export_design

    output = export_design(design, verify=verify)
    plain = {"verification": plain_verification(output.verification)}
    files = Files(output.files, RUN, design, options={COMMAND: "export"})
    return Answer(
        design.name, (), plain, files=files, notes=(verification_text(output.verification),)
    )


# What `dqforge export --for` answers: files of other firmware, what they hold and what not.


@on_design("export")
def answer_export_for(
    design: Design,
    names: Sequence[str],
    into: Path | None,
    *,
    verify: bool,
    elsewhere: bool = False,
) -> Answer:
    """Write a design as the files of other firmware.

    Args:
        design: The design.
        names: Whose files.
        into: An existing file whose other fields are kept; of one firmware only.
        verify: Whether the loops of each firmware are simulated, and refused where they do not
            settle.
        elsewhere: Whether the existing file stays as it is.

    Raises:
        InputError: There is no such firmware, it needs what the design does not say, or the
            existing file is not its own.
        NoSolutionError: Its loops do not settle on this drive; says why.
    """
    chosen = tuple(dict.fromkeys(method_of(name, option="--for").name for name in names))
    if into is not None and len(chosen) != 1:
        raise InputError("--into: a file is one firmware's; write a single --for NAME with it")
    original = b"" if into is None else read_regular_file(into, MOST_BYTES)
    existing = None if into is None else decoded_file(original, str(into))
    check_drivable(design, [method_of(name) for name in chosen])
    if existing is not None:
        check_existing(existing, TARGETS[chosen[0]])
    stage("tuning")
    made_files = solved_files(design, chosen, existing)
    files: dict[str, bytes] = {}
    tables: list[Table] = []
    plain: PlainData = {}
    notes: list[str] = []
    for fit, made in made_files:
        _check_names(files, made, fit)
        files |= made
        read = read_files(made, target_named(fit))
        title = f"{target_named(fit).title}: {', '.join(made)}"
        tables += fit_tables(fit, read, title)
        plain[fit.name] = plain_fit(fit) | {"files": list(made)}
    if verify:
        from dqforge.reports.firmware.design_made import settling_text, settling_verdicts

        fits = [fit for fit, _ in made_files]
        verdicts = settling_verdicts(design, fits, _running)
        notes = [settling_text(verdict) for verdict in verdicts]
    for fit, _ in made_files:
        notes += [f"{fit.name}: {step}" for step in next_steps(fit.name)]
    options, given = {FIRMWARES: ",".join(chosen)}, {}
    if into is not None:
        options[EXISTING], given[into.name] = into.name, original
    # A project of others that is rewritten in place gets nothing that is not its own.
    part = FIRMWARE if into is None or elsewhere else ""
    written = Files(files, part, design, options=options, given=given)
    return Answer(design.name, tables, {"firmware": plain}, files=written, notes=tuple(notes))


def _running(name: str) -> None:
    stage(f"running the loops of {name}")


def _check_names(files: dict[str, bytes], made: dict[str, bytes], fit: FirmwareFit) -> None:
    """Refuse two files of one name."""
    twice = sorted(set(files) & set(made))
    if twice:
        raise InputError(
            f"--for: {fit.name} and another firmware both write {twice[0]}; export them one by "
            "one, each with its own -o"
        )
