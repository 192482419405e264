"""The recommendation in plain words."""

from __future__ import annotations

import math

from dqforge.machines.names import CurrentFrame, Topology
from dqforge.optimizer.flashing_choice.advice import WORTH, Advice, Trade
from dqforge.optimizer.flashing_choice.choices import FlashRow

TOPOLOGY_TEXT: dict[Topology, str] = {
    "three-wire": "star",
    "four-leg": "four legs",
    "six-leg": "six legs",
    "split-capacitor": "split link",
}


_MANY = {"six-leg"}

_SUBJECTS: dict[Topology, str] = {
    "three-wire": "a star on three legs",
    "four-leg": "the fourth leg",
    "six-leg": "six legs",
    "split-capacitor": "a split link",
}


FRAME_TEXT: dict[CurrentFrame, str] = {
    "dq": "dq",
    "dqx": "dqx",
    "dqy": "dqy",
    "table": "table",
}


def watts(value: float) -> str:
    """A loss with two or three digits that count."""
    return f"{value:.3g} W" if abs(value) < 10.0 else f"{value:.1f} W"


def percent(share: float) -> str:
    """A share as percent with two digits, as a human reads it."""
    return f"{100.0 * share:.2g} %"


def advice_lines(advice: Advice) -> list[str]:
    """Sentences: what to flash, what it leaves, and what each other topology would change."""
    row = advice.row
    if row is None:
        return ["flash none of these here: no row keeps the voltage and the current of the design"]
    return [_first(row, advice), *(_traded(trade) for trade in advice.trades)]


def _first(row: FlashRow, advice: Advice) -> str:
    known = row.ripple_known
    ripple = math.nan if known is None else known.plain
    bridge = "" if math.isnan(row.bridge) else f" and {watts(row.bridge)} in the inverter"
    control = (
        "dq with constant currents"
        if row.frame == "dq"
        else "the table with harmonic integrators (frame: table)"
    )
    kept = f"torque ripple {percent(ripple)}"
    if row.frame != "dq":
        kept += f", {percent(advice.dq_ripple)} with dq"
        if advice.dq_saved > WORTH * row.losses:
            kept += f", which loses {watts(advice.dq_saved)} less"
    lost = f"{watts(row.copper)} of copper{bridge}"
    return f"flash {TOPOLOGY_TEXT[row.topology]}, {control}: {lost}, {kept}"


def _traded(trade: Trade) -> str:
    name = _SUBJECTS[trade.topology]
    if trade.obstacle:
        return f"{name}: {trade.obstacle}"
    many = trade.topology in _MANY
    copper = _change(trade.copper_saved, many=many)
    if math.isnan(trade.bridge_added):
        cost = "what that costs in the inverter is unknown without inverter.device"
        return f"{name} {copper} of copper; {cost}{_voltage(trade)}"
    of_leg = (
        f" (the neutral's leg loses {watts(trade.neutral_leg)})"
        if math.isfinite(trade.neutral_leg)
        else ""
    )
    bridge = _change(-trade.bridge_added, many=many)
    total = f"that {_change(trade.net, many=False)} in all"
    if trade.net > 0.0:
        total += f", less than the {percent(WORTH)} of the losses that would be worth it"
    return (
        f"{name} {copper} of copper and {bridge} in the inverter{of_leg}: {total}{_voltage(trade)}"
    )


def _change(saved: float, *, many: bool) -> str:
    word = "save" if saved >= 0.0 else "cost"
    return f"{word if many else word + 's'} {watts(abs(saved))}"


def _voltage(trade: Trade) -> str:
    """What a topology changes in voltage, from a volt on."""
    if trade.link_saved > 1.0:
        return f"; the link could be {trade.link_saved:.0f} V lower"
    if trade.link_saved < -1.0:
        return f"; the link must be {-trade.link_saved:.0f} V higher"
    return ""
