"""Operating points in the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import copper_loss
from dqforge.optimizer.operating_points.current_choice import OperatingPoints
from dqforge.optimizer.operating_points.solve import Curves
from dqforge.optimizer.solution import Solution
from dqforge.reports.pages.html_table import HtmlTable, Row, heading_cells
from dqforge.reports.pages.html_text import (
    number,
    share,
)
from dqforge.reports.pages.labels import (
    watts,
)

if TYPE_CHECKING:
    pass
if TYPE_CHECKING:
    pass


@dataclass(frozen=True, slots=True)
class Saving:
    """Copper loss in W of the chosen strategy and of i_d = 0 at the largest torque
    in N m that both can make.
    """

    torque: float
    chosen: float
    id0: float

    @property
    def relative(self) -> float:
        """What is saved, as a share of the loss at i_d = 0."""
        return 1.0 - self.chosen / self.id0


def copper_saving(solution: Solution) -> Saving | None:
    """What the strategy saves against i_d = 0, or None where the two are the same or
    the machine has no magnet.
    """
    curves, design = solution.curves, solution.design
    if curves.id0 is None or not differs_from_id0(design):
        return None
    common = np.flatnonzero(~curves.id0.limited & ~curves.chosen.limited)
    last = int(common[-1])
    chosen, id0 = (float(losses_of(design, points)[last]) for points in (curves.chosen, curves.id0))
    return Saving(float(curves.chosen.torque[last]), chosen, id0) if id0 > 0.0 else None


_SHARES_OF_TORQUE = (0.1, 0.25, 0.5, 0.75, 1.0)


def losses_of(design: Design, points: OperatingPoints) -> FloatArray:
    """Copper loss in W of operating points, shape (N,)."""
    return copper_loss(design.machine.r_s, points.i_d, points.i_q)


def differs_from_id0(design: Design) -> bool:
    """Whether the design's strategy is anything else than i_d = 0."""
    return design.strategy != "id0" and design.machine.saliency != 0.0


def operating_table(design: Design, curves: Curves) -> HtmlTable:
    """Currents and copper loss at a few torques, beside those of i_d = 0."""
    chosen, id0 = curves.chosen, curves.id0 if differs_from_id0(design) else None
    loss = losses_of(design, chosen)
    loss_id0 = None if id0 is None else losses_of(design, id0)
    rows = []
    for part in _SHARES_OF_TORQUE:
        k = round(part * (chosen.torque.size - 1))
        cells = [number(chosen.torque[k]), number(chosen.i_d[k]), number(chosen.i_q[k])]
        cells += [number(float(np.hypot(chosen.i_d[k], chosen.i_q[k]))), watts(float(loss[k]))]
        if id0 is not None and loss_id0 is not None:
            if id0.limited[k]:
                cells += ["beyond the limit", "\u2013"]
            else:
                cells += [watts(float(loss_id0[k])), share(1.0 - float(loss[k] / loss_id0[k]), 3)]
        rows.append(Row(tuple(cells)))
    columns = ["Torque N m", "i_d A", "i_q A", "|i| A", "copper loss"]
    columns += [] if id0 is None else ["copper loss at i_d = 0", "saved"]
    return HtmlTable(
        "Operating points, exact (currents are peak of phase)",
        heading_cells(*columns),
        tuple(rows),
        0,
    )
