"""Errors of the speed observer as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dqforge.optimizer.observers.reduced_order import (
        ErrorsAtLoad,
        ObserverError,
        SpeedErrorSlopes,
    )
    from dqforge.reports.plain_data import PlainData


def plain_observer_errors(
    slopes: SpeedErrorSlopes | None, steady: tuple[ErrorsAtLoad, ...]
) -> PlainData:
    """Errors of the speed observer per unit of their causes and at loads; nothing without one."""
    if slopes is None:
        return {}

    def plain(error: ObserverError) -> PlainData:
        return {"i_q_A": error.i_q, "speed_rad_per_s": error.total, "relative": error.relative}

    at_loads = [
        {
            "omega_m_rad_per_s": found.exact.omega_m,
            "load_Nm": found.torque_load,
            "exact": plain(found.exact),
            "resistance_too_high": plain(found.resistance),
        }
        for found in steady
    ]
    return {
        "observer_errors": {
            "load_rad_per_s_per_Nm": slopes.load,
            "resistance_error": slopes.r_error,
            "resistance_rad_per_s_per_A": slopes.resistance,
            **({"steady": at_loads} if at_loads else {}),
        }
    }
