"""Bench files: columns in SI units, and what is refused, with its place."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from bench_files import bench_text, write_table

from dqforge.machines.bench.bench_reader import read_bench
from dqforge.machines.errors import InputError

ROWS = """
- name: rows
  kind: constant-speed
  file: log.csv
  columns: {i_q: iq, u_q: {column: uq, unit: mV}, speed: {column: n, unit: erpm}}
  currents: measured
  voltage: reference
"""


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """A folder with a log of four rows."""
    columns = {"iq [A]": [1.0, 2.0, -1.0, 0.0], "uq": [5.0, 6, 7, 8], "n": [60.0, 120, 180, 240]}
    write_table(tmp_path / "log.csv", {name: np.array(each) for name, each in columns.items()})
    return tmp_path


def written(folder: Path, runs: str, machine: str = "pole_pairs: 2") -> Path:
    path = folder / "bench.yaml"
    path.write_text(bench_text(runs, machine))
    return path


def refusals(folder: Path, runs: str, machine: str = "pole_pairs: 2") -> list[str]:
    with pytest.raises(InputError) as caught:
        read_bench(written(folder, runs, machine))
    return [str(one) for one in (caught.value, *caught.value.others)]


def test_columns_in_si_units(log: Path) -> None:
    (run,) = read_bench(written(log, ROWS)).runs
    assert run.need("i_q").tolist() == [1.0, 2.0, -1.0, 0.0]
    assert run.need("u_q") == pytest.approx([5e-3, 6e-3, 7e-3, 8e-3])
    # 60 electrical revolutions a minute of two pole pairs.
    assert run.need("speed") == pytest.approx(np.pi * np.array([1.0, 2.0, 3.0, 4.0]))


def test_a_quantity_that_stood_still(log: Path) -> None:
    runs = ROWS.replace("{column: n, unit: erpm}", "{value: 60 rpm}")
    (run,) = read_bench(written(log, runs)).runs
    assert run.need("speed") == pytest.approx(np.full(4, 2.0 * np.pi))


@pytest.mark.parametrize(
    ("machine", "flux"),
    [
        ("magnet_flux: 5 mWb", 5e-3),
        ("kv: 1500 rpm/V", 30.0 / np.pi / 1500.0 / np.sqrt(3.0) / 7.0),
        ("back_emf_constant: 0.07 V s/rad phase peak", 0.01),
        ("torque_constant: 0.105 N m/A peak", 0.01),
    ],
)
def test_constants_become_one_flux_linkage(log: Path, machine: str, flux: float) -> None:
    bench = read_bench(written(log, ROWS, f"pole_pairs: 7\n{machine}"))
    assert bench.known["magnet_flux"] == pytest.approx(flux)
    assert bench.origins["magnet_flux"] == machine.partition(":")[0]


def test_all_faults_at_once_with_their_places(log: Path) -> None:
    runs = """
- name: first
  kind: constant-speed
  file: log.csv
  columns: {i_q: iq, u_q: uq, speed: {column: nn, unit: rpm}}
  currents: requested
  voltage: reference
- name: first
  kind: spin-down
  file: log.csv
  columns: {speed: {column: n, unit: rpm}}
"""
    found = refusals(log, runs)
    assert [line for line in found if "bench.yaml:" not in line] == []
    for words in (
        "requested currents are not those that flowed",
        "the column 'uq' has no unit in log.csv",
        "no column 'nn' in log.csv",
        "runs[0] has the same name",
        "needs a column of time: nothing dynamic follows from rows without times",
    ):
        assert sum(words in line for line in found) == 1, words


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("  currents: measured\n", "", "whether the currents are measured or requested"),
        ("  voltage: reference\n", "", "whether the voltages are measured or references"),
        ("i_q: iq", "iq: iq", "no quantity is called 'iq'"),
        ("unit: mV", "unit: mA", "a voltage"),
        ("file: log.csv", "file: other.csv", "there is no such file"),
        ("i_q: iq", "torque: iq", "needs a column of i_q"),
    ],
)
def test_one_fault(log: Path, before: str, after: str, words: str) -> None:
    assert words in refusals(log, ROWS.replace(before, after))[0]


def test_a_design_is_no_bench(tmp_path: Path) -> None:
    path = tmp_path / "design.yaml"
    path.write_text("dqforge: 1\nname: x\n")
    with pytest.raises(InputError, match="this is a design; a bench file begins with"):
        read_bench(path)


def test_a_log_without_times_and_with_a_dead_torque_channel(
    tmp_path: Path, shared_data: Path
) -> None:
    """The logs of V-Dyno: no time, and in one of them a torque of 0 in all rows."""
    shutil.copy(shared_data / "bench/vdyno/2025-04-16_14-54-05.csv", tmp_path / "log.csv")
    runs = """
- name: torque
  kind: locked-torque
  file: log.csv
  columns:
    current: {column: Status_TotalCurrent_V1, unit: A}
    torque: {column: TorqueValue, unit: N m}
  currents: measured
"""
    found = refusals(tmp_path, runs, "pole_pairs: 7")
    assert any("holds 0 in all 625 rows of log.csv: a dead channel" in line for line in found)
    assert any("nothing dynamic follows from rows without times" in line for line in found)


def test_a_requested_current_that_is_said_to_be_measured(log: Path) -> None:
    text = (log / "log.csv").read_text().replace("iq [A]", "IqReq [A]")
    (log / "log.csv").write_text(text)
    (run,) = read_bench(written(log, ROWS.replace("i_q: iq", "i_q: IqReq"))).runs
    assert "looks like a requested current" in run.remarks[0]


def test_rows_with_a_gap_are_counted(log: Path) -> None:
    lines = (log / "log.csv").read_text().splitlines()
    (log / "log.csv").write_text("\n".join([*lines[:2], ",6,120", *lines[3:], "1.5,,60"]) + "\n")
    (run,) = read_bench(written(log, ROWS)).runs
    assert run.need("i_q").tolist() == [1.0, -1.0, 0.0]
    assert "2 of 5 rows of log.csv have a gap" in run.remarks[0]
    assert "line 3 first" in run.remarks[0]


def test_a_log_of_a_known_tool_needs_no_word_on_its_currents(
    tmp_path: Path, shared_data: Path
) -> None:
    shutil.copy(shared_data / "bench/moteus_ld/ld_mj5208.json", tmp_path / "sweep.json")
    runs = """
- {name: sweep, kind: speed-sweep, file: sweep.json, format: moteus-ld}
"""
    (run,) = read_bench(written(tmp_path, runs)).runs
    assert run.voltage == "reference"
