"""The command line in-process: tables, JSON, files, exit codes, and one clear
line for every wrong input.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import math
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
import yaml
from hidden_compilers import hide_compilers

from dqforge import __version__, cli
from dqforge.machines.design import catalogue
from dqforge.machines.files.library_files import DESIGN_SCHEMA, with_modeline


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Run = Callable[..., Outcome]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run one command inside an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> Outcome:
        with pytest.raises(SystemExit) as stop:
            cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return Outcome(stop.value.code, captured.out, captured.err)

    return call


def one_line(outcome: Outcome, code: int) -> str:
    assert outcome.code == code
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.err
    return outcome.err


IPM = "paper000-ipmsm-100kw"
COMMANDS = sorted(
    command.callback.__name__ for command in cli.app.registered_commands if command.callback
)
PROPORTIONAL = {"form": "proportional", "gain": 1, "torque_max": 1}
BENCH = "paper001-pmsm-bench"


def test_version_and_help(run: Run) -> None:
    assert run("--version").out == f"dqforge {__version__}\n"
    outcome = run("--help")
    assert outcome.code == 0
    assert all(re.search(rf"^  {command} ", outcome.out, re.MULTILINE) for command in COMMANDS)
    assert run() == outcome


def test_every_command_stands_in_one_group_with_a_whole_summary(run: Run) -> None:
    shown = run("--help").out.partition("\nDesign:\n")[2]
    rows = re.findall(r"^  ([a-z]+)  +(\S.*)$", shown, re.MULTILINE)
    assert sorted(name for name, _ in rows) == COMMANDS
    assert all(len(summary) <= 50 and summary.endswith(".") for _, summary in rows)
    assert not any(summary.endswith("...") for _, summary in rows)


def test_help_of_each_command_says_what_it_does(run: Run) -> None:
    for command in COMMANDS:
        outcome = run(command, "--help")
        assert outcome.code == 0
        assert len(outcome.out.splitlines()) > 4


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Outcome, Path]:
    """What a run of the shipped drive says, and the folder that it wrote; never to be changed."""
    folder = tmp_path_factory.mktemp("kept")
    told, failed = io.StringIO(), io.StringIO()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(told),
        contextlib.redirect_stderr(failed),
        pytest.raises(SystemExit) as stop,
    ):
        cli.main(["run", IPM, "-o", "out"])
    assert isinstance(stop.value.code, int)
    return Outcome(stop.value.code, told.getvalue(), failed.getvalue()), folder / "out"


def test_run_writes_everything_and_verify_agrees(
    run: Run, tmp_path: Path, kept: tuple[Outcome, Path]
) -> None:
    outcome, folder = kept
    assert outcome.code == 0, outcome.err
    shutil.copytree(folder, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "dqforge-input",
        "dqforge-manifest.json",
        "ipm100.h",
        "ipm100_modulation.h",
        "ipm100_modulation_vectors.h",
        "ipm100_speed_observer.h",
        "ipm100_certificate.json",
        "ipm100_vectors.h",
        "report.html",
        "result.json",
    }
    assert "60608 results equal the model bit for bit, compiled as C99 and C++11" in outcome.out
    assert "mtpa with ddt-gdpwm: 781 W" in outcome.out
    verified = run("verify", "out")
    assert verified.code == 0
    assert "60608 results equal the model bit for bit" in verified.out
    assert re.search(
        r"8 files equal what dqforge-input/design\.yaml .*: \d+ macros, \d+ literals", verified.out
    )


def test_the_documentation_shows_what_a_run_prints(kept: tuple[Outcome, Path]) -> None:
    """The summary and the excerpt of the header on the pages are those of the shipped drive."""
    pages = Path(__file__).parent.parent / "docs" / "reference"
    outcome, folder = kept
    printed = " ".join(outcome.out.split())
    commands = (pages / "commands.md").read_text()
    start = commands.index("    IPMSM 100 kW (paper 000)")
    block = commands[start : commands.index("\n#", start)]
    assert len(block.splitlines()) > 10
    assert " ".join(block.split()) in printed
    page = (pages / "header.md").read_text()
    header = (folder / "ipm100.h").read_text()
    excerpt = page[page.index("```c") : page.index("```\n", page.index("```c") + 4)]
    code = [line.strip() for line in excerpt.splitlines()[1:] if line.strip() and "..." not in line]
    assert len(code) > 8
    assert all(line in header for line in code)


@pytest.mark.slow
def test_same_design_same_bytes(run: Run, tmp_path: Path) -> None:
    for folder in ("first", "second"):
        assert run("run", BENCH, "-o", folder, "--no-verify").code == 0
    for path in (path for path in (tmp_path / "first").iterdir() if path.is_file()):
        assert path.read_bytes() == (tmp_path / "second" / path.name).read_bytes(), path.name
        assert str(tmp_path).encode() not in path.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("name", catalogue.names())
def test_every_library_drive_exports_and_verifies(run: Run, name: str) -> None:
    outcome = run("export", name)
    assert outcome.code == 0, outcome.err
    assert "bit for bit" in outcome.out


@pytest.mark.slow
def test_changed_header_fails_verification(
    run: Run, tmp_path: Path, kept: tuple[Outcome, Path]
) -> None:
    shutil.copytree(kept[1], tmp_path / "out")
    header = tmp_path / "out" / "ipm100.h"
    text = header.read_text()
    header.write_text(re.sub(r"0\.6294F", "0.6295F", text, count=1))
    assert re.search(
        r"ipm100\.h:\d+: 0\.6295F, the design gives 0\.6294F$", one_line(run("verify", "out"), 1)
    )
    header.write_text(text.replace("i_q_A = torque /", "i_q_A = torque //"))
    assert re.search(
        r"ipm100\.h:\d+: '/', the design gives ' '$", one_line(run("verify", "out"), 1)
    )


@pytest.mark.parametrize(
    ("content", "phrase"),
    [
        (None, "cannot be read"),
        ("{", "is not JSON"),
        ("[]", "holds no header"),
        ('{"header": {}}', "header.prefix"),
        ('{"header": {"prefix": "../../etc/x"}}', "not an identifier"),
        ('{"header": {"prefix": "a"}}', "header.vectors"),
        ('{"header": {"prefix": "a", "vectors": 16, "reference": {"form": "x"}}}', "unknown"),
        (
            json.dumps({"header": {"prefix": "a", "vectors": 16, "reference": PROPORTIONAL}}),
            "a.h: cannot be read",
        ),
        ("[" * 100_000, "is not JSON"),
    ],
)
def test_what_is_no_output_is_not_read_as_headers(
    tmp_path: Path, content: str | None, phrase: str
) -> None:
    from dqforge.machines.errors import InputError
    from dqforge.reports.run import read_folder

    if content is not None:
        (tmp_path / "result.json").write_text(content)
    with pytest.raises(InputError) as caught:
        read_folder(tmp_path)
    assert phrase in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [None, "", "{", "[]", "{}", '{"layout": 1}', "[" * 100_000, '{"layout": 1, "parts": 3}'],
)
def test_verify_refuses_what_is_no_output(run: Run, tmp_path: Path, content: str | None) -> None:
    (tmp_path / "out").mkdir()
    if content is not None:
        (tmp_path / "out" / "dqforge-manifest.json").write_text(content)
    said = one_line(run("verify", "out"), 2)
    assert said.startswith("dqforge: out/dqforge-manifest.json: ")
    assert "run the design again" in said or "give the folder that" in said


JSON_KEYS = {
    "check": {"input"},
    "mtpa": {"mtpa"},
    "fit": {"fit", "weakening"},
    "tune": {"gains"},
    "losses": {"losses"},
}


@pytest.mark.parametrize("command", JSON_KEYS)
def test_json_envelope_is_versioned_and_pinned(run: Run, command: str) -> None:
    outcome = run(command, IPM, "--json")
    assert outcome.code == 0
    document = json.loads(outcome.out)
    assert set(document) == {"dqforge", "format", "command", "design"} | JSON_KEYS[command]
    assert document["dqforge"] == __version__
    assert document["format"] == 1
    assert document["command"] == command
    assert outcome.out == run(command, IPM, "--json").out


def test_json_holds_the_physics(run: Run) -> None:
    curves = json.loads(run("mtpa", IPM, "--json").out)["mtpa"]["chosen"]
    torque, i_d, i_q = (curves[key][100] for key in ("torque_Nm", "i_d_A", "i_q_A"))
    assert 1.5 * 4 * (0.1049 + (350e-6 - 592e-6) * i_d) * i_q == pytest.approx(torque, rel=1e-7)
    losses = json.loads(run("losses", IPM, "--json").out)["losses"]
    assert losses["best"] == [["mtpa", "ddt-gdpwm"]]
    assert {row["modulation"] for row in losses["rows"]} == {"spwm", "svpwm", "ddt-gdpwm"}


def test_bench_drive_has_the_paper_integers(run: Run) -> None:
    gains = json.loads(run("tune", BENCH, "--json").out)["gains"]
    assert (gains["speed"]["kp_q"], gains["speed"]["ki_ts_q"], gains["speed"]["q_formats"]) == (
        20000,
        2500,
        [10, 10],
    )
    assert (gains["i_q"]["kp_q"], gains["i_q"]["ki_ts_q"], gains["i_q"]["q_formats"]) == (
        136,
        26,
        [10, 15],
    )
    assert "20000 (Q10), 2500 (Q10)" in run("tune", BENCH).out


@pytest.mark.parametrize("command", ["check", "mtpa", "fit", "tune", "losses"])
def test_tables_print(run: Run, command: str) -> None:
    outcome = run(command, IPM)
    assert outcome.code == 0
    assert outcome.out.startswith("IPMSM 100 kW (paper 000)")
    assert "\x1b" not in outcome.out


@pytest.mark.thinned
@pytest.mark.parametrize("command", ["mtpa", "fit", "tune", "losses"])
@pytest.mark.parametrize("suffix", ["svg", "png"])
def test_plots(run: Run, tmp_path: Path, command: str, suffix: str) -> None:
    outcome = run(command, IPM, "--plot", f"figure.{suffix}")
    assert outcome.code == 0, outcome.err
    content = (tmp_path / f"figure.{suffix}").read_bytes()
    assert content.startswith(b"<?xml" if suffix == "svg" else b"\x89PNG")


def test_plot_with_an_unknown_suffix_or_folder(run: Run, tmp_path: Path) -> None:
    assert ".svg" in one_line(run("mtpa", IPM, "--plot", "figure.bmp"), 2)
    assert "cannot write" in one_line(run("mtpa", IPM, "--plot", "missing/figure.svg"), 2)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_new_check_run_round_trip(run: Run, tmp_path: Path) -> None:
    assert run("new", "bench").code == 0
    design = tmp_path / "bench" / "design.yaml"
    assert run("check", design).code == 0
    assert run("run", design, "-o", "out", "--no-verify").code == 0
    assert "exists already" in one_line(run("new", "bench"), 2)
    assert run("new", "copy", "--machine", IPM).code == 0
    copy = (tmp_path / "copy" / "design.yaml").read_bytes()
    assert copy == with_modeline(catalogue.read_text(IPM), DESIGN_SCHEMA)
    assert IPM in one_line(run("new", "other", "--machine", "paper000"), 2)


def test_check_refuses_scales_that_the_run_refuses(run: Run) -> None:
    """Bases of fixed-point control are judged before anything is solved."""
    fixed = ("--set", "export.control=q15", "--set", "control.per_unit.current=50 A")
    said = one_line(run("check", IPM, *fixed), 2)
    assert "50 A is full scale in fixed point" in said
    assert "write current: " in said
    assert run("check", IPM, *fixed[2:]).code == 0


@pytest.mark.slow
def test_machines_schema_and_reproduce(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    listing = run("machines").out
    assert all(name in listing for name in catalogue.names())
    assert yaml.safe_load(run("machines", IPM).out)["machine"]["resistance"]["value"] == "2 mOhm"
    schema = json.loads(run("schema").out)
    assert {"machine", "inverter", "control", "fit", "losses", "export"} <= set(
        schema["properties"]
    )
    assert {"machine", "inverter", "runs"} <= set(
        json.loads(run("schema", "--bench").out)["properties"]
    )
    assert "name one of them" in one_line(run("schema", "--bench", "--study"), 2)
    # without compilers: what is computed here, and what is left out with its reason
    monkeypatch.setenv("PATH", str(tmp_path))
    assert json.loads(run("reproduce", "000", "--json").out)["table_4"][0]["printed_loss"] == 1064.0
    assert "write: dqforge reproduce 000" in one_line(run("reproduce", "007"), 2)


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (["frobnicate"], "frobnicate"),
        (["fit"], "Missing argument"),
        (["fit", IPM, "--bogus"], "--bogus"),
        (["check", "missing.yaml"], "missing.yaml"),
        (["check", "."], "."),
        (["machines", "paper00"], "paper000"),
        (["machines", "--search", "toaster"], "nothing in the library matches 'toaster'"),
        (["machines", IPM, "--search", "hub"], "omit one of them"),
        (["run", "paper000"], "paper000"),
    ],
)
def test_wrong_command_lines(run: Run, tmp_path: Path, arguments: list[str], phrase: str) -> None:
    assert phrase in one_line(run(*arguments), 2)
    assert list(tmp_path.iterdir()) == []


def test_file_names_with_control_characters_stay_one_line(run: Run) -> None:
    line = one_line(run("check", "a\nb\x1b[31m.yaml"), 2)
    assert "\x1b" not in line


def broken_designs() -> list[tuple[str, str | bytes, int, int, str]]:
    path = Path(__file__).parent / "broken_designs.py"
    spec = importlib.util.spec_from_file_location("broken_designs", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return list(module.BROKEN)


BROKEN = broken_designs()


def test_there_are_enough_broken_designs() -> None:
    assert len(BROKEN) >= 40


@pytest.mark.thinned
@pytest.mark.parametrize("case", BROKEN, ids=[case[0] for case in BROKEN])
def test_broken_designs_give_one_line_exit_2_and_no_file(
    run: Run, tmp_path: Path, case: tuple[str, str | bytes, int, int, str]
) -> None:
    _, content, row, column, phrase = case
    path = tmp_path / "broken.yaml"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    line = one_line(run("run", "broken.yaml", "-o", "out"), 2)
    assert line.startswith(f"dqforge: broken.yaml:{row}:{column}: ")
    assert phrase in line
    assert [entry.name for entry in tmp_path.iterdir()] == ["broken.yaml"]


def test_design_without_solution_exits_1_and_leaves_nothing(run: Run, tmp_path: Path) -> None:
    text = catalogue.read_text(IPM).decode()
    path = tmp_path / "design.yaml"
    path.write_text(re.sub(r"max_torque: [^#\n]+", "max_torque: 250 N m ", text))
    assert "250 N m is out of reach" in one_line(run("run", "design.yaml", "-o", "out"), 1)
    path.write_text(re.sub(r"bandwidth: 500 Hz", "bandwidth: 40 kHz", text))
    assert "current_loop" in one_line(run("run", "design.yaml", "-o", "out"), 1)
    assert not (tmp_path / "out").exists()
    path.write_text(re.sub(r"torque: 130 N m", "torque: 1300 N m", text))
    assert "out of reach" in run("losses", "design.yaml").out


def test_out_that_cannot_be_written(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept")
    assert "-o" in one_line(run("export", IPM, "-o", "file", "--no-verify"), 2)
    assert (tmp_path / "file").read_text() == "kept"


def test_losses_of_a_design_without_comparison(run: Run) -> None:
    assert "section 'losses'" in one_line(run("losses", "abb-ipmsm-2k2"), 2)


def test_operating_points_at_a_speed_and_on_a_map(run: Run, tmp_path: Path) -> None:
    outcome = run("mtpa", IPM, "--speed", "6000 rpm", "--json", "--plot", "speed.svg")
    assert outcome.code == 0, outcome.err
    points = json.loads(outcome.out)["operating_points"]["points"]
    limit = json.loads(outcome.out)["operating_points"]["limit"]
    assert limit["v_max_V"] == pytest.approx(500.0 / 3**0.5, rel=1e-8)
    assert max(points["voltage_V"]) <= limit["v_max_V"] * (1.0 + 1e-8)
    assert max(points["kkt_residual"]) < 1e-8
    assert {"none", "voltage"} <= set(points["held_by"])
    chart = run(
        "mtpa",
        IPM,
        "--map",
        "12x15",
        "--json",
        "--plot",
        "map.svg",
        "--modulation",
        "spwm",
        "--margin",
        "5 %",
    )
    assert chart.code == 0, chart.err
    document = json.loads(chart.out)["operating_map"]
    assert document["limit"]["v_max_V"] == pytest.approx(0.95 * 250.0)
    assert len(document["map"]["efficiency"]) == 12
    assert {"speed.svg", "map.svg"} <= {path.name for path in tmp_path.iterdir()}


def test_operating_point_tables(run: Run) -> None:
    assert "voltage" in run("mtpa", IPM, "--torque", "100 N m", "--speed", "7000 rpm").out
    listing = run("mtpa", IPM, "--map", "8x9").out
    assert "base speed" in listing
    assert "4182 rpm" in listing
    assert "braking N m" in listing
    beyond = run("mtpa", IPM, "--torque", "500 N m", "--speed", "7000 rpm")
    assert "(no more)" in beyond.out
    assert beyond.code == 0


def test_one_operating_point_in_detail(run: Run) -> None:
    """Numbers of the JSON document against the dq equations, and against each other."""
    outcome = run("mtpa", IPM, "--torque", "-100 N m", "--speed", "6000 rpm")
    assert "voltage: the field is weakened" in outcome.out
    assert "optimality residual" in outcome.out
    document = json.loads(
        run("mtpa", IPM, "--torque", "-100 N m", "--speed", "6000 rpm", "--json").out
    )
    found = document["operating_points"]
    i_d, i_q = found["points"]["i_d_A"][0], found["points"]["i_q_A"][0]
    assert 1.5 * 4 * (0.1049 + (350e-6 - 592e-6) * i_d) * i_q == pytest.approx(-100.0, rel=1e-7)
    losses = found["losses"]
    assert losses["copper_W"][0] == pytest.approx(1.5 * 2e-3 * (i_d**2 + i_q**2), rel=1e-7)
    parts = losses["copper_W"][0] + losses["conduction_W"][0] + losses["switching_W"][0]
    assert losses["total_W"][0] == pytest.approx(parts, rel=1e-8)
    assert found["most_torque"]["torque_Nm"][0] < -100.0
    assert (
        json.loads(run("mtpa", "abb-ipmsm-2k2", "--torque", "1 N m", "--json").out)[
            "operating_points"
        ]["losses"]["conduction_W"]
        is None
    )


def test_least_total_loss_counts_iron_and_loses_less(run: Run, tmp_path: Path) -> None:
    """With iron loss the field is weakened before the voltage asks for it: less loss in total,
    more in the copper.
    """
    text = run("machines", IPM).out.replace(
        "\ninverter:",
        (
            "  iron_loss: {frequency: 400 Hz, flux: 0.12 Wb, hysteresis: 150 W, eddy: 250 W}\n"
            "inverter:"
        ),
        1,
    )
    (tmp_path / "iron.yaml").write_text(text, encoding="utf-8")
    where = ("mtpa", "iron.yaml", "--torque", "60 N m", "--speed", "6000 rpm", "--json")
    copper, total = (
        json.loads(run(*where, "--objective", name).out)["operating_points"]
        for name in ("copper", "total")
    )
    assert total["losses"]["total_W"][0] < 0.98 * copper["losses"]["total_W"][0]
    assert total["losses"]["copper_W"][0] > copper["losses"]["copper_W"][0]
    assert total["losses"]["iron_W"][0] < copper["losses"]["iron_W"][0]
    assert total["points"]["minimised_W"][0] == pytest.approx(
        total["losses"]["total_W"][0], rel=1e-2
    )
    assert "expected copper or total" in one_line(
        run("mtpa", IPM, "--map", "8x8", "--objective", "iron"), 2
    )


def test_speed_beyond_all_currents_has_no_solution(run: Run) -> None:
    """The ABB machine's back-EMF cannot be weakened enough above 4597 rpm."""
    line = one_line(run("mtpa", "abb-ipmsm-2k2", "--speed", "5000 rpm"), 1)
    assert "it can be kept up to 4597 rpm" in line
    assert "no current" in one_line(
        run("mtpa", "abb-ipmsm-2k2", "--torque", "1 N m", "--speed", "-5000 rpm"), 1
    )


def test_resistance_drop_beyond_the_voltage_limit(run: Run, tmp_path: Path) -> None:
    """IPM with 2 Ohm for 2 mOhm: 283 A take 566 V. Without a largest speed there is no
    speed at which a map ends.
    """
    text = catalogue.read_text(IPM).decode().replace("value: 2 mOhm", "value: 2 Ohm")
    text = text[: text.index("modulation_choice:")] + text[text.index("export:") :]
    path = tmp_path / "design.yaml"
    path.write_text(text)
    assert run("mtpa", path, "--map", "5x5").code == 0
    path.write_text(re.sub(r"  max_speed:.*\n(?:    .*\n)*", "", text))
    outcome = run("mtpa", path, "--map", "5x5")
    assert "resistance drop" in one_line(outcome, 1)


def test_map_document_holds_envelopes_and_loci(run: Run) -> None:
    document = json.loads(run("mtpa", "abb-syrm-6k7", "--map", "5x6", "--json").out)[
        "operating_map"
    ]
    assert set(document) == {
        "limit",
        "characteristics",
        "envelope",
        "braking_envelope",
        "loci",
        "map",
        "objective",
    }
    braking, motoring = document["braking_envelope"]["torque_Nm"], document["envelope"]["torque_Nm"]
    assert all(-low >= high * (1.0 - 1e-9) for low, high in zip(braking, motoring, strict=True))
    assert document["loci"]["mtpv"]["held_by"][0] == "MTPV"
    assert document["loci"]["mtpa"]["torque_Nm"][-1] == pytest.approx(
        document["characteristics"]["torque_max_Nm"]
    )


@pytest.mark.parametrize(
    ("arguments", "phrase"),
    [
        (["--map", "4"], "NxM"),
        (["--map", "1x9"], "NxM"),
        (["--map", "9999x9999"], "NxM"),
        (["--map", "4x4", "--speed", "1 rad/s"], "omit --speed and --torque"),
        (["--speed", "5 kHz"], "rotational speed"),
        (["--torque", "5 A"], "--torque"),
        (["--speed", "9 rad/s", "--modulation", "svm"], "ddt-gdpwm"),
        (["--speed", "9 rad/s", "--margin", "5"], "such as '5 %'"),
        (["--torque", "9 N m", "--plot", "x.svg"], "omit --torque"),
    ],
)
def test_wrong_operating_point_options(
    run: Run, tmp_path: Path, arguments: list[str], phrase: str
) -> None:
    assert phrase in one_line(run("mtpa", IPM, *arguments), 2)
    assert list(tmp_path.iterdir()) == []


def test_operating_points_need_the_strategy_that_they_solve(run: Run) -> None:
    assert "write strategy: mtpa" in one_line(
        run("mtpa", "paper002-pmsm-nonsinusoidal", "--speed", "9 rad/s"), 2
    )


@pytest.mark.slow
def test_poor_fits_are_called_so(run: Run, tmp_path: Path) -> None:
    text = catalogue.read_text(IPM).decode()
    path = tmp_path / "design.yaml"
    path.write_text(text.replace("degree: 4", "degree: 1").replace("segments: 2", "segments: 1"))
    assert "costs more than 1 % copper loss" in run("fit", path).out
    assert "costs more than" not in run("fit", IPM).out


def test_generating_speeds_are_points_of_comparison(run: Run, tmp_path: Path) -> None:
    """At the opposite speed the resistance drop helps the voltage.

    Copper and conduction losses are the same.
    """
    path = tmp_path / "design.yaml"
    path.write_text(
        catalogue.read_text(IPM).decode().replace("speed: 300 rad/s", "speed: -300 rad/s")
    )
    ours, theirs = (
        json.loads(run("losses", name, "--json").out)["losses"]["rows"] for name in (path, IPM)
    )
    for row, other in zip(ours, theirs, strict=True):
        assert row["conduction_W"] == other["conduction_W"]
        assert row["voltage_V"] < other["voltage_V"]


WAVES = "paper002-phase-waveforms"


@pytest.mark.slow
def test_phase_currents_are_emitted_verified_and_a_changed_entry_is_found(
    run: Run, tmp_path: Path
) -> None:
    assert run("run", WAVES, "-o", "out").code == 0
    assert "40256 results equal" in run("verify", "out").out
    header = tmp_path / "out" / "pmsm002w_waveform.h"
    text = header.read_text(encoding="ascii")
    table = text.index("waveform_table")
    entry = re.search(r"-\d\.\d{5,}F", text[table:])
    assert entry is not None
    changed = text[:table] + text[table:].replace(
        entry[0], entry[0][:-2] + str((int(entry[0][-2]) + 1) % 10) + "F", 1
    )
    header.write_text(changed, encoding="ascii")
    assert "pmsm002w_waveform.h:" in one_line(run("verify", "out"), 1)
    header.write_text(text, encoding="ascii")
    result = tmp_path / "out" / "result.json"
    document = json.loads(result.read_text(encoding="ascii"))
    result.write_text(
        json.dumps(document | {"waveform_header": "x"}, indent=1) + "\n", encoding="ascii"
    )
    assert "result.json:" in one_line(run("verify", "out"), 1)


@pytest.mark.slow
def test_phase_currents_of_the_command_line(run: Run, tmp_path: Path) -> None:
    """JSON against the phase model: constant torque at every angle, copper loss R mean(sum i^2)."""
    import numpy as np

    outcome = run(
        "dqy", WAVES, "--torque", "3.9 N m", "--speed", "2500 rpm", "--json", "--plot", "waves.svg"
    )
    document = json.loads(outcome.out)["waveforms"]
    flux = np.array(document["emf_over_omega_Wb"])
    for rule in ("dqx", "dqy", "limited"):
        currents = np.array(document["rules"][rule]["currents_A"])
        np.testing.assert_allclose(2.0 * np.sum(flux * currents, axis=0), 3.9, rtol=1e-8)
        loss = float(np.mean(np.sum(currents**2, axis=0)))
        assert document["rules"][rule]["copper_W"] == pytest.approx(loss, rel=1e-7)
    assert document["binding"] == ["voltage"]
    assert document["rules"]["dqy"]["breaks"] == ["dc link"]
    losses = [entry["copper_W"] for entry in document["ripple_front"]]
    assert losses == sorted(losses, reverse=True)
    assert (tmp_path / "waves.svg").stat().st_size > 1000
    assert "held by voltage" in run("dqy", WAVES, "--torque", "3.9 N m", "--speed", "2500 rpm").out


def test_phase_currents_that_cannot_be_had_or_asked_for(run: Run) -> None:
    impossible = one_line(run("dqy", WAVES, "--torque", "5 N m", "--speed", "3300 rpm"), 1)
    assert "it would take a current limit of" in impossible
    assert "sinusoidal back-EMF" in one_line(run("dqy", IPM), 2)
    assert "expected a, b or c" in one_line(run("dqy", WAVES, "--open-phase", "x"), 2)
    assert "share below 100 %" in one_line(run("dqy", WAVES, "--ripple", "200"), 2)
    assert "--torque" in one_line(run("dqy", WAVES, "--torque", "3 rpm"), 2)


def capture_file(path: Path) -> None:
    """Three sines of 50 Hz with a fifth of 3 %, four periods, German decimals."""
    import numpy as np

    time = np.arange(4000) / 50_000.0
    phases = []
    for lag in (0.0, 120.0, 240.0):
        theta = 2.0 * np.pi * 50.0 * time - np.radians(lag)
        phases.append(-20.0 * (np.sin(theta) + 0.03 * np.sin(5.0 * theta)))
    rows = [
        ";".join(f"{value:.6f}".replace(".", ",") for value in row)
        for row in zip(time, *phases, strict=True)
    ]
    path.write_text("\n".join(["Zeit [s];a [V];b [V];c [V]", *rows]), encoding="utf-8")


def test_capture_of_the_back_emf(run: Run, tmp_path: Path) -> None:
    """psi = 20 V / (2 pi 50 Hz) = 63.66 mWb, by hand; with 2 pole pairs 13.33 V/krpm peak of
    phase.
    """
    capture_file(tmp_path / "scope.csv")
    shown = run("bemf", "scope.csv", "--pole-pairs", "2", "--plot", "scope.png")
    assert shown.code == 0, shown.err
    assert "0.06366 Wb" in shown.out
    assert "13.33 V/krpm (phase peak)" in shown.out
    found = json.loads(run("bemf", "scope.csv", "--json").out)["bemf"]
    assert found["frequency_Hz"] == pytest.approx(50.0, rel=1e-6)
    assert found["constants_Vs_per_rad"] == {}
    assert found["omega_m_rad_per_s"] is None
    paired = json.loads(run("bemf", "scope.csv", "--pole-pairs", "2", "--json").out)["bemf"]
    assert paired["constants_Vs_per_rad"]["phase_peak"] == pytest.approx(0.12732, rel=1e-3)
    assert paired["omega_m_rad_per_s"] == pytest.approx(math.pi * 50.0, rel=1e-6)
    assert found["amplitudes_Wb"][1][4] / found["amplitudes_Wb"][1][0] == pytest.approx(
        0.03, rel=1e-3
    )
    assert found["sequence"] == "abc"
    lines = run("bemf", "scope.csv", "--line-to-line").out
    assert "do not contain the zero sequence" in lines


def test_captures_that_are_none(run: Run, tmp_path: Path) -> None:
    capture_file(tmp_path / "scope.csv")
    assert "no such file" in one_line(run("bemf", "nosuch.csv"), 2)
    assert "three factors" in one_line(run("bemf", "scope.csv", "--scale", "1,x"), 2)
    assert "above 0" in one_line(run("bemf", "scope.csv", "--pole-pairs", "0"), 2)
    assert "1 to 200" in one_line(run("bemf", "scope.csv", "--harmonics", "0"), 2)
    assert "no column 'z'" in one_line(run("bemf", "scope.csv", "--columns", "z,a,b,c"), 2)
    lines = (tmp_path / "scope.csv").read_text(encoding="utf-8").splitlines()
    lines[1000] = lines[1000].rsplit(";", 1)[0] + ";overload"
    (tmp_path / "scope.csv").write_text("\n".join(lines), encoding="utf-8")
    assert "scope.csv:1001" in one_line(run("bemf", "scope.csv"), 2)


@pytest.mark.slow
def test_budget_of_a_fit_is_shown_with_what_was_tried(run: Run, tmp_path: Path) -> None:
    text = run("machines", IPM).out
    start, end = text.index("\nfit:"), text.index("\n\n", text.index("\nfit:"))
    budget = "\nfit: {torque_error: 0.2 %, loss_penalty: 0.1 %, flash: 256 B, max_torque: 200 N m}"
    (tmp_path / "budget.yaml").write_text(text[:start] + budget + text[end:], encoding="utf-8")
    shown = run("fit", "budget.yaml").out
    assert "Forms tried for the budget" in shown
    document = json.loads(run("fit", "budget.yaml", "--json").out)["fit"]
    assert document["errors"]["torque_relative"] <= 2e-3
    assert document["trials"][-1]["quick"] is False
    assert run("run", "budget.yaml", "-o", "out").code == 0
    assert "Forms tried for the budget" in (tmp_path / "out" / "report.html").read_text(
        encoding="utf-8"
    )


@pytest.mark.slow
def test_simulation_with_the_emitted_controller(run: Run, tmp_path: Path) -> None:
    """The bench drive starts to 1200 rpm and turns back.

    Figures, samples, JSON and picture agree.
    """
    import numpy as np

    shown = run("simulate", BENCH, "-o", "out", "--plot", "run.svg")
    assert shown.code == 0, shown.err
    assert shown.err == ""
    assert "rise time" in shown.out
    archive = np.load(tmp_path / "out" / "bench001_simulation.npz")
    assert archive["t"].size == 5001
    assert archive["omega_m"][2499] * 30.0 / np.pi == pytest.approx(1200.0, abs=2.0)
    assert archive["omega_m"][-1] * 30.0 / np.pi == pytest.approx(-1200.0, abs=2.0)
    assert (tmp_path / "run.svg").stat().st_size > 10_000
    document = json.loads(run("simulate", BENCH, "--json").out)
    assert set(document) == {"dqforge", "format", "command", "design", "simulation", "out", "files"}
    found = document["simulation"]
    assert found["bounded"] is True
    assert [step["after"] for step in found["steps"]] == pytest.approx(
        [40.0 * np.pi, -40.0 * np.pi]
    )
    energy = found["energy_J"]
    assert energy["in"] == pytest.approx(energy["copper"] + energy["shaft"], rel=1e-3)
    assert document["simulation"]["inverter"] == "averaged"
    assert (
        json.loads(run("simulate", BENCH, "--json", "--switched").out)["simulation"]["inverter"]
        == "switched"
    )
    again = run("simulate", BENCH, "-o", "again")
    assert again.code == 0
    assert run("simulate", BENCH, "-o", "third", "--json").code == 0
    names = ("third/bench001_simulation.npz", "again/bench001_simulation.npz")
    assert len({(tmp_path / name).read_bytes() for name in names}) == 1


@pytest.mark.slow
def test_a_paper_computed_again_is_shown_without_compilers(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "98.6767" in run("reproduce", "000").out


@pytest.mark.slow
def test_simulation_is_in_the_report(run: Run, tmp_path: Path) -> None:
    assert run("run", BENCH, "-o", "out").code == 0
    assert (tmp_path / "out" / "bench001_simulation.npz").is_file()
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert 'id="simulation"' in report
    assert "Steps of the speed" in report
    written = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert list(written)[-1] == "simulation"
    simulated = run("simulate", BENCH, "-o", "simulated", "--json")
    assert written["simulation"] == json.loads(simulated.out)["simulation"]
    assert "not computed again" not in run("verify", "out").out
    # One folder for both: the samples are those of the run, and verify knows them.
    assert run("simulate", BENCH, "-o", "out").code == 0
    assert run("simulate", BENCH, "-o", "out", "--switched").code == 0
    verified = run("verify", "out")
    assert (verified.code, verified.err) == (0, "")
    assert (tmp_path / "out" / "bench001_simulation_switched.npz").is_file()


@pytest.mark.slow
def test_a_run_that_compiles_nothing_simulates_nothing(run: Run, tmp_path: Path) -> None:
    assert run("run", BENCH, "-o", "other", "--no-verify").code == 0
    assert "simulation" not in json.loads(
        (tmp_path / "other" / "result.json").read_text(encoding="utf-8")
    )
    assert not (tmp_path / "other" / "bench001_simulation.npz").exists()
    assert 'id="simulation"' not in (tmp_path / "other" / "report.html").read_text(encoding="utf-8")


def test_two_designs_have_a_folder_each(run: Run, tmp_path: Path) -> None:
    """The default folder has the name of the prefix; a folder that is named is one design's."""
    other = "abb-syrm-6k7"
    assert run("export", BENCH, "--no-verify").code == 0
    (header,) = (tmp_path / "out" / "bench001").glob("bench001.h")
    first = header.read_bytes()
    assert run("export", other, "--no-verify").code == 0
    assert header.read_bytes() == first
    assert len(list((tmp_path / "out").iterdir())) == 2
    line = one_line(run("export", other, "--no-verify", "-o", "out/bench001"), 2)
    assert "holds what dqforge made of PMSM bench (paper 001) (bench001), this is" in line
    assert header.read_bytes() == first
    changed = run("export", BENCH, "--no-verify", "--set", "machine.resistance=2.4 Ohm")
    assert changed.code == 0
    assert "replaced: bench001.h " in changed.out
    document = json.loads(run("export", BENCH, "--no-verify", "--json").out)
    assert "bench001.h" in document["replaced"]


def test_a_disk_that_is_full_is_not_a_fault_of_the_design(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("dqforge.reports.output.folder.replace_content", full)
    line = one_line(run("export", BENCH, "--no-verify", "-o", "there"), 2)
    assert line.startswith("dqforge: cannot write the folder there: No space left on device;")


def test_simulation_that_cannot_be_had(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "add a section such as simulation" in one_line(run("simulate", IPM), 2)
    assert "no folder" in one_line(run("simulate", BENCH, "--plot", "nosuch/run.svg"), 2)
    hide_compilers(monkeypatch)
    assert "dqforge[cc]" in one_line(run("simulate", BENCH), 1)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_phase_currents_of_a_salient_machine(run: Run, tmp_path: Path) -> None:
    """Torque from the printed currents by p (f'i + i' dL/dtheta i / 2) with the
    inductances of the file; the header.
    """
    import numpy as np

    name = "salient-phase-waveforms"
    document = json.loads(run("dqy", name, "--json").out)["waveforms"]
    flux = np.array(document["emf_over_omega_Wb"])
    theta = np.array(document["theta_rad"])
    slope = np.zeros((theta.size, 3, 3))
    for order, own, mutual in ((2, -1.8e-3, -1.8e-3), (4, 0.3e-3, -0.2e-3)):
        for k in range(3):
            wave = -order * np.sin(order * (theta - 2.0 * np.pi * k / 3.0))
            j, m = (k + 1) % 3, (k + 2) % 3
            slope[:, k, k] += own * wave
            slope[:, j, m] += mutual * wave
            slope[:, m, j] += mutual * wave
    for rule in ("dqx", "dqy", "limited"):
        currents = np.array(document["rules"][rule]["currents_A"])
        square = np.einsum("kx,xkl,lx->x", currents, slope, currents)
        np.testing.assert_allclose(
            2.0 * (np.sum(flux * currents, axis=0) + 0.5 * square), 3.0, rtol=1e-6
        )
    assert document["rules"]["limited"]["breaks"] == []
    assert document["rules"]["dqy"]["breaks"] == ["dc link"]
    assert document["confirmations"] == []
    assert 0.0 < document["optimality"]["floor_W"] < document["rules"]["limited"]["copper_W"]
    run("run", name, "-o", "out")
    assert "equal the model bit for bit" in run("verify", "out").out
    header = (tmp_path / "out" / "salientw_waveform.h").read_text(encoding="ascii")
    assert "not in proportion to the torque" in header
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "which no constant torque undercuts" in report


@pytest.mark.slow
def test_osqp_is_heard_in_the_report_and_in_json(run: Run, tmp_path: Path) -> None:
    entries = json.loads(run("dqy", WAVES, "--json").out)["waveforms"]["confirmations"]
    assert len(entries) == 7
    assert {entry["verdict"] for entry in entries} == {"confirmed"}
    assert "OSQP" not in run("dqy", WAVES).out
    run("run", WAVES, "-o", "out", "--no-verify")
    report = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for entry in entries:
        assert f"{entry['residuals_osqp']['largest']:.1e}" in report


def test_the_three_commands_of_the_readme(run: Run, tmp_path: Path) -> None:
    """From a data sheet to the file of a firmware, as the README types it."""
    readme = Path(__file__).resolve().parent.parent / "README.md"
    text = readme.read_text(encoding="utf-8").replace("\\\n", " ")
    lines = re.findall(r"^\$ dqforge ((?:new|tune|export) .*)$", text, re.MULTILINE)
    assert [line.split()[0] for line in lines] == ["new", "tune", "export"]
    for line in lines:
        outcome = run(*shlex.split(line))
        assert outcome.code == 0, outcome.err
    assert (tmp_path / "hub/vesc/motor_mcconf.xml").is_file()
