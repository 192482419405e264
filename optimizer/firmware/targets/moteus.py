"""moteus (mjbots): one bandwidth for the current loops, of which the firmware makes its gains;
position and speed in one controller; torque over current with saturation.

Sources: `SOURCES`; the keys and what they amount to are in `moteus_keys`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.dq_machines.synchronous import Machine, torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    AntiWindup,
    Configuration,
    CurrentLoops,
    DriveValues,
    LoopProfile,
    PiController,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    Asked,
    FirmwareMethod,
    Price,
    Shortfall,
    judge,
)
from dqforge.optimizer.firmware.moteus_format import (
    FILTER,
    FIRMWARE,
    KV_FLUX,
    NEVER,
    SLIP,
    VERSION,
    TorqueRotation,
    as_printed,
    bandwidth_asked,
    configuration,
    control_period,
    d_current_missing,
    field_weakening_missing,
    filter_bandwidth,
    filter_gains,
    gains_changed,
    held_bandwidth,
    pwm_rate,
    rates_changed,
    rounded_down,
    saturation_unknown,
    torque_rotation,
    voltage_share,
)

SOURCES = (
    "mjbots/moteus fw/bldc_servo_control.h:341-345, 392: Kv to flux, gains from pid_dq_hz",
    "mjbots/moteus fw/bldc_servo_control.h ISR_DoCurrent: feedforward, d first, integrals set back",
    "mjbots/moteus fw/bldc_servo_control.h RateConfig: rates, time for the sampling",
    "mjbots/moteus fw/simple_pi.h Apply: the integral is updated before it is used",
    "mjbots/moteus 00021a0 fw/bldc_servo.cc ConfigurePwmTimer, ISR_HandleTimer: sampling instant",
    "mjbots/moteus 00021a0 fw/bldc_servo.cc UpdateConfig: torque constant",
    "mjbots/moteus fw/motor_position.h:837: filter of the encoder",
    "mjbots/moteus fw/pid.h Apply: position and speed",
    "mjbots/moteus fw/torque_model.h; fw/bldc_servo_structs.h:461-470: torque over current",
    "package moteus 1.1.1 moteus_tool.py: set_encoder_filter (bandwidth over 2.48)",
    "package moteus 1.1.1 moteus_tool.py: calculate_bandwidth, upgrades of configurations",
)

# Largest bandwidth of the encoder's filter over the rate of the control, as in moteus_tool.
_FILTER_SHARE = 0.1
_SLOWEST_FILTER = 10.0
_LARGEST_POLES = 255
_NEARLY = 1.5


def configure(asked: Asked) -> Configuration:
    """Everything that a design decides of a moteus.

    Args:
        asked: The design and the gains that it wishes for.
    """
    drive, machine = asked.drive, asked.design.machine
    numbers = {
        key: as_printed(key, value)
        for key, value in (_machine_values(drive) | _drive_values(asked)).items()
    }
    fitted = _rotation(machine, float(numbers["motor.Kv"]), drive)
    numbers["motor.inductance_d_scale"] = as_printed("", _inductance_slope(machine, drive))
    numbers["motor.rotation_current_cutoff_A"] = as_printed("", fitted.cutoff)
    numbers["motor.rotation_current_scale"] = as_printed("", fitted.current_scale)
    numbers["motor.rotation_torque_scale"] = as_printed("", fitted.torque_scale)

    def loops(hertz: float) -> LoopProfile:
        return profile(configuration(asked.design.name, {**numbers, "servo.pid_dq_hz": hertz}))

    wished = bandwidth_asked(asked) / (2.0 * math.pi)
    numbers["servo.pid_dq_hz"] = held_bandwidth(wished, loops, asked)
    if asked.speed is not None:
        numbers |= _speed_values(asked, float(numbers["servo.pid_dq_hz"]))
    return configuration(asked.design.name, numbers)


def profile(held: Configuration) -> LoopProfile:
    """The loops that a configuration amounts to.

    Args:
        held: Of moteus.
    """
    d, q, drive = held.current_d, held.current_q, held.drive
    if d is None or q is None or drive.t_s is None or drive.f_sw is None:
        wanted = "motor.resistance_ohm, motor.inductance_d_H, motor.inductance_q_H"
        raise InputError(
            f"a moteus configuration makes current loops of {wanted}, servo.pid_dq_hz and "
            "servo.pwm_rate_hz; one of them is missing or zero: give all of them"
        )
    # What the limit takes away is taken out of the integral in the same period.
    pi = PiController(d.kp, d.ki, drive.t_s, anti_windup="back-calculation", tracking=1 / drive.t_s)
    current = CurrentLoops(
        d=pi,
        q=replace(pi, kp=q.kp, ki=q.ki),
        delay=1.0,
        # What is fed forward is the coupling of the references, which no loop feels.
        cross=False,
        order="d-first",
        voltage_share=voltage_share(drive.f_sw),
    )
    return LoopProfile(FIRMWARE, held.version, current, speed=_speed(held), sources=SOURCES)


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What a moteus cannot hold of a design.

    Args:
        asked: The design and its wishes.
        held: What was made of them.
    """
    judged = judge(profile(replace(held, speed=None)), asked.drive)
    key = "servo.pid_dq_hz"
    words = f"{key} {held.own[key]:g} Hz is the only setting of the current loops"
    return (
        *gains_changed(asked, held, judged, words),
        *rates_changed(asked, held),
        *saturation_unknown(asked, profile(replace(held, speed=None)), _inductances_words(held)),
        *d_current_missing(asked),
        *_torque_error(asked, held),
        *field_weakening_missing(
            asked,
            "beyond base speed moteus computes the d current itself (servo.fw.enable, from Kv "
            "and inductance_d_H), not from the map of the design",
        ),
    )


def _machine_values(drive: DriveValues) -> dict[str, float]:
    pairs, r_s, psi_pm = drive.pole_pairs, drive.r_s, drive.psi_pm
    if pairs is None or 2 * pairs > _LARGEST_POLES:
        raise InputError(
            f"machine.pole_pairs: moteus holds at most {_LARGEST_POLES} poles; choose another "
            "firmware"
        )
    if psi_pm is None or not psi_pm > 0.0:
        raise InputError(
            "machine.magnet_flux: moteus makes torque of the magnets alone (motor.Kv); a machine "
            "without any needs another firmware"
        )
    assert r_s is not None
    assert drive.l_d is not None
    assert drive.l_q is not None
    return {
        "motor.poles": 2 * pairs,
        "motor.resistance_ohm": r_s,
        "motor.inductance_d_H": drive.l_d,
        "motor.inductance_q_H": drive.l_q,
        "motor.Kv": KV_FLUX / (pairs * psi_pm),
    }


def _drive_values(asked: Asked) -> dict[str, float]:
    drive, slope = asked.drive, asked.design.control.references.current_slope
    assert drive.f_sw is not None
    assert drive.i_max is not None
    values = {
        "servo.pwm_rate_hz": float(pwm_rate(drive.f_sw)),
        "servo.max_current_A": drive.i_max,
        # With it the answer to a step of the current would overshoot by up to 13 %.
        "servo.current_feedforward": 0.0,
        "servo.cross_coupling_feedforward": 1.0,
    }
    if slope is not None:
        values["servo.max_current_desired_rate"] = slope
    if drive.omega_m_max is not None:
        values["servo.max_velocity"] = drive.omega_m_max / (2.0 * math.pi)
    if drive.inertia is not None:
        values["servo.inertia_feedforward"] = drive.inertia
    return values


def _speed_values(asked: Asked, bandwidth: float) -> dict[str, float | int]:
    """Controller of position and speed, and the filter of the encoder as fast as the current loop,
    as moteus_tool sets it.
    """
    drive, speed = asked.drive, asked.speed
    assert speed is not None
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    assert drive.f_sw is not None
    turn = 2.0 * math.pi * torque_per_ampere(drive.pole_pairs, drive.psi_pm)
    rate = 1.0 / control_period(pwm_rate(drive.f_sw))
    assert drive.i_max is not None
    stiffness = speed.ki * turn
    values = {
        "servo.pid_position.kp": stiffness,
        "servo.pid_position.ki": 0.0,
        "servo.pid_position.kd": speed.kp * turn,
        FILTER: rounded_down(min(_FILTER_SHARE * rate, _filter_wished(asked, bandwidth))),
    }
    if stiffness > 0.0:
        # How far the position may lag: what the largest current makes up for.
        values[SLIP] = torque_per_ampere(drive.pole_pairs, drive.psi_pm) * drive.i_max / stiffness
    return {key: as_printed(key, value) for key, value in values.items()}


def _filter_wished(asked: Asked, bandwidth: float) -> float:
    """Bandwidth in Hz of the encoder's filter: the one asked for, else that of the currents."""
    if asked.pll is None:
        return max(_SLOWEST_FILTER, bandwidth)
    return filter_bandwidth(asked.pll.kp)


def _speed(held: Configuration) -> SpeedController | None:
    gains, drive = held.speed, held.drive
    if gains is None or drive.t_s is None:
        return None
    feedback = SpeedEstimate("ideal", drive.t_s)
    bandwidth = held.own.get(FILTER)
    if isinstance(bandwidth, float | int) and bandwidth > 0.0:
        kp, ki = filter_gains(float(bandwidth))
        feedback = SpeedEstimate("pll", drive.t_s, kp, ki)
    winds: AntiWindup = "clamp" if _slips(held, gains.ki) else "none"
    pi = PiController(gains.kp, gains.ki, drive.t_s, anti_windup=winds, limit=drive.i_max)
    slope = held.own.get("servo.default_accel_limit")
    ramp = None if slope is None else 2.0 * math.pi * float(slope)
    return SpeedController(pi, feedback, ramp)


def _slips(held: Configuration, ki: float) -> bool:
    """Whether the lag of the position is limited to about what the largest current makes up for."""
    slip, i_max = held.own.get(SLIP), held.drive.i_max
    return (
        slip is not None
        and i_max is not None
        and 2.0 * math.pi * ki * float(slip) <= _NEARLY * i_max
    )


def _inductance_slope(machine: Machine, drive: DriveValues) -> float:
    """Slope in H/A, at most zero, of the chord inductance (psi_d(i_d) - psi_d(0))/i_d over negative
    d currents, with the least largest error; moteus_tool takes no positive one either.
    """
    assert drive.i_max is not None
    i_d = -drive.i_max * np.linspace(0.02, 1.0, 50)
    zero = np.zeros_like(i_d)
    known = machine.known(i_d, zero)
    if not np.any(known):
        return 0.0
    i_d = i_d[known]
    chord = (machine.flux(i_d, zero[known])[0] - machine.psi_pm) / i_d - machine.l_d
    if float(np.max(np.abs(chord))) < 1e-6 * machine.l_d:
        return 0.0
    low, high = float(np.min(chord / i_d)), float(np.max(chord / i_d))
    for _ in range(80):
        left, right = low + (high - low) / 3.0, high - (high - low) / 3.0
        errors = [float(np.max(np.abs(chord - slope * i_d))) for slope in (left, right)]
        low, high = (left, high) if errors[0] > errors[1] else (low, right)
    return min(0.5 * (low + high), 0.0)


def _rotation(machine: Machine, speed_constant: float, drive: DriveValues) -> TorqueRotation:
    assert drive.i_max is not None
    return torque_rotation(machine, 1.5 * KV_FLUX / speed_constant, drive.i_max)


def _inductances_words(held: Configuration) -> str:
    scale = held.own.get("motor.inductance_d_scale", 0.0)
    slope = f" (along -d a slope of {float(scale) * 1e6:.4g} uH/A)" if scale else ""
    return f"one q inductance for all currents{slope}"


def _torque_error(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """How far commanded and made torque are apart with the fitted model, and without it."""
    found = _rotation(asked.design.machine, float(held.own["motor.Kv"]), asked.drive)
    if found.cutoff >= NEVER:
        return ()
    words = (
        f"a logarithm beyond {found.cutoff:.4g} A stands for the saturation: torque within "
        f"{found.error:.3g} N m of {found.largest:.4g} N m without d current; with the torque "
        f"constant alone it would be {found.straight:.3g} N m"
    )
    return (Shortfall(words, (Price("torque", found.error, "N m"),)),)


MOTEUS = FirmwareMethod(FIRMWARE, VERSION, "bandwidth", configure, profile, shortfalls)
