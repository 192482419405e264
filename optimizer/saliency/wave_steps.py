"""A tracker of the saliency by an injected wave as the firmware runs it: written once, in the order
of operations of the emitted C (``observers/injection.j2``).

Square wave (two samples): the second difference of the current in stator axes, across the direction
in which the voltage acted, less what the rest of the voltage makes of it; sine along the assumed d
axis: the current across it, demodulated; rotating voltage: the negative sequence of the current.
Each gives sin 2 (eps + chi) of the angle error eps, chi being where the flux map has the axis of
the saliency at the present load; scale and shift of the gains make the error in rad of it. A sample
that is not a number corrects nothing.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals, park
from dqforge.optimizer.observers.parts import Arithmetic, ObserverState, Pair, limited

POINTS = 9  # Of the tables over the load.
_UNKNOWN = 1.0e15
_LARGEST = 0.5  # Largest error in rad that a sample may claim.
_FILLED = 3.0


class LoadTables(Protocol):
    """Gains with tables over the load."""

    @property
    def per_ampere(self) -> float:
        """Points per A of |i_q|."""
        ...

    @property
    def scale(self) -> tuple[float, ...]:
        """Angle error per demodulated current, in rad/A."""
        ...

    @property
    def shift(self) -> tuple[float, ...]:
        """What the load adds to it, in rad."""
        ...


@dataclass(frozen=True, slots=True)
class WaveGains:
    """What the firmware needs.

    ``t_s`` in s; ``k_p`` and ``k_i`` (1/s) of the phase-locked loop; ``omega_max`` in rad/s. The
    fundamental of the current is ``notch[0..2]`` of the last three samples less ``notch[3..4]`` of
    its last two values. ``scale`` (rad per what is demodulated), ``shift`` in rad and ``rest`` in
    A/V (what a voltage across makes of the current in a period) stand over |i_q| in steps of
    1/``per_ampere``. ``carrier`` in V is that of the d axis, or of alpha with
    that of beta besides (then it rotates); ``reference`` demodulates.
    """

    t_s: float
    k_p: float
    k_i: float
    omega_max: float
    notch: tuple[float, float, float, float, float]
    per_ampere: float
    scale: tuple[float, ...]
    shift: tuple[float, ...]
    carrier: tuple[float, ...]
    carrier_beta: tuple[float, ...]
    reference: tuple[float, ...]
    reference_beta: tuple[float, ...]
    rest: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class WaveState(ObserverState):
    """``vectors``: the last two currents, the last two of the fundamental, the last three
    directions (cosine, sine) of the voltage, the voltage that was asked for before the last, and
    the rest of that which acted; ``scalars``: samples known in a row, and demodulated currents.
    ``n`` is the place in the wave.
    """

    n: int = 0


def wave_start(gains: WaveGains, theta_e: Reals, omega_e: Reals) -> WaveState:
    """State before the first step: angle in rad (wrapped), speed in rad/s."""
    zero = np.zeros_like(theta_e)
    pair = (zero, zero)
    products = 0 if len(gains.carrier) == 2 else len(gains.carrier)
    return WaveState(
        (pair,) * 9, theta_e, omega_e, started=False, scalars=(zero,) * (1 + products),
        added=pair, seen=pair,
    )  # fmt: skip


def known_sample(i: Pair, last: Pair, maths: Arithmetic) -> tuple[Reals, Pair]:
    """Whether a sample is a number, and the sample, or the last one in its place."""
    known = (np.abs(i[0]) < maths.number(_UNKNOWN)) & (np.abs(i[1]) < maths.number(_UNKNOWN))
    return known, (np.where(known, i[0], last[0]), np.where(known, i[1], last[1]))


def place_of(gains: LoadTables, i_q: Reals, maths: Arithmetic) -> tuple[Any, Reals]:
    """Where an i_q in A lies in the tables: the point below, and the part of the way to the next
    one.
    """
    place, last = np.abs(i_q) * gains.per_ampere, maths.number(POINTS - 1.001)
    inside = np.where(place < last, place, last)
    index = inside.astype(np.int64)
    return index, inside - index.astype(maths.number)


def between(table: tuple[float, ...], place: tuple[Any, Reals], maths: Arithmetic) -> Reals:
    """A table there, by lines."""
    values, (index, part) = np.array(table, dtype=maths.number), place
    return np.asarray(values[index] + part * (values[index + 1] - values[index]))


def at_load(gains: LoadTables, i_q: Reals, maths: Arithmetic) -> tuple[Reals, Reals]:
    """Scale and shift at an i_q in A."""
    place = place_of(gains, i_q, maths)
    offset = between(gains.shift, place, maths)
    return between(gains.scale, place, maths), np.where(i_q < 0.0, -offset, offset)


def _fundamental(gains: WaveGains, i: Pair, vectors: tuple[Pair, ...]) -> Pair:
    b_0, b_1, b_2, a_1, a_2 = gains.notch
    last, before, told, told_before = vectors[:4]
    x, y = (
        (((b_0 * i[n] + b_1 * last[n]) + b_2 * before[n]) - a_1 * told[n]) - a_2 * told_before[n]
        for n in (0, 1)
    )
    return x, y


def _second_difference(
    gains: WaveGains, state: WaveState, seen: tuple[Pair, Pair, Pair], maths: Arithmetic
) -> Reals:
    """Of the current, across the sum of the directions of the voltages that acted, less what the
    rest of the voltage has made of it.
    """
    i, rest, told = seen
    x = gains.t_s * state.omega_e
    twice = 2.0 - x * x
    last, before = state.vectors[:2]
    bent = tuple((i[n] - twice * last[n]) + before[n] for n in (0, 1))
    moved = tuple(rest[n] - state.vectors[8][n] for n in (0, 1))
    cosine, sine = (state.vectors[5][n] + state.vectors[6][n] for n in (0, 1))
    ahead = maths.rotation(maths.wrap(state.theta_e + gains.t_s * state.omega_e))
    share = between(gains.rest, place_of(gains, park(maths, told, ahead)[1], maths), maths)
    own = (cosine * bent[1] - sine * bent[0]) - share * (cosine * moved[1] - sine * moved[0])
    return np.asarray(own * gains.reference[state.n])


def _product(gains: WaveGains, n: int, i: Pair, turn: Pair) -> Reals:
    """What a sample adds to the demodulated current."""
    if not gains.carrier_beta:
        return np.asarray((turn[0] * i[1] - turn[1] * i[0]) * gains.reference[n])
    c, s = gains.reference[n], gains.reference_beta[n]
    alpha, beta = c * i[0] - s * i[1], s * i[0] + c * i[1]
    cosine, sine = turn[0] * turn[0] - turn[1] * turn[1], 2.0 * (turn[0] * turn[1])
    return np.asarray(cosine * beta - sine * alpha)


def wave_step(
    gains: WaveGains, state: WaveState, v: Pair, i: Pair, heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> WaveState:  # fmt: skip
    """Next state; ``i`` in A (alpha, beta) at the sampling instant, ``v`` in V acted until then."""
    del heard
    theta, omega, count = state.theta_e, state.omega_e, len(gains.carrier)
    known, sample = known_sample(i, state.vectors[0], maths)
    assert state.added is not None
    acted = known_sample(v, state.vectors[7], maths)[1]
    rest = (acted[0] - state.vectors[7][0], acted[1] - state.vectors[7][1])
    vectors, fresh, products = state.vectors, state.scalars[0], list(state.scalars[1:])
    if not state.started:
        vectors, told = (sample,) * 4 + vectors[4:], sample
        fresh = np.zeros_like(fresh)
    else:
        ahead = maths.wrap(theta + gains.t_s * omega)
        turn = maths.rotation(ahead)
        told = _fundamental(gains, sample, vectors)
        more = np.where(fresh < maths.number(_FILLED), fresh + maths.number(1.0), fresh)
        fresh = np.where(known, more, maths.number(0.0))
        if count == 2:
            found = _second_difference(gains, state, (sample, rest, told), maths)
            found = np.where(fresh >= maths.number(_FILLED), found, maths.number(0.0))
        else:
            product = _product(gains, state.n, sample, turn)
            products[state.n] = np.where(known, product, maths.number(0.0))
            found = np.zeros_like(theta)
            for each in products:
                found = found + each
        scale, shift = at_load(gains, park(maths, told, turn)[1], maths)
        error = limited(maths, scale * found - shift, maths.number(_LARGEST))
        if count == 2:
            error = np.where(fresh >= maths.number(_FILLED), error, maths.number(0.0))
        omega = limited(maths, omega + gains.k_i * error, gains.omega_max)
        theta = maths.wrap(ahead + gains.k_p * error)
    direction = maths.rotation(maths.wrap(theta + (1.5 * gains.t_s) * omega))
    return WaveState(
        (
            *(sample, vectors[0], told, vectors[2]),
            *(direction, vectors[4], vectors[5], state.added, rest),
        ),
        theta,
        omega,
        scalars=(fresh, *products),
        added=_asked(gains, state.n, direction),
        seen=told,
        n=(state.n + 1) % count,
    )


def _asked(gains: WaveGains, n: int, direction: Pair) -> Pair:
    """The voltage that is to be added from the next sampling instant on."""
    if gains.carrier_beta:
        zero = np.zeros_like(direction[0])
        return zero + gains.carrier[n], zero + gains.carrier_beta[n]
    return direction[0] * gains.carrier[n], direction[1] * gains.carrier[n]
