/* Baseline: one step of the current controllers put together from CMSIS-DSP, whose source is not part of the project.
 *
 * Written by hand for tests/benchmarks/test_control_chain_cost.py. It does what drive_current_control() does, but for the
 * wrap of the angle and the check for what is no number, neither of which CMSIS-DSP has, and keeps no voltage for an observer.
 * The duty cycles are those of the emitted header: arm_inv_clarke_f32 with a search for the extremes takes 26 instructions more.
 */
#ifndef CMSIS_STEP_H
#define CMSIS_STEP_H

#include <dsp/controller_functions.h>

#include "drive_control.h"

typedef struct {
    arm_pid_instance_f32 d;
    arm_pid_instance_f32 q;
    float pole_pairs;
    float l_d_H;
    float l_q_H;
    float psi_pm_Wb;
    float voltage_share;
    float advance_s;
} cmsis_control_t;

static inline drive_abc_t cmsis_current_control(cmsis_control_t *control, const drive_measured_t *measured, drive_dq_t reference)
{
    const float omega_e = control->pole_pairs * measured->omega_m;
    const float v_max = control->voltage_share * measured->v_dc;
    float alpha;
    float beta;
    float sine;
    float cosine;
    float length;
    drive_dq_t i;
    drive_dq_t v;
    drive_alphabeta_t voltage;

    arm_clarke_f32(measured->i.a, measured->i.b, &alpha, &beta);
    arm_sin_cos_f32(57.29578F * measured->theta_e, &sine, &cosine);
    arm_park_f32(alpha, beta, &i.d, &i.q, sine, cosine);
    v.d = arm_pid_f32(&control->d, reference.d - i.d) - (omega_e * (control->l_q_H * i.q));
    v.q = arm_pid_f32(&control->q, reference.q - i.q) + (omega_e * ((control->l_d_H * i.d) + control->psi_pm_Wb));
    length = sqrtf((v.d * v.d) + (v.q * v.q));
    if (length > v_max) {
        const float share = v_max / length;
        const drive_dq_t wanted = v;

        v.d = share * wanted.d;
        v.q = share * wanted.q;
        control->d.state[2] = control->d.state[2] + (v.d - wanted.d); /* the controllers take back what was cut off */
        control->q.state[2] = control->q.state[2] + (v.q - wanted.q);
    }
    arm_sin_cos_f32(57.29578F * (measured->theta_e + (omega_e * control->advance_s)), &sine, &cosine);
    arm_inv_park_f32(v.d, v.q, &voltage.alpha, &voltage.beta, sine, cosine);
    return drive_centred_duties(voltage, measured->v_dc);
}

#endif
