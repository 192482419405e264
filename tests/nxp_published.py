"""Published configurations of MCAT: inputs and constants as numbers, by the ages of the format.

Where they stand: docs/firmware/nxp.md. The constants are kept as they are printed there.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """Inputs by MCAT's keys, constants by their macros without ``M1_``."""

    version: str
    inputs: dict[str, float]
    constants: dict[str, str]


def _numbers(text: str) -> dict[str, float]:
    return {key: float(value) for key, value in (line.split() for line in text.split("\n"))}


def _texts(text: str) -> dict[str, str]:
    return dict(part.split("=") for part in text.split())


LINIX = {
    "parametersPP": 2,
    "parametersRs": 0.45,
    "parametersLd": 0.000375,
    "parametersLq": 0.000429,
    "parametersKe": 0.0138,
    "parametersJ": 0.0000016,
    "parametersIphNom": 2,
    "parametersUphNom": 15,
    "parametersNnom": 4000,
    "parametersImax": 8.25,
    "parametersUdcbMax": 60.8,
    "parametersUdcbTrip": 29,
    "parametersUdcbUnder": 16,
    "parametersUdcbOver": 32,
    "parametersNover": 4399,
    "parametersNmin": 300,
    "parametersEblock": 1.4,
    "parametersEblockPer": 2000,
    "parametersNmax": 4400,
    "parametersUdcbIIRf0": 100,
    "parametersCalibDuration": 0.2,
    "parametersFaultDuration": 2,
    "parametersFreewheelDuration": 1.5,
    "parametersScalarUqMin": 1,
    "parametersAlignVoltage": 1.2,
    "parametersAlignDuration": 0.4,
    "parametersScalarVHzRatio": 100,
    "currentLoopSampleTime": 0.0000625,
    "currentLoopF0": 360,
    "currentLoopKsi": 1,
    "currentLoopOutputLimit": 90,
    "speedLoopSampleTime": 0.001,
    "speedLoopF0": 5,
    "speedLoopKsi": 1,
    "speedLoopIncUp": 10000,
    "speedLoopIncDown": 10000,
    "speedLoopCutOffFreq": 100,
    "speedLoopUpperLimit": 2,
    "speedLoopLowerLimit": -2,
    "speedLoopSLKp": 0.003,
    "speedLoopSLKi": 0.09,
    "speedLoopManualConstantTunning": False,
    "sensorlessBemfObsrvF0": 600,
    "sensorlessBemfObsrvKsi": 1,
    "sensorlessTrackObsrvF0": 80,
    "sensorlessTrackObsrvKsi": 1,
    "sensorlessTrackObsrvIIRSpeedCutOff": 400,
    "sensorlessStartupRamp": 5000,
    "sensorlessStartupCurrent": 0.35,
    "sensorlessMergingSpeed": 300,
    "sensorlessMergingCoeff": 100,
}

FLOAT_2025 = Published(
    "2025",
    LINIX,
    _texts(
        """MOTOR_PP=2 I_PH_NOM=2.0 N_NOM=837.758 I_MAX=8.25 U_DCB_MAX=60.8 U_DCB_TRIP=29.0
        U_DCB_UNDERVOLTAGE=16.0 U_DCB_OVERVOLTAGE=32.0 N_OVERSPEED=921.324 N_MIN=62.8319
        E_BLOCK_TRH=1.4 E_BLOCK_PER=2000 N_MAX=921.534 CALIB_DURATION=200 FAULT_DURATION=2000
        FREEWHEEL_DURATION=1500 SCALAR_UQ_MIN=1.0 ALIGN_VOLTAGE=1.2 ALIGN_DURATION=6400
        U_MAX=35.1029 FREQ_MAX=146.667 N_ANGULAR_MAX=4.77465 UDCB_IIR_B0=0.0192568
        UDCB_IIR_B1=0.0192568 UDCB_IIR_A1=0.961486 SCALAR_VHZ_FACTOR_GAIN=0.112500
        SCALAR_INTEG_GAIN=0.0183333 SCALAR_RAMP_UP=0.0208333 SCALAR_RAMP_DOWN=0.0208333
        D_KP_GAIN=1.24646 D_KI_GAIN=0.0599578 Q_KP_GAIN=1.49075 Q_KI_GAIN=0.0685918
        Q_IIR_ZC_B0=0.0439876 Q_IIR_ZC_B1=0.0439876 Q_IIR_ZC_A1=0.912025 CLOOP_LIMIT=0.519615
        SPEED_RAMP_UP=2.09440 SPEED_RAMP_DOWN=2.09440 SPEED_LOOP_HIGH_LIMIT=2.0
        SPEED_LOOP_LOW_LIMIT=-2.0 SPEED_PI_PROP_GAIN=0.00364243 SPEED_PI_INTEG_GAIN=0.0000286075
        SPEED_IIR_B0=0.239057 SPEED_IIR_B1=0.239057 SPEED_IIR_A1=0.521886
        SPEED_IIR_ZC_B0=0.00779278 SPEED_IIR_ZC_B1=0.00779278 SPEED_IIR_ZC_A1=0.984414
        OL_START_RAMP_INC=0.0654498 MERG_SPEED_TRH=62.8319 MERG_COEFF=0.000610352
        I_SCALE=0.930233 U_SCALE=0.155039 E_SCALE=0.155039 WI_SCALE=0.0000665116
        BEMF_DQ_KP_GAIN=2.37743 BEMF_DQ_KI_GAIN=0.333099 TO_KP_GAIN=1005.31 TO_KI_GAIN=15.7914
        TO_THETA_GAIN=0.0000198944 TO_SPEED_IIR_B0=0.0728205 TO_SPEED_IIR_B1=0.0728205
        TO_SPEED_IIR_A1=0.854359"""
    ),
)

FLOAT_2022 = Published(
    "2022",
    LINIX
    | {
        "parametersFaultDuration": 6,
        "currentLoopF0": 288,
        "speedLoopF0": 28,
        "speedLoopIncUp": 5000,
        "speedLoopIncDown": 5000,
        "sensorlessBemfObsrvF0": 300,
        "sensorlessTrackObsrvF0": 70,
    },
    _texts(
        """N_NOM=837.758 U_MAX=35.1029 FAULT_DURATION=6000 SCALAR_VHZ_FACTOR_GAIN=0.112500
        SCALAR_INTEG_GAIN=0.0183333 SCALAR_RAMP_UP=0.0104167 D_KP_GAIN=0.907168
        D_KI_GAIN=0.0767460 Q_KP_GAIN=1.10260 Q_KI_GAIN=0.0877975 CLOOP_LIMIT=0.519615
        SPEED_RAMP_UP=1.04720 SPEED_PI_PROP_GAIN=0.00246648 SPEED_PI_INTEG_GAIN=0.0000216963
        SPEED_IIR_B0=0.0192568 SPEED_IIR_A1=0.961486 OL_START_RAMP_INC=0.0654498 OL_START_I=0.35
        MERG_SPEED_TRH=62.8319 MERG_COEFF=0.000625000 I_SCALE=0.930233 U_SCALE=0.155039
        WI_SCALE=0.0000665116 BEMF_DQ_KP_GAIN=0.963717 BEMF_DQ_KI_GAIN=0.0832748
        TO_KP_GAIN=879.646 TO_KI_GAIN=12.0903 TO_THETA_GAIN=0.0000198944
        TO_SPEED_IIR_B0=0.0728205 TO_SPEED_IIR_A1=0.854359"""
    ),
)

TEKNIC_FIXED = LINIX | {
    "parametersNmax": 4400,
    "parametersImax": 8,
    "parametersEmax": 15.1,
    "parametersPP": 4,
    "parametersRs": 0.54,
    "parametersLd": 0.0003356,
    "parametersLq": 0.000218,
    "parametersKe": 0.05477461,
    "parametersJ": 0.00001,
    "parametersIphNom": 8,
    "parametersUdcbMax": 36.3,
    "parametersEblock": 0.7,
    "parametersKt": 0.01217,
    "parametersFaultDuration": 6,
    "parametersAlignVoltage": 1,
    "currentLoopSampleTime": 0.0001,
    "currentLoopF0": 288,
    "speedLoopF0": 28,
    "speedLoopUpperLimit": 3,
    "speedLoopLowerLimit": -3,
    "speedLoopSLKi": 0.009,
    "speedLoopManualConstantTunning": True,
    "sensorlessBemfObsrvF0": 300,
    "sensorlessTrackObsrvF0": 70,
    "sensorlessStartupRamp": 3000,
    "sensorlessStartupCurrent": 0.6,
    "sensorlessMergingSpeed": 500,
    "sensorlessMergingCoeff": 150,
}

FIXED_2022 = Published(
    "2022 fixed point",
    TEKNIC_FIXED,
    _texts(
        """N_MAX=4400.0 FREQ_MAX=293.333 I_MAX=8.0 U_MAX=20.9578 E_MAX=15.1 MOTOR_PP=4
        I_PH_NOM=1.0 N_NOM=0.909091 U_DCB_MAX=36.3 U_DCB_TRIP=0.798898
        U_DCB_UNDERVOLTAGE=0.440771 U_DCB_OVERVOLTAGE=0.881543 N_OVERSPEED=0.999773
        N_MIN=0.0681818 E_BLOCK_TRH=0.0463576 E_BLOCK_PER=2000 CALIB_DURATION=200
        FAULT_DURATION=6000 FREEWHEEL_DURATION=1500 SCALAR_UQ_MIN=0.0477149
        ALIGN_VOLTAGE=0.0477149 ALIGN_DURATION=4000 UDCB_IIR_B0=0.0152295 UDCB_IIR_B1=0.0152295
        UDCB_IIR_A1=0.469541 SCALAR_VHZ_FACTOR_GAIN=0.787295 SCALAR_VHZ_FACTOR_SHIFT=0
        SCALAR_INTEG_GAIN=0.0586667 SCALAR_RAMP_UP=0.000227273 SCALAR_RAMP_DOWN=0.000227273
        D_KP_GAIN=0.257498 D_KI_GAIN=0.0209740 Q_KP_GAIN=0.0950354 Q_KI_GAIN=0.0136243
        CLOOP_LIMIT=0.9 SPEED_RAMP_UP=0.00227273 SPEED_RAMP_DOWN=0.00227273
        SPEED_LOOP_HIGH_LIMIT=0.375 SPEED_LOOP_LOW_LIMIT=-0.375 SPEED_PI_PROP_GAIN=0.691150
        SPEED_PI_INTEG_GAIN=0.00207345 SPEED_IIR_B0=0.119529 SPEED_IIR_B1=0.119529
        SPEED_IIR_A1=0.260943 OL_START_RAMP_INC=0.0000681818 OL_START_I=0.075
        MERG_SPEED_TRH=0.113636 MERG_COEFF=0.005 I_SCALE=0.861396 U_SCALE=0.672415
        E_SCALE=0.484471 WI_SCALE=0.103129 BEMF_DQ_KP_GAIN=0.384202 BEMF_DQ_KI_GAIN=0.0631738
        TO_KP_SHIFT=-1 TO_KP_GAIN=0.954545 TO_KI_SHIFT=-6 TO_KI_GAIN=0.671730
        TO_THETA_SHIFT=-4 TO_THETA_GAIN=0.938667 TO_SPEED_IIR_B0=0.0558176
        TO_SPEED_IIR_B1=0.0558176 TO_SPEED_IIR_A1=0.388365"""
    ),
)

FIXED_AUTOMATIC = Published(
    "2022 fixed point",
    TEKNIC_FIXED
    | {
        "parametersPP": 2,
        "parametersImax": 8.25,
        "parametersJ": 0.0000016,
        "speedLoopManualConstantTunning": False,
    },
    _texts("SPEED_PI_PROP_GAIN=5.16719 SPEED_PI_INTEG_GAIN=0.454530"),
)

HAND_TUNED = Published(
    "2022",
    LINIX
    | {
        "parametersPP": 4,
        "parametersRs": 0.345,
        "parametersLd": 0.0003665,
        "parametersLq": 0.0003665,
        "parametersKe": 0.0634,
        "currentLoopF0": 350,
        "speedLoopSampleTime": 0.002,
        "speedLoopF0": 45,
        "speedLoopSLKp": 0.01,
        "speedLoopSLKi": 0.00006,
        "speedLoopManualConstantTunning": True,
        "parametersFaultDuration": 6,
    },
    _texts(
        """D_KP_GAIN=1.26695 D_KI_GAIN=0.110777 SPEED_PI_PROP_GAIN=0.01
        SPEED_PI_INTEG_GAIN=0.00006 SPEED_RAMP_UP=8.37758 CALIB_DURATION=100"""
    ),
)

HIGH_VOLTAGE = Published(
    "2022",
    LINIX
    | {
        "parametersPP": 4,
        "parametersRs": 5,
        "parametersLd": 0.03,
        "parametersLq": 0.06,
        "parametersKe": 0.478,
        "parametersJ": 0.000016,
        "currentLoopSampleTime": 0.000125,
        "currentLoopF0": 600,
        "currentLoopOutputLimit": 70,
        "speedLoopF0": 90,
        "speedLoopIncUp": 50,
        "sensorlessBemfObsrvF0": 360,
        "sensorlessTrackObsrvF0": 30,
        "sensorlessMergingSpeed": 500,
        "sensorlessMergingCoeff": 150,
    },
    _texts(
        """D_KP_GAIN=221.195 D_KI_GAIN=53.2959 Q_KP_GAIN=447.389 Q_KI_GAIN=106.592
        CLOOP_LIMIT=0.404145 SPEED_RAMP_UP=0.0209440 SPEED_PI_PROP_GAIN=0.00228882
        SPEED_PI_INTEG_GAIN=0.0000647150 SCALAR_RAMP_UP=0.000416667 I_SCALE=0.979592
        U_SCALE=0.00408163 WI_SCALE=0.000244898 BEMF_DQ_KP_GAIN=130.717 BEMF_DQ_KI_GAIN=19.1865
        TO_KP_GAIN=376.991 TO_KI_GAIN=4.44132 TO_THETA_GAIN=0.0000397887 MERG_COEFF=0.00625"""
    ),
)

SERVO_2025 = Published(
    "2025",
    {
        "parametersPP": 3,
        "parametersRs": 0.1105,
        "parametersLd": 0.000116467,
        "parametersLq": 0.000134492,
        "parametersKt": 0.058,
        "parametersJ": 0.00005,
        "parametersNmax": 4400,
        "parametersUdcbMax": 77.35,
        "parametersUdcbIIRf0": 100,
        "currentLoopSampleTime": 0.000015625,
        "currentLoopF0": 400,
        "currentLoopKsi": 1,
        "speedLoopSampleTime": 0.00025,
        "speedLoopF0": 10,
        "speedLoopKsi": 1,
        "speedLoopIncUp": 4000,
        "speedLoopIncDown": 5000,
        "speedLoopCutOffFreq": 100,
        "speedLoopManualConstantTunning": False,
        "sensorlessBemfObsrvF0": 150,
        "sensorlessBemfObsrvKsi": 1,
        "sensorlessTrackObsrvF0": 35,
        "sensorlessTrackObsrvKsi": 1,
        "sensorlessTrackObsrvIIRSpeedCutOff": 400,
        "sensorlessStartupRamp": 3000,
        "sensorlessMergingSpeed": 500,
        "sensorlessMergingCoeff": 100,
    },
    _texts(
        """D_KP_GAIN=0.474927 D_KI_GAIN=0.00574742 Q_KP_GAIN=0.565531 Q_KI_GAIN=0.00663691
        Q_IIR_ZC_B0=0.0115996 Q_IIR_ZC_A1=0.976801 SPEED_RAMP_UP=0.314159 SPEED_RAMP_DOWN=0.392699
        SPEED_PI_PROP_GAIN=0.0361103 SPEED_PI_INTEG_GAIN=0.000141805 SPEED_IIR_B0=0.0728205
        SPEED_IIR_ZC_B0=0.00391163 SPEED_IIR_ZC_A1=0.992177 UDCB_IIR_B0=0.00488476
        UDCB_IIR_A1=0.990230 U_MAX=44.6581 N_MAX=1382.30 SCALAR_INTEG_GAIN=0.00687500
        SCALAR_RAMP_UP=0.00312500 SCALAR_RAMP_DOWN=0.00390625 I_SCALE=0.985392 U_SCALE=0.132198
        WI_SCALE=0.0000177796 BEMF_DQ_KP_GAIN=0.109035 BEMF_DQ_KI_GAIN=0.00161646
        TO_KP_GAIN=439.823 TO_KI_GAIN=0.755642 TO_THETA_GAIN=0.00000497359
        TO_SPEED_IIR_B0=0.0192568 MERG_COEFF=0.000396729 MERG_SPEED_TRH=157.080
        OL_START_RAMP_INC=0.0147262"""
    ),
)

COMMENTED_2019 = Published(
    "2019",
    {
        "parametersPP": 2,
        "parametersRs": 0.55,
        "parametersLd": 0.000403,
        "parametersLq": 0.000512,
        "parametersKe": 0.0154,
        "parametersJ": 0.0000016,
        "parametersIphNom": 2,
        "currentLoopF0": 288,
        "currentLoopKsi": 1,
        "currentLoopSampleTime": 0.0001,
        "speedLoopF0": 28,
        "speedLoopKsi": 1,
        "speedLoopSampleTime": 0.001,
        "sensorlessBemfObsrvF0": 300,
        "sensorlessBemfObsrvKsi": 1,
    },
    _texts(
        """MOTOR_PP=2 I_MAX=8.25 U_DCB_MAX=60.8 U_MAX=35.1 N_MAX=922.0 FREQ_MAX=147.0 N_NOM=837.8
        I_PH_NOM=2.0 CLOOP_LIMIT=0.519615484541 D_KP_GAIN=0.908503238985
        D_KI_GAIN=0.131962264152 Q_KP_GAIN=1.302986745311 Q_KI_GAIN=0.167654290933
        SPEED_PI_PROP_GAIN=0.002210218185 SPEED_PI_INTEG_GAIN=0.000019442095
        SPEED_LOOP_HIGH_LIMIT=2.0 SPEED_LOOP_LOW_LIMIT=-2.0 SPEED_RAMP_UP=2.094395102393
        SPEED_IIR_B0=0.030459027951 SPEED_IIR_B1=0.030459027951 SPEED_IIR_A1=0.939081944097
        I_SCALE=0.879912663756 U_SCALE=0.218340611354 E_SCALE=0.218340611354
        WI_SCALE=0.000111790394 BEMF_DQ_KP_GAIN=0.969274207277 BEMF_DQ_KI_GAIN=0.143188220652
        TO_KP_GAIN=879.645943005142 TO_KI_GAIN=19.344424626136 TO_THETA_GAIN=0.000031830989
        TO_SPEED_IIR_B0=0.111635211705 TO_SPEED_IIR_A1=0.776729576591 SCALAR_RAMP_UP=0.033333333333
        SCALAR_INTEG_GAIN=0.029333333333"""
    ),
)

COMMENTED_FIXED = Published(
    "2019 fixed point",
    {
        "parametersPP": 2,
        "parametersRs": 0.47,
        "parametersLd": 0.000385,
        "parametersLq": 0.00043,
        "parametersKe": 0.0152,
        "parametersJ": 0.0000016,
        "parametersIphNom": 2,
    },
    _texts(
        """MOTOR_PP=2 I_MAX=8.0 U_DCB_MAX=36.3 U_MAX=21.0 N_MAX=4400 FREQ_MAX=147.0 E_MAX=15.1
        N_NOM=0.909090909091 D_KP_GAIN=0.33701133418206425 D_KI_GAIN=0.02269745822799856
        Q_KP_GAIN=0.3973299131309883 Q_KI_GAIN=0.025350407891011384 CLOOP_LIMIT=0.9
        SPEED_PI_PROP_GAIN=0.5759586531581288 SPEED_PI_INTEG_GAIN=0.005759586531581287
        SPEED_LOOP_HIGH_LIMIT=0.375 SPEED_LOOP_LOW_LIMIT=-0.375 SPEED_RAMP_UP=0.002272727273
        SPEED_IIR_B0=0.119528611806 SPEED_IIR_A1=0.260942776389 I_SCALE=0.891203703704
        U_SCALE=0.607638888889 E_SCALE=0.436921296297 WI_SCALE=0.091726748466
        BEMF_DQ_KP_GAIN=0.5199553938852898 BEMF_DQ_KI_GAIN=0.072472962648529
        TO_KP_GAIN=0.545454545455 TO_KP_SHIFT=-1 TO_KI_GAIN=0.877361148348 TO_KI_SHIFT=-9
        TO_THETA_GAIN=0.938666666667 TO_THETA_SHIFT=-5 TO_SPEED_IIR_B0=0.055817605853
        SCALAR_RAMP_UP=0.000227272727"""
    ),
)

# A project whose inputs were rounded for display: its constants do not follow from them.
ROUNDED_INPUTS = Published(
    "2025",
    LINIX
    | {
        "parametersPP": 4,
        "parametersRs": 2.25,
        "parametersLd": 0.00601,
        "parametersLq": 0.00659,
        "parametersKe": 0.344,
        "parametersJ": 0.0000253,
        "parametersUphNom": 200,
        "parametersImax": 8,
        "parametersUdcbMax": 433,
        "currentLoopF0": 280,
        "speedLoopF0": 28,
        "speedLoopIncUp": 4000,
        "speedLoopIncDown": 4000,
        "sensorlessBemfObsrvF0": 280,
        "sensorlessTrackObsrvF0": 25,
    },
    _texts(
        """MOTOR_PP=4 U_MAX=249.993 D_KP_GAIN=18.9259 D_KI_GAIN=0.582252 Q_KP_GAIN=20.9307
        Q_KI_GAIN=0.637363 Q_IIR_ZC_B0=0.0295512 Q_IIR_ZC_A1=0.940898 CLOOP_LIMIT=0.519615
        SPEED_PI_PROP_GAIN=0.00647341 SPEED_PI_INTEG_GAIN=0.000284716 SPEED_RAMP_UP=1.67552
        SPEED_LOOP_HIGH_LIMIT=2.0 SPEED_IIR_B0=0.239057 I_SCALE=0.977119 U_SCALE=0.0101448
        E_SCALE=0.0101448 WI_SCALE=0.0000668503 BEMF_DQ_KP_GAIN=18.9259 BEMF_DQ_KI_GAIN=1.16450
        TO_KP_GAIN=314.159 TO_KI_GAIN=1.54213 TO_THETA_GAIN=0.0000198944"""
    ),
)
