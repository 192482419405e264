"""Names of MCAT: its inputs by section, and its macros by section, in the order of its files."""

from __future__ import annotations

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
