"""Sliding-mode observer of the extended EMF with a saturation function, with a phase-locked loop.

A model of the current in stationary coordinates (complex, alpha + j beta) is driven by the voltage
and a switched one, z, that holds the modelled current at the measured one (``gap`` = modelled
minus measured); what z must be is the extended EMF e (`extended_emf`):

    L_d d(gap)/dt = e - R gap - z,    z = k gap / max(|gap|, h)

Within the boundary layer |gap| <= h that is linear; outside |z| = k, and the gap shrinks as
long as |e| < k. Sampled, with the measured current in the other terms of the machine
(m = (R + j omega (L_q - L_d)) t_s / L_d, I = i[k] - i[k-1], x = omega t_s):

    u_0 = (t_s / L_d) v[k] - m (i[k-1] + i[k])/2 - I
    u = u_0 - m/12 (m I + j x u_0)                   the mean EMF of the period, times t_s / L_d
    gap[k] = phi gap[k-1] - (t_s / L_d) z[k-1] + u,     phi = exp(-R t_s / L_d)

(trapezoid with end correction). In the layer the gap is multiplied by q = phi - g per sample,
g = k t_s / (L_d h). A low-pass filter follows,

    e_f[k] = rho e_f[k-1] + (1 - rho) (1 - q)/g z[k],   rho = exp(-bandwidth t_s)

and both lags are taken back where the drive is steady: e = c(x) e_f with

    c = (x/2) / sin(x/2)  (exp(j x/2) - q exp(-j x/2)) / (1 - q)  (1 - rho exp(-j x)) / (1 - rho)

of which the firmware evaluates polynomials of degree 4 (real part, even) and 5 (imaginary, odd).

References:
    V. Utkin, J. Guldner, J. Shi, "Sliding Mode Control in Electro-Mechanical Systems", 2nd edition,
    2009 (equivalent control, boundary layer); S. Chi, Z. Zhang, L. Xu, "Sliding-mode sensorless
    control of direct-drive PM synchronous motors for washing machine applications", IEEE Trans.
    Industry Applications 45 (2), 2009; Z. Chen et al. as in `extended_emf` (model).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.extended_emf import (
    ComplexArray,
    Triple,
    emf_angle_error,
    emf_part,
    even_odd,
    filter_pole,
    speed_nodes,
    usual_eemf,
)
from dqforge.optimizer.observers.parts import (
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
    loop_scale,
)
from dqforge.optimizer.observers.pll import PllGains, corrected, pll_gains, predicted
from dqforge.optimizer.steps.step_arithmetic import (
    EXACT,
    AlphaBeta,
    Arithmetic,
    Member,
    Pair,
    at_least,
    limited,
)

# The boundary layer settles so many times faster than the filter behind it, and the switched
# voltage reaches so many times the largest EMF: twice the flux linkage does not leave the layer.
_FASTER, _RESERVE = 4.0, 2.0


@dataclass(frozen=True, slots=True)
class SmoGains:
    """A switched current model, its filter, what takes their lag back, and a loop.

    The factor c is the polynomials x -> r[0] + r[1] x^2 + r[2] x^4 (real part) and x (m[0] +
    m[1] x^2 + m[2] x^4) (imaginary part) of x = omega t_s.
    """

    x_max: Annotated[float, Member("largest omega t_s", "rad")]
    volt: Annotated[float, Member("t_s / L_d", "A/V")]
    drop: Annotated[float, Member("R t_s / L_d")]
    saliency: Annotated[float, Member("(L_q - L_d) / L_d")]
    keep: Annotated[float, Member("exp(-R t_s / L_d)")]
    switched: Annotated[float, Member("largest switched voltage", "V")]
    layer: Annotated[float, Member("boundary layer", "A")]
    rho: Annotated[float, Member("pole of the filter")]
    share: Annotated[float, Member("of the switched voltage in the filter")]
    lag_r: Annotated[Triple, Member("what takes the lag back, real part")]
    lag_m: Annotated[Triple, Member("... and imaginary part")]
    slope: Annotated[float, Member("current error over EMF, at rest", "A/V")]
    late: Annotated[float, Member("lag of the switched voltage over omega t_s")]
    psi_pm: Annotated[float, Member("magnet flux linkage", "Wb")]
    floor: Annotated[float, Member("least EMF that counts in full", "V")]
    pll: PllGains


def lag_factor(q: float, rho: float, x: FloatArray) -> ComplexArray:
    """EMF over what the filter shows in a steady drive.

    Args:
        q, rho: Poles of the boundary layer and of the filter.
        x: omega t_s in rad, not nil, shape (S,).
    """
    half = np.exp(0.5j * x)
    sliding = (half - q / half) / (1.0 - q)
    filtered = (1.0 - rho * np.exp(-1j * x)) / (1.0 - rho)
    return np.asarray(0.5 * x / np.sin(0.5 * x) * sliding * filtered, dtype=np.complex128)


def largest_emf(machine: LinearMachine, omega_max: float) -> float:
    """Largest extended EMF in V up to an electrical speed in rad/s and the current limit, with
    the whole resistive voltage, which is what it is off by for a resistance of nil.
    """
    psi = machine.psi_pm + abs(machine.saliency) * machine.i_max
    return omega_max * psi + machine.r_s * machine.i_max


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> SmoGains:
    """Gains for electrical speeds up to ``omega_max`` rad/s.

    Raises:
        NoSolutionError: The filter or the speed range is too fast for the sampling.
    """
    rho = filter_pole(tuning.bandwidth, t_s)
    volt, keep = t_s / machine.l_d, float(np.exp(-machine.r_s * t_s / machine.l_d))
    q = keep * float(np.exp(-_FASTER * tuning.bandwidth * t_s))
    g, switched = keep - q, _RESERVE * largest_emf(machine, omega_max)
    x = speed_nodes(omega_max * t_s)
    lag_r, lag_m = even_odd(x, lag_factor(q, rho, x))
    return SmoGains(
        x_max=omega_max * t_s,
        volt=volt,
        drop=machine.r_s * volt,
        saliency=machine.saliency / machine.l_d,
        keep=keep,
        switched=switched,
        layer=switched * volt / g,
        rho=rho,
        share=(1.0 - rho) * (1.0 - q) / g,
        lag_r=lag_r,
        lag_m=lag_m,
        slope=volt / (1.0 - q),
        late=0.5 * (1.0 + q) / (1.0 - q),
        psi_pm=machine.psi_pm,
        floor=machine.psi_pm * tuning.omega_floor,
        pll=pll_gains(tuning.pll_bandwidth, tuning.damping, t_s),
    )


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; shapes (N,)."""
    zero = np.zeros_like(theta_e)
    pairs: tuple[Pair, ...] = ((zero, zero),) * 3
    return ObserverState(pairs, theta_e, omega_e, started=False)


def turned_by(_: Arithmetic, real: Reals | float, imaginary: Reals, y: Pair) -> AlphaBeta:
    """The vector y times real + j imaginary."""
    return AlphaBeta(real * y[0] - imaginary * y[1], real * y[1] + imaginary * y[0])


def late_by(o: Arithmetic, real: Reals, imaginary: Reals, y: Pair) -> AlphaBeta:
    """The vector y over real + j imaginary."""
    part = o.let("part", 1.0 / (real * real + imaginary * imaginary))
    return AlphaBeta(
        part * (real * y[0] + imaginary * y[1]), part * (real * y[1] - imaginary * y[0])
    )


def mean_emf(
    o: Arithmetic, volt: float, drop: float, y: Reals, x: Reals, v: Pair, last: Pair, i: Pair
) -> AlphaBeta:
    """Mean EMF of a period in V times t_s / L_d in A/V; y = omega t_s (L_q - L_d) / L_d."""
    mean = o.let("mean", AlphaBeta(0.5 * (last[0] + i[0]), 0.5 * (last[1] + i[1])))
    change = o.let("change", AlphaBeta(i[0] - last[0], i[1] - last[1]))
    lost = o.let("lost", o.call(turned_by, drop, y, mean))
    first = o.let(
        "first",
        AlphaBeta(
            volt * v[0] - lost.alpha - change.alpha,
            volt * v[1] - lost.beta - change.beta,
        ),
    )
    bent = o.let("bent", o.call(turned_by, drop, y, change))
    ends = o.let("ends", AlphaBeta(bent.alpha - x * first.beta, bent.beta + x * first.alpha))
    end = o.let("end", o.call(turned_by, drop, y, ends))
    return AlphaBeta(first.alpha - 0.083333336 * end.alpha, first.beta - 0.083333336 * end.beta)


def switched_voltage(o: Arithmetic, most: float, layer: float, gap: Pair) -> AlphaBeta:
    """Voltage in V that drives a current error in A back, in proportion within the layer."""
    size = o.let("size", o.root(gap[0] * gap[0] + gap[1] * gap[1]))
    scale = o.let("scale", most / at_least(o, size, layer))
    return AlphaBeta(scale * gap[0], scale * gap[1])


def _first_step(
    gains: SmoGains, state: ObserverState, i: Pair, x: Reals, o: Arithmetic
) -> ObserverState:
    """What a steady drive without load would have left at the given angle and speed."""
    turn = o.let("turn", o.rotation(state.theta_e))
    size = o.let("size", state.omega_e * gains.psi_pm, "of the EMF, V")
    emf = o.let("emf", AlphaBeta(-(size * turn[1]), size * turn[0]))
    one = o.let("one", AlphaBeta(o.full(1.0, x), o.full(0.0, x)))
    lag = o.let("lag", o.call(emf_part, gains.lag_r, gains.lag_m, x, one))
    filtered = o.let("filtered", o.call(late_by, lag.alpha, lag.beta, emf))
    ahead = o.let("ahead", o.call(late_by, one.alpha, o.let("late", gains.late * x), emf))
    gap = o.let("gap", AlphaBeta(gains.slope * ahead.alpha, gains.slope * ahead.beta))
    z = o.let("z", o.call(switched_voltage, gains.switched, gains.layer, gap))
    return ObserverState((_rest(gains, gap, z), filtered, i), state.theta_e, state.omega_e)


def _rest(gains: SmoGains, gap: Pair, z: Pair) -> AlphaBeta:
    """What the next sample finds of the current error without an EMF in between."""
    return AlphaBeta(
        gains.keep * gap[0] - gains.volt * z[0], gains.keep * gap[1] - gains.volt * z[1]
    )


def step(
    gains: SmoGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are what is left of the current error in A, e_f in V and the last
    current in A.
    """
    o = maths
    advance = o.let("advance", gains.pll.t_s * state.omega_e, "angle of the period, rad")
    x = o.let("x", limited(o, advance, gains.x_max))
    if not state.started:
        return _first_step(gains, state, i, x, o)
    rest, before, last = state.vectors
    y = o.let("y", gains.saliency * x)
    u = o.let("u", o.call(mean_emf, gains.volt, gains.drop, y, x, v, last, i))
    gap = o.let("gap", AlphaBeta(rest[0] + u.alpha, rest[1] + u.beta), "modelled minus measured, A")
    z = o.let(
        "z", o.call(switched_voltage, gains.switched, gains.layer, gap), "switched voltage, V"
    )
    filtered = o.let(
        "filtered",
        AlphaBeta(
            gains.rho * before[0] + gains.share * z.alpha,
            gains.rho * before[1] + gains.share * z.beta,
        ),
    )
    e = o.let("e", o.call(emf_part, gains.lag_r, gains.lag_m, x, filtered))
    theta = o.let("theta", predicted(state.theta_e, advance, o), "foretold angle, rad")
    error = emf_angle_error(o, e, theta, state.omega_e, gains.floor)
    return ObserverState(
        (_rest(gains, gap, z), filtered, i),
        *corrected(gains.pll, theta, state.omega_e, error, o),
    )


METHOD = ObserverMethod(
    name="smo",
    code="smo",
    title="sliding-mode observer",
    design=design,
    start=start,
    step=step,
    usual=usual_eemf,
    searched=("pll_bandwidth", "bandwidth"),
    gains=SmoGains,
    scale=loop_scale,
    members=StateMembers(
        (
            ("rest", Member("what is left of the current error", "A")),
            ("filtered", Member("filtered switched voltage", "V")),
            ("i", Member("last current", "A")),
        )
    ),
)
