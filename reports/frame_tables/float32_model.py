"""The emitted frame tables: as plain data, and what their C finds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.optimizer.frame_tables.exact_frames import COLUMNS
from dqforge.optimizer.frame_tables.fit import FrameTable
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.read_back import singles_from
from dqforge.reports.plain_data import PlainData, shortest

_MOST_ROWS = 1 << 17
_INPUTS = 5  # Turn, electrical speed, and currents of dqy.


@dataclass(frozen=True, slots=True, eq=False)
class FrameModel:
    """The header in numpy: its table."""

    table: FrameTable

    def evaluate(self, inputs: SingleArray) -> SingleArray:
        """Quantities of `COLUMNS`, and decoupling voltages of dqy in V, shape (M, 21).

        ``inputs`` are the turn, the electrical speed in rad/s and the currents d, q, 0 of dqy in A,
        shape (M, 5).
        """
        turn, omega, i_d, i_q, i_0 = inputs.T
        found = self.table.values(np.ascontiguousarray(turn))
        at = dict(zip(COLUMNS, found, strict=True))
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            sums = [
                ((at[f"c_{axis}d"] * i_d) + (at[f"c_{axis}q"] * i_q)) + (at[f"c_{axis}0"] * i_0)
                for axis in "dq0"
            ]
            sums[1] = sums[1] + at["emf"]
            volts = [omega * total for total in sums]
        return np.ascontiguousarray(np.stack([*found, *volts]).T, dtype=np.float32)


def plain_frame_model(table: FrameTable) -> PlainData:
    """The table as plain data; every number is a float32 value."""
    return {
        "parts": table.parts,
        "columns": list(COLUMNS),
        "table": [[shortest(value) for value in row] for row in table.entries],
    }


def frame_model_from(plain: Mapping[str, Any]) -> FrameModel:
    """Read a table back.

    Raises:
        InputError: The data are not what `plain_frame_model` makes.
    """
    fault = InputError("frames_header is not what dqforge writes; run the design again")
    try:
        rows, parts = plain["table"], plain["parts"]
        known = list(plain["columns"]) == list(COLUMNS) and parts in (1, 3)
        if not known or not 2 < len(rows) <= _MOST_ROWS:
            raise fault
        entries = np.stack([singles_from(row, len(COLUMNS)) for row in rows])
        if entries.shape[1] != len(COLUMNS):
            raise fault
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise fault from error
    return FrameModel(FrameTable(entries, int(parts)))


def frame_inputs(count: int, seed: int) -> SingleArray:
    """Inputs of the functions, special turns first, shape (count, 5)."""
    generator = np.random.default_rng(seed)
    inputs = generator.uniform(-1.0, 1.0, (count, _INPUTS)) * [1.0, 2000.0, 20.0, 20.0, 20.0]
    inputs[:, 0] = generator.uniform(0.0, 1.0, count)
    below_one = float(np.nextafter(np.float32(1.0), np.float32(0.0)))
    special = [0.0, -0.0, below_one, 1.0, -0.25, np.nan, 1e30, 1.0 / 3.0, 2.0 / 3.0, 0.5, 1e-40]
    inputs[: len(special), 0] = special
    return np.ascontiguousarray(inputs, dtype=np.float32)


def model_results(model: FrameModel, count: int = SWEEP_POINTS) -> tuple[SingleArray, SingleArray]:
    """Inputs and what the compiled functions must return."""
    inputs = frame_inputs(count, SWEEP_SEED)
    return inputs, model.evaluate(inputs)
