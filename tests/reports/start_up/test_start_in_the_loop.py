"""The emitted start in the loop of the simulation: hand-over in both directions, chatter, stop,
faults, and a rotor that turns already.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from start_designs import INJECTION, start_design

from dqforge.machines.plants.scenario import CurrentSensor, PlantErrors, Profile, Scenario, constant
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.simulation.design_run import (
    DriveSimulation,
    StartFigures,
    controller_files,
    drive_of,
    evaluate,
    observers_of,
    spans,
)
from dqforge.reports.simulation.recorded_run import Simulator, simulate, simulator
from dqforge.reports.simulation.tables import plain_simulation, plot_simulation, simulation_tables

RPM = math.pi / 30.0
Made = tuple[Solution, Simulator]


def made(start: str, l_q: float) -> Iterator[Made]:
    solution = solve(start_design(start, l_q))
    with simulator(controller_files(solution), "drive", observers_of(solution)[1]) as program:
        yield solution, program


@pytest.fixture(scope="module")
def ramp() -> Iterator[Made]:
    yield from made("{method: i-f, flying_start: true, load_torque: 0.9 N m}", 1.2)


@pytest.fixture(scope="module")
def salient() -> Iterator[Made]:
    yield from made(INJECTION, 1.8)


def scenario_of(solution: Solution, **changes: object) -> Scenario:
    scenario = solution.design.simulation
    assert scenario is not None
    noisy = CurrentSensor(noise=0.05)
    off = PlantErrors(r_s=0.3, psi_pm=-0.04)
    return replace(scenario, sensor=noisy, errors=off, dead_time=0.5e-6, **changes)  # type: ignore[arg-type]


def run_of(drive: Made, **changes: object) -> DriveSimulation:
    solution, program = drive
    run = simulate(program, drive_of(solution.design), scenario_of(solution, **changes))
    return evaluate(solution.design, run)


def start_of(found: DriveSimulation) -> StartFigures:
    assert found.start is not None
    return found.start


def states(found: DriveSimulation) -> list[str]:
    assert found.run.start is not None
    return [name for name, _, _ in spans(found.run.start)]


def steps(*points: tuple[float, float]) -> Profile:
    times, speeds = zip(*points, strict=True)
    return Profile(times, tuple(RPM * speed for speed in speeds))


@pytest.mark.thinned
@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.5, 3.3])
def test_a_ramp_starts_from_any_angle_either_way(
    ramp: Made, direction: float, angle: float
) -> None:
    found = run_of(ramp, reference=constant(direction * 1200.0 * RPM), theta_e=angle)
    start = start_of(found)
    assert states(found) == ["CATCH", "ALIGN", "RAMP", "RUN"]
    assert start.fault == "NO_FAULT"
    assert abs(math.degrees(start.angle_error)) < 20.0
    assert found.run.omega_m[-1] == pytest.approx(direction * 1200.0 * RPM, rel=0.02)


def test_the_frame_turns_and_the_current_stays(ramp: Made) -> None:
    found = run_of(ramp)
    assert start_of(found).current_step < 0.1 * 10.0
    assert start_of(found).current_step < 0.25 * float(
        np.hypot(found.run.i_d, found.run.i_q)[
            np.searchsorted(found.run.t, start_of(found).hand_over)
        ]
    )


def test_a_hundred_crossings_of_the_hand_over_speed_do_not_chatter(ramp: Made) -> None:
    solution, _ = ramp
    assert solution.start_up is not None
    speed = solution.start_up.plan.hand_over / 4.0
    wave = Profile((0.0,), (speed,), amplitude=0.1 * speed, frequency=10.0)
    found = run_of(ramp, reference=wave, duration=6.0)
    crossed = np.count_nonzero(np.diff(np.sign(found.run.start.start_reference - speed)))  # type: ignore[union-attr]
    assert crossed >= 100
    assert start_of(found).crossings == 1
    assert start_of(found).fault == "NO_FAULT"


def test_down_back_reversal_and_stop(ramp: Made) -> None:
    reference = steps((0.0, 1200.0), (0.9, 150.0), (1.4, 1200.0), (2.0, -1200.0))
    found = run_of(ramp, reference=reference, duration=4.0, stop=3.2)
    expected = ["CATCH", "ALIGN", "RAMP", "RUN", "RAMP", "RUN", "RAMP", "RUN", "RAMP", "IDLE"]
    assert states(found) == expected
    run = found.run
    low = (run.t > 1.25) & (run.t < 1.4)
    assert np.mean(run.omega_m[low]) == pytest.approx(150.0 * RPM, rel=0.15)
    turned = (run.t > 2.9) & (run.t < 3.2)
    assert np.mean(run.omega_m[turned]) == pytest.approx(-1200.0 * RPM, rel=0.03)
    assert abs(run.omega_m[-1]) < 5.0
    assert abs(run.i_q[-1]) < 0.01


def test_a_blocked_rotor_is_found_tried_again_and_given_up(ramp: Made) -> None:
    found = run_of(ramp, load=constant(20.0), duration=9.0)
    assert start_of(found).state == "FAULT"
    assert start_of(found).fault in ("NO_HANDOVER", "STALLED")
    assert states(found).count("WAIT") == 2


def test_a_rotor_blocked_at_speed_has_stalled(ramp: Made) -> None:
    load = Profile((0.0, 0.8), (0.5, 30.0))
    found = run_of(ramp, load=load, duration=1.2)
    assert "RUN" in states(found)
    assert start_of(found).failed[0] in ("STALLED", "LOST")


@pytest.mark.parametrize("speed", [2700.0, -1500.0])
def test_a_turning_rotor_is_caught(ramp: Made, speed: float) -> None:
    found = run_of(ramp, omega_m=speed * RPM, load=constant(0.05), theta_e=1.0, duration=0.5)
    assert states(found)[:2] == ["CATCH", "RUN"]
    assert abs(math.degrees(start_of(found).angle_error)) < 8.0
    assert float(found.run.figures.peak_current[0]) < 15.0


@pytest.mark.slow
def test_saliency_starts_hands_over_and_takes_back(salient: Made) -> None:
    reference = steps((0.0, 1200.0), (1.2, 60.0))
    found = run_of(salient, reference=reference, theta_e=2.0, duration=2.2)
    assert states(found) == ["ALIGN", "SEARCH", "LOW", "RUN", "LOW"]
    assert found.run.omega_m[-1] == pytest.approx(60.0 * RPM, abs=20.0 * RPM)


def test_tables_json_and_figure_tell_the_start(ramp: Made) -> None:
    found = run_of(ramp)
    rows = {row[0]: row[1] for row in simulation_tables(found)[0].rows}
    assert rows["state at the end"] == "RUN"
    plain = plain_simulation(found)["start"]
    assert plain["state"] == "RUN"
    assert plain["hand_over_s"] == start_of(found).hand_over
    assert ">RUN<" in to_svg(plot_simulation(found)).replace(" ", "")


def test_a_drive_without_dead_time_comes_to_rest_with_its_switches_off(ramp: Made) -> None:
    """What rounding leaves of a current chooses no diode: the run ends, and no current flows."""
    solution, program = ramp
    scenario = scenario_of(solution, reference=constant(1200.0 * RPM), duration=1.6, stop=1.0)
    run = simulate(program, drive_of(solution.design), replace(scenario, dead_time=0.0))
    still = run.t > 1.55
    assert np.abs(run.i_d[still]).max() < 1e-6
    assert np.abs(run.i_q[still]).max() < 1e-6
