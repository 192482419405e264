"""The fixed-point control functions as C: every bit of the model, no undefined behaviour,
damage refused.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import IPM, RELUCTANCE, SURFACE, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import ModulationName
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.fixed_control.codes import FIXED_MODULATORS, sine_error
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_control
from dqforge.reports.control.fixed_header import (
    control_fixed_files,
    control_fixed_harness,
    plain_fixed_control,
    plain_fixed_evidence,
)
from dqforge.reports.control.fixed_model import (
    fixed_control_from,
    input_names,
    output_names,
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
)


# Those whose code differs most; the others in the long run.
_FIRST = {"svpwm", "thipwm6", "dpwm0", "gdpwm", "ddt-gdpwm"}
MODULATIONS = [
    pytest.param(name, marks=[] if name in _FIRST else [pytest.mark.slow])
    for name in FIXED_MODULATORS
]


def drive(machine: LinearMachine, modulation: ModulationName = "svpwm") -> Design:
    design = make_design(machine)
    bases = replace(design.control.bases, speed=1000.0)
    operation = replace(design.operation, modulation=modulation)
    return replace(design, operation=operation, control=replace(design.control, bases=bases))


@cache
def gains_of(machine: LinearMachine) -> GainSet:
    """Gains of a drive, tuned once."""
    return solve_gains(drive(machine))


def fitted(design: Design, width: int) -> FixedControlFit:
    assert isinstance(design.machine, LinearMachine)
    gains = gains_of(design.machine)
    return fit_control(design, (gains.i_d, gains.i_q, gains.speed), gains.observer, width)


def run_rows(
    design: Design, fit: FixedControlFit, folder: Path, rows: np.ndarray, *flags: str
) -> np.ndarray:
    """Results of the compiled header for rows of inputs.

    The test vectors inside are run as well.
    """
    control = fit.control
    for name, content in control_fixed_files(design, fit).items():
        (folder / name).write_bytes(content)
    (folder / "main.c").write_text(control_fixed_harness(control).source("drive"))
    command = ["gcc", "-O2", *STRICT, *flags, "main.c", "-o", "main"]
    subprocess.run(command, cwd=folder, check=True, timeout=120)
    wide = np.dtype(f"i{control.width // 4}")
    done = subprocess.run(
        [folder / "main"], input=rows.astype(wide).tobytes(), capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr.decode()
    return np.frombuffer(done.stdout, dtype=wide).reshape(rows.shape[0], -1)


@pytest.mark.thinned
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("modulation", MODULATIONS)
def test_every_modulator_equals_the_model_under_the_sanitizer(
    modulation: ModulationName, width: int, tmp_path: Path
) -> None:
    """Random rows, the ends of every word, and in 16 bits every angle.

    Undefined behaviour ends the program.
    """
    design = drive(IPM, modulation)
    fit = fitted(design, width)
    rows = row_inputs(fit.control, 65_536 if width == 16 else 30_000, 11)
    if width == 16:
        assert np.unique(rows[:, input_names(fit.control).index("theta")]).size == 65_536
    flags = (
        "-std=c99",
        "-fsanitize=undefined,signed-integer-overflow",
        "-fno-sanitize-recover=all",
    )
    found = run_rows(design, fit, tmp_path, rows, *flags)
    assert np.array_equal(found, row_results(fit.control, rows))


@pytest.mark.thinned
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("machine", [SURFACE, RELUCTANCE], ids=["surface", "reluctance"])
def test_corners_of_all_words_equal_the_model(
    machine: LinearMachine, width: int, tmp_path: Path
) -> None:
    """Rows whose every entry is an end of its word."""
    design = drive(machine)
    fit = fitted(design, width)
    spread = row_inputs(fit.control, 40_000, 12)
    low, high = spread.min(axis=0), spread.max(axis=0)
    rows = np.where(np.random.default_rng(13).random((20_000, low.size)) < 0.5, low, high)
    flags = (
        "-std=c99",
        "-fsanitize=undefined,signed-integer-overflow",
        "-fno-sanitize-recover=all",
    )
    found = run_rows(design, fit, tmp_path, rows, *flags)
    assert np.array_equal(found, row_results(fit.control, rows))
    assert ("zeta" in input_names(fit.control)) == (machine.psi_pm > 0.0)


def test_the_results_depend_on_their_inputs() -> None:
    """No column of the model is constant: the comparison sees each function."""
    for width in (16, 32):
        control = fitted(drive(IPM), width).control
        rows = row_inputs(control, 5000, 1)
        results = row_results(control, rows)
        assert results.shape[1] == len(output_names(control))
        for name, column in zip(output_names(control), results.T, strict=True):
            least = (
                control.ratio - 1 if name == "speed_loop_count" else 20 if "duty" in name else 100
            )
            assert np.unique(column).size > least, name


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = tmp_path_factory.mktemp("fixed")
    design = catalogue.load("paper001-pmsm-bench")
    export = replace(design.export, control=("q15", "q31"), vectors=64)
    output = export_design(replace(design, export=export), verify=True)
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    assert output.verification.sweep > 65_536 + 20_000
    for name, content in output.files.items():
        (folder / name).write_bytes(content)
    return folder, "bench001"


@pytest.mark.slow
def test_a_design_that_asks_gets_both_headers(written: tuple[Path, str]) -> None:
    folder, prefix = written
    for name in ("control_q15", "control_q31"):
        assert (folder / f"{prefix}_{name}.h").exists()
        assert (folder / f"{prefix}_{name}_vectors.h").exists()
    text = (folder / f"{prefix}_control_q15.h").read_text()
    assert "{ 136, 10U, 512 }" in text  # Table 8.1 of paper 001
    assert "{ 20000, 10U, 512 }" in text
    assert "ki t_s 26 / 2^15" in text
    assert "float" not in text.replace("float32", "")
    assert verify_folder(folder).sweep > 80_000
    found = json.loads((folder / "result.json").read_text())
    assert found["control_fixed"]["q15"]["loops"]["i_q"]["ki_ts"]["mantissa"] == 26
    assert all(abs(reach["high"]) < 2**31 for reach in found["control_fixed"]["q15"]["ranges"])


@pytest.mark.slow
def test_a_changed_integer_is_found(written: tuple[Path, str], tmp_path: Path) -> None:
    folder, prefix = written
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    header = tmp_path / f"{prefix}_control_q15.h"
    text = header.read_text()
    assert text.count("{ 136, 10U, 512 }") == 6  # two loops, two forms, and the whole step
    header.write_text(text.replace("{ 136, 10U, 512 }", "{ 137, 10U, 512 }"))
    with pytest.raises(VerificationError, match="does not give the results of its test vectors"):
        verify_folder(tmp_path)


@pytest.mark.slow
def test_one_unit_in_the_sine_is_found(written: tuple[Path, str], tmp_path: Path) -> None:
    folder, prefix = written
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    header = tmp_path / f"{prefix}_control_q15.h"
    text = header.read_text()
    assert text.count(" 23171U") == 1
    header.write_text(text.replace(" 23171U", " 23172U"))
    with pytest.raises(VerificationError, match="test vectors"):
        verify_folder(tmp_path)


@pytest.mark.parametrize("width", [16, 32])
def test_plain_data_come_back(width: int) -> None:
    fit = fitted(drive(IPM), width)
    plain = json.loads(json.dumps(plain_fixed_control(fit.control)))
    assert fixed_control_from(plain, width) == replace(fit.control, bases=tuple(plain["bases"]))
    json.dumps(plain_fixed_evidence(fit))


@pytest.mark.parametrize(
    "damage",
    [
        {"width": 32},
        {"modulation": "ninefold"},
        {"bases": [1.0, 2.0, 3.0]},
        {"bases": [1.0, 2.0, -3.0, 1.0]},
        {"dc_least": 0},
        {"dc_scale": 9},
        {"limit": {"mantissa": 70_000, "shift": 1, "value": 1.0}},
        {"limit": {"mantissa": 7, "shift": -1, "value": 1.0}},
        {"limit": {"mantissa": True, "shift": 1, "value": 1.0}},
        {"i_d": None},
        {"i_q": {"parallel": {}}},
        {"decoupling": {"x_d": 1}},
        {"observer": {"reach": 2}},
    ],
)
def test_damaged_plain_data_are_refused(damage: dict[str, Any]) -> None:
    plain = plain_fixed_control(fitted(drive(IPM), 16).control)
    with pytest.raises(InputError, match="run the design again"):
        fixed_control_from(plain | damage, 16)


def test_integers_that_could_overflow_are_not_read_back() -> None:
    plain = json.loads(json.dumps(plain_fixed_control(fitted(drive(IPM), 16).control)))
    plain["speed"]["velocity"]["fraction"] = 15
    with pytest.raises(InputError, match="run the design again"):
        fixed_control_from(plain, 16)


def test_stated_error_of_the_sine() -> None:
    assert 1.0 <= sine_error(16) < 1.4
    assert sine_error(32) < 2.4


def test_the_key_takes_one_format_or_several() -> None:
    text = (
        "dqforge: 1\nname: One\n"
        "machine: {pole_pairs: 3, resistance: 1 Ohm, inductance_d: 2 mH, inductance_q: 2 mH, "
        "magnet_flux: 50 mWb, max_current: 5 A}\n"
        "inverter: {v_dc: 48 V, switching_frequency: 10 kHz}\nexport: {control: CONTROL}\n"
    )
    for written, expected in (("q15", ("q15",)), ("[q31, q15, q31]", ("q31", "q15")), ("[]", ())):
        assert (
            load_text(text.replace("CONTROL", written).encode(), "design.yaml").export.control
            == expected
        )
    with pytest.raises(
        InputError, match=r"export.control: expected one of float32, q15, q31, got the text 'q7'"
    ):
        load_text(text.replace("CONTROL", "q7").encode(), "design.yaml")


def test_automatic_formats_reach_the_macros_and_the_control_header() -> None:
    """The thesis' gains with 15 bits each: the same values in both headers."""
    design = catalogue.load("paper001-pmsm-bench")
    control = design.control
    assert control.speed_loop is not None
    changed = replace(
        control,
        current_loop=replace(control.current_loop, q_formats="auto"),
        speed_loop=replace(control.speed_loop, q_formats="auto"),
    )
    design = replace(design, control=changed, export=replace(design.export, control=("q15",)))
    files = export_design(design, verify=False).files
    plain, fixed = files["bench001.h"].decode(), files["bench001_control_q15.h"].decode()
    assert "BENCH001_IQ_KP_PU_Q17 (17408)" in plain  # 136 / 2^10
    assert "BENCH001_IQ_KI_TS_PU_Q25 (26624)" in plain  # 26 / 2^15
    assert "BENCH001_SPEED_KP_PU_Q10 (20000)" in plain
    assert "{ 17408, 17U, 65536 }" in fixed
