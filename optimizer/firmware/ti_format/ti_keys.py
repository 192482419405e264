"""The macros of a motor in TI's universal motor control lab that a design decides, or that its
loops depend on.

Names and units are those of ``user_mtr1.h`` (TexasInstruments/motor-control-sdk,
tidm_02018_universal_motorcontrol); a name ends in the unit of its value.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware import own_values
from dqforge.optimizer.firmware.configuration import Number, OwnValue
from dqforge.optimizer.firmware.own_values import FLOAT32_DIGITS, float32_value, rounded

FIRMWARE = "TI's lab"  # Its name in messages.
VERSION = "universal lab 2024"
OLDER_LAB = "universal lab 3.03"
INSTASPIN = "user.h of InstaSPIN"

# Who says a value: the design itself, a rule for starting the motor, or the gains.
Decided = Literal["design", "start", "gains"]


@dataclass(frozen=True, slots=True)
class Key:
    """One macro: its name, whether it is a whole number, who decides it, and what it means."""

    name: str
    kind: Literal["whole", "real", "word"]
    decided: Decided
    says: str


# fmt: off
_MOTOR = (
    Key("TYPE", "word", "design", "a machine with permanent magnets"),
    Key("NUM_POLE_PAIRS", "whole", "design", "pole pairs"),
    Key("Rr_Ohm", "real", "design", "rotor resistance: none"),
    Key("Rs_Ohm", "real", "design", "resistance of a phase"),
    Key("Ls_d_H", "real", "design", "inductance of a phase, d axis"),
    Key("Ls_q_H", "real", "design", "inductance of a phase, q axis"),
    Key("RATED_FLUX_VpHz", "real", "design", "2 pi times the flux linkage (peak of phase)"),
    Key("MAGNETIZING_CURRENT_A", "real", "design", "magnetising current: none"),
    Key("MAX_CURRENT_A", "real", "design", "largest current, peak of phase"),
    Key("OVER_CURRENT_A", "real", "design", "current that trips: 125 % of the largest"),
    Key("INERTIA_Kgm2", "real", "design", "moment of inertia"),
    Key("RATED_VOLTAGE_V", "real", "design", "voltage of the dc link"),
    Key("FREQ_MAX_Hz", "real", "design", "largest electrical frequency"),
    Key("RES_EST_CURRENT_A", "real", "start", "for measuring the resistance: 10 % of the largest"),
    Key("IND_EST_CURRENT_A", "real", "start", "for measuring the inductance: minus 10 %"),
    Key("FLUX_EXC_FREQ_Hz", "real", "start", "for measuring the flux: 10 % of it"),
    Key("FREQ_MIN_Hz", "real", "start", "least frequency: 1.5 % of the largest"),
    Key("FREQ_LOW_Hz", "real", "start", "V/f profile, level 2: 10 %"),
    Key("FREQ_HIGH_Hz", "real", "start", "V/f profile: 100 %"),
    Key("VOLT_MIN_V", "real", "start", "V/f profile: 15 % of the peak phase voltage"),
    Key("VOLT_MAX_V", "real", "start", "V/f profile: 100 % of it"),
    Key("FORCE_DELTA_A", "real", "start", "step of current in forced rotation: 1 %"),
    Key("ALIGN_DELTA_A", "real", "start", "step of the current while aligning: 0.2 %"),
    Key("FLUX_CURRENT_A", "real", "start", "d current in forced rotation: 10 %"),
    Key("ALIGN_CURRENT_A", "real", "start", "current that aligns the rotor: 25 %"),
    Key("STARTUP_CURRENT_A", "real", "start", "current until the speed is SPEED_START: 50 %"),
    Key("TORQUE_CURRENT_A", "real", "start", "current of the torque mode: 50 %"),
    Key("SPEED_START_Hz", "real", "start", "speed of closed loops: 6 % of the largest frequency"),
    Key("SPEED_FORCE_Hz", "real", "start", "forced rotation: 5 %"),
    Key("ACCEL_START_Hzps", "real", "start", "slope of forced rotation: 5 % per second"),
    Key("ACCEL_MAX_Hzps", "real", "start", "slope of the speed reference: 100 % per second"),
    Key("SPEED_FS_Hz", "real", "start", "flying start: 0.5 %"),
    Key("SPEED_LPF_FC_Hz", "real", "start", "corner of the filter on the speed (eSMO)"),
    Key("GAIN_SPEED_LOW_Hz", "real", "start", "below it the LOW gains of the speed: 10 %"),
    Key("GAIN_SPEED_HIGH_Hz", "real", "start", "above it the HIGH gains: 50 %"),
    Key("GAIN_IQ_LOW_A", "real", "start", "below it the LOW gains of the q current: 10 %"),
    Key("GAIN_IQ_HIGH_A", "real", "start", "above it the HIGH gains: 50 %"),
    *(
        Key(f"{gain}_{loop}_{where}SF", "real", "gains", f"{words} of TI's own gain")
        for loop, places, words in (
            ("ID", ("",), "d current: multiple"),
            ("IQ", ("START_", "LOW_", "HIGH_"), "q current: multiple"),
            ("SPD", ("START_", "LOW_", "HIGH_"), "speed: multiple"),
        )
        for where in places
        for gain in ("KP", "KI")
    ),
)
_BOARD = (
    Key("NOMINAL_DC_BUS_VOLTAGE_V", "real", "design", "voltage of the dc link"),
    Key("PWM_FREQ_kHz", "real", "design", "PWM frequency"),
    Key("NUM_PWM_TICKS_PER_ISR_TICK", "whole", "design", "PWM periods per control step: 1, 2 or 3"),
    Key("NUM_ISR_TICKS_PER_SPEED_TICK", "whole", "design", "control steps per speed step"),
    Key("MAX_VS_MAG_PU", "real", "design", "largest voltage over that of the dc link: 1/sqrt(3)"),
    Key("ADC_FULL_SCALE_CURRENT_A", "real", "design", "current over all codes of the converter"),
)
# fmt: on

MOTOR_PREFIX = "USER_MOTOR1_"
BOARD_PREFIX = "USER_M1_"

# What `configure` writes, by the name of the macro, in the order of the file.
KEYS: Mapping[str, Key] = {
    f"{prefix}{key.name}": Key(f"{prefix}{key.name}", key.kind, key.decided, key.says)
    for prefix, keys in ((MOTOR_PREFIX, _MOTOR), (BOARD_PREFIX, _BOARD))
    for key in keys
}

# What is read beside that, to hold it against the rest.
READ_ONLY: Mapping[str, Key] = {
    "USER_MOTOR1_RATED_SPEED_KRPM": Key(
        "USER_MOTOR1_RATED_SPEED_KRPM", "real", "design", "rated speed"
    )
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, FLOAT32_DIGITS)


def kept(value: float, asked_by: str) -> float:
    """A value as the file holds it; raises InputError, naming the key of the design, where a
    float32 cannot.
    """
    return float32_value(value, asked_by, FIRMWARE)


def number(own: Mapping[str, OwnValue], name: str) -> float | None:
    """A value of the motor (``Rs_Ohm``) or the board (``M1_...``) as a number, None without one."""
    full = f"USER_{name}" if name.startswith("M1_") else MOTOR_PREFIX + name
    return own_values.number(own, full)


def known(own: Mapping[str, OwnValue], name: str, otherwise: Number) -> float:
    """As `number`, with TI's own value where the file is silent."""
    value = number(own, name)
    return float(otherwise) if value is None else value
