"""Study files: what they say, and one line with the place for each that is wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from broken_studies import BASE, BROKEN, changed

from dqforge.machines.design import catalogue as designs
from dqforge.machines.errors import InputError
from dqforge.machines.exploration import study_checks as catalogue
from dqforge.machines.exploration.study import Study
from dqforge.machines.exploration.study_checks import (
    grid_rows,
    read_study,
    row_count,
    study_of_text,
)


def read(text: str, folder: Path | None = None) -> Study:
    return study_of_text(text.encode(), "study.yaml", folder)


@pytest.mark.parametrize(
    ("text", "line", "column", "phrase"),
    [broken[1:] for broken in BROKEN],
    ids=[broken[0] for broken in BROKEN],
)
def test_a_fault_is_one_line_with_its_place(
    text: str, line: int, column: int, phrase: str, tmp_path: Path
) -> None:
    file = tmp_path / "study.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_study(file)
    said = str(caught.value)
    assert phrase in said
    assert said.startswith(f"{file}:{line}:{column}: ")
    assert "\n" not in said
    assert caught.value.exit_code == 2


_CARRIER = "{range: {from: 60 kHz, to: 100 kHz, count: 3}}"


@pytest.mark.parametrize(
    ("key", "values", "place", "phrase"),
    [
        (
            "inverter.dead_time",
            "[1 us, 1,5 us]",
            "5:30: vary.inverter.dead_time[1]",
            "1 has no unit and the text '5 us' has one; write 1.5 us for one number, or 1 s, 5 us",
        ),
        (
            "inverter.device",
            "[fuji-2mbi300xbe120-50]",
            "5:3",
            "write {name: fuji-2mbi300xbe120-50}",
        ),
        ("dqforge", "[1, 2]", "5:3", "the same in every design; remove the key"),
    ],
)
def test_what_is_meant_is_said(key: str, values: str, place: str, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        read(changed((f"inverter.switching_frequency: {_CARRIER}", f"{key}: {values}")))
    assert str(caught.value).startswith(f"study.yaml:{place}: ")
    assert phrase in str(caught.value)


@pytest.mark.parametrize("values", ["[0, 5 us]", "[1 us, 1.5 us]", "[1e-6, 2 us]", "[1e-6, 2e-6]"])
def test_numbers_without_a_unit_may_stand_beside_others(values: str) -> None:
    old = f"inverter.switching_frequency: {_CARRIER}"
    study = read(changed((old, f"inverter.dead_time: {values}")))
    assert len(study.axes[0].numbers) == 2


def test_the_base_of_the_faults_is_sound() -> None:
    study = read(BASE)
    assert grid_rows(study) == 6
    assert row_count(study) == 60
    assert [tolerance.key for tolerance in study.tolerances] == [
        "inverter.v_dc",
        "machine.resistance",
    ]
    assert study.tolerances[0].centre == 500.0
    assert study.tolerances[1].centre == 2e-3
    assert study.design_text == designs.read_text("paper000-ipmsm-100kw")


def test_studies_of_the_library_are_read() -> None:
    assert catalogue.names() == [
        "magnets-and-inductances",
        "modules-and-modulators",
        "production-yield",
    ]
    modules = catalogue.load("modules-and-modulators")
    assert [len(axis.steps) for axis in modules.axes] == [6, 20, 12]
    carriers = np.array(modules.axes[1].numbers)[:, 0]
    np.testing.assert_allclose(carriers, np.geomspace(8e3, 1e5, 20), rtol=1e-14)
    assert carriers[0] == 8e3
    assert carriers[-1] == 1e5
    assert modules.axes[2].steps[3] == (["svpwm"],)
    assert {bound.output: bound.below for bound in modules.limits} == {
        "losses.ripple_current": 6.0,
        "losses.junction_temperature": 150.0,
    }
    production = catalogue.load("production-yield")
    assert row_count(production) == 100_000
    widths = {tolerance.key: tolerance.width for tolerance in production.tolerances}
    assert widths["machine.magnet_flux"] == 0.02
    margin = next(bound for bound in production.accept if bound.output == "gains.phase_margin")
    assert math.isclose(margin.above or 0.0, math.radians(68.0))
    loss = next(bound for bound in production.accept if bound.output == "losses.total")
    assert loss.point == (130.0, 300.0, "ddt-gdpwm")


def test_values_outside_the_limits_of_a_design_are_rows() -> None:
    """Some steps that the design refuses are rows of that state; where all are, it is an error."""
    carriers = "{range: {from: 60 kHz, to: 100 kHz, count: 3}}"
    study = read(changed((carriers, "[1 mHz, 80 kHz, 1e12]")))
    assert study.axes[0].numbers == ((1e-3,), (8e4,), (1e12,))
    with pytest.raises(InputError, match=r"study\.yaml:5:3: .*no row is a design, the first: "):
        read(changed((carriers, "[1 mHz, 1e12]")))


def test_a_device_that_the_design_refuses_is_a_row() -> None:
    """80 V on a link of 500 V: the row is refused, the study is not."""
    study = read(
        changed(
            (
                "operation.strategy: [mtpa, id0]",
                "inverter.device: [{name: ti-csd19505ktt}, {name: sirectifier-sii400s12}]",
            )
        )
    )
    assert len(study.axes[1].steps) == 2


def test_widths_are_shares_or_absolute() -> None:
    def drawn(text: str, key: str = "machine.resistance") -> tuple[float, bool]:
        study = read(changed(("machine.resistance: {normal: 5 %}", f"{key}: {{uniform: {text}}}")))
        found = next(entry for entry in study.tolerances if entry.key == key)
        return found.width, found.relative

    assert drawn("5 %") == (0.05, True)
    assert drawn("100 uOhm") == (1e-4, False)
    assert drawn("1e-4") == (1e-4, False)
    # A width of a temperature is a difference, whatever its unit.
    for text in ("5 K", "5 degC", "5"):
        assert drawn(text, "inverter.coolant_temperature") == (5.0, False)


def test_between_takes_values_and_shares() -> None:
    for text in ("[1.8 mOhm, 2.4 mOhm]", "[-10 %, 20 %]"):
        study = read(changed(("{normal: 5 %}", f"{{between: {text}}}")))
        found = study.tolerances[1]
        assert [found.low, found.high] == pytest.approx([1.8e-3, 2.4e-3])


def test_the_box_of_the_design_is_the_distribution(tmp_path: Path) -> None:
    design = designs.read_text("paper000-ipmsm-100kw").decode()
    box = "  tolerances: {r_s: 30 %, l_q: {from: -20 %, to: 10 %}, v_dc: 5 %, dead_time: 20 %}\n"
    design = design.replace("  observer:\n", f"{box}  observer:\n")
    (tmp_path / "drive.yaml").write_text(design, encoding="utf-8")
    text = changed(
        ("paper000-ipmsm-100kw", "drive.yaml"),
        (
            "tolerances:\n  machine.resistance: {normal: 5 %}\n  inverter.v_dc: {uniform: 10 %}",
            "tolerances: design",
        ),
    )
    drawn = {entry.key: entry for entry in read(text, tmp_path).tolerances}
    assert sorted(drawn) == ["inverter.v_dc", "machine.inductance_q", "machine.resistance"]
    assert (drawn["inverter.v_dc"].kind, drawn["inverter.v_dc"].width) == ("uniform", 0.05)
    skewed = drawn["machine.inductance_q"]
    assert skewed.kind == "between"
    assert skewed.low == pytest.approx(0.8 * 592e-6)
    assert skewed.high == pytest.approx(1.1 * 592e-6)
    both = text.replace(
        "tolerances: design", "tolerances: {design: uniform, inverter.v_dc: {normal: 1 %}}"
    )
    again = {entry.key: entry for entry in read(both, tmp_path).tolerances}
    assert again["inverter.v_dc"].kind == "normal"
    assert again["machine.inductance_q"] == skewed


def test_correlations_that_no_numbers_have_are_refused() -> None:
    keys = ["inverter.v_dc", "machine.resistance", "machine.inductance_d"]
    pairs = [(0, 1), (0, 2), (1, 2)]
    listed = ", ".join(f"{{keys: [{keys[a]}, {keys[b]}], rho: -0.8}}" for a, b in pairs)
    text = changed(
        ("{uniform: 10 %}", "{uniform: 10 %}\n  machine.inductance_d: {normal: 1 %}"),
        ("seed: 1", f"seed: 1, correlations: [{listed}]"),
    )
    with pytest.raises(InputError, match="no numbers have these correlations together"):
        read(text)
    study = read(text.replace("-0.8", "0.8"))
    assert study.draw is not None
    assert study.draw.correlations[0] == ("inverter.v_dc", "machine.inductance_d", 0.8)


def test_a_key_that_is_set_is_drawn_round_that_value() -> None:
    study = read(changed(("fit.degree: 3", "machine.resistance: 3 mOhm")))
    assert study.tolerances[1].centre == 3e-3


def test_keys_in_step_make_one_axis() -> None:
    text = changed(
        (
            "operation.strategy: [mtpa, id0]",
            (
                "sizes:\n    together:\n"
                "      machine.inductance_d: {range: {from: 300 uH, to: 400 uH, count: 2}}\n"
                "      machine.inductance_q: [500 uH, 0.6 mH]"
            ),
        )
    )
    axis = read(text).axes[1]
    assert axis.keys == ("machine.inductance_d", "machine.inductance_q")
    assert axis.numbers == ((3e-4, 5e-4), (4e-4, 6e-4))
    assert read(text).axes[0].spacing == "linear"
    assert axis.spacing == ""
