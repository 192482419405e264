"""What is said of a proof, stored of it, and checked again."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.certificates.current_loop_proof import (
    confirm,
    confirm_sensitivity,
    plain_inputs,
    prove_current_loops,
)
from dqforge.optimizer.solution import Solution
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Outcome, asked_for
from dqforge.reports.loops.capability import STABILITY
from dqforge.reports.loops.firmware_text import (
    certificate_bytes,
    plain_stability,
    stability_lines,
    stability_notes,
)
from dqforge.reports.loops.proven_text import gains_tables
from dqforge.reports.output.recomputation import check_stored_proof, stored_proof_text
from dqforge.reports.run import RunOutput, export_design

BOX = "{r_s: 30 %, l_d: 20 %, l_q: 20 %, v_dc: 10 %}"


def with_tolerances(line: str = BOX) -> Design:
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    text = text.replace("control:\n", f"control:\n  tolerances: {line}\n", 1)
    return load_text(text.encode(), "design.yaml", None, ["export.control=float32"])


@cache
def exported() -> RunOutput:
    return export_design(with_tolerances(), verify=False)


def solution() -> Solution:
    return exported().solution


def words(text: str) -> str:
    return " ".join(text.replace(" * ", " ").split())


@pytest.mark.slow
def test_tune_header_and_json_say_the_same() -> None:
    gains = solution().loops
    assert gains is not None
    assert gains.robust is not None
    pole_pairs = solution().design.machine.pole_pairs
    notes = stability_notes(gains, pole_pairs)
    assert len(notes) == 2
    assert "proven stable for every drive in the box at every constant speed" in notes[0]
    assert "interval arithmetic" in notes[0]
    assert "without voltage limit and without rounding" in notes[0]
    assert "proven below" in notes[1]
    tables = gains_tables(solution().design, gains)
    table = next(t for t in tables if t.title == "Worst within control.tolerances")
    assert set(notes) <= set(table.notes)
    header = words(exported().files[f"{solution().design.export.prefix}_control.h"].decode())
    for note in notes:
        assert words(note[1:]) in header
    plain = plain_stability(gains.robust)
    assert plain is not None
    assert plain["proven"] is True
    assert plain["share"] == 1.0
    stored = json.loads(exported().files["result.json"])["gains"]["tolerances"]["stability"]
    assert stored["matrices"] == plain["matrices"] > 0
    omega_m_max = solution().design.machine.omega_m_max
    assert omega_m_max is not None
    assert stored["inputs"]["omega_e"] == pytest.approx(pole_pairs * omega_m_max)


def test_without_tolerances_nothing_is_said() -> None:
    made = export_design(catalogue.load("paper001-pmsm-bench"), verify=False)
    assert made.solution.loops is not None
    assert stability_notes(made.solution.loops, 3) == ()
    assert stability_lines(made.solution.loops, 3) == []
    assert STABILITY.name not in [
        c.name for c, _ in asked_for(CAPABILITIES, Outcome(made.solution))
    ]


def test_what_is_open_is_told_with_its_share() -> None:
    gains = solution().loops
    assert gains is not None
    assert gains.robust is not None
    assert gains.robust.proof is not None
    wide = replace(gains.robust.proof.box, l_d=(1e-3, 4e-3), l_q=(1.1e-3, 4e-3))
    wide = replace(wide, kp=(4.0, 4.0), ki_ts=(0.05, 0.05))
    proof = prove_current_loops(wide, 2)
    assert not proof.proven
    assert proof.counterexample is None
    robust = replace(gains.robust, proof=proof)
    note = stability_notes(replace(gains, robust=robust), 3)[0]
    assert "proven stable for" in note
    assert "% of the drives in the box" in note
    assert "nothing is proven of drives with" in note
    assert "every drive" not in note
    plain = plain_stability(robust)
    assert plain is not None
    assert plain["proven"] is False
    assert plain["open"] > 0
    assert plain["still_open"] is not None
    unknown = replace(gains.robust, proof=None)
    assert "not proven" in stability_notes(replace(gains, robust=unknown), 3)[0]


def test_the_stored_certificate_is_confirmed_by_what_lies_in_the_file() -> None:
    gains = solution().loops
    assert gains is not None
    assert gains.robust is not None
    assert gains.robust.proof is not None
    stored = json.loads(certificate_bytes(gains.robust.proof))
    inputs = plain_inputs(gains.robust.proof.box)
    assert confirm(stored, inputs).proven
    bounded = {"inputs": stored["inputs"], "tree": stored["sensitivity"]["tree"]}
    assert confirm_sensitivity(bounded, inputs, stored["sensitivity"]["bound"]).proven


def folder(path: Path) -> Path:
    """A certificate as a run writes it."""
    gains = solution().loops
    assert gains is not None
    assert gains.robust is not None
    assert gains.robust.proof is not None
    path.mkdir()
    prefix = solution().design.export.prefix
    (path / f"{prefix}_stability.json").write_bytes(certificate_bytes(gains.robust.proof))
    return path


def test_a_folder_is_checked_and_forgeries_in_it_are_refused(tmp_path: Path) -> None:
    place = folder(tmp_path / "run")
    found = check_stored_proof(place, solution())
    assert found is not None
    assert found.proven
    assert "confirmed in interval arithmetic" in stored_proof_text(found)
    path = next(place.glob("*_stability.json"))
    good = json.loads(path.read_bytes())
    first = next(k for k, verdict in enumerate(good["tree"]) if len(verdict) == 21)
    negative = [-entry for entry in good["tree"][first]]
    forged = [
        good | {"tree": [*good["tree"][:first], negative, *good["tree"][first + 1 :]]},
        good | {"inputs": good["inputs"] | {"t_s": 2.0 * good["inputs"]["t_s"]}},
        good | {"tree": ["open"]},
        good | {"sensitivity": {"bound": 1.0, "tree": ["open"]}},
        {key: value for key, value in good.items() if key != "sensitivity"},
    ]
    for content in forged:
        path.write_text(json.dumps(content))
        with pytest.raises(VerificationError):
            check_stored_proof(place, solution())
    path.write_text("[")
    with pytest.raises(InputError, match="is not JSON"):
        check_stored_proof(place, solution())
    path.unlink()
    assert check_stored_proof(place, solution()) is None


@pytest.mark.slow
def test_the_same_design_gives_the_same_bytes() -> None:
    prove_current_loops.cache_clear()
    again = export_design(with_tolerances(), verify=False)
    for name, content in exported().files.items():
        assert hashlib.sha256(content).digest() == hashlib.sha256(again.files[name]).digest(), name
    first, second = (made.solution.loops for made in (exported(), again))
    assert first is not None
    assert second is not None
    assert first.robust is not None
    assert second.robust is not None
    assert first.robust.proof is not None
    assert second.robust.proof is not None
    assert first.robust.proof is not second.robust.proof
    assert certificate_bytes(first.robust.proof) == certificate_bytes(second.robust.proof)
