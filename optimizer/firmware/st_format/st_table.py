"""The table of currents of ST's MCSDK for the machine of a design, and what it costs."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.firmware_method import Asked
from dqforge.optimizer.firmware.st_format.st_mtpa import (
    MtpaTable,
    fitted_table,
    locus_counts,
    table_currents,
)
from dqforge.optimizer.firmware.st_format.st_scales import FULL
from dqforge.optimizer.operating_points.mtpa_locus import MtpaLocus, mtpa_locus

_NEGLIGIBLE = 2.0  # Counts of i_d up to which no table is needed.


@dataclass(frozen=True, slots=True)
class TablePrice:
    """What a table of currents costs.

    Args:
        error, error_current: Largest deviation of i_d from the optimum in counts and in A.
        loss: Largest copper loss beyond the optimum for the same torque, relative.
        torque: Largest torque of the table below that of the optimum at the same current, relative.
    """

    error: float
    error_current: float
    loss: float
    torque: float


def locus_of(asked: Asked) -> MtpaLocus:
    """The optimal currents of the design's machine, up to its current limit."""
    return mtpa_locus(asked.design.machine, asked.design.i_max)


def table_for(asked: Asked, full_current: float) -> MtpaTable | None:
    """The table with the least largest error for the machine of a design, saturated or not.

    None where the design asks for no d current, or optimal d currents are too small to be seen.
    """
    machine = asked.design.machine
    if asked.design.strategy != "mtpa":
        return None
    if isinstance(machine, LinearMachine) and machine.l_d == machine.l_q:
        return None
    wanted = _wanted(asked, full_current)
    if wanted.size < 16 or float(np.max(np.abs(wanted))) < _NEGLIGIBLE:
        return None
    return fitted_table(wanted)


def _wanted(asked: Asked, full_current: float) -> FloatArray:
    """Optimal i_d in counts at every count of i_q."""
    locus = locus_of(asked)
    i_d, i_q = np.concatenate(([0.0], locus.i_d)), np.concatenate(([0.0], locus.i_q))
    return locus_counts(i_d, i_q, full_current)


def table_price(
    asked: Asked,
    full_current: float,
    width: int,
    slopes: tuple[int, ...],
    offsets: tuple[int, ...],
) -> TablePrice:
    """What a table costs on the machine of a design, at every count of its q current from a
    twentieth of the largest on.
    """
    wanted = _wanted(asked, full_current)
    counts = np.arange(wanted.size)
    count = full_current / FULL
    i_d = table_currents(width, slopes, offsets, counts).astype(np.float64) * count
    i_q = counts.astype(np.float64) * count
    error = float(np.max(np.abs(i_d * FULL / full_current - wanted)))
    part = counts >= wanted.size // 20
    machine = asked.design.machine
    torque = np.asarray(machine.torque(i_d[part], i_q[part]))
    square = i_d[part] ** 2 + i_q[part] ** 2
    # The optimum at every count, too: its points of the locus are too far apart for shares of 1e-4.
    best_d = wanted * full_current / FULL
    most = np.asarray(machine.torque(best_d, i_q))
    least = np.hypot(best_d, i_q)
    best = np.interp(torque, most, least)
    within = torque <= most[-1]
    loss = float(np.max(square[within] / best[within] ** 2, initial=1.0)) - 1.0
    at_current = np.interp(np.sqrt(square), least, most)
    lost = float(np.max(1.0 - torque / at_current, initial=0.0))
    return TablePrice(error, error * full_current / FULL, max(0.0, loss), max(0.0, lost))
