"""Which topology and controller this machine should have on this inverter, by watts and ripple."""

from __future__ import annotations

import math

from dqforge.machines.names import Topology
from dqforge.machines.records import dataclass
from dqforge.optimizer.flashing_choice.choices import COMPARED, FlashRow
from dqforge.optimizer.flashing_choice.solve import FlashComparison

# By how much the torque ripple of plain dq may be above that of the table, over the torque, for the
# simpler controller to be enough.
SMOOTH = 5e-3

# Share of the losses that more legs, or capacitors in halves, must save to be worth having.
WORTH = 5e-3


@dataclass(frozen=True, slots=True)
class Trade:
    """What another topology would change against the one to flash.

    ``copper_saved`` and ``bridge_added`` in W (the latter NaN without a device), ``neutral_leg``
    its loss in W or NaN, ``link_saved`` in V that the link could be lower, ``obstacle`` why it
    cannot be had, else empty.
    """

    topology: Topology
    copper_saved: float
    bridge_added: float
    neutral_leg: float
    link_saved: float
    obstacle: str

    @property
    def net(self) -> float:
        """Watts that it would save in all, negative where it costs; NaN where that is unknown."""
        return self.copper_saved - self.bridge_added


@dataclass(frozen=True, slots=True)
class Advice:
    """What to flash.

    ``row`` is None where nothing can be run at the point. ``dq_ripple`` is what plain dq would
    leave on the same topology, over the torque, and ``dq_saved`` the W that it would lose less.
    """

    row: FlashRow | None
    dq_ripple: float
    trades: tuple[Trade, ...]
    dq_saved: float = 0.0


def advise(found: FlashComparison) -> Advice:
    """The topology that loses least with the table, or the first that can be had where that saves
    less than `WORTH`; plain dq where its torque ripple is as good.

    Without a device the bridges cannot be weighed: then it is the first topology that can be had.

    Args:
        found: The comparison, with what was simulated of it.
    """
    tables = [_candidate(found, topology) for topology in COMPARED]
    possible = [row for row in tables if not row.obstacle]
    if not possible:
        return Advice(None, math.nan, ())
    best = possible[0]
    if not found.without_device:
        least = min(possible, key=lambda row: row.losses)
        best = least if least.losses < best.losses * (1.0 - WORTH) else best
    plain = found.row(best.topology, "dq")
    dq_ripple, ripple = _ripple(plain), _ripple(best)
    trades = tuple(_trade(row, best) for row in tables if row.topology != best.topology)
    enough = not plain.obstacle and dq_ripple <= ripple + SMOOTH
    saved = best.losses - plain.losses
    return Advice(plain if enough else best, dq_ripple, trades, saved)


def _candidate(found: FlashComparison, topology: Topology) -> FlashRow:
    """The table, or plain dq where that alone can be run."""
    table, plain = found.row(topology, "table"), found.row(topology, "dq")
    alone = table.control is None or (table.obstacle and not plain.obstacle)
    return plain if alone else table


def _ripple(row: FlashRow) -> float:
    known = row.ripple_known
    return math.nan if known is None else known.plain


def _trade(row: FlashRow, best: FlashRow) -> Trade:
    return Trade(
        row.topology,
        best.copper - row.copper,
        row.bridge - best.bridge,
        row.neutral_leg,
        best.link - row.link,
        row.obstacle,
    )
