"""The members of SimpleFOC's BLDCMotor that a design decides, and the library's defaults."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Number, OwnValue
from dqforge.optimizer.firmware.own_values import number, rounded

VERSION = "2.4"
BEFORE = f"before {VERSION}"  # Version of files with ``phase_inductance``, one for both axes.
SIGNIFICANT = 6  # Significant digits that are written: a line of the Commander takes 19 characters.


@dataclass(frozen=True, slots=True)
class Member:
    """One member of BLDCMotor: its name, its line of the Commander without the motor's letter
    (empty where it has none), and what it means with its unit.
    """

    name: str
    command: str
    says: str
    whole: bool = False


# fmt: off
MEMBERS = {member.name: member for member in (
    Member("pole_pairs", "", "pole pairs", whole=True),
    Member("phase_resistance", "R", "resistance of a phase of the star, Ohm"),
    Member("axis_inductance.d", "ID", "L_d of a phase, H; set, it switches the decoupling on"),
    Member("axis_inductance.q", "IQ", "L_q of a phase, H"),
    Member("KV_rating", "K", "rev/min per volt between two terminals (peak)"),
    Member("foc_modulation", "WT", "1: space-vector modulation", whole=True),
    Member("torque_controller", "T", "2: both currents are controlled", whole=True),
    Member("controller", "C", "0: current is commanded, 1: speed", whole=True),
    Member("motion_downsample", "CD", "the speed controller leaves out so many loops", whole=True),
    Member("PID_current_q.P", "QP", "V/A"),
    Member("PID_current_q.I", "QI", "V/(A s)"),
    Member("PID_current_q.D", "QD", "V s/A"),
    Member("PID_current_q.output_ramp", "QR", "V/s, 0: none"),
    Member("LPF_current_q.Tf", "QF", "time constant of the filter on the current, s"),
    Member("PID_current_d.P", "DP", "V/A"),
    Member("PID_current_d.I", "DI", "V/(A s)"),
    Member("PID_current_d.D", "DD", "V s/A"),
    Member("PID_current_d.output_ramp", "DR", "V/s, 0: none"),
    Member("LPF_current_d.Tf", "DF", "time constant of the filter on the current, s"),
    Member("PID_velocity.P", "VP", "A s/rad"),
    Member("PID_velocity.I", "VI", "A/rad"),
    Member("PID_velocity.D", "VD", "A s^2/rad"),
    Member("PID_velocity.output_ramp", "VR", "A/s, 0: none"),
    Member("LPF_velocity.Tf", "VF", "time constant of the filter on the speed, s"),
    Member("velocity_limit", "LV", "rad/s"),
    Member("current_limit", "LC", "A (peak of phase)"),
    Member("voltage_limit", "LU", "V (peak of phase)"),
    Member("PID_current_q.limit", "QL", "V"),
    Member("PID_current_d.limit", "DL", "V"),
    Member("PID_velocity.limit", "VL", "A"),
)}
# fmt: on

"""In the order in which they are written; limits behind what changes them."""


# What the files say beside the members: the link in V and the period of loopFOC() in s.
V_DC, LOOP_PERIOD = "v_dc", "loop_period"
FOC_CURRENT = 2  # torque_controller that controls both currents.

# The library's own values on processors faster than an AVR (src/common/defaults.h), and the period
# of its loop that its documentation names for them.
DEFAULTS: Mapping[str, Number] = {
    "PID_current_q.P": 3.0,
    "PID_current_q.I": 300.0,
    "PID_current_d.P": 3.0,
    "PID_current_d.I": 300.0,
    "LPF_current_q.Tf": 0.005,
    "LPF_current_d.Tf": 0.005,
    "LPF_velocity.Tf": 0.005,
    "PID_velocity.output_ramp": 1000.0,
    "motion_downsample": 0,
    "foc_modulation": 0,
    LOOP_PERIOD: 1e-4,
}


def as_printed(value: float) -> float:
    """A number as it comes back from the file."""
    return rounded(value, SIGNIFICANT)


def set_or_default(own: Mapping[str, OwnValue], name: str) -> float:
    """A value of the file, or the library's."""
    value = number(own, name)
    return float(DEFAULTS[name]) if value is None else value


def flux_or_kv(pole_pairs: float, kv_rating: float) -> float:
    """Flux linkage in Wb (peak of phase) from rev/min per volt between two terminals (peak):
    psi = 60/(sqrt 3 2 pi p KV) (BLDCMotor.cpp, estimateBEMF). The other way round it is the same.
    """
    return 60.0 / (math.sqrt(3.0) * 2.0 * math.pi * pole_pairs * kv_rating)
