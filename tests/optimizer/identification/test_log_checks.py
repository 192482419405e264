"""Each pitfall of a log, planted into one that is sound, is named; the sound one names none."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from bench_files import bench_text, slow_noise, write_table

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_file import LoggedRun, LogPart
from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.errors import DqforgeError
from dqforge.optimizer.identification.identify import Identification, identify
from dqforge.optimizer.identification.log_checks import (
    Fitted,
    _balance,
    _Powers,
    at_limit,
    log_findings,
    requested,
    step_of,
)
from dqforge.optimizer.identification.voltage_terms import SteadyRows, analyse_rows

Log = dict[str, FloatArray]

POLE_PAIRS, RESISTANCE, FLUX, L_D, L_Q, V_0 = 5, 0.08, 0.03, 0.2e-3, 0.35e-3, 0.3
ROWS, V_DC = 900, 90.0
UNITS = {
    "i_d": "A",
    "i_q": "A",
    "u_d": "V",
    "u_q": "V",
    "speed": "rad/s",
    "electrical_speed": "rad/s",
    "torque": "N m",
    "v_dc": "V",
    "duty": "",
}
RUN = """
- name: {name}
  kind: constant-speed
  file: {name}.csv
  columns: {{{columns}}}
  currents: measured
  voltage: reference
"""
SHEET = f"magnet_flux: {FLUX} Wb\nresistance: {RESISTANCE} Ohm"


def sound_log() -> Log:
    """A ride in four quadrants with dead time, friction, slow noise of voltages and torque."""
    rng = np.random.default_rng(3)
    speed = 120.0 * np.sin(np.linspace(0.0, 19.0, ROWS)) + slow_noise(rng, ROWS, 0.98, 20.0)
    i_q = slow_noise(rng, ROWS, 0.95, 25.0)
    i_d = -np.abs(slow_noise(rng, ROWS, 0.97, 12.0))
    size = np.hypot(i_d, i_q) + 0.5
    psi_d, psi_q, omega_e = FLUX + L_D * i_d, L_Q * i_q, POLE_PAIRS * speed
    friction = 0.05 * np.tanh(speed) + 2e-4 * speed
    return {
        "i_d": i_d,
        "i_q": i_q,
        "u_d": RESISTANCE * i_d - omega_e * psi_q + V_0 * i_d / size
        + slow_noise(rng, ROWS, 0.6, 0.03),
        "u_q": RESISTANCE * i_q + omega_e * psi_d + V_0 * i_q / size
        + slow_noise(rng, ROWS, 0.6, 0.03),
        "speed": speed,
        "electrical_speed": omega_e,
        "torque": 1.5 * POLE_PAIRS * (psi_d * i_q - psi_q * i_d) - friction
        + slow_noise(rng, ROWS, 0.6, 0.03),
    }  # fmt: skip


def said(folder: Path, log: Mapping[str, FloatArray], machine: str = SHEET) -> str:
    """All that is said of a log, by remarks, contradictions or a refusal."""
    titled = {f"{name} [{UNITS[name]}]" if UNITS[name] else name: log[name] for name in log}
    write_table(folder / "first ride.csv", titled)
    run = RUN.format(name="first ride", columns=", ".join(f"{name}: {name}" for name in log))
    path = folder / "bench.yaml"
    path.write_text(bench_text(run, f"pole_pairs: {POLE_PAIRS}\n{machine}"))
    try:
        found = identify(read_bench(path))
    except DqforgeError as error:
        return "\n".join(f"against: {one}" for one in (error, *error.others))
    against = (f"against: {text}" for text in found.contradictions)
    return "\n".join((*against, *found.remarks))


def scaled(factor: float, *names: str) -> Callable[[Log], Log]:
    return lambda log: log | {name: factor * log[name] for name in names}


def held(log: Log) -> Log:
    """The setpoints of a controller that moves them every 15 rows."""
    every = np.arange(ROWS) // 15 * 15
    return log | {"i_d": log["i_d"][every], "i_q": log["i_q"][every]}


def clipped(limit: float) -> Callable[[Log], Log]:
    def cut(log: Log) -> Log:
        size = np.hypot(log["u_d"], log["u_q"])
        share = np.minimum(1.0, limit / size)
        return log | {"u_d": share * log["u_d"], "u_q": share * log["u_q"]}

    return cut


def fed(log: Log) -> Log:
    return clipped(V_DC / 3.0**0.5 / 3.0)(log) | {"v_dc": np.full(ROWS, V_DC / 3.0)}


def full_duty(log: Log) -> Log:
    limit = 15.0
    duty = np.minimum(0.95, 0.95 * np.hypot(log["u_d"], log["u_q"]) / limit)
    return clipped(limit)(log) | {"duty": duty}


def one_way(log: Log) -> Log:
    kept = log["speed"] > 5.0
    return {name: values[kept] for name, values in log.items()}


def coarse(log: Log) -> Log:
    return log | {"u_q": 0.25 * np.round(log["u_q"] / 0.25)}


class Pitfall(NamedTuple):
    """What is done to the log, and pieces of the sentence that names it."""

    name: str
    planted: Callable[[Log], Log]
    expected: tuple[str, ...]
    machine: str = SHEET


PITFALLS = (
    Pitfall("currents 2/3", scaled(2 / 3, "i_d", "i_q"),
            ("first ride", "factor of 1.5", "columns i_d and i_q")),
    Pitfall("currents 2/3 by torque", scaled(2 / 3, "i_d", "i_q"),
            ("first ride: column torque is 1.5 times (near 3/2",), ""),
    Pitfall("voltages 1/2", scaled(0.5, "u_d", "u_q"),
            ("first ride", "(near 2", "columns u_d and u_q")),
    Pitfall("voltages sqrt 3", scaled(3.0**0.5, "u_d", "u_q"),
            ("first ride", "near sqrt(3)", "columns u_d and u_q")),
    Pitfall("voltages sqrt 3 by torque", scaled(3.0**0.5, "u_d", "u_q"),
            ("first ride: column torque is 0.577 times (near sqrt(3)",), ""),
    Pitfall("flux sqrt 3", dict,
            ("first ride", "near sqrt(3)", "column speed, machine.pole_pairs or the magnet"),
            f"magnet_flux: {3.0**0.5 * FLUX} Wb\nresistance: {RESISTANCE} Ohm"),
    Pitfall("requested currents", held,
            ("first ride: column i_q has the number of the row before in ", "requested current")),
    Pitfall("torque of zero", scaled(0.0, "torque"), ("column of torque holds 0",)),
    Pitfall("constant torque", lambda log: log | {"torque": np.full(ROWS, 1.2)},
            ("column of torque holds 1.2", "rows of first ride.csv")),
    Pitfall("noise for torque", lambda log: log | {"torque": log["torque"][::-1].copy()},
            ("first ride: column torque does not follow 1.5 p Im(conj(psi) i)", "900 rows")),
    Pitfall("negative torque", scaled(-1.0, "torque"),
            ("first ride: column torque has the other sign", "rows of first ride.csv (from row")),
    Pitfall("torque of a gear", scaled(1.3, "torque"),
            ("first ride: column torque is 1.3 times",)),
    Pitfall("zero of the torque sensor", lambda log: log | {"torque": log["torque"] + 3.0},
            ("first ride: power balance of motoring at ", "less than nothing", "from row")),
    Pitfall("torque lost", lambda log: log | {"torque": log["torque"] - 0.12 * log["speed"]},
            ("first ride: power balance of motoring at ", "lost outside the winding")),
    Pitfall("one direction", one_way, ("first ride: column speed has one direction",)),
    Pitfall("plateau of the voltage", clipped(15.0),
            ("first ride: |u| of u_d and u_q has one largest value, 15 V", "clipped, left out")),
    Pitfall("voltage at that of the DC link", fed,
            ("first ride: u_d and u_q stand at v_dc/sqrt(3)", "clipped, left out")),
    Pitfall("duty at its limit", full_duty, ("first ride: duty stands at its limit",)),
    Pitfall("pole pairs", scaled(7 / 5, "electrical_speed"),
            ("columns electrical_speed and speed have a ratio of 7, not 5 pole pairs",)),
    Pitfall("coarse voltage", coarse, ("first ride", "column u_q has steps of 0.25 V")),
)  # fmt: skip

# What leaves the rest of a log as it is.
REMARKS = {
    "requested currents", "one direction", "plateau of the voltage",
    "voltage at that of the DC link", "duty at its limit", "coarse voltage",
}  # fmt: skip


@pytest.mark.parametrize("pitfall", PITFALLS, ids=lambda pitfall: pitfall.name)
def test_a_pitfall_is_named(tmp_path: Path, pitfall: Pitfall) -> None:
    found = said(tmp_path, pitfall.planted(sound_log()), pitfall.machine)
    lines = [line for line in found.splitlines() if pitfall.expected[0] in line]
    lines = [line for line in lines if all(part in line for part in pitfall.expected)]
    assert lines, found
    against = any(line.startswith("against: ") for line in lines)
    assert against == (pitfall.name not in REMARKS), found


def test_a_sound_log_names_no_pitfall(tmp_path: Path) -> None:
    found = said(tmp_path, sound_log())
    for words in (
        "factor", "columns", "requested", "holds", "follow", "other sign", "times", "balance",
        "direction", "largest value", "stand", "ratio", "steps", "drift", "left out",
    ):  # fmt: skip
        assert words not in found, found
    assert "column torque is" in found


@pytest.mark.parametrize(("share", "named"), [(1.0, False), (0.985, True)])
def test_a_drift_between_repeats_is_named(tmp_path: Path, share: float, named: bool) -> None:
    """Magnets that warmed by 12 K from the first run to the second."""
    log, runs = sound_log(), []
    for place, name in enumerate(("cold", "warm")):
        part = {key: values[place::2] for key, values in log.items()}
        flux = share**place * FLUX - FLUX
        part["u_q"] = part["u_q"] + POLE_PAIRS * part["speed"] * flux
        columns = {key: part[key] for key in ("i_d", "i_q", "u_d", "u_q", "speed")}
        titles = {f"{key} [{UNITS[key]}]": values for key, values in columns.items()}
        write_table(tmp_path / f"{name}.csv", titles)
        runs.append(RUN.format(name=name, columns=", ".join(f"{key}: {key}" for key in columns)))
    path = tmp_path / "bench.yaml"
    path.write_text(bench_text("".join(runs), f"pole_pairs: {POLE_PAIRS}"))
    found = [text for text in identify(read_bench(path)).remarks if "drift" in text]
    assert bool(found) == named
    assert not named or found[0].startswith("warm: drift between repeats: magnet flux linkage")


def test_a_step_that_is_more_than_the_noise_widens_the_interval() -> None:
    """At points that are held, more rows do not average the rounding: of 20 benches the interval
    holds the truth in 18 or more.
    """
    step, held, points = 0.5, 40, 24
    inside = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        i_q = np.repeat(rng.uniform(-30.0, 30.0, points), held)
        omega_e = np.repeat(rng.uniform(-500.0, 500.0, points), held)
        u_q = RESISTANCE * i_q + omega_e * FLUX
        u_q = step * np.round((u_q + rng.normal(0.0, 0.01, u_q.size)) / step)
        series = np.zeros(u_q.size, dtype=np.intp)
        rows = SteadyRows(("run",), series, omega_e, i_q, u_q)
        found = analyse_rows(rows, {}, reference=False).of("resistance")
        assert found is not None
        inside += found.low <= RESISTANCE <= found.high
    assert inside >= 18


def test_rows_at_the_limit_are_not_absorbed(tmp_path: Path) -> None:
    """A clipped voltage would become a smaller flux linkage."""
    found = said(tmp_path, clipped(12.0)(sound_log()), f"magnet_flux: {FLUX} Wb")
    assert "within the interval" in found


def test_the_step_of_a_column() -> None:
    rng = np.random.default_rng(1)
    values = rng.normal(0.0, 1.0, 500)
    assert step_of(values) == 0.0
    assert step_of(np.round(values / 0.02) * 0.02) == pytest.approx(0.02)
    assert step_of(np.repeat([1.0, 2.0, 4.0], 50)) == 0.0


def held_points(seed: int, *, step: float = 0.0) -> Log:
    """30 points of 40 rows: the current reaches each within some rows, which the voltage leads."""
    rng = np.random.default_rng(seed)
    points, held = 30, 40
    settling = np.exp(-np.arange(held) / 3.0)
    log: dict[str, list[FloatArray]] = {name: [] for name in ("i_q", "u_q", "speed")}
    before = 0.0
    for point in range(points):
        i_q, speed = rng.uniform(-30.0, 30.0), rng.choice([-100.0, -50.0, 50.0, 100.0])
        current = i_q + (before - i_q) * settling
        # 1 ms per row, time constant of 3 rows: the voltage of the inductance.
        rising = L_Q * (i_q - before) * settling / 3e-3
        u_q = RESISTANCE * current + POLE_PAIRS * speed * FLUX + rising
        if point % 6 == 5:  # A point that warms: what it drifts by is no noise.
            u_q = u_q + np.linspace(0.0, 1.5, held)
        log["i_q"].append(current + rng.normal(0.0, 0.02, held))
        log["u_q"].append(u_q + slow_noise(rng, held, 0.5, 0.01))
        log["speed"].append(np.full(held, speed))
        before = i_q
    found = {name: np.concatenate(parts) for name, parts in log.items()}
    return found | ({"u_q": step * np.round(found["u_q"] / step)} if step else {})


def of_points(folder: Path, log: Log) -> Identification:
    write_table(folder / "points.csv", {f"{name} [{UNITS[name]}]": log[name] for name in log})
    run = RUN.format(name="points", columns=", ".join(f"{name}: {name}" for name in log))
    path = folder / "bench.yaml"
    path.write_text(bench_text(run.replace("reference", "measured"), f"pole_pairs: {POLE_PAIRS}"))
    return identify(read_bench(path))


def test_held_points_are_means_of_their_steady_windows(tmp_path: Path) -> None:
    """Rows that settle, and points that drift, are left out and counted; of 12 benches the
    intervals of the rest hold the truth in 11 or more.
    """
    inside = 0
    for seed in range(12):
        found = of_points(tmp_path, held_points(seed))
        (told,) = [text for text in found.remarks if "steady windows" in text]
        windows, rows = [int(word) for word in told.split() if word.isdigit()][:2]
        assert 20 <= windows <= 25
        assert 500 <= rows <= 1000
        assert f"{1200 - rows} rows that settle or drift are left out" in told
        held = found.of("resistance")
        assert held is not None
        assert held.status == "identified"
        assert held.sigma < 0.01 * RESISTANCE
        inside += held.low <= RESISTANCE <= held.high
    assert inside >= 11


def test_a_ride_has_no_windows(tmp_path: Path) -> None:
    """Neither where it goes on nor where it waits at a light."""
    log = sound_log()
    waits = np.arange(ROWS) % 90 < 60
    resting = {name: np.where(waits, 0.0, values) for name, values in log.items()}
    for each in (log, resting):
        found = said(tmp_path, each)
        assert "windows" not in found
        assert "column torque is" in found


def test_means_are_no_nearer_than_a_step_larger_than_the_noise(tmp_path: Path) -> None:
    fine, coarse_log = held_points(1), held_points(1, step=0.2)
    sigmas = []
    for log in (fine, coarse_log):
        found = of_points(tmp_path, log)
        held = found.of("resistance")
        assert held is not None
        sigmas.append(held.sigma)
        assert any("steps of 0.2 V" in text for text in found.remarks) == (log is coarse_log)
    # Rounding of 0.2/sqrt(12) V at each point, against 15 A r.m.s.
    assert sigmas[1] > 0.5 * 0.2 / 12.0**0.5 / 15.0 / 25.0**0.5
    assert sigmas[1] > 2.0 * sigmas[0]


# Each limit from both sides, on rows that are made for it.


def run_of(**columns: FloatArray) -> LoggedRun:
    rows = next(iter(columns.values())).size
    part = LogPart("ride.csv", "", columns, np.arange(2, 2 + rows), {})
    return LoggedRun(0, "ride", "constant-speed", (part,), {}, "reference")


def plateaued(top: int, below: int, moved: float = 1.0, rows: int = 400) -> LoggedRun:
    """Rows of a voltage: so many of the largest one, so many just below it, and others."""
    u_q = np.linspace(1.0, 9.0, rows)
    u_q[:top], u_q[top : top + below] = np.linspace(9.9905, 10.0, top), 9.945
    i_q = np.linspace(-8.0, 8.0, rows)
    i_q[:top] = np.linspace(5.0, 5.0 + 8.0 * moved, top) if top else 0.0
    return run_of(u_q=u_q, i_q=np.clip(i_q, -8.0, 8.0), speed=np.full(rows, 7.0))


def test_rows_at_a_limit_are_those_from_its_share_on() -> None:
    ones = np.ones(20)
    for share, reached in ((0.996, 20), (0.994, 0)):
        run = run_of(u_q=share * V_DC / 3.0**0.5 * ones, i_q=ones, speed=ones, i_d=ones)
        assert at_limit(run, V_DC)[0].sum() == reached
        assert at_limit(run, None)[0].sum() == 0
    # both axes together; a logged link before that of the inverter
    run = run_of(u_q=3.0 * ones, u_d=-4.0 * ones, i_q=ones, speed=ones, v_dc=8.72 * ones)
    assert at_limit(run, 1.0)[1] == ""
    assert at_limit(replace_column(run, "v_dc", 8.69 * ones), 99.0)[1].startswith("u_d and u_q")
    for duty, full in ((0.951, True), (-0.951, True), (0.949, False), (1.001, False)):
        run = run_of(u_q=ones, i_q=ones, i_d=ones, speed=ones, duty=duty * ones)
        assert bool(at_limit(run, None)[1]) == full
    for top, below, found in (
        (13, 0, True), (12, 0, False), (20, 9, True), (20, 10, False), (21, 10, True),
    ):  # fmt: skip
        rows, said = at_limit(plateaued(top, below), None)
        assert (rows.sum(), bool(said)) == ((top, True) if found else (0, False))
    for moved, found in ((0.051, True), (0.049, False)):
        assert bool(at_limit(plateaued(30, 0, moved), None)[1]) == found
    assert at_limit(plateaued(9, 0, rows=100), None)[0].sum() == 9
    assert at_limit(plateaued(8, 0, rows=100), None)[0].sum() == 0


def replace_column(run: LoggedRun, name: str, values: FloatArray) -> LoggedRun:
    return run_of(**(dict(run.parts[0].columns) | {name: values}))


@pytest.mark.parametrize(
    ("held", "still", "found"),
    [(81, 19, True), (79, 19, False), (81, 21, False), (100, 0, False)],
)
def test_a_requested_current_holds_in_four_of_five_rows(held: int, still: int, found: bool) -> None:
    def stepped(count: int) -> FloatArray:
        """101 numbers of which so many are those of the row before."""
        return np.cumsum(np.arange(101) > count).astype(np.float64)

    told = list(requested(run_of(i_q=stepped(held), u_q=stepped(still), speed=np.ones(101))))
    assert bool(told) == found
    assert not found or f"in {held} of 101 rows of ride.csv (from row 3 to {held + 2})" in told[0]


def findings(speed: FloatArray, resistance: float = 0.0, **columns: FloatArray) -> str:
    """All that is said of rows, contradictions in capitals."""
    run = run_of(speed=speed, **columns)
    found = log_findings(run, POLE_PAIRS, Fitted(resistance, math.nan))
    return "\n".join((*found.remarks, *(text.upper() for text in found.contradictions)))


def test_speeds_and_pole_pairs_count_where_the_shaft_turns() -> None:
    speed, ones = np.linspace(20.0, 100.0, 40), np.ones(40)
    for back, told in ((-9.0, True), (-11.0, False)):
        some = np.where(np.arange(40) == 3, back, speed)
        assert ("one direction of rotation" in findings(some, i_q=ones, u_q=ones)) == told
        assert ("one direction of rotation" in findings(-some, i_q=ones, u_q=ones)) == told
    odd = np.where(np.arange(40) < 25, 0.01 * speed, speed)
    for share, told in ((1.019, False), (1.021, True), (0.981, False), (0.979, True)):
        electrical = np.where(odd > 2.0, share * POLE_PAIRS * odd, -7.0 * odd)
        said = findings(odd, i_q=ones, u_q=ones, electrical_speed=electrical)
        assert ("NOT 5 POLE PAIRS" in said) == told


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("drives", [1.0, -1.0])
def test_a_balance_is_wrong_from_its_limits_on(way: float, drives: float) -> None:
    """At 100 rad/s and 100 to 300 W, of which a part is lost; torques vary enough to be told."""
    power = drives * np.linspace(100.0, 300.0, 60)
    words = "MOTORING" if drives > 0.0 else "BRAKING"
    speed, i_q = way * np.full(60, 100.0), np.full(60, 2.0)
    for share, text in (
        (-0.019, ""), (-0.022, "LESS THAN NOTHING"), (0.48, ""), (0.52, "OUTSIDE THE WINDING"),
    ):  # fmt: skip
        through = np.abs(power)
        # of what passes, the larger of both sides
        lost = share * through / (1.0 if share * drives > 0.0 else 1.0 + abs(share))
        if drives < 0.0 and share > 0.0:
            lost = share * through / (1.0 - share)
        power_of = _Powers(
            run_of(speed=speed, i_q=i_q, u_q=i_q), speed, (power - lost) / speed, power, 0.0 * power
        )
        found = "\n".join(_balance(power_of)).upper()
        assert (text in found) if text else (found == ""), (share, found)
        assert not text or f"{words} AT {'' if way > 0 else '-'}955 RPM" in found
