"""Names of SimpleFOC's motor in C++, and its enumerators with their numbers."""

from __future__ import annotations

from dqforge.optimizer.firmware.simplefoc_format.simplefoc_keys import MEMBERS

# Enumerators by the member that takes them, in the order of their numbers.
ENUMERATORS = {
    "torque_controller": (
        "TorqueControlType::voltage",
        "TorqueControlType::dc_current",
        "TorqueControlType::foc_current",
        "TorqueControlType::estimated_current",
    ),
    "controller": (
        "MotionControlType::torque",
        "MotionControlType::velocity",
        "MotionControlType::angle",
        "MotionControlType::velocity_openloop",
        "MotionControlType::angle_openloop",
    ),
    "foc_modulation": (
        "FOCModulationType::SinePWM",
        "FOCModulationType::SpaceVectorPWM",
        "FOCModulationType::Trapezoid_120",
        "FOCModulationType::Trapezoid_150",
    ),
}

# Members that the header works out from the link.
VOLTAGES = ("voltage_limit", "PID_current_q.limit", "PID_current_d.limit")

# Members by their line of the Commander.
COMMANDS = {member.command: name for name, member in MEMBERS.items() if member.command}
READ = (*MEMBERS, "phase_inductance")  # Members that are read.

# Other ways to write members.
FORMER = {
    "LPF_velocity": "LPF_velocity.Tf",
    "LPF_current_q": "LPF_current_q.Tf",
    "LPF_current_d": "LPF_current_d.Tf",
    "phase_inductance_dq.d": "axis_inductance.d",
    "phase_inductance_dq.q": "axis_inductance.q",
}

# What the arguments of BLDCMotor set: the q axis before the d axis.
CONSTRUCTOR = (
    "pole_pairs",
    "phase_resistance",
    "KV_rating",
    "axis_inductance.q",
    "axis_inductance.d",
)

# Ends of the names of the macros for the link in V and the period of the loop in s.
LINK, PERIOD = "V_DC", "LOOP_PERIOD"

# Functions of the motor that set a limit, with the member that they set.
LIMIT_CALLS = {
    "updateVoltageLimit": "voltage_limit",
    "updateCurrentLimit": "current_limit",
    "updateVelocityLimit": "velocity_limit",
}
