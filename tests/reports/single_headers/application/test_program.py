"""The emitted program: every state and fault by replayed samples, in the simulated drive, on an
emulated core, and refused where something is missing.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from application_replay import (
    ALIGN,
    ENCODER_STILL,
    ENCODER_WRONG,
    FAULT,
    KINDS,
    NO_FAULT,
    OFFSET,
    OFFSETS,
    OVERCURRENT,
    OVERVOLTAGE,
    READY,
    RUN,
    SAMPLE,
    START,
    TRIP,
    UNDERVOLTAGE,
    HostProgram,
    design,
    host_program,
    samples,
    target_source,
)
from numpy.typing import NDArray

from dqforge.machines.design.catalogue import load
from dqforge.machines.errors import InputError
from dqforge.optimizer.application import ApplicationPlan, application_plan
from dqforge.optimizer.solution import solve
from dqforge.reports.run import emitted_files
from dqforge.reports.simulation.design_run import simulate_design
from dqforge.reports.verification.cross_tools import build, emulate

BITS = np.uint32


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, HostProgram]:
    return {kind: host_program(kind, tmp_path_factory.mktemp(kind)) for kind in KINDS}


def plan_of(program: HostProgram) -> ApplicationPlan:
    plan = application_plan(program.design)
    assert plan is not None
    return plan


def states(out: NDArray[BITS]) -> list[int]:
    """States in the order in which they were entered."""
    found = out[:, 4].astype(int)
    return [int(found[0]), *(int(v) for v in found[1:][np.diff(found) != 0])]


def quarter(plan: ApplicationPlan, sign: int) -> int:
    return sign * plan.counts // (4 * plan.pole_pairs)


def aligned(program: HostProgram, turn: int) -> NDArray[BITS]:
    """Rows to the end of an alignment whose encoder moves by ``turn`` counts in its second step."""
    plan = plan_of(program)
    rows = samples(plan.offset_samples + 2 * plan.align_samples + 60)
    begun = plan.offset_samples + plan.align_samples + 20
    rows[begun:, 7] = np.uint32(turn % 2**32)
    return rows


@pytest.mark.parametrize("kind", KINDS)
def test_offsets_are_removed_or_refused(programs: dict[str, HostProgram], kind: str) -> None:
    program = programs[kind]
    plan = plan_of(program)
    still = {"run": 0}
    out = program.run(samples(plan.offset_samples + 5, i_a=0.2, i_b=-0.1, i_c=-0.1, **still))
    assert states(out) == [OFFSETS, READY]
    assert not out[:, 3].any()  # no gate pulses
    far = samples(plan.offset_samples + 5, i_b=1.2 * plan.offset_limit)
    out = program.run(far)
    assert states(out) == [OFFSETS, FAULT]
    assert out[-1, 5] == OFFSET
    # the command goes: it measures again
    out = program.run(np.concatenate([far, samples(plan.offset_samples + 5, run=0)]))
    assert states(out) == [OFFSETS, FAULT, OFFSETS, READY]
    assert out[-1, 5] == NO_FAULT


@pytest.mark.parametrize("kind", ["edges", "counts"])
def test_an_encoder_that_turns_by_the_quarter_lets_it_run_and_stop(
    programs: dict[str, HostProgram], kind: str
) -> None:
    program = programs[kind]
    plan = plan_of(program)
    rows = aligned(program, quarter(plan, 1))
    rest = samples(200, run=0, position=quarter(plan, 1))
    out = program.run(np.concatenate([rows, rest]))
    # it rests already: the stop ends in the step in which it begins
    assert states(out) == [OFFSETS, READY, ALIGN, RUN, READY]
    assert out[len(rows) - 1, 3] == 1
    assert out[-1, 3] == 0
    duties = out[:, :3].copy().view(np.float32)
    assert ((duties >= 0.0) & (duties <= 1.0)).all()


@pytest.mark.parametrize("kind", ["edges", "counts"])
def test_an_encoder_that_does_not_fit_is_named(programs: dict[str, HostProgram], kind: str) -> None:
    program = programs[kind]
    plan = plan_of(program)
    for turn, fault in ((0, ENCODER_STILL), (-1, ENCODER_WRONG), (2, ENCODER_WRONG)):
        out = program.run(aligned(program, quarter(plan, turn)))
        assert states(out) == [OFFSETS, READY, ALIGN, FAULT], turn
        assert out[-1, 5] == fault
        assert out[-1, 3] == 0


SPOILT: dict[str, tuple[dict[str, float], int]] = {
    "not a number": ({"i_b": np.nan}, SAMPLE),
    "endless voltage": ({"v_dc": np.inf}, SAMPLE),
    "no reference": ({"reference": np.nan}, SAMPLE),
    "trip": ({"trip": 1}, TRIP),
    "overcurrent": ({"i_a": 40.0, "i_b": -20.0, "i_c": -20.0}, OVERCURRENT),
    "undervoltage": ({"v_dc": 40.0}, UNDERVOLTAGE),
    "overvoltage": ({"v_dc": 400.0}, OVERVOLTAGE),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SPOILT)
def test_one_spoilt_sample_ends_in_its_fault_and_is_left_behind(
    programs: dict[str, HostProgram], kind: str, name: str
) -> None:
    program, (changes, fault) = programs[kind], SPOILT[name]
    plan = plan_of(program)
    before = samples(plan.offset_samples + 50)
    spoilt, after = samples(1, **changes), samples(20)
    out = program.run(np.concatenate([before, spoilt, after]))
    live = int(out[len(before) - 1, 4])
    assert live in (ALIGN, RUN)
    assert (out[len(before) :, 4] == FAULT).all()
    assert (out[len(before) :, 5] == fault).all()
    assert not out[len(before) :, 3].any()
    again = np.concatenate([before, spoilt, samples(5, run=0), samples(20)])
    out = program.run(again)
    assert out[-1, 4] == live
    assert out[-1, 5] == NO_FAULT
    assert np.isfinite(out[:, :3].copy().view(np.float32)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_a_spoilt_sample_before_the_offsets_are_known_measures_them_again(
    programs: dict[str, HostProgram], kind: str
) -> None:
    program = programs[kind]
    count = plan_of(program).offset_samples
    rows = np.concatenate(
        [samples(30), samples(1, i_a=np.nan), samples(5, run=0), samples(count + 5, run=0)]
    )
    out = program.run(rows)
    assert states(out) == [OFFSETS, FAULT, OFFSETS, READY]
    assert out[35, 4] == OFFSETS


def test_the_fault_of_the_start_up_is_passed_on(programs: dict[str, HostProgram]) -> None:
    program = programs["start-up"]
    count = plan_of(program).offset_samples
    # a rotor that is never there: no current answers, so no hand-over, try after try
    out = program.run(samples(count + 60_000))
    assert states(out) == [OFFSETS, READY, RUN, FAULT]
    assert out[-1, 5] == START


ENCODERS = {"start-up": ", encoder: none", "observer": ", encoder: {lines: 1024}"}
SCENARIO = (
    "simulation={duration: 2.2 s, speed: {points: [{time: 0 s, speed: 1200 rpm}]}, current_sensor: "
    "{offset: [100 mA, -50 mA, 20 mA], bits: 12, full_scale: 8 A}, initial: {angle: 100 deg}, "
    "stop: 1.6 s%s}"
)


@pytest.mark.thinned
@pytest.mark.parametrize("kind", KINDS)
def test_from_power_up_to_stop_in_the_simulated_drive(kind: str) -> None:
    found = simulate_design(design(kind, SCENARIO % ENCODERS.get(kind, "")))
    run, record = found.run, found.run.application
    assert record is not None
    order = record.application_state
    seen = [int(order[0]), *(int(v) for v in order[1:][np.diff(order) != 0])]
    wanted = [OFFSETS, READY, RUN, READY] if kind == "start-up" else [0, 1, 2, 3, 4, 1]
    assert seen == wanted
    assert not record.application_fault.any()
    steady = (run.t > 1.4) & (run.t < 1.59)
    assert np.abs(run.omega_m[steady] - 40.0 * np.pi).max() < 0.02 * 40.0 * np.pi
    error = np.angle(np.exp(1j * (run.theta_e_measured - run.theta_e)))
    assert np.abs(error[steady]).max() < np.radians(8.0)
    if kind != "start-up":
        assert abs(run.omega_m[-1]) < 2.0


def test_the_program_of_the_bench_needs_one_key() -> None:
    drive = load("paper001-pmsm-bench", ["export.application=skeleton"])
    assert drive.export.control == ("float32",)
    plan = application_plan(drive)
    assert plan is not None
    assert (plan.kind, plan.counts) == ("observer", 4096)
    assert "bench001_main.c" in emitted_files(solve(drive))


def test_what_it_needs_is_said_where_it_stands() -> None:
    with pytest.raises(InputError, match=r"export\.application: the program needs control\.start"):
        design("nothing")
    with pytest.raises(InputError, match="calls the speed control in float32"):
        design("integers")
    with pytest.raises(InputError, match=r"or by simulation\.encoder\.lines"):
        design("observer", "simulation.encoder={lines: 0}")


@pytest.mark.slow
@pytest.mark.parametrize("target", ["cortex-m0plus", "cortex-m4"])
@pytest.mark.parametrize("kind", KINDS)
def test_the_same_program_on_an_emulated_core(kind: str, target: str, tmp_path: Path) -> None:
    (tmp_path / "host").mkdir()
    (tmp_path / "target").mkdir()
    program = host_program(kind, tmp_path / "host", short=True)
    plan = plan_of(program)
    generator = np.random.default_rng(5)
    rows = samples(600)
    rows[40 + 60 + 20 :, 7] = quarter(plan, 1) if plan.counts else 0
    floats = rows[:, :5].copy().view(np.float32)
    floats[:, :3] += generator.normal(0.0, 0.05, (len(rows), 3)).astype(np.float32)
    rows[:, :5] = floats.view(np.uint32)
    rows[400:440, 5] = 0
    rows[500, 0] = np.float32(np.nan).view(np.uint32)
    wanted = program.run(rows)
    assert len(states(wanted)) >= 5
    assert wanted[:, 3].sum() > 100
    files = {n: c for n, c in program.files.items() if n.endswith(".h") and "vectors" not in n}
    source = target_source(kind, rows, wanted).replace('"drive_main.c"', '"drive_main_c.h"')
    files |= {"drive_main_c.h": program.files["drive_main.c"], "replay.c": source.encode()}
    build(files, ("-O2", "-ffp-contract=off"), target, tmp_path / "target")
    assert emulate(target, tmp_path / "target") == 0
