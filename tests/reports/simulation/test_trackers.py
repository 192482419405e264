"""Trackers in the loop: from standstill without an encoder, against their models, and where the
speed loop swings on them.
"""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.transforms import Triple, clarke
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.solution import solve
from dqforge.optimizer.steps.step_arithmetic import cast
from dqforge.reports.c_code.harness import wrap
from dqforge.reports.simulation.design_run import DriveSimulation, simulate_design

ABB, BALDOR = "abb-ipmsm-2k2", "baldor-pmsyrm-5k6"
RUN = (
    "simulation={duration: 1.2 s, sensorless: {above: 0 rpm, below: 0 rpm}, speed: {shape: linear, "
    "points: [{time: 0 s, speed: 0 rpm}, {time: 0.2 s, speed: 0 rpm}, {time: 0.6 s, speed: 60 rpm}"
    "]}, load: {points: [{time: 0.8 s, torque: LOAD}]}}"
)


def _design(drive: str, keys: str, load: str, spread: float = 17.0, *more: str) -> Design:
    return catalogue.load(
        drive,
        [
            f"control.observer={keys}",
            "export.control=float32",
            f"control.speed_loop.spread={spread}",
            RUN.replace("LOAD", load),
            *more,
        ],
    )


def _error(found: DriveSimulation) -> FloatArray:
    return np.degrees(np.abs(found.angle_error))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "keys", "load"),
    [
        (BALDOR, "{method: injection}", "15 N m"),
        (BALDOR, "{method: injection, wave: sine}", "15 N m"),
        (BALDOR, "{method: injection, wave: rotating}", "15 N m"),
        (ABB, "{method: injection}", "7 N m"),
        (ABB, "{method: injection, wave: sine}", "7 N m"),
    ],
)
def test_a_drive_runs_from_standstill_under_load_on_its_saliency(
    drive: str, keys: str, load: str
) -> None:
    """The saturated machine at a third of its torque, with dead time; 40 V of the link besides."""
    found = simulate_design(_design(drive, keys, load))
    run = found.run
    assert run.figures.bounded[0]
    assert np.all(run.sensorless == 1.0)
    assert np.max(_error(found)) < 12.0
    tail = run.t > 1.0
    assert np.max(_error(found)[tail]) < 5.0
    target = 60.0 * np.pi / 30.0
    assert np.max(np.abs(run.omega_m[tail] - target)) < 0.15 * target


@pytest.mark.slow
def test_a_drive_runs_from_standstill_on_pulses() -> None:
    keys, loop = "{method: inductance-mapping}", "control.speed_loop.ratio=10"
    found = simulate_design(_design(BALDOR, keys, "10 N m", 25.0, loop))
    assert found.run.figures.bounded[0]
    assert np.max(_error(found)) < 15.0
    assert np.max(_error(found)[found.run.t > 1.0]) < 6.0


@pytest.mark.slow
def test_cross_saturation_costs_what_the_table_takes_off() -> None:
    """At 40 N m the axis lies 3 degrees beside d: without the table the angle would err by it."""
    design = _design(BALDOR, "{method: injection}", "40 N m", 17.0, "inverter.dead_time=0 s")
    found = simulate_design(design)
    late = found.run.t > 1.1
    assert np.abs(np.degrees(np.mean(found.angle_error[late]))) < 1.0


@pytest.mark.slow
def test_the_emitted_tracker_in_the_loop_is_its_model() -> None:
    design = _design(BALDOR, "{method: injection}", "15 N m")
    solved = solve(design)
    tuned = solved.gains.tracker
    assert tuned is not None
    run = simulate_design(design, solution=solved).run
    i = clarke(SINGLE, Triple(*run.i_measured[:4000].astype(np.float32).T))
    v = run.v_alpha.astype(np.float32), run.v_beta.astype(np.float32)
    own = cast(tuned.gains, SINGLE)
    pairs = design.machine.pole_pairs
    first = np.array([run.theta_e[0]], dtype=np.float32)
    state = tuned.tracker.start(own, wrap(first), np.zeros(1, dtype=np.float32))
    for k in range(4000):
        now = slice(k, k + 1)
        state = tuned.tracker.step(
            own, state, (v[0][now], v[1][now]), (i[0][now], i[1][now]), (), SINGLE
        )
        assert state.theta_e[0] == np.float32(run.theta_e_observed[k])
        assert state.omega_e[0] / pairs == pytest.approx(run.omega_m_observed[k], abs=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("spread", "swings"), [(8.0, True), (12.0, False)])
def test_the_speed_loop_swings_where_it_is_judged_to(spread: float, swings: bool) -> None:
    steps = (
        "simulation={duration: 2 s, sensorless: {above: 0 rpm, below: 0 rpm}, speed: {points: "
        "[{time: 0 s, speed: 30 rpm}, {time: 0.3 s, speed: 33 rpm}]}}"
    )
    settings = [
        *("control.observer={method: injection}", "export.control=float32"),
        *("inverter.dead_time=0 s", f"control.speed_loop.spread={spread}", steps),
    ]
    design = catalogue.load(BALDOR, settings)
    speed = solve_gains(design).speed
    assert speed is not None
    assert speed.observed is not None
    assert (speed.observed.radius[0] > 1.0) == swings
    run = simulate_design(design).run
    late = np.ptp(run.omega_m[run.t > 1.7])
    assert (late > 1.0) == swings
    assert np.max(np.abs(run.omega_m)) < 100.0
