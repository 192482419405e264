"""The keys of VESC's motor configuration that a design decides, or that its loops depend on.

Names, kinds and permitted values are those of VESC Tool's ``res/config/7.01/parameters_mcconf.xml``
(vedderb/vesc_tool 461ecc6); the tool takes others without a word.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Literal

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Number, OwnValue
from dqforge.optimizer.firmware.own_values import number, rounded

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
