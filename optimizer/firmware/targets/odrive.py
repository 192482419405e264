"""ODrive 0.5 (v3.x boards): one bandwidth and one inductance for both current loops, a speed
controller in N m on the speed of the encoder's PLL.

Sources: `SOURCES`; the properties and what they amount to are in
`dqforge.optimizer.firmware.targets.odrive`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    LoopProfile,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    FLOAT32_DIGITS,
    Asked,
    FirmwareMethod,
    JudgedFirmware,
    Price,
    Shortfall,
    judge,
    rounded,
)
from dqforge.optimizer.firmware.moteus_format import (
    bandwidth_asked,
    d_current_missing,
    field_weakening_missing,
    gains_changed,
    held_bandwidth,
    overshoot,
    rates_changed,
    rounded_down,
    saturation_unknown,
)

SOURCES = (
    "odriverobotics/ODrive bddae0e MotorControl/motor.cpp:297: p = bandwidth L, i = bandwidth R",
    "odriverobotics/ODrive bddae0e MotorControl/motor.cpp update: no d current, feedforward",
    "odriverobotics/ODrive 1f78154 MotorControl/foc.cpp get_alpha_beta_output: PI, limit 0.8",
    "odriverobotics/ODrive 1f78154 MotorControl/foc.cpp get_alpha_beta_output: angle of the output",
    "odriverobotics/ODrive fw-v0.5 Board/v3/board.cpp ControlLoop_IRQHandler: a period later",
    "odriverobotics/ODrive b968a67 MotorControl/controller.cpp update: speed controller",
    "odriverobotics/ODrive 09790b0 MotorControl/encoder.cpp:121: kp = 2 bandwidth, ki = kp^2/4",
    "odriverobotics/ODrive 09790b0 MotorControl/encoder.cpp update: PLL",
    "odriverobotics/ODrive 029ab55 Firmware/odrive-interface.yaml: names, types, units",
)

VOLTAGE_SHARE = 0.8  # Largest phase voltage over v_dc/sqrt(3).
DEFAULT_PLL = 1000.0  # Bandwidth in rad/s of the encoder's PLL as ODrive ships it.

PWM_RATE = 24000.0  # In Hz: 168 MHz over two slopes of 3500 counts.

# Period in s of all controllers: every third period of the PWM (TIM_1_8_RCR 2).
PERIOD = 3.0 / PWM_RATE

# Largest bandwidth in rad/s that is written; from 0.5/PERIOD on the firmware refuses it.
FASTEST_PLL = 0.4 / PERIOD
_TRIP_SHARE = 0.2  # Current above the limit at which the drive switches off, over the limit.
_PLL_OVER_SPEED_LOOP = 8.0


def configure(asked: Asked) -> Configuration:
    """Everything that a design decides of an axis of an ODrive.

    Args:
        asked: The design and the gains that it wishes for.
    """
    wished = _machine_values(asked) | _drive_values(asked)
    if asked.speed is not None:
        wished |= _speed_values(asked)
    values = {key: as_printed(key, value) for key, value in wished.items()}
    bandwidth_key = "motor.config.current_control_bandwidth"

    def with_bandwidth(bandwidth: float) -> Configuration:
        return configuration(asked.design.name, {**values, bandwidth_key: bandwidth})

    def loops(bandwidth: float) -> LoopProfile:
        return profile(replace(with_bandwidth(bandwidth), speed=None))

    return with_bandwidth(held_bandwidth(bandwidth_asked(asked), loops, asked))


def profile(held: Configuration) -> LoopProfile:
    """The loops that a configuration amounts to.

    Args:
        held: Of ODrive.
    """
    gains = held.current_q
    if gains is None:
        raise InputError(
            "an ODrive makes its current loops of phase_resistance, phase_inductance and "
            "current_control_bandwidth in motor.config; one of them is missing or zero: calibrate "
            "the motor, or give all of them"
        )
    pi = PiController(gains.kp, gains.ki, PERIOD, rule="integral-last", anti_windup="hold")
    current = CurrentLoops(
        d=pi,
        q=pi,
        delay=1.0,
        cross=False,
        back_emf=bool(held.own.get("motor.config.bEMF_FF_enable", False)),
        order="vector",
        voltage_share=VOLTAGE_SHARE,
        angle_advance=1.5,
    )
    return LoopProfile(FIRMWARE, held.version, current, speed=_speed(held), sources=SOURCES)


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What an ODrive cannot hold of a design.

    Args:
        asked: The design and its wishes.
        held: What was made of them.
    """
    loops = profile(replace(held, speed=None))
    judged = judge(loops, asked.drive)
    bandwidth = held.own["motor.config.current_control_bandwidth"]
    lead = f"current_control_bandwidth {bandwidth:g} rad/s is the only setting of the current loops"
    return (
        *_one_inductance(asked, held, judged),
        *gains_changed(asked, held, judged, lead),
        *rates_changed(asked, held),
        *_voltage_missing(),
        *saturation_unknown(asked, loops, "one inductance for all currents"),
        *d_current_missing(asked),
        *field_weakening_missing(
            asked, "ODrive 0.5 has no field weakening: speed ends where the voltage does"
        ),
        *_not_measurable(held),
    )


def _machine_values(asked: Asked) -> dict[str, float | bool]:
    drive = asked.drive
    if drive.psi_pm is None or not drive.psi_pm > 0.0:
        raise InputError(
            "machine.magnet_flux: ODrive makes torque of the magnets alone (torque_constant); a "
            "machine without any needs another firmware"
        )
    assert drive.pole_pairs is not None
    assert drive.r_s is not None
    assert drive.l_d is not None
    assert drive.l_q is not None
    return {
        "motor.config.motor_type": HIGH_CURRENT,
        "motor.config.pre_calibrated": True,
        "motor.config.pole_pairs": drive.pole_pairs,
        "motor.config.phase_resistance": drive.r_s,
        "motor.config.phase_inductance": 0.5 * (drive.l_d + drive.l_q),
        "motor.config.torque_constant": torque_per_ampere(drive.pole_pairs, drive.psi_pm),
    }


def _drive_values(asked: Asked) -> dict[str, float | bool]:
    drive = asked.drive
    assert drive.i_max is not None
    margin = rounded_down(_TRIP_SHARE * drive.i_max)
    values: dict[str, float | bool] = {
        "motor.config.current_lim": drive.i_max,
        "motor.config.current_lim_margin": margin,
        "motor.config.requested_current_range": drive.i_max + margin,
        # With it the answer to a step of the current would overshoot by up to 13 %.
        "motor.config.R_wL_FF_enable": False,
        "motor.config.bEMF_FF_enable": True,
    }
    if drive.omega_m_max is not None:
        values["controller.config.vel_limit"] = drive.omega_m_max / (2.0 * math.pi)
    if drive.inertia is not None:
        values["controller.config.inertia"] = 2.0 * math.pi * drive.inertia
    return values


def _speed_values(asked: Asked) -> dict[str, float | bool]:
    drive, speed = asked.drive, asked.speed
    assert speed is not None
    assert drive.pole_pairs is not None
    assert drive.psi_pm is not None
    constant = torque_per_ampere(drive.pole_pairs, drive.psi_pm)
    return {
        "controller.config.vel_gain": 2.0 * math.pi * constant * speed.kp,
        "controller.config.vel_integrator_gain": 2.0 * math.pi * constant * speed.ki,
        "encoder.config.bandwidth": _pll_bandwidth(asked, speed.kp * constant),
    }


def _pll_bandwidth(asked: Asked, gain: float) -> float:
    """Bandwidth in rad/s of the encoder's PLL: the one asked for, else ODrive's own, raised for
    speed loops that are too fast for it; at most what the firmware takes.
    """
    inertia = asked.drive.inertia
    crossover = 0.0 if inertia is None else gain / inertia
    own = max(DEFAULT_PLL, _PLL_OVER_SPEED_LOOP * crossover)
    wished = own if asked.pll is None else 0.5 * asked.pll.kp
    return rounded_down(min(wished, FASTEST_PLL))


def _speed(held: Configuration) -> SpeedController | None:
    gains, own = held.speed, held.own
    if gains is None:
        return None
    feedback = SpeedEstimate("ideal", PERIOD)
    bandwidth = own.get("encoder.config.bandwidth")
    if isinstance(bandwidth, float | int) and bandwidth > 0.0:
        feedback = SpeedEstimate("pll", PERIOD, *pll_gains(float(bandwidth)))
    pi = PiController(
        gains.kp,
        gains.ki,
        PERIOD,
        rule="integral-last",
        anti_windup="hold",
        limit=held.drive.i_max,
    )
    slope = own.get("controller.config.vel_ramp_rate")
    ramped = own.get("controller.config.input_mode") == VELOCITY_RAMP and slope is not None
    return SpeedController(pi, feedback, 2.0 * math.pi * float(slope or 0.0) if ramped else None)


def _one_inductance(
    asked: Asked, held: Configuration, judged: JudgedFirmware
) -> tuple[Shortfall, ...]:
    """One inductance for two axes, with the bandwidths that they then have."""
    l_d, l_q, mean = asked.drive.l_d, asked.drive.l_q, held.drive.l_q
    assert l_d is not None
    assert l_q is not None
    assert mean is not None
    if abs(l_q / l_d - 1.0) < 1e-3 or judged.current_d is None or judged.current_q is None:
        return ()
    rates = [loop.crossover for loop in (judged.current_d, judged.current_q)]
    words = (
        f"one inductance, {mean * 1e6:.4g} uH, stands for {l_d * 1e6:.4g} uH (d) and "
        f"{l_q * 1e6:.4g} uH (q): crossovers {rates[0]:.4g} rad/s (d) and {rates[1]:.4g} rad/s (q)"
    )
    prices = (
        Price("crossover (d)", rates[0], "rad/s"),
        Price("crossover (q)", rates[1], "rad/s"),
    )
    return (Shortfall(words, prices),)


def _voltage_missing() -> tuple[Shortfall, ...]:
    words = (
        f"the phase voltage ends at {VOLTAGE_SHARE:.0%} of v_dc/sqrt(3), which lowers the base "
        "speed"
    )
    return (Shortfall(words, (Price("voltage", 1.0 - VOLTAGE_SHARE, ""),)),)


def _not_measurable(held: Configuration) -> tuple[Shortfall, ...]:
    low, high = MEASURED_INDUCTANCE
    inductance = held.drive.l_q
    assert inductance is not None
    if low <= inductance <= high:
        return ()
    words = (
        f"phase_inductance {inductance * 1e6:.4g} uH is outside {low * 1e6:.4g} to "
        f"{high * 1e6:.4g} uH, which the calibration of the motor accepts: do not run it "
        "(startup_motor_calibration false)"
    )
    return (Shortfall(words),)


FIRMWARE: Firmware = "odrive"
VERSION = "0.5"

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


# How the numbers of an ODrive 0.5 are meant, and what in them does not fit together.

# ``pm_flux_linkage`` of the sensorless estimator in Wb while nobody sets it.
DEFAULT_FLUX = 1.58e-3
DEFAULT_TORQUE_CONSTANT = 0.04  # In N m/A, likewise.

HALL = 1  # Mode of an encoder that is three Hall sensors.


def conventions(values: Values) -> Iterator[str]:
    """Sentences on how numbers are meant that a reader could take otherwise.

    Args:
        values: By name below the axis.
    """
    constant = _odrive_sentences_positive(values, "motor.config.torque_constant")
    if constant is not None:
        yield (
            f"torque_constant {constant:.6g} N m/A (peak of phase) is 8.27/KV: KV "
            f"{8.26993 / constant:.5g} rpm per volt between two phases (peak)"
        )
    elif "controller.config.vel_limit" in values:
        yield (
            "the file has no torque_constant, as before 0.5.1: in 0.4 speeds and gains were counts "
            "of the encoder, here they are taken as turns; check vel_limit"
        )
    if "motor.config.phase_inductance" in values:
        yield "phase_inductance stands for both axes"
    if "controller.config.vel_gain" in values:
        yield "vel_gain and vel_integrator_gain are in N m per turn/s and N m per turn"
    if values.get("motor.config.R_wL_FF_enable"):
        yield from _feedforward(values)


def contradictions(values: Values, period: float) -> Iterator[str]:
    """Sentences on what does not fit together.

    Args:
        values: By name below the axis.
        period: Of the control in s.
    """
    yield from _odrive_sentences_torque_constant(values)
    yield from _encoder(values, period)
    limit = _odrive_sentences_positive(values, "motor.config.current_lim")
    reach = _odrive_sentences_positive(values, "motor.config.requested_current_range")
    if limit is not None and reach is not None and limit > reach:
        yield (
            f"current_lim {limit:g} A is above requested_current_range {reach:g} A: the drive "
            "limits to what its amplifiers measure"
        )
    bandwidth = _odrive_sentences_positive(values, "motor.config.current_control_bandwidth")
    if bandwidth is not None and bandwidth * period > 0.5:
        yield (
            f"current_control_bandwidth {bandwidth:g} rad/s times the control's {period * 1e6:g} "
            f"us is {bandwidth * period:.2f}: above 0.5 the current loops ring"
        )
    if values.get("motor.config.pre_calibrated") and not (
        _odrive_sentences_positive(values, "motor.config.phase_resistance")
        and _odrive_sentences_positive(values, "motor.config.phase_inductance")
    ):
        yield "pre_calibrated is true, but phase_resistance or phase_inductance is zero"


def _odrive_sentences_positive(values: Values, key: str) -> float | None:
    value = values.get(key, 0.0)
    return float(value) if value > 0.0 else None


def _feedforward(values: Values) -> Iterator[str]:
    r_s = _odrive_sentences_positive(values, "motor.config.phase_resistance")
    inductance = _odrive_sentences_positive(values, "motor.config.phase_inductance")
    bandwidth = _odrive_sentences_positive(values, "motor.config.current_control_bandwidth")
    if r_s is not None and inductance is not None and bandwidth is not None:
        more = overshoot(1.0, bandwidth * inductance / r_s)
        yield (
            "R_wL_FF_enable adds R and omega L times the references to the voltages: a step of the "
            f"q current overshoots by {more:.1%}, the margins stay"
        )


def _odrive_sentences_torque_constant(values: Values) -> Iterator[str]:
    constant = _odrive_sentences_positive(values, "motor.config.torque_constant")
    flux = _odrive_sentences_positive(values, "sensorless_estimator.config.pm_flux_linkage")
    pairs = _odrive_sentences_positive(values, "motor.config.pole_pairs")
    if constant == DEFAULT_TORQUE_CONSTANT:
        yield "torque_constant 0.04 N m/A is what ODrive ships: 8.27/KV was not written there"
    elif constant and flux and pairs and abs(flux / DEFAULT_FLUX - 1.0) > 1e-4:
        made = torque_per_ampere(pairs, flux)
        if abs(made / constant - 1.0) > 0.02:
            yield (
                f"torque_constant {constant:.5g} N m/A is not 1.5 pole_pairs pm_flux_linkage = "
                f"{made:.5g} N m/A: one of them is of another motor"
            )


def _encoder(values: Values, period: float) -> Iterator[str]:
    bandwidth = _odrive_sentences_positive(values, "encoder.config.bandwidth")
    if bandwidth is not None and 2.0 * bandwidth * period >= 1.0:
        yield (
            f"encoder.config.bandwidth {bandwidth:g} rad/s: kp T = {2.0 * bandwidth * period:.3g} "
            "is not below 1, and ODrive stops with ERROR_UNSTABLE_GAIN"
        )
    pairs, counts = values.get("motor.config.pole_pairs"), values.get("encoder.config.cpr")
    if values.get("encoder.config.mode") == HALL and pairs and counts and counts != 6 * pairs:
        yield (
            f"encoder.config.cpr {counts:g} with Hall sensors is not 6 pole_pairs = {6 * pairs:g}"
        )


ODRIVE = FirmwareMethod(FIRMWARE, VERSION, "bandwidth", configure, profile, shortfalls)


# What the properties of an ODrive 0.5 amount to: constants, gains and rates in SI units.
#
# Facts of github.com/odriverobotics/ODrive, firmware 0.5.x: `MotorControl/motor.cpp`
# (update_current_controller_gains, update), `foc.cpp` (get_alpha_beta_output), `controller.cpp`
# (update), `encoder.cpp` (update_pll_gains, update), `odrive-interface.yaml` (names and types).

GIMBAL = 2  # Motor type for which amperes are meant as volts.
