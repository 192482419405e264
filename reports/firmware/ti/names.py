"""Names of TI's motor macros: those of today, of older labs and of the second motor."""

from __future__ import annotations

import re

from dqforge.optimizer.firmware.ti_format import BOARD_PREFIX, KEYS, MOTOR_PREFIX, READ_ONLY

READ = (*KEYS, *READ_ONLY)  # Macros that are read; all others of a file are kept and not looked at.

# What older labs called a macro of the motor, by its name of today.
_FORMER_MOTOR = {
    "Rr_Ohm": ("Rr",),
    "Rs_Ohm": ("Rs",),
    "Ls_d_H": ("Ls_d",),
    "Ls_q_H": ("Ls_q",),
    "RATED_FLUX_VpHz": ("RATED_FLUX",),
    "MAGNETIZING_CURRENT_A": ("MAGNETIZING_CURRENT",),
    "MAX_CURRENT_A": ("MAX_CURRENT",),
    "RES_EST_CURRENT_A": ("RES_EST_CURRENT",),
    "IND_EST_CURRENT_A": ("IND_EST_CURRENT",),
    "FLUX_EXC_FREQ_Hz": ("FLUX_EST_FREQ_Hz",),
    "FREQ_LOW_Hz": ("FREQ_LOW",),
    "FREQ_HIGH_Hz": ("FREQ_HIGH",),
    "FREQ_MAX_Hz": ("FREQ_MAX",),
    "VOLT_MIN_V": ("VOLT_MIN",),
    "VOLT_MAX_V": ("VOLT_MAX",),
    "KP_IQ_HIGH_SF": ("KP_IQ_SF",),
    "KI_IQ_HIGH_SF": ("KI_IQ_SF",),
}

_FORMER_BOARD = {
    "PWM_FREQ_kHz": ("NUM_PWM_FREQ_kHz",),
    "NUM_ISR_TICKS_PER_SPEED_TICK": ("NUM_CTRL_TICKS_PER_SPEED_TICK",),
}

_PREFIXES = (
    ("USER_MOTOR1_", "USER_M1_"),
    ("USER_MOTOR2_", "USER_M2_"),
    ("USER_MOTOR_", "USER_"),
)

# One block of a file that holds several motors: the macro that chooses, and the motor's name.
CHOICE = re.compile(
    r"^[ \t]*#[ \t]*(?:el)?if\b[^\n]*?\b(USER_MOTOR[12]?)[ \t]*==[ \t]*\(?([A-Za-z_]\w{0,80})",
    re.MULTILINE | re.ASCII,
)


def prefixes_of(text: str) -> tuple[str, str] | None:
    """Prefixes of the motor's and of the board's macros in a text; None where it holds neither."""
    for motor, board in _PREFIXES:
        if motor in text:
            return motor, board
    return None


def candidates(name: str, prefixes: tuple[str, str]) -> tuple[str, ...]:
    """What a macro may be called in a file with other prefixes, the likeliest first."""
    motor, board = prefixes
    of_motor = name.startswith(MOTOR_PREFIX)
    prefix, bare = (motor, name[len(MOTOR_PREFIX) :]) if of_motor else (board, _bare(name))
    former = (_FORMER_MOTOR if of_motor else _FORMER_BOARD).get(bare, ())
    upper = (f"{bare[:-2]}HZ",) if bare.endswith("_Hz") else ()
    return tuple(prefix + part for part in (bare, *upper, *former))


def _bare(name: str) -> str:
    return name[len(BOARD_PREFIX) :]
