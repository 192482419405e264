"""`dqforge compare`: identical sides, differences in exactly the rows that depend on a change,
faults in files.
"""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from drives import make_design

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.design import catalogue as loader
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.reports.comparison.sides_compared import (
    Comparison,
    LossRow,
    MacroRow,
    Row,
    compare_sides,
    comparison_tables,
)
from dqforge.reports.comparison.sources import Side, header_code, header_macros, solved_side

BENCH = "paper001-pmsm-bench"


@pytest.fixture(scope="module")
def bench() -> Side:
    return solved_side("bench", catalogue.load(BENCH))


def changed(old: str, new: str) -> Design:
    text = catalogue.read_text(BENCH).decode()
    assert text.count(old) == 1
    return loader.load_text(text.replace(old, new).encode(), "changed.yaml")


def different(found: Comparison) -> set[tuple[str, str]]:
    return {(row.section, row.label) for row in found.rows if row.differs}


CODE = ("header", "checksum of the code")
MARGINS = ("phase margin", "gain margin (factor)", "delay margin", "M_s")
LOOPED = ("bandwidth (crossover)", *MARGINS)


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("old", "new", "rows", "macros"),
    [
        ("value: 4.88 us", "value: 5 us", {("limits", "dead time")}, set()),
        (
            # The speed loop runs on an observer and is judged up to the largest speed.
            "max_speed: {value: 5420 rpm",
            "max_speed: {value: 6000 rpm",
            {("limits", "largest speed"), *(("speed loop", label) for label in LOOPED)},
            set(),
        ),
        # In a prefix only: macros are compared without it.
        ("prefix: bench001", "prefix: other", set(), set()),
        (
            # Gains are given, so that the speed loop's margins move and its gains do not.
            "inertia: {value: 200e-6 kg m^2",
            "inertia: {value: 250e-6 kg m^2",
            {
                ("machine", "inertia"),
                *(("speed loop", label) for label in LOOPED),
                # Its pole lies at -(g + B/J), and all constants follow from pole and inertia.
                *(("observer", label) for label in ("A", "B_U", "B_I", "C")),
            },
            {
                "OBSERVER_A",
                "OBSERVER_B_U_RAD_PER_VS",
                "OBSERVER_B_I_RAD_PER_AS",
                "OBSERVER_C_RAD_PER_AS",
            },
        ),
        (
            "inductance_d: {value: 1.61 mH",
            "inductance_d: {value: 1.65 mH",
            # The observer takes the voltage that turns with i_d off,
            # and the speed loop is judged on it.
            {
                ("machine", "inductance d"),
                *((loop, label) for loop in ("i_d loop", "speed loop") for label in LOOPED),
            },
            {"L_D_H"},
        ),
    ],
)
def test_a_change_shows_in_what_depends_on_it(
    bench: Side, old: str, new: str, rows: set[tuple[str, str]], macros: set[str]
) -> None:
    found = compare_sides(bench, solved_side("changed", changed(old, new)))
    # The header's code holds the macros.
    assert different(found) == rows | ({CODE} if macros else set())
    assert {row.name for row in found.macros} == macros
    assert found.identical == (
        not rows and all(row.better in ("equal", None) for row in found.losses)
    )


def test_difference_of_a_changed_resistance(bench: Side) -> None:
    found = compare_sides(
        bench, solved_side("changed", changed("value: 2.35 Ohm", "value: 2.82 Ohm"))
    )
    (row,) = [row for row in found.rows if row.label == "phase resistance"]
    assert (row.a, row.b) == (2.35, 2.82)
    assert row.relative == pytest.approx(0.2)
    assert "R_S_OHM" in {macro.name for macro in found.macros}
    # i_d = 0 at 0.47 N m: copper loss 3/2 R i_q^2 and that of the ripple current, some 6 % of it on
    # this winding, while the inverter loses nearly what it lost (the voltage rises).
    (loss,) = [
        r
        for r in found.losses
        if (r.strategy, r.modulation) == ("id0", "svpwm") and r.omega_m < 200.0
    ]
    i_q = 0.47 / (1.5 * 3 * 0.06)
    assert loss.difference is not None
    assert 1.0 < loss.difference / (1.5 * 0.47 * i_q**2) < 1.08
    assert loss.better == "a"
    text = "\n".join(
        cell for table in comparison_tables(found) for row in table.rows for cell in row
    )
    assert "+20 %" in text
    assert "2.35 Ohm" in text


@pytest.mark.slow
def test_losses_only_at_common_points_and_alternatives() -> None:
    first, second = LoadPoint(5.0, 300.0), LoadPoint(50.0, 300.0)
    base = make_design()
    a = solved_side(
        "a", replace(base, losses=LossSettings((first, second), ("id0", "mtpa"), ("spwm", "svpwm")))
    )
    b = solved_side(
        "b", replace(base, losses=LossSettings((second,), ("mtpa",), ("svpwm", "dpwm1")))
    )
    found = compare_sides(a, b)
    assert [(row.torque, row.strategy, row.modulation) for row in found.losses] == [
        (50.0, "mtpa", "svpwm")
    ]
    assert found.losses[0].better == "equal"
    assert found.alone == (
        "losses: 7 alternatives in A alone (point, strategy or modulator)",
        "losses: 1 alternative in B alone (point, strategy or modulator)",
    )
    assert not found.identical


def test_better_is_who_can_and_then_who_loses_less() -> None:
    def row(a: float | None, b: float | None) -> LossRow:
        return LossRow(1.0, 1.0, "mtpa", "svpwm", a, b)

    assert [
        row(*pair).better
        for pair in ((None, None), (None, 9.0), (9.0, None), (1.0, 2.0), (2.0, 1.0))
    ] == [
        None,
        "b",
        "a",
        "a",
        "b",
    ]
    assert row(100.0, 80.0).relative == pytest.approx(-0.2)
    assert row(80.0, 100.0).relative == pytest.approx(0.2)
    assert row(1.0, 1.0 + 1e-12).better == "equal"
    assert Row("s", "l", "", 0.0, 1.0).relative is None
    assert Row("s", "l", "", None, 1.0).differs


def test_macros_of_a_header() -> None:
    header = "#define X_H\n#define X_A (1.5F) /* A */\n#define X_N (4)\n#define Y_B (2)\n"
    assert header_macros(header, "x") == {"A": "1.5F", "N": "4"}


def test_bandwidth_is_the_crossover_in_hertz(bench: Side) -> None:
    found = compare_sides(bench, bench)
    assert found.identical
    (row,) = [
        r for r in found.rows if (r.section, r.label) == ("speed loop", "bandwidth (crossover)")
    ]
    assert row.a == pytest.approx(
        bench.value("gains", "speed", "crossover_rad_per_s") / (2.0 * math.pi)
    )


Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return stop.value.code, captured.out, captured.err

    return call


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("written") / "out"
    with pytest.raises(SystemExit):
        cli.main(["export", BENCH, "-o", str(folder), "--no-verify"])
    return folder


def test_design_and_its_result_are_identical(run: Run, written: Path) -> None:
    code, out, _ = run("compare", BENCH, written)
    assert code == 0
    assert "A and B are identical" in out
    assert "50 macros; the design files are the same" in out
    assert len(out.splitlines()) < 12
    assert run("compare", written / "result.json", written)[1].count("identical") == 1


def test_result_without_header_says_so(run: Run, written: Path, tmp_path: Path) -> None:
    lone = tmp_path / "lone.json"
    shutil.copy(written / "result.json", lone)
    code, out, _ = run("compare", lone, written)
    assert code == 0
    assert "A and B are identical" in out
    assert "headers are not compared: there is none beside the result of A" in out


def test_headers_alone(run: Run, written: Path, tmp_path: Path) -> None:
    """Against itself, its folder and its design; a literal or a macro changed by hand shows."""
    header = written / "bench001.h"
    for other in (header, written, BENCH):
        code, out, _ = run("compare", header, other)
        assert code == 0
        assert (
            "A and B are identical: 1 quantity, 0 losses, 50 macros; the design files are the same"
            in out
        )
    text = header.read_text()
    for old, new, macros in (
        ("(0.00161F)", "(0.0322F)", ["L_D_H"]),
        ("= 3.7037036F *", "= 3.7037038F *", []),
    ):
        assert text.count(old) == 1
        edited_header = tmp_path / "edited.h"
        edited_header.write_text(text.replace(old, new, 1))
        code, out, _ = run("compare", header, edited_header, "--json")
        found = json.loads(out)["comparison"]
        assert code == 0
        assert found["identical"] is False
        assert [row["name"] for row in found["macros"]] == macros
        assert [(row["section"], row["quantity"]) for row in found["rows"] if row["differs"]] == [
            CODE
        ]
    assert (
        "20 times"
        in run(
            "compare", header, _written(tmp_path / "l.h", text.replace("(0.00161F)", "(0.0322F)"))
        )[1]
    )


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_code_is_compared_without_comments_prefix_and_spaces() -> None:
    one = header_code("/* a\n b */\n#define X_A (1)\nstatic int x_f(void)  { return X_A; }\n", "X")
    assert one == header_code(
        "#define OTHER_A (1) /* c */\nstatic int other_f(void) { return OTHER_A; }\n", "other"
    )
    assert one != header_code("#define X_A (1)\nstatic int x_f(void) { return X_A + 1; }\n", "X")


def test_macros_have_differences_where_they_are_numbers() -> None:
    assert MacroRow("A", "2.0F", "-3").relative == pytest.approx(-2.5)
    assert MacroRow("A", "-1.0F", "20").ratio == pytest.approx(-20.0)
    assert MacroRow("A", "0", "1").relative is None
    assert MacroRow("A", "X", "1").relative is None
    assert MacroRow("A", None, "1").ratio is None


@pytest.mark.slow
def test_json(run: Run, written: Path) -> None:
    code, out, _ = run("compare", written, "thor-pmsyrm-5k", "--json")
    assert code == 0
    document: dict[str, Any] = json.loads(out)
    found = document["comparison"]
    assert document["command"] == "compare"
    assert found["identical"] is False
    rows = {(row["section"], row["quantity"]): row for row in found["rows"]}
    speed = rows["limits", "largest speed"]
    assert speed["unit"] == "rad/s"
    assert speed["a"] == pytest.approx(5420.0 * math.pi / 30.0)
    resistance = rows["machine", "phase resistance"]
    assert resistance["relative"] == pytest.approx((resistance["b"] - 2.35) / 2.35, rel=1e-6)
    assert found["macros_compared"] >= len(found["macros"]) > 5


def wrong(text: bytes) -> Callable[[bytes], bytes]:
    return lambda _: text


def edited(**parts: object) -> Callable[[bytes], bytes]:
    return lambda content: json.dumps(json.loads(content) | parts).encode()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (wrong(b"{"), "is not JSON"),
        (wrong(b"[1]"), "is not a result of dqforge"),
        (wrong(b'{"a": 1}'), "is not a result of dqforge"),
        (edited(command="fit"), "is the JSON of 'dqforge fit'"),
        (edited(format=99), "has the format 99, expected 1"),
        (edited(drive=None), "drive: is missing"),
        (edited(header={"prefix": "../x"}), "header.prefix: expected a C identifier"),
        (edited(header={"prefix": "bench001", "reference": 3}), "header.reference: cannot be read"),
        (edited(losses={"rows": [{"torque_Nm": "x"}]}), "losses.rows: not what dqforge writes"),
        (edited(drive={"r_s_Ohm": [1]}), "drive.r_s_Ohm: expected a number or a text"),
    ],
)
def test_faults_of_results_are_one_line(
    run: Run, written: Path, tmp_path: Path, change: Callable[[bytes], bytes], words: str
) -> None:
    path = tmp_path / "broken.json"
    path.write_bytes(change((written / "result.json").read_bytes()))
    code, out, err = run("compare", written, path)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert words in err
    assert "broken.json" in err


def test_faults_of_names_are_one_line(run: Run, written: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    os.mkfifo(tmp_path / "pipe.json")
    (tmp_path / "foreign.h").write_text("#ifndef X_H\n#define X_H\n#endif\n")
    for suffix in ("h", "json", "yaml"):
        (tmp_path / f"bytes.{suffix}").write_bytes(bytes([254, 0, 128, 10]) * 500)
    for name, words in (
        ("empty", "empty: the folder has no result.json"),
        ("foreign.h", "foreign.h: is no header of dqforge"),
        ("pipe.json", "pipe.json: cannot be read (this is a named pipe)"),
        ("bytes.h", "bytes.h: is no header of dqforge"),
        ("bytes.json", "bytes.json: is not JSON"),
        ("bytes.yaml", "bytes.yaml:1:1: the byte 0xFE"),
        ("", "a name is empty"),
        ("missing.json", "missing.json: cannot be read"),
        ("no-such-drive", "no-such-drive"),
    ):
        code, out, err = run("compare", written, name)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err


@pytest.mark.slow
def test_losses_with_and_without_the_bridge_are_not_compared() -> None:
    """A total without the bridge is smaller by what nobody knows; that is no saving."""
    base = make_design()
    bare = replace(base, inverter=replace(base.inverter, device=None))
    found = compare_sides(solved_side("a", base), solved_side("b", bare))
    assert found.losses == ()
    assert any("those of B are without the bridge" in note for note in found.alone)
