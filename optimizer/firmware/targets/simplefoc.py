"""SimpleFOC: the members of its motor for a design, and the loops that it then runs."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    LoopProfile,
    Number,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod, Shortfall, number
from dqforge.optimizer.firmware.simplefoc_format import (
    FOC_CURRENT,
    LOOP_PERIOD,
    V_DC,
    VERSION,
    as_printed,
    configuration,
    flux_or_kv,
    loop_period,
    set_or_default,
    speed_period,
)
from dqforge.optimizer.firmware.simplefoc_format import shortfalls as found_shortfalls

SOURCES = (
    "simplefoc/Arduino-FOC 7f9c45f src/common/pid.cpp:41: trapezoid, integral clamped",
    "simplefoc/Arduino-FOC 7f9c45f src/common/base_classes/FOCMotor.cpp:543,650: loop, decoupling",
    "simplefoc/Arduino-FOC 7f9c45f src/common/lowpass_filter.cpp: share T/(T + Tf)",
    "simplefoc/Arduino-FOC 7f9c45f src/BLDCMotor.cpp:38,144: constructor, KV",
    "simplefoc/Arduino-FOC 7f9c45f src/communication/Commander.cpp:131-263: lines",
)

# The library's filter on the speed in s, which is kept where nothing faster is needed.
SPEED_FILTER = 0.005
_FILTER_SHARE = 0.1
_MODULATION = {0: "spwm", 1: "svpwm"}


def rule(inductance: float, r_s: float, bandwidth: float) -> dict[str, float]:
    """The library's own gains (tuneCurrentController): P = 2 pi f L, I = 2 pi f R, and the filter
    at five times that frequency.

    Args:
        inductance, r_s: Of a phase, in H and Ohm.
        bandwidth: In Hz.
    """
    omega = 2.0 * math.pi * bandwidth
    return {"P": inductance * omega, "I": r_s * omega, "Tf": 1.0 / (5.0 * omega)}


def configure(asked: Asked) -> Configuration:
    """The members for a design.

    Raises:
        InputError: A value that they need is missing, or a current loop is faster than half the
            rate of the library's loop, which it refuses itself.
    """
    drive = asked.drive
    own: dict[str, OwnValue] = dict(_machine(drive))
    own |= {"foc_modulation": 1, "torque_controller": FOC_CURRENT}
    own |= {"controller": 0 if asked.speed is None else 1}
    for axis, gains, inductance in (
        ("q", asked.current_q, drive.l_q),
        ("d", asked.current_d, drive.l_d),
    ):
        own |= _current(axis, gains, inductance, drive)
    if asked.speed is not None:
        own |= _speed(asked, asked.speed)
    own |= _limits(drive, with_speed=asked.speed is not None)
    return configuration(asked.design.name, own)


def profile(found: Configuration) -> LoopProfile:
    """The loops that SimpleFOC runs with a configuration.

    Raises:
        InputError: It does not control the currents.
    """
    if found.current_d is None or found.current_q is None:
        raise InputError(
            "this configuration of SimpleFOC does not control the currents; set torque_controller "
            "to TorqueControlType::foc_current"
        )
    own, pi = found.own, {}
    for axis, gains in (("d", found.current_d), ("q", found.current_q)):
        pi[axis] = PiController(
            gains.kp,
            gains.ki,
            loop_period(own),
            rule="trapezoid",
            anti_windup="clamp",
            limit=number(own, f"PID_current_{axis}.limit") or number(own, "voltage_limit"),
            filter_time=set_or_default(own, f"LPF_current_{axis}.Tf"),
        )
    current = CurrentLoops(
        d=pi["d"],
        q=pi["q"],
        delay=1.0,
        cross=number(own, "axis_inductance.q") is not None,
        back_emf=False,
        order="axes",
        voltage_share=_share(own),
        modulation=_MODULATION.get(int(set_or_default(own, "foc_modulation")), "svpwm"),
    )
    return LoopProfile("simplefoc", found.version, current, _speed_loop(found), sources=SOURCES)


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the configuration cannot hold of what was asked."""
    return found_shortfalls(asked, held, profile(held))


def _machine(drive: DriveValues) -> dict[str, Number]:
    if drive.pole_pairs is None or drive.r_s is None or drive.l_d is None or drive.l_q is None:
        raise InputError("machine: SimpleFOC needs pole pairs, resistance and inductances")
    if not drive.psi_pm or drive.psi_pm < 0.0:
        raise InputError(
            "machine.magnet_flux: SimpleFOC makes its KV of the flux of magnets; a machine without "
            "any needs another firmware"
        )
    if drive.v_dc is None or drive.t_s is None:
        raise InputError("inverter.v_dc: SimpleFOC needs the link's voltage; give it")
    return {
        V_DC: as_printed(drive.v_dc),
        LOOP_PERIOD: as_printed(drive.t_s),
        "pole_pairs": drive.pole_pairs,
        "phase_resistance": as_printed(drive.r_s),
        "axis_inductance.d": as_printed(drive.l_d),
        "axis_inductance.q": as_printed(drive.l_q),
        "KV_rating": as_printed(flux_or_kv(drive.pole_pairs, drive.psi_pm)),
    }


def _current(
    axis: str, gains: PiGains, inductance: float | None, drive: DriveValues
) -> dict[str, Number]:
    """Gains of one axis; no filter on its current, whose lag the loop would pay for."""
    assert inductance is not None
    assert drive.t_s is not None
    crossover, most = gains.kp / inductance / (2.0 * math.pi), 0.5 / drive.t_s
    if crossover > most:
        raise InputError(
            f"control.current_loop: {crossover:.4g} Hz of the {axis} axis are more than half of "
            f"the {1.0 / drive.t_s:.4g} Hz of SimpleFOC's loop, which it refuses; ask for at most "
            f"{most:.4g} Hz"
        )
    return {
        f"PID_current_{axis}.P": as_printed(gains.kp),
        f"PID_current_{axis}.I": as_printed(gains.ki),
        f"PID_current_{axis}.D": 0.0,
        f"PID_current_{axis}.output_ramp": 0.0,
        f"LPF_current_{axis}.Tf": 0.0,
    }


def _speed(asked: Asked, gains: PiGains) -> dict[str, Number]:
    drive, settings = asked.drive, asked.design.control.speed_loop
    filter_time = 0.0 if settings is None else settings.filter_time
    if not filter_time:
        filter_time = SPEED_FILTER
        if drive.inertia and drive.pole_pairs and drive.psi_pm:
            constant = 1.5 * drive.pole_pairs * drive.psi_pm
            filter_time = min(filter_time, _FILTER_SHARE * drive.inertia / (constant * gains.kp))
    ratio = round(drive.t_speed / drive.t_s) if drive.t_speed and drive.t_s else 1
    return {
        "motion_downsample": max(ratio, 1) - 1,
        "PID_velocity.P": as_printed(gains.kp),
        "PID_velocity.I": as_printed(gains.ki),
        "PID_velocity.D": 0.0,
        "PID_velocity.output_ramp": 0.0,
        "LPF_velocity.Tf": as_printed(filter_time),
    }


def _limits(drive: DriveValues, *, with_speed: bool) -> dict[str, Number]:
    if drive.i_max is None:
        raise InputError("machine.max_current: SimpleFOC needs a largest current; give it")
    volts = voltage_limit(as_printed(drive.v_dc or 0.0))
    limits: dict[str, Number] = {
        "current_limit": as_printed(drive.i_max),
        "voltage_limit": volts,
        "PID_current_q.limit": volts,
        "PID_current_d.limit": volts,
    }
    if with_speed:
        limits["PID_velocity.limit"] = as_printed(drive.i_max)
    if drive.omega_m_max is not None:
        limits["velocity_limit"] = as_printed(drive.omega_m_max)
    return limits


def voltage_limit(v_dc: float) -> float:
    """Largest phase voltage in V of space-vector modulation, as it is written."""
    return as_printed(v_dc / math.sqrt(3.0))


def _share(own: Mapping[str, OwnValue]) -> float:

    limit, v_dc = number(own, "voltage_limit"), number(own, V_DC)
    if not limit or not v_dc:
        return 1.0
    return min(1.0, as_printed(limit * math.sqrt(3.0) / v_dc))


def _speed_loop(found: Configuration) -> SpeedController | None:
    """The filter runs where the speed is asked for: in move(), with the controller."""
    if found.speed is None:
        return None
    own, period = found.own, speed_period(found.own)
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        period,
        rule="trapezoid",
        anti_windup="clamp",
        limit=number(own, "PID_velocity.limit") or found.drive.i_max,
    )
    feedback = SpeedEstimate("low-pass", period, filter_time=set_or_default(own, "LPF_velocity.Tf"))
    return SpeedController(pi, feedback)


SIMPLEFOC = FirmwareMethod("simplefoc", VERSION, "axes", configure, profile, shortfalls)
