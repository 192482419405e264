"""Plain data of overmodulation."""

from __future__ import annotations

from dqforge.optimizer.operating_points.characteristics import Characteristics
from dqforge.optimizer.overmodulation.solve import LargestTorque, Overmodulation
from dqforge.reports.plain_data import PlainData


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
