"""INFORM as the firmware runs it: written once, in the order of operations of the emitted C
(``observers/inform.j2``).

A sequence is six periods: a voltage along 0, 120 and 240 degrees, each with its opposite, so that
back-EMF and resistance fall out of the difference. The sum of the differences along gamma_k, turned
by 2 gamma_k, is z = 3/2 V t_s Y_delta exp(2 j (theta + chi)). Between sequences the control has the
converter to itself. A sequence with a sample that is no number corrects nothing.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair, limited
from dqforge.optimizer.saliency.wave_steps import at_load, known_sample

LAST = 7  # Place in a sequence at which the answer to its last pulse is seen.
MIDDLE = 3.0  # Samples from the middle of the pulses to that place.
DIRECTIONS = ((1.0, 0.0), (-0.5, 0.8660254), (-0.5, -0.8660254))  # Cosine and sine of gamma_k.
_LARGEST = 0.5


@dataclass(frozen=True, slots=True)
class InformGains:
    """What the firmware needs.

    ``t_s`` in s; ``k_p`` and ``k_i`` (1/s) of the phase-locked loop per sequence; ``omega_max`` in
    rad/s; ``voltage`` in V; ``period`` in samples from one sequence to the next. ``scale`` in rad/A
    and ``shift`` in rad stand over |i_q| in steps of 1/``per_ampere``.
    """

    t_s: float
    k_p: float
    k_i: float
    omega_max: float
    voltage: float
    period: float
    per_ampere: float
    scale: tuple[float, ...]
    shift: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class InformState(ObserverState):
    """``vectors``: the last current and z; ``scalars``: the answer to the last pulse in A, whether
    all samples of the sequence were numbers, and z of the sequence before (alpha, beta). ``n`` is
    the place in the period.
    """

    n: int = 0


def inform_start(gains: InformGains, theta_e: Reals, omega_e: Reals) -> InformState:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    del gains
    zero = np.zeros_like(theta_e)
    pair = (zero, zero)
    return InformState(
        (pair, pair), theta_e, omega_e, started=False, scalars=(zero, zero), added=pair, seen=pair
    )


def inform_step(
    gains: InformGains,
    state: InformState,
    v: Pair,
    i: Pair,
    heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> InformState:
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, the voltage is not used."""
    del v, heard
    n, zero, one = state.n, maths.number(0.0), maths.number(1.0)
    known, sample = known_sample(i, state.vectors[0], maths)
    (half, whole), z = state.scalars, state.vectors[1]
    assert state.seen is not None
    theta, omega, told = state.theta_e, state.omega_e, sample
    if state.started:
        theta = maths.wrap(theta + gains.t_s * omega)
    if n == 0:
        whole, z = np.zeros_like(half) + one, (np.zeros_like(half), np.zeros_like(half))
    whole = np.where(known, whole, zero)
    if 2 <= n <= LAST:
        cosine, sine = (maths.number(part) for part in DIRECTIONS[(n - 2) // 2])
        moved = (sample[0] - state.vectors[0][0], sample[1] - state.vectors[0][1])
        along = cosine * moved[0] + sine * moved[1]
        if n % 2 == 0:
            half, told = along, state.seen
        else:
            pair = maths.number(0.5) * (half - along)
            z = (z[0] + cosine * pair, z[1] - sine * pair)
    if n == LAST:
        error = _error(gains, (z, told), theta, omega, maths)
        error = np.where(whole > zero, error, zero)
        omega = limited(maths, omega + gains.k_i * error, gains.omega_max)
        theta = maths.wrap(theta + gains.k_p * error)
    return InformState(
        (sample, z),
        theta,
        omega,
        scalars=(half, whole),
        added=_pulse(gains, n, theta, maths),
        seen=told,
        n=(n + 1) % int(gains.period),
    )


def _error(
    gains: InformGains, found: tuple[Pair, Pair], theta: Reals, omega: Reals, maths: Arithmetic
) -> Reals:
    """Angle error in rad of z and the current in A."""
    z, told = found
    i_q = park(maths, told, maths.rotation(theta))[1]
    cosine, sine = maths.rotation(maths.wrap(theta - (maths.number(MIDDLE) * gains.t_s) * omega))
    twice = (cosine * cosine - sine * sine, maths.number(2.0) * (cosine * sine))
    scale, shift = at_load(gains, i_q, maths)
    error = scale * (twice[0] * z[1] - twice[1] * z[0]) - shift
    return limited(maths, error, maths.number(_LARGEST))


def _pulse(gains: InformGains, n: int, theta: Reals, maths: Arithmetic) -> Pair:
    """The voltage that is to be added from the next sampling instant on."""
    zero = np.zeros_like(theta)
    if n > 5:
        return zero, zero
    cosine, sine = DIRECTIONS[n // 2]
    size = gains.voltage if n % 2 == 0 else -gains.voltage
    return zero + maths.number(cosine) * size, zero + maths.number(sine) * size
