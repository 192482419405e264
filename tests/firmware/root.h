/* Baseline: i_d from a given i_q by the MTPA locus with one square root (Morimoto); the argument is i_q in A.
 *
 * Written by hand for tests/benchmarks/test_firmware_cost.py, which replaces the words in capitals; sign, clamping and
 * not-a-number are handled as in the emitted header.
 */
#ifndef ROOT_H
#define ROOT_H

#include <math.h>

static inline void root_current_reference(float asked_A, float *i_d_A, float *i_q_A)
{
    const float t = fabsf(asked_A);
    float i_q;

    if (t <= CURRENT_MAX) {
        i_q = asked_A;
    } else if (t > CURRENT_MAX) {
        i_q = (asked_A < 0.0F) ? -CURRENT_MAX : CURRENT_MAX;
    } else {
        i_q = 0.0F;
    }

    *i_d_A = BASE - sqrtf(i_q * i_q + SQUARED);
    *i_q_A = i_q;
}

#endif
