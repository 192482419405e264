"""The emitted current control around a machine in rotor coordinates: how currents die out.

The machine is stepped by exponentials of its equations, which are written down here. Its back-EMF
is taken to be what the controller feeds forward, so that nothing but the loop itself moves the
currents; between measurements everything that machine and controller remember is scaled back, as
the loop is linear while no voltage is shortened.
"""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import expm

from dqforge.machines.names import Topology
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.phase_control.phase_controller import PhaseControl
from dqforge.optimizer.solution import Solution
from dqforge.reports.main_header import header_files
from dqforge.reports.phase_control.header import phase_control_files

# Phase voltages over the link voltage, against half the link on the split one.
PHASES: dict[Topology, tuple[str, str, str]] = {
    "three-wire": ("duty.a", "duty.b", "duty.c"),
    "diode-neutral": ("duty.a", "duty.b", "duty.c"),
    "four-leg": ("duty.a - duty.n", "duty.b - duty.n", "duty.c - duty.n"),
    "split-capacitor": ("duty.a - 0.5", "duty.b - 0.5", "duty.c - 0.5"),
    "six-leg": ("duty.a - duty.a2", "duty.b - duty.b2", "duty.c - duty.c2"),
    "six-leg-isolated": ("duty.a - duty.a2", "duty.b - duty.b2", "duty.c - duty.c2"),
}

# V: so much that no voltage is shortened while currents are small, even at high speed.
LINK = 6000.0

SOURCE = """
#include <math.h>
#include <stdio.h>
#include "@_control.h"

typedef struct {
    double samples, settle, factor, step, theta, turn, v_dc, free, level, own;
    double plane[2][4], zero[2][3], current[3];
} job_t;

static @_control_t state;
static @_shape_t shape;
static double current[3], acting[3], midpoint;

static double size(void)
{
    return sqrt(current[0] * current[0] + current[1] * current[1] + current[2] * current[2]
        + 0.01 * (acting[0] * acting[0] + acting[1] * acting[1] + acting[2] * acting[2]
        + midpoint * midpoint));
}

static void scale(double factor)
{
    unsigned n;

    state.d.integral *= (float)factor;
    state.q.integral *= (float)factor;
    SCALE_REST
    for (n = 0; n < 3; ++n) {
        current[n] *= factor;
        acting[n] *= factor;
    }
    midpoint *= factor;
}

static void one(const job_t *job, const @_control_gains_t *gains, double theta)
{
    const double next = theta + job->step;
    const @_dq_t none = { 0.0F, 0.0F };
    double now[3], before[3], alpha, beta, zero;
    @_measured_t measured;
    @_duties_t duty;
    double v_a, v_b, v_c;
    unsigned n;

    alpha = cos(theta) * current[0] - sin(theta) * current[1];
    beta = sin(theta) * current[0] + cos(theta) * current[1];
    measured.i.a = (float)(alpha + current[2]);
    measured.i.b = (float)(-0.5 * alpha + sqrt(0.75) * beta + current[2]);
    measured.i.c = (float)(-0.5 * alpha - sqrt(0.75) * beta + current[2]);
    measured.theta_e = (float)fmod(theta, job->turn);
    measured.omega_m = (float)(job->step / gains->t_s_s / gains->pole_pairs);
    measured.v_dc = (float)job->v_dc;
    MIDPOINT
    duty = @_current_control(gains, &state, &measured, none);
    v_a = job->v_dc * (PHASE_A);
    v_b = job->v_dc * (PHASE_B);
    v_c = job->v_dc * (PHASE_C);
    alpha = (2.0 * v_a - v_b - v_c) / 3.0;
    beta = (v_b - v_c) / sqrt(3.0);
    zero = (v_a + v_b + v_c) / 3.0;
    EMF
    for (n = 0; n < 3; ++n) {
        before[n] = current[n];
    }
    for (n = 0; n < 2; ++n) {
        now[n] = job->plane[n][0] * before[0] + job->plane[n][1] * before[1]
            + job->plane[n][2] * acting[0] + job->plane[n][3] * acting[1];
    }
    current[0] = now[0];
    current[1] = now[1];
    current[2] = job->zero[0][0] * before[2] + job->zero[0][1] * midpoint
        + job->zero[0][2] * acting[2];
    midpoint = job->zero[1][0] * before[2] + job->zero[1][1] * midpoint
        + job->zero[1][2] * acting[2];
    acting[0] = cos(next) * alpha + sin(next) * beta;
    acting[1] = cos(next) * beta - sin(next) * alpha;
    acting[2] = ZERO ? zero : 0.0;
}

int main(void)
{
    job_t job;

    while (fread(&job, sizeof job, 1, stdin) == 1) {
        @_control_gains_t gains = UPPER_CONTROL_GAINS;
        double logs = 0.0, start = 0.0, largest = 0.0;
        unsigned long k;

        if (job.own > 0.5) {
            if (fread(&gains, sizeof gains, 1, stdin) != 1
                || fread(&shape, sizeof shape, 1, stdin) != 1) {
                return 3;
            }
            gains.shape = &shape;
        }
        gains.d.kp *= (float)job.factor;
        gains.q.kp *= (float)job.factor;
        gains.zero.kp *= (float)job.factor;
        gains.d.ki_ts *= (float)job.factor;
        gains.q.ki_ts *= (float)job.factor;
        gains.zero.ki_ts *= (float)job.factor;
        LEARN
        @_control_start(&state);
        midpoint = 0.0;
        for (k = 0; k < 3; ++k) {
            current[k] = job.current[k];
            acting[k] = 0.0;
        }
        for (k = 0; k < (unsigned long)(job.settle + job.samples); ++k) {
            one(&job, &gains, job.theta + (double)k * job.step);
            if (job.free > 0.5) {
                if (k >= (unsigned long)job.settle && size() > largest) {
                    largest = size();
                }
                continue;
            }
            if (k + 1 == (unsigned long)job.settle) {
                start = logs + log(size());
            }
            if (k % 20 == 19) {
                const double found = size();

                logs += log(found / job.level);
                scale(job.level / found);
            }
        }
        largest = job.free > 0.5 ? largest : (logs + log(size()) - start) / job.samples;
        if (fwrite(&largest, sizeof largest, 1, stdout) != 1) {
            return 2;
        }
    }
    return 0;
}
"""


@dataclass(frozen=True)
class EmittedLoop:
    """A compiled controller, and what it was emitted from.

    ``data`` are the bytes of its gains and of its back-EMF, empty for those in the header; the
    control is what they hold. Currents stay around ``level`` in A, on a link of ``v_dc`` in V that
    shortens no voltage while they are that small.
    """

    program: Path
    control: PhaseControl
    data: bytes = b""
    level: float = 0.3
    v_dc: float = LINK

    def decay(
        self, omega: float, plant: tuple[float, ...], factor: float, settle: int, samples: int,
        theta: float = 0.0,
    ) -> float:  # fmt: skip
        """What is left of a disturbance per sample; ``plant`` as (R, L_d, L_q, L_0[, C])."""
        return float(np.exp(self._run(omega, plant, factor, settle, samples, theta, free=False)))

    def amplitude(
        self, omega: float, plant: tuple[float, ...], factor: float, settle: int, samples: int
    ) -> float:
        """Largest size of currents in A from the sample ``settle`` on, started from 10 mA."""
        return self._run(omega, plant, factor, settle, samples, 0.0, free=True)

    def _run(
        self, omega: float, plant: tuple[float, ...], factor: float, settle: int, samples: int,
        theta: float, *, free: bool,
    ) -> float:  # fmt: skip
        t_s, (r_s, l_d, l_q, l_0) = self.control.t_s, plant[:4]
        flow = np.zeros((4, 4))
        flow[0] = -r_s / l_d, omega * l_q / l_d, 1.0 / l_d, 0.0
        flow[1] = -omega * l_d / l_q, -r_s / l_q, 0.0, 1.0 / l_q
        flow[2, 3], flow[3, 2] = omega, -omega
        split = TOPOLOGIES[self.control.topology].midpoint
        common = np.zeros((3, 3))
        common[0] = -r_s / l_0, -1.0 / l_0 if split else 0.0, 1.0 / l_0
        common[1, 0] = 3.0 / plant[4] if split else 0.0
        neutral = TOPOLOGIES[self.control.topology].neutral
        zero = expm(common * t_s)[:2] if neutral else np.zeros((2, 3))
        first = (0.01 if free else self.level) * np.array([0.6, -0.7, 0.4 * neutral])
        turn = 2.0 * np.pi * self.control.shape.turns
        head = [samples, settle, factor, omega * t_s, theta, turn, self.v_dc, float(free)]
        head += [self.level, float(len(self.data) > 0)]
        job = np.concatenate([head, expm(flow * t_s)[:2].ravel(), zero.ravel(), first])
        done = subprocess.run(
            [self.program], input=job.astype(np.float64).tobytes() + self.data, capture_output=True,
            check=True, timeout=60,
        )  # fmt: skip
        return float(np.frombuffer(done.stdout, dtype=np.float64)[0])


def compiled_loop(folder: Path, solution: Solution, control: PhaseControl) -> EmittedLoop:
    """Emits and compiles the control."""
    prefix = solution.design.export.prefix
    rule = TOPOLOGIES[control.topology]
    for name, content in (header_files(solution) | phase_control_files(solution, control)).items():
        (folder / name).write_bytes(content)
    harmonics = control.harmonics
    rest = ["state.zero.integral *= (float)factor;"] if rule.neutral else []
    for name, orders in (
        ("harmonic", () if harmonics is None else harmonics.plane),
        ("harmonic_zero", () if harmonics is None or not rule.neutral else harmonics.zero),
    ):
        if orders:
            each = f"state.{name}[n].alpha *= (float)factor; state.{name}[n].beta *= (float)factor;"
            rest.append(f"for (n = 0; n < {len(orders)}; ++n) {{ {each} }}")
    opened = ", 0U" if rule.neutral else ""
    place = "(float)((theta + 1.5 * job->step) / job->turn)"
    emf = (
        f"{{ const {prefix}_alphabetazero_t f = {prefix}_shape_at(gains->shape, {place}{opened});"
        "const double omega = job->step / gains->t_s_s;"
        "alpha -= omega * f.alpha; beta -= omega * f.beta; zero -= omega * f.zero; }"
    )
    changes = {
        "@": prefix,
        "UPPER": prefix.upper(),
        "SCALE_REST": "\n    ".join(rest),
        "MIDPOINT": "measured.v_m = (float)(0.5 * job->v_dc + midpoint);" if rule.midpoint else "",
        "PHASE_A": PHASES[control.topology][0],
        "PHASE_B": PHASES[control.topology][1],
        "PHASE_C": PHASES[control.topology][2],
        "EMF": "" if control.feedforward == "none" else emf,
        "ZERO": "1" if rule.neutral else "0",
        "LEARN": "" if harmonics is None else "gains.harmonic_error_max_A = 1e9F;",
    }
    source = SOURCE
    for word, text in changes.items():
        source = source.replace(word, text)
    (folder / "loop.c").write_text(source, encoding="ascii")
    program = folder / "loop"
    command = ["cc", "-std=c99", "-O2", "-ffp-contract=off", "-o", str(program), "loop.c", "-lm"]
    subprocess.run(command, cwd=folder, check=True, timeout=120)
    return EmittedLoop(program, control)
