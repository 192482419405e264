"""Driven, locked and free shafts: real logs, and machines whose truth is known."""

from __future__ import annotations

import json
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bench_files import bench_text, slow_noise, write_table

from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.identification.identify import Identification, identify
from dqforge.optimizer.identification.parameters import Parameter
from dqforge.optimizer.identification.shaft_tests import (
    Bursts,
    OffsetCurve,
    OffsetSweep,
    SpinDown,
    SpinUp,
    VoltageSteps,
    analyse_bursts,
    analyse_offsets,
    analyse_spin,
    analyse_spin_up,
    analyse_steps,
    bursts_fault,
    captured,
    offset_fault,
    spin_fault,
    spin_up_fault,
    steps_fault,
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


def offset_sweep(omega_m: float, seed: int, turn: float = 0.05, rows: int = 90) -> OffsetSweep:
    """Four curves of psi_pm = 0.07 Wb and 3 pole pairs, offset 2.9 rad, with white noise."""
    rng, x = np.random.default_rng(seed), np.linspace(0.0, 2.0 * math.pi, rows)
    rng.shuffle(x)
    psi = 0.07 * np.exp(1j * (x - 2.9 - turn * np.sign(omega_m)))
    u = 3j * omega_m * psi
    curves = {"psi_d": psi.real, "psi_q": psi.imag, "u_d": u.real, "u_q": u.imag}
    return OffsetSweep(
        "sweep",
        omega_m,
        tuple(
            OffsetCurve(name, x, y + 0.01 * np.ptp(y) * rng.standard_normal(rows) + 0.1)
            for name, y in curves.items()
        ),
    )


def test_offset_turn_and_flux_of_simulated_sweeps_scatter_by_their_sigmas() -> None:
    truth = {"magnet_flux": 0.07, "encoder_offset": 2.9, "voltage_turn": -0.05}
    away: dict[str, list[float]] = {key: [] for key in truth}
    # Amplitude and phase of a circle of n rows: noise sqrt(2/n), over the amplitude; of both
    # curves of the voltage, both directions and, of the phase, both quantities.
    share = 0.02 * math.sqrt(2.0 / 90.0)
    expected = {
        "magnet_flux": 0.07 * share / 2.0,
        "encoder_offset": share / math.sqrt(8.0),
        "voltage_turn": share / math.sqrt(8.0),
    }
    for seed in range(30):
        pair = offset_sweep(100.0, 2 * seed), offset_sweep(-140.0, 2 * seed + 1)
        analysis = analyse_offsets(pair, 3, None)
        for key, value in truth.items():
            one = analysis.of(key)
            assert one is not None
            assert expected[key] * 0.6 < one.sigma < expected[key] * 3.5
            away[key].append((one.value - value) / expected[key])
        assert not analysis.contradictions
        assert sum("gives 3.0" in text or "gives 2.9" in text for text in analysis.remarks) == 2
        assert "at 1146 rpm" in " ".join(analysis.remarks)
    for found in away.values():
        assert abs(np.mean(found)) < 0.6
        assert np.std(found) == pytest.approx(1.0, rel=0.45)
    told = analyse_offsets(pair, 4, None).contradictions
    assert len(told) == 2
    assert all("not 4" in text for text in told)
    assert offset_fault(pair[0]) == ""
    assert "circle needs" in offset_fault(offset_sweep(100.0, 1, rows=7))


def test_what_no_offset_sweep_and_no_burst_shows() -> None:
    sweep = offset_sweep(-140.0, 4)
    assert "stands still" in offset_fault(replace(sweep, omega_m=0.0))
    flat = replace(sweep.curves[2], values=np.full(90, 3.0))
    assert "u_d is the same at all" in offset_fault(replace(sweep, curves=(sweep.curves[0], flat)))
    for share, text in ((0.7, "over 252 deg"), (0.76, "")):
        narrow = replace(sweep.curves[1], offset=share * sweep.curves[1].offset)
        said = offset_fault(replace(sweep, curves=(narrow,)))
        assert text in said
        assert bool(text) == bool(said)
    rows = np.zeros(50)
    assert "no burst" in bursts_fault(Bursts("bursts", np.arange(50.0), rows, rows))
    begun = Bursts("bursts", np.arange(50.0), np.where(rows == 0.0, 5.0, 0.0), rows)
    assert "rows without current before" in bursts_fault(begun)
    assert "do not rise" in spin_up_fault(
        SpinUp("up", np.arange(9.0)[::-1], np.ones(9), 10.0 * np.arange(9.0))
    )


@pytest.mark.parametrize(
    ("known", "against"), [(None, None), (0.0102, False), (0.0102 * math.sqrt(3.0), True)]
)
def test_a_capture_is_a_flux_linkage_with_its_own_interval(
    known: float | None, against: bool | None
) -> None:
    uncertainty = np.array([[2e-5, 9e-3], [5e-5, 1e-3], [1e-5, 0.0]])
    capture: Any = SimpleNamespace(
        psi_pm=0.01, amplitude_uncertainty=uncertainty, findings=("a spike",), orders=np.arange(7)
    )
    found = captured("log", capture, None if known is None else (known, "the sheet"))
    flux = found.of("magnet_flux")
    assert flux is not None
    assert (flux.low, flux.value, flux.high) == pytest.approx((0.00995, 0.01, 0.01005))
    assert flux.sigma == pytest.approx(5e-5 / 1.959964, rel=1e-5)
    assert found.covariance[0, 0] == pytest.approx(flux.sigma**2)
    assert found.terms == ("7 harmonics",)
    assert found.remarks[0] == "log: a spike"
    assert len(found.remarks) == (2 if against is False else 1)
    assert len(found.contradictions) == (1 if against else 0)
    assert all("the sheet" in text for text in (*found.remarks[1:], *found.contradictions))


@pytest.mark.parametrize("lag", [0.03, 0.1])
def test_speed_per_volt_is_that_of_the_settled_rows(lag: float) -> None:
    """A speed that settles by a first order: rows from eight times its half time on."""
    time = np.arange(0.0, 12.0, 0.01)
    voltage = np.select([time < 3.0, time < 6.0, time < 9.0], [2.0, 4.0, -3.0], 0.0)
    omega = np.zeros(time.size)
    for k in range(1, time.size):
        omega[k] = omega[k - 1] + (1.0 - math.exp(-0.01 / lag)) * (30.0 * voltage[k] - omega[k - 1])
    steps = VoltageSteps("steps", time, voltage, omega)
    assert steps_fault(steps) == ""
    analysis = analyse_steps([steps])
    rows = 8 * math.ceil(lag * math.log(2.0) / 0.01)
    assert analysis.residuals[0].rows == pytest.approx(3 * (300 - rows), abs=3)
    gain = analysis.of("speed_per_volt")
    assert gain is not None
    assert gain.value == pytest.approx(30.0, rel=3e-3)
    other = VoltageSteps("later", time, voltage, np.asarray(1.02 * omega, dtype=np.float64))
    both = analyse_steps([steps, other])
    gain = both.of("speed_per_volt")
    assert gain is not None
    assert gain.value == pytest.approx(30.3, rel=3e-3)
    assert gain.sigma == pytest.approx(0.3, rel=0.01)
    assert both.covariance[0, 0] == pytest.approx(gain.sigma**2)
    assert "changes by +2.00 %, rising all the way" in both.remarks[0]
    assert "not evaluated from steady speeds" in analysis.parameters[2].why
    moving = VoltageSteps("moving", time, np.where(np.arange(time.size) % 2, 2.0, 1.0), omega)
    assert "hold each level longer" in steps_fault(moving)


def test_torque_per_ampere_of_simulated_bursts() -> None:
    rng, time = np.random.default_rng(3), np.arange(0.0, 4.0, 1e-3)
    on = (time % 1.0 > 0.6) & (time > 1.0)
    current = np.where(on, 5.0, 0.0) + 0.01 * rng.standard_normal(time.size)
    torque = np.where(on, 0.4, 0.0) + 0.02 + 2e-3 * rng.standard_normal(time.size)
    bursts = Bursts("bursts", time, current, torque)
    assert bursts_fault(bursts) == ""
    analysis = analyse_bursts(bursts, 4, (0.08 / 6.0, "the design"))
    found = analysis.of("torque_constant")
    assert found is not None
    assert found.value == pytest.approx(0.08, rel=1e-3)
    # White noise: of the rows with and of those without current; three bursts of 399 rows without
    # a tenth at both ends, and the rows before the first by a fifth of it.
    with_current, without = 3 * 0.8 * 399, 1600 - 0.2 * 399
    expected = 2e-3 * math.sqrt(1.0 / with_current + 1.0 / without) / 5.0
    assert found.sigma == pytest.approx(expected, rel=0.4)
    (left,) = analysis.residuals
    assert left.rows == pytest.approx(with_current, rel=0.02)
    assert left.rms == pytest.approx(2e-3, rel=0.1)
    assert "400 mN m at 5 A, less 20 mN m" in analysis.remarks[0]
    assert analysis.contradictions == ()
    assert analyse_bursts(bursts, 4, (0.016, "the design")).contradictions
    quiet = Bursts("bursts", time, current, 0.02 + 2e-3 * rng.standard_normal(time.size))
    assert "does not answer" in bursts_fault(quiet)


def spin_up(torque: float, seed: int, begin: float = 0.0) -> SpinUp:
    """J = 2e-3 kg m^2, k_t = 0.5 N m/A, T_c = 0.05 N m, b = 1e-3 N m s/rad, exactly."""
    rng, time = np.random.default_rng(seed), np.linspace(0.0, 1.0, 400)
    final, lag = (torque - 0.05) / 1e-3, 2.0
    speed = final + (begin - final) * np.exp(-time / lag)
    noisy = speed + 0.02 * rng.standard_normal(time.size)
    return SpinUp("up" if torque else "down", time, np.full(time.size, torque / 0.5), noisy)


def test_inertia_and_friction_of_an_acceleration_and_of_coasting() -> None:
    truth = {"inertia": 2e-3, "coulomb_friction": 0.05, "friction": 1e-3}
    analysis = analyse_spin_up([spin_up(0.2, 1), spin_up(0.0, 2, 55.0)], 0.5, 0.0)
    for key, value in truth.items():
        one = analysis.of(key)
        assert one is not None
        assert one.value == pytest.approx(value, rel=0.02)
        assert one.low <= value <= one.high
    unsure = analyse_spin_up([spin_up(0.2, 1), spin_up(0.0, 2, 55.0)], 0.5, 0.03)
    first, second = analysis.parameters, unsure.parameters
    for sure, other in zip(first, second, strict=True):
        assert other.sigma == pytest.approx(math.hypot(sure.sigma, 0.03 * sure.value), rel=1e-6)
    shifted = np.outer([one.value for one in first], [one.value for one in first])
    np.testing.assert_allclose(unsure.covariance, analysis.covariance + 9e-4 * shifted, rtol=1e-9)
    assert [left.rows for left in analysis.residuals] == [400, 400]
    assert all(left.rms == pytest.approx(2e-3 * 0.02, rel=0.2) for left in analysis.residuals)
    alone = analyse_spin_up([spin_up(0.2, 1)], 0.5, 0.0)
    assert alone.parameters[1].status == "not identified"
    assert spin_up_fault(spin_up(0.2, 1)) == ""
    assert "coasting is a run" in spin_up_fault(spin_up(0.0, 1, 55.0))
    assert "does not change" in spin_up_fault(
        SpinUp("up", np.arange(9.0), np.ones(9), 100.0 + np.arange(9.0))
    )
