"""Extended-EMF observer for machines with or without saliency, with a phase-locked loop.

In stationary coordinates (complex, alpha + j beta) every linear synchronous machine obeys

    v = R i + L_d di/dt + j omega (L_q - L_d) i + e,
    e = j exp(j theta) (omega ((L_d - L_q) i_d + psi_pm) - (L_d - L_q) di_q/dt)

e, the extended EMF, turns with the rotor. For a constant speed and a held voltage the
sampled equation is exact,

    i[k] = phi i[k-1] + gamma v[k] + chi e[k-1],   e[k] = exp(j omega t_s) e[k-1]
    a = -(R + j omega (L_q - L_d)) / L_d,  phi = exp(a t_s),  gamma = (phi - 1)/(a L_d),
    chi = -(exp(j omega t_s) - phi) / (R + j omega L_q)

Observer of reduced order: the EMF that explains the period, smoothed by a filter that turns
with the estimated speed,

    e_hat[k] = exp(j omega t_s) (rho e_hat[k-1] + (1 - rho) (i[k] - phi i[k-1] - gamma v[k]) / chi),
    rho = exp(-bandwidth t_s)

Its error obeys |e~[k]| = rho |e~[k-1]| at every speed. The three factors of i[k], i[k-1] and v[k]
are functions of omega with an even real and an odd imaginary part; the firmware evaluates
polynomials of degree 4 and 5 in omega t_s.

References
----------
Z. Chen, M. Tomita, S. Doki, S. Okuma, "An extended electromotive force model for sensorless control
of interior permanent-magnet synchronous motors", IEEE Trans. Industrial Electronics 50 (2), 2003
(model); paper 001, 7.2.1.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park, park_inverse
from dqforge.optimizer.observers.method import ObserverMethod, loop_scale
from dqforge.optimizer.observers.parts import EXACT, Arithmetic, ObserverState, Pair, at_least
from dqforge.optimizer.observers.pll import PllGains, corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.observers.tuning_numbers import ObserverTuning

ComplexArray = NDArray[np.complex128]


Triple = tuple[float, float, float]


_NODES = 40


@dataclass(frozen=True, slots=True)
class EemfGains:
    """What the firmware needs.

    ``rho`` is the pole of the filter. The factors of i[k] (``now``), of i[k-1] (``last``) and of v
    (``volt``), with 1 - rho in them, are the polynomials x -> r[0] + r[1] x^2 + r[2] x^4 (real
    part) and x (m[0] + m[1] x^2 + m[2] x^4) (imaginary part) of x = omega t_s, clamped to
    ``x_max``; in Ohm, ``volt`` dimensionless. ``psi_pm`` in Wb starts the observer, ``floor`` in V
    is the least EMF that is normalised in full.
    """

    rho: float
    x_max: float
    now_r: Triple
    now_m: Triple
    last_r: Triple
    last_m: Triple
    volt_r: Triple
    volt_m: Triple
    psi_pm: float
    floor: float
    pll: PllGains


def exact_factors(
    machine: LinearMachine, rho: float, t_s: float, omega: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Factors of i[k], i[k-1] and v[k] at electrical speeds in rad/s, each complex,
    of the shape of ``omega``.
    """
    a = -(machine.r_s + 1j * omega * machine.saliency) / machine.l_d
    turn, phi = np.exp(1j * omega * t_s), np.exp(a * t_s)
    small = np.abs(a * t_s) < 1e-8
    gamma = np.where(
        small, t_s / machine.l_d, (phi - 1.0) / (np.where(small, 1.0, a) * machine.l_d)
    )
    # (exp(j omega t) - phi) / (j omega - a), written with the difference of the exponents,
    # which may vanish
    gap = (machine.r_s + 1j * omega * machine.l_q) / machine.l_d
    near = np.abs(gap * t_s) < 1e-8
    integral = np.where(near, t_s, np.expm1(gap * t_s) / np.where(near, 1.0, gap))
    chi = -phi * integral / machine.l_d
    now = (1.0 - rho) * turn / chi
    return now, -phi * now, -gamma * now


def _even_odd(x: FloatArray, values: ComplexArray) -> tuple[Triple, Triple]:
    """Least-squares polynomials of the real (even) and imaginary (odd) part, shape (nodes,)."""
    powers = np.stack([np.ones_like(x), x**2, x**4], axis=1)
    scale = x[-1] ** np.array([0, 2, 4])
    real = np.linalg.lstsq(powers / scale, values.real, rcond=None)[0] / scale
    odd = np.linalg.lstsq(powers / scale * x[:, None], values.imag, rcond=None)[0] / scale
    return (float(real[0]), float(real[1]), float(real[2])), (
        float(odd[0]),
        float(odd[1]),
        float(odd[2]),
    )


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> EemfGains:
    """Gains for electrical speeds up to ``omega_max`` rad/s.

    Raises
    ------
    NoSolutionError
        The filter or the speed range is too fast for the sampling.
    """
    if tuning.bandwidth * t_s > 2.0:
        raise NoSolutionError(
            f"control.observer.bandwidth: {tuning.bandwidth:g} rad/s is too fast for t_s = {t_s:g} "
            f"s; write {2.0 / t_s:g} rad/s or less"
        )
    rho = float(np.exp(-tuning.bandwidth * t_s))
    x_max = omega_max * t_s
    x = x_max * np.sin(0.5 * np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    (now_r, now_m), (last_r, last_m), (volt_r, volt_m) = (
        _even_odd(x, values) for values in exact_factors(machine, rho, t_s, x / t_s)
    )
    return EemfGains(
        rho=rho,
        x_max=x_max,
        now_r=now_r,
        now_m=now_m,
        last_r=last_r,
        last_m=last_m,
        volt_r=volt_r,
        volt_m=volt_m,
        psi_pm=machine.psi_pm,
        floor=machine.psi_pm * tuning.omega_floor,
        pll=pll_gains(tuning.pll_bandwidth, tuning.damping, t_s),
    )


def factor_error(gains: EemfGains, machine: LinearMachine, count: int = 400) -> float:
    """Largest relative error of the polynomial factors over the speed range,
    found on a dense grid.
    """
    x = np.linspace(-gains.x_max, gains.x_max, count)
    exact = exact_factors(machine, gains.rho, gains.pll.t_s, x / gains.pll.t_s)
    pairs = ((gains.now_r, gains.now_m), (gains.last_r, gains.last_m), (gains.volt_r, gains.volt_m))
    found = [_complex(_polynomial(real, imaginary, x)) for real, imaginary in pairs]
    return max(float(np.max(np.abs(a - b) / np.abs(b))) for a, b in zip(found, exact, strict=True))


def _complex(pair: Pair) -> ComplexArray:
    return np.asarray(pair[0] + 1j * pair[1], dtype=np.complex128)


def _polynomial(real: Triple, imaginary: Triple, x: Reals) -> Pair:
    square = x * x
    return (
        (real[2] * square + real[1]) * square + real[0],
        ((imaginary[2] * square + imaginary[1]) * square + imaginary[0]) * x,
    )


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; shapes (N,)."""
    zero = np.zeros_like(theta_e)
    return ObserverState(((zero, zero), (zero, zero)), theta_e, omega_e, started=False)


def _times(factor: Pair, x: Pair) -> Pair:
    return factor[0] * x[0] - factor[1] * x[1], factor[0] * x[1] + factor[1] * x[0]


def step(
    gains: EemfGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are e_hat in V and the last current in A. At the first step e_hat is
    that of the given angle and speed at no load.
    """
    if not state.started:
        cosine, sine = maths.rotation(state.theta_e)
        size = state.omega_e * gains.psi_pm
        return ObserverState(((-(size * sine), size * cosine), i), state.theta_e, state.omega_e)
    before, last = state.vectors
    advance = gains.pll.t_s * state.omega_e
    x = np.where(
        advance > gains.x_max, gains.x_max, np.where(advance < -gains.x_max, -gains.x_max, advance)
    )
    turned = park_inverse(maths, before, maths.rotation(x))
    parts = (
        _times(_polynomial(gains.now_r, gains.now_m, x), i),
        _times(_polynomial(gains.last_r, gains.last_m, x), last),
        _times(_polynomial(gains.volt_r, gains.volt_m, x), v),
    )
    e = (
        gains.rho * turned[0] + (parts[0][0] + (parts[1][0] + parts[2][0])),
        gains.rho * turned[1] + (parts[0][1] + (parts[1][1] + parts[2][1])),
    )
    theta_p = predicted(state.theta_e, advance, maths)
    along = park(maths, e, maths.rotation(theta_p))[0]
    error = -along / at_least(np.sqrt(e[0] * e[0] + e[1] * e[1]), gains.floor)
    error = np.where(state.omega_e < 0.0, -error, error)
    theta, omega = corrected(gains.pll, theta_p, state.omega_e, error, maths)
    return ObserverState((e, i), theta, omega)


def usual_eemf(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """EMF filter four times faster than the loop, so that it costs the loop little phase."""
    width = pll_bandwidth(t_s)
    return ObserverTuning(4.0 * width, width, omega_floor=0.02 * omega_max)


METHOD = ObserverMethod(
    name="extended-emf",
    code="eemf",
    title="extended EMF with phase-locked loop",
    design=design,
    start=start,
    step=step,
    usual=usual_eemf,
    searched=("pll_bandwidth", "bandwidth"),
    gains=EemfGains,
    scale=loop_scale,
)
