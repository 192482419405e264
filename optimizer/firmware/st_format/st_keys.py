"""Macros of ST's MCSDK that are read and written, by file, with what they mean.

Names that only the motor file has (`ld_lq_ratio`, `inertia`, `friction`) stand beside those of the
headers.
"""

from __future__ import annotations

# Of the format that is written; version 5 differs in the names of OTHERWISE and in the circle
# limitation.
VERSION = "6"

MOTOR = {
    "POLE_PAIR_NUM": "pole pairs",
    "RS": "resistance of a phase, ohm",
    "LS": "inductance of a phase along q, H",
    "MOTOR_VOLTAGE_CONSTANT": "back-EMF, V r.m.s. line to line per 1000 rpm",
    "MOTOR_MAX_SPEED_RPM": "largest speed of the motor, rpm",
    "NOMINAL_CURRENT_A": "largest current, A peak of phase",
    "ID_DEMAG_A": "d current down to which the field is weakened, A",
}

STAGE = {
    "NOMINAL_BUS_VOLTAGE_V": "dc link, V",
    "RSHUNT": "shunt, ohm",
    "AMPLIFICATION_GAIN": "gain behind it",
    "ADC_REFERENCE_VOLTAGE": "reference of the converter, V",
}

DRIVE = {
    "MAX_APPLICATION_SPEED_RPM": "largest speed of the drive, rpm",
    "PWM_FREQUENCY": "carrier, Hz",
    "PWM_FREQ_SCALING": "by which the carrier frequency is divided to fit 16 bits",
    "REGULATION_EXECUTION_RATE": "carrier periods per control period",
    "SW_DEADTIME_NS": "dead time, ns",
    "F1": "scale of the observed current",
    "F2": "scale of the observed back-EMF",
    "GAIN1": "observer: error of the current to the current",
    "GAIN2": "observer: error of the current to the back-EMF",
    "PLL_KP_GAIN": "loop behind the observer, proportional",
    "PLL_KI_GAIN": "loop behind the observer, integral",
    "PLL_KPDIV": "",
    "PLL_KIDIV": "",
    "STO_FIFO_DEPTH_DPP": "periods over which the observer averages the speed",
    "STO_FIFO_DEPTH_UNIT": "periods over which the speed is averaged",
    "OBS_MINIMUM_SPEED_RPM": "least speed at which the observer is relied on, rpm",
    "PID_TORQUE_KP_DEFAULT": "q current, proportional",
    "PID_TORQUE_KI_DEFAULT": "q current, integral per period",
    "PID_FLUX_KP_DEFAULT": "d current, proportional",
    "PID_FLUX_KI_DEFAULT": "d current, integral per period",
    "TF_KPDIV": "",
    "TF_KIDIV": "",
    "SPEED_LOOP_FREQUENCY_HZ": "rate of the speed controller, Hz",
    "PID_SPEED_KP_DEFAULT": "counts of q current per 0.1 Hz",
    "PID_SPEED_KI_DEFAULT": "the same, integral per period",
    "SP_KPDIV": "",
    "SP_KIDIV": "",
    "IQMAX_A": "largest q current, A",
}

TABLE = {
    "SEGDIV": "counts of q current per segment",
    "ANGC": "slopes of the segments, 1/32768",
    "OFST": "offsets of the segments, counts of d current",
}

# Dividers whose logarithm stands in a macro of its own.
LOGARITHMS = (
    "PLL_KPDIV",
    "PLL_KIDIV",
    "TF_KPDIV",
    "TF_KIDIV",
    "SP_KPDIV",
    "SP_KIDIV",
    "F1",
    "F2",
    "STO_FIFO_DEPTH_DPP",
)

# Currents in A, and the macros that hold them in counts up to version 6.1.
COUNTED = {"NOMINAL_CURRENT_A": "NOMINAL_CURRENT", "ID_DEMAG_A": "ID_DEMAG", "IQMAX_A": "IQMAX"}

# Other names that versions give a macro.
OTHERWISE = {
    "ANGC": "M1_ANGC",
    "MAX_APPLICATION_SPEED_RPM": "MAX_APPLICATION_SPEED",
    "OBS_MINIMUM_SPEED_RPM": "OBS_MINIMUM_SPEED",
    "CONSTANT1_Q": "M1_CONSTANT1_Q",
    "CONSTANT1_D": "M1_CONSTANT1_D",
    "CONSTANT2_QD": "M1_CONSTANT2_QD",
}

# Written over (SPEED_UNIT/10), which is one where speeds are counted in tenths of a hertz.
SPEED_GAINS = ("PID_SPEED_KP_DEFAULT", "PID_SPEED_KI_DEFAULT")

# Read where they are there, and never written.
READ_ONLY = (
    "VBUS_PARTITIONING_FACTOR",
    "REV_PARK_ANGLE_COMPENSATION_FACTOR",
    "ENC_AVERAGING_FIFO_DEPTH",
    "HALL_AVERAGING_FIFO_DEPTH",
    "CONSTANT1_Q",
    "CONSTANT1_D",
    "CONSTANT2_QD",
    "FW_VOLTAGE_REF",
)

# Keys of the motor file (JSON) and what they are here; ``inertia`` in 1e-6 kg m^2, ``friction`` in
# 1e-6 N m s/rad.
MOTOR_FILE = {
    "polePairs": "POLE_PAIR_NUM",
    "rs": "RS",
    "ls": "LS",
    "BEmfConstant": "MOTOR_VOLTAGE_CONSTANT",
    "maxRatedSpeed": "MOTOR_MAX_SPEED_RPM",
    "nominalCurrent": "NOMINAL_CURRENT_A",
    "nominalDCVoltage": "NOMINAL_BUS_VOLTAGE_V",
    "inertia": "inertia",
    "friction": "friction",
}

HEADERS = MOTOR | STAGE | DRIVE | TABLE

WHOLE = frozenset(
    name
    for name in DRIVE
    if name not in ("IQMAX_A", "PWM_FREQUENCY", "SW_DEADTIME_NS", "SPEED_LOOP_FREQUENCY_HZ")
) | {"POLE_PAIR_NUM", "SEGDIV"}
