"""TI's universal motor control lab: a motor block for a design, and the loops that it then runs."""

from __future__ import annotations

import math

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    AntiWindup,
    Configuration,
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LoopProfile,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import INERTIA, Asked, FirmwareMethod, needed
from dqforge.optimizer.firmware.ti_format import (
    BANDWIDTHS,
    BOARD_PREFIX,
    FIRMWARE,
    KEYS,
    MOTOR_PREFIX,
    TWO_PI,
    VERSION,
    Bandwidths,
    configuration,
    current_rule,
    kept,
    known,
    number,
    shortfalls,
    speed_rule,
)

_LAB = "TexasInstruments/motor-control-sdk tidm_02018_universal_motorcontrol "
_OLDER = "anyway-blows/ti-c2000-motor-control-sdk 3.03 "

SOURCES = (
    _LAB + "motor_common.c: setupControllers, tuneControllerGains",
    _LAB + "user_mtr1.c USER_setMotor1Params: BWc 200 Hz, delta 20",
    _LAB + "motor1_drive.c motor1CtrlISR: series PI, d before q, no feedforward, speed in Hz",
    _LAB + "spdfr.h: speed as the filtered difference of the angle of the eSMO",
    _OLDER + "user_mtr1.c: BWc 400 Hz, delta 10",
    _OLDER + "pi.h: integral limited to the output's limits, before it is used",
)

VOLTAGE_PU = 0.66  # USER_M1_MAX_VS_MAG_PU of TI's file.
SPEED_CORNER = 200.0  # USER_MOTOR1_SPEED_LPF_FC_Hz of TI's file.
MOST_SPEED_TICKS = 65535

_START_OF_CURRENT = {
    "RES_EST_CURRENT_A": 0.1,
    "IND_EST_CURRENT_A": -0.1,
    "FORCE_DELTA_A": 0.01,
    "ALIGN_DELTA_A": 0.002,
    "FLUX_CURRENT_A": 0.1,
    "ALIGN_CURRENT_A": 0.25,
    "STARTUP_CURRENT_A": 0.5,
    "TORQUE_CURRENT_A": 0.5,
    "OVER_CURRENT_A": 1.25,
    "GAIN_IQ_LOW_A": 0.1,
    "GAIN_IQ_HIGH_A": 0.5,
}

_START_OF_FREQUENCY = {
    "FLUX_EXC_FREQ_Hz": 0.1,
    "FREQ_MIN_Hz": 0.015,
    "FREQ_LOW_Hz": 0.1,
    "FREQ_HIGH_Hz": 1.0,
    "SPEED_START_Hz": 0.06,
    "SPEED_FORCE_Hz": 0.05,
    "ACCEL_START_Hzps": 0.05,
    "ACCEL_MAX_Hzps": 1.0,
    "SPEED_FS_Hz": 0.005,
    "GAIN_SPEED_LOW_Hz": 0.1,
    "GAIN_SPEED_HIGH_Hz": 0.5,
}


def configure(asked: Asked) -> Configuration:
    """The configuration for a design: the factors on TI's own gains make those that are asked for.

    Raises:
        InputError: The design says too little of its machine, or has no magnet; with the key.
    """
    drive = asked.drive
    values: dict[str, OwnValue] = {"USER_MOTOR1_TYPE": "MOTOR_TYPE_PM"}
    values |= _machine(drive)
    values |= _timing(drive)
    values |= _factors(asked)
    values |= _range(asked)
    own = {name: values[name] for name in KEYS if name in values}
    return configuration(asked.design.name, own)


def profile(found: Configuration) -> LoopProfile:
    """The loops that the lab runs with a configuration.

    Raises:
        InputError: It says nothing of the current controllers, or of their period.
    """
    t_s = found.drive.t_s
    if found.current_d is None or found.current_q is None or t_s is None:
        missing = (
            "USER_M1_PWM_FREQ_kHz"
            if t_s is None
            else "resistance and inductances, or is of a lab whose constants are not known"
        )
        raise InputError(
            f"the motor of TI's lab has no {missing}, which its current loops need; name the whole "
            f"user_mtr1.h"
        )
    wind_up: AntiWindup = "hold" if found.version == VERSION else "clamp"
    salient = found.drive.l_d != found.drive.l_q
    return LoopProfile(
        firmware="ti",
        version=found.version,
        current=CurrentLoops(
            d=_current(found.current_d, t_s, wind_up),
            q=_current(found.current_q, t_s, wind_up),
            delay=1.0,
            order="d-first",
            voltage_share=_given(found, "M1_MAX_VS_MAG_PU", VOLTAGE_PU) * math.sqrt(3.0),
            modulation="dpwmmin" if found.version == VERSION else "svpwm",
        ),
        speed=_speed_loop(found, t_s, wind_up),
        observer=FluxObserver("eSMO"),
        reference="mtpa-linear" if salient else "id-zero",
        sources=SOURCES,
    )


def _needed(value: float | None, key: str, what: str, otherwise: str = "give it") -> float:
    return needed(value, key, FIRMWARE, what, otherwise)


def _magnets(drive: DriveValues) -> float:
    without = "a machine without any needs another firmware"
    return _needed(drive.psi_pm, "machine.magnet_flux", "the flux linkage of magnets", without)


def _machine(drive: DriveValues) -> dict[str, OwnValue]:
    if not drive.pole_pairs:
        raise InputError(
            "machine: TI's lab needs the number of pole pairs; give poles or pole_pairs"
        )
    r_s = _needed(drive.r_s, "machine.resistance", "a resistance")
    l_d = _needed(drive.l_d, "machine.inductance_d", "inductances")
    l_q = _needed(drive.l_q, "machine.inductance_q", "inductances")
    psi = _magnets(drive)
    inertia = _needed(drive.inertia, "machine.inertia", "an inertia for its speed controller")
    i_max = _needed(drive.i_max, "machine.max_current", "a largest current")
    v_dc = _needed(drive.v_dc, "inverter.v_dc", "the voltage of the dc link")
    most = v_dc / math.sqrt(3.0) / (TWO_PI * psi)
    if drive.omega_m_max:
        most = drive.omega_m_max * drive.pole_pairs / TWO_PI
    values: dict[str, float] = {
        "Rr_Ohm": 0.0,
        "Rs_Ohm": kept(r_s, "machine.resistance"),
        "Ls_d_H": kept(l_d, "machine.inductance_d"),
        "Ls_q_H": kept(l_q, "machine.inductance_q"),
        "RATED_FLUX_VpHz": kept(TWO_PI * psi, "machine.magnet_flux"),
        "MAGNETIZING_CURRENT_A": 0.0,
        "MAX_CURRENT_A": kept(i_max, "machine.max_current"),
        "INERTIA_Kgm2": kept(inertia, "machine.inertia"),
        "RATED_VOLTAGE_V": kept(v_dc, "inverter.v_dc"),
        "FREQ_MAX_Hz": kept(most, "machine.max_speed"),
        "VOLT_MIN_V": kept(0.15 * v_dc / math.sqrt(3.0), "inverter.v_dc"),
        "VOLT_MAX_V": kept(v_dc / math.sqrt(3.0), "inverter.v_dc"),
        "SPEED_LPF_FC_Hz": SPEED_CORNER,
    }
    values |= {
        name: kept(share * i_max, "machine.max_current")
        for name, share in _START_OF_CURRENT.items()
    }
    values |= {
        name: kept(share * most, "machine.max_speed") for name, share in _START_OF_FREQUENCY.items()
    }
    named: dict[str, OwnValue] = {f"{MOTOR_PREFIX}{name}": values[name] for name in values}
    named[f"{MOTOR_PREFIX}NUM_POLE_PAIRS"] = drive.pole_pairs
    named[f"{BOARD_PREFIX}NOMINAL_DC_BUS_VOLTAGE_V"] = kept(v_dc, "inverter.v_dc")
    named[f"{BOARD_PREFIX}MAX_VS_MAG_PU"] = kept(1.0 / math.sqrt(3.0), "inverter.v_dc")
    return named


def _timing(drive: DriveValues) -> dict[str, OwnValue]:
    """PWM periods per control step, 1 to 3, and control steps per step of the speed controller."""
    f_sw = _needed(drive.f_sw, "inverter.switching_frequency", "a PWM frequency")
    pwm = kept(1e-3 * f_sw, "inverter.switching_frequency")
    ticks = 1 if drive.t_s is None else min(max(round(drive.t_s * f_sw), 1), 3)
    steps = 10 if drive.t_speed is None else round(drive.t_speed * 1e3 * pwm / ticks)
    return {
        f"{BOARD_PREFIX}PWM_FREQ_kHz": pwm,
        f"{BOARD_PREFIX}NUM_PWM_TICKS_PER_ISR_TICK": ticks,
        f"{BOARD_PREFIX}NUM_ISR_TICKS_PER_SPEED_TICK": min(max(steps, 1), MOST_SPEED_TICKS),
    }


def _range(asked: Asked) -> dict[str, OwnValue]:
    """What all codes of the converter amount to, where the design says how it measures."""
    sensing = asked.design.inverter.current_sensing
    if sensing is None:
        return {}
    scale = kept(sensing.reference / sensing.slope, "inverter.current_sensing")
    return {f"{BOARD_PREFIX}ADC_FULL_SCALE_CURRENT_A": scale}


def _factors(asked: Asked) -> dict[str, OwnValue]:
    """Factors on the gains that the firmware works out; the same from low to high current or
    speed.
    """
    drive, own = asked.drive, BANDWIDTHS[VERSION]
    assert drive.r_s is not None
    assert drive.l_d is not None
    assert drive.l_q is not None
    rule_d = current_rule(drive.r_s, drive.l_d, own.current)
    rule_q = current_rule(drive.r_s, drive.l_q, own.current)
    key = "control.current_loop"
    values = _pair("ID", ("",), asked.current_d, rule_d, key)
    values |= _pair("IQ", ("START_", "LOW_", "HIGH_"), asked.current_q, rule_q, key)
    wished, rule = asked.speed, _speed_rule(drive, own)
    values |= _pair("SPD", ("START_", "LOW_", "HIGH_"), wished or rule, rule, "control.speed_loop")
    return values


def _speed_rule(drive: DriveValues, own: Bandwidths) -> PiGains:
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    assert drive.inertia is not None
    return speed_rule(drive.pole_pairs, drive.psi_pm, drive.inertia, own)


def _pair(
    loop: str, places: tuple[str, ...], wished: PiGains, rule: PiGains, key: str
) -> dict[str, OwnValue]:
    if not wished.kp > 0.0:
        raise InputError(f"{key}: TI's lab multiplies the integral by kp, which must not be 0")
    kp = kept(wished.kp / rule.kp, key)
    ki = kept(wished.ki / wished.kp / (rule.ki / rule.kp), key)
    return {
        f"{MOTOR_PREFIX}{gain}_{loop}_{place}SF": value
        for place in places
        for gain, value in (("KP", kp), ("KI", ki))
    }


def _given(found: Configuration, name: str, otherwise: float) -> float:
    """A positive value of the file, or TI's own."""
    value = known(found.own, name, otherwise)
    return value if value > 0.0 else otherwise


def _current(gains: PiGains, t_s: float, wind_up: AntiWindup) -> PiController:
    return PiController(gains.kp, gains.ki, t_s, rule="integral-first", anti_windup=wind_up)


def _speed_loop(found: Configuration, t_s: float, wind_up: AntiWindup) -> SpeedController | None:
    if found.speed is None or found.drive.t_speed is None:
        return None
    corner = _given(found, "SPEED_LPF_FC_Hz", SPEED_CORNER)
    slope, pairs = number(found.own, "ACCEL_MAX_Hzps"), found.drive.pole_pairs
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        found.drive.t_speed,
        rule="integral-first",
        anti_windup=wind_up,
        limit=found.drive.i_max,
    )
    estimate = SpeedEstimate("low-pass", t_s, filter_time=1.0 / (TWO_PI * corner))
    ramp = TWO_PI * slope / pairs if slope and pairs else None
    return SpeedController(pi, estimate, ramp)


TI = FirmwareMethod("ti", VERSION, "axes", configure, profile, shortfalls, needs=(INERTIA,))
