"""A design that names a firmware, simulated: its own code and the firmware's loops side by side."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load_design
from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.plants.scenario import Scenario, Sensorless
from dqforge.optimizer.firmware.gain_search import FirmwareLoops
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.firmware.design_simulation import simulate_loops, simulate_with_firmware
from dqforge.reports.firmware.target import firmware_simulator
from dqforge.reports.simulation.design_run import DriveSimulation, npz_bytes, simulate_design
from dqforge.reports.simulation.recorded_run import Simulator
from dqforge.reports.simulation.tables import (
    plain_simulation,
    simulation_passage,
    simulation_tables,
)

TEXT = """\
dqforge: 1
name: e-scooter
machine:
  model: linear
  pole_pairs: 15
  resistance: {value: 100 mOhm, kind: line-to-line}
  inductance_d: {value: 200 uH, kind: line-to-line}
  inductance_q: {value: 200 uH, kind: line-to-line}
  back_emf_constant: {value: 60 rpm/V, kind: line-to-line peak}
  max_current: {value: 40 A, kind: rms}
  max_speed: 2500 rpm
  inertia: 0.001 kg m^2
inverter: {v_dc: 48 V, switching_frequency: 20 kHz}
control:
  firmware: vesc
  current_loop: {method: bandwidth, bandwidth: 1000 Hz}
  speed_loop: {method: bandwidth, bandwidth: 30 Hz}
simulation:
  duration: 0.6 s
  speed: {points: [{time: 0 s, speed: 60 rad/s}]}
export: {prefix: scooter}
"""


@pytest.fixture(scope="module")
def design(tmp_path_factory: pytest.TempPathFactory) -> Design:
    path = Path(tmp_path_factory.mktemp("scooter")) / "scooter.yaml"
    path.write_text(TEXT, encoding="utf-8")
    return load_design(path)


@pytest.fixture(scope="module")
def solution(design: Design) -> Solution:
    return solve(design)


@pytest.fixture(scope="module")
def found(design: Design, solution: Solution) -> DriveSimulation:
    return simulate_with_firmware(design, solution=solution)


@pytest.mark.slow
def test_our_own_code_runs_as_without_the_firmware(
    design: Design, solution: Solution, found: DriveSimulation
) -> None:
    alone = simulate_design(design, solution=solution)
    assert found.firmware is None
    assert npz_bytes(alone.run) == npz_bytes(found.run)
    assert found.formats == ("float32",)


def test_the_firmware_reaches_the_speed_along_its_ramp(found: DriveSimulation) -> None:
    mine = found.others[-1]
    assert mine.firmware == mine.label == "vesc"
    assert mine.run.omega_m[-1] == pytest.approx(60.0, abs=0.1)
    ramp = 25_000.0 / 15.0 * 2.0 * np.pi / 60.0  # ERPM/s that VESC keeps to
    early = (mine.run.t > 0.1) & (mine.run.t < 0.3)
    slope = np.polyfit(mine.run.t[early], mine.run.omega_m[early], 1)[0]
    assert slope == pytest.approx(ramp, rel=0.02)


def test_its_samples_have_a_file_of_their_own(found: DriveSimulation) -> None:
    files = found.files()
    assert list(files) == ["scooter_simulation.npz", "scooter_simulation_vesc.npz"]
    with np.load(io.BytesIO(files["scooter_simulation_vesc.npz"])) as stored:
        np.testing.assert_array_equal(stored["omega_m"], found.others[-1].run.omega_m)


def test_tables_have_a_column_of_its_name(found: DriveSimulation) -> None:
    figures, *steps = simulation_tables(found)
    assert figures.columns == ("", "float32", "vesc")
    assert [table.title for table in steps] == [
        "Steps of the speed, float32",
        "Steps of the speed, vesc",
    ]
    assert all(len(row) == 3 for row in figures.rows)


def test_the_json_names_it(found: DriveSimulation) -> None:
    plain = json.loads(json.dumps(plain_simulation(found)))
    assert "firmware" not in plain
    assert plain["others"][-1]["firmware"] == "vesc"
    assert plain["others"][-1]["steps"][0]["settling"] > 0.2


def test_the_report_names_it(found: DriveSimulation) -> None:
    passage = simulation_passage(found)
    assert "loops with the structure of vesc" in passage.text[0]
    assert "controller of <code>scooter_control.h</code>" in passage.text[0]
    assert [name for name, _ in passage.drawings] == ["simulation", "simulation_vesc"]


@pytest.fixture(scope="module")
def loops(solution: Solution) -> FirmwareLoops:
    found = solution.gains.firmware
    assert found is not None
    return found


@pytest.fixture(scope="module")
def program(loops: FirmwareLoops) -> Iterator[Simulator]:
    with firmware_simulator(loops.profile, loops.configuration.drive) as made:
        yield made


@pytest.fixture(scope="module")
def short(design: Design) -> Scenario:
    assert design.simulation is not None
    return replace(design.simulation, duration=0.02)


def test_what_is_not_modelled_is_left_out_and_said(
    design: Design,
    loops: FirmwareLoops,
    short: Scenario,
    found: DriveSimulation,
    program: Simulator,
) -> None:
    scenario = replace(
        short, sensorless=Sensorless(90.0, 80.0), encoder=replace(short.encoder, speed="observer")
    )
    mine = simulate_loops(design, loops, scenario, program=program)
    assert "angle of the encoder" in mine.remarks[0]
    assert "without the observer of dqforge" in mine.remarks[1]
    both = replace(found, others=(mine,))
    assert any("angle of the encoder" in note for note in simulation_tables(both)[0].notes)
    assert plain_simulation(both)["others"][-1]["remarks"] == list(mine.remarks)


def test_a_switched_inverter_loads_at_either_peak(
    design: Design, loops: FirmwareLoops, short: Scenario, program: Simulator
) -> None:
    switched = replace(short, inverter="switched")
    mine = simulate_loops(design, loops, switched, program=program)
    averaged = simulate_loops(design, loops, short, program=program)
    assert mine.run.scenario.inverter == "switched"
    assert mine.run.omega_m[-1] == pytest.approx(averaged.run.omega_m[-1], rel=0.02)
    current = replace(loops.profile.current, delay=0.3)
    odd = replace(loops, profile=replace(loops.profile, current=current))
    mine = simulate_loops(design, odd, switched, program=program)
    assert mine.run.scenario.inverter == "averaged"
    assert "averaged inverter" in mine.remarks[0]


def test_a_firmware_without_speed_control_is_named(
    design: Design, loops: FirmwareLoops, short: Scenario
) -> None:
    none = replace(loops, profile=replace(loops.profile, speed=None))
    with pytest.raises(InputError, match=r"control\.firmware: vesc has no speed controller"):
        simulate_loops(design, none, short)
