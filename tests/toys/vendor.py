"""A dialect from outside the package: names and units of a firmware that counts in rpm and mH."""

from __future__ import annotations

import math
from pathlib import Path

from dqforge.reports.c_code.harness import Constant
from dqforge.reports.main_header import Dialect, Entry

NAMES = {
    "machine.pole_pairs": ("POLE_PAIR_NUM", 1),
    "machine.r_s": ("RS", 1.0),
    "machine.l_d": ("LD_MH", 1e3),
    "machine.l_q": ("LQ_MH", 1e3),
    "limit.current": ("NOMINAL_PEAK_CURRENT", 1.0),
    "limit.torque": ("NOMINAL_TORQUE", 1.0),
    "limit.torque_code": ("NOMINAL_TORQUE_CODE", 1),
    "limit.torque_negative": ("NOMINAL_BRAKING_TORQUE", 1.0),
    "base.speed": ("MAX_APPLICATION_SPEED_RPM", 30.0 / math.pi),
    "i_d.kp": ("FLUX_KP", 1.0),
    "i_d.ki": ("FLUX_KI", 1.0),
    "i_q.kp": ("TORQUE_KP", 1.0),
    "i_q.ki": ("TORQUE_KI", 1.0),
}


def vendor_entry(constant: Constant) -> Entry | None:
    if constant.quantity not in NAMES:
        return None
    name, scale = NAMES[constant.quantity]
    return Entry(name, constant.value * scale, constant.meaning)


VENDOR = Dialect("vendor", str(Path(__file__).parent / "vendor.h.j2"), vendor_entry)
