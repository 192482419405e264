"""The independent checker confirms what is written, and finds what is planted in it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pytest
from drawn_cases import seed
from drawn_machines import factors
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, make_design

from dqforge.checker import check_certificate as checker
from dqforge.machines.design.catalogue import load
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import FitForm
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.run import emitted_files
from dqforge.reports.verification.independent import certificate_files, check_independently

COVERED = (
    "abb-ipmsm-2k2",
    "abb-syrm-6k7",
    "paper000-ipmsm-100kw",
    "paper001-pmsm-bench",
    "paper002-phase-waveforms",
    "paper002-pmsm-nonsinusoidal",
    "salient-phase-waveforms",
    "thor-pmsyrm-5k",
    "vdyno-trampa-6340",
)
Plain = dict[str, Any]
# A header and its certificate, changed.
Change = Callable[[str, Plain], str]


def solved(design: Design) -> Solution:
    """A design without what no certificate is about."""
    return solve(replace(design, losses=None))


def written(solution: Solution, folder: Path) -> Path:
    """The certificate of a design in a folder, beside its header."""
    files = emitted_files(solution)
    prefix = solution.design.export.prefix
    certified = certificate_files(solution, files)
    assert list(certified) == [f"{prefix}_certificate.json"]
    (folder / f"{prefix}.h").write_bytes(files[f"{prefix}.h"])
    path = folder / f"{prefix}_certificate.json"
    path.write_bytes(certified[path.name])
    return path


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The certificate of a machine with constant inductances and an odd number of pole pairs."""
    return written(solved(make_design(INVERSE_SALIENT)), tmp_path_factory.mktemp("sound"))


def test_the_checker_runs_alone_and_says_first_what_is_left_out(sound: Path) -> None:
    command = [sys.executable, "-I", "-S", checker.__file__, str(sound)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    first, second, *loops = done.stdout.splitlines()
    left = "speed loop over the tolerances (left to check_speed.py)"
    observed = "margins of the speed loop (on a speed that is observed)"
    over = "margins over the tolerances, crossovers, delay margins"
    assert first == f"not covered: {left}; {observed}; {over}"
    assert second.startswith("confirmed: for every torque from 0 to ")
    begins = ("i_d: no pole", "i_q: no pole", "errors of the speed observer shrink to ")
    assert len(loops) == len(begins)
    for line, words in zip(loops, begins, strict=True):
        assert line.startswith(f"confirmed: {words}")
    about = "the current reference and margins of loops"
    summary = f"confirmed: {about}; not covered of {about}: {left}, {observed}, {over}"
    assert check_independently(sound.parent).splitlines() == [summary, second, *loops]


def test_a_folder_is_checked_in_a_process_of_its_own(sound: Path, tmp_path: Path) -> None:
    assert "confirmed: " in check_independently(sound.parent)
    with pytest.raises(InputError, match="has no certificate"):
        check_independently(tmp_path)
    (tmp_path / sound.name).write_bytes(sound.read_bytes())
    header = sound.parent / "drive.h"
    (tmp_path / "drive.h").write_text(
        header.read_text().replace("POLE_PAIRS (3)", "POLE_PAIRS (4)")
    )
    with pytest.raises(VerificationError, match="the header has another POLE_PAIRS"):
        check_independently(tmp_path)


@pytest.mark.thinned
@pytest.mark.parametrize("name", COVERED)
def test_library_drives(name: str, tmp_path: Path) -> None:
    assert checker.main([str(written(solved(load(name)), tmp_path))]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("number", range(20))
def test_drawn_designs(number: int, tmp_path: Path) -> None:
    random = np.random.default_rng([number, crc32(seed().encode())])
    base = (IPM, INVERSE_SALIENT, RELUCTANCE, SURFACE)[number % 4]
    wide = {
        name: float(getattr(base, name) * factors(1, 0.2, random)[0])
        for name in ("r_s", "l_d", "l_q", "psi_pm")
    }
    machine = LinearMachine(base.pole_pairs, i_max=base.i_max, inertia=base.inertia, **wide)
    forms: tuple[FitForm, ...] = ("torque-exact", "closed-form", "polynomial")
    fit = FitSettings(form="closed-form" if base is RELUCTANCE else forms[number % 3])
    solution = solved(make_design(machine, fit=fit))
    proof = solution.certificate
    assert proof is not None
    if None not in (proof.i_d, proof.i_q, proof.loss):  # else the header states no such bound
        assert checker.main([str(written(solution, tmp_path))]) == 0


def literals(code: str) -> list[str]:
    """The numbers of a function, longest first, each once."""
    return sorted(set(re.findall(r"\d\.\d{3,}(?:e-\d+)?(?=F)", code)), key=lambda x: (-len(x), x))


def last_digit(text: str) -> str:
    """A number with another last digit."""
    digits, mark, power = text.partition("e")
    return digits[:-1] + str((int(digits[-1]) + 5) % 10) + mark + power


def edited(old: str, new: str, *, both: bool) -> Change:
    """Another text in the header's function, and in the certificate's copy of it."""

    def change(header: str, plain: Plain) -> str:
        place = header.index("static inline void drive_current_reference")
        claim = plain["claims"][0]
        assert old in header[place:]
        assert old in claim["code"]
        if both:
            claim["code"] = claim["code"].replace(old, new)
        return header[:place] + header[place:].replace(old, new)

    return change


def claimed(name: str, factor: float, *, both: bool) -> Change:
    """A smaller bound in the certificate, and in the header's words."""

    def change(header: str, plain: Plain) -> str:
        claim = plain["claims"][0]
        old = claim["bounds"][name]
        new = f"{float(old) * factor:.3g}"
        claim["bounds"][name] = new
        claim["statement"] = claim["statement"].replace(f"{float(old):g} ", f"{float(new):g} ")
        return (
            header.replace(f" {old} ", f" {new} ").replace(f"({old} ", f"({new} ")
            if both
            else header
        )

    return change


def boxes(work: Callable[[list[list[str]]], Any]) -> Change:
    """Other boxes."""

    def change(header: str, plain: Plain) -> str:
        work(plain["claims"][0]["boxes"])
        return header

    return change


def machine(name: str, text: str, constant: str = "", value: str = "") -> Change:
    """Another machine in the certificate, and in the header where a constant is named."""

    def change(header: str, plain: Plain) -> str:
        plain["machine"][name] = text
        if not constant:
            return header
        made, count = re.subn(rf"(DRIVE_{constant}) \([^)]*\)", rf"\1 ({value})", header)
        assert count == 1
        return made

    return change


def shifted(end: str, by: str) -> str:
    return str(Fraction(end) + Fraction(by))


def said(header: str, plain: Plain) -> str:
    claim = plain["claims"][0]
    claim["statement"] = claim["statement"].replace("for every", "for nearly every")
    return header


def other_strategy(header: str, plain: Plain) -> str:
    plain["claims"][0]["strategy"] = "id0"
    return header


def replaced(old: str, new: str) -> Change:
    def change(header: str, plain: Plain) -> str:
        assert old in header
        return header.replace(old, new)

    return change


def planted(code: str) -> dict[str, tuple[Change, str]]:
    """Faults by name, each with a word of what must be said of it."""
    faults: dict[str, tuple[Change, str]] = {}
    for text in literals(code):
        new = last_digit(text)
        faults[f"last digit of {text}"] = edited(text, new, both=False), "function is another"
        far = f"{float(text) * 1.02:.8g}"
        faults[f"{text} everywhere"] = edited(f"{text}F", f"{far}F", both=True), "box|beyond"
    for name in checker.BOUNDS:
        faults[f"smaller {name}"] = claimed(name, 0.9, both=False), name
        faults[f"smaller {name}, also in the header"] = claimed(name, 0.7, both=True), name
    faults |= {
        "first box left out": (boxes(lambda rows: rows.pop(0)), "box 0"),
        "a box left out": (boxes(lambda rows: rows.pop(3)), "box 3"),
        "last box left out": (boxes(lambda rows: rows.pop()), "boxes end at"),
        "a box twice": (boxes(lambda rows: rows.insert(2, rows[2])), "box 3"),
        "boxes exchanged": (boxes(lambda rows: rows.reverse()), "box 0"),
        "a gap": (
            boxes(lambda rows: rows[4].__setitem__(0, shifted(rows[4][0], "1/1000"))),
            "box 4",
        ),
        "a tiny gap": (
            boxes(lambda rows: rows[4].__setitem__(0, shifted(rows[4][0], "1/1000000000000"))),
            "box 4",
        ),
        "a box backwards": (boxes(lambda rows: rows[1].reverse()), "box 1"),
        "one box for all": (
            boxes(lambda rows: rows.__setitem__(slice(None), [[rows[0][0], rows[-1][1]]])),
            "box 0",
        ),
        "pole pairs": (machine("pole_pairs", "4"), "POLE_PAIRS"),
        "pole pairs everywhere": (machine("pole_pairs", "4", "POLE_PAIRS", "4"), "box 0"),
        "half a pole pair": (machine("pole_pairs", "3.5", "POLE_PAIRS", "3.5F"), "whole"),
        "psi_pm": (machine("psi_pm_Wb", "0.1001"), "PSI_PM"),
        "psi_pm everywhere": (machine("psi_pm_Wb", "0.1001", "PSI_PM_WB", "0.1001F"), "box"),
        "psi_pm negative": (machine("psi_pm_Wb", "-0.1", "PSI_PM_WB", "-0.1F"), "negative"),
        "l_d everywhere": (machine("l_d_H", "0.00201", "L_D_H", "0.00201F"), "box"),
        "l_q everywhere": (machine("l_q_H", "0.003", "L_Q_H", "0.003F"), "box"),
        "r_s everywhere": (machine("r_s_Ohm", "0.2", "R_S_OHM", "0.2F"), "loss"),
        "words": (said, "words"),
        "strategy": (other_strategy, "another strategy"),
        "no magnet": (machine("psi_pm_Wb", "0.0"), "PSI_PM"),
        "sign of the torque": (
            edited("torque = torque_Nm;", "torque = -torque_Nm;", both=True),
            "box 0",
        ),
        "sign beyond the end": (
            edited("? -DRIVE_TORQUE_MAX_NM : D", "? DRIVE_TORQUE_MAX_NM : D", both=True),
            "beyond",
        ),
        "another answer far beyond": (
            edited(
                "} else if (t > DRIVE_TORQUE_MAX_NM) {",
                "} else if (t > 1000.0F) { i_d = 0.0F; torque = 0.0F; } else if (t > "
                "DRIVE_TORQUE_MAX_NM) {",
                both=True,
            ),
            "function|beyond",
        ),
        "a macro": (
            replaced("#include <math.h>", "#define fabsf(x) (x)\n#include <math.h>"),
            "macro",
        ),
        "a name": (replaced("#include <math.h>", "#define torque t\n#include <math.h>"), "macro"),
        "a second function": (
            replaced("/* Test vectors", "#define fabsf sqrtf\n/* Test vectors"),
            "macro",
        ),
        "end of the domain": (
            replaced("TORQUE_MAX_NM (", "TORQUE_MAX_NM (1"),
            "boxes end|words|function",
        ),
    }
    return faults


def verdict(change: Change, sound: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The last line that the checker prints of a changed header and certificate."""
    plain = json.loads(sound.read_text())
    header = change((sound.parent / "drive.h").read_text(), plain)
    (folder / "drive.h").write_text(header)
    path = folder / sound.name
    path.write_text(json.dumps(plain))
    capsys.readouterr()
    code = checker.main([str(path)])
    line = capsys.readouterr().out.splitlines()[-1]
    assert code == (1 if line.startswith("not confirmed: ") else 0)
    return line


@pytest.mark.parametrize(
    "part", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 6))]
)
def test_planted_faults_are_found(
    part: int, sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unchanged = verdict(lambda header, _: header, sound, tmp_path, capsys)
    assert unchanged.startswith("confirmed: ")
    faults = planted(json.loads(sound.read_text())["claims"][0]["code"])
    assert len(faults) >= 40
    missed = {}
    for name, (change, place) in list(faults.items())[part::6]:
        line = verdict(change, sound, tmp_path, capsys)
        if not line.startswith("not confirmed: ") or not re.search(place, line):
            missed[name] = line
    assert missed == {}
