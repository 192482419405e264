"""What the keys of a moteus configuration amount to: constants, gains and rates in SI units.

Facts of github.com/mjbots/moteus (firmware ABI 0x010e and later unless said otherwise):
`fw/bldc_servo_control.h` (UpdateDerivedMotorConstants, UpdateEffectiveInductance, ISR_DoCurrent),
`fw/bldc_servo.cc` (torque constant), `fw/motor_position.h` (filter of the encoder),
`utils/moteus_tool` of the package `moteus` 1.1.1 (upgrades of older configurations).
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
from dqforge.optimizer.firmware.one_bandwidth.moteus_sentences import contradictions, conventions
from dqforge.optimizer.firmware.own_values import FLOAT32_DIGITS, rounded

FIRMWARE: Firmware = "moteus"
VERSION = "ABI 0x010e and later"
OLD_VERSION = "before ABI 0x010e"

# Kv p psi in V s/rad times rpm/V: Kv is the speed in rpm per volt (peak) between two phases.
KV_FLUX = 60.0 / (2.0 * math.pi * math.sqrt(3.0))
WHOLE = ("motor.poles", "servo.pwm_rate_hz", "servo.voltage_mode_control")
FILTER = "motor_position.sources.0.pll_filter_hz"
GEAR = "motor_position.rotor_to_output_ratio"
SLIP = "servo.max_position_slip"

# Keys that are those of the output of a gear, and the power of its ratio that they carry.
OF_OUTPUT = {
    "servo.max_velocity": 1,
    SLIP: 1,
    "servo.default_accel_limit": 1,
    "servo.pid_position.kp": -2,
    "servo.pid_position.ki": -2,
    "servo.pid_position.kd": -2,
    "servo.inertia_feedforward": -2,
}

# Keys that mean something to loops and machine, in the order in which they are written.
KNOWN = (
    "motor.poles",
    "motor.resistance_ohm",
    "motor.inductance_d_H",
    "motor.inductance_q_H",
    "motor.inductance_d_scale",
    "motor.Kv",
    "motor.rotation_current_cutoff_A",
    "motor.rotation_current_scale",
    "motor.rotation_torque_scale",
    "servo.pwm_rate_hz",
    "servo.pid_dq_hz",
    "servo.pid_dq.kp",
    "servo.pid_dq.ki",
    "servo.pid_q.kp",
    "servo.pid_q.ki",
    "servo.max_current_desired_rate",
    "servo.current_feedforward",
    "servo.cross_coupling_feedforward",
    "servo.bemf_feedforward",
    "servo.max_current_A",
    "servo.max_velocity",
    "servo.default_accel_limit",
    "servo.inertia_feedforward",
    "servo.pid_position.kp",
    "servo.pid_position.ki",
    "servo.pid_position.ilimit",
    "servo.pid_position.kd",
    SLIP,
    "servo.voltage_mode_control",
    FILTER,
)

# Largest rate in Hz of the control; above it every second period of the PWM has one.
FASTEST_INTERRUPT = 30000.0
_PWM_LOWEST, _PWM_HIGHEST = 15000, 60000

# Seconds for which the low-side switches conduct at least, so that the currents are sampled.
_SENSE_TIME = 0.6e-6

# Bandwidth (3 dB) over natural frequency of the filter of the encoder, damping 1.
_FILTER_RATIO = 2.48
Numbers = Mapping[str, float | int]


def as_printed(key: str, value: float) -> float | int:
    """A value as the file holds it: whole, or seven digits, which float32 keeps.

    Args:
        key: Name of the parameter.
        value: In its unit.
    """
    return round(value) if key in WHOLE else rounded(value, FLOAT32_DIGITS)


def pwm_rate(wished: float) -> int:
    """The rate in Hz that moteus runs for one wished for: even, from 15 to 60 kHz.

    Args:
        wished: In Hz.
    """
    return int(min(max(wished, _PWM_LOWEST), _PWM_HIGHEST)) // 2 * 2


def control_period(rate: float) -> float:
    """Period in s of current and position control at a rate of the PWM in Hz.

    Args:
        rate: In Hz.
    """
    return (2.0 if rate > FASTEST_INTERRUPT else 1.0) / rate


def voltage_share(rate: float) -> float:
    """Largest phase voltage over v_dc/sqrt(3): what the time for sampling leaves.

    Args:
        rate: Of the PWM in Hz.
    """
    return 1.0 - 4.0 * _SENSE_TIME * rate


def filter_gains(bandwidth: float) -> tuple[float, float]:
    """Gains (kp, ki) in 1/s and 1/s^2 of the filter of the encoder for its bandwidth in Hz.

    Args:
        bandwidth: As ``pll_filter_hz`` states it.
    """
    natural = 2.0 * math.pi * bandwidth / _FILTER_RATIO
    return 2.0 * natural, natural * natural


def filter_bandwidth(kp: float) -> float:
    """Bandwidth in Hz that the filter of the encoder has with a gain kp in 1/s.

    Args:
        kp: Twice its natural frequency.
    """
    return 0.5 * kp * _FILTER_RATIO / (2.0 * math.pi)


def configuration(name: str, numbers: Numbers) -> Configuration:
    """What keys amount to; gains that the firmware works out by itself included.

    Args:
        name: Of the drive.
        numbers: Values by key in the units of moteus, of the rotor (`OF_OUTPUT` undone).
    """
    own: dict[str, OwnValue] = {key: numbers[key] for key in KNOWN if key in numbers}
    current_d, current_q = _current_gains(numbers)
    drive = _drive(numbers)
    return Configuration(
        firmware=FIRMWARE,
        version=OLD_VERSION if _old(numbers) else VERSION,
        name=name,
        drive=drive,
        current_d=current_d,
        current_q=current_q,
        speed=_speed_gains(numbers, drive),
        own=own,
        conventions=tuple(conventions(numbers, drive.t_s)),
        contradictions=tuple(contradictions(numbers, drive.t_s)),
    )


def _old(numbers: Numbers) -> bool:
    return "servo.pid_dq_hz" not in numbers and "servo.pid_dq.kp" in numbers


def _drive(numbers: Numbers) -> DriveValues:
    poles, speed = numbers.get("motor.poles"), numbers.get("servo.max_velocity")
    pairs = int(poles) // 2 if poles else None
    rate = numbers.get("servo.pwm_rate_hz")
    period = None if rate is None else control_period(pwm_rate(rate))
    return DriveValues(
        pole_pairs=pairs,
        r_s=_positive(numbers, "motor.resistance_ohm"),
        l_d=_positive(numbers, "motor.inductance_d_H"),
        l_q=_positive(numbers, "motor.inductance_q_H"),
        psi_pm=_flux(numbers, pairs),
        inertia=_positive(numbers, "servo.inertia_feedforward"),
        i_max=_positive(numbers, "servo.max_current_A"),
        omega_m_max=None if speed is None else 2.0 * math.pi * speed,
        f_sw=None if rate is None else float(pwm_rate(rate)),
        t_s=period,
        t_speed=period if "servo.pid_position.kd" in numbers else None,
    )


def _positive(numbers: Numbers, key: str) -> float | None:
    """A value that is not known where it is zero."""
    value = numbers.get(key, 0.0)
    return float(value) if value > 0.0 else None


def _flux(numbers: Numbers, pairs: int | None) -> float | None:
    speed_constant = numbers.get("motor.Kv", 0.0)
    if pairs is None or speed_constant <= 0.0:
        return None
    return KV_FLUX / (pairs * speed_constant)


def _current_gains(numbers: Numbers) -> tuple[PiGains | None, PiGains | None]:
    """Gains of d and q: 2 pi f L and 2 pi f R, or those that stand there."""
    if _old(numbers):
        given = PiGains(numbers["servo.pid_dq.kp"], numbers.get("servo.pid_dq.ki", 0.0))
        own_q = numbers.get("servo.pid_q.kp")
        if own_q is None:
            return given, given
        return given, PiGains(own_q, numbers.get("servo.pid_q.ki", given.ki))
    resistance = _positive(numbers, "motor.resistance_ohm")
    hertz = _positive(numbers, "servo.pid_dq_hz")
    if resistance is None or hertz is None:
        return None, None
    rate = 2.0 * math.pi * hertz
    found = []
    for key in ("motor.inductance_d_H", "motor.inductance_q_H"):
        inductance = _positive(numbers, key)
        found.append(None if inductance is None else PiGains(rate * inductance, rate * resistance))
    return found[0], found[1]


def _speed_gains(numbers: Numbers, drive: DriveValues) -> PiGains | None:
    """The position controller as one of the speed: kd acts on the error of the speed, kp on that of
    the position, which is the integral of it.
    """
    damping = numbers.get("servo.pid_position.kd")
    if damping is None or drive.psi_pm is None or drive.pole_pairs is None:
        return None
    turn = 2.0 * math.pi * 1.5 * drive.pole_pairs * drive.psi_pm
    return PiGains(damping / turn, numbers.get("servo.pid_position.kp", 0.0) / turn)
