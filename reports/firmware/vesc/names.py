"""Names of VESC's motor configuration in C, and what its headers may write instead of numbers."""

from __future__ import annotations

from dqforge.optimizer.firmware.vesc_format import KEYS, LOOP_DEFAULTS

_OTHERWISE = {
    "motor_type": "MCCONF_DEFAULT_MOTOR_TYPE",
    "l_abs_current_max": "MCCONF_L_MAX_ABS_CURRENT",
    "l_min_erpm": "MCCONF_L_RPM_MIN",
    "l_max_erpm": "MCCONF_L_RPM_MAX",
    "l_erpm_start": "MCCONF_L_RPM_START",
    "s_pid_min_erpm": "MCCONF_S_PID_MIN_RPM",
}

_FURTHER = ("foc_encoder_ratio", "foc_fw_current_max", "l_erpm_start", "s_pid_min_erpm")


def define(name: str) -> str:
    """Name of the macro of a key (``cDefine`` in parameters_mcconf.xml)."""
    return _OTHERWISE.get(name, f"MCCONF_{name.upper()}")


# Keys that are read; all others of a file are kept and not looked at.
READ = tuple(dict.fromkeys((*KEYS, *LOOP_DEFAULTS, *_FURTHER)))

# Keys that hold whole numbers.
WHOLE = frozenset(
    {name for name, key in KEYS.items() if key.kind == "whole"}
    | {"foc_observer_type", "foc_sensor_mode"}
)

# Names that older versions used, and those of today.
FORMER = {
    "foc_f_sw": "foc_f_zv",
    "foc_sample_v0_v7": "foc_control_sample_mode",
}


def _numbered(*names: str) -> dict[str, float]:
    return {name: float(index) for index, name in enumerate(names)}


# Enumerators of the firmware (datatypes.h) with their numbers.
WORDS = (
    {"true": 1.0, "false": 0.0}
    | _numbered("MOTOR_TYPE_BLDC", "MOTOR_TYPE_DC", "MOTOR_TYPE_FOC")
    | _numbered(
        "FOC_SENSOR_MODE_SENSORLESS",
        "FOC_SENSOR_MODE_ENCODER",
        "FOC_SENSOR_MODE_HALL",
        "FOC_SENSOR_MODE_HFI",
        "FOC_SENSOR_MODE_HFI_START",
        "FOC_SENSOR_MODE_HFI_V2",
        "FOC_SENSOR_MODE_HFI_V3",
        "FOC_SENSOR_MODE_HFI_V4",
        "FOC_SENSOR_MODE_HFI_V5",
    )
    | _numbered(
        "FOC_CC_DECOUPLING_DISABLED",
        "FOC_CC_DECOUPLING_CROSS",
        "FOC_CC_DECOUPLING_BEMF",
        "FOC_CC_DECOUPLING_CROSS_BEMF",
    )
    | _numbered(
        "FOC_OBSERVER_ORTEGA_ORIGINAL",
        "FOC_OBSERVER_MXLEMMING",
        "FOC_OBSERVER_ORTEGA_LAMBDA_COMP",
        "FOC_OBSERVER_MXLEMMING_LAMBDA_COMP",
        "FOC_OBSERVER_MXV",
        "FOC_OBSERVER_MXV_LAMBDA_COMP",
        "FOC_OBSERVER_MXV_LAMBDA_COMP_LIN",
    )
    | _numbered("MTPA_MODE_OFF", "MTPA_MODE_IQ_TARGET", "MTPA_MODE_IQ_MEASURED")
    | _numbered("S_PID_SPEED_SRC_PLL", "S_PID_SPEED_SRC_FAST", "S_PID_SPEED_SRC_FASTER")
    | _numbered(
        "FOC_CONTROL_SAMPLE_MODE_V0",
        "FOC_CONTROL_SAMPLE_MODE_V0_V7",
        "FOC_CONTROL_SAMPLE_MODE_V0_V7_INTERPOL",
    )
    | _numbered(
        "PID_RATE_25_HZ",
        "PID_RATE_50_HZ",
        "PID_RATE_100_HZ",
        "PID_RATE_250_HZ",
        "PID_RATE_500_HZ",
        "PID_RATE_1000_HZ",
        "PID_RATE_2500_HZ",
        "PID_RATE_5000_HZ",
        "PID_RATE_10000_HZ",
    )
)
