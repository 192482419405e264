"""The keys of VESC's motor configuration that a design decides, or that its loops depend on.

Names, kinds and permitted values are those of VESC Tool's ``res/config/7.01/parameters_mcconf.xml``
(vedderb/vesc_tool 461ecc6); the tool takes others without a word.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from typing import Literal

from dqforge.machines.dq_machines.synchronous import torque_per_ampere
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm, linear_voltage
from dqforge.optimizer.firmware.configuration import (
    Configuration,
    DriveValues,
    LoopProfile,
    Number,
    Origin,
    OwnValue,
    PiGains,
)
from dqforge.optimizer.firmware.firmware_method import (
    NOTICED,
    Asked,
    Price,
    Shortfall,
    closed_form_currents,
    field_origins,
    judge,
    number,
    other_periods,
    rounded,
)

VERSION = "7.01"
_LAST_OF_TWO = "5.03"

# Versions of the firmware with the keys that came with each (CHANGELOG.md of vedderb/bldc, held
# against ``parameters_mcconf.xml`` of 3.57, 5.02, 6.00 and 7.01); 6.05 and later have the keys that
# loops depend on as 7.01 has them.
_AGES = (
    ("before 3.66", ()),
    ("3.66 to 5.01", ("foc_observer_type", "foc_cc_decoupling")),
    ("5.02", ("s_pid_ramp_erpms_s",)),
    (_LAST_OF_TWO, ("sp_pid_loop_rate",)),
    ("6.00 to 6.02", ("foc_sl_openloop_boost_q", "foc_sl_openloop_max_q")),
    (VERSION, ("s_pid_speed_source", "foc_control_sample_mode")),
)

_OLD_SAMPLING, _OLD_FREQUENCY = "foc_sample_v0_v7", "foc_f_sw"  # Keys that 6.05 and 6.00 replaced.
_TWO_OBSERVERS_UNTIL = [age for age, _ in _AGES].index(_LAST_OF_TWO)


def version_of(written: Collection[str], *, whole: bool) -> str:
    """Version of the firmware whose keys a file has.

    Args:
        written: Names of keys as the file spells them.
        whole: Whether the file has all keys of its version, as XML of the tool does: then what it
            lacks says as much as what it has. A header may leave out what a board does not change.
    """
    newest = max(
        (age for age, (_, keys) in enumerate(_AGES) if any(key in written for key in keys)),
        default=0,
    )
    if not whole:
        newest = len(_AGES) - (2 if _OLD_SAMPLING in written else 1)
        newest = _TWO_OBSERVERS_UNTIL if _OLD_FREQUENCY in written else newest
    return _AGES[newest][0]


def has_two_observers(version: str) -> bool:
    """Whether foc_observer_type 1 stands for another observer than today: before 6.00 there were
    two.
    """
    names = [age for age, _ in _AGES]
    return version in names[: _TWO_OBSERVERS_UNTIL + 1]


def known_to(version: str, name: str) -> bool:
    """Whether the firmware of a version has a key."""
    names = [age for age, _ in _AGES]
    since = next((age for age, (_, keys) in enumerate(_AGES) if name in keys), 0)
    return version not in names or names.index(version) >= since


SIGNIFICANT = 6  # Significant digits that the tool prints of a number (configparams.cpp, getXML).


@dataclass(frozen=True, slots=True)
class Key:
    """One key: its name in the file, whether it is a whole number, and the permitted values.

    ``says`` is what it means, with its unit.
    """

    name: str
    kind: Literal["whole", "real"]
    least: float
    most: float
    says: str


# fmt: off
KEYS = {key.name: key for key in (
    Key("motor_type", "whole", 0, 2, "2 for field-oriented control"),
    Key("l_current_max", "real", 0.0, 5000.0, "largest current, A (peak of phase)"),
    Key("l_current_min", "real", -5000.0, 0.0, "largest braking current, A (peak), negative"),
    Key("l_abs_current_max", "real", 0.0, 5000.0, "current that trips, A (peak)"),
    Key("l_min_erpm", "real", -1e6, 0.0, "electrical speed backwards, rev/min"),
    Key("l_max_erpm", "real", 0.0, 1e6, "electrical speed, rev/min"),
    Key("foc_current_kp", "real", 0.0, 1e5, "gain of both current controllers, V/A"),
    Key("foc_current_ki", "real", 0.0, 1e5, "integral gain of both, V/(A s)"),
    Key("foc_f_zv", "real", 0.0, 150e3, "zero vectors per second: twice the PWM frequency, Hz"),
    Key("foc_dt_us", "real", 0.0, 1000.0, "dead time that the observer allows for, us"),
    Key("foc_pll_kp", "real", 0.0, 1e6, "gain of the tracking loop for the speed, 1/s"),
    Key("foc_pll_ki", "real", 0.0, 1e6, "integral gain of that loop, 1/s^2"),
    Key("foc_motor_l", "real", 0.0, 10.0, "mean of L_d and L_q of a phase, H"),
    Key("foc_motor_ld_lq_diff", "real", -10.0, 10.0, "L_q - L_d, H"),
    Key("foc_motor_r", "real", 0.0, 1000.0, "resistance of a phase, Ohm"),
    Key("foc_motor_flux_linkage", "real", 0.0, 1000.0, "flux linkage of the magnets, Wb (peak)"),
    Key("foc_observer_gain", "real", 0.0, 2e10, "gain of the flux observer, 1/(s Wb^2)"),
    Key("foc_control_sample_mode", "whole", 0, 2, "0: one control step per PWM period"),
    Key("foc_cc_decoupling", "whole", 0, 3, "what is fed forward: 1 cross, 2 back-EMF, 3 both"),
    Key("foc_mtpa_mode", "whole", 0, 2, "currents of most torque per ampere: 1 of the command"),
    Key("sp_pid_loop_rate", "whole", 0, 8, "how often the speed controller runs, by number"),
    Key("s_pid_kp", "real", 0.0, 1e4, "speed gain, 20 x share of l_current_max per erpm"),
    Key("s_pid_ki", "real", 0.0, 1e4, "its integral gain, the same per second"),
    Key("s_pid_kd", "real", 0.0, 1e4, "its derivative gain"),
    Key("s_pid_speed_source", "whole", 0, 2, "which speed is controlled: 0 of the tracking loop"),
    Key("si_motor_poles", "whole", 2, 254, "number of poles: twice the pole pairs"),
)}
# fmt: on

"""The keys that `configure` writes, in the order of the file."""


# What the loops depend on where a file is silent: the tool's own defaults.
LOOP_DEFAULTS: Mapping[str, Number] = {
    "foc_pll_kp": 2000.0,
    "foc_pll_ki": 30000.0,
    "foc_control_sample_mode": 0,
    "foc_cc_decoupling": 0,
    "foc_observer_type": 3,
    "foc_observer_gain_slow": 0.05,
    "foc_overmod_factor": 1.0,
    "foc_mtpa_mode": 0,
    "foc_sensor_mode": 0,
    "l_max_duty": 0.95,
    "sp_pid_loop_rate": 5,
    "s_pid_ramp_erpms_s": 25000.0,
    "s_pid_speed_source": 0,
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, SIGNIFICANT)


def kept(name: str, value: float, asked_by: str) -> Number:
    """A value as the file holds it.

    Raises InputError, naming the key of the design that asks for it, where it cannot be held.
    """
    key = KEYS[name]
    held = round(value) if key.kind == "whole" else as_printed(value)
    if not key.least <= held <= key.most:
        raise InputError(
            f"{asked_by}: VESC's {name} holds {key.least:g} to {key.most:g}, not {held:g}; "
            f"choose a design within that"
        )
    return held


def loop_number(own: Mapping[str, OwnValue], name: str) -> float:
    """A value of the file, or the tool's default."""
    value = number(own, name)
    return float(LOOP_DEFAULTS[name]) if value is None else value


# What the values of a VESC motor configuration amount to in SI units.

# Frequencies in Hz of the speed controller, by the number that the file holds.
LOOP_RATES = (25.0, 50.0, 100.0, 250.0, 500.0, 1000.0, 2500.0, 5000.0, 10000.0)
SPEED_GAIN = 20.0  # What VESC divides the speed gains by (foc_math.c, foc_run_pid_control_speed).

CONVENTIONS = (
    "resistance, inductance and flux linkage are those of one phase of the star",
    "currents and flux linkage are peak values",
    "foc_motor_l is the mean of L_d and L_q, foc_motor_ld_lq_diff is L_q - L_d",
    "foc_f_zv is twice the PWM frequency; the control step runs once per PWM period",
    "l_max_erpm and s_pid_kp count electrical rev/min: mechanical ones times pole pairs",
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
    return in_rpm(1.0) * pole_pairs


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
    "pole_pairs": ("si_motor_poles", "twice the pole pairs"),
    "r_s": ("foc_motor_r", "as it is, Ohm of a phase"),
    "l_d": ("foc_motor_l", "mean of L_d and L_q, with foc_motor_ld_lq_diff = L_q - L_d, H"),
    "l_q": ("foc_motor_l", "mean of L_d and L_q, with foc_motor_ld_lq_diff = L_q - L_d, H"),
    "psi_pm": ("foc_motor_flux_linkage", "as it is, Wb (peak of phase)"),
    "i_max": ("l_current_max", "as it is, A (peak of phase)"),
    "omega_m_max": ("l_max_erpm", "pole pairs times the speed in rev/min"),
    "f_sw": ("foc_f_zv", "twice the switching frequency, Hz"),
    "t_s": ("foc_f_zv", "the control runs once per PWM period"),
    "dead_time": ("foc_dt_us", "in us"),
    "current_d.kp": ("foc_current_kp", "as it is, V/A"),
    "current_d.ki": ("foc_current_ki", "as it is, V/(A s)"),
    "current_q.kp": ("foc_current_kp", "as it is, V/A"),
    "current_q.ki": ("foc_current_ki", "as it is, V/(A s)"),
    "speed.kp": ("s_pid_kp", "times 30/pi times pole pairs times l_current_max/20, A s/rad"),
    "speed.ki": ("s_pid_ki", "times 30/pi times pole pairs times l_current_max/20, A/rad"),
    "pll.kp": ("foc_pll_kp", "as it is, 1/s"),
    "pll.ki": ("foc_pll_ki", "as it is, 1/s^2"),
}


# What VESC's configuration cannot hold of a design, and what that costs.

_BACK_EMF_SHARE = 0.98
_MUCH = 0.01

# Share of the newest value in the speed that is fed forward (mcpwm_foc.c, m_speed_est_fast).
FAST_SHARE = 0.01


def shortfalls(asked: Asked, held: Configuration, runs: LoopProfile) -> tuple[Shortfall, ...]:
    """What the configuration does not hold of what was asked, each with its price.

    Args:
        asked: What was asked.
        held: What was made of it.
        runs: The loops that VESC runs with it.
    """
    return (
        *_one_pair(asked, held, runs),
        *_currents(asked, held),
        *other_periods(asked, held, "VESC"),
        *_voltage(asked, held),
        *_dead_time(asked, held),
        *_feed_forward(asked, runs),
    )


def _one_pair(asked: Asked, held: Configuration, runs: LoopProfile) -> Iterator[Shortfall]:
    gains = held.current_q
    if gains is None or (asked.current_d, asked.current_q) == (gains, gains):
        return
    if math.isclose(asked.current_d.kp, asked.current_q.kp, rel_tol=1e-4):
        return
    current = runs.current
    wished = replace(
        current,
        d=replace(current.d, kp=asked.current_d.kp, ki=asked.current_d.ki),
        q=replace(current.q, kp=asked.current_q.kp, ki=asked.current_q.ki),
    )
    now = judge(replace(runs, speed=None), asked.drive)
    then = judge(replace(runs, speed=None, current=wished), asked.drive)
    prices, words = [], []
    for axis, is_now, was in (
        ("d", now.current_d, then.current_d),
        ("q", now.current_q, then.current_q),
    ):
        if is_now is not None and was is not None:
            lost = was.phase_margin - is_now.phase_margin
            prices.append(Price(f"phase margin of the {axis} axis", lost, "rad"))
            words.append(
                f"the {axis} axis crosses over at {is_now.crossover:.4g} rad/s with "
                f"{math.degrees(is_now.phase_margin):.1f} deg instead of {was.crossover:.4g} rad/s "
                f"with {math.degrees(was.phase_margin):.1f} deg"
            )
    yield Shortfall(
        f"one foc_current_kp serves two inductances: {gains.kp:.4g} V/A stands for "
        f"{asked.current_d.kp:.4g} V/A (d) and {asked.current_q.kp:.4g} V/A (q); "
        + "; ".join(words),
        tuple(prices),
    )


def _currents(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    difference = number(held.own, "foc_motor_ld_lq_diff") or 0.0
    used = difference if loop_number(held.own, "foc_mtpa_mode") > 0 else 0.0
    lead = "VESC's currents of most torque per ampere"
    return closed_form_currents(asked, held, used, lead)


def _voltage(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    """l_max_duty keeps a share of the range; without field weakening the speed ends there."""
    share = loop_number(held.own, "l_max_duty") * loop_number(held.own, "foc_overmod_factor")
    limit = share * linear_voltage(asked.design.inverter.v_dc)
    lost = 1.0 - limit / asked.design.v_max
    if lost > NOTICED:
        yield Shortfall(
            f"VESC uses {100.0 * share:.3g} % of the linear range (l_max_duty): {limit:.4g} V of "
            f"the {asked.design.v_max:.4g} V that the design counts on",
            (Price("voltage", lost, ""),),
        )
    drive = asked.drive
    if drive.omega_m_max and drive.pole_pairs and drive.psi_pm:
        emf = drive.omega_m_max * drive.pole_pairs * drive.psi_pm
        if emf > _BACK_EMF_SHARE * limit:
            reached = limit / (drive.pole_pairs * drive.psi_pm)
            yield Shortfall(
                f"the back-EMF at the largest speed is {emf:.4g} V, the voltage {limit:.4g} V: "
                f"without foc_fw_current_max, which is not written, the speed ends at "
                f"{reached:.4g} rad/s",
                (Price("speed", 1.0 - reached / drive.omega_m_max, ""),),
            )


def _dead_time(asked: Asked, held: Configuration) -> Iterator[Shortfall]:
    drive = asked.drive
    if held.drive.dead_time and drive.f_sw and drive.v_dc:
        volts = held.drive.dead_time * drive.f_sw * drive.v_dc / 3.0
        yield Shortfall(
            f"VESC's observer takes off 4/3 of the voltage of the dead time foc_dt_us: "
            f"{volts:.3g} V too much; {0.75e6 * held.drive.dead_time:.4g} us would be exact",
            (Price("voltage in the observer", volts, "V"),),
        )


def _feed_forward(asked: Asked, runs: LoopProfile) -> Iterator[Shortfall]:
    """The speed that the back-EMF is fed forward with lags behind an acceleration."""
    drive, design = asked.drive, asked.design
    if not (runs.current.back_emf and drive.inertia and drive.pole_pairs and drive.psi_pm):
        return
    lag = runs.current.d.t_s * (1.0 - FAST_SHARE) / FAST_SHARE
    acceleration = torque_per_ampere(drive.pole_pairs, drive.psi_pm) * design.i_max / drive.inertia
    volts = drive.pole_pairs * drive.psi_pm * acceleration * lag
    if volts > _MUCH * design.v_max:
        yield Shortfall(
            f"VESC feeds the back-EMF forward by a speed that lags {1e3 * lag:.3g} ms: at "
            f"{acceleration:.4g} rad/s^2, the most that the current limit gives without load, "
            f"{volts:.3g} V are missing, which the integrals make up for",
            (Price("voltage of the feed-forward", volts, "V"),),
        )


# What in a VESC motor configuration does not fit together, and what in it is dangerous.

# Share by which numbers of one rule may differ: the tool shows some of them with four digits.
TOLERANCE = 0.01

# foc_observer_gain times the flux linkage squared by VESC's rule, in rad/s (conf_general.c).
OBSERVER_RATE = 1000.0
ENCODER = 1  # foc_sensor_mode of an encoder.


def contradictions(own: Mapping[str, OwnValue]) -> tuple[str, ...]:
    """Sentences on values that do not fit together, with both numbers.

    Args:
        own: Values of the file by its own names.
    """
    return (*_gains(own), *_observer(own), *_limits(own), *_machine(own))


def tracking_poles(kp: float, ki: float) -> tuple[float, float]:
    """Magnitudes in rad/s of the poles of s^2 + kp s + ki, the slower first."""
    inside = kp * kp - 4.0 * ki
    if inside <= 0.0:
        return math.sqrt(ki), math.sqrt(ki)
    root = math.sqrt(inside)
    return 2.0 * ki / (kp + root), 0.5 * (kp + root)


def _gains(own: Mapping[str, OwnValue]) -> Iterator[str]:
    kp, ki = number(own, "foc_current_kp"), number(own, "foc_current_ki")
    r_s, inductance = number(own, "foc_motor_r"), number(own, "foc_motor_l")
    if not kp or not ki or not r_s or not inductance:
        return
    fast, slow = kp / inductance, ki / r_s
    if abs(fast - slow) > TOLERANCE * max(fast, slow):
        yield (
            f"foc_current_kp {kp:g} is {fast:.4g} rad/s times L, foc_current_ki {ki:g} is "
            f"{slow:.4g} rad/s times R: by VESC's rule (kp = L/tc, ki = R/tc) ki would be "
            f"{kp * r_s / inductance:.4g}; edited by hand, tuned by another rule, or R or L was "
            f"measured again"
        )


def _observer(own: Mapping[str, OwnValue]) -> Iterator[str]:
    gain, psi = number(own, "foc_observer_gain"), number(own, "foc_motor_flux_linkage")
    r_s = number(own, "foc_motor_r")
    if not gain or not psi:
        return
    rate = gain * psi * psi
    if abs(rate - OBSERVER_RATE) > TOLERANCE * OBSERVER_RATE:
        older = ""
        if r_s and abs(rate - 10.0 / r_s) < TOLERANCE * rate:
            older = f"; older versions set 10/(R lambda^2) = {10.0 / (r_s * psi * psi):.4g}"
        yield (
            f"foc_observer_gain {gain:g} is {rate:.4g}/lambda^2 instead of VESC's 1000/lambda^2 = "
            f"{OBSERVER_RATE / (psi * psi):.4g}{older}"
        )


def _limits(own: Mapping[str, OwnValue]) -> Iterator[str]:
    i_max, trip = number(own, "l_current_max"), number(own, "l_abs_current_max")
    if i_max is not None and trip is not None and trip < i_max:
        yield (
            f"l_abs_current_max {trip:g} A trips below the permitted current l_current_max "
            f"{i_max:g} A"
        )
    braking = number(own, "l_current_min")
    if braking is not None and braking > 0.0:
        yield f"l_current_min {braking:g} A is not negative: it limits braking"


def _machine(own: Mapping[str, OwnValue]) -> Iterator[str]:
    inductance, difference = number(own, "foc_motor_l"), number(own, "foc_motor_ld_lq_diff")
    if inductance and difference and abs(difference) >= 2.0 * inductance:
        yield (
            f"foc_motor_ld_lq_diff {difference:g} H leaves one axis without inductance: "
            f"foc_motor_l is {inductance:g} H"
        )
    poles, ratio = number(own, "si_motor_poles"), number(own, "foc_encoder_ratio")
    if poles and poles % 2:
        yield f"si_motor_poles {poles:g} is odd: poles come in pairs"
    encoder = loop_number(own, "foc_sensor_mode") == ENCODER
    if encoder and poles and ratio and abs(ratio - 0.5 * poles) > 1e-3:
        yield (
            f"foc_encoder_ratio {ratio:g} is not half of si_motor_poles {poles:g}: an encoder on "
            f"the shaft turns the field {0.5 * poles:g} times a revolution"
        )
