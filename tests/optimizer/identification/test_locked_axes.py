"""Steps, pulses and sines on a locked rotor, an acceleration and a capture, of known machines."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bench_files import bench_text, write_table
from scipy.integrate import solve_ivp

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.identification.identify import Identification, identify
from dqforge.optimizer.identification.locked_axes import (
    _NOISES,
    LockedAxes,
    _Filter,
    _Fit,
    _simulation,
    _terms,
    _white,
    _whitened,
    analyse_locked,
    locked_fault,
)
from dqforge.optimizer.identification.parameters import Analysis, Parameter
from dqforge.reports.identification import design_of

TRUTH = {
    "resistance": 0.5,
    "inductance_d": 2e-3,
    "inductance_q": 3e-3,
    "inverter_voltage": 0.8,
}
STEP = 2e-4
LEVELS = np.array([0.0, 2.0, 4.0, 6.0, 3.0, -3.0, -6.0, -2.0, 5.0, 1.5])


def steps(rows: int) -> FloatArray:
    return np.repeat(LEVELS, rows // LEVELS.size)


def locked(
    seed: int,
    axes: str = "dq",
    *,
    rows: int = 800,
    late: float = 1.5,
    bend: float = 0.0,
    measured: float = 0.0,
    voltage: FloatArray | None = None,
    parts: int = 8,
) -> LockedAxes:
    """A winding whose voltage comes ``late`` rows after its reference, with 20 mA of noise.

    Each part of a row is solved exactly but for the inverter's error, taken in its middle.
    """
    u = np.asarray(steps(rows) if voltage is None else voltage, dtype=np.float64)
    rng = np.random.default_rng(seed)
    h, r = STEP / parts, TRUTH["resistance"]
    current = {axis: np.zeros(u.size) for axis in axes}
    now = dict.fromkeys(axes, 0.0)
    for k in range(u.size):
        for axis in axes:
            current[axis][k] = now[axis]
        for part in range(parts):
            fed = u[max((k * parts + part - round(late * parts)) // parts, 0)]
            middle = dict(now)
            for share, base in ((0.5, now), (1.0, now)):
                size = math.hypot(0.1, *middle.values())
                after = {}
                for axis in axes:
                    own = TRUTH[f"inductance_{axis}"] + 2.0 * bend * middle[axis]
                    kept = math.exp(-share * h * r / own)
                    drop = TRUTH["inverter_voltage"] * middle[axis] / size if not measured else 0.0
                    after[axis] = kept * base[axis] + (1.0 - kept) / r * (fed - drop)
                middle = after
            now = middle
    noisy = {axis: values + rng.normal(0.0, 0.02, u.size) for axis, values in current.items()}
    said = {axis: np.asarray(u + rng.normal(0.0, measured, u.size)) for axis in axes}
    return LockedAxes("steps", np.asarray(STEP * np.arange(u.size)), noisy, said)


def of(analysis: Analysis | Identification, key: str) -> Parameter:
    found = analysis.of(key)
    assert found is not None
    return found


def test_steps_of_both_axes_hold_all() -> None:
    analysis = analyse_locked(locked(1), {}, reference=True)
    for key, truth in TRUTH.items():
        one = of(analysis, key)
        assert one.status == "identified"
        assert one.value == pytest.approx(truth, rel=0.01)
        assert abs(one.value - truth) < 2.5 * (one.high - one.value)
    late = float(analysis.remarks[0].split("comes ")[1].split(" us")[0])
    assert late == pytest.approx(300.0, abs=5.0)
    assert "delay of the voltage" in analysis.terms


@pytest.mark.slow
def test_intervals_hold_the_truth() -> None:
    """Of 60 logs each, of references and of voltages that are measured with noise of up to 5 %."""
    for measured in (0.0, 0.1, 0.3):
        hits: Counter[str] = Counter()
        for seed in range(60):
            rows = locked(seed, late=seed % 5 / 2.0, measured=measured)
            analysis = analyse_locked(rows, {}, reference=not measured)
            for one in analysis.parameters:
                hits[one.key] += one.low <= TRUTH[one.key] <= one.high
        assert min(hits.values()) >= 52, hits


def test_one_axis_says_nothing_of_the_other() -> None:
    analysis = analyse_locked(locked(2, "q", rows=400), {}, reference=True)
    assert of(analysis, "inductance_q").value == pytest.approx(3e-3, rel=0.01)
    assert of(analysis, "inductance_d").why == "no voltage on the d axis"


def test_a_quiet_axis_is_left_out() -> None:
    rows = locked(3, "d", rows=400)
    quiet = np.random.default_rng(0).normal(0.0, 0.02, rows.time.size)
    both = replace(
        rows,
        currents={**rows.currents, "q": quiet},
        voltages={**rows.voltages, "q": 0.0 * quiet},
    )
    analysis = analyse_locked(both, {}, reference=True)
    assert "i_q hardly moves" in analysis.remarks[0]
    assert of(analysis, "inductance_d").value == pytest.approx(2e-3, rel=0.01)


def test_one_sine_cannot_tell_a_delay() -> None:
    sine = 3.0 + 5.0 * np.sin(2.0 * np.pi * 50.0 * STEP * np.arange(800))
    analysis = analyse_locked(locked(4, "d", voltage=sine), {}, reference=True)
    for key in ("resistance", "inductance_d"):
        assert of(analysis, key).status == "not identified"
        assert "one frequency" in of(analysis, key).why


def test_an_inductance_that_falls_is_told() -> None:
    analysis = analyse_locked(locked(5, "d", bend=-3e-5), {}, reference=True)
    assert of(analysis, "inductance_d").value == pytest.approx(2e-3, rel=0.01)
    (told,) = [text for text in analysis.remarks if "inductance of small changes" in text]
    at = float(told.split(" mH at ")[1].split(" A")[0])
    there = float(told.split("current and ")[1].split(" mH")[0])
    assert there == pytest.approx(2.0 - 0.06 * at, rel=0.03)


def test_rows_at_uneven_times() -> None:
    rows = locked(6, "d", rows=800)
    kept = np.ones(rows.time.size, dtype=bool)
    kept[np.random.default_rng(1).choice(np.arange(1, 799), 30, replace=False)] = False
    some = LockedAxes(
        "steps",
        rows.time[kept],
        {"d": rows.currents["d"][kept]},
        {"d": rows.voltages["d"][kept]},
    )
    analysis = analyse_locked(some, {}, reference=True)
    assert of(analysis, "inductance_d").value == pytest.approx(2e-3, rel=0.03)


def test_what_no_locked_rotor_shows() -> None:
    rows = locked(7, "d", rows=40)
    still = replace(rows, voltages={"d": np.full(40, 2.0)})
    assert "no step, pulse or sine" in locked_fault(still)
    assert "needs 20" in locked_fault(
        LockedAxes(
            "run",
            rows.time[:9],
            {"d": rows.currents["d"][:9]},
            {"d": rows.voltages["d"][:9]},
        )
    )
    assert "no axis has" in locked_fault(replace(rows, currents={}))
    assert "do not rise" in locked_fault(replace(rows, time=rows.time[::-1].copy()))
    assert "i_d stands still" in locked_fault(replace(rows, currents={"d": np.full(40, 2.0)}))
    assert locked_fault(rows) == ""


# Its parts against their definitions.


def test_the_filter_is_that_of_its_differential_equation() -> None:
    """T_f y' = x - y from 0, of values that are held, and of lines between them."""
    step, slow, rng = 2e-4, 7e-4, np.random.default_rng(1)
    x, f, own = rng.normal(1.0, 1.0, 12), _Filter(7e-4, 2e-4), np.linspace(0.0, 2e-4, 4001)
    held, straight = [0.0], [0.0]
    for before, now in pairwise(x):
        weight = np.exp(-(step - own) / slow) / slow
        line = before + (now - before) * own / step
        kept = math.exp(-step / slow)
        held.append(kept * held[-1] + before * float(np.trapezoid(weight, own)))
        straight.append(kept * straight[-1] + float(np.trapezoid(weight * line, own)))
    assert f.held(x) == pytest.approx(np.array(held), abs=1e-6)
    assert f.straight(x) == pytest.approx(np.array(straight), abs=1e-6)
    assert f.slope(x) == pytest.approx((x - np.array(straight)) / slow, rel=1e-5)


def test_the_simulated_current_is_that_of_the_equation_and_its_slopes_are_differences() -> None:
    rows, rng = locked(1, rows=20), np.random.default_rng(2)
    rows = replace(rows, voltages={axis: rng.normal(0.0, 4.0, 20) for axis in "dq"})
    terms = _terms(rows, reference=True)
    value = {
        "resistance": 0.5, "inductance_d": 2e-3, "inductance_q": 3e-3, "start_d": 0.4,
        "start_q": -0.7, "inverter_voltage": 0.8, "turning": 0.3, "delay": 0.35,
        "offset_d": 0.2, "offset_q": -0.1, "square_d": -4e-5, "square_q": 3e-5,
        "cube_d": 6e-6, "cube_q": -5e-6,
    }  # fmt: skip
    at = np.array([value[term] for term in terms])
    run = _simulation(rows, terms, 1)
    found, turns = run(at)

    def slope(_: float, i: FloatArray, u: FloatArray) -> list[float]:
        size = math.sqrt(float(i @ i) + value["turning"] ** 2)
        return [
            (u[k] - value["resistance"] * x - value["inverter_voltage"] * x / size
             - value[f"offset_{axis}"])
            / (value[f"inductance_{axis}"] + 2.0 * value[f"square_{axis}"] * x
               + 3.0 * value[f"cube_{axis}"] * x**2)
            for k, (axis, x) in enumerate(zip("dq", i, strict=True))
        ]  # fmt: skip

    state, expected = np.array([0.4, -0.7]), []
    for row in range(20):
        expected.append(state)
        # the voltage of the row before, and from the delay on that one
        for earlier, share in ((2, value["delay"]), (1, 1.0 - value["delay"])):
            fed = np.array([rows.voltages[axis][max(row - earlier, 0)] for axis in "dq"])
            ends = solve_ivp(slope, (0.0, share * STEP), state, args=(fed,), rtol=1e-10, atol=1e-12)
            state = ends.y[:, -1]
    np.testing.assert_allclose(found.reshape(2, 20).T, expected, atol=1e-5)  # of Runge and Kutta
    for place, x in enumerate(at):
        ahead, back = at.copy(), at.copy()
        ahead[place], back[place] = x + 1e-5 * abs(x), x - 1e-5 * abs(x)
        differences = (run(ahead)[0] - run(back)[0]) / (2e-5 * abs(x))
        assert turns[:, place] == pytest.approx(differences, rel=1e-4, abs=1e-6)
    far = at.copy()
    far[terms.index("resistance")] = -1e4
    assert np.all(run(far)[0] == 1e3 * rows.size.max())


@pytest.mark.parametrize(("kept", "noise"), [(0.9, 3.0), (0.6, 0.2), (0.95, 0.0)])
def test_what_is_white_is_so_by_the_factor_of_the_whole_covariance(
    kept: float, noise: float
) -> None:
    """What stays of a noise of the voltage, beside a white one of the current."""
    count = 220
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    slow = (1.0 - kept) ** 2 * noise / (1.0 - kept**2) * kept**apart
    factor = np.linalg.cholesky(slow + np.eye(count))
    values = np.random.default_rng(3).normal(0.0, 1.0, (count, 2))
    white, spread = _white(values, kept, noise)
    assert spread == pytest.approx(factor[-1, -1], rel=1e-6)
    expected = np.linalg.solve(factor, values)
    assert white[-40:] == pytest.approx(expected[-40:], abs=1e-5)


def test_the_likeliest_noise_of_the_voltage_is_that_of_the_restricted_likelihood() -> None:
    rng, count, rows = np.random.default_rng(5), 160, locked(1, "d", rows=160)
    kept, truth = math.exp(-0.5 * STEP / 2e-3), 300.0
    x = np.zeros(count)
    for k in range(1, count):
        x[k] = kept * x[k - 1] + (1.0 - kept) * math.sqrt(truth) * rng.normal()
    columns = np.column_stack([np.ones(count), rows.voltages["d"], np.arange(count) / count])
    aim = columns @ np.array([0.3, 0.2, -1.0]) + x + rng.normal(0.0, 1.0, count)
    found = _Fit(
        ["resistance", "inductance_d", "delay"], np.array([0.5, 2e-3, 0.5]), columns, aim,
        np.zeros(count, dtype=np.intp), 0, STEP, reference=False,
    )  # fmt: skip
    white, noise = _whitened(np.column_stack([columns, aim]), found)
    apart = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))

    def unlikely(each: float) -> float:
        slow = (1.0 - kept) ** 2 * each / (1.0 - kept**2) * kept**apart
        own = np.linalg.inv(slow + np.eye(count))
        inner = columns.T @ own @ columns
        left = aim - columns @ np.linalg.solve(inner, columns.T @ own @ aim)
        free = count - columns.shape[1]
        dets = np.linalg.slogdet(inner)[1] - np.linalg.slogdet(own)[1]
        return float(dets + free * math.log(left @ own @ left))

    assert noise == min(_NOISES, key=unlikely)
    assert white == pytest.approx(_white(np.column_stack([columns, aim]), kept, noise)[0])


def test_voltages_that_are_measured_with_noise_are_no_reference() -> None:
    analysis = analyse_locked(locked(9, "d", rows=600, measured=0.3), {}, reference=False)
    for key in ("resistance", "inductance_d"):
        one = of(analysis, key)
        assert one.low <= TRUTH[key] <= one.high
        assert one.value == pytest.approx(TRUTH[key], rel=0.03)
    assert all(one.key != "inverter_voltage" for one in analysis.parameters)


# From files: a locked rotor, a capture, an acceleration and coasting make a design.


def test_a_bench_without_a_load_machine_makes_a_design(tmp_path: Path) -> None:
    """What a bare bench can do; inertia and friction come from the runs alone."""
    rng = np.random.default_rng(0)
    inertia, dry, viscous, flux, pairs = 2e-4, 0.02, 1e-4, 0.01, 4
    rows = locked(8)
    write_table(
        tmp_path / "locked.csv",
        {
            "t [s]": rows.time,
            **{f"i{axis} [A]": rows.currents[axis] for axis in "dq"},
            **{f"u{axis} [V]": rows.voltages[axis] for axis in "dq"},
        },
    )
    time = np.arange(0.0, 1.0, 1e-3)
    speed, accelerated = np.zeros(time.size), 3.0 + 0.5 * np.sin(40.0 * time)
    for k in range(time.size - 1):
        torque = 1.5 * pairs * flux * accelerated[k] - dry - viscous * speed[k]
        speed[k + 1] = speed[k] + 1e-3 * torque / inertia
    top = speed[-1]
    noise = rng.normal(0.0, 0.3, (2, time.size))
    write_table(
        tmp_path / "up.csv",
        {"t [s]": time, "iq [A]": accelerated, "w [rad/s]": speed + noise[0]},
    )
    coast = 3.0 * time
    falling = (top + dry / viscous) * np.exp(-coast * viscous / inertia) - dry / viscous
    turning = falling > 0.0
    write_table(
        tmp_path / "down.csv",
        {"t [s]": coast[turning], "w [rad/s]": (falling + noise[1])[turning]},
    )
    omega = 4 * 100.0
    short = np.arange(0.0, 0.2, 1e-4)
    voltage = math.sqrt(3.0) * omega * flux * np.cos(omega * short)
    write_table(
        tmp_path / "capture.csv",
        {"t [s]": short, "u [V]": voltage + rng.normal(0.0, 0.02, short.size)},
    )
    runs = """
- name: coast
  kind: spin-down
  file: down.csv
  columns: {time: t, speed: w}
- name: accelerate
  kind: spin-up
  file: up.csv
  columns: {time: t, i_q: iq, speed: w}
  currents: measured
- name: locked
  kind: locked-voltage
  file: locked.csv
  columns: {time: t, i_d: id, u_d: ud, i_q: iq, u_q: uq}
  currents: measured
  voltage: reference
- name: terminals
  kind: back-emf
  file: capture.csv
  columns: {time: t, line_voltage: u, speed: {value: 100 rad/s}}
  voltage: measured
"""
    path = tmp_path / "bench.yaml"
    machine = "pole_pairs: 4\nmax_current: 10 A"
    path.write_text(bench_text(runs, machine, "{v_dc: 24 V, switching_frequency: 20 kHz}"))
    found = identify(read_bench(path))
    assert of(found, "magnet_flux").value == pytest.approx(flux, rel=2e-3)
    assert of(found, "inertia").value == pytest.approx(inertia, rel=0.02)
    assert of(found, "friction").value == pytest.approx(viscous, rel=0.1)
    assert of(found, "coulomb_friction").value == pytest.approx(dry, rel=0.05)
    for key in ("resistance", "inductance_d", "inductance_q"):
        assert of(found, key).value == pytest.approx(TRUTH[key], rel=0.01)
    text, lacking = design_of(found)
    assert lacking == ""
    assert text is not None
    assert b"inertia:" in text
    assert b"friction:" in text
    path.write_text(bench_text(runs.split("- name: terminals", maxsplit=1)[0], machine))
    with pytest.raises(NoSolutionError, match="its torque needs the magnet flux linkage"):
        identify(read_bench(path))
