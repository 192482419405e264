"""Slopes of the references and voltage feedback, emitted and in the loop."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    ReferenceSettings,
    VoltageFeedbackSettings,
    WeakeningSettings,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, constant
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.control.header import control_files, gain_bytes, plain_control
from dqforge.reports.simulation.design_run import controller_files, drive_of
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator

RPM = math.pi / 30.0
MOST = 2400.0 * RPM
T_S = 1.0 / 8000.0


def designed(references: ReferenceSettings) -> Design:
    """The IPM of 2.2 kW with its field weakened up to 2400 rpm."""
    base = catalogue.load("abb-ipmsm-2k2")
    assert isinstance(base.machine, LinearMachine)
    return replace(
        base,
        machine=replace(base.machine, omega_m_max=MOST),
        control=replace(base.control, observer=None, references=references),
        weakening=WeakeningSettings(omega_m=MOST),
        losses=None,
    )


SLOPES = ReferenceSettings(
    torque_slope=400.0,
    current_slope=2500.0,
    voltage_feedback=VoltageFeedbackSettings(bandwidth=2.0 * math.pi * 20.0, current=3.0),
)


@pytest.fixture(scope="module")
def solved() -> Solution:
    return solve(designed(SLOPES))


@pytest.fixture(scope="module")
def program(solved: Solution) -> Iterator[Simulator]:
    with simulator(controller_files(solved), solved.design.export.prefix) as compiled:
        yield compiled


def changed(solved: Solution, **members: float) -> bytes:
    """Gains with other members of the references."""
    plain = plain_control(solved)
    return gain_bytes({**plain, "references": {**plain["references"], **members}})


def run(solved: Solution, program: Simulator, scenario: Scenario, **members: float) -> Simulation:
    return simulate(program, drive_of(solved.design), scenario, gains=changed(solved, **members))


def largest_change(values: FloatArray) -> float:
    return float(np.max(np.abs(np.diff(values))))


def at_rest(torque: float) -> Scenario:
    return Scenario(
        0.12, "torque", Profile((0.0, 0.01, 0.07), (0.0, torque, -torque)), shaft=constant(0.0)
    )


def test_the_torque_rises_along_its_slope(solved: Solution, program: Simulator) -> None:
    found = run(solved, program, at_rest(10.0), current_step=1e6)
    asked = 1.5 * 3 * (0.545 + (0.036 - 0.051) * found.i_d_reference) * found.i_q_reference
    assert largest_change(asked) == pytest.approx(400.0 * T_S, rel=0.02)
    middle = round(0.02 / T_S)  # 10 ms after the step
    assert asked[middle] == pytest.approx(4.0, abs=2.0 * 400.0 * T_S)
    assert asked[round(0.06 / T_S)] == pytest.approx(10.0, rel=1e-3)
    # without a slope the same step takes one sample
    step = run(solved, program, at_rest(10.0), torque_step=1e6, current_step=1e6)
    assert largest_change(step.i_q_reference) > 3.5


def test_the_current_moves_along_a_straight_line(solved: Solution, program: Simulator) -> None:
    found = run(solved, program, at_rest(14.0), torque_step=1e6)
    moved = np.hypot(np.diff(found.i_d_reference), np.diff(found.i_q_reference))
    assert float(np.max(moved)) == pytest.approx(2500.0 * T_S, rel=1e-4)
    rising = slice(round(0.01 / T_S), round(0.0115 / T_S))
    share = found.i_d_reference[rising] / found.i_q_reference[rising]
    assert float(np.ptp(share)) < 1e-5  # a straight line from no current
    assert float(np.hypot(found.i_d[500], found.i_q[500])) > 4.0


@pytest.mark.parametrize(("share", "settles"), [(0.7, True), (1.6, False)])
def test_speed_steps_settle_up_to_the_one_that_is_told(
    share: float, settles: bool, solved: Solution, program: Simulator
) -> None:
    """The slope limits the torque of all of them; the loop without a slope answers them all."""
    found = solved.gains.references
    assert found is not None
    assert 2.0 < found.speed_step < 0.3 * MOST
    target = share * found.speed_step
    scenario = Scenario(1.0, "speed", constant(target), dead_time=0.0)
    slow = run(solved, program, scenario, current_step=1e6)
    free = run(solved, program, scenario, torque_step=1e6, current_step=1e6)
    assert largest_change(slow.torque_reference) == pytest.approx(400.0 * T_S * 10, rel=0.01)
    assert float(free.omega_m[-1]) == pytest.approx(target, rel=5e-3)
    assert (float(np.max(np.abs(slow.omega_m[-3000:] - target))) < 0.05 * target) == settles


STRONG = PlantErrors(psi_pm=0.08)


def held(torque: float, errors: PlantErrors, dead_time: float = 0.0) -> Scenario:
    shaft = constant(2000.0 * RPM)
    return Scenario(
        0.6,
        "torque",
        constant(torque),
        shaft=shaft,
        omega_m=2000.0 * RPM,
        errors=errors,
        dead_time=dead_time,
    )


def tail(values: FloatArray) -> float:
    return float(np.mean(values[-800:]))


def shortfall(found: Simulation) -> float:
    """Distance of the currents from their references in A, at the end."""
    d = tail(found.i_d) - tail(found.i_d_reference)
    q = tail(found.i_q) - tail(found.i_q_reference)
    return math.hypot(d, q)


@pytest.mark.parametrize("torque", [4.0, -4.0])
def test_feedback_gives_the_currents_back_where_the_magnet_is_stronger(
    torque: float, solved: Solution, program: Simulator
) -> None:
    scenario = held(torque, STRONG)
    alone = run(solved, program, scenario, feedback=0.0)
    with_feedback = run(solved, program, scenario)
    assert shortfall(alone) > 0.3
    assert shortfall(with_feedback) < 0.02
    added = tail(alone.i_d_reference) - tail(with_feedback.i_d_reference)
    assert 0.3 < added < 3.0
    # the voltage that the currents need, by the machine's own equations
    omega, i_d, i_q = 3 * 2000.0 * RPM, tail(with_feedback.i_d), tail(with_feedback.i_q)
    needed = math.hypot(
        3.6 * i_d - omega * 0.051 * i_q, 3.6 * i_q + omega * (1.08 * 0.545 + 0.036 * i_d)
    )
    assert needed == pytest.approx(solved.design.v_max, rel=3e-3)
    # generating without the voltage for it, the drive brakes three times as hard as it is told
    assert abs(tail(with_feedback.torque) - torque) < 0.15 * abs(torque)
    assert abs(tail(alone.torque) - torque) > 0.3 * abs(torque)


def test_feedback_leaves_a_right_map_alone(solved: Solution, program: Simulator) -> None:
    scenario = held(4.0, PlantErrors())
    alone, with_feedback = (
        run(solved, program, scenario, **members) for members in ({"feedback": 0.0}, {})
    )
    assert tail(with_feedback.torque) == pytest.approx(4.0, rel=0.02)
    # the map may ask for 0.5 % more voltage than there is, which the currents lack
    assert tail(alone.torque) == pytest.approx(4.0, rel=0.15)
    assert abs(tail(with_feedback.i_d_reference) - tail(alone.i_d_reference)) < 0.1


def test_feedback_makes_up_for_a_dead_time_that_nothing_compensates(
    solved: Solution, program: Simulator
) -> None:
    """2 us at 8 kHz take some 9 V of the fundamental: most of the torque of the map alone."""
    scenario = held(4.0, PlantErrors(), dead_time=2e-6)
    alone, with_feedback = (
        run(solved, program, scenario, **members) for members in ({"feedback": 0.0}, {})
    )
    assert tail(alone.torque) < 0.6 * 4.0
    assert tail(with_feedback.torque) == pytest.approx(4.0, rel=0.03)


def test_feedback_keeps_within_the_current_limit(solved: Solution, program: Simulator) -> None:
    scenario = held(20.0, PlantErrors(psi_pm=0.15))
    found = run(solved, program, scenario, feedback_max=9.0)
    size = np.hypot(found.i_d_reference, found.i_q_reference)
    assert float(np.max(size)) < solved.design.i_max * (1.0 + 2e-3)
    assert tail(found.i_d_reference) < -6.0


@pytest.mark.slow
def test_nothing_is_emitted_that_is_not_asked_for() -> None:
    plain = solve(designed(ReferenceSettings()))
    text = control_files(plain)[f"{plain.design.export.prefix}_control.h"].decode()
    assert "references_t" not in text
    assert "references" not in plain_control(plain)
    single = solve(designed(ReferenceSettings(torque_slope=100.0)))
    text = control_files(single)[f"{single.design.export.prefix}_control.h"].decode()
    assert "torque_step_Nm" in text
    assert "current_step_A" not in text
    assert "feedback_A_per_V2" not in text
