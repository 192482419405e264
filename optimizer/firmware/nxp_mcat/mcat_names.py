"""Names of MCAT: its inputs by section, and its macros by section, in the order of its files."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import (
    FLOAT,
    FLOAT_2022_ONLY,
    FLOAT_2025_ONLY,
    ROOT_3,
    TORQUE,
    evaluate,
    fixed_constants,
    old_printed,
    printed,
)

_BOARD_INPUTS = (
    "parametersImax",
    "parametersUdcbMax",
    "parametersEmax",
    "parametersUdcbTrip",
    "parametersUdcbUnder",
    "parametersUdcbOver",
    "parametersNover",
    "parametersNmin",
    "parametersEblock",
    "parametersEblockPer",
    "parametersNmax",
    "parametersUdcbIIRf0",
    "parametersCalibDuration",
    "parametersFaultDuration",
    "parametersFreewheelDuration",
    "parametersScalarUqMin",
    "parametersAlignVoltage",
    "parametersAlignDuration",
    "parametersScalarVHzRatio",
)

# Inputs; MCAT asks for the section of the position loop, which a design does not decide.
INPUTS: dict[str, tuple[str, ...]] = {
    "parameters": (
        "parametersPP",
        "parametersRs",
        "parametersLd",
        "parametersLq",
        "parametersKe",
        "parametersKt",
        "parametersJ",
        "parametersIphNom",
        "parametersUphNom",
        "parametersNnom",
        *_BOARD_INPUTS,
    ),
    "currentLoop": (
        "currentLoopSampleTime",
        "currentLoopF0",
        "currentLoopKsi",
        "currentLoopOutputLimit",
    ),
    "speedLoop": (
        "speedLoopSampleTime",
        "speedLoopF0",
        "speedLoopKsi",
        "speedLoopIncUp",
        "speedLoopIncDown",
        "speedLoopCutOffFreq",
        "speedLoopUpperLimit",
        "speedLoopLowerLimit",
        "speedLoopSLKp",
        "speedLoopSLKi",
        "speedLoopManualConstantTunning",
    ),
    "positionLoop": (),
    "sensorless": (
        "sensorlessBemfObsrvF0",
        "sensorlessBemfObsrvKsi",
        "sensorlessTrackObsrvF0",
        "sensorlessTrackObsrvKsi",
        "sensorlessTrackObsrvIIRSpeedCutOff",
        "sensorlessStartupRamp",
        "sensorlessStartupCurrent",
        "sensorlessMergingSpeed",
        "sensorlessMergingCoeff",
    ),
}

# Other spellings of inputs, and those that stand for them here.
SPELLINGS = {"parametersPp": "parametersPP"}
FLAGS = ("speedLoopManualConstantTunning",)  # Inputs that are true or false.


def _filter(name: str) -> tuple[str, ...]:
    return (f"{name}_B0", f"{name}_B1", f"{name}_A1")


# Macros that MCAT makes of its inputs, as of the first motor.
MACROS: dict[str, tuple[str, ...]] = {
    "PARAMETERS": (
        "M1_MOTOR_PP",
        "M1_I_PH_NOM",
        "M1_N_NOM",
        "M1_I_MAX",
        "M1_U_DCB_MAX",
        "M1_U_DCB_TRIP",
        "M1_U_DCB_UNDERVOLTAGE",
        "M1_U_DCB_OVERVOLTAGE",
        "M1_N_OVERSPEED",
        "M1_N_MIN",
        "M1_E_BLOCK_TRH",
        "M1_E_BLOCK_PER",
        "M1_N_MAX",
        "M1_CALIB_DURATION",
        "M1_FAULT_DURATION",
        "M1_FREEWHEEL_DURATION",
        "M1_SCALAR_UQ_MIN",
        "M1_ALIGN_VOLTAGE",
        "M1_ALIGN_DURATION",
        "M1_U_MAX",
        "M1_E_MAX",
        "M1_FREQ_MAX",
        "M1_N_ANGULAR_MAX",
        *_filter("M1_UDCB_IIR"),
        "M1_SCALAR_VHZ_FACTOR_GAIN",
        "M1_SCALAR_VHZ_FACTOR_SHIFT",
        "M1_SCALAR_INTEG_GAIN",
        "M1_SCALAR_RAMP_UP",
        "M1_SCALAR_RAMP_DOWN",
    ),
    "CURRENTLOOP": (
        "M1_D_KP_GAIN",
        "M1_D_KI_GAIN",
        "M1_Q_KP_GAIN",
        "M1_Q_KI_GAIN",
        *_filter("M1_Q_IIR_ZC"),
        "M1_CLOOP_LIMIT",
    ),
    "SPEEDLOOP": (
        "M1_SPEED_RAMP_UP",
        "M1_SPEED_RAMP_DOWN",
        "M1_SPEED_LOOP_HIGH_LIMIT",
        "M1_SPEED_LOOP_LOW_LIMIT",
        "M1_SPEED_PI_PROP_GAIN",
        "M1_SPEED_PI_INTEG_GAIN",
        *_filter("M1_SPEED_IIR"),
        *_filter("M1_SPEED_IIR_ZC"),
    ),
    "SENSORLESS": (
        "M1_OL_START_RAMP_INC",
        "M1_OL_START_I",
        "M1_MERG_SPEED_TRH",
        "M1_MERG_COEFF",
        "M1_I_SCALE",
        "M1_U_SCALE",
        "M1_E_SCALE",
        "M1_WI_SCALE",
        "M1_BEMF_DQ_KP_GAIN",
        "M1_BEMF_DQ_KI_GAIN",
        "M1_TO_KP_SHIFT",
        "M1_TO_KP_GAIN",
        "M1_TO_KI_SHIFT",
        "M1_TO_KI_GAIN",
        "M1_TO_THETA_SHIFT",
        "M1_TO_THETA_GAIN",
        *_filter("M1_TO_SPEED_IIR"),
    ),
}

# Inputs that the board and the project decide, not the machine or its loops.
PROJECT_INPUTS = (
    *_BOARD_INPUTS,
    "speedLoopIncUp",
    "speedLoopIncDown",
    "sensorlessTrackObsrvIIRSpeedCutOff",
    "sensorlessStartupRamp",
    "sensorlessMergingSpeed",
    "sensorlessMergingCoeff",
)

# Constants that come of these inputs alone, with the periods and the pole pairs.
PROJECT_MACROS = (
    *(
        macro
        for macro in MACROS["PARAMETERS"]
        if macro not in ("M1_MOTOR_PP", "M1_I_PH_NOM", "M1_N_NOM", "M1_N_ANGULAR_MAX")
    ),
    "M1_SPEED_RAMP_UP",
    "M1_SPEED_RAMP_DOWN",
    "M1_OL_START_RAMP_INC",
    "M1_MERG_SPEED_TRH",
    "M1_MERG_COEFF",
    *_filter("M1_TO_SPEED_IIR"),
)


# The constants that MCAT makes of its inputs, as its file prints them, by edition.

MANUAL = "speedLoopManualConstantTunning"
SPEED_P, SPEED_I = "M1_SPEED_PI_PROP_GAIN", "M1_SPEED_PI_INTEG_GAIN"
_WHOLE = ("M1_N_MAX", "M1_FREQ_MAX")
_TENTHS = ("M1_U_MAX", "M1_N_NOM", "M1_N_MIN", "M1_N_OVERSPEED")

# Ends of the names of gains that an old fixed-point file prints as they are, 16 digits long.
_UNROUNDED = ("_KP_GAIN", "_KI_GAIN", "_PROP_GAIN", "_INTEG_GAIN")

# What an old file rounds upward at its twelfth place.
_UPWARD = (
    SPEED_P,
    SPEED_I,
    "M1_I_SCALE",
    "M1_U_SCALE",
    "M1_E_SCALE",
    "M1_WI_SCALE",
    "M1_BEMF_DQ_KP_GAIN",
    "M1_BEMF_DQ_KI_GAIN",
)


def constants(edition: Edition, inputs: Mapping[str, OwnValue]) -> dict[str, float]:
    """Constants by macro, rounded as the file prints them; those whose inputs are all there.

    Args:
        edition: The age of the format, and its arithmetic.
        inputs: By MCAT's keys; what is no number is left out.
    """
    known = numbers(edition, inputs)
    if edition.fixed:
        volts = _old_volts(known) if edition.commented else None
        found = fixed_constants(known, volts)
    else:
        found = _float(edition, known)
    if not edition.commented:
        return {name: printed(value) for name, value in found.items()}
    return {name: _old(edition, name, value) for name, value in found.items()}


def numbers(edition: Edition, inputs: Mapping[str, OwnValue]) -> dict[str, float]:
    """The inputs that are numbers, and the torque constant that the speed loop works with."""
    known = {key: float(value) for key, value in inputs.items() if not isinstance(value, str)}
    torque = torque_constant(edition, known)
    if torque is not None:
        known[TORQUE] = torque
    return known


def torque_constant(edition: Edition, inputs: Mapping[str, float]) -> float | None:
    """N m per ampere as the rule of the speed loop takes it.

    Until 2024 sqrt(3) times the back-EMF constant; since 2025 the torque constant itself, which
    first went by the old key; in fixed point always a key of its own.
    """
    e_m_f = inputs.get("parametersKe")
    if edition.fixed:
        return inputs.get("parametersKt")
    if edition.current_share == 1.0:
        return None if e_m_f is None else math.sqrt(3.0) * e_m_f
    return inputs.get("parametersKt", e_m_f)


def _float(edition: Edition, known: Mapping[str, float]) -> dict[str, float]:
    new = edition.current_share != 1.0
    found = evaluate(FLOAT | (FLOAT_2025_ONLY if new else FLOAT_2022_ONLY), known)
    if new:
        found |= _zero_cancelling("M1_Q_IIR_ZC", "M1_Q_KP_GAIN", "M1_Q_KI_GAIN", found)
        found |= _zero_cancelling("M1_SPEED_IIR_ZC", SPEED_P, SPEED_I, found)
    if known.get(MANUAL):
        found |= {
            macro: known[key]
            for macro, key in ((SPEED_P, "speedLoopSLKp"), (SPEED_I, "speedLoopSLKi"))
            if key in known
        }
    return found


def _zero_cancelling(
    name: str, proportional: str, integral: str, found: Mapping[str, float]
) -> dict[str, float]:
    """Filter of the reference that takes the zero of a controller away."""
    if proportional not in found or integral not in found:
        return {}
    k_p, k_i = found[proportional], found[integral]
    return {
        f"{name}_B0": k_i / (k_p + k_i),
        f"{name}_B1": k_i / (k_p + k_i),
        f"{name}_A1": (k_p - k_i) / (k_p + k_i),
    }


def _old_volts(known: Mapping[str, float]) -> float | None:
    volts = known.get("parametersUdcbMax")
    return None if volts is None else round(volts / ROOT_3, 1)


def _old(edition: Edition, name: str, value: float) -> float:
    """As it was printed before 2021: scales coarsely, some gains rounded up."""
    if (name in _WHOLE and not edition.fixed) or name == "M1_FREQ_MAX":
        return float(round(value))
    if name == "M1_U_MAX" or (name in _TENTHS and not edition.fixed):
        return math.floor(value * 10.0 + 0.5) / 10.0
    if edition.fixed and name.endswith(_UNROUNDED) and not name.startswith("M1_TO_"):
        return value
    if name in _UPWARD:
        return math.ceil(value * 1e12) / 1e12
    return old_printed(value)


# The ages of MCAT and its two kinds of arithmetic: what the same macro means in each.


@dataclass(frozen=True, slots=True)
class Edition:
    """One age of the format.

    Args:
        version: Its name in a configuration.
        fixed: Whether the firmware computes in fractions of its scales.
        commented: Whether inputs stand in line comments; else in one JSON comment.
        current_share, speed_share: Integral macro over ki times the period: 1 where MCAT takes the
            integral for a sum of rectangles, 1/2 for one of trapezoids.
    """

    version: str
    fixed: bool
    commented: bool
    current_share: float
    speed_share: float


FLOAT_2025 = Edition("2025", False, False, 0.5, 0.5)

FLOAT_2022 = Edition("2022", False, False, 1.0, 1.0)

FLOAT_2019 = Edition("2019", False, True, 1.0, 1.0)

FIXED_2022 = Edition("2022 fixed point", True, False, 0.5, 1.0)

FIXED_2019 = Edition("2019 fixed point", True, True, 0.5, 1.0)


EDITIONS = {
    edition.version: edition
    for edition in (FLOAT_2025, FLOAT_2022, FLOAT_2019, FIXED_2022, FIXED_2019)
}
