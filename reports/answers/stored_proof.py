"""The certificate of the current loops that a run stored, checked again in balls."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.box_proofs.current_loop_checker import (
    Confirmation,
    confirm,
    confirm_sensitivity,
)
from dqforge.reports.loops.stability_text import CERTIFICATE
from dqforge.reports.pages.files import LARGEST_JSON, read_output


def check_stored_proof(folder: Path) -> Confirmation | None:
    """Whether the certificate of a folder proves what its ``result.json`` states.

    Bound to the drive by its inputs: those of ``result.json``, which `recompute` holds against the
    design in the folder. None where the run stored no certificate.

    Parameters
    ----------
    folder:
        What 'dqforge run' wrote.

    Raises
    ------
    VerificationError
        The certificate proves something else, or nothing; says what is wrong.
    InputError
        A file cannot be read.
    """
    result = _load(folder / "result.json")
    stated = _stated(result)
    path = folder / f"{result['header']['prefix']}{CERTIFICATE}"
    if stated is None or not path.is_file():
        return None
    certificate = _load(path)
    confirmation = confirm(certificate, stated["inputs"])
    if confirmation.fault:
        raise VerificationError(f"{path}: {confirmation.fault}")
    _check_sensitivity(path, certificate, stated)
    if confirmation.proven != stated["proven"]:
        raise VerificationError(f"{path}: it leaves open what result.json states as proven")
    return confirmation


def _check_sensitivity(
    path: Path, certificate: Mapping[str, Any], stated: Mapping[str, Any]
) -> None:
    """Raises unless the certificate proves the bound of the sensitivity that is stated."""
    bound = (stated.get("sensitivity") or {}).get("bound")
    if bound is None:
        return
    own = certificate.get("sensitivity")
    own = own if isinstance(own, Mapping) else {}
    tree = {"inputs": certificate["inputs"], "tree": own.get("tree")}
    found = confirm_sensitivity(tree, stated["inputs"], bound)
    if not found.proven:
        raise VerificationError(f"{path}: sensitivity: {found.fault or 'it leaves cells open'}")


def _load(path: Path) -> dict[str, Any]:
    content = read_output(path, "the folder that 'dqforge run' wrote", LARGEST_JSON)
    try:
        loaded = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise InputError("is not JSON; run the design again", source=str(path)) from error
    if not isinstance(loaded, dict):
        raise InputError("is not what dqforge writes; run the design again", source=str(path))
    return loaded


def _stated(result: Mapping[str, Any]) -> dict[str, Any] | None:
    """What a result says of the proof; None where it says nothing."""
    found: Any = result
    for key in ("gains", "tolerances", "stability"):
        found = found.get(key) if isinstance(found, Mapping) else None
    return found if isinstance(found, dict) else None


def stored_proof_text(found: Confirmation) -> str:
    """What was checked, in words."""
    parts = f"{found.matrices} matrices, {found.empty} cells without a drive"
    if found.proven:
        return f"both current loops together: certificate confirmed in ball arithmetic ({parts})"
    return (
        "both current loops together: what the certificate claims is confirmed in ball arithmetic "
        f"({parts}); it leaves {found.left_open} cells open"
    )
