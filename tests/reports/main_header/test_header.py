"""The emitted header: compiled under every flag of the contract, bit for bit the model,
and byte for byte the same.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, in_floats, make_design
from hidden_compilers import hide_compilers

from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.current_reference.forms import CurrentReference, TorqueExact
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.current_reference.plain import (
    from_plain,
    sweep_torques,
    to_plain,
    vector_torques,
)
from dqforge.reports.main_header import header_files
from dqforge.reports.operating_system.host_compiler import require_compiler
from dqforge.reports.verification.host import WARNINGS, verify_files

CASES: dict[str, tuple[LinearMachine, FitSettings]] = {
    "torque-exact": (IPM, FitSettings()),
    "polynomial-shared": (IPM, FitSettings(form="polynomial", degree=3)),
    "polynomial-own": (IPM, FitSettings(form="polynomial", degree=2, breakpoint_mode="own")),
    "polynomial-free": (
        IPM,
        FitSettings(form="polynomial", degree=1, segments=4, exact_at_zero=False, continuous=False),
    ),
    "even-odd": (IPM, FitSettings(form="even-odd", degree=3, segments=1)),
    "even-odd-two": (INVERSE_SALIENT, FitSettings(form="even-odd", degree=2)),
    "flat-at-zero": (IPM, FitSettings(degree=3, segments=1, flat_at_zero=True)),
    "closed-form": (IPM, FitSettings(form="closed-form", degree=3)),
    "closed-form-inverse": (INVERSE_SALIENT, FitSettings(form="closed-form", degree=3)),
    "one-segment": (IPM, FitSettings(segments=1, degree=6)),
    "four-segments": (
        INVERSE_SALIENT,
        FitSettings(form="polynomial", segments=4, degree=5, method="lagrange"),
    ),
    "surface": (SURFACE, FitSettings()),
    "reluctance": (RELUCTANCE, FitSettings(form="closed-form")),
}


@pytest.fixture(scope="module", params=CASES)
def solution(request: pytest.FixtureRequest) -> Solution:
    machine, fit = CASES[request.param]
    return solve(make_design(machine, fit=fit))


@pytest.mark.thinned
def test_every_form_compiles_and_equals_the_model_bit_for_bit(solution: Solution) -> None:
    verification = verify_files(header_files(solution), "drive", solution.fit.reference, 256)
    assert verification.languages == ("c99", "c++11")
    assert all(
        check.compared == verification.vectors + verification.sweep >= 20_256
        for check in verification.checks
    )


@pytest.mark.thinned
def test_reference_survives_plain_data(solution: Solution) -> None:
    reference = in_floats(solution.fit)
    again = from_plain(to_plain(reference))
    assert isinstance(again, CurrentReference)
    torque = reference.samples(500)
    for left, right in zip(again.currents(torque), reference.currents(torque), strict=True):
        np.testing.assert_array_equal(left.view(np.uint32), right.view(np.uint32))


MAIN = """
#include <stdio.h>
#include "drive.h"
#include "drive.h"
int main(void)
{
    float t;
    while (fread(&t, sizeof t, 1U, stdin) == 1U) {
        float i[2];
        drive_current_reference(t, &i[0], &i[1]);
        fwrite(i, sizeof i, 1U, stdout);
    }
    return 0;
}
"""


def compiled_currents(
    folder: Path, header: bytes, torque: SingleArray, flags: list[str], program: str = "gcc"
) -> SingleArray:
    """Currents of the header, compiled with other flags than `verify` uses, shape (N, 2)."""
    (folder / "drive.h").write_bytes(header)
    (folder / "main.c").write_text(MAIN)
    command = [program, *flags, "-o", str(folder / "a.out"), str(folder / "main.c"), "-lm"]
    subprocess.run(command, check=True, capture_output=True)
    done = subprocess.run(
        [folder / "a.out"], input=torque.tobytes(), capture_output=True, check=True
    )
    return np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 2)


def has_fma() -> bool:
    return "fma" in Path("/proc/cpuinfo").read_text().split()


@pytest.mark.thinned
def test_stated_errors_hold_with_fused_multiply_add(solution: Solution, tmp_path: Path) -> None:
    """Compiled with contraction, the result keeps the stated errors; with FMA
    instructions it is the fused model.
    """
    flags = ["-std=gnu99", "-O2", "-ffp-contract=fast", *(["-mfma"] if has_fma() else [])]
    reference = in_floats(solution.fit)
    torque = reference.samples(4000)
    currents = compiled_currents(tmp_path, header_files(solution)["drive.h"], torque, flags).astype(
        np.float64
    )
    machine, errors = solution.design.machine, solution.fit.errors
    produced = machine.torque(currents[:, 0], currents[:, 1])
    assert np.max(np.abs(produced - torque)) <= errors.torque * (1.0 + 1e-6)
    if has_fma():
        fused = np.stack(reference.currents(torque, fused=True), axis=1)
        np.testing.assert_array_equal(currents.astype(np.float32), fused)


@pytest.mark.thinned
@pytest.mark.parametrize("level", ["-O0", "-Os", "-O3"])
def test_optimisation_level_changes_no_bit(level: str, tmp_path: Path) -> None:
    found = solve(make_design())
    torque = vector_torques(in_floats(found.fit), 500)
    compiled = compiled_currents(
        tmp_path, header_files(found)["drive.h"], torque, ["-std=c99", level, "-ffp-contract=off"]
    )
    model = np.stack(found.fit.reference.currents(torque), axis=1)
    np.testing.assert_array_equal(compiled.view(np.uint32), model.view(np.uint32))


@pytest.mark.thinned
def test_unused_header_makes_no_warning_and_sanitizers_find_nothing(
    solution: Solution, tmp_path: Path
) -> None:
    header = header_files(solution)["drive.h"]
    (tmp_path / "drive.h").write_bytes(header)
    (tmp_path / "unused.c").write_text('#include "drive.h"\nint main(void) { return 0; }\n')
    subprocess.run(
        ["gcc", "-std=c99", *WARNINGS, "-Wshadow", "-Wundef", "-c", "unused.c"],
        cwd=tmp_path,
        check=True,
    )
    torque = sweep_torques(in_floats(solution.fit), 4000)
    flags = [
        "-std=c99",
        "-O1",
        "-ffp-contract=off",
        "-fsanitize=undefined",
        "-fno-sanitize-recover=all",
    ]
    compiled = compiled_currents(tmp_path, header, torque, flags)
    model = np.stack(solution.fit.reference.currents(torque), axis=1)
    np.testing.assert_array_equal(compiled.view(np.uint32), model.view(np.uint32))


def mutated(
    files: dict[str, bytes], pattern: bytes, replacement: bytes, name: str = "drive.h"
) -> dict[str, bytes]:
    text, count = re.subn(pattern, replacement, files[name], count=1)
    assert count == 1
    return files | {name: text}


@pytest.fixture(scope="module")
def found() -> Solution:
    return solve(make_design())


def test_verification_sees_a_change_of_one_unit_in_the_last_place(found: Solution) -> None:
    files = header_files(found)
    reference = in_floats(found.fit)
    for pattern, replacement in (
        (rb"torque / \(\(-0\.001452F", b"torque / ((-0.0014520001F"),
        (rb"-DRIVE_TORQUE_MAX_NM :", b"DRIVE_TORQUE_MAX_NM :"),
        (rb"t < [0-9.]+F", b"t < 70.0F"),
    ):
        with pytest.raises(VerificationError, match="test vectors"):
            verify_files(mutated(files, pattern, replacement), "drive", reference, 256)


@pytest.mark.slow
def test_verification_sees_vectors_that_were_changed_with_the_header(found: Solution) -> None:
    """A header and vectors that agree with each other, but not with the model of the design,
    are found out, too.
    """
    other = solve(make_design(replace(IPM, psi_pm=0.1050)))
    with pytest.raises(
        VerificationError,
        match=r"results of the current reference differ from the float32 model; first at",
    ):
        verify_files(header_files(other), "drive", found.fit.reference, 256)


def test_verification_sees_a_difference_in_one_of_the_currents(found: Solution) -> None:
    """Only i_q depends on the magnet torque: here the model has it one unit
    in the last place larger.
    """
    reference = in_floats(found.fit)
    assert isinstance(reference.form, TorqueExact)
    form = replace(reference.form, magnet=np.nextafter(reference.form.magnet, np.float32(np.inf)))
    with pytest.raises(
        VerificationError, match="results of the current reference differ from the float32 model"
    ):
        verify_files(header_files(found), "drive", replace(reference, form=form), 256)


def test_verification_sees_a_warning(found: Solution) -> None:
    files = mutated(header_files(found), rb"0\.6294F", b"0.6294")
    with pytest.raises(VerificationError, match="does not compile as c99"):
        verify_files(files, "drive", found.fit.reference, 256)


def test_missing_compilers_are_named(found: Solution, monkeypatch: pytest.MonkeyPatch) -> None:
    files = header_files(found)
    compiler = require_compiler()
    hide_compilers(monkeypatch)
    monkeypatch.setattr(shutil, "which", lambda name: compiler.command[0] if name == "cc" else None)
    verification = verify_files(files, "drive", found.fit.reference, 256)
    assert verification.languages == ("c99",)
    assert verification.checks[1].missing == "g++"
    monkeypatch.setattr(shutil, "which", lambda _name: None)
    with pytest.raises(VerificationError, match=r"dqforge\[cc\]"):
        verify_files(files, "drive", found.fit.reference, 256)


def test_same_design_same_bytes_and_no_trace_of_machine_or_day(found: Solution) -> None:
    first, second = header_files(found), header_files(solve(make_design()))
    assert first == second
    text = first["drive.h"].decode("ascii") + first["drive_vectors.h"].decode("ascii")
    assert "/work" not in text
    assert "{{" not in text
    assert "{%" not in text
    assert not re.search(r"20\d\d-\d\d", text)
    assert max(len(line) for line in text.splitlines()) <= 160


def test_header_speaks_in_units_and_float_literals(found: Solution) -> None:
    text = header_files(found)["drive.h"].decode("ascii")
    macros = re.findall(r"#define (DRIVE_\w+) \(([^)]*)\) /\* (.+) \*/", text)
    assert len(macros) > 30
    for name, value, comment in macros:
        assert value.endswith("F") or value.isdigit(), name
        assert comment
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(r"\d\.\d+(?![\dFe])", code), "a double literal"
    assert not re.search(r"\b(malloc|double|fma|pow|printf)\b", code)


def test_hostile_names_stay_inside_their_comment() -> None:
    hostile = 'a */ int evil; /* "\\\n#define X ??/'
    solution = solve(make_design(SURFACE, name=hostile))
    files = header_files(solution)
    assert b"int evil" in files["drive.h"]
    assert b"*/ int evil" not in files["drive.h"]
    verify_files(files, "drive", solution.fit.reference, 256)


def test_gain_macros_hold_the_tuned_gains(found: Solution) -> None:
    text = header_files(found)["drive.h"].decode("ascii")

    def macro(name: str) -> float:
        match = re.search(rf"#define DRIVE_{name} \(([-0-9.e+]+)F?\)", text)
        assert match, name
        return float(match[1])

    control = found.design.control
    assert macro("ID_KP_V_PER_A") == pytest.approx(6283.0 * IPM.l_d, rel=1e-6)
    assert macro("IQ_KI_V_PER_AS") == pytest.approx(6283.0 * IPM.r_s, rel=1e-6)
    assert macro("IQ_KP_PU") == pytest.approx(
        macro("IQ_KP_V_PER_A") * control.bases.current / control.bases.voltage, rel=1e-6
    )
    assert macro("SPEED_KI_TS_PU") == pytest.approx(
        macro("SPEED_KI_NM_PER_RAD") * 1e-4 * control.bases.speed / control.bases.torque, rel=1e-6
    )
    assert macro("POLE_PAIRS") == 4
    assert 0.0 < macro("OBSERVER_A") < 1.0


@pytest.mark.parametrize(
    "damage",
    [
        {"form": "magic"},
        {"torque_max": "1"},
        {"torque_max": float("nan")},
        {"d": []},
        {"d": [{"start": 0.0}]},
        {"d": [{"start": 0.0, "coefficients": [1.0]}]},
        {"d": [{"start": 1.0, "coefficients": [1.0, 2.0]}]},
        {"d": [{"start": 0.0, "coefficients": [1.0, 1e400]}]},
        {"slope": None},
    ],
)
def test_damaged_plain_data_are_refused(found: Solution, damage: dict[str, object]) -> None:
    with pytest.raises(InputError, match="run the design again"):
        from_plain(to_plain(found.fit.reference) | damage)


def test_vectors_hold_the_special_cases(found: Solution) -> None:
    reference = in_floats(found.fit)
    torque = vector_torques(reference, 256)
    assert torque.size == 256
    assert np.isnan(torque).any()
    assert np.isinf(torque).any()
    assert (np.signbit(torque) & (torque == 0)).any()
    assert (np.abs(torque) == reference.torque_max).any()
    assert vector_torques(reference, 16).size >= 16


def test_programs_that_do_not_end_or_start_are_a_failed_verification(
    found: Solution, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = header_files(found)

    def endless(command: list[str], **_options: object) -> None:
        raise subprocess.TimeoutExpired(command, 60)

    def forbidden(command: list[str], **_options: object) -> None:
        raise PermissionError(13, "Permission denied", command[0])

    for run, phrase in (
        (endless, "did not end within 60 s"),
        (forbidden, "cannot be started .Permission denied"),
    ):
        monkeypatch.setattr(subprocess, "run", run)
        with pytest.raises(VerificationError, match=phrase):
            verify_files(files, "drive", found.fit.reference, 256)
