"""What the properties of an ODrive 0.5 amount to: constants, gains and rates in SI units.

Facts of github.com/odriverobotics/ODrive, firmware 0.5.x: `MotorControl/motor.cpp`
(update_current_controller_gains, update), `foc.cpp` (get_alpha_beta_output), `controller.cpp`
(update), `encoder.cpp` (update_pll_gains, update), `odrive-interface.yaml` (names and types).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.one_bandwidth.odrive_sentences import contradictions, conventions
from dqforge.optimizer.firmware.own_values import FLOAT32_DIGITS, rounded

FIRMWARE: Firmware = "odrive"
VERSION = "0.5"
PWM_RATE = 24000.0  # In Hz: 168 MHz over two slopes of 3500 counts.

# Period in s of all controllers: every third period of the PWM (TIM_1_8_RCR 2).
PERIOD = 3.0 / PWM_RATE
HIGH_CURRENT = 0  # Motor type whose currents are controlled.
MEASURED_INDUCTANCE = (2e-6, 4000e-6)  # Inductances in H that the calibration of the motor accepts.

# Properties of an axis that mean something to loops and machine, in the order in which they are
# written: type before what depends on it.
KINDS: dict[str, type] = {
    "motor.config.motor_type": int,
    "motor.config.pre_calibrated": bool,
    "motor.config.pole_pairs": int,
    "motor.config.phase_resistance": float,
    "motor.config.phase_inductance": float,
    "motor.config.torque_constant": float,
    "motor.config.current_lim": float,
    "motor.config.current_lim_margin": float,
    "motor.config.requested_current_range": float,
    "motor.config.current_control_bandwidth": float,
    "motor.config.R_wL_FF_enable": bool,
    "motor.config.bEMF_FF_enable": bool,
    "controller.config.vel_gain": float,
    "controller.config.vel_integrator_gain": float,
    "controller.config.vel_limit": float,
    "controller.config.vel_ramp_rate": float,
    "controller.config.input_mode": int,
    "controller.config.inertia": float,
    "encoder.config.bandwidth": float,
    "encoder.config.mode": int,
    "encoder.config.cpr": int,
    "sensorless_estimator.config.pm_flux_linkage": float,
}

VELOCITY_RAMP = 2  # Input mode in which the reference of the speed has a slope.
Values = Mapping[str, float | int | bool]


def as_printed(key: str, value: float | bool) -> float | int | bool:
    """A value as the file holds it: of its type, numbers with seven digits, which float32 keeps.

    Args:
        key: Name of the property below its axis.
        value: In its unit.
    """
    kind = KINDS[key]
    if kind is float:
        return rounded(value, FLOAT32_DIGITS)
    return bool(value) if kind is bool else round(value)


def pll_gains(bandwidth: float) -> tuple[float, float]:
    """Gains (kp, ki) in 1/s and 1/s^2 of the encoder's PLL for its bandwidth in rad/s.

    Args:
        bandwidth: As ``encoder.config.bandwidth`` states it.
    """
    kp = 2.0 * bandwidth
    return kp, 0.25 * kp * kp


def configuration(name: str, values: Values) -> Configuration:
    """What properties of an axis amount to; gains that the firmware works out by itself included.

    Args:
        name: Of the drive.
        values: By name below the axis, in the units of ODrive.
    """
    own: dict[str, OwnValue] = {key: values[key] for key in KINDS if key in values}
    drive = _drive(values)
    gains = _current_gains(values)
    return Configuration(
        firmware=FIRMWARE,
        version=VERSION,
        name=name,
        drive=drive,
        current_d=gains,
        current_q=gains,
        speed=_speed_gains(values),
        own=own,
        conventions=tuple(conventions(values)),
        contradictions=tuple(contradictions(values, PERIOD)),
    )


def _drive(values: Values) -> DriveValues:
    pairs, constant = values.get("motor.config.pole_pairs"), _torque_constant(values)
    limit = values.get("controller.config.vel_limit")
    inertia = _positive(values, "controller.config.inertia")
    inductance = _positive(values, "motor.config.phase_inductance")
    return DriveValues(
        pole_pairs=int(pairs) if pairs else None,
        r_s=_positive(values, "motor.config.phase_resistance"),
        l_d=inductance,
        l_q=inductance,
        psi_pm=constant / (1.5 * pairs) if pairs and constant is not None else None,
        inertia=None if inertia is None else inertia / (2.0 * math.pi),
        i_max=_positive(values, "motor.config.current_lim"),
        omega_m_max=None if limit is None else 2.0 * math.pi * limit,
        f_sw=PWM_RATE,
        t_s=PERIOD,
        t_speed=PERIOD if "controller.config.vel_gain" in values else None,
    )


def _positive(values: Values, key: str) -> float | None:
    """A value that is not known where it is zero."""
    value = values.get(key, 0.0)
    return float(value) if value > 0.0 else None


def _torque_constant(values: Values) -> float | None:
    return _positive(values, "motor.config.torque_constant")


def _current_gains(values: Values) -> PiGains | None:
    """Gains of both axes: bandwidth times inductance, bandwidth times resistance."""
    bandwidth = _positive(values, "motor.config.current_control_bandwidth")
    inductance = _positive(values, "motor.config.phase_inductance")
    resistance = _positive(values, "motor.config.phase_resistance")
    if bandwidth is None or inductance is None or resistance is None:
        return None
    return PiGains(bandwidth * inductance, bandwidth * resistance)


def _speed_gains(values: Values) -> PiGains | None:
    gain, constant = values.get("controller.config.vel_gain"), _torque_constant(values)
    if gain is None or constant is None:
        return None
    turn = 2.0 * math.pi * constant
    return PiGains(gain / turn, values.get("controller.config.vel_integrator_gain", 0.0) / turn)
