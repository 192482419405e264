"""Regulators that switch the bridge in the closed drive: balance of energy, steady state, switching
frequency by formula, the exact solution at constant speed, and the drive with a carrier.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from current_feedback_design import feedback_design

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import FeedbackMethod
from dqforge.machines.plants.current_feedback import simulate_currents
from dqforge.machines.plants.scenario import Encoder, Profile, Scenario, constant
from dqforge.optimizer.current_feedback.closed_drive import counted_losses, own_feedback
from dqforge.optimizer.current_feedback.regulator_runs import (
    bridge_of,
    load_points,
    regulator_plan,
)
from dqforge.optimizer.losses.drive_budget import drive_budget, known_bridge
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.solution import solve, solve_control
from dqforge.reports.pages.templating import to_text
from dqforge.reports.run import emitted_files
from dqforge.reports.simulation.design_run import DriveSimulation, controller_files
from dqforge.reports.simulation.feedback_run import (
    closed_points,
    closed_solution,
    feedback_files,
    simulate_bridge,
    simulate_feedback,
)
from dqforge.reports.simulation.recorded_run import BridgeFigures, Simulation, compile_simulator
from dqforge.reports.simulation.tables import (
    closed_tables,
    plain_closed,
    plain_simulation,
    plot_simulation,
    simulation_tables,
)

METHODS = ("hysteresis", "ramp-comparison", "look-up-table", "circle", "predictive")

LOADED = Scenario(
    0.4,
    "speed",
    constant(200.0),
    load=Profile((0.0, 0.15), (0.0, 2.0)),
    dead_time=1e-6,
    encoder=Encoder(lines=1024),
)


def _figures(run: Simulation) -> BridgeFigures:
    assert run.bridge is not None
    return run.bridge.figures


@pytest.fixture(
    scope="module", params=(*METHODS, pytest.param("trajectory", marks=pytest.mark.slow))
)
def found(request: pytest.FixtureRequest) -> DriveSimulation:
    return simulate_feedback(replace(feedback_design(request.param), simulation=LOADED))


def test_energy_goes_somewhere(found: DriveSimulation) -> None:
    """Link, bridge, copper, field and shaft by separate integrals of the run."""
    design, run, use = found.design, found.run, _figures(found.run).use
    machine, spent = design.machine, use.states
    assert isinstance(machine, LinearMachine)
    assert machine.inertia is not None
    field = 0.75 * (machine.l_d * run.i_d[-1] ** 2 + machine.l_q * run.i_q[-1] ** 2)
    inside = spent["e_copper"] + spent["e_shaft"] + field
    assert spent["e_in"] == pytest.approx(inside, rel=1e-5)
    motion = 0.5 * machine.inertia * run.omega_m[-1] ** 2
    assert spent["e_shaft"] == pytest.approx(
        spent["e_load"] + spent["e_friction"] + motion, rel=1e-6
    )
    # The drops in the circuit, at the coolant's temperature, against the counted currents.
    tables = known_bridge(design.inverter)
    top = 2.5 * design.i_max
    lost = counted_losses(tables, use.counted, top, use.duration).conduction
    assert spent["e_link"] - spent["e_in"] == pytest.approx(lost * use.duration, rel=3e-3)
    assert lost > 1.0


def test_speed_and_torque_meet_the_load(found: DriveSimulation) -> None:
    figures, run = _figures(found.run), found.run
    friction = found.design.machine.friction
    assert np.mean(run.omega_m[-100:]) == pytest.approx(200.0, rel=5e-3)
    assert figures.torque == pytest.approx(2.0 + friction * 200.0, rel=0.04)
    assert figures.shaft == pytest.approx(200.0 * figures.torque, rel=0.01)
    assert found.steps[0].after == 200.0
    assert run.figures.bounded[0]


def test_every_commutation_is_counted(found: DriveSimulation) -> None:
    figures, record = _figures(found.run), found.run.bridge
    assert record is not None
    assert np.all(np.diff(record.edges) >= 0.0)
    assert record.edges[-1] == np.sum(figures.use.edges)
    assert np.sum(figures.use.counted[:, 3:]) == pytest.approx(np.sum(figures.use.edges))
    # All three legs carry or block all the time; dead times are part of it.
    assert np.sum(figures.use.counted[:, :3]) == pytest.approx(3 * 0.4, rel=1e-3)
    blanked = np.sum(figures.use.counted[:, 2])
    assert 0.9e-6 * record.edges[-1] < blanked + 3e-6 < 1.01e-6 * record.edges[-1] + 3e-6
    duty = found.run.duty[-500:-1]
    assert np.all((duty > -1e-9) & (duty < 1.0 + 1e-9))


def test_it_is_printed_drawn_and_written(found: DriveSimulation) -> None:
    rows = {row[0]: row[1] for row in simulation_tables(found)[0].rows}
    assert rows["switched by"] == found.design.control.current_loop.method
    assert rows["... conduction loss"].endswith("W")
    plain = json.loads(to_text("simulate", "fb", {"simulation": plain_simulation(found)}))
    said = plain["simulation"]["current_feedback"]
    assert said["frequency_Hz"] == pytest.approx(_figures(found.run).tail_frequency)
    assert said["switching_W"] > 0.0
    labels = [axes.get_ylabel() for axes in plot_simulation(found).axes]
    assert "Frequency in kHz" in labels


def _bare(method: str, *settings: str) -> Design:
    """Without dead time, on switches that drop nothing."""
    design = feedback_design(method, *settings)
    return replace(design, inverter=replace(design.inverter, device=None, dead_time=0.0))


def _run(design: Design, scenario: Scenario, folder: Path) -> Simulation:
    solution = closed_solution(design)
    assert solution.current_feedback is not None
    plan = solution.current_feedback.plan
    program = compile_simulator(
        folder, feedback_files(design, solution), design.export.prefix, bridge=plan.method
    )
    return simulate_bridge(program, design, scenario, plan)


def test_frequency_of_hysteresis_at_standstill(tmp_path: Path) -> None:
    """A current along the axis of phase a: only its leg switches, between 2/3 of the link and 0,
    and its error runs from band to band along two exponentials.
    """
    design, current = _bare("hysteresis"), 8.0
    machine, plan = design.machine, regulator_plan(design)
    assert isinstance(machine, LinearMachine)
    scenario = Scenario(
        0.5, "current", constant(0.0), constant(current), shaft=constant(0.0), inverter="switched"
    )
    run = _run(design, scenario, tmp_path)
    low, high = current - plan.band, current + plan.band
    source = 2.0 / 3.0 * design.inverter.v_dc / machine.r_s
    constant_ = machine.l_d / machine.r_s
    period = constant_ * (math.log((source - low) / (source - high)) + math.log(high / low))
    figures = _figures(run)
    assert figures.tail.edges[1] == figures.tail.edges[2] == 0.0
    assert figures.tail.edges[0] / (2.0 * figures.tail.duration) == pytest.approx(
        1.0 / period, abs=1.0 / figures.tail.duration
    )
    assert figures.torque == pytest.approx(0.0, abs=1e-9)
    assert abs(np.max(run.i_d[-200:]) - high) < 0.05 * plan.band


@pytest.mark.slow
@pytest.mark.parametrize("method", [*METHODS, "trajectory"])
def test_the_exact_solution_at_constant_speed_agrees(method: str, tmp_path: Path) -> None:
    """On an imposed speed, against the Taylor series of `simulate_currents`: frequency, error.

    A narrow band commutates often enough that means of a chaotic course repeat.
    """
    banded = method in ("hysteresis", "circle", "look-up-table")
    narrow = ("band=1 A", *(() if method == "hysteresis" else ("sampling=100 kHz",)))
    settings = [f"control.current_loop.{key}" for key in narrow] if banded else []
    design, omega_m = _bare(method, *settings), 250.0
    scenario = Scenario(
        0.5,
        "current",
        constant(5.0),
        constant(-1.0),
        shaft=constant(omega_m),
        omega_m=omega_m,
        inverter="switched",
    )
    figures = _figures(_run(design, scenario, tmp_path))
    plan = regulator_plan(design)
    electrical = design.machine.pole_pairs * omega_m / (2.0 * math.pi)
    trace = simulate_currents(
        bridge_of(design), plan.scheme(electrical), -1.0, 5.0, omega_m, periods=12, settling=2
    )
    # Errors of the vector about its mean: the mean of three phases' squares is half of it.
    rms = float(trace.rms_error()[0])
    error = math.hypot(figures.i_d + 1.0, figures.i_q - 5.0) / math.sqrt(2.0)
    assert math.hypot(figures.ripple_current, error) == pytest.approx(rms, rel=0.04)
    frequency = float(trace.switching_frequency().average[0])
    assert figures.frequency == pytest.approx(frequency, rel=0.05)
    assert figures.torque == pytest.approx(
        float(trace.power_balance().shaft[0]) / omega_m, rel=0.03
    )


@pytest.mark.slow
def test_regulators_meet_the_loads_beside_the_carrier() -> None:
    """In the closed drive the speed loop makes the torque of the load, whatever the mean current of
    the regulator is off by.
    """
    design = feedback_design("hysteresis")
    points = load_points(design)
    assert points is not None
    found = {name: closed_points(design, points, name)[0] for name in ("hysteresis", "carrier")}
    for point in found.values():
        assert not point.obstacle
        assert point.torque == pytest.approx(2.0, rel=0.05)
        assert abs(point.speed_error) < 2.0
        assert point.total == pytest.approx(
            point.copper + point.ripple_copper + point.iron + point.conduction + point.switching
        )
    assert found["carrier"].name == "svpwm"
    assert found["carrier"].frequency == pytest.approx(3e3, rel=1e-3)
    assert found["hysteresis"].frequency < 0.5 * found["carrier"].frequency
    assert found["hysteresis"].copper > 0.9 * found["carrier"].copper
    bare = replace(design, control=replace(design.control, speed_loop=None))
    assert "control.speed_loop" in closed_points(bare, points, "hysteresis")[0].obstacle
    rows = closed_tables({"hysteresis": (found["hysteresis"],)}, points, "hysteresis")[0].rows
    assert rows[0][0] == "hysteresis"
    assert rows[0][-1] == "chosen"
    assert plain_closed({"hysteresis": (found["hysteresis"],)})[0]["obstacle"] is None


def _with_carrier(design: Design) -> Design:
    control = design.control
    loops = CurrentLoopSettings(method="magnitude-optimum")
    return replace(design, control=replace(control, current_loop=loops))


def test_means_and_losses_are_those_of_the_carrier_drive(tmp_path: Path) -> None:
    """A regulator that holds its mean current makes the currents of the drive with PI loops; its
    counted losses, and those of the carrier, are those of the averaged budget.
    """
    ramp = feedback_design("ramp-comparison")
    scenario = replace(LOADED, dead_time=0.0, encoder=Encoder())
    regulated = _figures(_run(ramp, scenario, tmp_path))
    carrier = _with_carrier(ramp)
    files = controller_files(solve(replace(carrier, losses=None)))
    program = compile_simulator(tmp_path, files, carrier.export.prefix, bridge="carrier")
    pulsed = _figures(simulate_bridge(program, carrier, scenario, None))
    assert regulated.tail_frequency == pytest.approx(3e3, rel=1e-3)
    assert pulsed.tail_frequency == pytest.approx(3e3, rel=1e-3)
    for name in ("i_q", "torque", "shaft"):
        assert getattr(regulated, name) == pytest.approx(getattr(pulsed, name), rel=0.03)
    assert regulated.i_d == pytest.approx(pulsed.i_d, abs=0.1)
    budget = drive_budget(
        carrier.machine,
        replace(carrier.inverter, dead_time=0.0),
        [pulsed.i_d],
        [pulsed.i_q],
        [200.0],
        ["svpwm"],
        options=budget_options(ramp),
    )
    assert pulsed.conduction[1] == pytest.approx(float(budget.conduction[0, 0, 0]), rel=0.02)
    # The budget switches the mean current; the ripple turns on at less of it and off at more.
    assert pulsed.switching[1] == pytest.approx(float(budget.switching[0, 0, 0]), rel=0.08)
    assert regulated.switching[1] == pytest.approx(pulsed.switching[1], rel=0.1)
    copper = 1.5 * 0.8 * (pulsed.i_d**2 + pulsed.i_q**2)
    assert pulsed.copper - copper == pytest.approx(3.0 * 0.8 * pulsed.ripple_current**2, rel=1e-6)


def test_patterns_of_three_pulses_hold_the_mean_current_at_their_frequency() -> None:
    """Three pulses to an electrical period, each leg; the currents of the phasors in the mean."""
    design = feedback_design("trajectory", "control.current_loop.pulses=3")
    speed = 500.0
    scenario = Scenario(
        0.08, "current", constant(4.0), shaft=constant(speed), omega_m=speed, dead_time=0.0
    )
    figures = _figures(simulate_feedback(replace(design, simulation=scenario)).run)
    electrical = design.machine.pole_pairs * speed / (2.0 * math.pi)
    assert figures.tail_frequency == pytest.approx(3.0 * electrical, rel=0.05)
    assert figures.i_q == pytest.approx(4.0, abs=0.4)
    assert figures.i_d == pytest.approx(0.0, abs=0.4)


def test_comparators_that_chatter_are_refused() -> None:
    design = feedback_design("ramp-comparison", "control.current_loop.kp=500 V/A")
    with pytest.raises(NoSolutionError, match="comparator_band"):
        simulate_feedback(replace(design, simulation=replace(LOADED, duration=0.01)))


@pytest.mark.parametrize("method", ["hysteresis", "circle"])
def test_the_emitted_speed_control_is_the_one_that_runs(method: FeedbackMethod) -> None:
    design = feedback_design(method, "export.control=float32", simulated=True)
    solution = replace(solve_control(design), current_feedback=own_feedback(design))
    emitted = emitted_files(solution)["fb_control.h"]
    assert emitted == feedback_files(design, closed_solution(design, solution))["fb_control.h"]
    assert f"The {method} regulator switches the bridge".encode() in emitted
