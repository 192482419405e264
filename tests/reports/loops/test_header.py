"""Headers of gains over the current: compiled, compared bit for bit, read back; the three forms;
tolerances shown.
"""

from __future__ import annotations

import json
import re
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.loops.gain_schedule import GainEvaluator
from dqforge.reports.loops.capability import (
    GAIN_HARNESS,
    evaluator_from,
    gains_files,
    plain_evaluator,
    schedule_inputs,
)
from dqforge.reports.output.folder import put_files
from dqforge.reports.run import RunOutput, export_design, read_folder, run_design, verify_folder
from dqforge.reports.verification.host import WARNINGS

LIBRARY = Path(__file__).resolve().parents[3] / "machines" / "library"
DRIVES = {
    "table": ("baldor-pmsyrm-5k6", "damping"),
    "polynomial": ("abb-syrm-6k7-saturated", "symmetrical-optimum"),
}


def text_of(drive: str, method: str, more: str = "") -> bytes:
    text = (LIBRARY / f"{drive}.yaml").read_text(encoding="utf-8")
    loop = f"    method: {method}\n    schedule: true\n" + (
        "    bandwidth: 250 Hz\n" if method == "damping" else ""
    )
    text = re.sub(r"  current_loop:\n(    .*\n)+", f"  current_loop:\n{loop}", text)
    text = re.sub(r"  degree: \d+\n  segments: \d+", "  degree: 1\n  segments: 1", text)
    return re.sub(r"\ncontrol:\n", f"\ncontrol:\n{more}", text).encode()


@cache
def exported(form: str) -> RunOutput:
    return export_design(load_text(text_of(*DRIVES[form]), "design.yaml"), verify=True)


def evaluator(form: str) -> GainEvaluator:
    schedule = exported(form).solution.gains.schedule
    assert schedule is not None
    return schedule.fit.evaluator


@pytest.mark.slow
@pytest.mark.parametrize("form", DRIVES)
def test_run_writes_verified_headers_that_verify_reads_back(form: str, tmp_path: Path) -> None:
    output = exported(form)
    assert evaluator(form).form == form
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    put_files(tmp_path, output.files)
    found = read_folder(tmp_path)
    assert {f"{found.prefix}_gains.h", f"{found.prefix}_gains_vectors.h"} <= set(found.files)
    rebuilt = evaluator_from(json.loads(output.files["result.json"])["gains_header"])
    inputs = schedule_inputs(rebuilt, 500, 3)
    assert np.array_equal(rebuilt.gains(inputs), evaluator(form).gains(inputs))
    verify_folder(tmp_path)

    header = tmp_path / f"{found.prefix}_gains.h"
    text = header.read_text(encoding="ascii")
    literal = re.findall(r"\d+\.\d+F", text)[-1]
    changed = f"{float(literal[:-1]) * 1.001:.8g}F"
    header.write_text(text.replace(literal, changed), encoding="ascii")
    with pytest.raises(VerificationError, match="does not give the results"):
        verify_folder(tmp_path)
    header.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        verify_folder(tmp_path)


@pytest.mark.thinned
@pytest.mark.parametrize("form", DRIVES)
@pytest.mark.parametrize("language", [("-std=c99",), ("-x", "c++", "-std=c++11")])
def test_compiled_code_equals_the_model_bit_for_bit(
    form: str, language: tuple[str, ...], tmp_path: Path
) -> None:
    output, model = exported(form), evaluator(form)
    put_files(tmp_path, output.files)
    prefix = output.solution.design.export.prefix
    harness = GAIN_HARNESS.source(prefix)
    (tmp_path / "harness.c").write_text(harness, encoding="ascii")
    flags = ["-O2", "-ffp-contract=off", "-Wshadow", "-Wsign-conversion", "-Wundef", *WARNINGS]
    subprocess.run(
        ["cc", *language, *flags, "-o", "harness", "harness.c"],
        cwd=tmp_path,
        check=True,
        timeout=60,
    )
    inputs = schedule_inputs(model, 20_000, 11, patterns=20_000)
    done = subprocess.run(
        [tmp_path / "harness"], input=inputs.tobytes(), capture_output=True, timeout=60, check=True
    )
    found = np.frombuffer(done.stdout, dtype=np.float32).reshape(-1, 4)
    assert np.array_equal(found.view(np.uint32), model.gains(inputs).view(np.uint32))
    assert np.all(found > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        {"end": 0.0},
        {"end": "1"},
        {"fallback": {}},
        {"constants": {"other": 1.0}},
        {"tables": {"kp_d": [1.0]}},
        {"tables": None},
        {"inverse_step": 1e9},
        {"starts": []},
    ],
)
def test_damaged_data_are_refused(damage: dict[str, Any]) -> None:
    plain = plain_evaluator(evaluator("table"))
    with pytest.raises(InputError, match="run the design again"):
        evaluator_from(plain | damage)


@pytest.mark.slow
def test_the_header_says_what_its_gains_keep() -> None:
    output = exported("polynomial")
    gains = output.solution.gains
    assert gains.schedule is not None
    text = gains_files(output.solution.design, gains, gains.schedule)[
        f"{output.solution.design.export.prefix}_gains.h"
    ].decode()
    for phrase in (
        "q-axis current in A as it is measured",
        "d[k] = d[k-1] + kp[k] e[k] - kp[k-1] e[k-1] + ki_ts[k] e[k]",
        "Not d[k-1] + kp[k] (e[k] - e[k-1]) + ki_ts[k] e[k]",
        "however fast the current changes",
        "least phase margin",
        "V/A",
        "Not-a-number",
        "_SCHEDULE_END_A",
    ):
        assert phrase in text.replace("\n *", "")
    assert "math.h" not in text
    assert all(line == line.rstrip() for line in text.splitlines())


@pytest.mark.slow
def test_json_report_and_macros_hold_the_three_forms_and_the_tolerances() -> None:
    tolerances = "  tolerances: {r_s: 20 %, l_d: 10 %, l_q: 10 %, v_dc: 5 %}\n"
    output = run_design(
        load_text(text_of("baldor-pmsyrm-5k6", "damping", tolerances), "design.yaml"), verify=False
    )
    gains = json.loads(output.files["result.json"])["gains"]
    axis = gains["i_q"]
    assert axis["q0"] == pytest.approx(axis["kp"] + axis["ki_ts"], rel=1e-8)
    assert axis["q1"] == -axis["kp"]
    assert axis["t_i_s"] == pytest.approx(axis["kp"] / axis["ki"], rel=1e-8)
    worst = gains["tolerances"]["i_q"]
    assert worst["phase_margin_rad"]["value"] < axis["phase_margin_rad"]
    assert re.match(r"r_s [+-]20 %, l_q ", worst["phase_margin_rad"]["at"])
    assert len(gains["schedule"]["i_q"]["scheduled"]["phase_margin_rad"]) == len(
        gains["schedule"]["i_q_A"]
    )
    prefix = output.solution.design.export.prefix
    header = output.files[f"{prefix}.h"].decode()
    macros = {
        name: float(value)
        for name, value in re.findall(
            rf"#define {prefix.upper()}_(IQ_\w+) \((-?[\d.e-]+)F\)", header
        )
    }
    assert macros["IQ_Q0_V_PER_A"] == pytest.approx(
        macros["IQ_KP_V_PER_A"] + macros["IQ_KI_TS_V_PER_A"], rel=1e-6
    )
    assert macros["IQ_Q1_V_PER_A"] == -macros["IQ_KP_V_PER_A"]
    assert "Within the tolerances at least" in header
    page = output.files["report.html"].decode()
    assert "Worst within control.tolerances" in page
    assert "Scheduled gains along the current reference" in page


def test_without_the_section_there_is_no_word_of_tolerances_or_schedules() -> None:
    output = export_design(
        load_text((LIBRARY / "paper001-pmsm-bench.yaml").read_bytes(), "design.yaml"), verify=False
    )
    document = json.loads(output.files["result.json"])
    assert "tolerances" not in document["gains"]
    assert "schedule" not in document["gains"]
    assert document["gains_header"] is None
    assert not any("gains" in name for name in output.files)
    assert "tolerances" not in output.files[f"{output.solution.design.export.prefix}.h"].decode()
