"""MCAT's rules for a fixed-point build: constants in fractions of the scales."""

from __future__ import annotations

import math

from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import shift_of
from dqforge.optimizer.firmware.nxp_mcat.mcat_rules import (
    FLOAT,
    FLOAT_2022_ONLY,
    IMAX,
    MERGING,
    NMAX,
    PP,
    ROOT_3,
    SHARED,
    TORQUE,
    TS,
    TURN,
    TW,
    Inputs,
    Rule,
    evaluate,
    filter_a,
    filter_b,
    gain_i,
    merging,
)

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
        known[VOLTS] = inputs["parametersUdcbMax"] / ROOT_3
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


def _filter(name: str, cutoff: str, period: str) -> dict[str, Rule]:
    """Halves of the coefficients of a filter, which reach from -2 to 2."""
    keys = (cutoff, period)
    low, high = _halved((keys, filter_b)), _halved((keys, filter_a))
    return {f"{name}_B0": low, f"{name}_B1": low, f"{name}_A1": high}


def _ramp(slope: float, rpm: float, step: float) -> float:
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


MANUAL = "speedLoopManualConstantTunning"

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
    "M1_SCALAR_RAMP_UP": (("speedLoopIncUp", NMAX, TS), _ramp),
    "M1_SCALAR_RAMP_DOWN": (("speedLoopIncDown", NMAX, TS), _ramp),
    "M1_D_KP_GAIN": _scaled(FLOAT["M1_D_KP_GAIN"], IMAX, VOLTS),
    "M1_Q_KP_GAIN": _scaled(FLOAT["M1_Q_KP_GAIN"], IMAX, VOLTS),
    "M1_D_KI_GAIN": _halved(_scaled(FLOAT_2022_ONLY["M1_D_KI_GAIN"], IMAX, VOLTS)),
    "M1_Q_KI_GAIN": _halved(_scaled(FLOAT_2022_ONLY["M1_Q_KI_GAIN"], IMAX, VOLTS)),
    "M1_CLOOP_LIMIT": (("currentLoopOutputLimit",), lambda share: share / 100.0),
    "M1_SPEED_RAMP_UP": (("speedLoopIncUp", NMAX, TW), _ramp),
    "M1_SPEED_RAMP_DOWN": (("speedLoopIncDown", NMAX, TW), _ramp),
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
    "M1_OL_START_RAMP_INC": (("sensorlessStartupRamp", NMAX, TS), _ramp),
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
    **_filter("M1_UDCB_IIR", "parametersUdcbIIRf0", TS),
    **_filter("M1_SPEED_IIR", "speedLoopCutOffFreq", TW),
    **_filter("M1_TO_SPEED_IIR", "sensorlessTrackObsrvIIRSpeedCutOff", TS),
}


def _wi(l_q: float, l_d: float, step: float, r_s: float) -> float:
    return l_q * step / (l_d + step * r_s)
