"""Saliency and third-harmonic trackers as the firmware runs them: written once,
in the order of operations of the C.

As `dqforge.optimizer.observers.sampled_gains`, for `observer_injection.j2` and
`observer_third_harmonic.j2`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.transforms import Reals, park, park_inverse
from dqforge.optimizer.observers.methods.injection import Injection
from dqforge.optimizer.observers.methods.third_harmonic import ThirdHarmonic
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair
from dqforge.optimizer.observers.sampled_gains import limited


@dataclass(frozen=True, slots=True)
class InjectionGains:
    """`dqforge.optimizer.observers.methods.injection.Injection`; ``scale`` in rad/A,
    ``carrier`` in V.
    """

    t_s: float
    scale: float
    k_p: float
    k_i: float
    omega_max: float
    carrier: tuple[float, ...]
    reference: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class InjectionState(ObserverState):
    """In ``vectors`` the voltage in V to be injected.

    Besides, demodulated currents in A and the place ``n``.
    """

    products: tuple[Reals, ...] = ()
    n: int = 0


def injection_gains(tracker: Injection) -> InjectionGains:
    """What the firmware needs of a tracker."""
    return InjectionGains(
        tracker.t_s,
        1.0 / (tracker.samples * tracker.gain),
        tracker.k_p,
        tracker.k_i,
        tracker.omega_max,
        tuple(float(tracker.voltage * value) for value in tracker.carrier),
        tuple(float(value) for value in tracker.reference),
    )


def injection_start(theta_e: Reals, omega_e: Reals) -> InjectionState:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    zero = np.zeros_like(theta_e)
    return InjectionState(((zero, zero),), theta_e, omega_e, started=False)


def injection_step(
    gains: InjectionGains, state: InjectionState, v: Pair, i: Pair, maths: Arithmetic
) -> InjectionState:
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, ``v`` is not used."""
    del v
    count, theta, omega = len(gains.carrier), state.theta_e, state.omega_e
    products = list(state.products) or [np.zeros_like(theta)] * count
    if state.started:
        ahead = maths.wrap(theta + gains.t_s * omega)
        products[state.n] = park(maths, i, maths.rotation(ahead))[1] * gains.reference[state.n]
        total = np.zeros_like(theta)
        for product in products:
            total = total + product
        error = gains.scale * total
        omega = limited(omega + gains.k_i * error, gains.omega_max)
        theta = maths.wrap(ahead + gains.k_p * error)
    turn = maths.rotation(maths.wrap(theta + (1.5 * gains.t_s) * omega))
    zero = np.zeros_like(theta)
    asked = park_inverse(maths, (zero + gains.carrier[state.n], zero), turn)
    return InjectionState((asked,), theta, omega, products=tuple(products), n=(state.n + 1) % count)


@dataclass(frozen=True, slots=True)
class ThirdHarmonicGains:
    """`dqforge.optimizer.observers.methods.third_harmonic.ThirdHarmonic`; ``detector`` = -2/(3
    amplitude) in rad/(V s).
    """

    t_s: float
    amplitude: float
    phase: float
    k: float
    k_b: float
    k_p: float
    k_i: float
    detector: float
    omega_max: float


@dataclass(frozen=True, slots=True, eq=False)
class ThirdHarmonicState(ObserverState):
    """Besides angle and speed: the integral of the sum voltage in V s and its offset in V."""

    flux: Reals | None = None
    offset: Reals | None = None


def third_harmonic_gains(tracker: ThirdHarmonic) -> ThirdHarmonicGains:
    """What the firmware needs of a tracker; the phase is brought to -pi to pi."""
    return ThirdHarmonicGains(
        tracker.t_s,
        tracker.amplitude,
        float((tracker.phase + np.pi) % (2.0 * np.pi) - np.pi),
        tracker.k,
        tracker.k_b,
        tracker.k_p,
        tracker.k_i,
        -2.0 / (3.0 * tracker.amplitude),
        tracker.omega_max,
    )


def third_harmonic_start(theta_e: Reals, omega_e: Reals) -> ThirdHarmonicState:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    zero = np.zeros_like(theta_e)
    return ThirdHarmonicState((), theta_e, omega_e, started=False, flux=zero, offset=zero)


def third_harmonic_step(
    gains: ThirdHarmonicGains,
    state: ThirdHarmonicState,
    v: Pair,
    i: Pair,
    maths: Arithmetic,
    u: Reals,
) -> ThirdHarmonicState:
    """Next state; ``u`` in V is the mean sum voltage of the period that ends now,
    ``v`` and ``i`` are not used.
    """
    del v, i
    if not state.started:
        first = maths.rotation(maths.wrap(3.0 * state.theta_e - gains.phase))[0]
        return replace(state, flux=gains.amplitude * first, started=True)
    assert state.flux is not None
    assert state.offset is not None
    ahead = maths.wrap(state.theta_e + gains.t_s * state.omega_e)
    flux = state.flux + gains.t_s * (u - state.offset)
    cosine, sine = maths.rotation(maths.wrap(3.0 * ahead - gains.phase))
    rest = flux - gains.amplitude * cosine
    error = (gains.detector * rest) * sine
    return ThirdHarmonicState(
        (),
        maths.wrap(ahead + gains.k_p * error),
        limited(state.omega_e + gains.k_i * error, gains.omega_max),
        flux=flux - gains.k * rest,
        offset=state.offset + gains.k_b * rest,
    )
