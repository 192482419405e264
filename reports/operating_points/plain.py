"""Operating points as plain data."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.optimizer.operating_points.current_choice import OperatingPoints, SpeedPoint
from dqforge.optimizer.operating_points.mtpa_locus import PerUnitBase
from dqforge.optimizer.operating_points.solve import Curves
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.labels import significant
from dqforge.reports.plain_data import PlainData


def plain_speed(speed: SpeedPoint | None) -> PlainData | None:
    """The speed for which currents weaken the field, and the voltage that they keep there."""
    return None if speed is None else {"omega_m_rad_per_s": speed.omega_m, "v_max_V": speed.v_max}


def _plain_points(points: OperatingPoints) -> PlainData:
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
        "chosen": _plain_points(curves.chosen),
        "id0": None if curves.id0 is None else _plain_points(curves.id0),
        "base": None
        if curves.base is None
        else {"current_A": curves.base.current, "torque_Nm": curves.base.torque},
    }


# Operating points as tables of the terminal.


def _point_rows(points: OperatingPoints, base: PerUnitBase | None) -> tuple[tuple[str, ...], ...]:
    indices = np.unique(np.linspace(0, points.torque.size - 1, 11).round().astype(int))
    rows = []
    for k in indices:
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
            "held by the data: the flux map ends there, currents of less loss may lie beyond it"
        )
    base = curves.base
    per_unit_columns = () if base is None else ("torque p.u.", "i_d p.u.", "i_q p.u.")
    if base is not None:
        notes.append(
            f"per unit of {base.current:.5g} A and {base.torque:.5g} N m (the bases of the MTPA "
            "curve)"
        )
    columns = ("torque N m", "i_d A", "i_q A", "|i| A", *per_unit_columns, "limited by")
    tables = [
        Table(
            f"{design.name}: {design.strategy}",
            columns,
            _point_rows(curves.chosen, base),
            tuple(notes),
        )
    ]
    if negative is not None:
        rows = _point_rows(
            replace(negative.chosen, torque=-negative.chosen.torque, i_q=-negative.chosen.i_q), None
        )
        tables.append(Table(f"{design.name}: {design.strategy}, negative torques", columns, rows))
    return tables
