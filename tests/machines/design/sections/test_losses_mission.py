"""A mission named in a design file: read beside it, counted in the run, shown in the report."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_design, load_text
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import read_mission
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_mission
from dqforge.optimizer.losses.solve import solve_losses, solve_mission
from dqforge.reports.run import run_design

IPM = "paper000-ipmsm-100kw"
CYCLE = (
    "time [s]; speed [rpm]; torque [N m]\n0; 500; 60\n2; 2000; 120\n5; 3000; -40\n9; 0; 0\n"
    "12; 0; 0\n"
)
POINTS = "  points:\n    - {torque: 130 N m, speed: 300 rad/s}\n"


def written(
    folder: Path, *, points: bool = True, name: str = "cycle.csv", cycle: str = CYCLE
) -> Path:
    """A library drive with a mission beside it."""
    text = catalogue.read_text(IPM).decode()
    assert POINTS in text
    text = text.replace(POINTS, f"  mission: {name}\n" + (POINTS if points else ""))
    text = text[: text.index("modulation_choice:")] + text[text.index("export:") :]
    (folder / "cycle.csv").write_text(cycle, encoding="utf-8")
    path = folder / "design.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_mission_is_that_of_the_file_and_changes_the_digest(tmp_path: Path) -> None:
    design = load_design(written(tmp_path))
    assert design.losses is not None
    assert design.losses.mission is not None
    assert design.losses.mission.torque.tolist() == [60.0, 120.0, -40.0, 0.0]
    other = load_design(written(tmp_path, cycle=CYCLE.replace("120", "121")))
    assert other.digest != design.digest
    assert solve_losses(design) is not None


def test_energies_are_those_of_the_mission_by_itself(tmp_path: Path) -> None:
    design = load_design(written(tmp_path))
    found = solve_mission(design)
    assert found is not None
    alone = compare_mission(
        design.machine,
        design.inverter,
        read_mission(CYCLE.encode(), "cycle.csv"),
        Alternatives(("id0", "mtpa"), ("spwm", "svpwm", "ddt-gdpwm"), (100e3,)),
        i_max=design.i_max,
    )
    assert [run.total for run in found.runs] == pytest.approx([run.total for run in alone.runs])
    assert (found.runs[found.best].strategy, found.runs[found.best].modulation) == (
        "mtpa",
        "ddt-gdpwm",
    )
    # In the shaft 60 N m and 120 N m are driven, 40 N m braked: 2 s, 3 s, 4 s.
    speed = np.array([500.0, 2000.0, 3000.0]) * np.pi / 30.0
    assert found.runs[0].driving == pytest.approx(
        60.0 * speed[0] * 2.0 + 120.0 * speed[1] * 3.0, rel=1e-6
    )
    assert found.runs[0].braking == pytest.approx(-40.0 * speed[2] * 4.0, rel=1e-6)


@pytest.mark.thinned
@pytest.mark.parametrize("points", [True, False])
def test_report_and_result_show_it_with_and_without_points(points: bool, tmp_path: Path) -> None:
    files = run_design(load_design(written(tmp_path, points=points)), verify=False).files
    page, result = files["report.html"].decode("utf-8"), json.loads(files["result.json"])
    assert page.count('id="losses"') == 1
    assert "Energy lost over the mission by kind, in Wh" in page
    assert "MTPA, DDT-GDPWM" in page
    assert len(result["mission"]["alternatives"]) == 6
    assert (result["losses"] is None) == (not points)


def test_a_design_without_a_mission_has_none() -> None:
    assert solve_mission(catalogue.load(IPM)) is None


@pytest.mark.parametrize(
    ("name", "cycle", "phrase"),
    [
        ("../cycle.csv", CYCLE, "lies outside the folder"),
        ("/etc/passwd", CYCLE, "lies outside the folder"),
        ("other.csv", CYCLE, "there is no file 'other.csv'"),
        ("cycle.csv", CYCLE.replace("2; 2000", "0; 2000"), "does not lie after"),
        ("cycle.csv", CYCLE.replace("3000", "30000"), "above machine.max_speed"),
        ("cycle.csv", "nothing\n", "cycle.csv"),
    ],
)
def test_what_is_no_mission_is_refused(name: str, cycle: str, phrase: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_design(written(tmp_path, name=name, cycle=cycle))
    assert phrase in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_comparison_of_nothing_and_a_file_beside_a_library_drive_are_refused() -> None:
    text = catalogue.read_text(IPM).decode()
    with pytest.raises(InputError, match="losses needs points or a mission") as caught:
        load_text(text.replace(POINTS, "").encode(), "design.yaml")
    assert caught.value.line is not None
    with pytest.raises(InputError, match="cannot name files"):
        load_text(text.replace(POINTS, "  mission: cycle.csv\n").encode(), "design.yaml")
