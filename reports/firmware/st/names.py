"""Variables of Workbench 5 and the macros that they are, and which values are possible."""

from __future__ import annotations

from dqforge.machines.records import dataclass

MILLI = 1e-3


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable of a project: the macro that it is, and its unit in that of the macro."""

    macro: str
    unit: float = 1.0


VARIABLES = {
    "Pole Pairs": Variable("POLE_PAIR_NUM"),
    "Max Rated Speed": Variable("MOTOR_MAX_SPEED_RPM"),
    "Nominal Current": Variable("NOMINAL_CURRENT_A"),
    "Nominal DC Voltage": Variable("motor_voltage"),
    "Nominal voltage": Variable("NOMINAL_BUS_VOLTAGE_V"),
    "Rs": Variable("RS"),
    "Ls": Variable("LS", MILLI),
    "Ld": Variable("Ld", MILLI),
    "Lq": Variable("Lq", MILLI),
    "B-EmfConstant": Variable("MOTOR_VOLTAGE_CONSTANT"),
    "inertia": Variable("inertia"),
    "friction": Variable("friction"),
    "Shunt resistor(s) value": Variable("RSHUNT"),
    "Amplifying network gain": Variable("AMPLIFICATION_GAIN"),
    "ICS gain": Variable("sensor_slope"),
    "PWM frequency": Variable("PWM_FREQUENCY"),
    "Dead time": Variable("SW_DEADTIME_NS"),
    "Torque - P dividend": Variable("PID_TORQUE_KP_DEFAULT"),
    "Torque - P divisor": Variable("TF_KPDIV"),
    "Torque - I dividend": Variable("PID_TORQUE_KI_DEFAULT"),
    "Torque - I divisor": Variable("TF_KIDIV"),
    "Flux - P dividend": Variable("PID_FLUX_KP_DEFAULT"),
    "Flux - P divisor": Variable("flux_kp_divider"),
    "Flux - I dividend": Variable("PID_FLUX_KI_DEFAULT"),
    "Flux - I divisor": Variable("flux_ki_divider"),
    "SpeedCtrl - Execution rate": Variable("speed_period", MILLI),
    "SpeedCtrl - P dividend": Variable("PID_SPEED_KP_DEFAULT"),
    "SpeedCtrl - P divisor": Variable("SP_KPDIV"),
    "SpeedCtrl - I dividend": Variable("PID_SPEED_KI_DEFAULT"),
    "SpeedCtrl - I divisor": Variable("SP_KIDIV"),
    "Main - ObsPLL - F1": Variable("F1"),
    "Main - ObsPLL - F2": Variable("F2"),
    "Main - ObsPLL - G1": Variable("GAIN1"),
    "Main - ObsPLL - G2": Variable("GAIN2"),
    "Main - ObsPLL - P dividend": Variable("PLL_KP_GAIN"),
    "Main - ObsPLL - P divisor": Variable("PLL_KPDIV"),
    "Main - ObsPLL - I dividend": Variable("PLL_KI_GAIN"),
    "Main - ObsPLL - I divisor": Variable("PLL_KIDIV"),
    "Main - ObsPLL - Average speed FIFO depth for speed loop": Variable("STO_FIFO_DEPTH_UNIT"),
    "SL - Minimum start-up output speed": Variable("OBS_MINIMUM_SPEED_RPM"),
}

# A list whose value is the place of the chosen item.
EXECUTION_RATE = "Torque&Flux - Execution rate"

# List of the kinds of machine, and the tag of those without saliency, which have Ls alone.
STRUCTURE, SURFACE = "I/SM-PMSM", "0"

# List of the kinds of current measurement, and the tag of sensors without a shunt.
TOPOLOGY, SENSORS = "Current reading topology", "2"

# What is no macro of the headers and is turned into those that are.
OWN_NAMES = (
    "Ld",
    "Lq",
    "motor_voltage",
    "speed_period",
    "flux_kp_divider",
    "flux_ki_divider",
    "sensor_slope",
)

# What must be true for Workbench to leave gains as they are.
BY_HAND = (
    "Torque&Flux - Manual editing enabled",
    "SpeedCtrl_Manual_editing",
    "Main - ObsPLL - Manual editing enabled",
)

# Least and largest value of a macro; all others lie between -65536 and 65536.
POSSIBLE = {
    "POLE_PAIR_NUM": (1.0, 200.0),
    "RS": (1e-6, 1e3),
    "LS": (1e-9, 10.0),
    "MOTOR_VOLTAGE_CONSTANT": (0.0, 1e5),
    "MOTOR_MAX_SPEED_RPM": (1.0, 1e6),
    "MAX_APPLICATION_SPEED_RPM": (1.0, 1e6),
    "NOMINAL_CURRENT_A": (1e-3, 1e5),
    "IQMAX_A": (1e-3, 1e5),
    "NOMINAL_BUS_VOLTAGE_V": (1.0, 2e4),
    "RSHUNT": (1e-6, 100.0),
    "AMPLIFICATION_GAIN": (1e-3, 1e4),
    "ADC_REFERENCE_VOLTAGE": (0.1, 20.0),
    "VBUS_PARTITIONING_FACTOR": (1e-5, 10.0),
    "PWM_FREQUENCY": (100.0, 1e7),
    "REGULATION_EXECUTION_RATE": (1.0, 100.0),
    "SPEED_LOOP_FREQUENCY_HZ": (1.0, 1e5),
    "SW_DEADTIME_NS": (0.0, 1e5),
    "SEGDIV": (0.0, 32767.0),
    "STO_FIFO_DEPTH_UNIT": (1.0, 1024.0),
    "STO_FIFO_DEPTH_DPP": (1.0, 1024.0),
    "ld_lq_ratio": (1e-3, 1e3),
    "inertia": (0.0, 1e11),
    "friction": (0.0, 1e10),
} | dict.fromkeys(
    (
        *("TF_KPDIV", "TF_KIDIV", "SP_KPDIV", "SP_KIDIV", "PLL_KPDIV", "PLL_KIDIV", "F1", "F2"),
        *("flux_kp_divider", "flux_ki_divider"),
    ),
    (1.0, 65536.0),
)

BEYOND = (-65536.0, 65536.0)

# Macros behind the values of a configuration, and how they are converted.
FIELDS = {
    "pole_pairs": ("POLE_PAIR_NUM", ""),
    "r_s": ("RS", ""),
    "l_d": ("LS", "times ld_lq_ratio where there is one"),
    "l_q": ("LS", ""),
    "psi_pm": ("MOTOR_VOLTAGE_CONSTANT", "sqrt(2/3) 60/(2 pi 1000 p)"),
    "inertia": ("inertia", "1e-6 kg m^2"),
    "viscous": ("friction", "1e-6 N m s/rad"),
    "i_max": ("NOMINAL_CURRENT_A", ""),
    "omega_m_max": ("MAX_APPLICATION_SPEED_RPM", "rpm to rad/s"),
    "v_dc": ("NOMINAL_BUS_VOLTAGE_V", ""),
    "f_sw": ("PWM_FREQUENCY", ""),
    "dead_time": ("SW_DEADTIME_NS", "ns to s"),
    "t_s": ("REGULATION_EXECUTION_RATE", "over PWM_FREQUENCY"),
    "t_speed": ("SPEED_LOOP_FREQUENCY_HZ", "its reciprocal"),
    "shunt": ("RSHUNT", ""),
    "sense_gain": ("AMPLIFICATION_GAIN", ""),
    "sense_reference": ("ADC_REFERENCE_VOLTAGE", ""),
    "current_q.kp": ("PID_TORQUE_KP_DEFAULT", "over TF_KPDIV, times v_dc/sqrt(3) over full scale"),
    "current_q.ki": (
        "PID_TORQUE_KI_DEFAULT",
        "over TF_KIDIV, times v_dc/sqrt(3) f over full scale",
    ),
    "current_d.kp": ("PID_FLUX_KP_DEFAULT", "over TF_KPDIV, times v_dc/sqrt(3) over full scale"),
    "current_d.ki": ("PID_FLUX_KI_DEFAULT", "over TF_KIDIV, times v_dc/sqrt(3) f over full scale"),
    "speed.kp": ("PID_SPEED_KP_DEFAULT", "over SP_KPDIV, full scale/32768 per 0.1 Hz"),
    "speed.ki": ("PID_SPEED_KI_DEFAULT", "over SP_KIDIV, full scale/32768 f per 0.1 Hz"),
    "pll.kp": ("PLL_KP_GAIN", "over PLL_KPDIV, per control period"),
    "pll.ki": ("PLL_KI_GAIN", "over PLL_KIDIV, per control period"),
}
