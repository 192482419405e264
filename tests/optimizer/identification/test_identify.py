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
from dqforge.machines.errors import DqforgeError
from dqforge.machines.units.registry import DIMENSIONS
from dqforge.optimizer.identification.identify import identify
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
            columns["time"] = 0.1 * np.arange(rows)
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
