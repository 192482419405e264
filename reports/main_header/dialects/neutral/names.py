"""The neutral names: quantity, symbol and unit in capitals."""

from __future__ import annotations

from dqforge.reports.c_code.harness import Constant
from dqforge.reports.main_header.dialect import Dialect, Entry


def _loop(name: str, kp: str, ki: str) -> dict[str, str]:
    """Names of one controller; ``kp`` and ``ki`` are the units of its gains."""
    return {
        "kp": f"{name}_KP_{kp}",
        "ki": f"{name}_KI_{ki}",
        "ki_ts": f"{name}_KI_TS_{kp}",
        "t_i": f"{name}_T_I_S",
        "q0": f"{name}_Q0_{kp}",
        "q1": f"{name}_Q1_{kp}",
        "anti_windup": f"{name}_ANTI_WINDUP_PER_S",
        "kp_pu": f"{name}_KP_PU",
        "ki_ts_pu": f"{name}_KI_TS_PU",
        "kp_code": f"{name}_KP_PU_Q{{bits}}",
        "ki_ts_code": f"{name}_KI_TS_PU_Q{{bits}}",
    }


_LOOPS = {
    "i_d": _loop("ID", "V_PER_A", "V_PER_AS"),
    "i_q": _loop("IQ", "V_PER_A", "V_PER_AS"),
    "speed": _loop("SPEED", "NMS_PER_RAD", "NM_PER_RAD"),
}

# Names without prefix by quantity; ``bits`` are the fractional bits of a code.
NAMES = {
    "machine.pole_pairs": "POLE_PAIRS",
    "machine.r_s": "R_S_OHM",
    "machine.l_d": "L_D_H",
    "machine.l_q": "L_Q_H",
    "machine.psi_pm": "PSI_PM_WB",
    "limit.current": "CURRENT_MAX_A",
    "limit.torque": "TORQUE_MAX_NM",
    "limit.torque_code": "TORQUE_MAX_Q{bits}",
    "limit.torque_negative": "TORQUE_MAX_NEGATIVE_NM",
    "reference.speed": "REFERENCE_SPEED_RAD_PER_S",
    "reference.voltage": "REFERENCE_VOLTAGE_V",
    "base.current": "BASE_CURRENT_A",
    "base.voltage": "BASE_VOLTAGE_V",
    "base.speed": "BASE_SPEED_RAD_PER_S",
    "base.torque": "BASE_TORQUE_NM",
    "sampling.period": "T_S_S",
    "speed.ratio": "SPEED_RATIO",
    "observer.a": "OBSERVER_A",
    "observer.b_u": "OBSERVER_B_U_RAD_PER_VS",
    "observer.b_i": "OBSERVER_B_I_RAD_PER_AS",
    "observer.c": "OBSERVER_C_RAD_PER_AS",
    **{f"{loop}.{key}": name for loop, names in _LOOPS.items() for key, name in names.items()},
}


def neutral_entry(constant: Constant) -> Entry:
    """A constant in SI, with its unit in name and comment."""
    name = NAMES[constant.quantity].format(bits=constant.bits)
    words = ", ".join(part for part in (constant.meaning, constant.unit) if part)
    return Entry(name, constant.value, words + constant.note)


NEUTRAL = Dialect("neutral", "main_header/dialects/neutral/header.h.j2", neutral_entry)
