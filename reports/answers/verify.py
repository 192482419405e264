"""What `dqforge verify` answers: a folder computed again, its C compiled and run,
and the outcome per header.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from dqforge.machines.errors import InputError
from dqforge.reports.firmware.written_files import read_back_text, written_firmware
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.output.recomputation import (
    Recomputation,
    check_stored_proof,
    recomputation_text,
    recompute,
    stored_proof_text,
)
from dqforge.reports.output.signatures import check_signature
from dqforge.reports.pages.answer import Answer, stage
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run import WrittenHeaders, read_folder, verify_written
from dqforge.reports.verification.cortex_m import verify_on_target
from dqforge.reports.verification.cross_tools import core_named, target_of
from dqforge.reports.verification.host import Verification
from dqforge.reports.verification.independent import check_independently
from dqforge.reports.verification.text import plain_verification, target_text, verification_text


def answer_verify(
    folder: Path, target: str | None, independent: bool = False, signature: str | None = None
) -> Answer:
    """Verify a folder, on an emulated core as well where one is named, its certificate by the
    independent checker and its signature by a command where asked for.

    Raises:
        InputError: The folder is not what dqforge writes, the command refuses its signature, or
            there is no such core.
        VerificationError: Something differs; the message names the first difference.
    """
    if target is not None:
        target = core_named(target)
        target_of(target)
    # All that follows needs it; better said before the rest is computed than after.
    require_compiler()
    signed = [] if signature is None else [check_signature(signature, folder)]
    stage("computing again")
    recomputed = recompute(folder)
    notes, plain = [*signed, recomputation_text(recomputed)], _plain_recomputation(recomputed)
    plain = {"recomputation": plain, "verification": None, "headers": []}
    if signed:
        plain["signature"] = signed[0]
    solution = recomputed.solution
    if solution is None:
        if target is not None:
            raise InputError(f"--target: there are no headers in {folder}; name a folder of a run")
        if independent:
            raise InputError(f"--independent: there are no headers in {folder}; name that of a run")
        return Answer(str(folder), (), plain, notes=tuple(notes))
    found = read_folder(folder)
    stage("compiling and comparing")
    verified = verify_written(found)
    proof = check_stored_proof(folder, solution, own_inputs=bool(recomputed.digits))
    theirs = written_firmware(folder, solution)
    notes.append(verification_text(verified))
    notes += [read_back_text(name, files) for name, files in theirs.items()]
    notes += [] if proof is None else [stored_proof_text(proof)]
    plain["verification"] = plain_verification(verified)
    plain["headers"] = _plain_headers(found, verified)
    if theirs:
        plain["firmware"] = {name: list(files) for name, files in theirs.items()}
    if proof is not None:
        plain["stability"] = asdict(proof) | {"proven": proof.proven}
    if independent:
        stage("checking the certificate")
        plain["independent"] = check_independently(folder).splitlines()
        notes += plain["independent"]
    if target is not None:
        stage(f"running on {target}")
        outcome = verify_on_target(found.files, found.prefix, target, found.programmes)
        notes.append(target_text(outcome))
        plain["target"] = asdict(outcome)
    return Answer(str(folder), (), plain, notes=tuple(notes))


def _plain_recomputation(found: Recomputation) -> PlainData:
    """What equals the design in the folder, and which files were not computed again."""
    return {
        "digest": found.digest,
        **asdict(found.tally),
        "listed": list(found.listed),
        "line_ends": list(found.line_ends),
        "foreign": list(found.foreign),
        "digits": list(found.digits),
        "stale": list(found.stale),
    }


def _plain_headers(found: WrittenHeaders, verified: Verification) -> list[PlainData]:
    """Per header how many results equal its model, in each language that was tried."""
    return [
        {
            "name": programme.name,
            "results": programme.inputs.shape[0],
            "standards": list(verified.languages),
        }
        for programme in found.programmes
    ]
