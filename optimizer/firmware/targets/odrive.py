"""ODrive 0.5 (v3.x boards): one bandwidth and one inductance for both current loops, a speed
controller in N m on the speed of the encoder's PLL.

Sources: `SOURCES`; the properties and what they amount to are in
`dqforge.optimizer.firmware.odrive_format`.
"""

from __future__ import annotations

import math
from dataclasses import replace

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    LoopProfile,
    PiController,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import (
    Asked,
    FirmwareMethod,
    JudgedFirmware,
    Price,
    Shortfall,
    judge,
)
from dqforge.optimizer.firmware.moteus_format import (
    bandwidth_asked,
    d_current_missing,
    field_weakening_missing,
    gains_changed,
    held_bandwidth,
    rates_changed,
    rounded_down,
    saturation_unknown,
)
from dqforge.optimizer.firmware.odrive_format import (
    FIRMWARE,
    HIGH_CURRENT,
    MEASURED_INDUCTANCE,
    PERIOD,
    VELOCITY_RAMP,
    VERSION,
    as_printed,
    configuration,
    pll_gains,
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
    lead = f"current_control_bandwidth {bandwidth:g} rad/s is all that the current loops are told"
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
        "motor.config.torque_constant": 1.5 * drive.pole_pairs * drive.psi_pm,
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
    constant = 1.5 * drive.pole_pairs * drive.psi_pm
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
        f"the phase voltage ends at {VOLTAGE_SHARE:.0%} of v_dc/sqrt(3): so much lower is the base "
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


ODRIVE = FirmwareMethod(FIRMWARE, VERSION, "bandwidth", configure, profile, shortfalls)
