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

References:
    Z. Chen, M. Tomita, S. Doki, S. Okuma, "An extended electromotive force model for sensorless
    control of interior permanent-magnet synchronous motors", IEEE Trans. Industrial Electronics 50
    (2), 2003 (model); paper 001, 7.2.1.1.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.parts import (
    ObserverMethod,
    ObserverState,
    ObserverTuning,
    StateMembers,
    loop_scale,
)
from dqforge.optimizer.observers.pll import PllGains, corrected, pll_bandwidth, pll_gains, predicted
from dqforge.optimizer.steps.step_arithmetic import (
    EXACT,
    AlphaBeta,
    Arithmetic,
    Dq,
    Member,
    Pair,
    at_least,
    limited,
)

ComplexArray = NDArray[np.complex128]


Triple = tuple[float, float, float]


_NODES = 40


@dataclass(frozen=True, slots=True)
class EemfGains:
    """An EMF from three factors over the speed, its filter, and a loop.

    The factors of i[k] (``now``), of i[k-1] (``last``) and of v (``volt``), with 1 - rho in them,
    are the polynomials x -> r[0] + r[1] x^2 + r[2] x^4 (real part) and x (m[0] + m[1] x^2 +
    m[2] x^4) (imaginary part) of x = omega t_s.
    """

    rho: Annotated[float, Member("pole of the EMF filter")]
    x_max: Annotated[float, Member("largest omega t_s", "rad")]
    now_r: Annotated[Triple, Member("factor of i[k], real part", "Ohm")]
    now_m: Annotated[Triple, Member("... and imaginary part", "Ohm")]
    last_r: Annotated[Triple, Member("factor of i[k-1], real part", "Ohm")]
    last_m: Annotated[Triple, Member("... and imaginary part", "Ohm")]
    volt_r: Annotated[Triple, Member("factor of v, real part")]
    volt_m: Annotated[Triple, Member("... and imaginary part")]
    psi_pm: Annotated[float, Member("magnet flux linkage", "Wb")]
    floor: Annotated[float, Member("least EMF that counts in full", "V")]
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


def even_odd(x: FloatArray, values: ComplexArray) -> tuple[Triple, Triple]:
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


def filter_pole(bandwidth: float, t_s: float) -> float:
    """Pole of a filter of ``bandwidth`` rad/s, sampled every ``t_s`` seconds.

    Raises:
        NoSolutionError: It is too fast for the sampling.
    """
    if bandwidth * t_s > 2.0:
        raise NoSolutionError(
            f"control.observer.bandwidth: {bandwidth:g} rad/s is too fast for t_s = {t_s:g} s; "
            f"write {2.0 / t_s:g} rad/s or less"
        )
    return float(np.exp(-bandwidth * t_s))


def speed_nodes(x_max: float) -> FloatArray:
    """Turns per period in rad up to ``x_max`` at which factors are fitted, ascending, not nil."""
    return np.asarray(x_max * np.sin(0.5 * np.pi * (np.arange(_NODES) + 0.5) / _NODES))


def design(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> EemfGains:
    """Gains for electrical speeds up to ``omega_max`` rad/s.

    Raises:
        NoSolutionError: The filter or the speed range is too fast for the sampling.
    """
    rho = filter_pole(tuning.bandwidth, t_s)
    x_max = omega_max * t_s
    x = speed_nodes(x_max)
    (now_r, now_m), (last_r, last_m), (volt_r, volt_m) = (
        even_odd(x, values) for values in exact_factors(machine, rho, t_s, x / t_s)
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


def emf_part(o: Arithmetic, r: Triple, m: Triple, x: Reals, y: Pair) -> AlphaBeta:
    """The vector y times r[0] + r[1] x^2 + r[2] x^4 + j x (m[0] + m[1] x^2 + m[2] x^4)."""
    square = o.let("square", x * x)
    real = o.let("real", (r[2] * square + r[1]) * square + r[0])
    imaginary = o.let("imaginary", ((m[2] * square + m[1]) * square + m[0]) * x)
    return AlphaBeta(real * y[0] - imaginary * y[1], real * y[1] + imaginary * y[0])


def emf_angle_error(o: Arithmetic, e: AlphaBeta, theta: Reals, omega: Reals, floor: Any) -> Reals:
    """Sine of the angle from ``theta`` in rad to the d axis that an EMF in V shows."""
    along = o.park(e, o.rotation(theta)).d
    size = o.let("size", o.root(e.alpha * e.alpha + e.beta * e.beta), "of the EMF, V")
    across = o.let("across", -along / at_least(o, size, floor))
    return o.let(
        "error",
        o.choose(omega < 0.0, -across, across),
        "rad; the EMF turns its sign with the speed",
    )


def step(
    gains: EemfGains, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic = EXACT
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).

    The vectors of the state are e_hat in V and the last current in A. At the first step e_hat is
    that of the given angle and speed at no load.
    """
    o = maths
    if not state.started:
        turn = o.let("turn", o.rotation(state.theta_e))
        size = o.let("size", state.omega_e * gains.psi_pm, "of the EMF, V")
        e = AlphaBeta(-(size * turn[1]), size * turn[0])
        return ObserverState((e, i), state.theta_e, state.omega_e)
    before, last = state.vectors
    advance = o.let("advance", gains.pll.t_s * state.omega_e, "angle of the period, rad")
    x = o.let("x", limited(o, advance, gains.x_max))
    turned = o.let("turned", o.park_inverse(o.let("before", Dq(*before)), o.rotation(x)))
    now = o.let("now", o.call(emf_part, gains.now_r, gains.now_m, x, i))
    past = o.let("past", o.call(emf_part, gains.last_r, gains.last_m, x, last))
    volt = o.let("volt", o.call(emf_part, gains.volt_r, gains.volt_m, x, v))
    e = o.let(
        "e",
        AlphaBeta(
            gains.rho * turned.alpha + (now.alpha + (past.alpha + volt.alpha)),
            gains.rho * turned.beta + (now.beta + (past.beta + volt.beta)),
        ),
    )
    theta = o.let("theta", predicted(state.theta_e, advance, o), "foretold angle, rad")
    error = emf_angle_error(o, e, theta, state.omega_e, gains.floor)
    return ObserverState((e, i), *corrected(gains.pll, theta, state.omega_e, error, o))


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
    members=StateMembers(
        (
            ("e", Member("extended EMF", "V")),
            ("i", Member("last current", "A")),
        )
    ),
)
