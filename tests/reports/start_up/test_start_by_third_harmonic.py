"""A machine of any back-EMF from standstill without an encoder: by a current that turns onto the
third harmonic of its phase voltages, in C that is bit-equal to its model.
"""

from __future__ import annotations

import math
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from static_checks import DEVIATIONS, program

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.machines.plants.scenario import Profile, constant
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.start_up.start_records import StartupFault as Fault
from dqforge.optimizer.start_up.start_records import StartupState as State
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.observers.float32_model import EmittedTracker
from dqforge.reports.observers.position_header import plain_tracker_gains
from dqforge.reports.phase_control.emitted_integers import emitted_control_plain
from dqforge.reports.run import emitted_files
from dqforge.reports.simulation.design_run import (
    DriveSimulation,
    StartFigures,
    controlled_topology,
    controller_files,
    drive_of,
    evaluate,
    observers_of,
    spans,
)
from dqforge.reports.simulation.recorded_run import Simulator, simulate, simulator
from dqforge.reports.start_up.header import plain_start_up
from dqforge.reports.start_up.tried import start_up_from, start_up_programme
from dqforge.reports.verification.cortex_m import run_on_target

EXAMPLE = Path(__file__).resolve().parents[3] / "examples" / "third-harmonic-start.yaml"
RPM = math.pi / 30.0
Made = tuple[Solution, Simulator]

FRAMES = (
    "{frame: table}",
    "{frame: dq, feedforward: measured}",
    "{frame: dqx, feedforward: emf}",
    "{frame: table, feedforward: none}",
)


def drive(loop: str = "{}") -> Design:
    """The shipped drive, its current control otherwise."""
    merged = loop.replace("{", "{method: bandwidth, bandwidth: 300 Hz, ").replace(", }", "}")
    return load_design(EXAMPLE, [f"control.current_loop={merged}", "export.prefix=drive"])


@cache
def solution(loop: str = "{}") -> Solution:
    return solve(drive(loop))


@cache
def answered(loop: str) -> Programme:
    """Harness, inputs and what the model answers."""
    found, tracked = solution(loop), solution(loop).gains.tracker
    assert found.start_up is not None
    assert tracked is not None
    emitted = EmittedTracker(tracked.tracker, tracked.gains)
    whole = {
        "header": {"reference": to_plain(found.reference)},
        "control_header": emitted_control_plain(found),
        "observer_header": plain_tracker_gains(emitted),
    }
    return start_up_programme(start_up_from(plain_start_up(found, found.start_up), whole))


def folder_with(path: Path, loop: str) -> Path:
    part = answered(loop)
    for name, content in controller_files(solution(loop)).items():
        (path / name).write_bytes(content)
    (path / "main.c").write_text(part.harness.source("drive"), encoding="ascii")
    return path


@pytest.mark.slow
def test_the_states_of_a_ramp_and_every_fault_but_that_of_the_polarity_are_met() -> None:
    outputs = answered(FRAMES[0]).model
    states = {State(int(code)) for code in outputs[:, 4]}
    assert states == set(State) - {State.SEARCH, State.POLARITY}
    assert {Fault(int(code)) for code in outputs[:, 5]} == set(Fault) - {Fault.NO_POLARITY}
    pairs = set(zip(outputs[:-1, 4].astype(int), outputs[1:, 4].astype(int), strict=True))
    assert {(State.RAMP, State.RUN), (State.RUN, State.RAMP)} <= {
        (State(a), State(b)) for a, b in pairs
    }


@pytest.mark.slow
@pytest.mark.parametrize("loop", FRAMES)
def test_the_compiled_machine_equals_its_model_bit_for_bit(loop: str, tmp_path: Path) -> None:
    part = answered(loop)
    assert np.any(np.isnan(part.inputs[:, 7]))  # sums of voltages that are no numbers
    command = [program("gcc"), "-std=c99", "-O2", "-ffp-contract=off", "-fsanitize=undefined"]
    subprocess.run(
        [*command, "-fno-sanitize-recover=all", "main.c", "-lm", "-o", "main"],
        cwd=folder_with(tmp_path, loop),
        check=True,
        timeout=60,
    )
    ran = subprocess.run(
        [str(tmp_path / "main")], input=part.inputs.tobytes(), capture_output=True, check=True
    )
    found = part.results(ran.stdout)
    assert found is not None
    part.require_model(found, "compiled", "C", any_nan=True)


@pytest.mark.slow
def test_cppcheck_and_misra_find_the_listed_deviations_only(tmp_path: Path) -> None:
    done = subprocess.run(
        [program("cppcheck"), "--std=c99", "--addon=misra", "--enable=style", "-q", "main.c"],
        cwd=folder_with(tmp_path, FRAMES[0]),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    own = [line for line in done.stderr.splitlines() if line.startswith("drive_startup.h")]
    rules = {line.rsplit("-", 1)[1].rstrip("]") for line in own if "[misra-c2012-" in line}
    assert rules <= set(DEVIATIONS), own
    assert rules, "the addon said nothing at all: did it run?"


@pytest.mark.slow
def test_only_a_design_that_starts_so_has_currents_to_hold_in_its_control() -> None:
    with_start = emitted_files(solution())
    plain = replace(drive().control, start_up=None)
    running = emitted_files(solve(replace(drive(), control=plain, simulation=None)))
    assert b"held" in with_start["drive_control.h"]
    assert b"held" not in running["drive_control.h"]
    assert "drive_startup.h" in set(with_start) - set(running)
    assert b"float u; " in with_start["drive_startup.h"]


@pytest.fixture(scope="module")
def made() -> Iterator[Made]:
    found = solution()
    files, names = controller_files(found), observers_of(found)[1]
    with simulator(files, "drive", names, topology=controlled_topology(found)) as built:
        yield found, built


def run_of(made: Made, **changes: object) -> DriveSimulation:
    found, built = made
    assert found.design.simulation is not None
    scenario = replace(found.design.simulation, stop=None, **changes)  # type: ignore[arg-type]
    return evaluate(found.design, simulate(built, drive_of(found.design), scenario))


def start_of(found: DriveSimulation) -> StartFigures:
    assert found.start is not None
    return found.start


def states(found: DriveSimulation) -> list[str]:
    assert found.run.start is not None
    return [name for name, _, _ in spans(found.run.start)]


@pytest.mark.thinned
@pytest.mark.parametrize("load", [0.0, 1.0])
@pytest.mark.parametrize(("direction", "angle"), [(1.0, 3.3), (-1.0, 0.5)])
def test_it_starts_from_any_angle_either_way(
    made: Made, load: float, direction: float, angle: float
) -> None:
    speed = constant(direction * 900.0 * RPM)
    found = run_of(made, reference=speed, load=constant(load), theta_e=angle, duration=2.4)
    assert states(found) == ["ALIGN", "RAMP", "RUN"]
    start = start_of(found)
    assert start.fault == "NO_FAULT"
    assert abs(math.degrees(start.angle_error)) < 8.0
    assert start.current_step < 0.3
    assert found.run.omega_m[-1] == pytest.approx(direction * 900.0 * RPM, rel=0.03)


def test_a_blocked_rotor_is_given_up(made: Made) -> None:
    found = run_of(made, load=constant(20.0), duration=9.0)
    assert start_of(found).state == "FAULT"
    assert start_of(found).fault == "NO_HANDOVER"
    assert states(found).count("WAIT") == 2


def test_the_shipped_drive_goes_there_and_back(made: Made) -> None:
    found = run_of(made, duration=7.5)
    assert states(found) == ["ALIGN", "RAMP", "RUN", "RAMP", "RUN"]
    run = found.run
    assert run.start is not None
    alone = run.start.start_state == State.RUN
    assert np.max(np.abs(found.angle_error[alone])) < math.radians(10.0)
    for first, last, speed in ((2.3, 2.5, 1211.0), (3.9, 4.2, 200.0), (7.3, 7.5, -1200.0)):
        part = (run.t > first) & (run.t < last)
        assert np.mean(run.omega_m[part]) == pytest.approx(speed * RPM, rel=0.05)


@pytest.mark.slow
def test_a_load_that_comes_at_speed_leaves_it_locked(made: Made) -> None:
    load = Profile((0.0, 3.0), (0.0, 1.0))
    found = run_of(made, reference=constant(1200.0 * RPM), load=load, duration=5.0)
    assert states(found) == ["ALIGN", "RAMP", "RUN"]
    assert found.run.omega_m[-1] == pytest.approx(1200.0 * RPM, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["cortex-m0plus", "cortex-m4"])
def test_an_emulated_core_gives_the_same_bits(target: str) -> None:
    part = answered(FRAMES[0])
    found = run_on_target(controller_files(solution(FRAMES[0])), "drive", [part], target)
    assert [(run.name, run.compared) for run in found] == [("start-up", len(part.inputs))]
