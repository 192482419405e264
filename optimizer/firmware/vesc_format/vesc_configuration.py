"""What the values of a VESC motor configuration amount to in SI units."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.field_origins import field_origins
from dqforge.optimizer.firmware.own_values import number
from dqforge.optimizer.firmware.vesc_format.vesc_contradictions import contradictions
from dqforge.optimizer.firmware.vesc_format.vesc_keys import (
    LOOP_DEFAULTS,
    VERSION,
    known_to,
    loop_number,
)

# Frequencies in Hz of the speed controller, by the number that the file holds.
LOOP_RATES = (25.0, 50.0, 100.0, 250.0, 500.0, 1000.0, 2500.0, 5000.0, 10000.0)
SPEED_GAIN = 20.0  # What VESC divides the speed gains by (foc_math.c, foc_run_pid_control_speed).

CONVENTIONS = (
    "resistance, inductance and flux linkage are those of one phase of the star",
    "currents and flux linkage are peak values",
    "foc_motor_l is the mean of L_d and L_q, foc_motor_ld_lq_diff is L_q - L_d",
    "foc_f_zv is twice the PWM frequency; the control step runs once per PWM period",
    "erpm count electrical revolutions per minute: mechanical ones times pole pairs",
    "s_pid_kp and s_pid_ki are 20 times the share of l_current_max per erpm",
)


def configuration(
    name: str,
    own: Mapping[str, OwnValue],
    origins: Mapping[str, Origin] | None = None,
    version: str = VERSION,
) -> Configuration:
    """A configuration from the values of the file, by its own names and in its own units.

    Args:
        name: Name of the drive.
        own: The values; what is not there is None in the result.
        origins: Where they stand, by the name of the key; none for values that are no file's.
        version: Version of the format.
    """
    found = {} if origins is None else origins
    return Configuration(
        firmware="vesc",
        version=version,
        name=name,
        drive=_drive(own),
        current_d=_pair(own, "foc_current_kp", "foc_current_ki", 1.0),
        current_q=_pair(own, "foc_current_kp", "foc_current_ki", 1.0),
        speed=_speed(own),
        own=dict(own),
        origins=field_origins(found, _FIELDS),
        conventions=(*CONVENTIONS, *_doubt(own, version)),
        contradictions=contradictions(own),
    )


def _doubt(own: Mapping[str, OwnValue], version: str) -> Iterator[str]:
    """What is not certain of the version, and of the observer that a file does not name."""
    if version != VERSION:
        yield (
            f"the file does not say its version; its keys are those of firmware {version}, and its "
            f"loops are computed with the structure of {VERSION}: check them against that firmware"
        )
    if "foc_observer_type" not in own:
        yield (
            "the file does not say foc_observer_type: "
            + (
                f"VESC Tool's default of {VERSION}, {LOOP_DEFAULTS['foc_observer_type']}, is taken"
                if known_to(version, "foc_observer_type")
                else "firmware of that age has the original observer of Ortega alone"
            )
        )


def erpm_per_speed(pole_pairs: float) -> float:
    """Electrical revolutions per minute of a mechanical speed of 1 rad/s."""
    return 30.0 / math.pi * pole_pairs


def speed_scale(pole_pairs: float, i_max: float) -> float:
    """Amperes per rad/s (mechanical) of a speed gain of 1 in the file."""
    return erpm_per_speed(pole_pairs) * i_max / SPEED_GAIN


def control_period(own: Mapping[str, OwnValue]) -> float | None:
    """Time between two control steps in s; None where the frequency is not there."""
    f_zv = number(own, "foc_f_zv")
    if not f_zv:
        return None
    return (1.0 if loop_number(own, "foc_control_sample_mode") == 1 else 2.0) / f_zv


def speed_period(own: Mapping[str, OwnValue]) -> float:
    """Time in s between two steps of the speed controller."""
    index = int(loop_number(own, "sp_pid_loop_rate"))
    return 1.0 / LOOP_RATES[min(max(index, 0), len(LOOP_RATES) - 1)]


def pole_pairs(own: Mapping[str, OwnValue]) -> int | None:
    """Number of pole pairs; None where the file has none, or not an even number of poles."""
    poles = number(own, "si_motor_poles")
    return int(poles) // 2 if poles and poles % 2 == 0 else None


def _drive(own: Mapping[str, OwnValue]) -> DriveValues:
    pairs, dead_time = pole_pairs(own), number(own, "foc_dt_us")
    l_mean, difference = number(own, "foc_motor_l"), number(own, "foc_motor_ld_lq_diff") or 0.0
    erpm, f_zv = number(own, "l_max_erpm"), number(own, "foc_f_zv")
    return DriveValues(
        pole_pairs=pairs,
        r_s=number(own, "foc_motor_r"),
        l_d=None if l_mean is None else l_mean - 0.5 * difference,
        l_q=None if l_mean is None else l_mean + 0.5 * difference,
        psi_pm=number(own, "foc_motor_flux_linkage"),
        i_max=number(own, "l_current_max"),
        omega_m_max=None if erpm is None or pairs is None else erpm / erpm_per_speed(pairs),
        f_sw=None if not f_zv else 0.5 * f_zv,
        dead_time=None if dead_time is None else 1e-6 * dead_time,
        t_s=control_period(own),
        t_speed=speed_period(own) if number(own, "s_pid_kp") is not None else None,
    )


def _pair(own: Mapping[str, OwnValue], kp: str, ki: str, scale: float) -> PiGains | None:
    proportional, integral = number(own, kp), number(own, ki)
    if proportional is None or integral is None:
        return None
    return PiGains(proportional * scale, integral * scale)


def _speed(own: Mapping[str, OwnValue]) -> PiGains | None:
    pairs, i_max = pole_pairs(own), number(own, "l_current_max")
    if pairs is None or i_max is None:
        return None
    return _pair(own, "s_pid_kp", "s_pid_ki", speed_scale(pairs, i_max))


_FIELDS = {
    "pole_pairs": ("si_motor_poles", "half of it"),
    "r_s": ("foc_motor_r", "as it is, Ohm of a phase"),
    "l_d": ("foc_motor_l", "less half of foc_motor_ld_lq_diff, H of a phase"),
    "l_q": ("foc_motor_l", "plus half of foc_motor_ld_lq_diff, H of a phase"),
    "psi_pm": ("foc_motor_flux_linkage", "as it is, Wb (peak of phase)"),
    "i_max": ("l_current_max", "as it is, A (peak of phase)"),
    "omega_m_max": ("l_max_erpm", "times pi/30 over the pole pairs, rad/s (mechanical)"),
    "f_sw": ("foc_f_zv", "half of it, Hz"),
    "t_s": ("foc_f_zv", "one PWM period, s"),
    "dead_time": ("foc_dt_us", "in s"),
    "current_d.kp": ("foc_current_kp", "as it is, V/A"),
    "current_d.ki": ("foc_current_ki", "as it is, V/(A s)"),
    "current_q.kp": ("foc_current_kp", "as it is, V/A"),
    "current_q.ki": ("foc_current_ki", "as it is, V/(A s)"),
    "speed.kp": ("s_pid_kp", "times 30/pi times pole pairs times l_current_max/20, A s/rad"),
    "speed.ki": ("s_pid_ki", "times 30/pi times pole pairs times l_current_max/20, A/rad"),
    "pll.kp": ("foc_pll_kp", "as it is, 1/s"),
    "pll.ki": ("foc_pll_ki", "as it is, 1/s^2"),
}
