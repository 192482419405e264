"""Names of what the compiled plant integrates, reads and writes, in the order of its structures."""

from __future__ import annotations

# States of the plant; those from ``torque`` on serve phase machines, ``torque`` being the integral
# of the torque and ``v_midpoint`` the voltage of a split link's midpoint above its half.
STATES = (
    "i_x",
    "i_y",
    "i_zero",
    "omega_m",
    "theta_m",
    "e_in",
    "e_copper",
    "e_shaft",
    "e_load",
    "e_friction",
    "i_square",
    "torque",
    "v_midpoint",
    "neutral_square",
    "e_copper_a",
    "e_copper_b",
    "e_copper_c",
)

# Further states, where a tracker is told the voltages of the phases: their integrals, in V s.
HEARD = ("v_a", "v_b", "v_c")

# Fields of the C structure ``parameters_t``, all doubles, in this order.
PARAMETERS = (
    *("mode", "t_s", "samples", "stride", "sub_steps", "tail", "progress", "seed", "i_stop"),
    *(
        "kind",
        "pole_pairs",
        "r_s",
        "l_d",
        "l_q",
        "psi_pm",
        "scale_d",
        "scale_q",
        "scale_pm",
    ),
    *("inertia", "friction", "driven", "omega_m_0", "theta_m_0"),
    *("switched", "halves", "dead_time", "dead_band", "ripple_l_d", "ripple_l_q"),
    *("counts", "speed_ratio", "angle_error"),
    *(
        "adc_bits",
        "adc_full_scale",
        "noise",
        "offset_a",
        "offset_b",
        "offset_c",
        "gain_a",
        "gain_b",
        "gain_c",
    ),
    *("v_bits", "v_full_scale"),
    *("observed_speed", "sensorless", "sensor_above", "sensor_below"),
    *("legs", "second", "neutral", "capacitance", "l_own", "l_mutual", "l_neutral", "turns"),
    *("i_nothing", "open_phase", "open_time", "aware_time"),
    "delay",
    *("load_resists", "brake_time", "brake_stiffness", "brake_damping"),
    *("encoderless", "stop_time"),
    *("edges", "clock", "measured_ratio"),
)

# What is recorded at a sampling instant, in this order.
COLUMNS = (
    *(
        "t",
        "i_d",
        "i_q",
        "i_zero",
        "omega_m",
        "theta_e",
        "torque",
        "torque_load",
        "duty_a",
        "duty_b",
        "duty_c",
    ),
    *("v_dc", "reference", "reference_d", "i_a_measured", "i_b_measured", "i_c_measured"),
    *("theta_e_measured", "omega_m_measured", "i_d_reference", "i_q_reference", "torque_reference"),
    *("v_alpha", "v_beta", "theta_e_observed", "omega_m_observed", "sensorless"),
    *("start_state", "start_fault", "start_reference"),
    *("application_state", "application_fault"),
    *("duty_n", "duty_a2", "duty_b2", "duty_c2", "i_a", "i_b", "i_c", "i_n", "v_m", "torque_mean"),
)

# Figures of a run, in this order.
SUMMARY = (
    *(
        "status",
        "t",
        "peak_current",
        "tail_error",
        "tail_current",
        "i_d",
        "i_q",
        "omega_m",
        "torque",
        "i_square",
    ),
    *("e_in", "e_copper", "e_shaft", "e_load", "e_friction"),
    *("e_magnetic", "e_midpoint", "tail_torque", "tail_ripple_means", "tail_ripple"),
    *("tail_neutral_rms", "tail_copper_a", "tail_copper_b", "tail_copper_c", "tail_midpoint"),
)
