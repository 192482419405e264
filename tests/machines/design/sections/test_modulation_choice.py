"""The section modulation_choice of a design file: from the text to the verified header,
the report and back.
"""

from __future__ import annotations

import json
import math
import os
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from dqforge.cli import app
from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ChoiceSettings
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.modulation_choice.solve import ModulationChoice, solve_choice
from dqforge.reports.modulation_choice.figures import choice_model, leaf_boxes, plot_choice
from dqforge.reports.modulation_choice.rule_model import emitted_from, rule_inputs, rule_results
from dqforge.reports.modulation_choice.text import (
    binding_shares,
    choice_tables,
    limits_text,
    rule_lines,
)
from dqforge.reports.output.folder import put_files
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.run import RunOutput, read_folder, run_design, verify_folder
from dqforge.reports.verification.cortex_m import verify_on_target

IPM = "paper000-ipmsm-100kw"
RANGE = "min_frequency: 16 kHz, max_frequency: 60 kHz"
SMALL = f"{{{RANGE}, modulations: [svpwm, dpwm1], ripple_current: 1 A, torques: 6, speeds: 7}}"


def text(section: str) -> str:
    """The library drive with another section, written in braces."""
    lines = catalogue.read_text(IPM).decode()
    without = re.sub(r"\nmodulation_choice:\n(?:  .*\n)+", "\n", lines)
    assert "modulation_choice" not in without
    return without + (f"\nmodulation_choice: {section}\n" if section else "")


def design(section: str) -> Design:
    return load_text(text(section).encode(), "design.yaml")


@pytest.fixture(scope="module")
def output() -> RunOutput:
    return run_design(design(SMALL), verify=True)


def choice_of(output: RunOutput) -> ModulationChoice:
    assert output.solution.choice is not None
    return output.solution.choice


def test_defaults_come_from_the_design_and_are_stated() -> None:
    loaded = design(f"{{{RANGE}}}")
    assert loaded.modulation_choice == ChoiceSettings(16e3, 60e3, loaded.machine.omega_m_max or 0.0)
    assert len(loaded.modulation_choice.modulations) == 12
    assert any("modulation_choice.speed is 9000 rpm" in sentence for sentence in loaded.assumptions)
    assert design("").modulation_choice is None


def test_what_is_written_is_taken() -> None:
    loaded = design(
        f"{{{RANGE}, avoid: [{{min: 20 kHz, max: 24 kHz}}], modulations: [svpwm], strategy: id0, "
        "speed: 6000 rpm, ripple_share: 2 %, max_junction_temperature: 120 degC, carrier_ratio: "
        "15, ripple_resistance: 30, torques: 5, speeds: 6, frequencies: 4, questions: 1}"
    )
    found = loaded.modulation_choice
    assert found is not None
    assert found.omega_m == pytest.approx(6000.0 * math.pi / 30.0)
    assert found.ripple_max == pytest.approx(0.02 * 283.0 / math.sqrt(2.0))
    assert found == ChoiceSettings(
        16e3,
        60e3,
        found.omega_m,
        strategy="id0",
        modulations=("svpwm",),
        bands=((20e3, 24e3),),
        ripple_max=found.ripple_max,
        junction_max=120.0,
        carrier_ratio=15.0,
        ripple_resistance=30.0,
        torques=5,
        speeds=6,
        frequencies=4,
        questions=1,
    )
    assert any("ripple_share permits 4.002" in sentence for sentence in loaded.assumptions)


@pytest.mark.slow
def test_the_header_is_written_verified_rebuilt_and_a_changed_threshold_is_found(
    output: RunOutput, tmp_path: Path
) -> None:
    assert output.verification is not None
    assert output.verification.languages == ("c99", "c++11")
    put_files(tmp_path, output.files)
    found = read_folder(tmp_path)
    assert {"ipm100_modulation.h", "ipm100_modulation_vectors.h"} <= set(found.files)
    model = choice_model(choice_of(output))
    rebuilt = emitted_from(json.loads(output.files["result.json"])["modulation_header"])
    inputs = rule_inputs(model, 3000, 3, patterns=3000)
    assert np.array_equal(rule_results(rebuilt, inputs), rule_results(model, inputs))
    assert verify_folder(tmp_path) == output.verification
    header = tmp_path / "ipm100_modulation.h"
    whole = header.read_text(encoding="ascii")
    threshold = re.search(r">= (\d+\.\d)F", whole)
    assert threshold is not None
    for change in (
        f"{float(threshold[1]) + 0.1:.1f}F",
        f"{float(threshold[1]):.1f}F || torque != torque",
    ):
        header.write_text(whole.replace(f"{threshold[1]}F", change, 1), encoding="ascii")
        with pytest.raises(VerificationError):
            verify_folder(tmp_path)
    header.unlink()
    with pytest.raises(InputError, match="cannot be read"):
        verify_folder(tmp_path)


@pytest.mark.slow
def test_the_rule_is_compared_where_the_map_was_made(output: RunOutput) -> None:
    """At every point of the grid the emitted model takes what the choice says."""
    choice = choice_of(output)
    model, rule = choice_model(choice), choice.emitted
    torque, speed = np.meshgrid(choice.torque, choice.omega_m, indexing="ij")
    inputs = np.stack([torque.ravel(), speed.ravel()], axis=1).astype(np.float32)
    results = rule_results(model, inputs)[choice.asked]
    wanted = [rule.alternatives[k] for k in rule.taken[choice.asked]]
    assert [float(row[2]) for row in results] == [frequency for _, frequency in wanted]
    assert [model.modulators[int(row[1])] for row in results] == [name for name, _ in wanted]


@pytest.mark.parametrize("damage", ["x", {}, {"rule": {"choice": 0}}])
def test_a_damaged_result_is_refused(damage: object, output: RunOutput, tmp_path: Path) -> None:
    put_files(tmp_path, output.files)
    document = json.loads(output.files["result.json"]) | {"modulation_header": damage}
    (tmp_path / "result.json").write_text(json.dumps(document), encoding="ascii")
    with pytest.raises(InputError, match="modulation_header is not what dqforge writes"):
        read_folder(tmp_path)


def test_json_holds_map_rules_and_limits(output: RunOutput) -> None:
    plain = json.loads(output.files["result.json"])["modulation_choice"]
    choice = choice_of(output)
    assert np.shape(plain["best"]["frequency_Hz"]) == (6, 7)
    assert plain["best_mean_W"] == pytest.approx(choice.best_mean, rel=1e-8)
    assert [rule["questions"] for rule in plain["rules"]] == [0, 1, 2]
    assert plain["rules"][2]["price"] == pytest.approx(choice.price(choice.emitted), abs=1e-8)
    assert plain["limits"]["ripple_current_A"] == 1.0
    assert np.mean(plain["binding"]["ripple"]) > 0.3


def test_report_shows_the_map_the_prices_and_the_rule(output: RunOutput) -> None:
    page = output.files["report.html"].decode("utf-8")
    assert page.count('id="modulation"') == 1
    assert page.count('href="#modulation"') == 1
    for phrase in (
        "Modulator with the least loss",
        "this design",
        "ipm100_modulation_choice(float torque_Nm",
    ):
        assert phrase in page
    assert 'id="modulation"' not in run_design(design(""), verify=False).files[
        "report.html"
    ].decode("utf-8")


@pytest.mark.slow
def test_tables_and_text_say_the_same_as_the_rule(output: RunOutput) -> None:
    choice = choice_of(output)
    prices, rule, chart = choice_tables(output.solution.design, choice)
    assert [row[0] for row in prices.rows][:2] == [
        "best at every point",
        "rule with two questions (in the header)",
    ]
    assert float(prices.rows[0][2]) == pytest.approx(choice.best_mean, rel=1e-3)
    assert any("current ripple at" in note for note in prices.notes)
    assert len(rule.rows) == len(rule_lines(choice.emitted.rule, choice.emitted.alternatives))
    assert len(chart.rows) == 6
    assert binding_shares(choice)["current ripple"] == pytest.approx(
        np.mean(choice.best.binding["ripple"][choice.asked])
    )
    assert limits_text(choice.settings)[1] == "Ripple of a phase current at most 1 A (r.m.s.)"


def test_figure_names_every_answer_and_its_boxes_fill_the_map(output: RunOutput) -> None:
    choice = choice_of(output)
    drawn = to_svg(plot_choice(choice))
    for name, frequency in choice.emitted.alternatives:
        assert name in drawn
        assert f"{frequency / 1e3:.4g} kHz" in drawn
    assert f"{choice.best_mean:.4g} W" in drawn
    boxes = leaf_boxes(choice.emitted.rule, (0.0, 900.0, 0.0, 200.0))
    area = sum((right - left) * (high - low) for _, (left, right, low, high) in boxes)
    assert area == pytest.approx(900.0 * 200.0)


@pytest.mark.parametrize(
    "section",
    [
        f"{{{RANGE}, modulations: [svpwm], torques: 3, speeds: 3, questions: 0}}",
        "{min_frequency: 40 kHz, max_frequency: 40 kHz, torques: 3, speeds: 3}",
        (
            f"{{{RANGE}, modulations: [svpwm, dpwm1], torques: 6, speeds: 6, "
            "max_junction_temperature: 75 degC}"
        ),
    ],
)
def test_odd_choices_are_drawn_and_told(section: str) -> None:
    loaded = design(section)
    found = solve_choice(loaded)
    assert found is not None
    assert "<svg" in to_svg(plot_choice(found))
    assert len(choice_tables(loaded, found)) == 3


def run(*arguments: Any) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, [str(part) for part in arguments])
    return done.exit_code, done.stdout, done.stderr


def test_command_shows_the_choice_as_tables_json_and_figure(tmp_path: Path) -> None:
    path = tmp_path / "design.yaml"
    path.write_text(text(SMALL), encoding="utf-8")
    code, out, _ = run("losses", path, "--choice", "--plot", tmp_path / "map.svg")
    assert code == 0
    assert "Rule in ipm100_modulation.h" in out
    assert (tmp_path / "map.svg").read_bytes().startswith(b"<?xml")
    code, out, _ = run("losses", path, "--choice", "--json")
    assert json.loads(out)["modulation_choice"]["emitted"] == 2
    path.write_text(text(""), encoding="utf-8")
    for arguments, phrase in (
        ((path, "--choice"), "add a section 'modulation_choice'"),
        ((path, "--choice", "--map", "4x4"), "other options"),
    ):
        done = CliRunner().invoke(app, ["losses", *map(str, arguments)])
        assert done.exit_code != 0
        assert phrase in str(done.exception)


def test_the_library_drive_carries_the_section() -> None:
    loaded = catalogue.load(IPM)
    assert loaded.modulation_choice is not None
    assert loaded.modulation_choice.ripple_max == 1.0


def test_the_rule_holds_on_an_emulated_core_and_a_wrong_one_is_found(output: RunOutput) -> None:
    for tool in ("arm-none-eabi-gcc", "qemu-system-arm"):
        if shutil.which(tool) is None:
            if os.environ.get("CI"):
                pytest.fail(f"{tool} is missing; CI needs it")
            pytest.skip(f"{tool} is not installed")
    files = {name: content for name, content in output.files.items() if name.endswith(".h")}
    assert verify_on_target(files, "ipm100", "cortex-m4").vectors > 0
    wrong = re.sub(
        rb"frequency_Hz = (\d+)\.0F",
        rb"frequency_Hz = \g<1>.5F",
        files["ipm100_modulation.h"],
        count=1,
    )
    assert wrong != files["ipm100_modulation.h"]
    with pytest.raises(VerificationError, match=r"functions of ipm100_modulation\.h"):
        verify_on_target(files | {"ipm100_modulation.h": wrong}, "ipm100", "cortex-m4")
