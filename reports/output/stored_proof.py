"""The certificate of the current loops that a run stored, checked again in balls."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.certificates.current_loop_proof import (
    Confirmation,
    confirm,
    confirm_sensitivity,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.loops.firmware_text import CERTIFICATE
from dqforge.reports.pages.answer import LARGEST_JSON, read_output
from dqforge.reports.pages.templating import strict_json


def check_stored_proof(
    folder: Path, solution: Solution, *, own_inputs: bool = False
) -> Confirmation | None:
    """Whether the certificate of a folder proves what the design in it states.

    None where the run stored no certificate, or the design asks for none.

    Args:
        folder: What 'dqforge run' wrote.
        solution: What the design in the folder gives; the certificate must have its inputs, to the
            bit.
        own_inputs: Whether the certificate is held against its own inputs instead: those of another
            processor, which were compared within their last digits.

    Raises:
        VerificationError: The certificate proves something else, or nothing; says what is wrong.
        InputError: The file cannot be read.
    """
    loops = solution.loops
    proof = None if loops is None or loops.robust is None else loops.robust.proof
    path = folder / f"{solution.design.export.prefix}{CERTIFICATE}"
    if proof is None or proof.certificate is None or not path.is_file():
        return None
    stored = _load(path)
    inputs = stored.get("inputs", {}) if own_inputs else proof.certificate["inputs"]
    confirmation = confirm(stored, inputs)
    if confirmation.fault:
        raise VerificationError(f"{path}: {confirmation.fault}")
    if confirmation.proven != proof.proven:
        raise VerificationError(f"{path}: it leaves open what result.json states as proven")
    bound = None if proof.sensitivity is None else proof.sensitivity.bound
    if bound is not None:
        _check_sensitivity(path, stored, inputs, bound)
    return confirmation


def _check_sensitivity(
    path: Path, stored: Mapping[str, Any], inputs: Mapping[str, Any], bound: float
) -> None:
    """Raises unless the certificate proves the bound of the sensitivity that is stated."""
    own = stored.get("sensitivity")
    tree = own.get("tree") if isinstance(own, Mapping) else None
    found = confirm_sensitivity({"inputs": stored["inputs"], "tree": tree}, inputs, bound)
    if not found.proven:
        raise VerificationError(f"{path}: sensitivity: {found.fault or 'it leaves cells open'}")


def _load(path: Path) -> dict[str, Any]:
    content = read_output(path, "the folder that 'dqforge run' wrote", LARGEST_JSON)
    try:
        loaded = strict_json(content)
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON; run the design again", source=str(path)) from error
    if not isinstance(loaded, dict):
        raise InputError("is not what dqforge writes; run the design again", source=str(path))
    return loaded


def stored_proof_text(found: Confirmation) -> str:
    """What was checked, in words."""
    matrices = "one matrix" if found.matrices == 1 else f"{found.matrices} matrices"
    parts = f"{matrices}, {found.empty} cells without a drive"
    if found.proven:
        return f"both current loops together: certificate confirmed in ball arithmetic ({parts})"
    return (
        "both current loops together: what the certificate claims is confirmed in ball arithmetic "
        f"({parts}); it leaves {found.left_open} cells open"
    )
