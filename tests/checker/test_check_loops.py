"""The checker of the current loops confirms what is written, and finds what is planted in it."""

from __future__ import annotations

import itertools
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_current_loops import random_boxes

from dqforge.checker import check_loops as checker
from dqforge.checker import kit
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load
from dqforge.machines.errors import VerificationError
from dqforge.optimizer.certificates.cell_queue import CurrentLoopBox, loop_matrices
from dqforge.optimizer.certificates.current_loop_proof import (
    CurrentLoopProof,
    plain_inputs,
    prove_current_loops,
    prove_sensitivity,
    random_parameters,
)
from dqforge.optimizer.solution import solve
from dqforge.reports.loops.firmware_text import certificate_bytes, proof_text
from dqforge.reports.run import emitted_files
from dqforge.reports.verification.independent import check_independently

# Library drives with tolerances and a largest speed.
COVERED = (
    "teknic-m2310p",
    "anaheim-bly172s",
    "beckhoff-am8051e",
    "brusa-hsm1",
    "estun-emj-04apb",
    "hurst-dma0204024b101",
    "hurst-dmb0224c10002",
    "kollmorgen-akm44h",
    "leadshine-el5-m0400",
    "linix-45zwn24-40",
    "nanotec-db42m03",
    "scooter-hub-36v",
    "shinano-la052",
    "toyota-prius-2004",
)
# Drawn drives: those that are proven, and of them one whose box is cut.
PROVEN = (0, 3, 4, 5, 6, 7)
CUT = 6
Plain = dict[str, Any]
Change = Callable[[str, Plain], str]


def header_of(box: CurrentLoopBox, proof: CurrentLoopProof, pole_pairs: int) -> str:
    """A header with what the checker reads."""
    law = "d[k] = d[k-1] + kp (e[k] - e[k-1]) + ki_ts e[k]"
    names = ("ID_KP", "IQ_KP", "ID_KI_TS", "IQ_KI_TS")
    lines = [f"/* B{proof_text(proof, pole_pairs)[1:]}. */", f"#define D_POLE_PAIRS ({pole_pairs})"]
    lines += [f"/* PI controller of {axis}: given\n * {law}\n */" for axis in ("i_d", "i_q")]
    values = dict(zip(names, (*box.kp, *box.ki_ts), strict=True))
    constants = {f"{name}_V_PER_A": value for name, value in values.items()}
    constants |= {"T_S_S": box.t_s, "L_D_H": box.decoupling[0], "L_Q_H": box.decoupling[1]}
    lines += [f"#define D_{name} ({np.float32(x):.9g}F)" for name, x in constants.items()]
    lines += ["/* decoupling v_q += omega_e (L_D i_d + PSI_PM), v_d -= omega_e L_Q i_q */"]
    return "\n".join(lines) + "\n"


@cache
def boxes() -> list[CurrentLoopBox]:
    return random_boxes(12, 7, fast=True)


@cache
def drawn(number: int) -> tuple[str, str]:
    """Header and certificate of a drawn drive that is proven."""
    proof = prove_current_loops(boxes()[number])
    assert proof.proven
    return header_of(proof.box, proof, 4), certificate_bytes(proof).decode()


def said(header: str, certificate: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The last line that the checker prints."""
    (folder / "d.h").write_text(header)
    path = folder / "d_stability.json"
    path.write_text(certificate)
    capsys.readouterr()
    code = checker.main([str(path)])
    line = capsys.readouterr().out.splitlines()[-1]
    assert code == (1 if line.startswith("not confirmed: ") else 0)
    return line


def test_the_checker_runs_alone(tmp_path: Path) -> None:
    header, certificate = drawn(CUT)
    (tmp_path / "d.h").write_text(header)
    path = tmp_path / "d_stability.json"
    path.write_text(certificate)
    command = [sys.executable, "-I", "-S", checker.__file__, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, second = done.stdout.splitlines()
    assert first.startswith("not covered: limits of the voltage")
    assert second.startswith("confirmed: both current loops together are stable for every drive")
    left = first.replace("not covered", "not covered of both current loops")
    summary = f"confirmed: both current loops; {left}"
    assert check_independently(tmp_path).splitlines() == [summary, second]
    (tmp_path / "d.h").write_text(header.replace("PAIRS (4)", "PAIRS (5)"))
    with pytest.raises(VerificationError, match="rpm"):
        check_independently(tmp_path)


@pytest.mark.parametrize("number", PROVEN)
def test_drawn_designs(number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert said(*drawn(number), tmp_path, capsys).startswith("confirmed: ")


def test_unstable_drives_are_not_confirmed_whatever_the_witness(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    proof = prove_current_loops(boxes()[3])
    unstable = [box for n, box in enumerate(boxes()) if n not in PROVEN]
    assert all(prove_current_loops(box).counterexample is not None for box in unstable)
    for box in unstable:
        plain = json.loads(certificate_bytes(proof)) | {"inputs": plain_inputs(box)}
        line = said(header_of(box, proof, 4), json.dumps(plain), tmp_path, capsys)
        assert line.startswith("not confirmed: ")
        plain["tree"] = plain["tree"][:1]
        header = re.sub("/[*] Both.*?[*]/", "", header_of(box, proof, 4))
        line = said(header, json.dumps(plain), tmp_path, capsys)
        assert line.startswith("not confirmed: stability, row 0 ")


def single(pair: tuple[float, float]) -> tuple[float, float]:
    """What the header has of a pair."""
    return float(np.float32(pair[0])), float(np.float32(pair[1]))


def test_loops_are_those_of_other_code() -> None:
    header, certificate = drawn(CUT)
    box = boxes()[CUT]
    same = replace(
        box,
        t_s=float(np.float32(box.t_s)),
        kp=single(box.kp),
        ki_ts=single(box.ki_ts),
        decoupling=single(box.decoupling),
    )
    points = random_parameters(box, 20)
    theirs = checker.Box(json.loads(certificate)["inputs"], kit.Header(header, "d"))
    for point, matrix in zip(points, loop_matrices(same, points), strict=True):
        loop = checker.loop_of(theirs, tuple(map(Fraction, point)))
        assert loop.r < 2**20
        found = np.array([[entry / checker.ONE for entry in row] for row in loop.rows])
        np.testing.assert_allclose(found, matrix, rtol=0, atol=1e-13)


@pytest.mark.parametrize("number", PROVEN[:3])
def test_rests_hold_what_the_corners_leave_out(number: int) -> None:
    header, certificate = drawn(number)
    theirs = checker.Box(json.loads(certificate)["inputs"], kit.Header(header, "d"))
    random = np.random.default_rng(number)
    points = random_parameters(boxes()[number], 40)
    nearest = []
    for first, second in zip(points[::2], points[1::2], strict=True):
        ends = np.sort([first, second], axis=0)
        low, high = (tuple(map(Fraction, end)) for end in ends)
        bounds = np.array([float(bound) for bound in checker.rests(theirs, low, high)])
        at = random.uniform(0.2, 0.8, 4)
        chosen = np.array(list(itertools.product((0, 1), repeat=4)))
        weights = np.where(chosen == 1, at, 1.0 - at).prod(axis=1)
        corners = loop_matrices(boxes()[number], np.where(chosen == 1, ends[1], ends[0]))
        inside = loop_matrices(boxes()[number], (ends[0] + at * (ends[1] - ends[0]))[None])[0]
        rest = inside - np.einsum("v,vij->ij", weights, corners)
        found = np.array([np.linalg.norm(rest[:2, k : k + 2], 2) for k in (0, 2)])
        assert (found <= bounds).all()
        assert np.abs(rest[2:]).max() < 1e-12
        nearest.append(found / bounds)
    assert np.max(nearest, axis=0).min() > 0.2  # they are no more than a few times too large


def test_a_smaller_bound_of_the_sensitivity_is_not_confirmed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, certificate = drawn(3)
    found = prove_sensitivity(boxes()[3])
    assert found.certificate is not None
    assert found.bound is not None
    plain = json.loads(certificate)
    for bound, words in (
        (found.bound, "the sensitivity"),
        (0.99 * found.found, "sensitivity, row"),
    ):
        plain["sensitivity"] = {"bound": bound, "tree": found.certificate["tree"]}
        assert words in said(header, json.dumps(plain), tmp_path, capsys)
    plain["sensitivity"] = {"bound": found.bound, "tree": ["open"]}
    assert "are left open" in said(header, json.dumps(plain), tmp_path, capsys)
    words = "Sensitivity of both axes together up to 1; proven below {}, so that voltages"
    for shown in (f"{found.bound * 0.9:.4g}", f"{found.bound:.4g}"):
        plain["sensitivity"] = {"bound": found.bound, "tree": found.certificate["tree"]}
        line = said(f"{header}/* {words.format(shown)} */", json.dumps(plain), tmp_path, capsys)
        assert line.startswith("confirmed") == (shown == f"{found.bound:.4g}")
    del plain["sensitivity"]
    line = said(f"{header}/* {words.format(2)} */", json.dumps(plain), tmp_path, capsys)
    assert "the certificate nothing" in line


def texts(old: str, new: str) -> Change:
    """Another text in the header."""

    def change(header: str, plain: Plain) -> str:
        assert old in header
        return header.replace(old, new)

    return change


def constant(name: str, factor: float, inputs: tuple[str, int] | None) -> Change:
    """A constant of the header times a factor, and the same of the inputs where they are named."""

    def change(header: str, plain: Plain) -> str:
        value = float(re.findall(rf"D_{name} \((\S+)F\)", header)[0])
        if inputs is not None and inputs[1] < 0:
            plain["inputs"][inputs[0]] = value * factor
        elif inputs is not None:
            plain["inputs"][inputs[0]][inputs[1]] = value * factor
        return re.sub(rf"(D_{name}) \(\S+\)", rf"\1 ({value * factor:.10g}F)", header)

    return change


def end(name: str, place: int, factor: float) -> Change:
    """Another end of a range in the certificate; one that is zero becomes the factor."""

    def change(header: str, plain: Plain) -> str:
        plain["inputs"][name][place] = plain["inputs"][name][place] * factor or factor
        return header

    return change


def everywhere(change: Change) -> Change:
    """The same of a header that says nothing of its drives."""
    return lambda header, plain: re.sub("/[*] Both.*?[*]/", "", change(header, plain))


def speed(header: str, plain: Plain) -> str:
    plain["inputs"]["omega_e"] *= 2.0
    return header


def rows(work: Callable[[list[Any]], Any]) -> Change:
    """Another tree."""

    def change(header: str, plain: Plain) -> str:
        work(plain["tree"])
        return header

    return change


def entry(row: int, place: int, factor: float) -> Change:
    """An entry of a matrix, or of a cut, times a factor."""
    return rows(lambda tree: tree[row].__setitem__(place, tree[row][place] * factor))


def put(row: int, verdict: Any) -> Change:
    """Another verdict."""
    return rows(lambda tree: tree.__setitem__(row, verdict))


def without(row: int) -> Change:
    """A verdict left out."""
    return rows(lambda tree: tree.pop(row))


def repeated(row: int) -> Change:
    """A verdict put before another."""
    return rows(lambda tree: tree.insert(row, tree[row - 1]))


def planted(tree: list[Any]) -> dict[str, tuple[Change, str]]:
    """Faults by name, each with what must be said of it."""
    faults: dict[str, tuple[Change, str]] = {}
    for name, place, key in checker.CONSTANTS:
        at = (name, -1 if place is None else place)
        faults[f"last digits of {key}"] = constant(key, 1.000001, None), f"another {key}"
        faults[f"sign of {key}"] = constant(key, -1.0, at), "row|not positive"
        for factor in (0.2, 5.0):
            faults[f"{key} times {factor}"] = constant(key, factor, at), "row"
    for name in checker.RANGES:
        for place, factor in ((0, 0.99), (1, 1.01)):
            faults[f"{name} wider at {place}"] = (
                end(name, place, factor),
                f"{name}|before it begins",
            )
    for name, place in (("l_d", 0), ("l_q", 0), ("gain", 1)):
        wider = everywhere(end(name, place, 0.3 if place == 0 else 3.0))
        faults[f"{name} wider everywhere"] = wider, "row"
    for row, verdict in enumerate(tree):
        here = f"row {row} |row {row + 1} |left out at its end"
        faults[f"row {row} left out"] = without(row), "row|left out"
        faults[f"row {row} repeats"] = repeated(row), "row|left out"
        faults[f"row {row} empty"] = put(row, "empty"), f"row {row} .*holds drives"
        if len(verdict) == 2:
            faults[f"cut {row} far off"] = entry(row, 1, 100.0), f"row {row} .*outside"
            faults[f"cut {row} of no parameter"] = put(row, [4, verdict[1]]), f"row {row} "
            continue
        faults[f"row {row} open"] = put(row, "open"), "left open"
        faults[f"row {row} negative"] = put(row, [-x for x in verdict]), here
        faults[f"row {row} too short"] = put(row, verdict[:-1]), here
        for place in (0, 2, 4, 15, 18, 20):  # of phi, v, I
            faults[f"row {row}, entry {place}"] = entry(row, place, -1.0), f"row {row} "
    twice, other = "#define D_T_S_S (1.0F)", "#define D_T_S_S 1"
    faults |= {
        "one cell for all": (rows(lambda tree: tree.__setitem__(slice(None), tree[-1:])), "row 0 "),
        "no tree": (rows(lambda tree: tree.clear()), "left out"),
        "speed": (speed, "rpm"),
        "speed everywhere": (everywhere(speed), "row"),
        "pole pairs": (texts("POLE_PAIRS (4)", "POLE_PAIRS (5)"), "rpm"),
        "sign of the integral": (texts("+ ki_ts e[k]", "- ki_ts e[k]"), "another law of i_d"),
        "sign of the decoupling": (texts("v_d -= omega_e", "v_d += omega_e"), "decouple"),
        "axes exchanged": (texts("of i_q: given", "of i_d: given"), "another law of i_q"),
        "a constant twice": (texts("#define D_T_S_S", f"{twice}\n#define D_T_S_S"), "twice"),
        "a constant otherwise": (texts("#define D_T_S_S", f"{other}\n#define D_T_S_S"), "twice"),
        "a constant less": (texts("D_IQ_KP", "D_IX_KP"), "has no D_IQ_KP"),
    }  # fmt: skip
    return faults


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 5))]
)
def test_planted_faults_are_found(
    part: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    header, certificate = drawn(CUT)
    faults = planted(json.loads(certificate)["tree"])
    assert len(faults) >= 100
    missed = {}
    for name, (change, place) in list(faults.items())[part::5]:
        plain = json.loads(certificate)
        changed = change(header, plain)
        line = said(changed, json.dumps(plain), tmp_path, capsys)
        if not line.startswith("not confirmed: ") or not re.search(place, line):
            missed[name] = line
    assert missed == {}


@pytest.mark.slow
@pytest.mark.parametrize("name", COVERED)
def test_library_drives(name: str, tmp_path: Path) -> None:
    solution = solve(replace(load(name), losses=None))
    loops = solution.loops
    assert loops is not None
    assert loops.robust is not None
    assert loops.robust.proof is not None
    prefix = solution.design.export.prefix
    for file, content in emitted_files(solution).items():
        (tmp_path / file).write_bytes(content)
    path = tmp_path / f"{prefix}_stability.json"
    path.write_bytes(certificate_bytes(loops.robust.proof))
    assert checker.main([str(path)]) == 0


def test_all_library_drives_with_a_proof_are_covered() -> None:
    asked = set()
    for name in (*catalogue.names(), *catalogue.motors()):
        if "  tolerances: " in catalogue.read_text(name).decode():
            asked |= {name} if load(name).machine.omega_m_max is not None else set()
    assert asked == set(COVERED)
