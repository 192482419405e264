"""A simulation runs the control in every format that the design emits, and says what it leaves out,
on the terminal, in the report and in JSON.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dqforge import cli
from dqforge.machines.design import catalogue
from dqforge.machines.names import NumberFormat
from dqforge.machines.plants.scenario import Profile, Scenario
from dqforge.optimizer.current_reference.forms import FixedReference
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.report import run_tables
from dqforge.reports.simulation.design_run import in_float32, simulate_design
from dqforge.reports.simulation.plant_input import format_text, not_simulated, simulated
from dqforge.reports.simulation.tables import plain_simulation, simulation_html, simulation_tables
from dqforge.reports.verification.host import Verification

CASES: dict[str, tuple[tuple[NumberFormat, ...], NumberFormat, str, str]] = {
    "control q15": (("q15",), "float32", "runs the q15 control", ""),
    "control in all": (
        ("q31", "float32", "q15"),
        "float32",
        "runs the float32 and the q15 and the q31 control",
        "",
    ),
    "reference q15": (
        (),
        "q15",
        "runs the float32 control; the emitted q15 is not simulated",
        "q15",
    ),
    "reference q15, control q31": (
        ("q31",),
        "q15",
        "runs the q31 control; the emitted q15 is not simulated",
        "q15",
    ),
    "reference and control q15": (("q15",), "q15", "runs the q15 control", ""),
    "float32": (("float32",), "float32", "", ""),
    "no control": ((), "float32", "", ""),
}


@pytest.fixture(scope="module")
def solved() -> dict[str, Solution]:
    """The bench drive with a current reference in float32 and in Q15."""
    scenario = Scenario(0.02, "speed", Profile((0.0,), (10.0,)))
    design = replace(catalogue.load("paper001-pmsm-bench"), losses=None, simulation=scenario)
    design = replace(design, fit=replace(design.fit, form="polynomial", degree=2, segments=1))
    found = solve(design)
    coarse = replace(design, fit=replace(design.fit, format="q15"))
    return {"float32": found, "q15": replace(found, design=coarse, fit=solve_fit(coarse).fit)}


def asked(solved: dict[str, Solution], name: str) -> Solution:
    """The solution with the control functions of a case (whose evidence plays no part here)."""
    control, reference, *_ = CASES[name]
    solution = solved[reference]
    export = replace(solution.design.export, control=control)
    return replace(solution, design=replace(solution.design, export=export))


@pytest.mark.parametrize("name", CASES)
def test_the_formats_that_are_simulated_and_those_that_are_not(
    name: str, solved: dict[str, Solution]
) -> None:
    said, left = CASES[name][2:]
    solution = asked(solved, name)
    assert list(not_simulated(solution)) == ([left] if left else [])
    assert format_text(simulated(solution), not_simulated(solution)) == said
    run = " ".join(
        cell
        for table in run_tables(solution, Verification(0, 0, ()))
        for row in table.rows
        for cell in row
    )
    assert ("not simulated" in run) == bool(left)
    assert not left or said in run


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["float32", "reference q15"])
def test_a_simulation_says_it_everywhere(name: str, solved: dict[str, Solution]) -> None:
    said, left = CASES[name][2:]
    solution = asked(solved, name)
    found = simulate_design(solution.design, solution=solution)
    terminal = " ".join(
        cell for table in simulation_tables(found) for row in table.rows for cell in row
    )
    page = " ".join(
        str(cell) for table in simulation_html(found) for row in table.rows for cell in row.cells
    )
    plain = plain_simulation(found)
    assert plain["format"] == "float32"
    assert plain["not_simulated"] == ([left] if left else [])
    for text in (terminal, page):
        assert ("not simulated" in text) == bool(left)
        assert not said or said in text


def test_a_reference_in_fixed_point_is_run_in_float32(solved: dict[str, Solution]) -> None:
    """The form is the same; its currents lie within some codes of the emitted ones."""
    coarse = solved["q15"].fit.reference
    assert isinstance(coarse, FixedReference)
    fine = in_float32(solved["q15"]).fit.reference
    torque = np.linspace(-1.0, 1.0, 41, dtype=np.float32) * np.float32(coarse.torque_max)
    gaps = np.array(fine.currents(torque)) - np.array(coarse.currents(torque))
    assert np.max(np.abs(gaps)) < 4.0 * coarse.current_base / 32768.0
    assert in_float32(solved["float32"]) is solved["float32"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "formats", "said"),
    [
        ({"export": {"control": "q15"}}, ["q15"], "runs the q15 control"),
        (
            {"export": {"control": ["float32", "q15"]}},
            ["float32", "q15"],
            "runs the float32 and the q15 control",
        ),
        (
            {"fit": {"format": "q31", "form": "polynomial"}},
            ["float32"],
            "runs the float32 control; the emitted q31 is not simulated",
        ),
    ],
)
def test_through_the_command_line(
    changes: dict[str, dict[str, object]],
    formats: list[str],
    said: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    design = yaml.safe_load(catalogue.read_text("paper001-pmsm-bench"))
    design.pop("losses")
    for section, keys in changes.items():
        design.setdefault(section, {}).update(keys)
    path, out = tmp_path / "design.yaml", tmp_path / "out"
    path.write_text(yaml.safe_dump(design), encoding="utf-8")
    for command in ("simulate", "run"):
        with pytest.raises(SystemExit) as stop:
            cli.main([command, str(path), "-o", str(out)])
        captured = capsys.readouterr()
        assert (stop.value.code, captured.err) == (0, "")
        assert said in captured.out or (command == "run" and "not simulated" not in said)
    page = (out / "report.html").read_text(encoding="utf-8")
    assert said in page
    simulated = json.loads((out / "result.json").read_text(encoding="ascii"))["simulation"]
    assert [simulated["format"], *(run["format"] for run in simulated["others"])] == formats
    samples = {file.name for file in out.glob("*_simulation*.npz")}
    assert len(samples) == len(formats)
    for name in samples:
        assert name in page
