"""The third-harmonic tracker as the firmware runs it: written once, in the order of operations of
the C, `observer_third_harmonic.j2`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.harmonic_trackers.third_harmonic import ThirdHarmonic
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair, limited


@dataclass(frozen=True, slots=True)
class ThirdHarmonicGains:
    """`dqforge.optimizer.harmonic_trackers.third_harmonic.ThirdHarmonic`; ``detector`` = -2/(3
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
    cosine, sine = maths.rotation(maths.wrap(3.0 * ahead - gains.phase))
    model = gains.amplitude * cosine
    flux = state.flux + gains.t_s * (u - state.offset)
    flux = np.where(np.abs(u) < 1e6, flux, model)  # no number: as foretold
    rest = flux - model
    error = (gains.detector * rest) * sine
    return ThirdHarmonicState(
        (),
        maths.wrap(ahead + gains.k_p * error),
        limited(maths, state.omega_e + gains.k_i * error, gains.omega_max),
        flux=flux - gains.k * rest,
        offset=state.offset + gains.k_b * rest,
    )
