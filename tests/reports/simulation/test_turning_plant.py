"""A plant whose map is one over the rotor angle, read from its file: against SciPy's integration of
the machine's own closed form, against its energy, and in the loop of a design.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import turning_machine as truth
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.catalogue import load_design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.flux_map import SaturatedMachine
from dqforge.machines.flux_maps.building import build_flux_map
from dqforge.machines.flux_maps.map_files import read_flux_points
from dqforge.machines.plants.scenario import InverterModel, Profile, Scenario, constant
from dqforge.reports.answers.mtpa import Request, answer_mtpa
from dqforge.reports.simulation.design_run import simulate_design, turning_figures
from dqforge.reports.simulation.plant_input import Drive
from dqforge.reports.simulation.recorded_run import Simulator, simulate, simulator
from dqforge.reports.simulation.tables import plain_simulation, simulation_tables

T_S, R_S, INERTIA = 1e-4, 2.0, 4e-3
FILE = truth.text(truth.rows(np.arange(0.0, 60.0, 2.5)), truth.TITLES)
LINK = Inverter(120.0, 1.0 / T_S)
DUTY_A, DUTY_B = (
    Profile((0.0,), (0.5,), amplitude=0.1, frequency=40.0),
    Profile((0.0,), (0.5,), amplitude=-0.06, frequency=70.0),
)
SCENARIO = Scenario(
    2.5e-3, "open-loop", DUTY_A, DUTY_B, load=constant(0.5), omega_m=160.0, theta_e=0.4
)
DESIGN = """\
dqforge: 1
name: turning
machine:
  model: flux-map
  pole_pairs: 3
  resistance: 200 mOhm phase
  max_current: 28 A peak
  inertia: 4e-3
  max_speed: 3000 rpm
  flux_map: {file: map.csv}
inverter: {v_dc: 300 V, switching_frequency: 10 kHz}
control: {speed_loop: {ratio: 10}}
simulation:
  duration: 0.2 s
  torque: 6 N m
  shaft: 180 rpm
"""


@pytest.fixture(scope="module")
def plant() -> Iterator[Simulator]:
    with simulator() as compiled:
        yield compiled


@pytest.fixture(scope="module")
def machine() -> SaturatedMachine:
    found = build_flux_map(read_flux_points(FILE, "map.csv"), pole_pairs=truth.PAIRS).flux_map
    return SaturatedMachine(truth.PAIRS, R_S, found, 28.0, inertia=INERTIA, omega_m_max=200.0)


def currents(psi: FloatArray, theta: float, guess: FloatArray) -> FloatArray:
    """Currents (i_d, i_q) of the closed form at flux linkages, by Newton's method on differences;
    ``guess`` is where it begins, and takes what it finds.
    """
    angle, step = np.full(3, theta), 1e-4 * np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    for _ in range(50):
        at_d, at_q = guess[:, None] + step
        there = np.array(truth.flux(at_d, at_q, angle))
        miss = psi - there[:, 0]
        if np.max(np.abs(miss)) < 1e-13:
            break
        guess += np.linalg.solve((there[:, 1:] - there[:, :1]) / 1e-4, miss)
    return guess.copy()


def test_the_plant_is_the_machine_integrated_by_scipy(
    plant: Simulator, machine: SaturatedMachine
) -> None:
    """The states of the reference are the flux linkages of the stator, which know no rotation: its
    electromotive forces are none of the plant's formulas.
    """
    guess = np.zeros(2)

    def inside(x: FloatArray) -> tuple[float, complex]:
        theta = truth.PAIRS * x[3]
        turned = complex(x[0], x[1]) * np.exp(-1j * theta)
        i_d, i_q = currents(np.array([turned.real, turned.imag]), theta, guess)
        return theta, complex(i_d, i_q)

    def slopes(_: float, x: FloatArray, v: complex) -> FloatArray:
        theta, i = inside(x)
        force = v - R_S * i * np.exp(1j * theta)
        at = np.array([i.real]), np.array([i.imag]), np.array([theta])
        torque = float(truth.torque(*at)[0])
        return np.array([force.real, force.imag, (torque - 0.5) / INERTIA, x[2]])

    begin = truth.flux(np.zeros(1), np.zeros(1), np.array([0.4]))
    psi = complex(begin[0][0], begin[1][0]) * np.exp(0.4j)
    states = [np.array([psi.real, psi.imag, 160.0, 0.4 / truth.PAIRS])]
    duty = np.full(3, 0.5)
    for k in range(25):
        v = complex(2.0 / 3.0 * 120.0 * np.sum(duty * np.exp(2j * math.pi / 3.0 * np.arange(3))))
        found = solve_ivp(slopes, (0.0, T_S), states[-1], rtol=1e-7, atol=1e-9, args=(v,))
        states.append(found.y[:, -1])
        a, b = (float(part.at(np.array(k * T_S))) for part in (DUTY_A, DUTY_B))
        duty = np.array([a, b, 1.5 - a - b])
    run = simulate(plant, Drive(machine, LINK, T_S), SCENARIO)
    guess[:] = 0.0
    pairs = [inside(x) for x in states]
    theta, i = np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])
    assert float(np.max(np.abs(i))) > 4.0
    np.testing.assert_allclose(run.i_d, i.real, atol=2e-5)
    np.testing.assert_allclose(run.i_q, i.imag, atol=2e-5)
    np.testing.assert_allclose(run.omega_m, [x[2] for x in states], atol=2e-5)
    torque = truth.torque(i.real, i.imag, theta)
    np.testing.assert_allclose(run.torque, torque, atol=2e-4)
    assert torque[0] == pytest.approx(
        truth.torque(np.zeros(1), np.zeros(1), np.array([0.4]))[0]
    )  # cogging
    # Without what turns, the same plant is another one.
    flat = SaturatedMachine(
        truth.PAIRS,
        R_S,
        build_flux_map(read_flux_points(FILE, "map.csv")).flux_map,
        28.0,
        inertia=INERTIA,
        omega_m_max=200.0,
    )
    other = simulate(plant, Drive(flat, LINK, T_S), SCENARIO)
    assert float(np.max(np.abs(other.i_q - i.imag))) > 0.3


@pytest.mark.parametrize("inverter", ["averaged", "switched"])
def test_energy_is_kept(
    plant: Simulator, machine: SaturatedMachine, inverter: InverterModel
) -> None:
    """What goes in is copper loss, work at the shaft and the field's energy by the closed form."""
    scenario = Scenario(
        2.5e-3, "open-loop", DUTY_A, DUTY_B, load=constant(0.5), omega_m=160.0, theta_e=0.4,
        inverter=inverter, dead_time=1e-6,
    )  # fmt: skip
    run = simulate(plant, Drive(machine, LINK, T_S), scenario)

    def field(k: int) -> float:
        at = run.i_d[k : k + 1], run.i_q[k : k + 1], run.theta_e[k : k + 1]
        psi_d, psi_q = truth.flux(*at)
        return float((1.5 * (psi_d * at[0] + psi_q * at[1]) - truth.co_energy(*at))[0])

    figures, end = run.figures, run.t.size - 1
    kept = float(figures.e_in[0] - figures.e_copper[0] - figures.e_shaft[0])
    assert kept == pytest.approx(field(end) - field(0), abs=2e-6)
    assert abs(field(end) - field(0)) > 0.01
    assert float(figures.e_copper[0]) > 0.01


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "map.csv").write_bytes(FILE)
    (tmp_path / "turning.yaml").write_text(DESIGN)
    return tmp_path


def test_references_carry_the_ripple_of_the_torque(folder: Path) -> None:
    design = load_design(folder / "turning.yaml")
    answer = answer_mtpa(design, Request(None, None, None, "svpwm", "0 %"))
    (table,) = [table for table in answer.tables if "ripple" in table.title]
    chosen, found = answer.plain["mtpa"]["chosen"], answer.plain["mtpa"]["torque_ripple"]
    theta = np.linspace(0.0, math.pi / 3.0, 720, endpoint=False)
    course = truth.torque(
        np.asarray(chosen["i_d_A"])[:, None], np.asarray(chosen["i_q_A"])[:, None], theta
    )
    np.testing.assert_allclose(found["peak_to_peak_Nm"], np.ptp(course, axis=1), rtol=2e-4)
    assert table.columns[-2:] == ("order 6 N m", "order 12 N m")
    assert float(table.rows[-1][1]) == pytest.approx(found["peak_to_peak_Nm"][-1], rel=1e-3)
    share = 100.0 * found["peak_to_peak_Nm"][-1] / float(np.max(course[-1].mean()))
    assert float(table.rows[-1][2]) == pytest.approx(share, rel=2e-3)
    assert 100.0 * found["relative"][-1] == pytest.approx(share, rel=2e-3)
    assert math.isnan(found["relative"][0])


@pytest.mark.slow
def test_the_loop_shows_the_ripple_of_its_currents(folder: Path) -> None:
    """The ripple of the run is that of the closed form along its own currents, and near that at
    constant currents: the loop holds them against 54 Hz of order 6.
    """
    design = load_design(folder / "turning.yaml")
    found = simulate_design(design)
    seen = found.turning
    assert seen is not None
    i_d, i_q = float(found.run.i_d[-1]), float(found.run.i_q[-1])
    theta = np.linspace(0.0, math.pi / 3.0, 720, endpoint=False)
    course = truth.torque(np.array([i_d]), np.array([i_q]), theta)
    assert seen.ripple == pytest.approx(float(np.ptp(course)), rel=0.1)
    run, last = found.run, found.run.t >= 0.18
    own = truth.torque(run.i_d[last], run.i_q[last], run.theta_e[last])
    assert seen.ripple == pytest.approx(float(np.ptp(own)), rel=0.005)
    assert seen.torque == pytest.approx(6.0, abs=0.05)
    assert plain_simulation(found)["turning"]["ripple"] == seen.ripple
    assert seen.relative == pytest.approx(seen.ripple / seen.torque)
    idle = replace(run.figures, tail_torque=0.0 * run.figures.tail_torque)
    assert turning_figures(replace(run, figures=idle)).relative is None
    rows = {row[0]: row[1] for row in simulation_tables(found)[0].rows}
    assert rows["its ripple, peak to peak"].startswith(f"{seen.ripple:.3g} N m")
