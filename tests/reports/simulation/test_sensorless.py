"""The emitted observers in the loop: against the truth, their numpy models,
and the steady errors that are judged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    ObserverSettings,
    SpeedLoopSettings,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import (
    CurrentSensor,
    Encoder,
    PlantErrors,
    Profile,
    Scenario,
    Sensorless,
    constant,
    plants,
)
from dqforge.machines.transforms import Triple, clarke
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.observers.methods.registry import METHODS
from dqforge.optimizer.observers.parts import steady_observer
from dqforge.optimizer.observers.reduced_order_step import ReducedOrderGains
from dqforge.optimizer.solution import Solution, solve
from dqforge.optimizer.steps.step_arithmetic import cast
from dqforge.reports.c_code.harness import wrap
from dqforge.reports.observers.float32_model import observed_speeds
from dqforge.reports.pages.figures_style import to_svg
from dqforge.reports.simulation.design_run import controller_files, drive_of, evaluate, observers_of
from dqforge.reports.simulation.recorded_run import Simulation, Simulator, simulate, simulator
from dqforge.reports.simulation.tables import plain_simulation, plot_simulation, simulation_tables

T_S = 1e-4
MACHINE = LinearMachine(
    pole_pairs=3,
    r_s=0.3,
    l_d=2e-3,
    l_q=3e-3,
    psi_pm=0.1,
    i_max=50.0,
    inertia=0.05,
    friction=0.01,
    omega_m_max=300.0,
)
SENSORLESS = Sensorless(40.0, 30.0)


def _design(method: ObserverMethodName) -> Design:
    base = make_design(MACHINE)
    observer = (
        ObserverSettings(500.0) if method == "reduced-order" else ObserverSettings(method=method)
    )
    control = replace(
        base.control,
        t_s=T_S,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=2.0 * math.pi * 300.0),
        speed_loop=SpeedLoopSettings("symmetrical-optimum", ratio=5, spread=16.0),
        observer=observer,
    )
    if method == "open-loop-flux":  # its usual loop is so fast that the drive swings on it
        control = replace(control, observer=ObserverSettings(method=method, pll_bandwidth=100.0))
    return replace(base, control=control, inverter=Inverter(500.0, 1.0 / T_S), losses=None)


@contextmanager
def _compiled(method: ObserverMethodName) -> Iterator[tuple[Solution, Simulator]]:
    solved = solve(_design(method))
    with simulator(
        controller_files(solved), solved.design.export.prefix, observers_of(solved)[1]
    ) as program:
        yield solved, program


@pytest.fixture(scope="module")
def flux() -> Iterator[tuple[Solution, Simulator]]:
    with _compiled("flux") as found:
        yield found


def _angle_error(found: Simulation) -> FloatArray:
    return np.asarray(np.angle(np.exp(1j * (found.theta_e_observed - found.theta_e))))


def _model(solved: Solution, found: Simulation) -> tuple[FloatArray, FloatArray]:
    """Angle and mechanical speed by the float32 model, fed with what was recorded."""
    position = solved.gains.position
    assert position is not None
    phases = found.i_measured.astype(np.float32)
    i = clarke(SINGLE, Triple(*phases.T))
    v = (found.v_alpha.astype(np.float32), found.v_beta.astype(np.float32))
    first = [
        np.array([value], dtype=np.float32) for value in (found.theta_e[0], 3.0 * found.omega_m[0])
    ]
    state, own = position.method.start(wrap(first[0]), first[1]), cast(position.gains, SINGLE)
    theta, omega = np.empty(found.t.size), np.empty(found.t.size)
    for k in range(found.t.size):
        now = slice(k, k + 1)
        state = position.method.step(
            own, state, (v[0][now], v[1][now]), (i[0][now], i[1][now]), SINGLE
        )
        theta[k], omega[k] = state.theta_e[0], state.omega_e[0]
    return theta, omega / 3.0


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_a_drive_runs_on_its_observer_which_equals_its_model(method: ObserverMethodName) -> None:
    """From 60 rad/s up to 150 and a load, all without encoder.

    The estimates are those of numpy to the bit.
    """
    with _compiled(method) as (solved, program):
        sensor = CurrentSensor(noise=0.02)
        speed = Profile((0.0, 0.1, 0.4), (60.0, 60.0, 150.0), "linear")
        load = Profile((0.0, 0.4, 0.5), (0.0, 0.0, 5.0), "linear")
        scenario = Scenario(
            0.8,
            "speed",
            speed,
            load=load,
            omega_m=60.0,
            sensor=sensor,
            sensorless=Sensorless(0.0, 0.0),
            dead_time=0.0,
        )
        found = simulate(program, drive_of(solved.design), scenario)
    assert np.all(found.sensorless == 1.0)
    np.testing.assert_array_equal(found.theta_e_measured, found.theta_e_observed)
    theta, omega = _model(solved, found)
    np.testing.assert_array_equal(found.theta_e_observed, theta)
    np.testing.assert_allclose(found.omega_m_observed, omega, rtol=1e-12)
    late = found.t > 0.7
    # Position observers have no notion of the acceleration: while it lasts, the angle lags.
    assert np.degrees(np.max(np.abs(_angle_error(found)))) < 15.0
    assert np.degrees(np.max(np.abs(_angle_error(found)[late]))) < 1.0
    assert float(np.mean(found.omega_m[late])) == pytest.approx(150.0, abs=0.5)
    assert float(np.mean(found.omega_m_observed[late] - found.omega_m[late])) == pytest.approx(
        0.0, abs=0.05
    )


@pytest.mark.slow
def test_the_voltage_is_that_of_the_ending_period(flux: tuple[Solution, Simulator]) -> None:
    """Duty cycles of the sample before, on a constant link, are the recorded voltage of the next
    row.
    """
    solved, program = flux
    found = simulate(program, drive_of(solved.design), Scenario(0.05, "speed", constant(60.0)))
    a, b, c = (500.0 * found.duty[:-1, k] for k in range(3))
    np.testing.assert_allclose(found.v_alpha[1:], (2.0 * a - b - c) / 3.0, atol=1e-3)
    np.testing.assert_allclose(found.v_beta[1:], (b - c) / math.sqrt(3.0), atol=1e-3)
    assert np.max(np.abs(found.v_alpha)) > 10.0


@pytest.mark.slow
@pytest.mark.parametrize("method", ["flux", pytest.param("extended-emf", marks=pytest.mark.slow)])
def test_wrong_parameters_cost_the_angle_what_is_judged(method: ObserverMethodName) -> None:
    """R +30 % and psi -5 % in the machine: the mean angle error in the loop is the
    fixed point of the judgement.
    """
    omega_m, i_d, i_q = (
        40.0,
        -8.0,
        8.0,
    )  # i_q alone changes the size of the voltage only, not its angle
    with _compiled(method) as (solved, program):
        scenario = Scenario(
            1.0,
            "current",
            constant(i_q),
            constant(i_d),
            shaft=constant(omega_m),
            omega_m=omega_m,
            errors=PlantErrors(r_s=0.3, psi_pm=-0.05),
            dead_time=0.0,
        )
        found = simulate(program, drive_of(solved.design), scenario)
    position = solved.gains.position
    assert position is not None
    off = plants(MACHINE, {"r_s": np.array([0.3]), "psi_pm": np.array([-0.05])})
    steady = steady_observer(
        position.method,
        position.gains,
        T_S,
        off,
        np.array([i_d + 1j * i_q]),
        np.array([3.0 * omega_m]),
        np.zeros(1),
    )
    assert steady.found[0]
    last = found.t > 0.8
    assert float(np.ptp(_angle_error(found)[last])) < 1e-3
    assert float(np.mean(_angle_error(found)[last])) == pytest.approx(
        float(steady.theta_error[0]), abs=3e-4
    )
    assert abs(float(steady.theta_error[0])) > math.radians(1.5)


def test_the_handover_has_hysteresis(flux: tuple[Solution, Simulator]) -> None:
    """Up through both speeds, between them, and down: on at `above`, off at `below`,
    by the speed in use.
    """
    solved, program = flux
    speed = Profile((0.0, 0.5, 0.8, 1.3), (20.0, 60.0, 60.0, 20.0), "linear")
    found = simulate(
        program,
        drive_of(solved.design),
        Scenario(1.5, "speed", speed, omega_m=20.0, encoder=Encoder(2048), sensorless=SENSORLESS),
    )
    edges = np.flatnonzero(np.diff(found.sensorless))
    assert edges.size == 2
    assert found.sensorless[edges[0] + 1] == 1.0
    # The sample that switches was decided with the speed that was in use one sample before.
    assert (
        float(found.omega_m_measured[edges[0]])
        >= 40.0
        > float(found.omega_m_measured[edges[0] - 20])
    )
    assert (
        float(found.omega_m_measured[edges[1]])
        < 30.0
        < float(found.omega_m_measured[edges[1] - 20])
    )
    before = found.t < found.t[edges[0]]
    assert (
        np.max(np.abs(np.angle(np.exp(1j * (found.theta_e_measured - found.theta_e)[before]))))
        < 3e-3
    )
    assert np.max(np.abs(found.omega_m - found.reference)) < 10.0


def test_figures_and_tables_show_the_angle(flux: tuple[Solution, Simulator]) -> None:
    solved, program = flux
    scenario = Scenario(0.2, "speed", constant(60.0), omega_m=60.0, sensorless=SENSORLESS)
    shown = evaluate(solved.design, simulate(program, drive_of(solved.design), scenario))
    rows = {row[0]: row[1] for row in simulation_tables(shown)[0].rows}
    assert "deg" in rows["angle of the observer, largest error"]
    assert rows["control without encoder"] == "100 % of the time"
    plain = plain_simulation(shown)["observer"]
    assert plain["sensorless_share"] == 1.0
    assert 0.0 < plain["angle_error_rms_rad"] <= plain["angle_error_largest_rad"] < 0.2
    assert "Angle error in deg" in to_svg(plot_simulation(shown))


@pytest.mark.slow
def test_the_speed_observer_in_the_loop_equals_its_model() -> None:
    with _compiled("reduced-order") as (solved, program):
        scenario = Scenario(
            0.1, "speed", constant(50.0), encoder=Encoder(speed="observer"), dead_time=0.0
        )
        found = simulate(program, drive_of(solved.design), scenario)
        with pytest.raises(InputError, match="one of the position"):
            simulate(program, drive_of(solved.design), replace(scenario, sensorless=SENSORLESS))
    assert solved.gains.observer is not None
    gains = ReducedOrderGains.of(MACHINE, solved.gains.observer)
    phases = found.i_measured.astype(np.float32)
    i = clarke(SINGLE, Triple(*phases.T))
    theta = found.theta_e_measured.astype(np.float32)
    v = (found.v_alpha.astype(np.float32)[None], found.v_beta.astype(np.float32)[None])
    model = observed_speeds(
        gains, v, (i[0][None], i[1][None]), theta[None], (theta[:1], np.zeros(1, np.float32))
    )
    np.testing.assert_allclose(
        found.omega_m_observed, model[0, :, 1].astype(float) / 3.0, rtol=1e-12
    )
    assert np.all(np.isnan(found.theta_e_observed))
    # It takes the torque as that of i_q alone; here i_d makes a part of it.
    assert 0.05 < np.max(np.abs(found.omega_m_observed - found.omega_m)) < 0.5
    assert "largest error of the observed speed" in {
        row[0] for row in simulation_tables(evaluate(solved.design, found))[0].rows
    }


def test_an_observer_that_is_not_there_is_asked_for(flux: tuple[Solution, Simulator]) -> None:
    solved, program = flux
    bare = replace(program, observers=())
    for changes, phrase in (
        ({"encoder": Encoder(speed="observer")}, "control.observer"),
        ({"sensorless": SENSORLESS}, "one of the position"),
    ):
        with pytest.raises(InputError, match=phrase):
            simulate(
                bare, drive_of(solved.design), Scenario(0.1, "speed", constant(60.0), **changes)
            )
    with pytest.raises(InputError, match="cannot end below"):
        Sensorless(10.0, 11.0)
