"""Results as plain data for ``--json`` and ``result.json``: documented,
versioned and the same bytes every time.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.entries.rules import EntryError, check_prefix
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import Emitted
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.harness import HeaderKind, Programme
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome, header_kinds
from dqforge.reports.current_reference.plain import from_plain, reference_programme, to_plain
from dqforge.reports.pages.answer import LARGEST_FILE, LARGEST_JSON, read_output
from dqforge.reports.pages.templating import strict_json
from dqforge.reports.plain_data import PlainData
from dqforge.reports.plain_design import plain_design
from dqforge.reports.verification.host import Verification, verify_files


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
    path = folder / "result.json"
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
