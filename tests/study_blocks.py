"""Rows of studies for the tests of their store: made up, the same whenever they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dqforge.machines.exploration.study import Axis, Draw, Goal, Study
from dqforge.optimizer.exploration.row_block import STATES, ColumnSpec, RowBlock
from dqforge.reports.exploration.part_file import encode_part
from dqforge.reports.exploration.part_store import (
    PartStore,
    StudyHeader,
    study_header,
    study_inputs,
)

DEVICES = ("fuji-2mbi300xbe120-50", "infineon-ff200r12ke3", "wolfspeed-c2m0045170d")
COLUMNS = (
    ColumnSpec("in.inverter.switching_frequency", "Hz"),
    ColumnSpec("in.inverter.device", "", "choice", DEVICES),
    ColumnSpec("out.losses.total", "W"),
    ColumnSpec("out.losses.junction_temperature", "degC"),
    ColumnSpec("out.gains.phase_margin", "rad"),
    ColumnSpec("out.gains.i_d.crossover", "rad/s"),
    ColumnSpec("out.gains.i_d.stable"),
)
OK, LIMIT, REFUSED = STATES.index("ok"), STATES.index("limit"), STATES.index("refused")


@dataclass(frozen=True)
class Rows:
    """Rows that depend on nothing but their index."""

    count: int
    batch: int = 100
    columns: tuple[ColumnSpec, ...] = COLUMNS

    def rows(self, first: int, end: int) -> RowBlock:
        index = np.arange(first, end)
        noise = np.sin(12.9898 * (index + 1.0)) * 43758.5453
        share = noise - np.floor(noise)
        states = np.where(index % 7 == 3, REFUSED, np.where(index % 5 == 1, LIMIT, OK))
        ended = states != REFUSED
        losses = np.where(ended, 400.0 + 300.0 * share, np.nan)
        columns = {
            "in.inverter.switching_frequency": 8000.0 * (1.0 + index % 20),
            "in.inverter.device": np.where(index % 11 == 5, -1, index % 3).astype(np.int32),
            "out.losses.total": losses,
            "out.losses.junction_temperature": np.where(ended, 40.0 + 0.1 * losses, np.nan),
            "out.gains.phase_margin": 1.2 + 0.1 * share,
            "out.gains.i_d.crossover": 3000.0 + 10.0 * share,
            "out.gains.i_d.stable": np.where(share > 0.1, 1.0, 0.0),
        }
        texts = tuple("" if fine else "inverter.v_dc 500 V is above the 80 V" for fine in ended)
        audited = {"losses.total": 1e-15 * (1 + first)} if first % 1000 == 0 else {}
        return RowBlock(first, columns, keys_of(index), states.astype(np.int8), texts, audited)


def keys_of(index: np.ndarray) -> np.ndarray:
    """Keys of 16 bytes that differ for every index, spread over all bytes."""
    mixed = (index.astype(np.uint64) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    turned = (mixed >> np.uint64(29)) ^ (mixed * np.uint64(0xBF58476D1CE4E5B9))
    return np.stack([mixed, turned], axis=1).view(np.uint8).reshape(len(index), 16)


def study(count: int = 1050, seed: int = 1, *, name: str = "Made up") -> Study:
    """A drawn study with one goal."""
    return Study(
        name,
        "",
        b"machine: {}\n",
        "made-up",
        "00",
        draw=Draw(count, seed),
        goals=(Goal("losses.total"),),
    )


def grid_study(*values: float) -> Study:
    """A study of a grid."""
    steps = tuple((f"{value} Hz",) for value in values)
    numbers = tuple((value,) for value in values)
    axes = (Axis(("inverter.switching_frequency",), steps, numbers),)
    return Study("Grid", "", b"machine: {}\n", "made-up", "00", axes=axes)


def header(count: int = 1050, seed: int = 1, *, name: str = "Made up") -> StudyHeader:
    """The header of `study`."""
    asked = study(count, seed, name=name)
    return study_header(asked, Rows(count))


def part(of: StudyHeader, number: int) -> bytes:
    """A part of a study of `Rows`."""
    first = number * of.batch
    block = Rows(of.count).rows(first, first + of.rows_of(number))
    return encode_part(block, of.columns, of.digest)


def filled(folder: Path, of: StudyHeader | None = None) -> PartStore:
    """A folder with all parts of a study, open."""
    whole = of or header()
    store = PartStore.open(folder, whole, inputs=study_inputs(study(whole.count)))
    for number in sorted(set(range(whole.parts)) - store.finished()):
        store.write(number, part(whole, number))
    return store
