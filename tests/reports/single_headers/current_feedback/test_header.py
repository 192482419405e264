"""Emitted regulators against their model, and settings for comparators."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from current_feedback_design import feedback_design
from static_checks import DEVIATIONS, program

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.names import FeedbackMethod, SampledRuleName
from dqforge.optimizer.current_feedback.regulator_runs import (
    CurrentFeedback,
    design_patterns,
    emitted_rule,
    load_points,
    regulator_plan,
    run_regulator,
    speed_loop,
)
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.run import export_design, verify_folder
from dqforge.reports.single_headers.current_feedback import (
    plain_rule,
    rule_files,
    rule_from,
    rule_programme,
    settings_files,
)
from dqforge.reports.verification.cortex_m import run_on_target
from dqforge.reports.verification.host import WARNINGS

RULES: tuple[SampledRuleName, ...] = ("predictive", "circle", "look-up-table")


def found_of(method: FeedbackMethod, *settings: str) -> tuple[Design, CurrentFeedback]:
    design = feedback_design(method, *settings)
    points = load_points(design)
    assert points is not None
    run = run_regulator(design, regulator_plan(design), points)
    speed = speed_loop(design, run)
    assert speed is not None
    patterns = design_patterns(design, run.plan, points)
    rule = emitted_rule(design, run.plan)
    return design, CurrentFeedback(run.plan, (run,), 0, None, *speed, patterns, rule)


@pytest.mark.parametrize("rule", RULES)
def test_compiled_rule_equals_its_model_bit_for_bit(rule: SampledRuleName, tmp_path: Path) -> None:
    design, found = found_of(rule)
    (header,) = rule_files(design, found).items()
    assert settings_files(design, found) == {}
    constants = found.rule
    assert constants is not None
    again = rule_from(json.loads(json.dumps(plain_rule(constants))))
    assert again == constants
    part = rule_programme(again)
    (tmp_path / header[0]).write_bytes(header[1])
    (tmp_path / "harness.c").write_text(part.harness.source("fb"))
    command = [program("cc"), "-std=c99", "-O2", "-ffp-contract=off", *WARNINGS, "harness.c"]
    subprocess.run([*command, "-lm", "-o", "harness"], cwd=tmp_path, check=True, timeout=60)
    done = subprocess.run(
        [str(tmp_path / "harness")], input=part.inputs.tobytes(), capture_output=True, timeout=60,
        check=True,
    )  # fmt: skip
    results = part.results(done.stdout)
    assert results is not None
    np.testing.assert_array_equal(results, part.model)
    # Every state is named, kept and left.
    before = part.inputs[:, 0].astype(np.uint32)
    assert set(part.model[:, 0].tolist()) == set(range(8))
    assert 0.05 < np.mean(before == part.model[:, 0]) < 0.95


@pytest.mark.parametrize(
    ("key", "value"), [("rule", "other"), ("l_d", 0.0), ("t_s", None), ("band", True), ("r_s", "x")]
)
def test_changed_data_are_refused(key: str, value: object) -> None:
    _, found = found_of("circle")
    constants = found.rule
    assert constants is not None
    with pytest.raises(InputError, match="current_feedback_header is not what dqforge writes"):
        rule_from(plain_rule(constants) | {key: value})


def test_hysteresis_emits_its_band_and_the_codes_of_a_converter() -> None:
    design, found = found_of("hysteresis", "control.current_loop.band=1.5 A")
    assert rule_files(design, found) == {}
    text = settings_files(design, found)["fb_current_feedback.h"].decode()
    assert "#define FB_FEEDBACK_BAND_A (1.5F)" in text
    assert "COUNTS" not in text
    assert found.speed is not None
    stated = re.search(r"FB_FEEDBACK_SPEED_KP \((\S+)F\)", text)
    assert stated is not None
    assert float(stated[1]) == pytest.approx(found.speed.kp, rel=1e-6)
    sensed = feedback_design(
        "hysteresis",
        "control.current_loop.band=1.5 A",
        "inverter.current_sensing.shunt=20 mOhm",
        "inverter.current_sensing.gain=5",
        "inverter.current_sensing.reference=3.3 V",
    )
    text = settings_files(sensed, found)["fb_current_feedback.h"].decode()
    # 1.5 A times 0.1 V/A over 3.3 V of 4096 codes.
    assert "#define FB_FEEDBACK_BAND_COUNTS (186)" in text


def test_trajectory_emits_its_patterns() -> None:
    design, found = found_of("trajectory")
    text = settings_files(design, found)["fb_current_feedback.h"].decode()
    (pattern,) = found.patterns
    assert f"{len(pattern.angles)}U }}" in text
    assert float_literal(pattern.angles[0]) in text
    text = settings_files(*found_of("ramp-comparison"))["fb_current_feedback.h"].decode()
    assert "FB_FEEDBACK_CARRIER_HZ (3000.0F)" in text


@pytest.mark.slow
def test_a_run_emits_a_verified_header_that_fails_when_changed(tmp_path: Path) -> None:
    output = export_design(feedback_design("circle"), verify=True)
    assert output.verification is not None
    for name, content in output.files.items():
        (tmp_path / name).write_bytes(content)
    verify_folder(tmp_path)
    header = tmp_path / "fb_current_feedback.h"
    text = header.read_text()
    header.write_text(text.replace("if (state == now) {", "if (state != now) {"))
    with pytest.raises(VerificationError, match="circle regulator"):
        verify_folder(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES)
def test_rule_on_an_emulated_core(rule: SampledRuleName) -> None:
    program("qemu-system-arm")
    program("arm-none-eabi-gcc")
    design, found = found_of(rule)
    constants = found.rule
    assert constants is not None
    files = rule_files(design, found)
    (done,) = run_on_target(files, "fb", [rule_programme(constants)], "cortex-m4")
    assert done.compared >= 20_000


@pytest.mark.slow
@pytest.mark.parametrize("method", [*RULES, "hysteresis", "ramp-comparison", "trajectory"])
def test_static_quality(method: FeedbackMethod, tmp_path: Path) -> None:
    design, found = found_of(method)
    files = rule_files(design, found) or settings_files(design, found)
    (tmp_path / "fb_current_feedback.h").write_bytes(files["fb_current_feedback.h"])
    main = '#include "fb_current_feedback.h"\nint main(void)\n{\n    return 0;\n}\n'
    (tmp_path / "main.c").write_text(main)
    command = [program("cppcheck"), "--std=c99", "--addon=misra", "--enable=style", "-q", "main.c"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    found_rules = set(re.findall(r"\[misra-c2012-([0-9.]+)\]", done.stderr))
    assert found_rules <= set(DEVIATIONS), done.stderr
    assert found_rules
