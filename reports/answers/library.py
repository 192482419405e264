"""What `dqforge new` and `schema` answer: a design file to start from, and the form of one."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from dqforge.machines.errors import InputError, shown
from dqforge.machines.files.library_files import (
    DESIGN_SCHEMA,
    STUDY_SCHEMA,
    schema_bytes,
    with_modeline,
)
from dqforge.machines.records import dataclass
from dqforge.reports.command_line.designs import NEW_DESIGN, NEW_STUDY, new_file
from dqforge.reports.pages.answer import Answer, Files


@dataclass(frozen=True, slots=True)
class NewRequest:
    """What a new file is made of; nothing: the general template.

    Args:
        machine: Name of a drive in the library.
        files, settings: As `answer_new_from`.
        sheet: By the dotted key, what a data sheet says, as the options of the command line have
            it.
        template: Whether the general template is asked for.
        study: Name of a study in the library, which is made instead of a design.
        capture: Where the magnet flux linkage comes from, beside the data sheet.
        flux_map, axes: File of a flux map, which is copied beside the design, and its ``axes``.
    """

    machine: str | None = None
    files: Sequence[Path] | None = None
    settings: Sequence[str] | None = None
    sheet: Mapping[str, str] | None = None
    template: bool = False
    study: str | None = None
    capture: CapturedFlux | None = None
    flux_map: Path | None = None
    axes: str | None = None


@dataclass(frozen=True, slots=True)
class CapturedFlux:
    """Files of a capture of the back-EMF from which the magnet flux linkage comes, and what its
    channels were, as `dqforge bemf` has it.
    """

    files: Sequence[Path]
    line_to_line: bool = False
    scale: str | None = None


def recorded(
    files: Sequence[Path] | None,
    flux_map: Path | None,
    axes: str | None,
    scale: str | None,
    *,
    line_to_line: bool,
) -> tuple[CapturedFlux | None, Path | None, str | None]:
    """Files of measurements among the options, the last three members of `NewRequest`.

    Raises:
        InputError: An option describes a file that is not given.
    """
    for flag, said, needed, other in (
        ("--axes", axes, flux_map, "--map"),
        ("--scale", scale, files, "--capture"),
        ("--line-to-line", line_to_line, files, "--capture"),
    ):
        if said and not needed:
            raise InputError(f"{flag} describes a file that is not given; write {other} FILE")
    capture = CapturedFlux(files, line_to_line, scale) if files else None
    return capture, flux_map, axes


def answer_new(folder: Path, asked: NewRequest) -> Answer:
    """A commented design file to start from: of a data sheet, of the library, of files of other
    firmware, or a general one; or a study of the library. Its schema goes beside it.

    Raises:
        InputError: The library has no such entry, the data sheet lacks or contradicts something,
            the folder has such a file already, or more than one of the ways is asked for; or as
            `answer_new_from`.
    """
    _refuse_two_ways(asked)
    if asked.files:
        return answer_new_from(folder, asked.files, asked.settings)
    if asked.study is not None:
        if asked.settings:
            raise InputError("--set: sets keys of a design; a study has them under 'set'")
        return _answer_new_study(folder, asked.study)
    path = new_file(folder, NEW_DESIGN)
    if asked.machine is not None and (asked.sheet or asked.capture or asked.settings):
        return _answer_new_over(asked, asked.machine, path)
    if asked.sheet or asked.capture or asked.flux_map or (asked.settings and not asked.template):
        return _answer_new_of(asked, path)
    if asked.settings:
        raise InputError("--set: the template is to be filled in; omit --template, or --set")
    from dqforge.machines.design import catalogue

    files = design_files(catalogue.template(asked.machine))
    return _written(asked.machine or "", path, f"dqforge check {path}", files)


def _answer_new_study(folder: Path, name: str) -> Answer:
    path, schema = new_file(folder, NEW_STUDY), STUDY_SCHEMA
    from dqforge.machines.exploration import study_checks as studies

    text = with_modeline(studies.read_text(name), schema)
    files = Files({path.name: text, schema: schema_bytes(schema)}, "", named=False)
    return _written(name, path, f"dqforge explore {path} --dry-run", files)


def _written(name: str, path: Path, following: str, files: Files) -> Answer:
    note = f"{path} written; next: {following}"
    return Answer(name, (), {"next": following}, files=files, notes=(note,))


def _refuse_two_ways(asked: NewRequest) -> None:
    from dqforge.machines.design.sheet_values import BY_KEY

    # Own values, and the flux of a capture, stand over those of a drive of the library.
    own = [BY_KEY[key].flag for key in asked.sheet or ()] + ["--capture"] * bool(asked.capture)
    given = [] if asked.machine else own
    given += ["--map"] * (asked.flux_map is not None)
    ways = {
        "--from": asked.files,
        "--machine": asked.machine,
        "--template": asked.template,
        "--study": asked.study,
    }
    given += [way for way, is_asked in ways.items() if is_asked]
    if len(given) > 1 and set(given) & set(ways):
        raise InputError(f"{given[0]} and {given[-1]} both define the design; omit one of them")


def _answer_new_of(asked: NewRequest, path: Path) -> Answer:
    """The design of a data sheet, and what `dqforge check` says of it."""
    from dqforge.machines.design.catalogue import load_text
    from dqforge.machines.design.sheet_judged import checked_text
    from dqforge.machines.design.sheet_values import FLUX_AXES, FLUX_MAP
    from dqforge.reports.answers.check import answer_check

    sheet, found = dict(asked.sheet or {}), asked.flux_map
    said, origins = _add_capture(sheet, asked.capture) if asked.capture else ((), {})
    if found is not None:
        sheet |= {FLUX_MAP: found.name} | ({FLUX_AXES: asked.axes} if asked.axes else {})
    source = None if found is None else found.parent
    try:
        files = design_files(checked_text(sheet, source, origins, asked.settings or ()).encode())
    except InputError as error:
        raise _with_way_out(error) from error
    checked = answer_check(load_text(files.contents[NEW_DESIGN], str(path), source))
    following = f"dqforge tune {path}"
    notes = (*said, *checked.notes, f"{path} written; next: {following}")
    plain = {"next": following} | checked.plain
    if found is not None and found.resolve().parent != path.parent.resolve():
        new_file(path.parent, found.name)
        files = replace(files, contents={**files.contents, found.name: found.read_bytes()})
    return replace(checked, plain=plain, files=files, notes=notes)


def _answer_new_over(asked: NewRequest, name: str, path: Path) -> Answer:
    """A drive of the library with own values in the place of its own, and what `dqforge check` says
    of it.
    """
    from dqforge.machines.design.catalogue import load_text, template
    from dqforge.machines.design.sheet_judged import replaced
    from dqforge.reports.answers.check import answer_check

    sheet, said = dict(asked.sheet or {}), tuple[str, ...]()
    if asked.capture is not None:
        said, _ = _add_capture(sheet, asked.capture)
    text, changes = replaced(template(name), name, sheet, asked.settings or ())
    files = design_files(text.encode())
    checked = answer_check(load_text(files.contents[NEW_DESIGN], str(path)))
    following = f"dqforge tune {path}"
    notes = (*said, *changes, *checked.notes, f"{path} written; next: {following}")
    return replace(checked, plain={"next": following} | checked.plain, files=files, notes=notes)


# Harmonics from this share of the fundamental on are told: with currents in phase with the
# fundamental they are a ripple of the torque of about their size.
_TOLD = 0.02
_FLUX = "machine.magnet_flux"


def _add_capture(
    sheet: dict[str, str], capture: CapturedFlux
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Put the magnet flux linkage of a capture to the values of a data sheet; what is to be said,
    and where it comes from by its key.

    Raises:
        InputError: As `read_capture`.
    """
    from dqforge.reports.back_emf import CaptureRequest, read_capture

    pairs = sheet.get("machine.pole_pairs", "")
    request = CaptureRequest(
        line_to_line=capture.line_to_line,
        scale=capture.scale,
        pole_pairs=int(pairs) if pairs.isdigit() and int(pairs) > 0 else None,
    )
    try:
        reading = read_capture(capture.files, request)
    except InputError as error:
        raise _with_way_out(error) from error
    result, source = reading.result, reading.name
    sheet[_FLUX] = f"{1e3 * result.psi_pm:.4g} mWb peak"
    shares = result.amplitudes.max(axis=0) / result.amplitudes[:, 0].mean()
    loud = [
        f"{share:.1%} of order {order}"
        for order, share in zip(result.orders[1:], shares[1:], strict=True)
        if share > _TOLD and order % 3
    ]
    more = (
        f"{source}: the back-EMF has {', '.join(loud)}: torque ripple with sinusoidal currents; "
        "for currents without it, write in the design 'model: waveform', self_inductance in place "
        f"of inductance, and back_emf: {{{_as_back_emf(capture)}}} in place of magnet_flux, with "
        "the file beside the design"
    )
    first = f"magnet flux {1e3 * result.psi_pm:.4g} mWb, the fundamental of the capture"
    said = (f"{source}: {sentence}" for sentence in (first, *reading.findings))
    return (*said, *([more] * bool(loud))), {_FLUX: f"fundamental of the capture {shown(source)}"}


def _as_back_emf(capture: CapturedFlux) -> str:
    """What the section ``machine.back_emf`` says of a capture."""
    names = [shown(file.name) for file in capture.files]
    files = f"file: {names[0]}" if len(names) == 1 else f"files: [{', '.join(names)}]"
    connection = ", connection: line-to-line" if capture.line_to_line else ""
    scale = "" if capture.scale is None else f", scale: [{capture.scale}]"
    return f"{files}{connection}{scale}"


# What a refusal of a capture or a flux map asks for and `dqforge new` has not: options of `dqforge
# bemf` and a key of a design, with the way out.
_ELSEWHERE = (
    (
        ("--interval", "--columns", "--speed"),
        "; 'dqforge bemf' takes it: give the magnet flux that it finds by --magnet-flux",
    ),
    (
        ("columns: {",),
        (
            " under machine.flux_map of a design file; 'dqforge new' reads the headings: name them "
            "in the file, such as i_d [A]"
        ),
    ),
)


# A key that a refusal of a flux map asks for in its file.
_KEY_OF_MAP = re.compile(r"write (flux_unit|current_unit|angle_unit|quantities|layout): (\w+)")


def _with_way_out(error: InputError) -> InputError:
    """A refusal, with what to do where it asks for what `dqforge new` has not."""
    for asked, way_out in _ELSEWHERE:
        if any(words in str(error) for words in asked):
            return InputError(f"{error}{way_out}")
    told = _KEY_OF_MAP.sub(r"write --set machine.flux_map.\1=\2", str(error))
    return error if told == str(error) else InputError(told)


def design_files(text: bytes) -> Files:
    """What `dqforge new` writes: a design, and the schema that its first line names to editors."""
    contents = {
        NEW_DESIGN: with_modeline(text, DESIGN_SCHEMA),
        DESIGN_SCHEMA: schema_bytes(DESIGN_SCHEMA),
    }
    return Files(contents, "", named=False)


def answer_new_from(
    folder: Path, files: Sequence[Path], settings: Sequence[str] | None = None
) -> Answer:
    """A design file from the configuration that files of a firmware hold.

    Args:
        folder: Folder to make; it gets a file design.yaml.
        files: Files of one firmware.
        settings: Keys that the files do not say, or that shall be others, as those of ``--set``.

    Raises:
        InputError: A file is of no known firmware, a value in it is none that a design can have, or
            the folder has a design file already.
    """
    path = new_file(folder, NEW_DESIGN)
    from dqforge.reports.firmware.design_made import design_from_files
    from dqforge.reports.firmware.written_files import plain_configuration

    made = design_from_files(files, settings or ())
    notes = [f"{path} written, from {', '.join(file.name for file in files)}"]
    notes += [f"contradiction: {sentence}" for sentence in made.configuration.contradictions]
    notes += [
        f"missing: {key}; write it, or give --set {key}='{example}'"
        for key, example in (*made.missing, *made.wanted)
    ]
    notes.append(f"next: dqforge {'check' if made.missing else 'tune'} {path}")
    plain = {
        "next": f"dqforge check {path}",
        "missing": [key for key, _ in made.missing],
        "wanted": [key for key, _ in made.wanted],
        "configuration": plain_configuration(made.configuration),
    }
    contents = design_files(made.text.encode("utf-8"))
    return Answer(made.configuration.name, (), plain, files=contents, notes=tuple(notes))


def answer_schema(*, study: bool = False, bench: bool = False, out: Path | None = None) -> Answer:
    """The JSON Schema of the design file, or of study or bench file; printed, or written to
    ``out``.
    """
    from dqforge.machines.bench.bench_file import bench_json_schema
    from dqforge.machines.design.schema import json_schema
    from dqforge.machines.exploration.study import study_json_schema

    if study and bench:
        raise InputError("--study and --bench: a schema is that of one file; name one of them")
    kind = "study" if study else "bench file" if bench else "design"
    schema = study_json_schema() if study else bench_json_schema() if bench else json_schema()
    text = json.dumps(schema, indent=1)
    if out is None:
        return Answer("", (), {"schema": schema}, notes=(text,))
    line = with_modeline(b"", out.name).decode("utf-8").removesuffix("\n")
    note = f"first line of a {kind} beside it, for editors: {line}"
    return Answer(
        "",
        (),
        {"schema": schema},
        files=Files({out.name: f"{text}\n".encode()}, ""),
        notes=(note,),
    )
