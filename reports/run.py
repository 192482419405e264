"""The main job: solve a design, emit its header, prove the header, and
gather the files to be written.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import field, replace

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.names import Firmware
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.optimizer.firmware.solve import FirmwareFit, solve_firmware
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome, asked_for
from dqforge.reports.firmware.design_simulation import simulate_with_firmware
from dqforge.reports.firmware.target import TextFile
from dqforge.reports.firmware_files.plain import firmware_files
from dqforge.reports.firmware_files.settled import settling_verdicts
from dqforge.reports.main_header import NEUTRAL, Dialect, header_files
from dqforge.reports.observers.speed_loop_text import promise_lines, with_promise
from dqforge.reports.pages.answer import shares, stage
from dqforge.reports.pages.templating import to_text
from dqforge.reports.plain_data import PlainData
from dqforge.reports.report import render_report
from dqforge.reports.result import plain_outcome, plain_solution, programmes
from dqforge.reports.run_folder import REPORT, RESULT, listed_files
from dqforge.reports.verification.host import Verification, stated_verification, verify_files


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
