"""Operating points as plain data."""

from __future__ import annotations

import numpy as np

from dqforge.optimizer.operating_points.current_choice import OperatingPoints, SpeedPoint
from dqforge.optimizer.operating_points.solve import Curves
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
