"""Every form of emitted code under the strict flags of three compilers and under
cppcheck with its MISRA addon.

The deviations from MISRA C:2012 that are permitted, each with its reason,
are listed in docs/reference/header.md and here.
"""

from __future__ import annotations

import math
import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import pytest
from drives import INVERSE_SALIENT, IPM, RELUCTANCE, SURFACE, make_design
from static_checks import DEVIATIONS, program

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    FitSettings,
    WaveformSettings,
    WeakeningSettings,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import ModulationName, OpenPhase, WaveformForm
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.field_weakening.fit import solve_weakening
from dqforge.optimizer.fixed_control.design import fit_control
from dqforge.optimizer.frame_tables import fit_frames
from dqforge.optimizer.modulation_choice.rule import Leaf, Question, Rule, SimplifiedChoice
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.waveforms.solve import solve_phases
from dqforge.reports.control.fixed_header import control_fixed_files
from dqforge.reports.control.header import control_files
from dqforge.reports.loops.capability import gains_files
from dqforge.reports.main_header import header_files
from dqforge.reports.modulation_choice.figures import rule_header
from dqforge.reports.modulation_choice.rule_model import Alternative
from dqforge.reports.single_headers.field_weakening import weakening_files
from dqforge.reports.single_headers.frame_tables import frame_files
from dqforge.reports.verification.host import WARNINGS
from dqforge.reports.waveforms.tables import waveform_files

STRICT = [
    *WARNINGS,
    "-Wsign-conversion",
    "-Wshadow",
    "-Wundef",
    "-Wcast-qual",
    "-Wcast-align",
    "-O2",
]
IN_C = ["-Wstrict-prototypes", "-Wmissing-prototypes"]
Files = dict[str, bytes]


FITS: dict[str, tuple[LinearMachine, FitSettings]] = {
    "polynomial": (IPM, FitSettings(form="polynomial", degree=3)),
    "polynomial own": (
        IPM,
        FitSettings(form="polynomial", degree=2, breakpoint_mode="own", segments=3),
    ),
    "even-odd": (IPM, FitSettings(form="even-odd", degree=3, segments=1)),
    "torque-exact": (IPM, FitSettings()),
    "closed-form": (INVERSE_SALIENT, FitSettings(form="closed-form", degree=3)),
    "proportional": (SURFACE, FitSettings()),
    "reluctance": (RELUCTANCE, FitSettings(form="closed-form")),
    "q15": (IPM, FitSettings(form="polynomial", degree=3, format="q15")),
    "q15 own": (
        IPM,
        FitSettings(form="polynomial", degree=2, format="q15", breakpoint_mode="own"),
    ),
    "q15 proportional": (SURFACE, FitSettings(form="polynomial", format="q15")),
    "q31": (IPM, FitSettings(form="polynomial", degree=3, format="q31")),
}
WAVEFORMS: tuple[WaveformForm, ...] = ("table", "harmonics")
OPEN_PHASES: dict[str, OpenPhase | None] = {"equal phases": None, "open phase": "a"}
WEAKENED: dict[str, tuple[LinearMachine, float]] = {
    "smooth": (IPM, 9000.0),
    "two segments": (INVERSE_SALIENT, 18_000.0),
}
MODULATORS: tuple[ModulationName, ...] = (
    "spwm",
    "svpwm",
    "thipwm6",
    "dpwm0",
    "dpwmmin",
    "gdpwm",
    "ddt-gdpwm",
)
# Both widths, with the modulators whose code differs most.
FIXED: tuple[tuple[int, ModulationName], ...] = (
    (16, "svpwm"),
    (16, "dpwm0"),
    (16, "thipwm6"),
    (32, "ddt-gdpwm"),
)
RULES: dict[str, Rule] = {
    "four": Question(
        "speed_rad_per_s",
        340.0,
        Question("speed_rad_per_s", 131.0, Leaf(0), Leaf(1)),
        Question("torque_Nm", 32.2, Leaf(2), Leaf(1)),
    ),
    "one question": Question("torque_Nm", 20.0, Leaf(1), Leaf(0)),
    "none": Leaf(2),
}
SCHEDULED = {"table": "baldor-pmsyrm-5k6", "segments": "abb-syrm-6k7-saturated"}


def reference_headers(name: str) -> Files:
    """Current reference of a machine and its settings."""
    machine, fit = FITS[name]
    return header_files(solve(make_design(machine, fit=fit)))


def named_drive(name: str) -> Design:
    """A drive of the catalogue whose names in C begin with drive."""
    design = catalogue.load(name)
    return replace(design, export=replace(design.export, prefix="drive"))


def shape_headers(form: WaveformForm) -> Files:
    """Phase currents of a machine without saliency."""
    design = replace(named_drive("paper002-phase-waveforms"), waveform=WaveformSettings(form=form))
    return waveform_files(design, solve_phases(design))


def frame_headers() -> Files:
    """Coordinates of a machine with harmonics."""
    design = named_drive("paper002-phase-waveforms")
    assert isinstance(design.phase_machine, PhaseMachine)
    return frame_files(design, fit_frames(design.phase_machine, 5e-3))


def salient_headers(phases: str) -> Files:
    """Phase currents of a salient machine, with all its phases or without one."""
    settings = WaveformSettings(open_phase=OPEN_PHASES[phases])
    design = replace(named_drive("salient-phase-waveforms"), waveform=settings)
    return waveform_files(design, solve_phases(design))


def weakening_headers(name: str) -> Files:
    """Field weakening up to a speed."""
    machine, rpm = WEAKENED[name]
    weakened = replace(make_design(machine), weakening=WeakeningSettings(rpm * math.pi / 30.0))
    fit = solve_weakening(weakened)
    assert fit is not None
    return weakening_files(weakened, fit)


@cache
def solution_of_the_drive() -> Solution:
    """What the control functions of every modulator begin with."""
    return solve(make_design(IPM))


def control_headers(modulator: ModulationName) -> Files:
    """Control functions with a modulator."""
    solution = solution_of_the_drive()
    operation = replace(solution.design.operation, modulation=modulator)
    changed = replace(solution, design=replace(solution.design, operation=operation))
    return header_files(changed) | control_files(changed)


def fixed_headers(width: int, modulator: ModulationName) -> Files:
    """Control functions in fixed point."""
    solution = solution_of_the_drive()
    design, gains = solution.design, solution.gains
    bases = replace(design.control.bases, speed=1000.0)
    operation = replace(design.operation, modulation=modulator)
    changed = replace(design, control=replace(design.control, bases=bases), operation=operation)
    loops = (gains.i_d, gains.i_q, gains.speed)
    return control_fixed_files(changed, fit_control(changed, loops, gains.observer, width))


def rule_headers(name: str) -> Files:
    """Rule that chooses among three modulators."""
    alternatives = [
        Alternative("svpwm", 16e3),
        Alternative("ddt-gdpwm", 41.9e3),
        Alternative("dpwm3", 35.1e3),
    ]
    priced = SimplifiedChoice(RULES[name], 101.0, 100.0, True)
    return rule_header(make_design(), priced, alternatives, reach=(200.0, 900.0))


def gains_headers(name: str) -> Files:
    """Scheduled gains of a drive of the catalogue."""
    made = named_drive(SCHEDULED[name])
    current = CurrentLoopSettings("magnitude-optimum", schedule=True)
    control = replace(made.control, current_loop=current, speed_loop=None, observer=None)
    made = replace(made, control=control)
    gains = solve_gains(made)
    assert gains.schedule is not None
    return gains_files(made, gains, gains.schedule)


# What makes the files of each form; nothing is made before a test asks for it.
HEADERS: dict[str, Callable[[], Files]] = {
    **{name: partial(reference_headers, name) for name in FITS},
    **{f"waveform {form}": partial(shape_headers, form) for form in WAVEFORMS},
    "frames": frame_headers,
    **{f"waveform salient {name}": partial(salient_headers, name) for name in OPEN_PHASES},
    **{f"weakening {name}": partial(weakening_headers, name) for name in WEAKENED},
    **{f"control {name}": partial(control_headers, name) for name in MODULATORS},
    **{
        f"control_q{width - 1} {kind}": partial(fixed_headers, width, kind) for width, kind in FIXED
    },
    **{f"modulation {name}": partial(rule_headers, name) for name in RULES},
    **{f"gains {name}": partial(gains_headers, name) for name in SCHEDULED},
}


@cache
def made_headers(name: str) -> Files:
    """Emitted files of a form, with the prefix drive."""
    return HEADERS[name]()


FRAMES_MAIN = """#include "drive_frames.h"
int main(void)
{
    const drive_frames_t frames = drive_frames(0.25F);
    float v_d;
    float v_q;
    float v_0;

    drive_decoupling(&frames, 100.0F, 0.0F, 1.0F, 0.0F, &v_d, &v_q, &v_0);
    return (v_q > 0.0F) ? 0 : 1;
}
"""
CONTROL_MAIN = """#include "drive_control.h"
int main(void)
{
    static drive_control_t state;
    drive_measured_t measured;
    drive_abc_t duty;

    measured.i.a = 0.0F;
    measured.i.b = 0.0F;
    measured.i.c = 0.0F;
    measured.theta_e = 0.5F;
    measured.omega_m = 10.0F;
    measured.v_dc = 300.0F;
    drive_control_start(&state);
    duty = drive_speed_control(&DRIVE_CONTROL_GAINS, &state, &measured, 20.0F);
    return ((duty.a >= 0.0F) && (duty.b >= 0.0F) && (duty.c <= 1.0F)) ? 0 : 1;
}
"""


@pytest.fixture(params=HEADERS)
def written(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, str]:
    """Folder with the files of one form and a main.c that includes them,
    and the name of the vectors' header.
    """
    name = request.param
    for file_name, content in made_headers(name).items():
        (tmp_path / file_name).write_bytes(content)
    kind = name.split()[0]
    vectors = {"waveform", "weakening", "modulation", "gains", "control_q15", "control_q31"}
    part = f"drive_{kind}" if kind in vectors else "drive"
    call = f"{part}_mismatches" if part != "drive" else "drive_vectors_mismatches"
    main = (
        f'#include "{part}_vectors.h"\nint main(void)\n{{\n    return ({call}() == 0U) ? 0 : 1;\n'
        "}\n"
    )
    main = {"control": CONTROL_MAIN, "frames": FRAMES_MAIN}.get(kind, main)
    (tmp_path / "main.c").write_text(main, encoding="ascii")
    return tmp_path, name


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("compiler", "flags"),
    [
        ("gcc", ["-std=c99", *IN_C]),
        ("clang", ["-std=c99", *IN_C]),
        ("g++", ["-x", "c++", "-std=c++11"]),
        ("clang++", ["-x", "c++", "-std=c++17"]),
    ],
)
def test_no_compiler_warns_and_the_vectors_hold(
    written: tuple[Path, str], compiler: str, flags: list[str]
) -> None:
    folder, _ = written
    command = [
        program(compiler),
        *flags,
        *STRICT,
        "-ffp-contract=off",
        "main.c",
        "-lm",
        "-o",
        "main",
    ]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert subprocess.run([str(folder / "main")], check=False, timeout=60).returncode == 0


@pytest.mark.thinned
def test_undefined_behaviour_is_not_met(written: tuple[Path, str]) -> None:
    folder, _ = written
    sanitize = ["-fsanitize=undefined", "-fno-sanitize-recover=all"]
    command = [
        program("gcc"),
        "-std=c99",
        *STRICT,
        "-ffp-contract=off",
        *sanitize,
        "main.c",
        "-lm",
        "-o",
        "main",
    ]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stderr
    ran = subprocess.run(
        [str(folder / "main")], capture_output=True, text=True, check=False, timeout=60
    )
    assert ran.returncode == 0, ran.stderr


@pytest.mark.thinned
def test_cppcheck_and_misra_find_the_listed_deviations_only(written: tuple[Path, str]) -> None:
    folder, folder_name = written
    command = [program("cppcheck"), "--std=c99", "--addon=misra", "--enable=style", "-q", "main.c"]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )
    rules = set(re.findall(r"\[misra-c2012-([0-9.]+)\]", done.stderr))
    assert rules <= set(DEVIATIONS), done.stderr
    others = set(re.findall(r"\[((?!misra)[a-zA-Z]\w*)\]$", done.stderr, re.MULTILINE))
    # It looks at a segment with torques that never come there; test_fixed_header runs all of
    # them under the sanitizer.
    assert others <= ({"integerOverflowCond"} if "q15" in folder_name else set())
    assert rules, "the addon said nothing at all: did it run?"


def test_deviations_are_documented(request: pytest.FixtureRequest) -> None:
    text = (Path(request.config.rootpath) / "docs" / "reference" / "header.md").read_text(
        encoding="utf-8"
    )
    for rule in DEVIATIONS:
        assert f"| {rule} |" in text
