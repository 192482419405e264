"""What is proven of both current loops together, in words, comment lines and plain data."""

from __future__ import annotations

import json
import math
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dqforge.optimizer.box_proofs.current_loop_model import BoxDrive
    from dqforge.optimizer.box_proofs.current_loop_proof import (
        CurrentLoopProof,
        DriveRange,
        ProvenSensitivity,
    )
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.loops.robustness import RobustSet
    from dqforge.reports.plain_data import PlainData

_PARAMETERS = ("b_d", "b_q", "s_Ohm", "x")
_WIDTH = 100

# How the file of a certificate ends, behind the prefix of the design.
CERTIFICATE = "_stability.json"


def _between(values: tuple[float, float], scale: float = 1.0) -> str:
    low, high = (f"{value * scale:.4g}" for value in values)
    return low if low == high else f"{low} to {high}"


def _rpm(omega_e: float, pole_pairs: int) -> float:
    return omega_e / pole_pairs * 30.0 / math.pi


def proof_text(proof: CurrentLoopProof, pole_pairs: int) -> str:
    """What is proven, of which drives, and what is not; one sentence or two.

    Args:
        proof: The proof.
        pole_pairs: Of the machine, for its speeds.
    """
    if not proof.proven:
        return f"both current loops together: {_open_text(proof, pole_pairs)}"
    assert proof.confirmation is not None
    count = proof.confirmation.matrices
    cells = "one cell" if count == 1 else f"{count} cells"
    return (
        "both current loops together: proven stable for every drive in the box at every constant "
        f"speed up to {_rpm(proof.box.omega_e, pole_pairs):.4g} rpm either way ({cells}, confirmed "
        f"in ball arithmetic): {scope_text(proof)}"
    )


def _open_text(proof: CurrentLoopProof, pole_pairs: int) -> str:
    confirmation = proof.confirmation
    if confirmation is None or confirmation.fault or proof.still_open is None:
        return "not proven stable over the box; corners and points inside are"
    share = math.floor(proof.share * 1000.0) / 10.0
    return (
        f"proven stable for {share:.1f} % of the drives in the box ({confirmation.matrices} cells, "
        "confirmed in ball arithmetic), the rest not decided within the budget: too close to the "
        "border; nothing is "
        f"proven of drives with {_range_text(proof.still_open, pole_pairs)}; {scope_text(proof)}"
    )


def _range_text(left: DriveRange, pole_pairs: int) -> str:
    speeds = tuple(_rpm(omega, pole_pairs) for omega in left.omega_e)
    return (
        f"{_between(left.r_s)} Ohm, l_d {_between(left.l_d, 1e3)} mH, l_q "
        f"{_between(left.l_q, 1e3)} mH, voltage gain {_between(left.gain)} at "
        f"{_between((speeds[0], speeds[1]))} rpm"
    )


def scope_text(proof: CurrentLoopProof) -> str:
    """The drives that the proof is about, and what it leaves aside."""
    box = proof.box
    parts = [f"resistance {_between(box.r_s)} Ohm"]
    if box.dead_time != (0.0, 0.0):
        parts.append(f"dead time worth {_between(box.dead_time)} Ohm")
    parts += [
        f"l_d {_between(box.l_d, 1e3)} mH",
        f"l_q {_between(box.l_q, 1e3)} mH",
        f"voltage gain {_between(box.gain)}",
    ]
    return (
        f"{', '.join(parts)}, each constant; with the gains as they stand, without voltage limit "
        "and without rounding of the control"
    )


def proof_summary(proof: CurrentLoopProof) -> str:
    """What is proven in a few words."""
    if proof.proven:
        return "proven stable together for every drive within the tolerances"
    share = math.floor(proof.share * 1000.0) / 10.0
    return f"proven stable together for {share:.1f} % of the drives within the tolerances"


def drive_text(drive: BoxDrive, pole_pairs: int) -> str:
    """A drive in words: ``2000 rpm, 1.6 Ohm, l_d 1.3 mH, l_q 2.1 mH, voltage gain 1.1``."""
    return (
        f"{_rpm(drive.omega_e, pole_pairs):.4g} rpm, {drive.r_s:.4g} Ohm, "
        f"l_d {drive.l_d * 1e3:.4g} mH, l_q {drive.l_q * 1e3:.4g} mH, voltage gain {drive.gain:.4g}"
    )


def sensitivity_text(robust: RobustSet, pole_pairs: int) -> str:
    """Sensitivity of both axes together beside that of each alone; empty where it is not known."""
    found = None if robust.proof is None else robust.proof.sensitivity
    if found is None:
        return ""
    alone = max(robust.i_d.max_sensitivity.value, robust.i_q.max_sensitivity.value)
    least = f"sensitivity of both axes together up to {found.found:.2f} "
    least += f"({drive_text(found.at, pole_pairs)}), axis by axis up to {alone:.2f}"
    if found.bound is None:
        return f"{least}; a bound of the first is not decided within the budget"
    turn = math.degrees(2.0 * math.asin(min(1.0, 0.5 / found.bound)))
    return (
        f"{least}; proven below {found.bound:.4g}, so that voltages turned by any constant angle "
        f"up to {math.floor(10.0 * turn) / 10.0:.1f} deg leave the loops stable"
    )


def stability_notes(gains: GainSet, pole_pairs: int) -> tuple[str, ...]:
    """What is proven of both current loops over the tolerances; nothing without them."""
    robust = gains.robust
    if robust is None or gains.phases is not None:
        return ()
    if robust.proof is None:
        return ("both current loops together: not proven, machine.max_speed is not known",)
    notes = (proof_text(robust.proof, pole_pairs), sensitivity_text(robust, pole_pairs))
    return tuple(note for note in notes if note)


def stability_lines(gains: GainSet | None, pole_pairs: int) -> list[str]:
    """The same as comment lines of a header."""
    notes = () if gains is None else stability_notes(gains, pole_pairs)
    lines = []
    for note in notes:
        lines += textwrap.wrap(f"{note[0].upper()}{note[1:]}.", _WIDTH)
    return ["", *lines] if lines else []


def plain_stability(robust: RobustSet) -> PlainData | None:
    """What is proven as plain data; None where nothing was asked."""
    proof = robust.proof
    if proof is None or proof.confirmation is None:
        return None
    return {
        "proven": proof.proven,
        "share": proof.share,
        "matrices": proof.confirmation.matrices,
        "empty": proof.confirmation.empty,
        "open": proof.confirmation.left_open,
        "still_open": None if proof.still_open is None else _plain_range(proof.still_open),
        "sensitivity": _plain_sensitivity(proof.sensitivity),
        "inputs": asdict(proof.box),
    }


def _plain_sensitivity(found: ProvenSensitivity | None) -> PlainData | None:
    if found is None:
        return None
    at = {
        "r_s_Ohm": found.at.r_s,
        "l_d_H": found.at.l_d,
        "l_q_H": found.at.l_q,
        "voltage_gain": found.at.gain,
        "omega_e_rad_per_s": found.at.omega_e,
    }
    return {"found": found.found, "at": at, "bound": found.bound}


def _plain_range(left: DriveRange) -> PlainData:
    return {
        "r_s_Ohm": left.r_s,
        "l_d_H": left.l_d,
        "l_q_H": left.l_q,
        "voltage_gain": left.gain,
        "omega_e_rad_per_s": left.omega_e,
    }


def certificate_bytes(proof: CurrentLoopProof) -> bytes:
    """A certificate as a file: JSON with a line per cell."""
    assert proof.certificate is not None
    parts = [
        json.dumps({"format": 1, "parameters": list(_PARAMETERS)})[1:-1],
        f'"inputs": {json.dumps(proof.certificate["inputs"])}',
        f'"tree": {_rows(proof.certificate["tree"])}',
    ]
    found = proof.sensitivity
    if found is not None and found.certificate is not None:
        bound, tree = json.dumps(found.bound), _rows(found.certificate["tree"])
        parts.append(f'"sensitivity": {{"bound": {bound}, "tree": {tree}}}')
    return ("{\n" + ",\n".join(parts) + "\n}\n").encode("ascii")


def _rows(tree: list[Any]) -> str:
    rows = ",\n".join(json.dumps(verdict) for verdict in tree)
    return f"[\n{rows}\n]"
