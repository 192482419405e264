"""The emitted integer reference: compiled, run on any codes, weighed, and read back."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from weakened_drives import line_fit, weakened_design, weakened_fit

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh
from dqforge.optimizer.steps.integer_arithmetic import CodeArray
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.run import export_design, verify_folder
from dqforge.reports.single_headers.fixed_mesh_reading import mesh_from
from dqforge.reports.single_headers.fixed_reference import (
    mesh_harness,
    plain_mesh,
    reference_files,
    reference_inputs,
    reference_programme,
    reference_results,
)
from dqforge.reports.verification.cortex_m import run_on_target
from dqforge.reports.verification.host import WARNINGS

STRICT = (
    *WARNINGS,
    "-Wsign-conversion",
    "-Wshadow",
    "-Wundef",
    "-Wcast-qual",
    "-Wcast-align",
    "-Wno-overlength-strings",
)
SANITIZER = (
    "-std=c99",
    "-fsanitize=undefined,signed-integer-overflow",
    "-fno-sanitize-recover=all",
)
FAST = ("small ipm", "reluctance")
SLOW = ("interior", "servo with mtpv", "inverse", "pmsyrm")
NAMES = [*FAST, *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW)]


def compiled(
    name: str, fit: FixedReferenceFit, folder: Path, rows: CodeArray, *flags: str
) -> CodeArray:
    """Results of the compiled header; its test vectors are run as well."""
    mesh = fit.reference
    for file, content in reference_files(weakened_design(name), fit).items():
        (folder / file).write_bytes(content)
    (folder / "main.c").write_text(mesh_harness(mesh).source("drive"), encoding="ascii")
    command = ["gcc", "-O2", *STRICT, *flags, "main.c", "-o", "main"]
    subprocess.run(command, cwd=folder, check=True, timeout=60)
    number = np.dtype(f"i{mesh.width // 8}")
    done = subprocess.run(
        [folder / "main"], input=rows.astype(number).tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout, dtype=number).reshape(-1, 2).astype(np.int64)


@pytest.mark.thinned
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("name", NAMES)
def test_compiled_code_equals_the_model_under_the_sanitizer(
    name: str, width: int, tmp_path: Path
) -> None:
    """Any codes, ends of words among them; undefined behaviour ends the program."""
    for fit in (weakened_fit(name, width), line_fit(name, width)):
        rows = reference_inputs(fit.reference, 100_000, 3)
        found = compiled(name, fit, tmp_path, rows, *SANITIZER)
        assert np.array_equal(found, reference_results(fit.reference, rows))
        assert len(np.unique(found[:, 1])) > 1000


def test_compiles_as_cpp(tmp_path: Path) -> None:
    fit = weakened_fit("small ipm", 16)
    rows = reference_inputs(fit.reference, 20_000, 4)
    found = compiled("small ipm", fit, tmp_path, rows, "-x", "c++", "-std=c++11")
    assert np.array_equal(found, reference_results(fit.reference, rows))


@pytest.mark.parametrize(
    ("text", "other"),
    [
        ("square) > left) {", "square) < left) {"),
        ("-(int32_t)turning : turning", "turning : -(int32_t)turning"),
        (">> 15U) + 1;", ">> 15U) + 0;"),
        ("(room > below) ? (room - below) : 0", "0"),
    ],
)
def test_a_change_of_the_code_is_found(text: str, other: str, tmp_path: Path) -> None:
    """Faults in the C that vectors and sweep must see."""
    fit = weakened_fit("small ipm", 16)
    design = weakened_design("small ipm")
    source = reference_files(design, fit)["drive_reference_q15.h"].decode()
    assert text in source
    rows = reference_inputs(fit.reference, 20_000, 4)
    name = "drive_reference_q15.h"
    for file, content in reference_files(design, fit).items():
        (tmp_path / file).write_bytes(content)
    (tmp_path / name).write_text(source.replace(text, other))
    (tmp_path / "main.c").write_text(mesh_harness(fit.reference).source("drive"))
    subprocess.run(["gcc", "-O1", "main.c", "-o", "main"], cwd=tmp_path, check=True, timeout=60)
    done = subprocess.run(
        [tmp_path / "main"],
        input=rows.astype(np.int16).tobytes(),
        capture_output=True,
        check=False,
    )
    found = np.frombuffer(done.stdout, dtype=np.int16).reshape(-1, 2)
    assert np.any(found != reference_results(fit.reference, rows))


@pytest.mark.skipif(shutil.which("qemu-system-arm") is None, reason="needs qemu-system-arm")
@pytest.mark.parametrize(
    "target", ["cortex-m0plus", pytest.param("cortex-m4", marks=pytest.mark.slow)]
)
def test_emulated_cores_equal_the_model(target: str) -> None:
    design, programmes = weakened_design("small ipm"), []
    files: dict[str, bytes] = {}
    for fit in (weakened_fit("small ipm", 16), weakened_fit("small ipm", 32)):
        files |= reference_files(design, fit)
        programmes.append(reference_programme(fit.reference))
    runs = run_on_target(files, "drive", programmes, target)
    assert [run.name for run in runs] == ["fixed-point reference"] * 2


@pytest.mark.parametrize("width", [16, 32])
def test_reads_back_what_it_wrote(width: int) -> None:
    for fit in (weakened_fit("small ipm", width), line_fit("small ipm", width)):
        plain = json.loads(json.dumps(plain_mesh(fit.reference)))
        assert mesh_from(plain, width) == fit.reference


def damaged(mesh: CurrentMesh) -> dict[str, Any]:
    voltage = plain_mesh(mesh)["voltage"]
    return {
        "width": 32,
        "bases": [1.0, 2.0, -3.0, 4.0],
        "torque": [*mesh.torque[:-1], mesh.torque[0]],
        "d": [*mesh.d[:-1], 40_000],
        "q": mesh.q[:-1],
        "flux": [*mesh.flux[:-1], True],
        "heat": "none",
        "voltage": {**voltage, "shift": -1},
    }


@pytest.mark.parametrize("key", ["width", "bases", "torque", "d", "q", "flux", "heat", "voltage"])
def test_damaged_data_are_refused(key: str) -> None:
    mesh = weakened_fit("small ipm", 16).reference
    plain = json.loads(json.dumps(plain_mesh(mesh)))
    with pytest.raises(InputError, match="reference_q15_header"):
        mesh_from(plain | {key: damaged(mesh)[key]}, 16)
    plain.pop(key)
    with pytest.raises(InputError, match="run the design again"):
        mesh_from(plain, 16)


def written(tmp_path: Path) -> Path:
    """Headers of the bench, whose control is asked for in both fixed-point formats."""
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    text = text.replace("export:\n", "export:\n  control: [q15, q31]\n")
    text = re.sub(r"(?ms)^simulation:.*?(?=^\w)", "", text)
    files = export_design(load_text(text.encode(), "design.yaml"), verify=False).files
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


@pytest.mark.slow
def test_the_headers_of_a_design_are_verified_from_their_folder(tmp_path: Path) -> None:
    """What is changed in a header is found by its own result alone."""
    folder = written(tmp_path)
    result = json.loads((folder / "result.json").read_text())
    assert set(result["reference_fixed"]) == {"q15", "q31"}
    assert result["reference_fixed"]["q15"]["errors"]["voltage_excess"] is None
    verify_folder(folder)
    header = folder / "bench001_reference_q15.h"
    header.write_text(header.read_text().replace("(asked < 0) ? -i_q : i_q", "i_q"))
    with pytest.raises(VerificationError, match="test vectors"):
        verify_folder(folder)


def test_the_header_says_what_is_proven() -> None:
    design, fit = weakened_design("small ipm"), weakened_fit("small ipm", 16)
    text = reference_files(design, fit)["drive_reference_q15.h"].decode()
    assert fit.proven.voltage is not None
    bound = rounded_up(100.0 * fit.proven.voltage)
    assert f"exceeds that by at most {bound} %: proven" in text
    assert max(len(line) for line in text.splitlines() if line.startswith(" *")) <= 125
    unproven = replace(fit, proven=replace(fit.proven, voltage=None))
    assert "(sampled)." in reference_files(design, unproven)["drive_reference_q15.h"].decode()
