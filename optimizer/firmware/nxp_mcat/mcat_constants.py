"""The constants that MCAT makes of its inputs, as its file prints them, by edition."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.optimizer.firmware.configuration import OwnValue
from dqforge.optimizer.firmware.nxp_mcat.mcat_edition import Edition
from dqforge.optimizer.firmware.nxp_mcat.mcat_fixed_rules import fixed_constants
from dqforge.optimizer.firmware.nxp_mcat.mcat_numbers import old_printed, printed
from dqforge.optimizer.firmware.nxp_mcat.mcat_rules import (
    FLOAT,
    FLOAT_2022_ONLY,
    FLOAT_2025_ONLY,
    ROOT_3,
    TORQUE,
    evaluate,
)

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
