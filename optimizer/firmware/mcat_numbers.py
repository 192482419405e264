"""How MCAT prints numbers, and what is left of them in the integers of a fixed-point build."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from decimal import ROUND_HALF_UP, Decimal

from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import half_digit
from dqforge.optimizer.firmware.configuration import OwnValue

# Names of MCAT: its inputs by section, and its macros by section, in the order of its files.

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
    return None if volts is None else round(volts / MCAT_ROOT_3, 1)


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


# How MCAT prints numbers, and what is left of them in the integers of a fixed-point build.

DIGITS = 6  # Significant digits of MCAT since 2021.
OLD_PLACES = 12  # Decimal places of MCAT before that.

# Bits behind the binary point, by the macro that makes the integer.
FRACTION_BITS = {"FRAC16": 15, "FRAC32": 31, "ACC32": 15}


def printed(value: float) -> float:
    """A number as MCAT prints it since 2021: as it is with fewer than six decimal places, else
    with six significant digits, halves upward.
    """
    if value == int(value) or _places(value) < DIGITS:
        return value
    exact = Decimal(value)
    step = Decimal(1).scaleb(exact.adjusted() - DIGITS + 1)
    return float(exact.quantize(step, rounding=ROUND_HALF_UP))


def old_printed(value: float) -> float:
    """A number as MCAT printed it before 2021: twelve decimal places, halves upward."""
    return math.floor(value * 1e12 + 0.5) / 1e12


def counts(value: float, kind: str) -> int:
    """The integer that a macro makes of a number, cut off toward zero and held in its range."""
    scale = 1 << FRACTION_BITS[kind]
    largest = (1 << 15) - 1 if kind == "FRAC16" else (1 << 31) - 1
    return int(max(-largest - 1, min(largest, value * scale)))


def held(value: float, kind: str) -> float:
    """What is left of a number in that integer."""
    return counts(value, kind) / (1 << FRACTION_BITS[kind])


def shift_of(value: float) -> int:
    """Power of two by which MCAT takes a positive number into the range of a fraction."""
    if value < 1.0:
        return -math.ceil(math.log2(1.0 / value) - 1.0)
    return math.ceil(math.log2(value))


def half_step(value: float, places: int | None = None) -> float:
    """Half of the last printed digit: how far the number before rounding may lie from it.

    Args:
        value: The printed number.
        places: Its decimal places where they are known, None for six significant digits.
    """
    if places is not None:
        return 0.5 * 10.0**-places
    return half_digit(value, DIGITS)


def _places(value: float) -> int:
    """Decimal places of the shortest decimal that reads back to a number."""
    exponent = Decimal(repr(value)).as_tuple().exponent
    return max(0, -exponent) if isinstance(exponent, int) else 0


# MCAT's rules: from its inputs to the constants of a float build, and those that all share.
#
# Inputs go by MCAT's own keys and units: speeds in rpm, frequencies in Hz, times in s. Constants
# are not rounded here. Sources: docs/firmware/nxp.md.

# The inputs that a constant is made of, and how.
Inputs = Mapping[str, float]
Rule = tuple[tuple[str, ...], Callable[..., float]]
MCAT_ROOT_3 = 1.73205  # What MCAT takes for the square root of three.
TURN = 2.0 * math.pi
PP, RS, LD, LQ = "parametersPP", "parametersRs", "parametersLd", "parametersLq"
TS, TW = "currentLoopSampleTime", "speedLoopSampleTime"
F0, KSI = "currentLoopF0", "currentLoopKsi"
NMAX, IMAX, UDC = "parametersNmax", "parametersImax", "parametersUdcbMax"

# Not a key of MCAT: the torque constant that its speed loop works with, whatever it is made of.
TORQUE = "torqueConstant"


def gain_p(ksi: float, f_0: float, inductance: float, r_s: float) -> float:
    """Proportional gain in V/A that puts the poles of L s + R at f_0 in Hz with damping ksi."""
    return 2.0 * ksi * TURN * f_0 * inductance - r_s


def gain_i(f_0: float, inductance: float, period: float) -> float:
    """Integral gain for these poles times the period, in V/A."""
    return (TURN * f_0) ** 2 * inductance * period


def electrical(pole_pairs: float, rpm: float) -> float:
    """Electrical speed in rad/s."""
    return rpm / 60.0 * (TURN * pole_pairs)


def filter_b(cutoff: float, period: float) -> float:
    """Coefficients b_0 = b_1 of a first-order filter, bilinear, for a cut-off in Hz."""
    angle = TURN * cutoff * period
    return angle / (2.0 + angle)


def filter_a(cutoff: float, period: float) -> float:
    """Coefficient -a_1 of that filter."""
    angle = TURN * cutoff * period
    return (2.0 - angle) / (2.0 + angle)


def _mcat_numbers_filter(name: str, cutoff: str, period: str) -> dict[str, Rule]:
    keys = (cutoff, period)
    return {
        f"{name}_B0": (keys, filter_b),
        f"{name}_B1": (keys, filter_b),
        f"{name}_A1": (keys, filter_a),
    }


def _same(key: str) -> Rule:
    return ((key,), lambda value: value)


def _count(duration: str, period: str) -> Rule:
    return ((duration, period), lambda time, step: round(time / step, 6))


def _ramp(pairs: float, slope: float, period: float) -> float:
    return slope * period / (60.0 / (TURN * pairs))


def _decay(part: float, inductance: float, period: float, r_s: float) -> float:
    return part / (inductance + period * r_s)


# Constants that a float and a fixed-point build have alike.
SHARED: dict[str, Rule] = {
    "M1_MOTOR_PP": _same(PP),
    "M1_I_MAX": _same(IMAX),
    "M1_U_DCB_MAX": _same(UDC),
    "M1_U_MAX": ((UDC,), lambda u: u / MCAT_ROOT_3),
    "M1_FREQ_MAX": ((NMAX, PP), lambda rpm, pairs: rpm / 60.0 * pairs),
    "M1_E_BLOCK_PER": _same("parametersEblockPer"),
    "M1_CALIB_DURATION": _count("parametersCalibDuration", TW),
    "M1_FAULT_DURATION": _count("parametersFaultDuration", TW),
    "M1_FREEWHEEL_DURATION": _count("parametersFreewheelDuration", TW),
    "M1_ALIGN_DURATION": _count("parametersAlignDuration", TS),
    "M1_SCALAR_INTEG_GAIN": (
        (PP, NMAX, TS),
        lambda pairs, rpm, step: TURN * pairs * rpm / 60.0 * step / math.pi,
    ),
}

# Constants of a float build that are the same since 2021.
FLOAT: dict[str, Rule] = SHARED | {
    "M1_I_PH_NOM": _same("parametersIphNom"),
    "M1_N_NOM": ((PP, "parametersNnom"), electrical),
    "M1_N_OVERSPEED": ((PP, "parametersNover"), electrical),
    "M1_N_MIN": ((PP, "parametersNmin"), electrical),
    "M1_N_MAX": ((PP, NMAX), electrical),
    "M1_N_ANGULAR_MAX": ((PP,), lambda pairs: 60.0 / (TURN * pairs)),
    "M1_U_DCB_TRIP": _same("parametersUdcbTrip"),
    "M1_U_DCB_UNDERVOLTAGE": _same("parametersUdcbUnder"),
    "M1_U_DCB_OVERVOLTAGE": _same("parametersUdcbOver"),
    "M1_E_BLOCK_TRH": _same("parametersEblock"),
    "M1_SCALAR_UQ_MIN": _same("parametersScalarUqMin"),
    "M1_ALIGN_VOLTAGE": _same("parametersAlignVoltage"),
    "M1_SCALAR_VHZ_FACTOR_GAIN": (
        ("parametersUphNom", "parametersScalarVHzRatio", "parametersNnom", PP),
        lambda volts, share, rpm, pairs: volts * share / 100.0 / (rpm * pairs / 60.0),
    ),
    "M1_SCALAR_RAMP_UP": (
        ("speedLoopIncUp", TS, PP),
        lambda slope, step, pairs: slope * step / 60.0 * pairs,
    ),
    "M1_SCALAR_RAMP_DOWN": (
        ("speedLoopIncDown", TS, PP),
        lambda slope, step, pairs: slope * step / 60.0 * pairs,
    ),
    "M1_D_KP_GAIN": ((KSI, F0, LD, RS), gain_p),
    "M1_Q_KP_GAIN": ((KSI, F0, LQ, RS), gain_p),
    "M1_CLOOP_LIMIT": (("currentLoopOutputLimit",), lambda share: share / MCAT_ROOT_3 / 100.0),
    "M1_SPEED_RAMP_UP": ((PP, "speedLoopIncUp", TW), _ramp),
    "M1_SPEED_RAMP_DOWN": ((PP, "speedLoopIncDown", TW), _ramp),
    "M1_SPEED_LOOP_HIGH_LIMIT": _same("speedLoopUpperLimit"),
    "M1_SPEED_LOOP_LOW_LIMIT": _same("speedLoopLowerLimit"),
    "M1_OL_START_RAMP_INC": ((PP, "sensorlessStartupRamp", TS), _ramp),
    "M1_OL_START_I": _same("sensorlessStartupCurrent"),
    "M1_MERG_SPEED_TRH": ((PP, "sensorlessMergingSpeed"), electrical),
    "M1_I_SCALE": ((LD, LD, TS, RS), _decay),
    "M1_U_SCALE": ((TS, LD, TS, RS), _decay),
    "M1_E_SCALE": ((TS, LD, TS, RS), _decay),
    "M1_WI_SCALE": (
        (LQ, LD, TS, RS),
        lambda l_q, l_d, step, r_s: l_q * step / (l_d + step * r_s),
    ),
    "M1_BEMF_DQ_KP_GAIN": (("sensorlessBemfObsrvKsi", "sensorlessBemfObsrvF0", LD, RS), gain_p),
    "M1_BEMF_DQ_KI_GAIN": (("sensorlessBemfObsrvF0", LD, TS), gain_i),
    "M1_TO_KP_GAIN": (
        ("sensorlessTrackObsrvKsi", "sensorlessTrackObsrvF0"),
        lambda ksi, f_0: 2.0 * ksi * TURN * f_0,
    ),
    "M1_TO_KI_GAIN": (("sensorlessTrackObsrvF0", TS), lambda f_0, step: (TURN * f_0) ** 2 * step),
    "M1_TO_THETA_GAIN": ((TS,), lambda step: step / math.pi),
    **_mcat_numbers_filter("M1_UDCB_IIR", "parametersUdcbIIRf0", TS),
    **_mcat_numbers_filter("M1_TO_SPEED_IIR", "sensorlessTrackObsrvIIRSpeedCutOff", TS),
}


def merging(share: float, rpm: float, pairs: float, step: float) -> float:
    """Step of the merging of angles after the start, per period."""
    return share / 100.0 * rpm * pairs * step / 60.0


MERGING = ("sensorlessMergingCoeff", "sensorlessMergingSpeed", PP, TS)
SPEED_KEYS = ("speedLoopKsi", "speedLoopF0", "parametersJ", TORQUE)

# What MCAT makes since 2025: integrals of trapezoids, the speed loop from the torque constant.
FLOAT_2025_ONLY: dict[str, Rule] = {
    "M1_D_KI_GAIN": ((F0, LD, TS), lambda *of: 0.5 * gain_i(*of)),
    "M1_Q_KI_GAIN": ((F0, LQ, TS), lambda *of: 0.5 * gain_i(*of)),
    "M1_SPEED_PI_PROP_GAIN": (
        (*SPEED_KEYS, PP),
        lambda ksi, f_0, inertia, torque, pairs: (
            2.0 * TURN * ksi * f_0 * inertia / (torque * pairs)
        ),
    ),
    "M1_SPEED_PI_INTEG_GAIN": (
        (*SPEED_KEYS, PP, TW),
        lambda _, f_0, inertia, torque, pairs, step: (
            (TURN * f_0) ** 2 * inertia / (torque * pairs) * (0.5 * step)
        ),
    ),
    "M1_MERG_COEFF": (MERGING, lambda *of: math.floor(merging(*of) * 32768.0 + 0.5) / 32768.0),
    **_mcat_numbers_filter("M1_SPEED_IIR", "speedLoopCutOffFreq", TW),
}

# What it made before: integrals of rectangles, the speed loop per rpm and a tenth of its integral,
# its filter for the period of the current loop.
FLOAT_2022_ONLY: dict[str, Rule] = {
    "M1_D_KI_GAIN": ((F0, LD, TS), gain_i),
    "M1_Q_KI_GAIN": ((F0, LQ, TS), gain_i),
    "M1_SPEED_PI_PROP_GAIN": (
        SPEED_KEYS,
        lambda ksi, f_0, inertia, torque: TURN / 60.0 * (2.0 * TURN * ksi * f_0) * inertia / torque,
    ),
    "M1_SPEED_PI_INTEG_GAIN": (
        (*SPEED_KEYS, TW),
        lambda _, f_0, inertia, torque, step: (
            TURN / 60.0 * (TURN * f_0) ** 2 * inertia / (10.0 * torque) * step
        ),
    ),
    "M1_MERG_COEFF": (MERGING, merging),
    **_mcat_numbers_filter("M1_SPEED_IIR", "speedLoopCutOffFreq", TS),
}


def evaluate(rules: Mapping[str, Rule], inputs: Inputs) -> dict[str, float]:
    """The constants whose inputs are all there."""
    return {
        macro: formula(*(inputs[key] for key in keys))
        for macro, (keys, formula) in rules.items()
        if all(key in inputs for key in keys)
    }


# MCAT's rules for a fixed-point build: constants in fractions of the scales.

# Not keys of MCAT but for the middle one: scales of the phase voltage in V, of the electrical speed
# in rad/s.
VOLTS, EMF, SPEED = "scaleVoltage", "parametersEmax", "scaleSpeed"


def fixed_constants(inputs: Inputs, volts: float | None = None) -> dict[str, float]:
    """Constants of a fixed-point build whose inputs are all there.

    Args:
        inputs: By MCAT's keys.
        volts: Scale of the phase voltage in V; None for that of MCAT since 2021.
    """
    known = dict(inputs)
    if volts is not None:
        known[VOLTS] = volts
    elif "parametersUdcbMax" in inputs:
        known[VOLTS] = inputs["parametersUdcbMax"] / MCAT_ROOT_3
    if PP in inputs and NMAX in inputs:
        known[SPEED] = TURN * inputs[PP] * inputs[NMAX] / 60.0
    found = evaluate(_RULES, known)
    for name in ("M1_TO_KP", "M1_TO_KI", "M1_TO_THETA"):
        if f"{name}_GAIN" in found:
            found |= mantissa(name, found[f"{name}_GAIN"])
    scalar = found.get("M1_SCALAR_VHZ_FACTOR_GAIN")
    if scalar is not None:
        shift = shift_of(scalar) if scalar > 1.0 else 0
        found["M1_SCALAR_VHZ_FACTOR_GAIN"] = math.ldexp(scalar, -shift)
        found["M1_SCALAR_VHZ_FACTOR_SHIFT"] = shift
    return found


def mantissa(name: str, value: float) -> dict[str, float]:
    """A constant as a fraction and a power of two."""
    shift = shift_of(value)
    return {f"{name}_GAIN": math.ldexp(value, -shift), f"{name}_SHIFT": shift}


def _over(key: str, scale: str) -> Rule:
    return ((key, scale), lambda value, full: value / full)


def _scaled(rule: Rule, up: str, down: str) -> Rule:
    """A rule of the float build times one scale over another."""
    keys, formula = rule

    def scaled(first: float, second: float, *of: float) -> float:
        return formula(*of) * first / second

    return ((up, down, *keys), scaled)


def _halved(rule: Rule) -> Rule:
    keys, formula = rule
    return (keys, lambda *of: 0.5 * formula(*of))


def _fixed_filter(name: str, cutoff: str, period: str) -> dict[str, Rule]:
    """Halves of the coefficients of a filter, which reach from -2 to 2."""
    keys = (cutoff, period)
    low, high = _halved((keys, filter_b)), _halved((keys, filter_a))
    return {f"{name}_B0": low, f"{name}_B1": low, f"{name}_A1": high}


def _fixed_ramp(slope: float, rpm: float, step: float) -> float:
    return slope / rpm * step


def _speed_p(
    manual: float, k_p: float, ksi: float, f_0: float, inertia: float, torque: float
) -> float:
    if manual:
        return k_p
    return 2.0 * ksi * TURN * math.floor(f_0 + 0.5) * inertia / torque


def _speed_i(
    manual: float, k_i: float, f_0: float, inertia: float, torque: float, step: float
) -> float:
    return (k_i if manual else (TURN * f_0) ** 2 * inertia / torque) * step


def _wi(l_q: float, l_d: float, step: float, r_s: float) -> float:
    return l_q * step / (l_d + step * r_s)


_RULES: dict[str, Rule] = SHARED | {
    "M1_N_MAX": ((NMAX,), lambda rpm: rpm),
    "M1_E_MAX": ((EMF,), lambda volts: volts),
    "M1_I_PH_NOM": _over("parametersIphNom", IMAX),
    "M1_N_NOM": _over("parametersNnom", NMAX),
    "M1_N_OVERSPEED": _over("parametersNover", NMAX),
    "M1_N_MIN": _over("parametersNmin", NMAX),
    "M1_U_DCB_TRIP": _over("parametersUdcbTrip", "parametersUdcbMax"),
    "M1_U_DCB_UNDERVOLTAGE": _over("parametersUdcbUnder", "parametersUdcbMax"),
    "M1_U_DCB_OVERVOLTAGE": _over("parametersUdcbOver", "parametersUdcbMax"),
    "M1_E_BLOCK_TRH": _over("parametersEblock", EMF),
    "M1_SCALAR_UQ_MIN": _over("parametersScalarUqMin", VOLTS),
    "M1_ALIGN_VOLTAGE": _over("parametersAlignVoltage", VOLTS),
    "M1_SCALAR_VHZ_FACTOR_GAIN": (
        ("parametersUphNom", "parametersScalarVHzRatio", "parametersNnom", NMAX, VOLTS),
        lambda volts, share, rpm, full, scale: volts * share / 100.0 / rpm * full / scale,
    ),
    "M1_SCALAR_RAMP_UP": (("speedLoopIncUp", NMAX, TS), _fixed_ramp),
    "M1_SCALAR_RAMP_DOWN": (("speedLoopIncDown", NMAX, TS), _fixed_ramp),
    "M1_D_KP_GAIN": _scaled(FLOAT["M1_D_KP_GAIN"], IMAX, VOLTS),
    "M1_Q_KP_GAIN": _scaled(FLOAT["M1_Q_KP_GAIN"], IMAX, VOLTS),
    "M1_D_KI_GAIN": _halved(_scaled(FLOAT_2022_ONLY["M1_D_KI_GAIN"], IMAX, VOLTS)),
    "M1_Q_KI_GAIN": _halved(_scaled(FLOAT_2022_ONLY["M1_Q_KI_GAIN"], IMAX, VOLTS)),
    "M1_CLOOP_LIMIT": (("currentLoopOutputLimit",), lambda share: share / 100.0),
    "M1_SPEED_RAMP_UP": (("speedLoopIncUp", NMAX, TW), _fixed_ramp),
    "M1_SPEED_RAMP_DOWN": (("speedLoopIncDown", NMAX, TW), _fixed_ramp),
    "M1_SPEED_LOOP_HIGH_LIMIT": _over("speedLoopUpperLimit", IMAX),
    "M1_SPEED_LOOP_LOW_LIMIT": _over("speedLoopLowerLimit", IMAX),
    "M1_SPEED_PI_PROP_GAIN": _scaled(
        (
            (MANUAL, "speedLoopSLKp", "speedLoopKsi", "speedLoopF0", "parametersJ", TORQUE),
            _speed_p,
        ),
        SPEED,
        IMAX,
    ),
    "M1_SPEED_PI_INTEG_GAIN": _scaled(
        ((MANUAL, "speedLoopSLKi", "speedLoopF0", "parametersJ", TORQUE, TW), _speed_i),
        SPEED,
        IMAX,
    ),
    "M1_OL_START_RAMP_INC": (("sensorlessStartupRamp", NMAX, TS), _fixed_ramp),
    "M1_OL_START_I": _over("sensorlessStartupCurrent", IMAX),
    "M1_MERG_SPEED_TRH": _over("sensorlessMergingSpeed", NMAX),
    "M1_MERG_COEFF": (MERGING, merging),
    "M1_I_SCALE": FLOAT["M1_I_SCALE"],
    "M1_U_SCALE": _scaled(FLOAT["M1_U_SCALE"], VOLTS, IMAX),
    "M1_E_SCALE": _scaled(FLOAT["M1_E_SCALE"], EMF, IMAX),
    "M1_WI_SCALE": ((SPEED, *FLOAT["M1_WI_SCALE"][0]), lambda full, *of: _wi(*of) * full),
    "M1_BEMF_DQ_KP_GAIN": _scaled(FLOAT["M1_BEMF_DQ_KP_GAIN"], IMAX, EMF),
    "M1_BEMF_DQ_KI_GAIN": _scaled(
        (FLOAT["M1_BEMF_DQ_KI_GAIN"][0], gain_i),
        IMAX,
        EMF,
    ),
    "M1_TO_KP_GAIN": (
        (SPEED, *FLOAT["M1_TO_KP_GAIN"][0]),
        lambda full, ksi, f_0: 2.0 * ksi * TURN * f_0 / full,
    ),
    "M1_TO_KI_GAIN": (
        (SPEED, *FLOAT["M1_TO_KI_GAIN"][0]),
        lambda full, f_0, step: (TURN * f_0) ** 2 * step / full,
    ),
    "M1_TO_THETA_GAIN": ((SPEED, TS), lambda full, step: step * full / math.pi),
    **_fixed_filter("M1_UDCB_IIR", "parametersUdcbIIRf0", TS),
    **_fixed_filter("M1_SPEED_IIR", "speedLoopCutOffFreq", TW),
    **_fixed_filter("M1_TO_SPEED_IIR", "sensorlessTrackObsrvIIRSpeedCutOff", TS),
}
