"""The emitted rule: compiled without warning as C and C++, and equal to
the decision of the model.
"""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.errors import InputError
from dqforge.optimizer.modulation_choice.rule import Leaf, Question, Rule, SimplifiedChoice, decide
from dqforge.reports.modulation_choice.figures import rule_header
from dqforge.reports.modulation_choice.rule_model import (
    Alternative,
    EmittedRule,
    as_emitted,
    emitted_from,
    emitted_rule,
    plain_emitted,
    rule_inputs,
    rule_results,
)
from dqforge.reports.verification.host import WARNINGS

ALTERNATIVES = [
    Alternative("svpwm", 10e3),
    Alternative("dpwm1", 20e3),
    Alternative("ddt-gdpwm", 20e3),
    Alternative("svpwm", 40e3),
]
RULES: dict[str, Rule] = {
    "four": Question(
        "torque_Nm",
        120.1,
        Question("speed_rad_per_s", 300.3, Leaf(3), Leaf(2)),
        Question("speed_rad_per_s", 500.0, Leaf(1), Leaf(0)),
    ),
    "one question": Question("speed_rad_per_s", 314.159, Leaf(2), Leaf(0)),
    "none": Leaf(1),
}
MAIN = """
#include <stdio.h>
#include "drive_modulation.h"
#include "drive_modulation.h"
int main(void)
{
    float in[2];
    while (fread(in, sizeof in, 1U, stdin) == 1U) {
        const float f = drive_switching_frequency_Hz(drive_modulation_choice(in[0], in[1]));
        fwrite(&f, sizeof f, 1U, stdout);
    }
    return 0;
}
"""


@pytest.mark.parametrize("language", ["c", "c++"])
@pytest.mark.parametrize("name", RULES)
def test_compiled_rule_decides_as_the_model(name: str, language: str, tmp_path: Path) -> None:
    rule = as_emitted(RULES[name])
    files = rule_header(
        make_design(), SimplifiedChoice(RULES[name], 100.0, 99.0, True), ALTERNATIVES
    )
    for file_name, content in files.items():
        (tmp_path / file_name).write_bytes(content)
    (tmp_path / "main.c").write_text(MAIN)
    standard = "-std=c99" if language == "c" else "-std=c++11"
    program = "gcc" if language == "c" else "g++"
    command = [
        program,
        "-x",
        language,
        standard,
        *WARNINGS,
        "-Wshadow",
        "main.c",
        "-lm",
        "-o",
        "main",
    ]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    generator = np.random.default_rng(4)
    inputs = generator.uniform(-1.0, 1.0, (20_000, 2)).astype(np.float32) * np.array(
        [250.0, 900.0], dtype=np.float32
    )
    below = np.nextafter(np.float32(120.1), np.float32(0.0))
    edges = np.array([[120.1, 300.3], [below, 300.3], [np.nan, 1.0], [0.0, 0.0]], dtype=np.float32)
    inputs = np.concatenate([inputs, edges, -edges])
    found = subprocess.run(
        [str(tmp_path / "main")], input=inputs.tobytes(), capture_output=True, check=True
    )
    size = np.abs(inputs.astype(np.float64))
    chosen = decide(rule, {"torque_Nm": size[:, 0], "speed_rad_per_s": size[:, 1]})
    wanted = np.array([alternative.f_sw for alternative in ALTERNATIVES])[chosen]
    np.testing.assert_array_equal(np.frombuffer(found.stdout, dtype=np.float32), wanted)


def test_header_names_what_the_rule_takes_and_its_price() -> None:
    files = rule_header(
        make_design(), SimplifiedChoice(RULES["one question"], 101.0, 100.0, False), ALTERNATIVES
    )
    text = files["drive_modulation.h"].decode("ascii")
    assert "DRIVE_DDT_GDPWM_20000_HZ" in text
    assert "DRIVE_DPWM1_20000_HZ" not in text
    assert "101 W, 1 % above the best alternative" in text.replace("1.01 %", "1 %")
    assert "breaks them least" in text


def model(name: str = "four") -> EmittedRule:
    return emitted_rule(RULES[name], ALTERNATIVES, (250.0, 900.0))


@pytest.mark.parametrize("name", RULES)
def test_model_is_the_rule_with_numbers_of_its_own(name: str) -> None:
    emitted = model(name)
    inputs = rule_inputs(emitted, 4000, 1, patterns=4000)
    results = rule_results(emitted, inputs)
    size = np.abs(np.where(np.isnan(inputs), 0.0, inputs)).astype(
        np.float64
    )  # not-a-number counts as zero
    chosen = decide(
        as_emitted(RULES[name]), {"torque_Nm": size[:, 0], "speed_rad_per_s": size[:, 1]}
    )
    for row, k in zip(results, chosen, strict=True):
        assert row[2] == np.float32(ALTERNATIVES[k].f_sw)
        assert emitted.alternatives[int(row[0])] == ALTERNATIVES[k]
        assert emitted.modulators[int(row[1])] == ALTERNATIVES[k].modulation
    assert set(results[:, 0]) == set(range(len(emitted.alternatives)))


def test_every_threshold_is_tried_from_both_sides() -> None:
    emitted = model()
    torque, speed = rule_inputs(emitted, 10, 1).T
    for threshold, values in ((120.1, torque), (300.3, speed), (500.0, speed)):
        exact = np.float32(threshold)
        for value in (
            exact,
            np.nextafter(exact, np.float32(0.0)),
            np.nextafter(exact, np.float32(np.inf)),
        ):
            assert value in values
            assert -value in values
    assert np.isnan(torque).any()
    assert np.isinf(speed).any()


@pytest.mark.parametrize("name", RULES)
def test_plain_data_rebuild_the_model(name: str) -> None:
    emitted = model(name)
    inputs = rule_inputs(emitted, 3000, 2, patterns=1000)
    again = emitted_from(plain_emitted(emitted))
    assert again.modulators == emitted.modulators
    assert np.array_equal(rule_results(again, inputs), rule_results(emitted, inputs))


@pytest.mark.parametrize(
    "damage",
    [
        {"rule": {}},
        {"rule": {"choice": 9}},
        {"rule": {"choice": True}},
        {"rule": 3},
        {"alternatives": []},
        {"alternatives": [{"modulation": "svm", "frequency_Hz": 1e4}]},
        {"alternatives": [{"modulation": None, "frequency_Hz": 1e4}]},
        {"alternatives": [{"modulation": "svpwm", "frequency_Hz": "x"}]},
        {"torque_max_Nm": 0.0},
        {"omega_m_max_rad_per_s": None},
    ],
)
def test_damaged_data_are_refused(damage: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="modulation_header is not what dqforge writes"):
        emitted_from(plain_emitted(model()) | damage)


def test_a_rule_deeper_than_any_is_refused() -> None:
    plain: dict[str, Any] = {"choice": 0}
    for _ in range(20):
        plain = {"quantity": "torque_Nm", "threshold": 1.0, "below": plain, "above": {"choice": 0}}
    with pytest.raises(InputError, match="run the design again"):
        emitted_from(plain_emitted(model("none")) | {"rule": plain})
