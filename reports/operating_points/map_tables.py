"""Tables and plain data of operating points under the voltage limit, of envelopes and of maps."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.flux_map import TorqueRipple
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.operating_points.characteristics import (
    Characteristics,
    DrivePoints,
    Envelope,
    Loci,
    OperatingMap,
    VoltageLimit,
)
from dqforge.optimizer.operating_points.current_choice import OperatingPoints, SpeedPoint
from dqforge.optimizer.operating_points.mtpa_locus import Active, MtpaLocus, PerUnitBase
from dqforge.optimizer.operating_points.points import DriveLosses, OptimalPoints
from dqforge.optimizer.operating_points.solve import Curves
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import significant
from dqforge.reports.plain_data import PlainData

_ENVELOPE_ROWS = 13


def _number(value: float) -> str:
    """Four digits, no exponent up to ten millions."""
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value + 0.0:.4g}"


def _limit_note(limit: VoltageLimit) -> str:
    kept = f", {100.0 * limit.margin:.3g} % kept free" if limit.margin else ""
    return (
        f"voltage limit {limit.v_max:.4g} V (phase amplitude): {limit.made_by} at "
        f"{limit.v_dc:.4g} V dc{kept}"
    )


def _point_row(points: OptimalPoints, losses: DriveLosses, k: int) -> tuple[str, ...]:
    label = Active(int(points.active[k])).label
    return (
        _number(in_rpm(points.omega_m[k])),
        _number(points.torque_request[k]),
        _number(points.torque[k])
        if points.reached[k]
        else f"{_number(points.torque[k])} (no more)",
        _number(points.i_d[k]),
        _number(points.i_q[k]),
        _number(float(np.hypot(points.i_d[k], points.i_q[k]))),
        _number(points.voltage[k]),
        _number(losses.copper[k]),
        _number(losses.total[k]),
        label,
    )


def points_tables(
    design: Design, found: DrivePoints, limit: VoltageLimit, objective: str
) -> list[Table]:
    """One row per operating point: what was asked for, what can be had, what it loses,
    and what holds it.

    ``objective`` says which loss was minimised: ``copper`` or ``total``.
    """
    columns = (
        "speed rpm",
        "T_ref N m",
        "torque N m",
        "i_d A",
        "i_q A",
        "|i| A",
        "voltage V",
        "copper W",
        "total W",
        "held by",
    )
    points = found.points
    rows = tuple(_point_row(points, found.losses, k) for k in range(points.torque.size))
    worst = float(np.max(points.kkt_residual, initial=0.0))
    violation = f"largest violation of the optimality conditions {worst:.1e} (relative)"
    notes = (_limit_note(limit), violation, *_extrapolation_notes(points))
    title = f"{design.name}: least {objective} loss within the limits"
    return [Table(title, columns, rows, notes), *_harmonics_tables(found), *_of_points(found)]


def _harmonics_tables(found: DrivePoints) -> list[Table]:
    """What overmodulation adds where the points need it."""
    ripple, points = found.harmonics, found.points
    if ripple is None or not np.any(ripple.distortion > 0.0):
        return []
    columns = ("speed rpm", "torque N m", "of six-step %", "distortion %", "ripple A", "peak A")
    torque = ("torque p-p N m", "6th N m", "12th N m", "copper W")
    rows = tuple(
        (
            _number(in_rpm(points.omega_m[k])),
            _number(points.torque[k]),
            _number(100.0 * ripple.index[k]),
            _number(100.0 * ripple.distortion[k]),
            _number(ripple.current[k]),
            _number(ripple.peak_current[k]),
            _number(ripple.torque[k]),
            _number(ripple.torque_6[k]),
            _number(ripple.torque_12[k]),
            _number(ripple.copper[k]),
        )
        for k in np.flatnonzero(ripple.distortion > 0.0)
    )
    note = (
        "ripple of a phase current (r.m.s.), peak of the current vector, torque peak to peak and "
        "at 6 and 12 times the fundamental, copper loss beside that of the fundamental"
    )
    return [Table("Low harmonics beyond the linear range", (*columns, *torque), rows, (note,))]


def _of_points(found: DrivePoints) -> list[Table]:
    every = np.arange(found.points.torque.size)
    return _turning_tables(found.turning, found.points.torque, every)


def _turning_tables(
    ripple: TorqueRipple | None, torque: FloatArray, rows: IndexArray
) -> list[Table]:
    """Torque over the rotor angle at some of the points, where the map knows it."""
    if ripple is None:
        return []
    orders = tuple(f"order {order:g} N m" for order in ripple.orders)
    columns = ("torque N m", "peak to peak N m", "of the torque %", *orders)
    relative = ripple.over(torque)
    cells = tuple(
        (
            _number(torque[k]),
            _number(ripple.peak_to_peak[k]),
            _number(100.0 * relative[k]) if torque[k] else "-",
            *(_number(part[k]) for part in ripple.amplitudes),
        )
        for k in rows
    )
    note = "at constant currents, from the flux map; amplitudes by order per electrical turn"
    return [Table("Torque ripple over the rotor angle", columns, cells, (note,))]


def _plain_turning(ripple: TorqueRipple | None, torque: FloatArray) -> PlainData:
    if ripple is None:
        return {}
    parts = {
        "orders": list(ripple.orders),
        "peak_to_peak_Nm": ripple.peak_to_peak,
        "relative": ripple.over(torque),
        "amplitudes_Nm": ripple.amplitudes,
    }
    return {"torque_ripple": parts}


def _extrapolation_notes(points: OptimalPoints) -> tuple[str, ...]:
    beyond, held = (
        int(np.count_nonzero(points.extrapolated)),
        int(np.count_nonzero(points.active == Active.DATA)),
    )
    notes = (
        [f"{beyond} of {points.extrapolated.size} points lie beyond the flux map: extrapolated"]
        if beyond
        else []
    )
    if held:
        notes.append(
            f"{held} of {points.active.size} points are held by the data: better ones may lie "
            "beyond the flux map"
        )
    return tuple(notes)


_HELD_BY = {
    Active.NONE: "nothing: the unlimited optimum",
    Active.VOLTAGE: "voltage: the field is weakened",
    Active.CURRENT: "current",
    Active.BOTH: "current and voltage",
    Active.MTPV: "voltage: most torque per volt (MTPV)",
    Active.UNREACHABLE: "voltage: no current keeps it",
    Active.DATA: "the data: the flux map ends there",
}


def _watts(value: float) -> str:
    return f"{value:.4g} W" if math.isfinite(value) else "none"


def _loss_rows(losses: DriveLosses) -> list[tuple[str, str]]:
    """Rows of the first point; without device data the inverter is left out."""
    rows = [("copper loss", _watts(float(losses.copper[0])))]
    if losses.iron[0] > 0.0:
        rows.append(("iron loss", _watts(float(losses.iron[0]))))
    if losses.with_inverter:
        rows += [
            ("conduction loss", _watts(float(losses.conduction[0]))),
            ("switching loss", _watts(float(losses.switching[0]))),
        ]
    if len(rows) > 1:
        rows.append(("total loss", _watts(float(losses.total[0]))))
    if losses.with_inverter:
        rows.append(("junction", f"{losses.junction_temperature[0]:.4g} degC"))
    return rows


def point_tables(
    design: Design, found: DrivePoints, most: OptimalPoints, limit: VoltageLimit, objective: str
) -> list[Table]:
    """One operating point in detail; ``most`` is the most torque in its direction at its speed."""
    points, share = found.points, float(found.efficiency[0])
    torque, voltage = float(points.torque[0]), float(points.voltage[0])
    short = "" if points.reached[0] else " (no more)"
    current = float(np.hypot(points.i_d[0], points.i_q[0]))
    rows = [
        ("speed", f"{_number(in_rpm(points.omega_m[0]))} rpm"),
        ("requested torque", f"{_number(points.torque_request[0])} N m"),
        ("torque", f"{_number(torque)} N m{short}"),
        ("held by", _HELD_BY[Active(int(points.active[0]))]),
        ("i_d, i_q", f"{_number(points.i_d[0])} A, {_number(points.i_q[0])} A"),
        ("current", f"{current:.4g} A, {100.0 * current / design.i_max:.3g} % of the limit"),
        ("phase voltage", f"{voltage:.4g} V, {100.0 * voltage / limit.v_max:.3g} % of the limit"),
        ("mechanical power", f"{_number(float(found.power[0]) * 1e-3)} kW"),
        *_loss_rows(found.losses),
        ("efficiency", f"{100.0 * share:.2f} %" if math.isfinite(share) else "none"),
        (
            "most torque here",
            f"{_number(most.torque[0])} N m, held by {_HELD_BY[Active(int(most.active[0]))]}",
        ),
        ("optimality residual", f"{points.kkt_residual[0]:.1e} (relative)"),
    ]
    notes = (
        "currents and voltages are peak of phase",
        _limit_note(limit),
        *_extrapolation_notes(points),
    )
    return [
        Table(
            f"{design.name}: operating point of least {objective} loss",
            ("", ""),
            tuple(rows),
            notes,
        ),
        *_harmonics_tables(found),
        *_of_points(found),
    ]


def _envelope_rows(envelope: Envelope) -> tuple[tuple[str, ...], ...]:
    """Rows at even speeds and where what holds the most torque changes."""
    points, braking = envelope.points, envelope.braking
    even = np.linspace(points.omega_m[0], points.omega_m[-1], _ENVELOPE_ROWS)
    near = np.abs(points.omega_m[:, np.newaxis] - even).argmin(axis=0)
    changes = np.flatnonzero(np.diff(points.active)) + 1
    return tuple(
        (
            _number(in_rpm(points.omega_m[k])),
            _number(points.torque[k]),
            _number(envelope.power[k] * 1e-3),
            _number(points.i_d[k]),
            _number(points.i_q[k]),
            _number(float(np.hypot(points.i_d[k], points.i_q[k]))),
            _number(points.voltage[k]),
            Active(int(points.active[k])).label,
            _number(braking.torque[k]),
        )
        for k in np.unique(np.concatenate([near, changes]))
    )


def _held_text(figures: Characteristics, name: str) -> str:
    return ", held by the data" if name in figures.held else ""


def envelope_tables(
    design: Design,
    figures: Characteristics,
    envelope: Envelope,
    chart: OperatingMap,
    limit: VoltageLimit,
) -> list[Table]:
    """Figures of the drive, and the largest torque over speed."""
    current = figures.characteristic_current
    end = figures.speed_max
    power = f"{figures.power_max * 1e-3:.4g} kW at {_number(in_rpm(figures.power_speed))} rpm"
    last = "any speed" if end is None else f"{_number(in_rpm(end))} rpm"
    rows = (
        ("largest torque", f"{figures.torque_max:.4g} N m{_held_text(figures, 'torque_max')}"),
        (
            "base speed",
            f"{_number(in_rpm(figures.base_speed))} rpm{_held_text(figures, 'base_speed')}",
        ),
        ("largest power", f"{power}{_held_text(figures, 'power_max')}"),
        ("characteristic current", "none" if current is None else f"{current:.4g} A (peak)"),
        ("voltage limit can be kept up to", f"{last}{_held_text(figures, 'speed_max')}"),
    )
    columns = (
        "speed rpm",
        "torque N m",
        "power kW",
        "i_d A",
        "i_q A",
        "|i| A",
        "voltage V",
        "held by",
        "braking N m",
    )
    worst = float(np.max(chart.points.kkt_residual, initial=0.0))
    reached = int(np.count_nonzero(chart.points.reached))
    note = (
        f"map: {reached} of {chart.points.reached.size} points can be reached; largest violation "
        f"{worst:.1e}"
    )
    iron = ["iron"] if np.any(chart.losses.iron > 0.0) else []
    parts = ["copper", *iron, *(["conduction", "switching"] if chart.with_inverter else [])]
    losses = f"{', '.join(parts)} loss" if len(parts) > 1 else "copper loss alone"
    best_text = f"best efficiency on the map {100.0 * chart.best_efficiency:.2f} % (with {losses})"
    notes = (note, best_text, *_extrapolation_notes(chart.points))
    return [
        Table(f"{design.name}: limits", ("", ""), rows, (_limit_note(limit),)),
        Table("Most torque over speed", columns, _envelope_rows(envelope), notes),
    ]


def _plain_points(points: OptimalPoints) -> PlainData:
    return {
        "torque_request_Nm": points.torque_request,
        "torque_Nm": points.torque,
        "omega_m_rad_per_s": points.omega_m,
        "i_d_A": points.i_d,
        "i_q_A": points.i_q,
        "current_A": np.hypot(points.i_d, points.i_q),
        "voltage_V": points.voltage,
        "minimised_W": points.loss,
        "held_by": [Active(int(code)).label for code in points.active],
        "reached": points.reached,
        "kkt_residual": points.kkt_residual,
        "extrapolated": points.extrapolated,
    }


def _plain_limit(limit: VoltageLimit) -> PlainData:
    return {
        "modulation": limit.modulation,
        "topology": limit.topology,
        "v_dc_V": limit.v_dc,
        "margin": limit.margin,
        "v_max_V": limit.v_max,
    } | ({} if limit.overmodulation == "none" else {"overmodulation": limit.overmodulation})


def _plain_harmonics(found: DrivePoints) -> PlainData:
    """What overmodulation adds, of `plain_points`; empty without."""
    ripple = found.harmonics
    if ripple is None:
        return {}
    return {
        "overmodulation": {
            "index": ripple.index,
            "distortion": ripple.distortion,
            "harmonics_V": ripple.voltage,
            "current_rms_A": ripple.current,
            "current_peak_A": ripple.peak_current,
            "torque_ripple_Nm": ripple.torque,
            "torque_6_Nm": ripple.torque_6,
            "torque_12_Nm": ripple.torque_12,
            "copper_W": ripple.copper,
        }
    }


def _plain_losses(losses: DriveLosses) -> PlainData:
    """Losses as arrays; those of an inverter without device data are None."""
    inverter = (losses.conduction, losses.switching, losses.junction_temperature)
    conduction, switching, junction = inverter if losses.with_inverter else (None, None, None)
    return {
        "copper_W": losses.copper,
        "iron_W": losses.iron,
        "conduction_W": conduction,
        "switching_W": switching,
        "total_W": losses.total,
        "junction_degC": junction,
    }


def _plain_locus(locus: MtpaLocus) -> PlainData:
    return {
        "torque_Nm": locus.torque,
        "i_d_A": locus.i_d,
        "i_q_A": locus.i_q,
        "held_by_data": locus.held,
    }


def plain_points(
    found: DrivePoints, most: OptimalPoints, limit: VoltageLimit, objective: str
) -> PlainData:
    """Operating points as arrays, their losses, the most torque at the speed,
    and the voltage limit they keep.
    """
    return {
        "limit": _plain_limit(limit),
        "objective": objective,
        "points": _plain_points(found.points),
        "losses": _plain_losses(found.losses),
        "power_W": found.power,
        "efficiency": found.efficiency,
        "most_torque": _plain_points(most),
        **_plain_harmonics(found),
        **_plain_turning(found.turning, found.points.torque),
    }


def plain_map(
    figures: Characteristics,
    envelope: Envelope,
    chart: OperatingMap,
    lines: Loci,
    limit: VoltageLimit,
) -> PlainData:
    """Characteristics, envelope and map.

    The map's points run through the speeds of the first torque, then the next.
    """
    return {
        "limit": _plain_limit(limit),
        "characteristics": {
            "torque_max_Nm": figures.torque_max,
            "base_speed_rad_per_s": figures.base_speed,
            "power_max_W": figures.power_max,
            "power_speed_rad_per_s": figures.power_speed,
            "characteristic_current_A": figures.characteristic_current,
            "speed_max_rad_per_s": figures.speed_max,
            "held_by_data": figures.held,
        },
        "envelope": _plain_points(envelope.points) | {"power_W": envelope.power},
        "braking_envelope": _plain_points(envelope.braking) | {"power_W": envelope.braking_power},
        "loci": {
            "i_max_A": lines.i_max,
            "mtpa": _plain_locus(lines.mtpa),
            "mtpv": _plain_points(lines.mtpv),
        },
        "map": {
            "torque_Nm": chart.torque,
            "omega_m_rad_per_s": chart.omega_m,
            "points": _plain_points(chart.points),
            "losses": _plain_losses(chart.losses),
            "loss_W": chart.loss,
            "efficiency": chart.efficiency,
            "best_efficiency": chart.best_efficiency,
        },
    }


# Operating points as plain data.


def plain_speed(speed: SpeedPoint | None) -> PlainData | None:
    """The speed for which currents weaken the field, and the voltage that they keep there."""
    return None if speed is None else {"omega_m_rad_per_s": speed.omega_m, "v_max_V": speed.v_max}


def _plain_plain_points(points: OperatingPoints) -> PlainData:
    return {
        "torque_Nm": points.torque,
        "i_d_A": points.i_d,
        "i_q_A": points.i_q,
        "current_A": np.hypot(points.i_d, points.i_q),
        "copper_W": points.copper,
        "limited": points.limited,
        "held_by_data": points.held,
        "torque_residual_largest": float(np.max(np.abs(points.torque_residual))),
    }


def plain_curves(curves: Curves) -> PlainData:
    """Operating points over torque."""
    saving = curves.saving
    return {
        "holds_at": plain_speed(curves.speed),
        "saving": None
        if saving is None
        else {
            "torque_Nm": saving.torque,
            "copper_W": saving.chosen,
            "copper_id0_W": saving.id0,
            "relative": saving.relative,
        },
        "chosen": _plain_plain_points(curves.chosen),
        "id0": None if curves.id0 is None else _plain_plain_points(curves.id0),
        "base": None
        if curves.base is None
        else {"current_A": curves.base.current, "torque_Nm": curves.base.torque},
        **_plain_turning(curves.turning, curves.chosen.torque),
    }


# Operating points as tables of the terminal.


def _shown(points: OperatingPoints) -> IndexArray:
    return np.unique(np.linspace(0, points.torque.size - 1, 11).round().astype(np.intp))


def _point_rows(points: OperatingPoints, base: PerUnitBase | None) -> tuple[tuple[str, ...], ...]:
    rows = []
    for k in _shown(points):
        torque, i_d, i_q = (float(values[k]) for values in (points.torque, points.i_d, points.i_q))
        cells = [torque, i_d, i_q, float(np.hypot(i_d, i_q))]
        if base is not None:
            cells += [torque / base.torque, i_d / base.current, i_q / base.current]
        rows.append((*(significant(cell) for cell in cells), _held_by(points, int(k))))
    return tuple(rows)


def _held_by(points: OperatingPoints, k: int) -> str:
    if points.held[k]:
        return "the data"
    return "current limit" if points.limited[k] else ""


def mtpa_tables(design: Design, curves: Curves, negative: Curves | None = None) -> list[Table]:
    """Currents over torque for the design's strategy, and what i_d = 0 would draw
    at the end of the domain.

    ``negative`` are those of negative torques, mirrored, where these have their own.
    """
    notes = [f"limit {design.i_max:.4g} A (peak); currents are peak of phase"]
    if curves.id0 is not None and design.strategy == "mtpa":
        chosen = float(np.hypot(curves.chosen.i_d[-1], curves.chosen.i_q[-1]))
        if not curves.id0.limited[-1]:
            notes.append(
                f"i_d = 0 draws {curves.id0.i_q[-1]:.4g} A at the last torque, {design.strategy} "
                f"{chosen:.4g} A"
            )
        else:
            notes.append(f"i_d = 0 reaches {curves.id0.torque[-1]:.4g} N m within the limit")
    if np.any(curves.chosen.held):
        notes.append(
            "limited by the data: the flux map ends there, currents of less loss may lie beyond it"
        )
    base = curves.base
    per_unit_columns = () if base is None else ("torque p.u.", "i_d p.u.", "i_q p.u.")
    if base is not None:
        notes.append(
            f"p.u.: of i_base = psi_pm/(2 |l_q - l_d|) = {base.current:.5g} A and T_base = "
            f"3/4 p psi_pm i_base = {base.torque:.5g} N m"
        )
    columns = ("torque N m", "i_d A", "i_q A", "|i| A", *per_unit_columns, "limited by")
    tables = [
        Table(
            f"{design.name}: {design.strategy}",
            columns,
            _point_rows(curves.chosen, base),
            tuple(notes),
        ),
        *_turning_tables(curves.turning, curves.chosen.torque, _shown(curves.chosen)),
    ]
    if negative is not None:
        rows = _point_rows(
            replace(negative.chosen, torque=-negative.chosen.torque, i_q=-negative.chosen.i_q), None
        )
        tables.append(Table(f"{design.name}: {design.strategy}, negative torques", columns, rows))
    return tables
