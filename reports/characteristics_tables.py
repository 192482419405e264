"""Tables and plain data of operating points under the voltage limit, of envelopes and of maps."""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design import Design
from dqforge.optimizer.characteristics import Characteristics, Envelope, OperatingMap, VoltageLimit
from dqforge.optimizer.operating_points import Active, OptimalPoints
from dqforge.reports.reference_ir import PlainData
from dqforge.reports.tables import Table

_RPM = 30.0 / math.pi
_ENVELOPE_ROWS = 13


def _number(value: float) -> str:
    return f"{value + 0.0:.4g}"


def _limit_note(limit: VoltageLimit) -> str:
    kept = f", {100.0 * limit.margin:.3g} % kept free" if limit.margin else ""
    return f"voltage limit {limit.v_max:.4g} V (phase amplitude): {limit.modulation} at {limit.v_dc:.4g} V dc{kept}"


def _point_row(points: OptimalPoints, k: int) -> tuple[str, ...]:
    label = Active(int(points.active[k])).label
    return (
        _number(points.omega_m[k] * _RPM),
        _number(points.torque_request[k]),
        _number(points.torque[k]) if points.reached[k] else f"{_number(points.torque[k])} (no more)",
        _number(points.i_d[k]),
        _number(points.i_q[k]),
        _number(float(np.hypot(points.i_d[k], points.i_q[k]))),
        _number(points.voltage[k]),
        _number(points.loss[k]),
        label,
    )


def points_tables(design: Design, points: OptimalPoints, limit: VoltageLimit) -> list[Table]:
    """One row per operating point: what was asked for, what can be had, and what holds it."""
    columns = ("speed rpm", "asked N m", "torque N m", "i_d A", "i_q A", "|i| A", "voltage V", "copper W", "held by")
    rows = tuple(_point_row(points, k) for k in range(points.torque.size))
    worst = float(np.max(points.kkt_residual, initial=0.0))
    notes = (_limit_note(limit), f"largest violation of the optimality conditions {worst:.1e} (relative)")
    return [Table(f"{design.name}: least copper loss within the limits", columns, rows, notes)]


def envelope_tables(
    design: Design, figures: Characteristics, envelope: Envelope, chart: OperatingMap, limit: VoltageLimit
) -> list[Table]:
    """Figures of the drive, and the largest torque over speed."""
    current = figures.characteristic_current
    end = figures.speed_max
    rows = (
        ("largest torque", f"{figures.torque_max:.4g} N m"),
        ("base speed", f"{figures.base_speed * _RPM:.4g} rpm"),
        ("largest power", f"{figures.power_max * 1e-3:.4g} kW at {figures.power_speed * _RPM:.4g} rpm"),
        ("characteristic current", "none" if current is None else f"{current:.4g} A (peak)"),
        ("voltage limit can be kept up to", "any speed" if end is None else f"{end * _RPM:.4g} rpm"),
    )
    points = envelope.points
    chosen = np.unique(np.linspace(0, points.torque.size - 1, _ENVELOPE_ROWS).round().astype(int))
    lines = tuple(
        (
            _number(points.omega_m[k] * _RPM),
            _number(points.torque[k]),
            _number(envelope.power[k] * 1e-3),
            _number(points.i_d[k]),
            _number(points.i_q[k]),
            Active(int(points.active[k])).label,
        )
        for k in chosen
    )
    columns = ("speed rpm", "torque N m", "power kW", "i_d A", "i_q A", "held by")
    worst = float(np.max(chart.points.kkt_residual, initial=0.0))
    reached = int(np.count_nonzero(chart.points.reached))
    note = f"map: {reached} of {chart.points.reached.size} points can be had; largest violation {worst:.1e}"
    best = float(np.nanmax(chart.efficiency)) if np.any(np.isfinite(chart.efficiency)) else math.nan
    losses = "copper, conduction and switching loss" if chart.with_inverter else "copper loss alone"
    efficiency = f"best efficiency on the map {100.0 * best:.2f} % (with {losses})"
    return [
        Table(f"{design.name}: limits", ("", ""), rows, (_limit_note(limit),)),
        Table("Most torque over speed", columns, lines, (note, efficiency)),
    ]


def _plain_points(points: OptimalPoints) -> PlainData:
    return {
        "torque_request_Nm": points.torque_request,
        "torque_Nm": points.torque,
        "omega_m_rad_per_s": points.omega_m,
        "i_d_A": points.i_d,
        "i_q_A": points.i_q,
        "voltage_V": points.voltage,
        "copper_W": points.loss,
        "held_by": [Active(int(code)).label for code in points.active],
        "reached": points.reached,
        "kkt_residual": points.kkt_residual,
    }


def _plain_limit(limit: VoltageLimit) -> PlainData:
    return {"modulation": limit.modulation, "v_dc_V": limit.v_dc, "margin": limit.margin, "v_max_V": limit.v_max}


def plain_points(points: OptimalPoints, limit: VoltageLimit) -> PlainData:
    """Operating points as arrays, with the voltage limit they keep."""
    return {"limit": _plain_limit(limit), "points": _plain_points(points)}


def plain_map(figures: Characteristics, envelope: Envelope, chart: OperatingMap, limit: VoltageLimit) -> PlainData:
    """Characteristics, envelope and map; the map's points run through the speeds of the first torque, then the next."""
    return {
        "limit": _plain_limit(limit),
        "characteristics": {
            "torque_max_Nm": figures.torque_max,
            "base_speed_rad_per_s": figures.base_speed,
            "power_max_W": figures.power_max,
            "power_speed_rad_per_s": figures.power_speed,
            "characteristic_current_A": figures.characteristic_current,
            "speed_max_rad_per_s": figures.speed_max,
        },
        "envelope": _plain_points(envelope.points),
        "map": {
            "torque_Nm": chart.torque,
            "omega_m_rad_per_s": chart.omega_m,
            "points": _plain_points(chart.points),
            "loss_W": chart.loss,
            "efficiency": chart.efficiency,
        },
    }
