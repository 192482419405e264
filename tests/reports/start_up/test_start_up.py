"""The emitted state machine of a start: bit-equal to its model through every state and fault, and
what a sample that is no number does to it.
"""

from __future__ import annotations

import struct
import subprocess
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from start_designs import INJECTION, start_design
from static_checks import DEVIATIONS, program

from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.start_up.start_records import RESTING
from dqforge.optimizer.start_up.start_records import StartupFault as Fault
from dqforge.optimizer.start_up.start_records import StartupState as State
from dqforge.reports.c_code.harness import single_from
from dqforge.reports.control.header import plain_control
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.observers.position_header import emitted, plain_observer
from dqforge.reports.simulation.design_run import controller_files
from dqforge.reports.start_up.float32_reading import MEMBERS, StartUpRun
from dqforge.reports.start_up.header import (
    plain_start_observer,
    plain_start_up,
    settings_bytes,
    settings_of,
)
from dqforge.reports.start_up.tried import (
    OUTPUTS,
    SEEN,
    TriedStart,
    start_up_from,
    start_up_programme,
)
from dqforge.reports.verification.cortex_m import run_on_target


@cache
def solution() -> Solution:
    return solve(start_design(INJECTION, 1.8))


@cache
def tried() -> TriedStart:
    found = solution().start_up
    observer = emitted(solution().gains.position)
    assert found is not None
    assert observer is not None
    whole = {
        "header": {"reference": to_plain(solution().reference)},
        "control_header": plain_control(solution()),
        "observer_header": plain_observer(observer),
        "start_observer_header": plain_start_observer(found),
    }
    return start_up_from(plain_start_up(solution(), found), whole)


@cache
def answered() -> Any:
    """Harness, inputs and what the model answers."""
    return start_up_programme(tried())


def folder_with(path: Path, main: str) -> Path:
    for name, content in controller_files(solution()).items():
        (path / name).write_bytes(content)
    (path / "main.c").write_text(main, encoding="ascii")
    return path


def harness() -> str:
    text: str = answered().harness.source("drive")
    return text


def test_every_state_and_every_fault_is_met() -> None:
    outputs = answered().model
    assert outputs.shape[1] == OUTPUTS
    assert {State(int(code)) for code in outputs[:, 4]} == set(State)
    assert {Fault(int(code)) for code in outputs[:, 5]} == set(Fault)
    pairs = set(zip(outputs[:-1, 4].astype(int), outputs[1:, 4].astype(int), strict=True))
    ways = {(State.RAMP, State.RUN), (State.RUN, State.RAMP), (State.RUN, State.LOW)}
    assert ways <= {(State(a), State(b)) for a, b in pairs}


def test_the_compiled_machine_equals_its_model_bit_for_bit(tmp_path: Path) -> None:
    part = answered()
    folder_with(tmp_path, harness())
    command = [program("gcc"), "-std=c99", "-O2", "-ffp-contract=off", "-fsanitize=undefined"]
    subprocess.run(
        [*command, "-fno-sanitize-recover=all", "main.c", "-lm", "-o", "main"],
        cwd=tmp_path,
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
    folder_with(tmp_path, harness())
    done = subprocess.run(
        [program("cppcheck"), "--std=c99", "--addon=misra", "--enable=style", "-q", "main.c"],
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    own = [line for line in done.stderr.splitlines() if line.startswith("drive_startup.h")]
    rules = {line.rsplit("-", 1)[1].rstrip("]") for line in own if "[misra-c2012-" in line}
    assert rules <= set(DEVIATIONS), own
    assert rules, "the addon said nothing at all: did it run?"


def test_settings_as_bytes_are_those_of_the_structure() -> None:
    found = solution().start_up
    assert found is not None
    values = settings_of(found.plan)
    whole = sum(member.whole for member in MEMBERS)
    assert [member.whole for member in MEMBERS] == [True] * whole + [False] * (len(MEMBERS) - whole)
    numbers = struct.unpack(f"={whole}I{len(MEMBERS) - whole}f", settings_bytes(found.plan))
    for member, number in zip(MEMBERS, numbers, strict=True):
        assert number == (values[member.name] if member.whole else np.float32(values[member.name]))


@pytest.mark.thinned
@pytest.mark.parametrize("channel", [0, 1, 2, 3])
def test_a_sample_that_is_no_number_ends_in_a_named_fault_in_every_state(channel: int) -> None:
    inputs = answered().inputs
    met: set[State] = set()
    run = StartUpRun(tried().model)
    with np.errstate(all="ignore"):
        for row in inputs:
            if row[0] > 0.0:
                names = zip(MEMBERS, row[SEEN:], strict=True)
                settings = {
                    m.name: int(v) if m.whole else float(single_from(float(v))) for m, v in names
                }
                run = StartUpRun(tried().model, settings)
            if run.drive.state not in met:
                met.add(run.drive.state)
                bad = [np.float32(value) for value in row[1:5]]
                bad[channel] = np.float32("nan")
                spoilt = deepcopy(run)
                resting = run.drive.state in RESTING
                _, gate = spoilt.step((bad[0], bad[1], bad[2]), bad[3], np.float32(row[5]), 1)
                assert gate == 0
                assert spoilt.drive.state in RESTING
                assert resting or spoilt.drive.fault == Fault.SAMPLE
                assert np.isfinite([spoilt.drive.theta_e, spoilt.drive.omega_e]).all()
                if met == set(State):
                    return
            i_a, i_b, i_c, v_dc, reference = map(np.float32, row[1:6])
            run.step((i_a, i_b, i_c), v_dc, reference, int(row[6]))
    assert met == set(State)


@pytest.mark.slow
@pytest.mark.parametrize("target", ["cortex-m0plus", "cortex-m4"])
def test_an_emulated_core_gives_the_same_bits(target: str) -> None:
    found = run_on_target(controller_files(solution()), "drive", [answered()], target)
    assert [(run.name, run.compared) for run in found] == [("start-up", len(answered().inputs))]
