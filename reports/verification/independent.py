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

from dqforge.checker import check_certificate as checker
from dqforge.checker import check_loops, check_ranges
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.solution import Solution
from dqforge.reports.loops.firmware_text import CERTIFICATE
from dqforge.reports.plain_data import PlainData
from dqforge.reports.verification.range_claims import RANGES

SUFFIX = "_certificate.json"
_MOST_BOXES = 1500  # Boxes that are looked at before the claim is left.
_NARROWEST = Fraction(1, 2**64)  # Of the domain: a box that is not confirmed there is left.

# What the header's certificate leaves to the one beside it.
_LOOPS = "confirmed by check_loops.py in a folder of 'dqforge run'"
_RANGES = "confirmed by check_ranges.py, unless phases are controlled one by one"

Boxes = list[tuple[Fraction, Fraction]]


def certificate_files(solution: Solution, files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The certificate of the main header, by its name; none where no claim of it is confirmed.

    Args:
        solution: What was solved.
        files: The headers by name, as they are written.
    """
    prefix = solution.design.export.prefix
    header = checker.Header(files[f"{prefix}.h"].decode("utf-8"), prefix)
    claims, left = [], _not_covered(solution)
    machine = _machine(solution)
    if solution.certificate is not None:
        try:
            claims.append(_reference_claim(solution, header, machine))
        except checker.Fault as why:
            left.insert(0, f"reference over torque ({why})")
    if not claims:
        return {}
    plain = {"format": 1, "not_covered": left, "machine": machine, "claims": claims}
    return {f"{prefix}{SUFFIX}": _bytes(plain)}


def _machine(solution: Solution) -> dict[str, str]:
    """The machine as the certificate has it: decimal numbers in SI."""
    machine = solution.design.machine
    values = (machine.pole_pairs, machine.r_s, machine.l_d, machine.l_q, machine.psi_pm)
    return {
        name: repr(value if index == 0 else float(value))
        for index, (name, value) in enumerate(zip(checker.CONSTANTS, values, strict=True))
    }


def _not_covered(solution: Solution) -> list[str]:
    """What the design has or states and the certificate says nothing of."""
    loops = solution.loops
    robust = None if loops is None else loops.robust
    parts = {
        "reference of negative torque": solution.negative,
        "reference over torque and flux linkage": solution.weakening,
        "references in fixed point": solution.fixed_references or None,
        f"ranges of the control in fixed point ({_RANGES})": solution.fixed or None,
        f"current loops over the tolerances ({_LOOPS})": robust,
        "speed loop": None if loops is None else loops.speed,
        "position observer": solution.observer_proof,
    }
    return [name for name, there in parts.items() if there is not None]


def _reference_claim(
    solution: Solution, header: checker.Header, machine: dict[str, str]
) -> PlainData:
    """The claim of the reference over torque, with boxes on which the checker confirms it.

    Raises:
        Fault: It is of a kind that the checker does not know, or is not confirmed; says why.
    """
    reference, proof = solution.reference, solution.certificate
    assert proof is not None
    if not isinstance(solution.design.machine, LinearMachine):
        raise checker.Fault("a machine whose inductances change")
    if isinstance(reference, FixedReference):
        raise checker.Fault("in fixed point")
    if proof.voltage_excess is not None or solution.negative is not None:
        raise checker.Fault("limited by the voltage, or not the same for both signs of the torque")
    stated = checker.STATED.search(header.said)
    if stated is None:
        raise checker.Fault("bounds that the checker does not know")
    bounds = {name: stated[name] for name in checker.BOUNDS}
    exact = checker.read_machine(machine, header)
    judge = checker.Reference(header, exact, stated["strategy"], bounds)
    judge.check_beyond()
    edges = {checker.number(text) for text in re.findall(r"< ([\d.e+-]+F)", judge.body)}
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
        except checker.Fault:
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
    can import nothing of dqforge.

    Raises:
        InputError: There is no certificate in the folder, or more than one of a kind.
        VerificationError: A claim is not confirmed; names the place.
    """
    said = []
    for program, suffix in (
        (checker.__file__, SUFFIX),
        (check_loops.__file__, CERTIFICATE),
        (check_ranges.__file__, RANGES),
    ):
        found = sorted(folder.glob(f"*{suffix}"))
        if len(found) > 1:
            raise InputError(f"--independent: {folder} has {len(found)} files *{suffix}; keep one")
        said += [_confirmed(Path(program), path) for path in found]
    if not said:
        raise InputError(
            f"--independent: {folder} has no certificate; 'dqforge run' writes one "
            "where claims can be confirmed"
        )
    return "\n".join(said)


def _confirmed(program: Path, path: Path) -> str:
    """What a checker says of a certificate; raises as `check_independently`."""
    command = [sys.executable, "-I", "-S", str(program), str(path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=600)
    said = ended.stdout.strip()
    if ended.returncode != 0:
        raise VerificationError(f"{path}: {(said or ended.stderr.strip()).splitlines()[-1]}")
    return said
