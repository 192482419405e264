"""The observers in fixed point as C: every bit of the model, no undefined behaviour, damage
refused.
"""

from __future__ import annotations

import copy
import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fixed_drives import fitted, observed_design

from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.fixed_observers.fixed_observer_fit import (
    FIXED_METHODS,
    FixedObserverFit,
    fixed_method_named,
    solve_fixed_observers,
)
from dqforge.optimizer.steps.integer_arithmetic import CodeArray
from dqforge.reports.fixed_observers.fixed_observer_header import (
    fixed_observer_files,
    fixed_observer_from,
    fixed_observer_harness,
    input_names,
    output_names,
    plain_fixed_observer,
    plain_observer_evidence,
    row_inputs,
    row_results,
)
from dqforge.reports.run import export_design, verify_folder
from dqforge.reports.verification.host import WARNINGS

STRICT = (
    *WARNINGS,
    "-Wsign-conversion",
    "-Wshadow",
    "-Wundef",
    "-Wcast-qual",
    "-Wcast-align",
    "-Wno-overlength-strings",
    "-std=c99",
    "-fsanitize=undefined,signed-integer-overflow,integer-divide-by-zero",
    "-fno-sanitize-recover=all",
)

# The covariances of the filter are searched for, which takes seconds.
EVERY = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] if name == "ekf" else [])
        for name in FIXED_METHODS
    ],
)


def run_rows(fit: FixedObserverFit, name: str, folder: Path, rows: CodeArray) -> CodeArray:
    """Results of the compiled header under the sanitizer, which ends the program."""
    design, observer = observed_design(name), fit.observer
    for file, content in fixed_observer_files(design, fit).items():
        (folder / file).write_bytes(content)
    prefix = design.export.prefix
    (folder / "main.c").write_text(fixed_observer_harness(observer).source(prefix))
    subprocess.run(["gcc", "-O2", *STRICT, "main.c", "-o", "main"], cwd=folder, check=True)
    done = subprocess.run(
        [folder / "main"], input=rows.astype("i8").tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout, dtype="i8").reshape(rows.shape[0], -1)


@pytest.mark.thinned
@pytest.mark.parametrize(
    "width", [16, pytest.param(32, marks=pytest.mark.slow)], ids=["q15", "q31"]
)
@EVERY
def test_the_c_equals_the_model_under_the_sanitizer(name: str, width: int, tmp_path: Path) -> None:
    """Drives that turn, random states, and rows whose every entry is an end of its word."""
    fit = fitted(name, width)
    spread = row_inputs(fit.observer, 12_000, 11)
    low, high = spread.min(axis=0), spread.max(axis=0)
    ends = np.where(np.random.default_rng(13).random((6000, low.size)) < 0.5, low, high)
    rows = np.concatenate([spread, ends])
    found = run_rows(fit, name, tmp_path, rows)
    assert np.array_equal(found, row_results(fit.observer, rows))


@pytest.mark.thinned
@EVERY
def test_the_results_depend_on_their_inputs(name: str) -> None:
    """No column of the model is constant: the comparison sees each word of the state."""
    observer = fitted(name, 16).observer
    results = row_results(observer, row_inputs(observer, 6000, 1))
    names = output_names(observer)
    assert results.shape[1] == len(names) == len(input_names(observer)) - 3
    for column, values in zip(names, results.T, strict=True):
        assert np.unique(values).size > 20, column


@EVERY
def test_an_observer_reads_back_and_is_proven_again(name: str) -> None:
    observer = fitted(name, 16).observer
    plain = json.loads(json.dumps(plain_fixed_observer(observer)))
    assert fixed_observer_from(plain, 16) == observer
    with pytest.raises(InputError, match="observer_q15_header or observer_q31_header is not what"):
        fixed_observer_from(plain, 32)


def _damaged(plain: dict[str, Any], path: tuple[str, ...], value: Any) -> dict[str, Any]:
    found = copy.deepcopy(plain)
    part = found
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    return found


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("method",), "other"),
        (("bases",), [1.0, 2.0]),
        (("turn",), -1.0),
        (("width",), True),
        (("gains", "floor"), 0),
        (("gains", "floor"), 1.5),
        (("gains", "pll", "advance", "mantissa"), 2**31),
        (("gains", "pll", "advance", "shift"), 63),
        (("gains", "now", "shift"), -1),
        (("gains", "now", "rows"), 3),
        (("gains", "now", "rows"), [[2**62, 2**62, 2**62], [0, 0, 0]]),
        (("gains",), None),
    ],
)
def test_damaged_data_are_refused(path: tuple[str, ...], value: Any) -> None:
    plain = json.loads(json.dumps(plain_fixed_observer(fitted("extended-emf", 16).observer)))
    with pytest.raises(InputError, match="is not what dqforge writes; run the design again"):
        fixed_observer_from(_damaged(plain, path, value), 16)


def test_evidence_names_every_range() -> None:
    fit = fitted("flux", 16)
    plain = plain_observer_evidence(fit)
    assert len(plain["ranges"]) == len(fit.reaches)
    assert plain["angle_step_rad"] == pytest.approx(2.0 * np.pi / 65536)
    assert 0.0 < plain["fullest"]["share"] <= 1.0


@pytest.mark.slow
def test_a_run_emits_both_formats_and_finds_a_changed_sign(tmp_path: Path) -> None:
    output = export_design(observed_design("flux"), verify=True)
    for name, content in output.files.items():
        (tmp_path / name).write_bytes(content)
    verify_folder(tmp_path)
    plain = json.loads(output.files["result.json"])
    assert set(plain["observer_fixed"]) == {"q15", "q31"}
    header = tmp_path / "bench001_observer_q31.h"
    text = header.read_text()
    assert "omega - bench001" not in text
    changed = text.replace("clipped_q31(observer->omega + ", "clipped_q31(observer->omega - ")
    assert changed != text
    header.write_text(changed)
    with pytest.raises(VerificationError, match="does not give the results of its test vectors"):
        verify_folder(tmp_path)


@pytest.mark.slow
def test_all_headers_of_a_drive_compile_together(tmp_path: Path) -> None:
    """Control and observer in float32 and both integer formats, in any order."""
    design = observed_design("extended-emf")
    export = replace(design.export, control=("float32", "q15", "q31"))
    files = export_design(replace(design, export=export), verify=False).files
    names = [name for name in files if name.endswith(".h") and "vectors" not in name]
    assert {"bench001_observer_q15.h", "bench001_control_q31.h", "bench001_observer.h"} <= {*names}
    for name in names:
        (tmp_path / name).write_bytes(files[name])
    for order in (names, names[::-1]):
        lines = [f'#include "{name}"' for name in order] + ["int main(void) { return 0; }"]
        (tmp_path / "main.c").write_text("\n".join(lines))
        command = ["gcc", "-std=c99", *WARNINGS, "main.c", "-lm", "-o", "main"]
        subprocess.run(command, cwd=tmp_path, check=True)


def test_no_observer_in_integers_where_none_is_asked_for() -> None:
    design = observed_design("flux")
    assert solve_fixed_observers(design, None) == ()
    with pytest.raises(
        InputError, match="the observer back-emf is not there in fixed point; write"
    ):
        fixed_method_named("back-emf")
