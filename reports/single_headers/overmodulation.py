"""Overmodulation as words, tables, JSON, HTML and a figure."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.operating_points.characteristics import Characteristics
from dqforge.optimizer.overmodulation import LargestTorque, Overmodulation
from dqforge.optimizer.solution import Solution
from dqforge.reports.capability import Capability, Passage, Quantity, ReportPart, Rows
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row
from dqforge.reports.pages.templating import MODULATION
from dqforge.reports.plain_data import PlainData

ASSUMED = (
    "At constant speed; the current controllers are taken to leave the harmonics alone. Faster "
    "than about the frequency of the fundamental they answer them, and raise them."
)


def reach_text(found: Overmodulation) -> str:
    """How far the fundamental reaches, and how far it did."""
    volts, linear = (format_quantity(x, "V", 4) for x in (found.v_max, found.linear_v_max))
    return (
        f"{found.method}, up to {100.0 * found.limit:.4g} % of six-step operation: {volts} instead "
        f"of {linear}"
    )


def gain_text(largest: LargestTorque) -> str:
    """What that gives the machine."""
    speeds = [
        format_quantity(figures.base_speed, "rpm", 4)
        for figures in (largest.figures, largest.linear_figures)
    ]
    powers = [
        format_quantity(figures.power_max, "W", 4)
        for figures in (largest.figures, largest.linear_figures)
    ]
    return (
        f"base speed {speeds[0]} instead of {speeds[1]}, largest power {powers[0]} instead of "
        f"{powers[1]}"
    )


def _percent(value: float) -> str:
    return f"{100.0 * value:.2f}"


def voltage_rows(found: Overmodulation) -> list[tuple[str, ...]]:
    """Index, and each order over the fundamental, in percent."""
    return [
        (_percent(index), *(_percent(value) for value in row))
        for index, row in zip(found.index, found.voltage, strict=True)
    ]


def _voltage_columns(found: Overmodulation) -> tuple[str, ...]:
    return ("of six-step %", *(f"order {order} %" for order in found.orders))


POINT_COLUMNS = (
    "speed rpm", "torque N m", "linear N m", "of six-step %", "ripple A", "peak A",
    "torque p-p N m", "6th N m", "12th N m", "copper W",
)  # fmt: skip


def point_rows(largest: LargestTorque) -> list[tuple[str, ...]]:
    """The points of most torque with what the harmonics do there."""
    points, ripple = largest.points, largest.harmonics
    columns = (
        in_rpm(points.omega_m), points.torque, largest.linear_torque, 100.0 * ripple.index,
        ripple.current, ripple.peak_current, ripple.torque, ripple.torque_6, ripple.torque_12,
        ripple.copper,
    )  # fmt: skip
    return [
        tuple(f"{value:.4g}" if math.isfinite(value) else "-" for value in row)
        for row in np.stack(columns, axis=-1)
    ]


def overmodulation_tables(found: Overmodulation) -> list[Table]:
    """Harmonics over the index, and the largest torque with its ripple."""
    title = f"Overmodulation: {reach_text(found)}"
    tables = [
        Table(
            title,
            _voltage_columns(found),
            tuple(voltage_rows(found)),
            ("harmonics of the phase voltage over its fundamental",),
        )
    ]
    if found.largest is not None:
        tables.append(
            Table(
                f"Largest torque beyond the linear range: {gain_text(found.largest)}",
                POINT_COLUMNS,
                tuple(point_rows(found.largest)),
                (ASSUMED,),
            )
        )
    return tables


def overmodulation_passage(found: Overmodulation) -> Passage:
    """What the report prints of overmodulation."""
    title = "Harmonics of the phase voltage over its fundamental"
    rows = tuple(Row(row) for row in voltage_rows(found))
    tables, gain = [HtmlTable(title, _voltage_columns(found), rows, 0)], ""
    if found.largest is not None:
        title = "Largest torque beyond the linear range, and what the harmonics add"
        rows = tuple(Row(row) for row in point_rows(found.largest))
        tables.append(HtmlTable(title, POINT_COLUMNS, rows, 0))
        gain = f" That gives {gain_text(found.largest)}."
    text = (
        "Voltages beyond the linear range are made with the requested fundamental: "
        f"{reach_text(found)}.{gain} {ASSUMED}"
    )
    return Passage(text=[text], tables=tables)


# Plain data of overmodulation.


def plain_overmodulation(found: Overmodulation) -> PlainData:
    """What ``result.json`` says of overmodulation."""
    return {
        "method": found.method,
        "limit": found.limit,
        "v_max_V": found.v_max,
        "linear_v_max_V": found.linear_v_max,
        "index": found.index,
        "orders": list(found.orders),
        "voltage": found.voltage,
        "largest_torque": None if found.largest is None else _largest(found.largest),
    }


def _largest(largest: LargestTorque) -> PlainData:
    points, ripple = largest.points, largest.harmonics
    return {
        "omega_m_rad_per_s": points.omega_m,
        "torque_Nm": points.torque,
        "linear_torque_Nm": largest.linear_torque,
        "i_d_A": points.i_d,
        "i_q_A": points.i_q,
        "voltage_V": points.voltage,
        "index": ripple.index,
        "harmonics_V": ripple.voltage,
        "distortion": ripple.distortion,
        "current_rms_A": ripple.current,
        "current_peak_A": ripple.peak_current,
        "torque_ripple_Nm": ripple.torque,
        "torque_6_Nm": ripple.torque_6,
        "torque_12_Nm": ripple.torque_12,
        "copper_W": ripple.copper,
        "with": _figures(largest.figures),
        "without": _figures(largest.linear_figures),
    }


def _figures(figures: Characteristics) -> PlainData:
    return {
        "base_speed_rad_per_s": figures.base_speed,
        "power_max_W": figures.power_max,
        "power_speed_rad_per_s": figures.power_speed,
    }


# Overmodulation, as one record.


def _summary(_: Solution, found: Overmodulation) -> Rows:
    rows = [("overmodulation", reach_text(found))]
    return rows if found.largest is None else [*rows, ("  gives", gain_text(found.largest))]


def _parts(_: Solution, found: Overmodulation) -> list[ReportPart]:
    return [overmodulation_passage(found).of(MODULATION)]


OVERMODULATION = Capability(
    name="overmodulation",
    title="overmodulation",
    of=lambda outcome: outcome.solution.overmodulation,
    plain=lambda _, found: plain_overmodulation(found),
    summary=_summary,
    tables=lambda _, found: overmodulation_tables(found),
    parts=_parts,
    quantities=(
        Quantity("overmodulation", "largest fundamental", "V", ("overmodulation", "v_max_V")),
    ),
)
