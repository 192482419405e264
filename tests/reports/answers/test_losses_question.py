"""Loss maps and missions from the command line: tables, JSON, figures and faults."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.losses.machine_budget import MachineLoss
from dqforge.optimizer.losses.drive_budget import PARTS
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import solve_map
from dqforge.reports.losses.map_figures import plot_loss_map
from dqforge.reports.losses.map_tables import map_tables
from dqforge.reports.pages.html_text import NOT_COMPARED, part_label

IPM = "paper000-ipmsm-100kw"
MISSION = (
    "Zeit [s];Drehzahl [1/min];Drehmoment [Nm]\n0,0;300;20\n2,5;1500;120,5\n3;2500;-80\n5;500;5\n"
    "10;0;0\n"
)
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mission.csv").write_text(MISSION, encoding="utf-8")

    def call(*arguments: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as stop:
            cli.main(["losses", *arguments])
        captured = capsys.readouterr()
        assert isinstance(stop.value.code, int)
        return stop.value.code, captured.out, captured.err

    return call


def test_map_names_the_winner_everywhere(run: Run) -> None:
    options = (
        "--strategies",
        "mtpa,id0",
        "--modulations",
        "spwm,svpwm,ddt-gdpwm",
        "--frequencies",
        "20 kHz,100 kHz",
    )
    code, out, err = run(IPM, "--map", "6x8", *options, "--json", "--plot", "map.svg")
    assert (code, err) == (0, "")
    found = json.loads(out)["loss_map"]
    assert len(found["alternatives"]) == 12
    assert (len(found["best"]), len(found["best"][0])) == (6, 8)
    for i, row in enumerate(found["best"]):
        for j, best in enumerate(row):
            totals = {
                k: entry["total_W"][i][j]
                for k, entry in enumerate(found["alternatives"])
                if entry["usable"][i][j]
            }
            assert (best == -1) == (not totals)
            if totals:
                assert totals[best] <= min(totals.values()) * (1.0 + 1e-8)
    assert sum(entry["least_share"] for entry in found["alternatives"]) == pytest.approx(
        np.mean(np.array(found["best"]) >= 0)
    )
    for entry in found["alternatives"]:
        assert entry["mean_total_W"] == pytest.approx(sum(entry["mean_W"].values()), rel=1e-7)
        usable = np.array(entry["usable"])
        assert entry["usable_share"] == pytest.approx(np.mean(usable))
        assert entry["junction_max_degC"] == np.max(np.array(entry["junction_degC"])[usable])
    assert found["dead_time_share"] == pytest.approx([0.004, 0.04])
    drawn = Path("map.svg").read_text(encoding="utf-8")
    assert "DDT-GDPWM" in drawn
    assert "least" in drawn
    code, out, _ = run(IPM, "--map", "6x8", *options)
    assert code == 0
    assert "Alternative of least loss" in out
    assert "least at %" in out
    # 200 ns at 20 and 100 kHz: once where a phase rests, twice otherwise.
    assert "dead time is compensated, which takes 0.4 to 4 % of the linear range" in out


def test_mission_counts_energy_and_follows_the_junction(run: Run) -> None:
    code, out, err = run(
        IPM, "--mission", "mission.csv", "--modulations", "svpwm,dpwm1", "--json", "--plot", "m.svg"
    )
    assert (code, err) == (0, "")
    found = json.loads(out)["mission"]
    for row in found["alternatives"]:
        assert row["total_J"] == pytest.approx(sum(row["energy_J"].values()), rel=1e-7)
        assert row["input_J"] == pytest.approx(
            row["total_J"] + row["driving_J"] + row["braking_J"], rel=1e-7
        )
        assert row["usable"]
    totals = [row["total_J"] for row in found["alternatives"]]
    assert totals[found["best"]] == min(totals)
    assert (
        max(found["course"]["junction_degC"])
        == found["alternatives"][found["best"]]["junction_max_degC"]
    )
    assert Path("m.svg").is_file()
    code, out, _ = run(IPM, "--mission", "mission.csv")
    assert code == 0
    assert "best" in out
    assert "swing K" in out
    assert "which takes 2 to 4 % of the linear range" in out


def test_every_kind_of_loss_has_a_heading_and_a_colour() -> None:
    design = replace(
        catalogue.load(IPM),
        machine_loss=MachineLoss(1e-9, 0.05, 1e-5, 1e-10),
        inverter=replace(catalogue.load(IPM).inverter, capacitor_esr=1e-3),
    )
    found = solve_map(design, Alternatives(("mtpa",), ("svpwm",), (1e4,)), 0.0, 4, 4)
    texts = [text.get_text() for text in plot_loss_map(found).findobj(Text)]
    columns = map_tables(design, found)[0].columns
    # Nothing is known of this device's diode, and so of the dead time's loss.
    assert {f"{part_label(part)} W" for part in set(PARTS) - {"dead_time"}} <= set(columns)
    assert {"copper", "iron", "ripple iron", "switching"} <= set(texts)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--map", "6x8", "--mission", "mission.csv"), "one at a time"),
        (("--map", "6"), "--map: expected NxM"),
        (("--map", "6x8", "--modulations", "pwm"), "--modulations: expected some of spwm"),
        (("--map", "6x8", "--strategies", "mtpa,mtpa"), "--strategies: write each name once"),
        (("--map", "6x8", "--frequencies", "20 V"), "--frequencies: expected a frequency"),
        (("--map", "6x8", "--margin", "95 %"), "--margin: expected a share"),
        (("--map", "2000x2000"), "budgets are requested"),
        (("--map", "6x8", "--points", "1 N m 90 rpm"), "have their own points"),
        (("--points", "130 N m"), "--points: '130 N m' is no torque and speed"),
        (("--points", "130 N m 3000"), "--points: '3000' has no unit; write '3000 rpm' or"),
        (("--points", "130 3000 rpm"), "--points: '130' has no unit; write '130 N m'"),
        (("--points", "9 N m 90 krpm"), "--points: 90 krpm is above machine.max_speed"),
        (("--mission", "none.csv"), "none.csv: there is no such file"),
        (("--mission", "late.csv"), "late.csv:3: time 0 s does not lie after"),
        (("--mission", "fast.csv"), "fast.csv:2: speed 20000 rpm is above machine.max_speed"),
    ],
)
def test_faults_are_one_line(run: Run, arguments: tuple[str, ...], message: str) -> None:
    Path("late.csv").write_text("t [s],n [rpm],M [Nm]\n0,1,1\n0,1,1\n", encoding="utf-8")
    Path("fast.csv").write_text("t [s],n [rpm],M [Nm]\n0,20000,1\n1,1,1\n", encoding="utf-8")
    code, out, err = run(IPM, *arguments)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1
    assert message in err


def test_points_and_alternatives_of_the_command_line_stand_in_one_table(run: Run) -> None:
    """Each row is that of a command with its point and its alternative alone."""
    names, points = ("svpwm", "dpwm1"), ("90 N m 2000 rpm", "40 N m @ 1 krpm")
    words = ("--strategies", "mtpa", "--json")
    both = ("--points", ", ".join(points), "--frequencies", "8 kHz, 16 kHz")
    code, out, err = run(IPM, *both, "--modulations", "svpwm, dpwm1", *words)
    assert (code, err) == (0, "")
    found = json.loads(out)["losses"]
    rows = {
        (row["torque_Nm"], row["switching_frequency_Hz"], row["modulation"]): row["total_W"]
        for row in found["rows"]
    }
    assert len(rows) == 8
    for torque, point in zip((90.0, 40.0), points, strict=True):
        for f_sw, text in ((8e3, "8 kHz"), (16e3, "16 kHz")):
            alone = ("--points", point, "--frequencies", text, "--modulations", ",".join(names))
            single = json.loads(run(IPM, *alone, *words)[1])["losses"]["rows"]
            assert [row["total_W"] for row in single] == [rows[torque, f_sw, n] for n in names]
    for torque, (strategy, modulation, f_sw) in zip((90.0, 40.0), found["best"], strict=True):
        totals = {key: total for key, total in rows.items() if key[0] == torque}
        assert strategy == "mtpa"
        assert min(totals, key=lambda key: totals[key]) == (torque, f_sw, modulation)
    code, out, _ = run(IPM, *both, "--modulations", "svpwm, dpwm1", "--strategies", "mtpa")
    assert code == 0
    assert out.count(" f_sw Hz ") == out.count(" best ") == 2


def test_the_points_of_the_design_take_alternatives(run: Run) -> None:
    code, out, err = run(IPM, "--modulations", "spwm", "--margin", "5 %", "--json")
    assert (code, err) == (0, "")
    assert {row["modulation"] for row in json.loads(out)["losses"]["rows"]} == {"spwm"}


def test_a_list_that_lacks_its_brackets_is_written_with_them(run: Run) -> None:
    code, _, err = run(IPM, "--set", "losses.modulations=svpwm, dpwm1")
    assert code == 2
    assert "got the text 'svpwm, dpwm1'; write [svpwm, dpwm1]" in err


def test_the_points_take_what_the_refusals_name(run: Run) -> None:
    def rows(*settings: str) -> list[dict[str, object]]:
        words = [word for setting in settings for word in ("--set", setting)]
        code, out, err = run(IPM, *words, "--json")
        assert (code, err) == (0, "")
        found: list[dict[str, object]] = json.loads(out)["losses"]["rows"]
        return found

    named = ("losses.modulations=[spwm, svpwm]", "losses.strategies=[mtpa, id0]")
    found = rows(*named)
    assert {row["modulation"] for row in found} == {"spwm", "svpwm"}
    assert {row["strategy"] for row in found} == {"mtpa", "id0"}
    slower = rows(*named, "inverter.switching_frequency=50 kHz")
    assert [row["switching_W"] for row in slower] != [row["switching_W"] for row in found]


@pytest.mark.parametrize("mission", [False, True])
def test_a_design_without_a_switch_is_compared_without_the_bridge(run: Run, mission: bool) -> None:
    Path("m.csv").write_text("t [s],n [rpm],M [Nm]\n0,100,10\n1,100,5\n2,0,0\n", encoding="utf-8")
    arguments = ("--mission", "m.csv") if mission else ("--map", "4x4")
    code, out, err = run("abb-ipmsm-2k2", *arguments, "--plot", "losses.svg")
    assert (code, err) == (0, "")
    assert "the design has no inverter.device: the total is without the bridge" in " ".join(
        out.split()
    )
    assert "conduction" not in out.split("the design has")[0]
    assert NOT_COMPARED in out
    assert " best" not in out
    assert "Alternative of least loss" not in out
    found = json.loads(run("abb-ipmsm-2k2", *arguments, "--json")[1])
    part = found["mission" if mission else "loss_map"]
    assert not part["compared"]
    assert part["best"] is None if mission else {-1} == set(np.ravel(part["best"]).tolist())
    assert "nan" not in Path("losses.svg").read_text(encoding="utf-8")


def test_torque_that_cannot_be_had_is_named_by_line(run: Run) -> None:
    Path("m.csv").write_text("t [s],n [rpm],M [Nm]\n0,100,10\n1,100,500\n2,0,0\n", encoding="utf-8")
    code, out, _ = run(IPM, "--mission", "m.csv", "--modulations", "svpwm")
    assert code == 0
    assert (
        "m.csv:3: torque or voltage is out of reach (1 row) with id0 svpwm, mtpa svpwm"
        in " ".join(out.split())
    )


@pytest.mark.slow
def test_files_are_the_same_bytes_every_time(run: Run) -> None:
    for name in ("a.svg", "b.svg"):
        assert run(IPM, "--map", "5x6", "--plot", name)[0] == 0
    assert Path("a.svg").read_bytes() == Path("b.svg").read_bytes()
