"""What to flash: the comparison as tables and plain data, and its rows in the simulation."""

from __future__ import annotations

import math

from dqforge.machines.design.design import Design
from dqforge.machines.names import CurrentFrame, Topology
from dqforge.optimizer.flashing_choice import (
    DEVIATIONS,
    WORTH,
    Advice,
    FlashComparison,
    FlashRow,
    RippleFigures,
    Trade,
)
from dqforge.reports.pages.answer import Table
from dqforge.reports.plain_data import PlainData

_RPM = 30.0 / math.pi


_COLUMNS = (
    "legs",
    "control",
    "ripple %",
    "copper W",
    "inverter W",
    "link V",
    "neutral A",
    "cycles",
    "table B",
    "",
)


_DEVIATIONS = {
    "offset": "a sensor 30 mA off",
    "noise": "30 mA of noise",
    "inductance": "L 30 % lower",
    "back_emf": "EMF 5 % higher",
}


def _number(value: float, digits: int = 3) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"


def _share(figures: RippleFigures | None, name: str | None = None) -> str:
    """Percent with two decimals; a dash where it is not known."""
    if figures is None:
        return "-"
    share = figures.plain if name is None else figures.deviating.get(name, math.nan)
    return f"{100.0 * share:.2f}" if math.isfinite(share) else "-"


def _cells(row: FlashRow, advice: Advice, *, without_device: bool) -> tuple[str, ...]:
    known = row.ripple_known
    best = advice.row is not None and (row.topology, row.frame) == (
        advice.row.topology,
        advice.row.frame,
    )
    return (
        TOPOLOGY_TEXT[row.topology],
        FRAME_TEXT[row.frame],
        _share(known),
        _number(row.copper, 4),
        "no device" if without_device else _number(row.bridge, 4),
        _number(row.link, 4),
        _number(row.neutral),
        "-" if row.cycles is None else f"{0.5 * sum(row.cycles):.0f}",
        str(row.constants) if row.constants else "-",
        "flash this" if best else row.obstacle,
    )


def flash_tables(design: Design, found: FlashComparison, advice: Advice) -> list[Table]:
    """Rows of topologies and controllers, the recommendation below them; then what the torque
    ripple becomes where sensors and machine are not what the firmware takes them for.
    """
    point = f"{found.torque:.4g} N m, {found.omega_m * _RPM:.4g} rpm, {found.v_dc:.4g} V"
    rows = tuple(_cells(row, advice, without_device=found.without_device) for row in found.rows)
    by = "of the emitted C in the compiled simulation"
    if found.unsimulated:
        by = f"by closed form ({found.unsimulated})"
    notes = [
        *advice_lines(advice),
        *_fault(found),
        (
            f"torque ripple, peak to peak of the means over a PWM period, {by}, with a dead time "
            f"of {1e6 * design.inverter.dead_time:.3g} us; table: with harmonic integrators"
        ),
    ]
    if found.uncounted:
        notes.append(f"no cycles: {found.uncounted}")
    if found.without_device:
        notes.append(
            "inverter W: the design has no inverter.device, nothing is known of the switches"
        )
    if design.inverter.midpoint_capacitance is None:
        notes.append(
            f"split-capacitor: with {1e3 * found.capacitance:.3g} mF in all, which hold the "
            "midpoint within 2 % of the link here"
        )
    main = Table(f"{design.name}: what to flash at {point}", _COLUMNS, rows, tuple(notes))
    columns = ("legs", "control", "as it is", *(_DEVIATIONS[name] for name in DEVIATIONS))
    sensitive = tuple(
        (
            TOPOLOGY_TEXT[row.topology],
            FRAME_TEXT[row.frame],
            _share(row.ripple_known),
            *(_share(row.ripple_known, name) for name in DEVIATIONS),
        )
        for row in found.rows
        if row.ripple_known is not None
    )
    return [main, Table("Torque ripple in % where something is not as assumed", columns, sensitive)]


def _fault(found: FlashComparison) -> list[str]:
    """What speaks for a neutral where a phase may fail."""
    price = found.without_phase
    if price is None:
        return []
    return [
        (
            "with a phase open a star's torque vanishes twice a period; with a neutral it stays "
            f"constant for {price.copper:.3g} times the copper, and the neutral's leg carries "
            f"{price.neutral:.2g} times the phase peak"
        )
    ]


def _plain_ripple(figures: RippleFigures | None) -> PlainData | None:
    return None if figures is None else {"plain": figures.plain, **figures.deviating}


def plain_flash(found: FlashComparison, advice: Advice) -> PlainData:
    """Rows, recommendation and what was left out."""
    rows = [
        {
            "topology": row.topology,
            "frame": row.frame,
            "obstacle": row.obstacle,
            "copper_W": row.copper,
            "bridge_W": row.bridge,
            "neutral_leg_W": row.neutral_leg,
            "link_V": row.link,
            "neutral_A": row.neutral,
            "table_B": row.constants,
            "ripple_closed_form": _plain_ripple(row.ripple),
            "ripple_simulated": _plain_ripple(row.simulated),
            "cycles": None if row.cycles is None else list(row.cycles),
        }
        for row in found.rows
    ]
    chosen = advice.row
    trades = [
        {
            "topology": trade.topology,
            "copper_saved_W": trade.copper_saved,
            "bridge_added_W": trade.bridge_added,
            "net_W": trade.net,
            "link_saved_V": trade.link_saved,
            "obstacle": trade.obstacle,
        }
        for trade in advice.trades
    ]
    return {
        "torque_Nm": found.torque,
        "omega_m_rad_per_s": found.omega_m,
        "v_dc_V": found.v_dc,
        "midpoint_capacitance_F": found.capacitance,
        "rows": rows,
        "flash": None if chosen is None else {"topology": chosen.topology, "frame": chosen.frame},
        "dq_ripple": advice.dq_ripple,
        "dq_saved_W": advice.dq_saved,
        "trades": trades,
        "words": [*advice_lines(advice), *_fault(found)],
        "unsimulated": found.unsimulated,
        "uncounted": found.uncounted,
    }


# The recommendation in plain words.

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
