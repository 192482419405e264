"""The main job: solve a design, emit its header, prove the header, and gather the files to be
written, ``result.json`` among them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.entries.rules import EntryError, check_prefix
from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.optimizer.current_reference.forms import Emitted
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.c_code.harness import HeaderKind, Programme
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome, asked_for, header_kinds
from dqforge.reports.current_reference.plain import from_plain, reference_programme, to_plain
from dqforge.reports.firmware.design_made import settling_verdicts
from dqforge.reports.firmware.design_simulation import simulate_with_firmware
from dqforge.reports.firmware.target import TextFile
from dqforge.reports.firmware.written_files import firmware_files
from dqforge.reports.main_header import NEUTRAL, Dialect, header_files
from dqforge.reports.observers.speed_loop_text import promise_lines, with_promise
from dqforge.reports.pages.answer import LARGEST_FILE, LARGEST_JSON, read_output, shares, stage
from dqforge.reports.pages.templating import strict_json, to_text
from dqforge.reports.plain_data import PlainData, plain_design
from dqforge.reports.report import render_report
from dqforge.reports.run_folder import REPORT, RESULT, listed_files
from dqforge.reports.verification.host import Verification, stated_verification, verify_files
from dqforge.reports.verification.independent import certificate_files
from dqforge.reports.verification.range_claims import range_files


@dataclass(frozen=True, slots=True)
class RunOutput:
    """What a run made: the solution, the outcome of the verification (None if it was skipped),
    and the files.

    ``plain`` is what ``result.json`` holds, ``told`` says by name what each file is.
    """

    solution: Solution
    verification: Verification | None
    files: dict[str, bytes]
    plain: PlainData
    told: dict[str, str] = field(default_factory=dict)


Told = Iterator[tuple[str, dict[str, bytes]]]


def _emitted(solution: Solution, capabilities: Capabilities, dialect: Dialect) -> Told:
    """What is emitted, in a few words, with its files; where a speed loop runs on an observer, each
    says at which speeds.
    """
    loops = solution.loops
    lines = promise_lines(None if loops is None else loops.speed)
    for words, files in _made(solution, capabilities, dialect):
        yield words, {name: with_promise(name, content, lines) for name, content in files.items()}


def _made(solution: Solution, capabilities: Capabilities, dialect: Dialect) -> Told:
    """As `_emitted`, without the speeds."""
    yield "current reference, gains and bases of the drive", header_files(solution, dialect)
    for capability, found in asked_for(capabilities, Outcome(solution)):
        for kind in capability.headers:
            if kind.plain(solution, found) is not None:
                yield capability.title, kind.files(solution, found)
        yield capability.title, capability.emitted(solution, found)


def _words(made: Told) -> tuple[dict[str, bytes], dict[str, str]]:
    """Files by name, and what each is."""
    files: dict[str, bytes] = {}
    told: dict[str, str] = {}
    for title, contents in made:
        files |= contents
        for name in contents:
            told[name] = f"test vectors: {title}" if name.endswith("_vectors.h") else title
    return files, told


def emitted_files(
    solution: Solution, capabilities: Capabilities = CAPABILITIES, dialect: Dialect = NEUTRAL
) -> dict[str, bytes]:
    """Names and bytes of all headers of a solution, and of what is emitted beside them; arguments
    as of `export_design`.
    """
    return _words(_emitted(solution, capabilities, dialect))[0]


def _verified(
    solution: Solution, files: dict[str, bytes], plain: PlainData, capabilities: Capabilities
) -> Verification:
    """The headers against what the result says of them: what a later `dqforge verify` will read."""
    for _ in settling_verdicts(solution.design, solution.firmware, _running):
        pass  # what does not settle is refused
    stage("compiling and comparing")
    export = solution.design.export
    _, further = programmes(plain, capabilities)
    return verify_files(files, export.prefix, solution.reference, export.vectors, further)


def _running(name: str) -> None:
    stage(f"running the loops of {name}")


def _result(design: Design, plain: PlainData) -> bytes:
    return to_text("run", design.name, plain).encode("ascii")


@on_design("export")
def export_design(
    design: Design,
    *,
    verify: bool,
    capabilities: Capabilities = CAPABILITIES,
    dialect: Dialect = NEUTRAL,
) -> RunOutput:
    """Header, test vectors and ``result.json`` of a design; nothing else is computed for show.

    Args:
        design: What is solved.
        verify: Whether the headers are compiled and compared with their models.
        capabilities: Those of the product, or these and some from outside.
        dialect: Whose names the main header takes.

    Raises:
        InputError, NoSolutionError: As `require_observed`.
        VerificationError: The compiled header differs from the model, or no compiler is there to
            try it.
    """
    stage("solving")
    solution = solve(design)
    require_observed(design, solution.loops)
    stage("emitting the headers")
    files, told = _words(_emitted(solution, capabilities, dialect))
    if dialect is NEUTRAL:
        certified = certificate_files(solution, files) | range_files(solution, files)
        files |= certified
        told |= dict.fromkeys(certified, "what is proven, for the independent checker")
    plain = plain_solution(solution, capabilities)
    verification = _verified(solution, files, plain, capabilities) if verify else None
    files[RESULT], told[RESULT] = _result(design, plain), "every number of this run, as JSON"
    return RunOutput(solution, verification, files, plain, told)


@on_design("machine")
def run_design(
    design: Design,
    *,
    verify: bool,
    capabilities: Capabilities = CAPABILITIES,
    dialect: Dialect = NEUTRAL,
) -> RunOutput:
    """Everything that the design asks for, the report included; arguments as of `export_design`.

    Raises:
        VerificationError: As `export_design`.
    """
    output = export_design(design, verify=verify, capabilities=capabilities, dialect=dialect)
    return _finished(output, output.verification, capabilities, dialect)


def run_again(
    design: Design,
    languages: Sequence[str],
    there: Mapping[str, bytes],
    capabilities: Capabilities = CAPABILITIES,
) -> RunOutput:
    """What `run_design` makes; nothing is compiled but what the simulation runs.

    Args:
        design: What is solved.
        languages: Standards in which the headers were verified, none for a run without
            verification.
        there: The files that lie beside the report, which lists them with their hashes.
        capabilities: As of `export_design`.

    Raises:
        InputError, NoSolutionError, VerificationError: As `run_design`.
    """
    output = export_design(design, verify=False, capabilities=capabilities)
    if not languages:
        return _finished(output, None, capabilities, NEUTRAL, there)
    export = design.export
    _, further = programmes(output.plain, capabilities)
    stated = stated_verification(output.solution.reference, export.vectors, further, languages)
    return _finished(output, stated, capabilities, NEUTRAL, there)


def solved_files(
    design: Design, names: Sequence[Firmware], existing: TextFile | None = None
) -> list[tuple[FirmwareFit, dict[str, bytes]]]:
    """What a design amounts to in each of these firmwares, and the files that hold it; as
    `firmware_files`.

    Raises:
        InputError, NoSolutionError: A firmware needs what the design does not say, or has no gains
            for it.
    """
    wanted = replace(design, export=replace(design.export, firmware=tuple(names)))
    fits = solve_firmware(wanted, solve_gains(wanted))
    return [(fit, firmware_files(wanted, fit, existing)) for fit in fits]


def _finished(
    output: RunOutput,
    verification: Verification | None,
    capabilities: Capabilities,
    dialect: Dialect,
    there: Mapping[str, bytes] | None = None,
) -> RunOutput:
    """What was exported with simulation and report."""
    design, simulation = output.solution.design, None
    if verification is not None and design.simulation is not None:
        stage("simulating")
        simulation = simulate_with_firmware(design, solution=output.solution, progress=shares())
    outcome = Outcome(output.solution, verification is not None, simulation)
    if simulation is not None:
        plain = output.plain | plain_outcome(outcome, capabilities)
        output.files[RESULT] = _result(design, plain)
    further, told = _words(
        (capability.title, capability.files(output.solution, found))
        for capability, found in asked_for(capabilities, outcome)
    )
    output.files.update(further)
    output.told.update(told)
    stage("writing the report")
    beside = {name: (there or {}).get(name, content) for name, content in output.files.items()}
    listed = listed_files(beside, output.told, design.given)
    output.files[REPORT] = render_report(
        output.solution, verification, simulation, capabilities, dialect, listed
    ).encode("utf-8")
    return output


# Results as plain data for ``--json`` and ``result.json``: documented, versioned and the same
# bytes every time.


def plain_drive(design: Design) -> PlainData:
    """Constants, limits and settings of machine and inverter in SI units, whatever keys the design
    gave them by.
    """
    machine, inverter = design.machine, design.inverter
    return {
        "constant": isinstance(machine, LinearMachine),
        "pole_pairs": machine.pole_pairs,
        "r_s_Ohm": machine.r_s,
        "l_d_H": machine.l_d,
        "l_q_H": machine.l_q,
        "psi_pm_Wb": machine.psi_pm,
        "inertia_kg_m2": machine.inertia,
        "friction_Nms_per_rad": machine.friction,
        "omega_m_max_rad_per_s": machine.omega_m_max,
        "i_max_A": design.i_max,
        "v_dc_V": inverter.v_dc,
        "f_sw_Hz": inverter.f_sw,
        "dead_time_s": inverter.dead_time,
        "topology": inverter.topology,
        "t_s_s": design.control.t_s,
        "strategy": design.strategy,
        "reference_omega_m_rad_per_s": design.operation.omega_m,
    }


def plain_header(solution: Solution) -> PlainData:
    """The main header: its prefix, the number of its test vectors, and what its model needs."""
    export = solution.design.export
    return {
        "prefix": export.prefix,
        "vectors": export.vectors,
        "reference": to_plain(solution.reference),
    }


def plain_outcome(outcome: Outcome, capabilities: Capabilities = CAPABILITIES) -> PlainData:
    """What each capability says of its result and of its headers, by key.

    Args:
        outcome: What was solved, verified and simulated.
        capabilities: Those of the product, or these and some from outside.
    """
    plain: PlainData = {}
    for capability in capabilities:
        found = capability.of(outcome)
        if capability.plain is not None and (capability.always or found is not None):
            plain[capability.name] = (
                None if found is None else capability.plain(outcome.solution, found)
            )
        for kind in capability.headers:
            described = None if found is None else kind.plain(outcome.solution, found)
            if capability.always or described is not None:
                plain[kind.key] = described
    return plain


def plain_solution(solution: Solution, capabilities: Capabilities = CAPABILITIES) -> PlainData:
    """Everything that a run found, with what `dqforge verify` needs under ``header``."""
    return {
        "input": plain_design(solution.design),
        "drive": plain_drive(solution.design),
        "header": plain_header(solution),
        **plain_outcome(Outcome(solution), capabilities),
    }


# Headers of a folder that was written before, read back from its ``result.json``.


def _read(path: Path, most_bytes: int = LARGEST_FILE) -> bytes:
    return read_output(path, "the folder that 'dqforge run' or 'dqforge export' wrote", most_bytes)


def _load_result(path: Path) -> dict[str, Any]:
    """A result that describes a header."""
    content = _read(path, LARGEST_JSON)
    try:
        loaded = strict_json(content)
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON; run the design again", source=str(path)) from error
    if not isinstance(loaded, dict) or not isinstance(loaded.get("header"), dict):
        raise InputError("holds no header; run the design again", source=str(path))
    return loaded


def programmes(
    plain: Mapping[str, Any], capabilities: Capabilities = CAPABILITIES
) -> tuple[dict[str, HeaderKind[Any, Any]], list[Programme]]:
    """The kinds of further headers that a result describes by name, and their harnesses.

    What stands in the result alone rebuilds the models that the compiled functions must equal.

    Raises:
        InputError: What stands there is not what dqforge writes.
    """
    found = {}
    made = []
    for kind in header_kinds(capabilities):
        described = plain.get(kind.key)
        if described is None:
            continue
        if not isinstance(described, dict):
            raise InputError(f"{kind.key} is not what dqforge writes; run the design again")
        found[kind.name] = kind
        made.append(kind.programme(kind.read(described, plain)))
    return found, made


@dataclass(frozen=True, slots=True)
class WrittenHeaders:
    """What an earlier run wrote: files by name, prefix, model, number of test vectors,
    harnesses of further headers.
    """

    files: dict[str, bytes]
    prefix: str
    reference: Emitted
    vectors: int
    further: tuple[Programme, ...] = ()

    @property
    def programmes(self) -> tuple[Programme, ...]:
        """Harnesses of all headers."""
        return (reference_programme(self.reference, self.vectors)[0], *self.further)


def read_folder(folder: Path, capabilities: Capabilities = CAPABILITIES) -> WrittenHeaders:
    """Headers and models of an earlier run, by what its ``result.json`` describes.

    Args:
        folder: What 'dqforge run' or 'export' wrote.
        capabilities: Those of the product, or these and some from outside, as the run had them.

    Raises:
        InputError: A file is missing or is not what dqforge writes.
    """
    path = folder / RESULT
    loaded = _load_result(path)
    header = loaded["header"]
    vectors = header.get("vectors")
    try:
        prefix = check_prefix(str(header.get("prefix", "")))
    except EntryError as error:
        raise InputError(
            f"header.prefix: {error.message}; run the design again", source=str(path)
        ) from error
    if not isinstance(vectors, int) or not isinstance(header.get("reference"), dict):
        raise InputError(
            "header.vectors or header.reference is missing; run the design again", source=str(path)
        )
    try:
        reference = from_plain(header["reference"])
        kinds, further = programmes(loaded, capabilities)
    except InputError as error:
        raise InputError(error.message, source=str(path)) from error
    names = [f"{prefix}.h", f"{prefix}_vectors.h"]
    names += [name for kind in kinds.values() for name in kind.file_names(prefix)]
    return WrittenHeaders(
        {name: _read(folder / name) for name in names}, prefix, reference, vectors, tuple(further)
    )


def verify_written(found: WrittenHeaders) -> Verification:
    """Compile and run what an earlier run wrote; raises VerificationError as `verify_files`."""
    return verify_files(found.files, found.prefix, found.reference, found.vectors, found.further)


def verify_folder(folder: Path, capabilities: Capabilities = CAPABILITIES) -> Verification:
    """Compile and run what an earlier run wrote into a folder; arguments as of `read_folder`.

    Raises:
        InputError: As `read_folder`.
        VerificationError: As `verify_files`.
    """
    return verify_written(read_folder(folder, capabilities))
