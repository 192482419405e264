"""Bench files for tests, written into a folder."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dqforge.machines.arrays import FloatArray

MOTEUS = {"mj5208": 7, "mad8318": 21, "flipsky6374": 7, "hoverboard": 15}


def bench_text(
    runs: str, machine: str = "pole_pairs: 7", inverter: str = "", uncertainty: str = "{}"
) -> str:
    """A bench file; ``runs`` are the lines of the list, without indent."""
    lines = "\n".join(f"  {line}" for line in runs.strip().splitlines())
    known = "\n".join(f"  {line}" for line in machine.strip().splitlines())
    fed = f"inverter: {inverter}\n" if inverter else ""
    head = "dqforge_bench: 1\nname: Machine on a bench\n"
    width = "" if uncertainty == "{}" else f"uncertainty: {uncertainty}\n"
    return f"{head}machine:\n{known}\n{width}{fed}runs:\n{lines}\n"


def moteus_bench(folder: Path, data: Path, motor: str) -> Path:
    """Bench file of one of moteus's sweeps, beside a copy of its log."""
    log = f"ld_{motor}.json"
    shutil.copy(data / "bench" / "moteus_ld" / log, folder / log)
    path = folder / f"{motor}.yaml"
    run = f"""
- name: sweep
  kind: speed-sweep
  file: {log}
  format: moteus-ld
  currents: measured
  voltage: reference
"""
    path.write_text(bench_text(run, f"pole_pairs: {MOTEUS[motor]}"))
    return path


def write_table(path: Path, columns: Mapping[str, FloatArray]) -> None:
    """A CSV with a heading for each column."""
    rows = np.column_stack(list(columns.values()))
    text = "\n".join(",".join(f"{value:.9g}" for value in row) for row in rows)
    path.write_text(f"{','.join(columns)}\n{text}\n")


def slow_noise(rng: np.random.Generator, count: int, memory: float, size: float) -> FloatArray:
    """Noise of first order whose rows are correlated by ``memory``, with standard deviation
    ``size``, shape (count,).
    """
    steps = rng.normal(0.0, size * np.sqrt(1.0 - memory**2), count)
    found = np.empty(count)
    found[0] = rng.normal(0.0, size)
    for row in range(1, count):
        found[row] = memory * found[row - 1] + steps[row]
    return found
