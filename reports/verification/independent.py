"""The certificates beside a header, and the programs that confirm them apart from all of this.

A claim is written down only where that program confirms it: the boxes of torques that it needs are
cut here with its own verdicts.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from dqforge.checker import check_certificate as checker
from dqforge.checker import (
    check_loops,
    check_observer,
    check_ranges,
    check_speed,
    check_surface,
    kit,
    margins,
)
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.solution import Solution
from dqforge.reports.loops.firmware_text import CERTIFICATE
from dqforge.reports.observers.position_text import rounded_up
from dqforge.reports.plain_data import PlainData
from dqforge.reports.verification.range_claims import RANGES

SUFFIX, SPEED_SUFFIX, OBSERVER_SUFFIX = "_certificate.json", "_speed.json", "_observer.json"
SURFACE_SUFFIX = "_surface.json"
_MOST_BOXES = 1500  # Boxes that are looked at before the claim is left.
_NARROWEST = Fraction(1, 2**64)  # Of the domain: a box that is not confirmed there is left.


def _left_to(program: str) -> str:
    """How a certificate names the program that something is left to."""
    return f"left to {program}"


# What the header's certificate leaves to the one beside it.
_LOOPS, _SPEED, _OBSERVER, _RANGES, _SURFACE = (
    _left_to(f"check_{about}.py") for about in ("loops", "speed", "observer", "ranges", "surface")
)

# The programs, with the certificate that each reads and what that is about.
_PROGRAMS = (
    (checker, SUFFIX, "the current reference"),
    (check_loops, CERTIFICATE, "both current loops"),
    (check_speed, SPEED_SUFFIX, "the speed loop"),
    (check_observer, OBSERVER_SUFFIX, "the position observer"),
    (check_ranges, RANGES, "ranges in fixed point"),
    (check_surface, SURFACE_SUFFIX, "field weakening"),
)

Boxes = list[tuple[Fraction, Fraction]]


def certificate_files(solution: Solution, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The certificates of the main header, the speed loop, the position observer and field
    weakening, by their names; none of those of which no claim is confirmed.

    Args:
        solution: What was solved.
        files: The headers by name, as they are written.
    """
    prefix = solution.design.export.prefix
    text = files[f"{prefix}.h"].decode("utf-8")
    header = kit.Header(text, prefix)
    further = files.get(f"{prefix}_control.h", b"").decode("utf-8")
    speed = _speed_claim(solution, kit.Header(text, prefix, further), further)
    observer = _observer_claim(solution, files.get(f"{prefix}_observer.h", b"").decode("utf-8"))
    surface = _surface_claim(
        solution, files.get(f"{prefix}_weakening.h", b"").decode("utf-8"), text
    )
    rest = {SPEED_SUFFIX: speed, OBSERVER_SUFFIX: observer, SURFACE_SUFFIX: surface}
    found = {f"{prefix}{suffix}": claim for suffix, claim in rest.items() if claim is not None}
    claims, left = [], _not_covered(solution)
    machine = _machine(solution)
    if solution.certificate is not None:
        try:
            claims.append(_reference_claim(solution, header, machine))
        except kit.Fault as why:
            left.insert(0, f"reference over torque ({why})")
    if not claims:
        return found
    margin_claims = _margin_claims(solution, header, further, left)
    left += ["margins over the tolerances, crossovers, delay margins"] if margin_claims else []
    claims += margin_claims
    plain = {"format": 1, "not_covered": left, "machine": machine, "claims": claims}
    return {f"{prefix}{SUFFIX}": _bytes(plain), **found}


def _speed_claim(solution: Solution, header: kit.Header, control: str) -> bytes | None:
    """The certificate of the speed loop, JSON with a line per matrix; None where its checker does
    not confirm it.
    """
    proof = None if solution.loops is None else solution.loops.proofs.speed
    if proof is None or proof.certificate is None:
        return None
    tree = ",\n".join(_verdict_text(verdict) for verdict in proof.certificate["tree"])
    inputs = json.dumps(proof.certificate["inputs"])
    text = f'{{\n"format": 1, "inputs": {inputs},\n"tree": [\n{tree}\n]\n}}\n'
    try:
        check_speed.check_speed(kit.plain(text), header, control)
    except kit.Fault:
        return None
    return text.encode("ascii")


def _observer_claim(solution: Solution, header: str) -> bytes | None:
    """The certificate of the position observer; None where its checker does not confirm it."""
    proof = solution.observer_proof
    if proof is None or proof.contraction is None or not proof.matrix or not header:
        return None
    matrix = [float(f"{row[k]:.12g}") for n, row in enumerate(proof.matrix) for k in range(n, 4)]
    plain = {
        "format": 1,
        "omega_e": [proof.omega_low, proof.omega_high],
        "i_q": proof.i_q,
        "contraction": rounded_up(proof.contraction),
        "matrix": matrix,
    }
    text = json.dumps(plain) + "\n"
    try:
        stated = kit.plain(text)
        check_observer.check_observer(stated, header, solution.design.export.prefix)
    except kit.Fault:
        return None
    return text.encode("ascii")


def _surface_claim(solution: Solution, header: str, main: str) -> bytes | None:
    """The certificate of field weakening with all bounds that the header states as proven; None
    where its checker does not confirm them.
    """
    fit, prefix = solution.weakening, solution.design.export.prefix
    if fit is None or fit.certificate is None or not header:
        return None
    if not isinstance(solution.design.machine, LinearMachine):
        return None
    limits = (fit.region.i_max, fit.domain.v_max, fit.domain.omega_e)
    plain: dict[str, Any] = {"format": 1, "machine": _machine(solution)}
    plain |= zip(check_surface.LIMITS, (repr(float(each)) for each in limits), strict=True)
    try:
        said = check_surface.Surface(header, prefix).said
        plain["bounds"] = {name: said[name] for name in check_surface.BOUNDS if said[name]}
        check_surface.check_surface(plain, header, main, prefix)
    except kit.Fault:
        return None
    return (json.dumps(plain, indent=1) + "\n").encode("ascii")


def _verdict_text(verdict: Any) -> str:
    """A cut or a word as it stands, matrices to twelve digits and a line each."""
    if isinstance(verdict, str) or not isinstance(verdict[0], list):
        return json.dumps(verdict)
    matrices = ([float(f"{entry:.12g}") for entry in matrix] for matrix in verdict)
    return "[" + ",\n".join(json.dumps(matrix) for matrix in matrices) + "]"


def _machine(solution: Solution) -> dict[str, str]:
    """The machine as the certificate has it: decimal numbers in SI."""
    machine = solution.design.machine
    values = (machine.pole_pairs, machine.r_s, machine.l_d, machine.l_q, machine.psi_pm)
    return {
        name: repr(value if index == 0 else float(value))
        for index, (name, value) in enumerate(zip(kit.MACHINE, values, strict=True))
    }


def _not_covered(solution: Solution) -> list[str]:
    """What the design has or states and the certificate says nothing of."""
    loops = solution.loops
    robust = None if loops is None else loops.robust
    parts = {
        "reference of negative torque": solution.negative,
        f"reference over torque and flux linkage ({_SURFACE})": solution.weakening,
        "references in fixed point": solution.fixed_references or None,
        f"ranges of the control in fixed point ({_RANGES})": solution.fixed or None,
        f"current loops over the tolerances ({_LOOPS})": robust,
        f"speed loop over the tolerances ({_SPEED})": None if loops is None else loops.speed,
        f"position observer ({_OBSERVER})": solution.observer_proof,
    }
    return [name for name, there in parts.items() if there is not None]


def _reference_claim(solution: Solution, header: kit.Header, machine: dict[str, str]) -> PlainData:
    """The claim of the reference over torque, with boxes on which the checker confirms it.

    Raises:
        Fault: It is of a kind that the checker does not know, or is not confirmed; says why.
    """
    reference, proof = solution.reference, solution.certificate
    assert proof is not None
    if not isinstance(solution.design.machine, LinearMachine):
        raise kit.Fault("a machine whose inductances change")
    if isinstance(reference, FixedReference):
        raise kit.Fault("in fixed point")
    if proof.voltage_excess is not None or solution.negative is not None:
        raise kit.Fault("limited by the voltage, or not the same for both signs of the torque")
    stated = checker.STATED.search(header.said)
    if stated is None:
        raise kit.Fault("bounds that the checker does not know")
    bounds = {name: stated[name] for name in checker.BOUNDS}
    exact = kit.read_machine(machine, header)
    judge = checker.Reference(header, exact, stated["strategy"], bounds)
    judge.check_beyond()
    edges = {kit.number(text) for text in re.findall(r"< ([\d.e+-]+F)", judge.body)}
    inner = {edge for edge in edges if 0 < edge < judge.largest}
    boxes = _confirmed_boxes(judge, sorted(inner | {judge.largest}))
    return {
        "name": "reference",
        "statement": judge.statement(stated["strategy"]),
        "code": judge.body,
        "strategy": stated["strategy"],
        "bounds": bounds,
        "boxes": [[str(low), str(high)] for low, high in boxes],
    }


def _margin_claims(
    solution: Solution, header: kit.Header, control: str, left: list[str]
) -> list[PlainData]:
    """The claim of the margins of each loop alone, and of the speed observer; ``left`` takes on
    what is not confirmed, and why.
    """
    loops, design = solution.loops, solution.design
    if loops is None:
        return []
    tried: dict[str, PlainData] = {
        f"margins of {name}": {"axes": [name[-1]]} for name in ("i_d", "i_q")
    }
    seen = (loops.observer, loops.position, loops.tracker, loops.measured_speed)
    if loops.speed is not None and any(each is not None for each in seen):
        left.append("margins of the speed loop (on a speed that is observed)")
    elif loops.speed is not None:
        speed = _one_drive(design, loops.i_q, loops.speed)
        tried["margins of the speed loop"] = {"axes": [], "speed": speed}
    if loops.observer is not None:
        shaft = {"inertia": design.machine.inertia, "friction": design.machine.friction}
        tried["the speed observer"] = {"axes": [], "observer": shaft}
    kept: dict[str, Any] = {"name": "margins", "axes": []}
    for name, claim in tried.items():
        try:
            list(margins.check_margins(kit.plain(json.dumps(claim)), header, control))
        except kit.Fault as why:
            left.append(f"{name} ({why})")
        else:
            kept["axes"] += claim["axes"]
            kept |= {key: value for key, value in claim.items() if key != "axes"}
    return [kept] if kept["axes"] or len(kept) > 2 else []


def _one_drive(design: Design, i_q: LoopGains, speed: LoopGains) -> PlainData:
    """The inputs of the speed loop's certificate for the drive without deviations."""
    settings, machine = design.control.speed_loop, design.machine
    assert settings is not None
    drive = (machine.r_s, 0, machine.l_q, 1, 1, machine.inertia, 0)
    spans = zip(check_speed.SPANS, drive, strict=True)
    found: dict[str, Any] = {name: [value, value] for name, value in spans}
    found |= {"t_s": design.control.t_s, "kp": i_q.kp, "ki_ts": i_q.ki_ts}
    found |= {"speed_kp": speed.kp, "speed_ki_ts": speed.ki_ts, "ratio": settings.ratio}
    found |= {"friction": machine.friction, "filter_time": settings.filter_time}
    return found | {"inductance_scale": machine.l_q, "speed_scale": 1.0 / speed.kp}


def _confirmed_boxes(judge: checker.Reference, ends: list[Fraction]) -> Boxes:
    """Boxes from zero to the last end, none across an end, all confirmed.

    Raises:
        Fault: One is not, however narrow.
    """
    waiting: Boxes = list(zip([Fraction(0), *ends[:-1]], ends, strict=True))[::-1]
    found: Boxes = []
    tried = 0
    while waiting:
        low, high = waiting.pop()
        tried += 1
        try:
            judge.check(low, high)
        except kit.Fault:
            if tried > _MOST_BOXES or high - low < ends[-1] * _NARROWEST:
                raise
            middle = (low + high) / 2
            waiting += [(middle, high), (low, middle)]
        else:
            found.append((low, high))
    return found


def _bytes(plain: PlainData) -> bytes:
    """A certificate as a file: JSON with a line per box."""
    text = json.dumps(plain, indent=1)
    text = re.sub(r'\[\s+("[^"]+"),\s+("[^"]+")\s+\]', r"[\1, \2]", text)
    return (text + "\n").encode("ascii")


def check_independently(folder: Path) -> str:
    """What the checkers say of the certificates in a folder, each run as a program of its own that
    can import nothing of dqforge: what is confirmed and what is not covered, and then each claim.

    Raises:
        InputError: There is no certificate in the folder, or more than one of a kind.
        VerificationError: A claim is not confirmed; names the place.
    """
    claims, left = [], {}
    for program, suffix, about in _PROGRAMS:
        found = sorted(folder.glob(f"*{suffix}"))
        if len(found) > 1:
            raise InputError(f"--independent: {folder} has {len(found)} files *{suffix}; keep one")
        for path in found:
            file = Path(str(program.__file__))
            first, *said = _confirmed(file, path)
            more = " and margins of loops" if any(" phase margin " in line for line in said) else ""
            left[file.name] = about + more, first.removeprefix("not covered: ").split("; ")
            claims += said
    if not left:
        raise InputError(
            f"--independent: {folder} has no certificate; 'dqforge run' writes one "
            "where claims can be confirmed"
        )
    others = [f"({_left_to(name)})" for name in left]  # what one leaves to them is covered
    parts = []
    for about, words in left.values():
        kept = [each for each in words if not each.endswith(tuple(others))]
        parts += [f"of {about}: {', '.join(kept)}"] if kept else []
    confirmed = ", ".join(about for about, _ in left.values())
    return "\n".join([f"confirmed: {confirmed}; not covered {'; '.join(parts)}", *claims])


def _confirmed(program: Path, path: Path) -> list[str]:
    """What a checker says of a certificate, line by line; raises as `check_independently`."""
    command = [sys.executable, "-I", "-S", str(program), str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    said = ended.stdout.strip()
    if ended.returncode != 0:
        raise VerificationError(f"{path}: {(said or ended.stderr.strip()).splitlines()[-1]}")
    return said.splitlines()
