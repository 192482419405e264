"""Every capability keeps the promise of its record, and one from outside the package goes the
same way as those of the product.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from drives import SURFACE, make_design
from figure_pages import blank_figure
from toys.kinetic_energy import KINETIC_ENERGY

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings, ReferenceSettings
from dqforge.machines.errors import InputError, VerificationError
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Capabilities, Outcome, asked_for, header_kinds
from dqforge.reports.comparison.sides_compared import compare_sides
from dqforge.reports.comparison.sources import solved_side
from dqforge.reports.report import chapters, run_tables
from dqforge.reports.run import (
    RunOutput,
    export_design,
    plain_outcome,
    programmes,
    read_folder,
    run_design,
    verify_folder,
)
from dqforge.reports.verification.cortex_m import verify_on_target
from dqforge.reports.verification.host import verify_files

DOCS = Path(__file__).resolve().parents[2] / "docs"
MACHINE = replace(SURFACE, omega_m_max=900.0)
WITH_TOY: Capabilities = (*CAPABILITIES, KINETIC_ENERGY)


def small() -> Design:
    """A drive whose current reference is exact, which saves the fit."""
    return make_design(MACHINE)


def everything() -> Design:
    """Control in every format, a position observer and losses."""
    design = small()
    control = replace(
        design.control,
        observer=ObserverSettings(method="flux"),
        speed_loop=None,
        bases=replace(design.control.bases, speed=1000.0),
    )
    return replace(
        design, control=control, export=replace(design.export, control=("float32", "q15", "q31"))
    )


SECTIONS = """
field_weakening: {}
modulation_choice: {min_frequency: 16 kHz, max_frequency: 60 kHz, modulations: [svpwm, dpwm1],
  ripple_current: 1 A, torques: 6, speeds: 7}
"""


def with_sections() -> Design:
    text = catalogue.read_text("paper000-ipmsm-100kw").decode()
    text = re.sub(r"(?ms)^modulation_choice:.*?(?=^export:)", "", text)
    return load_text((text + SECTIONS).encode(), "design.yaml")


def scheduled() -> Design:
    text = catalogue.read_text("baldor-pmsyrm-5k6").decode()
    loop = "  current_loop:\n    method: damping\n    schedule: true\n    bandwidth: 250 Hz\n"
    text = re.sub(r"  current_loop:\n(    .*\n)+", loop, text)
    text = re.sub(r"  degree: \d+\n  segments: \d+", "  degree: 1\n  segments: 1", text)
    return load_text(text.encode(), "design.yaml")


def waves() -> Design:
    return catalogue.load("paper002-phase-waveforms", ["export.frame_tables=true"])


def without_loops() -> Design:
    """No section of the design asks for anything beside the current reference and the loops."""
    design = small()
    control = replace(design.control, observer=None, speed_loop=None)
    return replace(design, control=control, losses=None)


def beyond() -> Design:
    """Voltages beyond the linear range, with float32 control whose references move slowly, and the
    file of another firmware.
    """
    design = without_loops()
    references = ReferenceSettings(torque_slope=50.0, current_slope=5e3)
    return replace(
        design,
        control=replace(design.control, references=references),
        inverter=replace(design.inverter, overmodulation="least-phase-error"),
        operation=replace(design.operation, overmodulation="least-phase-error"),
        export=replace(design.export, firmware=("odrive",)),
    )


DESIGNS: dict[str, Callable[[], Design]] = {
    "bare": without_loops,
    "small": small,
    "beyond": beyond,
    "everything": everything,
    "sections": with_sections,
    "schedule": scheduled,
    "waveforms": waves,
}

NAMED = [
    "bare",
    "small",
    "beyond",
    "everything",
    *(pytest.param(name, marks=pytest.mark.slow) for name in ("sections", "schedule", "waveforms")),
]


@cache
def exported(name: str) -> RunOutput:
    return export_design(DESIGNS[name](), verify=False)


def outcome_of(name: str) -> Outcome:
    return Outcome(exported(name).solution)


# Which design asks for what. Negative torques, a mission, tolerances, a simulation and loops that
# do not hold have tests of their own in their rooms.
ASKED = {
    "bare": {"mtpa", "fit", "gains"},
    "small": {"mtpa", "fit", "gains", "losses", "speed_observer"},
    "beyond": {"mtpa", "fit", "gains", "overmodulation", "dynamic_references"} | {"firmware"},
    "everything": {
        "mtpa",
        "fit",
        "gains",
        "losses",
        "observer_proof",
        "control",
        "control_fixed",
        "reference_fixed",
    }
    | {"position_observer", "observer_fixed"},
    "sections": {"mtpa", "fit", "gains", "losses", "speed_observer", "weakening"}
    | {"modulation_choice"},
    "schedule": {"mtpa", "fit", "gains", "gain_schedule"},
    "waveforms": {"mtpa", "fit", "gains", "waveforms", "waveform_fit", "frame_tables"},
}
ELSEWHERE = {
    "application",
    "mtpa_negative",
    "fit_negative",
    "gains_left_out",
    "mission",
    "not_simulated",
    "six_step",
    "stability",
    "simulation",
    "current_feedback",
    "speed_measurement",
    "online_estimation",
    "commissioning",
    "start_up",
}


def test_each_capability_is_asked_for_by_one_of_the_designs() -> None:
    names = [capability.name for capability in CAPABILITIES]
    assert len(set(names)) == len(names)
    assert set.union(*ASKED.values()) | ELSEWHERE == set(names)


@pytest.mark.parametrize("name", NAMED)
def test_a_design_gets_what_it_asks_for_and_nothing_else(name: str) -> None:
    found = asked_for(CAPABILITIES, outcome_of(name))
    assert {capability.name for capability, _ in found} == ASKED[name]


@pytest.mark.parametrize("name", NAMED)
def test_the_result_holds_the_keys_of_its_record(name: str) -> None:
    outcome = outcome_of(name)
    plain = plain_outcome(outcome)
    for capability in CAPABILITIES:
        found = capability.of(outcome)
        asked = found is not None
        if capability.plain is not None:
            assert (capability.name in plain) == (capability.always or asked)
            assert (plain.get(capability.name) is not None) == asked
        for kind in capability.headers:
            described = kind.plain(outcome.solution, found) if asked else None
            assert (kind.key in plain) == (capability.always or described is not None)
            assert plain.get(kind.key) == described


@pytest.mark.thinned
@pytest.mark.parametrize("name", NAMED)
def test_every_header_is_named_read_back_and_gives_its_model(name: str) -> None:
    output = exported(name)
    prefix, solution = output.solution.design.export.prefix, output.solution
    kinds, parts = programmes(json.loads(output.files["result.json"]))
    wanted = {f"{prefix}.h", f"{prefix}_vectors.h", "result.json"}
    wanted |= {file for kind in kinds.values() for file in kind.file_names(prefix)}
    for capability, found in asked_for(CAPABILITIES, outcome_of(name)):
        wanted |= set(capability.emitted(output.solution, found))
    assert set(output.files) - {f"{prefix}_certificate.json"} == wanted
    rows = [replace(part, inputs=part.inputs[:500], model=part.model[:500]) for part in parts]
    checked = verify_files(output.files, prefix, solution.reference, 256, rows)
    assert checked.vectors + checked.sweep > 500 * len(rows)


@pytest.mark.parametrize("name", NAMED)
def test_every_part_of_the_report_is_written_once(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dqforge.reports.report.page_figure", blank_figure)
    outcome = outcome_of(name)
    found = asked_for(CAPABILITIES, outcome)
    written = {chapter.id: chapter.text for chapter in chapters(outcome.solution, found)}
    parts = [
        part for capability, result in found for part in capability.parts(outcome.solution, result)
    ]
    assert {part.chapter.id for part in parts} == {key for key, text in written.items() if text}
    for text in written.values():
        assert "<h2" not in text  # the frame of the report writes it
    drawn = sum(len(capability.figures(outcome.solution, result)) for capability, result in found)
    assert sum(text.count("<svg>") for text in written.values()) == drawn


@pytest.mark.parametrize("name", NAMED)
def test_what_is_shown_is_text_in_rows_as_wide_as_their_headings(name: str) -> None:
    outcome = outcome_of(name)
    for capability, result in asked_for(CAPABILITIES, outcome):
        for table in capability.tables(outcome.solution, result):
            assert table.rows
            assert all(len(row) == len(table.columns) for row in table.rows)
        for row in capability.summary(outcome.solution, result):
            assert all(row)


def documented() -> set[str]:
    """Keys in the first column of the table of keys, and those that its sentences name."""
    return set(re.findall(r"`(\w+)`", (DOCS / "reference" / "json.md").read_text(encoding="utf-8")))


def test_every_key_of_a_result_is_documented() -> None:
    told = documented()
    names = {capability.name for capability in CAPABILITIES if capability.plain is not None}
    keys = names | {kind.key for kind in header_kinds(CAPABILITIES)}
    assert keys - told == set()
    for name in ("bare", "small", "everything"):
        assert set(exported(name).plain) - told == set()


# The capability from outside: see docs/project/contributing.md.


@cache
def with_toy() -> RunOutput:
    return run_design(small(), verify=True, capabilities=WITH_TOY)


def test_a_capability_from_outside_reaches_result_report_summary_and_header() -> None:
    output = with_toy()
    plain = json.loads(output.files["result.json"])
    machine = output.solution.design.machine
    assert machine.inertia is not None
    assert machine.omega_m_max is not None
    energy = 0.5 * machine.inertia * machine.omega_m_max**2
    assert plain["kinetic_energy"]["largest_J"] == pytest.approx(energy, rel=1e-8)
    assert list(plain)[-2:] == ["kinetic_energy", "kinetic_energy_header"]
    report = output.files["report.html"].decode("utf-8")
    assert '<div id="kinetic_energy">' in report
    assert '<a href="#kinetic_energy">Kinetic energy</a>' in report
    assert "Kinetic energy over the mechanical speed." in report
    rows = run_tables(output.solution, output.verification, WITH_TOY)[-1].rows
    assert ("kinetic energy", f"{energy:.4g} J at the largest speed") in rows
    assert b"drive_kinetic_energy_J" in output.files["drive_kinetic_energy.h"]
    plain_run = export_design(small(), verify=False)
    for name in plain_run.files.keys() - {"result.json"}:
        assert output.files[name] == plain_run.files[name]


def test_a_capability_from_outside_is_left_out_where_it_is_not_asked_for() -> None:
    still = replace(small(), machine=replace(MACHINE, inertia=None))
    outcome = Outcome(replace(with_toy().solution, design=still))
    assert plain_outcome(outcome, WITH_TOY)["kinetic_energy"] is None
    assert plain_outcome(outcome, WITH_TOY)["kinetic_energy_header"] is None


@pytest.mark.slow
def test_a_header_from_outside_is_verified_like_the_others(tmp_path: Path) -> None:
    output = with_toy()
    for name, content in output.files.items():
        (tmp_path / name).write_bytes(content)
    found = verify_folder(tmp_path, WITH_TOY)
    assert found == output.verification
    before = verify_folder(tmp_path)
    assert found.sweep - before.sweep == 4001
    header = tmp_path / "drive_kinetic_energy.h"
    header.write_bytes(header.read_bytes().replace(b"* speed_rad_per_s)", b"+ speed_rad_per_s)"))
    with pytest.raises(VerificationError, match="results of the kinetic energy differ"):
        verify_folder(tmp_path, WITH_TOY)
    result = tmp_path / "result.json"
    text = result.read_text(encoding="ascii")
    result.write_text(text.replace('"half_inertia"', '"half"'), encoding="ascii")
    with pytest.raises(InputError, match="kinetic_energy_header is not what dqforge writes"):
        read_folder(tmp_path, WITH_TOY)


def test_a_header_from_outside_runs_on_an_emulated_core() -> None:
    if shutil.which("qemu-system-arm") is None or shutil.which("arm-none-eabi-gcc") is None:
        pytest.skip("no tools for an emulated core")
    output = with_toy()
    files = {name: text for name, text in output.files.items() if name.endswith(".h")}
    _, parts = programmes(output.plain, (KINETIC_ENERGY,))
    outcome = verify_on_target(files, "drive", "cortex-m4", parts)
    assert [(run.name, run.compared) for run in outcome.runs] == [("kinetic energy", 4001)]
    assert "drive_kinetic_energy.h" not in outcome.not_run


def test_a_capability_from_outside_is_compared() -> None:
    design = small()
    heavy = replace(design, machine=replace(MACHINE, inertia=1.2e-3))
    a, b = (solved_side(name, part, WITH_TOY) for name, part in (("a", design), ("b", heavy)))
    rows = {(row.section, row.label): row for row in compare_sides(a, b, WITH_TOY).rows}
    row = rows["kinetic energy", "largest"]
    assert row.differs
    assert row.relative == pytest.approx(0.2, rel=1e-6)
    assert ("kinetic energy", "largest") not in {
        (row.section, row.label) for row in compare_sides(a, b).rows
    }
