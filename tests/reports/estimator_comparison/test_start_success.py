"""The rate of a design's own start: its box, its program, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.design import Design
from dqforge.machines.design.from_machine import make_design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.plants.scenario import CurrentSensor, Scenario, constant
from dqforge.optimizer.solution import solve
from dqforge.optimizer.start_up.solve import StartRate
from dqforge.reports.answers.estimators import drawn_plants, start_success
from dqforge.reports.control.header import plain_control
from dqforge.reports.estimator_comparison.random_starts import StartInput, bench_program, run_starts
from dqforge.reports.simulation.design_run import controller_files, drive_of, emitted_files
from dqforge.reports.simulation.plant_input import run_input
from dqforge.reports.simulation.recorded_run import simulate, simulator
from dqforge.reports.start_up.header import start_up_files

MACHINE = LinearMachine(
    pole_pairs=4, r_s=0.36, l_d=1.2e-3, l_q=1.2e-3, psi_pm=0.05, i_max=10.0, inertia=1e-4,
    omega_m_max=314.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def design() -> Design:
    return make_design(
        MACHINE,
        v_dc=325.0,
        f_sw=1e4,
        inverter={"dead_time": 1e-6},
        control={
            "speed_loop": {"method": "symmetrical-optimum", "spread": 8},
            "observer": {"method": "flux", "speed_gain": 0.7, "pll_bandwidth": 500.0},
            "tolerances": {"r_s": 0.3, "psi_pm": 0.04, "inertia": 0.2, "dead_time": "50 %"},
            "start_up": {},
        },
        export={"control": "float32"},
    )


@pytest.fixture(scope="module")
def rates(design: Design) -> tuple[StartRate, ...]:
    return start_success(design, loads=(0.3, 1.3), count=4)


def test_design_starts_throughout_its_box(rates: tuple[StartRate, ...]) -> None:
    rate = rates[0]
    assert (rate.load, rate.count, rate.succeeded, rate.silent) == (0.3, 4, 4, 0)
    assert rate.interval[0] < 0.6
    assert rate.interval[1] == 1.0


def test_overload_has_a_name(rates: tuple[StartRate, ...]) -> None:
    """A load beyond the current limit starts never, and every drive says so."""
    rate = rates[1]
    assert (rate.succeeded, rate.silent) == (0, 0)
    assert sum(rate.failures.values()) == 4


def test_same_seed_same_drives(design: Design) -> None:
    assert drawn_plants(design, 9, 7)[:3] == drawn_plants(design, 3, 7)
    assert drawn_plants(design, 3, 8) != drawn_plants(design, 3, 7)


def test_drives_are_drawn_from_the_box(design: Design) -> None:
    drawn = drawn_plants(design, 400, 1)
    errors = np.array(
        [[one.errors.r_s, one.errors.psi_pm, one.errors.inertia, one.errors.l_d] for one in drawn]
    )
    np.testing.assert_allclose(np.min(errors, axis=0), [-0.3, -0.04, -0.2, 0.0], atol=0.01)
    np.testing.assert_allclose(np.max(errors, axis=0), [0.3, 0.04, 0.2, 0.0], atol=0.01)
    dead_times = np.array([one.dead_time for one in drawn])
    assert np.min(dead_times) >= 0.0
    assert np.max(dead_times) <= 0.5e-6 * (1.0 + 1e-9)
    assert abs(np.mean(np.exp(1j * np.array([one.theta_e for one in drawn])))) < 0.15


def test_without_tolerances_the_usual_box_and_the_whole_dead_time(design: Design) -> None:
    plain = replace(design, control=replace(design.control, tolerances=None))
    drawn = drawn_plants(plain, 100, 1)
    assert 0.25 < max(abs(one.errors.r_s) for one in drawn) <= 0.3
    assert all(abs(one.dead_time - 1e-6) < 1e-12 for one in drawn)


def test_bench_and_simulation_are_the_same_drive(design: Design) -> None:
    """Speed and angles of a start by both programs, without noise."""
    solution = solve(design)
    assert solution.start_up is not None
    scenario = Scenario(
        0.9,
        "speed",
        constant(150.0),
        load=constant(0.3),
        theta_e=2.0,
        load_kind="friction",
        sensor=CurrentSensor(),
        encoder=replace(Scenario(1.0, "speed", constant(1.0)).encoder, absent=True),
    )
    files = controller_files(solution) | start_up_files(solution, solution.start_up)
    drive, prefix = drive_of(design), design.export.prefix
    with bench_program(files, prefix, "flux", shared=False) as program:
        (rows,) = run_starts(program, [StartInput(run_input(drive, scenario))])
    with simulator(emitted_files(solution, "float32") | files, prefix, ("flux",)) as whole:
        run = simulate(whole, drive, scenario)
    count = min(rows["t"].size, run.t.size)
    np.testing.assert_allclose(rows["omega_m"][:count], run.omega_m[:count], atol=1e-6)
    assert abs(run.omega_m[-1] - 150.0) < 5.0
    assert plain_control(solution)["start_up"] is True


@pytest.mark.slow
def test_what_cannot_be_tried_is_refused(design: Design) -> None:
    none = replace(design, control=replace(design.control, start_up=None))
    with pytest.raises(InputError, match=r"control\.start_up"):
        start_success(none)
    with pytest.raises(NoSolutionError, match="shows no angle at rest"):
        start_success(design, "saliency", count=1)
