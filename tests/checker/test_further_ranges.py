"""The checker of ranges confirms position observers and the control of each phase in integers, and
finds what is planted in them.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import pytest
from fixed_drives import fitted, observed_design
from phase_drives import plain_control, trapezoidal
from planted_ranges import (
    KALMAN,
    MATSUI,
    OBSERVERS,
    PHASES,
    Files,
    certificate,
    narrowed_types,
    planted_texts,
    said,
    smaller_claims,
)

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.names import CurrentFrame, Feedforward, Topology
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.fixed_observers.fixed_observer_fit import FIXED_METHODS
from dqforge.optimizer.fixed_phase_control.design import fit_phase_control
from dqforge.optimizer.solution import solve
from dqforge.reports.fixed_observers.fixed_observer_header import fixed_observer_files
from dqforge.reports.phase_control.emitted_integers import phase_fixed_files
from dqforge.reports.verification.range_claims import range_files

# Variables of 32 bits that 16 hold in the headers of `observer("flux", 16)`.
CODES = {"x", "y"}
Lines = pytest.CaptureFixture[str]


def texts(design: Any, made: dict[str, bytes], **fits: Any) -> Files:
    """Headers without their test vectors, and the certificate of them."""
    files = {name: x for name, x in made.items() if not name.endswith("_vectors.h")}
    solution: Any = SimpleNamespace(design=design, **({"fixed": (), "fixed_observers": ()} | fits))
    return {name: x.decode("utf-8") for name, x in (files | range_files(solution, files)).items()}


@cache
def observer(name: str, width: int) -> Files:
    design, fit = observed_design(name), fitted(name, width)
    return texts(design, fixed_observer_files(design, fit), fixed_observers=(fit,))


@cache
def solved() -> Any:
    """A drive with a speed loop whose phases are controlled one by one."""
    design = catalogue.load("paper002-phase-waveforms")
    bases = replace(design.control.bases, voltage=300.0, current=8.0, torque=6.0)
    loop = SpeedLoopSettings(ratio=7, filter_time=5e-4)
    return solve(replace(design, control=replace(design.control, bases=bases, speed_loop=loop)))


@cache
def phases(topology: Topology, frame: CurrentFrame, feedforward: Feedforward, width: int) -> Files:
    solution = solved()
    changes: Any = {"topology": topology, "frame": frame, "feedforward": feedforward}
    control = plain_control(trapezoidal(96), **changes)
    speed = (solution.gains.speed, solution.gains.i_q)
    fit = fit_phase_control(solution.design, control, width, speed)
    return texts(solution.design, phase_fixed_files(solution.design, fit), fixed=(fit,))


KINDS = [
    (topology, frame, feedforward)
    for topology in get_args(Topology)
    for frame in get_args(CurrentFrame)
    for feedforward in ("references", "emf", "none")
    if frame != "dqy" or TOPOLOGIES[topology].neutral
]


@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize(
    "name",
    [pytest.param(x, marks=[] if x == "flux" else [pytest.mark.slow]) for x in FIXED_METHODS],
)
def test_observers_are_confirmed(name: str, width: int, tmp_path: Path, capsys: Lines) -> None:
    lines = said(observer(name, width), tmp_path, capsys)
    code = FIXED_METHODS[name].code
    assert lines[0] == "not covered: nothing"
    assert any(f"bench001_{code}_step_" in line for line in lines[1:])
    assert all(line.startswith("confirmed: ") for line in lines[1:])


@pytest.mark.slow
@pytest.mark.parametrize("width", [16, 32])
@pytest.mark.parametrize("kind", KINDS, ids="-".join)
def test_phases_are_confirmed(kind: Any, width: int, tmp_path: Path, capsys: Lines) -> None:
    lines = said(phases(*kind, width), tmp_path, capsys)
    assert re.fullmatch(r"not covered: \w+_pi_velocity_step_q\d+", lines[0])
    for function in ("current", "torque", "speed", "shaped"):
        assert any(f"_{function}_control_q" in line for line in lines[1:])
    assert all(line.startswith("confirmed: ") for line in lines[1:])


def faults(files: Files, planted: Any, folder: Path, capsys: Lines) -> int:
    """How many planted faults there are; each is found with its place."""
    many = 0
    for name, changed in planted_texts(files, planted):
        line = said(changed, folder, capsys)[-1]
        assert re.match(r"not confirmed: (\w*, line \d+: |\w+\.h|\w+: (state|observer)\.)", line), (
            name
        )
        many += 1
    return many


def test_planted_faults_of_observers_are_found(tmp_path: Path, capsys: Lines) -> None:
    assert faults(observer("flux", 16), OBSERVERS, tmp_path, capsys) == len(OBSERVERS)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "planted"), [("ekf", KALMAN), ("matsui-voltage", MATSUI)])
def test_planted_faults_of_states_are_found(
    name: str, planted: Any, tmp_path: Path, capsys: Lines
) -> None:
    assert faults(observer(name, 16), planted, tmp_path, capsys) == len(planted)


@pytest.mark.slow
def test_planted_faults_of_phases_are_found(tmp_path: Path, capsys: Lines) -> None:
    files = phases("four-leg", "dqy", "references", 16)
    assert faults(files, PHASES, tmp_path, capsys) == len(PHASES)


# Variances are positive, those of speed and angle below a limit of their own.
LESS = {f"ekf_q15.p.{k}" for k in ("0.0", "4.0", "7.0", "7.1", "9.0", "9.1")}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["matsui-voltage", "ekf", "phases"])
def test_states_that_are_told_smaller_are_found(name: str, tmp_path: Path, capsys: Lines) -> None:
    files = phases("four-leg", "dqy", "emf", 16) if name == "phases" else observer(name, 16)
    kept, planted = set(), list(smaller_claims(certificate(files)))
    assert len(planted) >= 4
    for fault, plain in planted:
        line = said(files, tmp_path, capsys, plain)[-1]
        if not re.match(r"not confirmed: \w+: (state|observer)\.\S+ may be ", line):
            kept.add(fault)
    assert kept == (LESS if name == "ekf" else set())


@pytest.mark.slow
def test_types_that_are_too_narrow_are_found(tmp_path: Path, capsys: Lines) -> None:
    """Variables of 32 bits that hold a code of 16 alone may have 16."""
    kept = set()
    for name, changed in narrowed_types(observer("flux", 16)):
        if not said(changed, tmp_path, capsys)[-1].startswith("not confirmed: "):
            kept.add(name.split(": ")[1])
    assert kept == CODES


@pytest.mark.slow
def test_entries_that_are_told_wrong_are_refused(tmp_path: Path, capsys: Lines) -> None:
    """Two entries for an array of three."""
    files = phases("four-leg", "table", "emf", 32)
    plain = json.loads(json.dumps(certificate(files)))
    plain["states"]["control_q31"]["integral"].pop()
    assert said(files, tmp_path, capsys, plain)[-1].endswith(" are not 3 entries")
