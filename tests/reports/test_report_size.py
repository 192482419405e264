"""Reports stay small, and are written faster than what they tell is solved, whatever a design
asks for: each section by itself, and the keys that add pictures.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from figure_pages import page_tables

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.optimizer.solution import solve
from dqforge.reports.command_line.designs import load
from dqforge.reports.report import render_report
from dqforge.reports.run import run_design

EXAMPLES = Path(__file__).parents[2] / "examples"
LARGEST = 1_000_000
MOST_CELLS = 60_000  # Of the data of one figure; a map of 56 by 56 points in two panels has 18,816.
SLACK = 5.0  # Process time in s that a report may take beyond that of solving, on a busy machine.
IPM, SERVO, PHASES = "paper000-ipmsm-100kw", "abb-ipmsm-2k2", "paper002-phase-waveforms"
SIX_STEP, THIRD = "six-step-drive.yaml", "third-harmonic-start.yaml"
FLUX = "control.observer={method: flux}"

# What is asked for, the drive, and what is set in it.
CHEAP: dict[str, tuple[str, tuple[str, ...]]] = {
    "field_weakening": (IPM, ("field_weakening={speed: 6000 rpm, flash: 2048 B}",)),
    "waveform": (PHASES, ("waveform.open_phase=a",)),
    "control.references": (SERVO, ("control.references={torque_slope: 100 N m/s}",)),
}
SLOW: dict[str, tuple[str, tuple[str, ...]]] = {
    "losses": (IPM, ()),
    "control.observer": (SERVO, ("control.observer={method: open-loop-flux}",)),
    "export.control": (SERVO, ("export.control=float32",)),
    "export.frame_tables": (PHASES, ("export.frame_tables=true",)),
    "operation": (IPM, ("operation.speed=5000 rpm", "fit.max_torque=150 N m")),
    "operation.overmodulation": (
        IPM,
        (
            "operation={speed: 5000 rpm, overmodulation: least-phase-error}",
            "fit.max_torque=150 N m",
        ),
    ),
    "fit": (SERVO, ("fit={form: polynomial, degree: 6, segments: 4}",)),
    "modulation_choice": (IPM, ("modulation_choice.torques=60", "modulation_choice.speeds=60")),
    "control.current_loop": ("abb-syrm-6k7-saturated", ("control.current_loop={schedule: true}",)),
    "control.speed_loop": (SERVO, ("control.speed_loop.ratio=5",)),
    "control.observer, tuned": (SERVO, ("control.observer={method: ekf}",)),
    "control.per_unit": (
        SERVO, ("fit.format=q15", "export.control=q15", "control.per_unit.torque=26 N m"),
    ),
    "control.tolerances": (
        SERVO, ("control.tolerances={r_s: 30 %, l_d: 20 %, l_q: 20 %, psi_pm: 10 %}",),
    ),
    "control.firmware": (SERVO, ("control.firmware={name: vesc}",)),
    "control.six_step": (SIX_STEP, ("control.six_step={filter_time: 10 us}",)),
    "control.start_up": (THIRD, ()),
    "control.online_estimation": (
        "paper001-pmsm-bench", ("control.online_estimation={time_constant: 1 s}",),
    ),
    "control.commissioning": ("paper001-pmsm-bench", ("control.commissioning={rows: 256}",)),
    "export.application": (
        SERVO,
        (FLUX, "control.start_up={method: i-f}", "export.control=float32",
         "export.application=skeleton"),
    ),
    "inverter.current_sensing": (
        SERVO, ("inverter.current_sensing={shunt: 1 mOhm, gain: 20, reference: 3.3 V}",),
    ),
}  # fmt: skip
# As many sections at once as one drive takes.
TOGETHER = (
    IPM,
    (
        "field_weakening={speed: 6000 rpm, flash: 2048 B}",
        "operation={speed: 5000 rpm, overmodulation: least-phase-error}",
        "fit={form: polynomial, degree: 6, segments: 4, max_torque: 150 N m}",
        "modulation_choice.torques=20",
        "modulation_choice.speeds=20",
        "control.speed_loop.ratio=5",
        FLUX,
        "control.references={torque_slope: 100 N m/s}",
        "control.tolerances={r_s: 20 %, l_d: 10 %, l_q: 10 %, psi_pm: 5 %}",
        "export.control=float32",
        "control.start_up={method: i-f}",
        "export.application=skeleton",
        "inverter.current_sensing={shunt: 1 mOhm, gain: 20, reference: 3.3 V}",
    ),
)

SIMULATED = ("paper001-pmsm-bench", "salient-phase-waveforms", SIX_STEP, THIRD)

# What every design has, sections of which each key stands here, and what adds files alone;
# simulations are below.
NOT_PICTURED = {
    "dqforge", "name", "about", "machine", "inverter", "control", "export", "simulation",
    "control.sampling_frequency", "control.gains", "export.prefix", "export.vectors",
    "export.firmware",
}  # fmt: skip


def found(name: str) -> str:
    return str(EXAMPLES / name) if name.endswith(".yaml") else name


def judge(page: str) -> None:
    assert len(page.encode()) < LARGEST
    for name, table in page_tables(page).items():
        assert sum(map(len, table.values())) < MOST_CELLS, name


@pytest.mark.parametrize(
    ("drive", "sets"),
    [
        *(pytest.param(*case, id=name) for name, case in CHEAP.items()),
        *(pytest.param(*case, id=name, marks=pytest.mark.slow) for name, case in SLOW.items()),
        pytest.param(*TOGETHER, id="all together", marks=pytest.mark.slow),
    ],
)
def test_a_report_is_small_and_soon_written(drive: str, sets: tuple[str, ...]) -> None:
    design = load(found(drive), list(sets))
    begun = time.process_time()
    solution = solve(design)
    solved = time.process_time()
    page = render_report(solution, None)
    written = time.process_time()
    judge(page)
    assert written - solved < solved - begun + SLACK


@pytest.mark.slow
@pytest.mark.parametrize("drive", SIMULATED)
def test_a_report_with_a_simulation_is_small(drive: str) -> None:
    files = run_design(load(found(drive), None), verify=True).files
    judge(files["report.html"].decode())


def test_every_section_is_tried() -> None:
    there = {
        *DesignFile.model_fields,
        *(f"control.{name}" for name in ControlSection.model_fields),
        *(f"export.{name}" for name in ExportSection.model_fields),
    }
    assert there - NOT_PICTURED <= {*CHEAP, *SLOW}
