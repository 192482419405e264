"""A current controller for phase machines written by hand, to try the simulated plant with:
currents in proportion to the back-EMF, P action and integrators in alpha-beta-0, the whole voltage
of the references ahead. It has the functions and members that the simulation calls, and nothing
else.
"""

from __future__ import annotations

import struct

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.names import Topology
from dqforge.machines.topologies import TOPOLOGIES

# kp and ki T_s of alpha-beta and of zero, R, L_ab, L_0, T_s; behind them the shape.
NODES = 360
GAINS = struct.Struct("@8fP")

_TEXT = """
#include <math.h>
#include <stdint.h>

typedef struct { float a, b, c; } t_abc_t;
typedef struct { float alpha, beta; } t_alphabeta_t;
typedef struct { float d, q; } t_dq_t;
typedef struct { float LEGS; } t_duties_t;
typedef struct { t_abc_t i; float theta_e; float omega_m; float v_dc; float v_m; } t_measured_t;
typedef struct { float flux[3][NODES + 1]; } t_shape_t;
typedef struct {
    float kp, ki_ts, kp_0, ki_0_ts, r, l, l_0, t_s;
    const t_shape_t *shape;
} t_control_gains_t;
typedef struct {
    t_dq_t reference;
    t_alphabeta_t v;
    float torque, integral[3], speed;
    uint32_t open;
} t_control_t;

static const t_shape_t T_SHAPE = { { { 0 } } };
static const t_control_gains_t T_CONTROL_GAINS = { 0, 0, 0, 0, 0, 1, 1, 1, &T_SHAPE };

static inline t_alphabeta_t t_clarke(t_abc_t i)
{
    t_alphabeta_t out = { (2 * i.a - i.b - i.c) / 3, (i.b - i.c) * 0.57735027F };
    return out;
}

static inline void t_control_start(t_control_t *state)
{
    const t_control_t rest = { { 0, 0 }, { 0, 0 }, 0, { 0, 0, 0 }, 0, 0 };
    *state = rest;
}

static inline void t_open_phase(t_control_t *state, uint32_t phase)
{
    state->open = phase;
    state->integral[0] = state->integral[1] = state->integral[2] = 0;
}

/* f in alpha, beta, zero at an angle */
static inline void t_shape_at(const t_control_gains_t *gains, uint32_t open, float angle,
                              float f[3])
{
    const float turns = angle / (6.28318531F * TURNS);
    const float place = (turns - floorf(turns)) * NODES;
    const int node = (place < NODES) ? (int)place : NODES - 1;
    float x[3];
    int k;
    for (k = 0; k < 3; ++k) {
        const float *row = gains->shape->flux[k];
        const float part = place - (float)node;
        x[k] = ((uint32_t)k + 1U == open) ? 0 : row[node] + (row[node + 1] - row[node]) * part;
    }
    f[0] = (2 * x[0] - x[1] - x[2]) / 3;
    f[1] = (x[1] - x[2]) * 0.57735027F;
    f[2] = ZERO ? (x[0] + x[1] + x[2]) / 3 : 0;
}

static inline void t_wanted(const float f[3], float torque, float i[3])
{
    const float square = PAIRS * (1.5F * (f[0] * f[0] + f[1] * f[1]) + 3 * f[2] * f[2]);
    int k;
    for (k = 0; k < 3; ++k) {
        i[k] = torque * f[k] / square;
    }
}

static inline t_duties_t t_torque_control(const t_control_gains_t *gains, t_control_t *state,
                                          const t_measured_t *m, float torque)
{
    const float omega_e = PAIRS * m->omega_m, step = omega_e * gains->t_s;
    const t_alphabeta_t plane = t_clarke(m->i);
    const float i_now[3] = { plane.alpha, plane.beta, (m->i.a + m->i.b + m->i.c) / 3 };
    float f[3], now[3], next[3], last[3], ahead[3], v[3], p[3], off;
    t_duties_t d;
    int k;

    t_shape_at(gains, state->open, m->theta_e, f);
    t_wanted(f, torque, now);
    t_shape_at(gains, state->open, m->theta_e + step, f);
    t_wanted(f, torque, next);
    t_shape_at(gains, state->open, m->theta_e + 2 * step, f);
    t_wanted(f, torque, last);
    t_shape_at(gains, 0U, m->theta_e + 1.5F * step, ahead);
    for (k = 0; k < 3; ++k) {
        const float l = (k < 2) ? gains->l : gains->l_0, e = now[k] - i_now[k];
        state->integral[k] += ((k < 2) ? gains->ki_ts : gains->ki_0_ts) * e;
        v[k] = gains->r * 0.5F * (next[k] + last[k]) + l * (last[k] - next[k]) / gains->t_s
               + omega_e * ahead[k] + ((k < 2) ? gains->kp : gains->kp_0) * e + state->integral[k];
    }
    v[2] = ZERO ? v[2] : 0;
    state->torque = torque;
    state->v.alpha = v[0];
    state->v.beta = v[1];
    p[0] = v[0] + v[2];
    p[1] = -0.5F * v[0] + 0.8660254F * v[1] + v[2];
    p[2] = -0.5F * v[0] - 0.8660254F * v[1] + v[2];
    off = -0.5F * (fmaxf(fmaxf(p[0], p[1]), fmaxf(p[2], LEAST))
                   + fminf(fminf(p[0], p[1]), fminf(p[2], -(LEAST))));
MODULATOR
    return d;
}

static inline t_duties_t t_current_control(const t_control_gains_t *gains, t_control_t *state,
                                           const t_measured_t *m, t_dq_t reference)
{
    state->reference = reference;
    return t_torque_control(gains, state, m, reference.q);
}

static inline t_duties_t t_speed_control(const t_control_gains_t *gains, t_control_t *state,
                                         const t_measured_t *m, float reference)
{
    return t_torque_control(gains, state, m, 0.01F * (reference - m->omega_m));
}
"""

_CENTRED = "".join(f"    d.{x} = 0.5F + (p[{k}] + off) / m->v_dc;\n" for k, x in enumerate("abc"))

_MODULATORS: dict[Topology, str] = {
    "three-wire": _CENTRED,
    "diode-neutral": _CENTRED,
    "four-leg": _CENTRED + "    d.n = 0.5F + off / m->v_dc;\n",
    "split-capacitor": "    (void)off;\n"
    + "".join(f"    d.{x} = (p[{k}] + m->v_m) / m->v_dc;\n" for k, x in enumerate("abc")),
    "six-leg": "    (void)off;\n"
    + "".join(
        f"    d.{x} = 0.5F + 0.5F * p[{k}] / m->v_dc;\n    d.{x}2 = 1 - d.{x};\n"
        for k, x in enumerate("abc")
    ),
    "six-leg-isolated": "".join(
        f"    d.{x} = 0.5F + 0.5F * (p[{k}] + off) / m->v_dc;\n    d.{x}2 = 1 - d.{x};\n"
        for k, x in enumerate("abc")
    ),
}


def header(topology: Topology, pole_pairs: int, turns: int = 1) -> dict[str, bytes]:
    """The header ``t_control.h`` by name, for a topology."""
    rule = TOPOLOGIES[topology]
    four = topology == "four-leg"
    text = (
        _TEXT.replace("MODULATOR\n", _MODULATORS[topology])
        .replace("LEGS", ", ".join(rule.legs))
        .replace("LEAST", "0" if four else "-1e9F")
        .replace("ZERO", "1" if rule.neutral else "0")
        .replace("NODES", str(NODES))
        .replace("PAIRS", f"{pole_pairs}.0F")
        .replace("TURNS", f"{turns}.0F")
    )
    return {"t_control.h": text.encode("ascii")}


def gain_bytes(omega_c: float, r_s: float, inductances: tuple[float, float], t_s: float) -> bytes:
    """Gains for a bandwidth in rad/s and (L_ab, L_0) in H: kp = omega_c L, ki = kp omega_c/10."""
    l_ab, l_0 = inductances
    pi = [
        value
        for inductance in inductances
        for value in (omega_c * inductance, 0.1 * omega_c**2 * inductance * t_s)
    ]
    return GAINS.pack(*pi, r_s, l_ab, l_0, t_s, 0)


def shape_bytes(flux: FloatArray) -> bytes:
    """The back-EMF over electrical speed in V s/rad, shape (3, N), at `NODES` nodes and the first
    one again.
    """
    places = np.arange(NODES) * flux.shape[1] // NODES
    nodes = flux[:, places].astype(np.float32)
    return np.column_stack([nodes, nodes[:, :1]]).tobytes()
