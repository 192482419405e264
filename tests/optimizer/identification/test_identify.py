"""Whatever a log holds, a bench file is answered or refused in one line."""

from __future__ import annotations

import json
import warnings
from pathlib import Path

import numpy as np
import pytest
from bench_files import bench_text, write_table

from dqforge.machines.arrays import FloatArray
from dqforge.machines.bench.bench_file import RunKindName
from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.bench.log_columns import KINDS, QUANTITIES
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.units.registry import DIMENSIONS
from dqforge.optimizer.identification.identify import identify
from dqforge.optimizer.identification.parameters import Parameter
from dqforge.reports.identification import (
    design_of,
    identification_tables,
    plain_identification,
)

MACHINE = "pole_pairs: 3\ninertia: 0.1 kg m^2\nmagnet_flux: 10 mWb\nmax_current: 10 A"


def strange(rng: np.random.Generator, rows: int) -> FloatArray:
    """Rows of a channel that may be dead, stepped, noisy or far too large."""
    choices: list[FloatArray] = [
        np.zeros(rows),
        np.full(rows, 3.0),
        rng.normal(size=rows),
        np.arange(rows, dtype=float),
        rng.integers(-2, 3, rows).astype(float),
        1e8 * rng.normal(size=rows),
        np.sign(rng.normal(size=rows)),
    ]
    return choices[int(rng.integers(len(choices)))]


@pytest.mark.parametrize("kind", KINDS)
def test_strange_logs_are_answered_or_refused(tmp_path: Path, kind: RunKindName) -> None:
    rng = np.random.default_rng(sorted(KINDS).index(kind))
    for _ in range(20):
        names = [group[int(rng.integers(len(group)))] for group in KINDS[kind].needs]
        names += [name for name in KINDS[kind].may if rng.random() < 0.5 and name != "duty"]
        rows = int(rng.integers(3, 60))
        columns = {name: strange(rng, rows) for name in names}
        if "time" in columns and rng.random() < 0.8:
            columns["time"] = np.linspace(0.0, 0.1 * rows, rows)
        titles = {name: f"{name} [{DIMENSIONS[QUANTITIES[name]].unit}]" for name in names}
        write_table(tmp_path / "log.csv", {titles[name]: columns[name] for name in names})
        listed = ", ".join(f"{name}: {name}" for name in names)
        run = f"""
- name: run
  kind: {kind}
  file: log.csv
  columns: {{{listed}}}
  currents: measured
  voltage: reference
"""
        path = tmp_path / "bench.yaml"
        path.write_text(bench_text(run, MACHINE, "{v_dc: 60 V, switching_frequency: 20 kHz}"))
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            try:
                found = identify(read_bench(path))
            except DqforgeError:
                continue
            assert identification_tables(found)
            assert json.dumps(plain_identification(found), allow_nan=False)
            assert design_of(found)


PRIOR_RUN = """
- name: ride
  kind: constant-speed
  file: ride.csv
  columns: {i_q: i_q, u_q: u_q, speed: speed}
  currents: measured
  voltage: measured
"""


def held_resistance(
    folder: Path, noise: float, machine: str = "", uncertainty: str = "{}", level: float = 0.0
) -> Parameter:
    """Resistance (80 mOhm in truth) of 400 rows, of currents of at least ``level`` A."""
    rng = np.random.default_rng(7)
    i_q = rng.uniform(level, 20.0, 400) * rng.choice([-1.0, 1.0], 400)
    speed = rng.uniform(-150.0, 150.0, 400)
    u_q = 0.08 * i_q + 3.0 * speed * 0.02 + rng.normal(0.0, noise, 400)
    columns = {"i_q [A]": i_q, "u_q [V]": u_q, "speed [rad/s]": speed}
    write_table(folder / "ride.csv", columns)
    path = folder / "bench.yaml"
    path.write_text(bench_text(PRIOR_RUN, f"pole_pairs: 3\n{machine}", uncertainty=uncertainty))
    found = identify(read_bench(path)).of("resistance")
    assert found is not None
    return found


def test_what_is_known_is_weighted_by_inverse_variance(tmp_path: Path) -> None:
    alone = held_resistance(tmp_path, 0.2)
    assert alone.status == "identified"
    for width, status in ((0.1, "identified"), (0.005, "prior-dominated")):
        known, sigma = 0.081, 0.081 * width / 1.959964
        found = held_resistance(
            tmp_path, 0.2, f"resistance: {known} Ohm", f"{{resistance: {100 * width} %}}"
        )
        weight = sigma**-2 / (sigma**-2 + alone.sigma**-2)
        assert found.status == status
        assert found.value == pytest.approx(weight * known + (1 - weight) * alone.value)
        apart = max(1.0, abs(known - alone.value) / np.hypot(sigma, alone.sigma))
        assert found.sigma == pytest.approx(apart * (sigma**-2 + alone.sigma**-2) ** -0.5)
        assert f"{100 * weight:.2g} % of the weight is that of machine.resistance" in found.why


def test_what_is_known_stands_alone_where_the_rows_hold_nothing(tmp_path: Path) -> None:
    """At one amplitude of the current the estimate is no estimate, however narrow."""
    found = held_resistance(tmp_path, 0.01, "resistance: 0.09 Ohm", "{resistance: 20 %}", 19.5)
    assert found.status == "prior-dominated"
    assert [found.low, found.value, found.high] == pytest.approx([0.072, 0.09, 0.108])
    assert "one amplitude" in found.why
    wide = held_resistance(tmp_path, 40.0, "resistance: 0.09 Ohm", "{resistance: 20 %}")
    assert wide.status == "prior-dominated"
    assert wide.runs == ("ride",)


def test_a_width_belongs_to_a_value(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"uncertainty\.resistance: machine has no resistance"):
        held_resistance(tmp_path, 0.1, "", "{resistance: 5 %}")


JOINT_RUN = """
- name: run {name}
  kind: constant-speed
  file: {name}.csv
  columns: {{i_q: i_q, u_q: u_q, speed: speed}}
  currents: measured
  voltage: measured
"""


def joint_bench(folder: Path, names: str, flux_of: dict[str, float]) -> Path:
    """Bench file of runs of one machine (20 mWb), but for those of another flux linkage."""
    for name in "abcd":
        rng = np.random.default_rng(ord(name))
        i_q, speed = rng.uniform(-20.0, 20.0, 200), rng.uniform(-150.0, 150.0, 200)
        u_q = 0.08 * i_q + 3.0 * speed * flux_of.get(name, 0.02) + rng.normal(0.0, 0.1, 200)
        columns = {"i_q [A]": i_q, "u_q [V]": u_q, "speed [rad/s]": speed}
        write_table(folder / f"{name}.csv", columns)
    path = folder / f"{names}.yaml"
    path.write_text(bench_text("".join(JOINT_RUN.format(name=name) for name in names)))
    path.write_text(path.read_text().replace("pole_pairs: 7", "pole_pairs: 3"))
    return path


@pytest.mark.parametrize("flux", [0.02, 0.0204])
def test_a_run_that_does_not_belong_is_named(tmp_path: Path, flux: float) -> None:
    whole = identify(read_bench(joint_bench(tmp_path, "abcd", {"c": flux})))
    held = whole.of("magnet_flux")
    assert held is not None
    assert held.moved is not None
    moves = {}
    for name in "abcd":
        others = "abcd".replace(name, "")
        less = identify(read_bench(joint_bench(tmp_path, others, {"c": flux}))).of("magnet_flux")
        assert less is not None
        moves[f"run {name}"] = (less.value - held.value) / less.sigma
    most = max(moves, key=lambda name: abs(moves[name]))
    assert held.moved is not None
    assert held.moved[0] == most
    assert held.moved[1] == pytest.approx(moves[most])
    told = [text for text in whole.remarks if "without this run magnet flux linkage" in text]
    assert [text.partition(":")[0] for text in told] == (["run c"] if flux > 0.02 else [])


def test_two_runs_cannot_judge_each_other(tmp_path: Path) -> None:
    held = identify(read_bench(joint_bench(tmp_path, "ab", {}))).of("magnet_flux")
    assert held is not None
    assert held.moved is None
