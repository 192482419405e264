"""Driven, locked and free shafts: real logs, and machines whose truth is known."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from bench_files import bench_text, slow_noise, write_table

from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.identification.identify import Identification, identify
from dqforge.optimizer.identification.parameters import Parameter
from dqforge.optimizer.identification.shaft_tests import (
    SpinDown,
    analyse_spin,
    spin_fault,
)

CURVES = ("u_d_V", "u_q_V", "psi_d_Vs", "psi_q_Vs")


def parameter(found: Identification, key: str) -> Parameter:
    one = found.of(key)
    assert one is not None
    return one


def sweeps(folder: Path, data: Path, *directions: str, pole_pairs: int = 3) -> Identification:
    """The offset sweeps of the HDM06-005 in some directions."""
    runs = ""
    for direction in directions:
        names = [f"hdm06-005_{direction}1000rpm_{curve}.csv" for curve in CURVES]
        for name in names:
            shutil.copy(data / "bench/ultrazohm" / name, folder / name)
        speed = 1000 if direction == "plus" else -1000
        runs += f"""
- name: {direction}
  kind: offset-sweep
  files: [{", ".join(names)}]
  columns:
    encoder_offset: {{column: encoder_offset_rad_el, unit: rad}}
    u_d: u_d
    u_q: u_q
    psi_d: psi_d
    psi_q: psi_q
    speed: {{value: {speed} rpm}}
  voltage: reference"""
    path = folder / "bench.yaml"
    path.write_text(bench_text(runs, f"pole_pairs: {pole_pairs}"))
    return identify(read_bench(path))


def test_offset_of_a_driven_machine_from_both_directions(tmp_path: Path, shared_data: Path) -> None:
    found = sweeps(tmp_path, shared_data, "plus", "minus")
    assert 16.9e-3 < parameter(found, "magnet_flux").value < 17.0e-3
    offset = parameter(found, "encoder_offset")
    assert offset.value == pytest.approx(-0.546, abs=2e-3)
    assert offset.status == "identified"
    turn = parameter(found, "voltage_turn")
    assert math.degrees(turn.value) == pytest.approx(3.39, abs=0.05)
    told = " ".join(found.remarks)
    assert "gives 2.996" in told
    assert "differs by 0.5" in told


def test_one_direction_holds_no_offset(tmp_path: Path, shared_data: Path) -> None:
    offset = parameter(sweeps(tmp_path, shared_data, "plus"), "encoder_offset")
    assert offset.status == "not identified"
    assert "one direction of rotation" in offset.why


def test_a_wrong_number_of_pole_pairs_contradicts(tmp_path: Path, shared_data: Path) -> None:
    found = sweeps(tmp_path, shared_data, "plus", pole_pairs=4)
    assert "gives 2.996" in found.contradictions[0]
    assert "not 4" in found.contradictions[0]


def test_speed_per_volt_drifts_from_run_to_run(tmp_path: Path, shared_data: Path) -> None:
    runs = ""
    for number in (1, 2, 3):
        shutil.copy(shared_data / f"bench/labmrd/step{number}.csv", tmp_path)
        runs += f"""
- name: step {number}
  kind: voltage-speed
  file: step{number}.csv
  columns:
    time: {{column: column 1, unit: s, scale: 1.25e-4}}
    voltage: column 2
    speed: column 4
  voltage: reference"""
    (tmp_path / "bench.yaml").write_text(bench_text(runs, "pole_pairs: 1"))
    found = identify(read_bench(tmp_path / "bench.yaml"))
    gain = parameter(found, "speed_per_volt")
    assert gain.value == pytest.approx(113.7, abs=0.05)
    assert gain.low < 113.65
    assert gain.high > 113.73
    assert any("+0.06 %, rising all the way" in text for text in found.remarks)
    for key in ("time_constant", "friction_voltage"):
        assert parameter(found, key).status == "not identified"


BURST = """
- name: burst
  kind: locked-torque
  file: burst.json
  format: motortest
  currents: measured
"""


def burst(folder: Path, data: Path, gain: float) -> Identification:
    """The torque burst of the V2207 with a torque sensor whose gain has changed."""
    log = json.loads((data / "bench/motorTest/V2207_1500KV_results_cd37f24.json").read_text())
    rng = np.random.default_rng(1)
    for row in log["torque_burst_test"]["data"]:
        row["measured_torque_Nm"] = gain * row["measured_torque_Nm"] + rng.normal(0.0, 1e-4)
    (folder / "burst.json").write_text(json.dumps(log))
    (folder / "bench.yaml").write_text(bench_text(BURST, "pole_pairs: 7"))
    return identify(read_bench(folder / "bench.yaml"))


def test_torque_per_ampere_against_the_kv(tmp_path: Path, shared_data: Path) -> None:
    found = burst(tmp_path, shared_data, 1.0)
    constant = parameter(found, "torque_constant")
    assert constant.value == pytest.approx(6.00e-3, abs=0.02e-3)
    assert constant.status == "identified"
    assert any(re.search(r"8\.[678] % above 0.005513", text) for text in found.remarks)


def test_a_dead_torque_sensor_is_refused(tmp_path: Path, shared_data: Path) -> None:
    with pytest.raises(NoSolutionError, match="the torque sensor does not answer"):
        burst(tmp_path, shared_data, 0.0)


def test_a_torque_constant_that_is_a_tenth_contradicts(tmp_path: Path, shared_data: Path) -> None:
    found = burst(tmp_path, shared_data, 0.1)
    assert "two routes differ by a factor of 9.1" in found.contradictions[0]
    assert parameter(found, "torque_constant").status == "not identified"


def coasting(seed: int, fan: float = 0.0) -> SpinDown:
    """A rotor of 0.85 kg m^2 with the friction of the notes, over eight minutes at 5 Hz."""
    time = np.arange(0.0, 480.0, 0.2)
    speed = np.empty(time.size)
    now = 60.0
    for place in range(time.size):
        speed[place] = now
        now -= 0.2 * (0.041 + 1.45e-3 * now + fan * now**2) / 0.8489
    rng = np.random.default_rng(seed)
    return SpinDown("coast", time, speed + slow_noise(rng, time.size, 0.97, 0.05))


def test_friction_of_a_coasting_rotor() -> None:
    held = {"coulomb_friction": 0, "friction": 0}
    truth = {"coulomb_friction": 0.041, "friction": 1.45e-3}
    for seed in range(30):
        analysis = analyse_spin(coasting(seed), 0.8489)
        for key, value in truth.items():
            one = analysis.of(key)
            assert one is not None
            assert one.value == pytest.approx(value, rel=0.03)
            held[key] += one.low <= value <= one.high
    assert min(held.values()) >= 26


def test_friction_that_falls_with_the_square_of_the_speed_is_none() -> None:
    analysis = analyse_spin(coasting(3, fan=-8e-6), 0.8489)
    fan = analysis.of("fan_friction")
    assert fan is not None
    assert fan.status == "not identified"
    assert "not physical" in fan.why
    assert any("comes out negative" in text for text in analysis.remarks)


def test_what_is_no_coasting() -> None:
    time = np.arange(20.0)
    assert "falls by 4 %" in spin_fault(SpinDown("run", time, 500.0 - time))
    assert "does not coast" in spin_fault(SpinDown("run", time, np.full(20, 5.0)))
    assert "do not rise" in spin_fault(SpinDown("run", np.zeros(20), 20.0 - time))


def test_a_spin_down_without_an_inertia_has_its_place(tmp_path: Path) -> None:
    write_table(tmp_path / "log.csv", {"t [s]": np.arange(9.0), "w [rad/s]": 9.0 - np.arange(9.0)})
    run = """
- name: coast
  kind: spin-down
  file: log.csv
  columns: {time: t, speed: w}
"""
    path = tmp_path / "bench.yaml"
    path.write_text(bench_text(run, "pole_pairs: 1\ninertia: 0.01 kg m^2"))
    assert parameter(identify(read_bench(path)), "coulomb_friction").value == pytest.approx(
        0.01, rel=1e-6
    )
