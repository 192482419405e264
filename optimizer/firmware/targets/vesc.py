"""VESC (bldc firmware): its configuration for a design, and the loops that it then runs."""

from __future__ import annotations

import math

from dqforge.machines.errors import InputError
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    CurrentLoops,
    DriveValues,
    FluxObserver,
    LoopProfile,
    Number,
    OwnValue,
    PiController,
    PiGains,
    SpeedController,
    SpeedEstimate,
)
from dqforge.optimizer.firmware.firmware_method import Asked, FirmwareMethod, Shortfall, number
from dqforge.optimizer.firmware.vesc_format import (
    KEYS,
    LOOP_RATES,
    OBSERVER_RATE,
    VERSION,
    configuration,
    control_period,
    erpm_per_speed,
    has_two_observers,
    kept,
    known_to,
    loop_number,
    pole_pairs,
    speed_period,
    speed_scale,
    tracking_poles,
)
from dqforge.optimizer.firmware.vesc_format import shortfalls as found_shortfalls

SOURCES = (
    "vedderb/bldc b9d287b motor/mcpwm_foc.c:4631-4680: both PI controllers, d axis first",
    "vedderb/bldc b9d287b motor/mcpwm_foc.c timer_reinit: centre-aligned, loaded at each end",
    "vedderb/bldc b9d287b motor/mcpwm_foc.c:3636: currents of most torque per ampere",
    "vedderb/bldc b9d287b motor/foc_math.c: foc_pll_run, foc_run_pid_control_speed",
    "vedderb/bldc b9d287b motor/foc_math.c: foc_observer_update",
    "vedderb/bldc b9d287b conf_general.c:1513-1527: gains from R, L and lambda",
    "vedderb/vesc_tool 461ecc6 res/config/7.01/parameters_mcconf.xml: names, kinds, limits",
)

TRIP_SHARE = 1.5  # Current that trips over the permitted one.

# foc_pll_kp that is written: VESC's default, with which kp^2/4 is just what foc_pll_ki holds.
TRACKING_GAIN = 2000.0

# Share of the newest value in the filtered speeds, by s_pid_speed_source.
FAST_FILTERS = {1: 0.01, 2: 0.2}
_SAME = 1.001
_TWO_OBSERVERS = ("ortega original", "ortega iterative")

_OBSERVERS = (
    "ortega original",
    "mxlemming",
    "ortega lambda comp",
    "mxlemming lambda comp",
    "mxv",
    "mxv lambda comp",
    "mxv lambda comp lin",
)


def rule(r_s: float, inductance: float, psi_pm: float, tc: float = 1e-3) -> dict[str, float]:
    """VESC's own gains: kp = L/tc, ki = R/tc, and 1000/lambda^2 of the observer.

    Args:
        r_s, inductance, psi_pm: Resistance in Ohm, mean inductance in H and flux linkage in Wb of a
            phase.
        tc: Time constant of the current loop in s.
    """
    return {
        "foc_current_kp": inductance / tc,
        "foc_current_ki": r_s / tc,
        "foc_observer_gain": OBSERVER_RATE / (psi_pm * psi_pm),
    }


def configure(asked: Asked) -> Configuration:
    """The configuration for a design; of gains of two axes their mean.

    Raises:
        InputError: The design has no magnet, or a value does not fit the format; with the key.
    """
    drive = asked.drive
    own: dict[str, OwnValue] = {"motor_type": kept("motor_type", 2, "control.firmware")}
    own |= _limits(drive)
    own |= _gains(asked)
    own |= _machine(drive)
    own |= _structure(asked)
    if asked.speed is not None:
        own |= _speed(drive, asked.speed)
    own |= _tracking(asked)
    own["si_motor_poles"] = kept(
        "si_motor_poles", 2 * _known(drive.pole_pairs), "machine.pole_pairs"
    )
    return configuration(asked.design.name, own)


def profile(found: Configuration) -> LoopProfile:
    """The loops that VESC runs with a configuration.

    Raises:
        InputError: It says nothing of the current controllers, or of their period.
    """
    own, t_s = found.own, control_period(found.own)
    if found.current_q is None or t_s is None:
        missing = "foc_f_zv" if t_s is None else "foc_current_kp and foc_current_ki"
        raise InputError(
            f"the configuration of VESC has no {missing}, which its current loops need; save the "
            f"whole motor configuration with VESC Tool"
        )
    mtpa = loop_number(own, "foc_mtpa_mode") > 0 and bool(number(own, "foc_motor_ld_lq_diff"))
    return LoopProfile(
        firmware="vesc",
        version=found.version,
        current=_current(found, found.current_q, t_s),
        speed=_speed_loop(found, t_s),
        observer=_observer(found),
        reference="mtpa-linear" if mtpa else "id-zero",
        sources=SOURCES,
    )


def shortfalls(asked: Asked, held: Configuration) -> tuple[Shortfall, ...]:
    """What the configuration cannot hold of what was asked."""
    return found_shortfalls(asked, held, profile(held))


def _known(value: int | None) -> int:
    if value is None:
        raise InputError("machine: VESC needs the number of poles; give poles or pole_pairs")
    return value


def _limits(drive: DriveValues) -> dict[str, Number]:
    if drive.i_max is None:
        raise InputError("machine.max_current: VESC needs a largest current; give it")
    key = "machine.max_current"
    values = {
        "l_current_max": kept("l_current_max", drive.i_max, key),
        "l_current_min": kept("l_current_min", -drive.i_max, key),
        "l_abs_current_max": kept("l_abs_current_max", TRIP_SHARE * drive.i_max, key),
    }
    if drive.omega_m_max is not None:
        erpm = drive.omega_m_max * erpm_per_speed(_known(drive.pole_pairs))
        values["l_min_erpm"] = kept("l_min_erpm", -erpm, "machine.max_speed")
        values["l_max_erpm"] = kept("l_max_erpm", erpm, "machine.max_speed")
    return values


def _zero_vectors(f_sw: float) -> Number:
    most = KEYS["foc_f_zv"].most
    if 2.0 * f_sw > most:
        raise InputError(
            f"inverter.switching_frequency: VESC's foc_f_zv, twice it, holds at most {most:g}; "
            f"write at most {0.5e-3 * most:g} kHz, and control.sampling_frequency with it"
        )
    return kept("foc_f_zv", 2.0 * f_sw, "inverter.switching_frequency")


def _gains(asked: Asked) -> dict[str, Number]:
    """One pair for both axes: the mean, as VESC takes the mean inductance."""
    kp = 0.5 * (asked.current_d.kp + asked.current_q.kp)
    ki = 0.5 * (asked.current_d.ki + asked.current_q.ki)
    values = {
        "foc_current_kp": kept("foc_current_kp", kp, "control.current_loop"),
        "foc_current_ki": kept("foc_current_ki", ki, "control.current_loop"),
    }
    if asked.drive.f_sw is not None:
        values["foc_f_zv"] = _zero_vectors(asked.drive.f_sw)
    if asked.drive.dead_time:
        values["foc_dt_us"] = kept("foc_dt_us", 1e6 * asked.drive.dead_time, "inverter.dead_time")
    return values


def _machine(drive: DriveValues) -> dict[str, Number]:
    if drive.r_s is None or drive.l_d is None or drive.l_q is None:
        raise InputError("machine: VESC needs resistance and inductances; give them")
    if not drive.psi_pm or drive.psi_pm < 0.0:
        raise InputError(
            "machine.magnet_flux: VESC finds the rotor by the flux of its magnets; a machine "
            "without any needs another firmware"
        )
    own = rule(drive.r_s, 0.5 * (drive.l_d + drive.l_q), drive.psi_pm)
    return {
        "foc_motor_l": kept("foc_motor_l", 0.5 * (drive.l_d + drive.l_q), "machine.inductance_q"),
        "foc_motor_ld_lq_diff": kept(
            "foc_motor_ld_lq_diff", drive.l_q - drive.l_d, "machine.inductance_q"
        ),
        "foc_motor_r": kept("foc_motor_r", drive.r_s, "machine.resistance"),
        "foc_motor_flux_linkage": kept(
            "foc_motor_flux_linkage", drive.psi_pm, "machine.magnet_flux"
        ),
        "foc_observer_gain": kept(
            "foc_observer_gain", own["foc_observer_gain"], "machine.magnet_flux"
        ),
    }


def _structure(asked: Asked) -> dict[str, Number]:
    drive = asked.drive
    both = drive.f_sw is not None and drive.t_s is not None and drive.t_s * drive.f_sw < 0.75
    salient = asked.design.strategy == "mtpa" and drive.l_d != drive.l_q
    return {
        "foc_control_sample_mode": kept(
            "foc_control_sample_mode", int(both), "control.sampling_frequency"
        ),
        "foc_cc_decoupling": kept("foc_cc_decoupling", 3, "control.current_loop"),
        "foc_mtpa_mode": kept("foc_mtpa_mode", int(salient), "operation.strategy"),
    }


def _speed(drive: DriveValues, asked: PiGains) -> dict[str, Number]:
    """Speed gains, without derivative, on the speed of the tracking loop."""
    scale = speed_scale(_known(drive.pole_pairs), drive.i_max or math.nan)
    rate = 1.0 / drive.t_speed if drive.t_speed else 1000.0
    not_slower = [index for index, found in enumerate(LOOP_RATES) if found >= rate / _SAME]
    number_of_rate = min(not_slower, default=len(LOOP_RATES) - 1)
    key = "control.speed_loop"
    return {
        "sp_pid_loop_rate": kept("sp_pid_loop_rate", number_of_rate, key),
        "s_pid_kp": kept("s_pid_kp", asked.kp / scale, key),
        "s_pid_ki": kept("s_pid_ki", asked.ki / scale, key),
        "s_pid_kd": kept("s_pid_kd", 0.0, key),
        "s_pid_speed_source": kept("s_pid_speed_source", 0, key),
    }


def _tracking(asked: Asked) -> dict[str, Number]:
    """The tracking loop where it is asked for, or makes the speed that is controlled: then both of
    its poles are fast, while VESC's default of foc_pll_ki puts one of them at 15 rad/s.
    """
    wanted = asked.pll
    if wanted is None and asked.speed is not None:
        wanted = PiGains(TRACKING_GAIN, 0.25 * TRACKING_GAIN * TRACKING_GAIN)
    if wanted is None:
        return {}
    return {
        "foc_pll_kp": kept("foc_pll_kp", wanted.kp, "control.firmware.pll_kp"),
        "foc_pll_ki": kept("foc_pll_ki", wanted.ki, "control.firmware.pll_ki"),
    }


def _current(found: Configuration, gains: PiGains, t_s: float) -> CurrentLoops:
    """The integral first, no back-calculation; the d voltage before the q voltage.

    Duty cycles are loaded at either end of the counter: half a PWM period after the sampling, which
    is half a control period where it runs once per PWM period.
    """
    own = found.own
    pi = PiController(gains.kp, gains.ki, t_s, rule="integral-first", anti_windup="clamp")
    fed = int(loop_number(own, "foc_cc_decoupling"))
    share = loop_number(own, "l_max_duty") * loop_number(own, "foc_overmod_factor")
    return CurrentLoops(
        d=pi,
        q=pi,
        delay=1.0 if loop_number(own, "foc_control_sample_mode") == 1 else 0.5,
        cross=fed in (1, 3),
        back_emf=fed in (2, 3),
        order="d-first",
        voltage_share=share,
    )


def _speed_loop(found: Configuration, t_s: float) -> SpeedController | None:
    if found.speed is None:
        return None
    own, pairs = found.own, pole_pairs(found.own)
    ramped_at_all = known_to(found.version, "s_pid_ramp_erpms_s") or "s_pid_ramp_erpms_s" in own
    ramp = loop_number(own, "s_pid_ramp_erpms_s") if ramped_at_all else 0.0
    pi = PiController(
        found.speed.kp,
        found.speed.ki,
        speed_period(own),
        rule="integral-last",
        anti_windup="clamp",
        limit=found.drive.i_max,
    )
    ramped = ramp / erpm_per_speed(pairs) if ramp > 0.0 and pairs is not None else None
    return SpeedController(pi, _speed_estimate(found, t_s), ramped)


def _speed_estimate(found: Configuration, t_s: float) -> SpeedEstimate:
    own = found.own
    share = FAST_FILTERS.get(int(loop_number(own, "s_pid_speed_source")))
    if share is not None:
        return SpeedEstimate("low-pass", t_s, filter_time=t_s * (1.0 - share) / share)
    return SpeedEstimate(
        "pll", t_s, kp=loop_number(own, "foc_pll_kp"), ki=loop_number(own, "foc_pll_ki")
    )


def _observer(found: Configuration) -> FluxObserver:
    own = found.own
    chosen = known_to(found.version, "foc_observer_type") or "foc_observer_type" in own
    index = int(loop_number(own, "foc_observer_type")) if chosen else 0

    names = _TWO_OBSERVERS if has_two_observers(found.version) else _OBSERVERS
    name = names[index] if 0 <= index < len(names) else f"foc_observer_type {index}"
    gain, psi = number(own, "foc_observer_gain"), number(own, "foc_motor_flux_linkage")
    corrects = name.startswith("ortega") and gain is not None and psi is not None
    rate = gain * psi * psi if corrects and gain is not None and psi is not None else None
    return FluxObserver(name, rate, _warnings(found))


def _warnings(found: Configuration) -> tuple[str, ...]:
    own = found.own
    kp, ki = loop_number(own, "foc_pll_kp"), loop_number(own, "foc_pll_ki")
    slow, fast = tracking_poles(kp, ki)
    controlled = found.speed is not None and loop_number(own, "s_pid_speed_source") == 0
    if not controlled or slow >= 0.1 * fast:
        return ()
    words = (
        f"foc_pll_kp {kp:g} with foc_pll_ki {ki:g} puts a pole of the speed that is controlled at "
        f"{slow:.3g} rad/s: a fast speed loop oscillates on it; foc_pll_ki = foc_pll_kp^2/4 = "
        f"{0.25 * kp * kp:g} puts both at {0.5 * kp:g} rad/s"
    )
    return (words,)


VESC = FirmwareMethod("vesc", VERSION, "one-pair", configure, profile, shortfalls)
