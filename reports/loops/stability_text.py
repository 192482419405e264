"""What is proven of both current loops together, in words, comment lines and plain data."""

from __future__ import annotations

import json
import math
import textwrap
from dataclasses import asdict

from dqforge.optimizer.box_proofs.current_loop_proof import CurrentLoopProof, DriveRange
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.loops.robustness import RobustSet
from dqforge.reports.plain_data import PlainData

_PARAMETERS = ("b_d", "b_q", "s_Ohm", "x")

_WIDTH = 100

CERTIFICATE = "_stability.json"

"""How the file of a certificate ends, behind the prefix of the design."""


def _between(values: tuple[float, float], scale: float = 1.0) -> str:
    low, high = (f"{value * scale:.4g}" for value in values)
    return low if low == high else f"{low} to {high}"


def _rpm(omega_e: float, pole_pairs: int) -> float:
    return omega_e / pole_pairs * 30.0 / math.pi


def proof_text(proof: CurrentLoopProof, pole_pairs: int) -> str:
    """What is proven, of which drives, and what is not; one sentence or two.

    Parameters
    ----------
    proof:
        The proof.
    pole_pairs:
        Of the machine, for its speeds.
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
        "confirmed in ball arithmetic), the rest too close to the border to decide; nothing is "
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


def stability_notes(gains: GainSet, pole_pairs: int) -> tuple[str, ...]:
    """What is proven of both current loops over the tolerances; nothing without them."""
    robust = gains.robust
    if robust is None or gains.phases is not None:
        return ()
    if robust.proof is None:
        return ("both current loops together: not proven, machine.max_speed is not known",)
    return (proof_text(robust.proof, pole_pairs),)


def stability_lines(gains: GainSet | None, pole_pairs: int) -> list[str]:
    """The same as comment lines of a header."""
    notes = () if gains is None else stability_notes(gains, pole_pairs)
    lines = []
    for note in notes:
        lines += textwrap.wrap(f"Stability: {note}.", _WIDTH)
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
        "inputs": asdict(proof.box),
    }


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
    lines = ",\n".join(json.dumps(verdict) for verdict in proof.certificate["tree"])
    head = json.dumps({"format": 1, "parameters": list(_PARAMETERS)})[1:-1]
    inputs = json.dumps(proof.certificate["inputs"])
    return f'{{{head},\n"inputs": {inputs},\n"tree": [\n{lines}\n]}}\n'.encode("ascii")
