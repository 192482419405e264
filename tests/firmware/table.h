/* Baseline: both currents from tables of COUNT points over the torque, straight lines between them.
 *
 * Written by hand for tests/benchmarks/test_firmware_cost.py, which replaces the words in capitals; sign, clamping and
 * not-a-number are handled as in the emitted header.
 */
#ifndef TABLE_H
#define TABLE_H

#include <math.h>
#include <stdint.h>

static const float table_i_d[COUNT] = { VALUES_D };
static const float table_i_q[COUNT] = { VALUES_Q };

static inline void table_current_reference(float torque_Nm, float *i_d_A, float *i_q_A)
{
    const float t = fabsf(torque_Nm);
    float i_d;
    float i_q;

    if (t <= TORQUE_MAX) {
        const float place = t * POINTS_PER_NM;
        uint32_t k = (uint32_t)place;
        float x;

        if (k > LAST) { /* the end itself lies in the last interval */
            k = LAST;
        }
        x = place - (float)k;
        i_d = (table_i_d[k + 1U] - table_i_d[k]) * x + table_i_d[k];
        i_q = (table_i_q[k + 1U] - table_i_q[k]) * x + table_i_q[k];
        i_q = (torque_Nm < 0.0F) ? -i_q : i_q;
    } else if (t > TORQUE_MAX) {
        i_d = END_D;
        i_q = (torque_Nm < 0.0F) ? -END_Q : END_Q;
    } else {
        i_d = 0.0F;
        i_q = 0.0F;
    }

    *i_d_A = i_d;
    *i_q_A = i_q;
}

#endif
