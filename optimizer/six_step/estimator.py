"""Position from the phase that floats: zero crossing and integral of the back-EMF, in the order
of operations of the emitted C (paper 001, 7.2.1, methods 2 and 3).

Once per period it is told the voltages of the three terminals, sampled in the middle of the
on-time. Times count in periods, between samples by a line. After a commutation the voltage is
left unseen while the phase that was switched off frees its current. A crossing that was missed
there, or while the drive accelerates, counts at the first sample that shows its sign.

The steps run on scalars of any floating type: double precision for analysis, single precision as
the model of the C.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.six_step.sectors import FLOATING, rising

_LARGEST = 1e6  # V
Real = Any  # A scalar of the floating type that the steps run in.


@dataclass(frozen=True, slots=True)
class BlockGains:
    """Numbers of the estimator.

    Args:
        t_s: Period in s.
        by_integral: 1: commutation by the integral of the voltage, 0: by the delay behind the
            crossing.
        delay: From crossing to commutation over 60 degrees, forwards and backwards.
        threshold: Integral at which it commutates in V s, forwards and backwards.
        latency: Periods from a sample to the instant at which what follows from it acts, that by
            which the filter is late included.
        blank_share, blank_least: How long the voltage is left unseen after a commutation: over the
            time of 60 degrees, and in periods.
        smooth: Share of a new sample in the filter of the voltage; 1 without a filter.
        patience: Times of 60 degrees without a crossing after which the position is lost.
        crossings: Electrical angles of the crossings in rad, of the sectors 0 to 5 turning
            forwards.
    """

    t_s: float
    by_integral: int
    delay: tuple[float, float]
    threshold: tuple[float, float]
    latency: float
    blank_share: float
    blank_least: float
    smooth: float
    patience: float
    crossings: tuple[float, ...]


@dataclass(slots=True)
class BlockState:
    """What the estimator holds.

    ``sector`` (0 to 5), ``direction`` (1 or -1), ``crossed``, ``armed`` and ``lost`` are whole
    numbers; ``since`` the commutation, ``elapsed`` since the crossing, the last ``interval`` and
    the ``mean`` of two count in periods; ``last`` is the voltage in V, ``area`` its integral in
    V s, ``theta_z`` the angle of the last crossing, ``theta_e`` and ``omega_e`` the estimates.
    """

    sector: int
    direction: int
    crossed: int
    armed: int
    lost: int
    since: Real
    elapsed: Real
    interval: Real
    mean: Real
    last: Real
    area: Real
    theta_z: Real
    theta_e: Real
    omega_e: Real


def wrapped_once(theta: Real, real: type) -> Real:
    """An angle within three turns of zero brought into -pi to pi, as `wrapped_once` of the C.

    Args:
        theta: In rad.
        real: Floating type.
    """
    turn, half = real(6.283185307179586), real(3.141592653589793)
    if theta >= half:
        theta = theta - turn
    if theta < -half:
        theta = theta + turn
    return theta


def crossing_angle(gains: BlockGains, sector: int, direction: int, real: type) -> Real:
    """Electrical angle in rad of the crossing in a sector.

    Args:
        gains: Of the estimator.
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards: then it is that of the opposite sector.
        real: Floating type.
    """
    return real(gains.crossings[sector if direction > 0 else (sector + 3) % 6])


def start(
    gains: BlockGains, sector: int, direction: int, omega_e: Real, beyond: Real, real: type
) -> BlockState:
    """The state of a drive that turns.

    Args:
        gains: Of the estimator.
        sector: The one that is fed from now on, 0 to 5.
        direction: 1 forwards, -1 backwards.
        omega_e: Magnitude of the electrical speed in rad/s, above 0.
        beyond: Electrical angle in rad by which the rotor is beyond the crossing of the sector, in
            the sense of its rotation; negative before it.
        real: Floating type.
    """
    x = omega_e * real(gains.t_s)
    mean = real(1.0471975511965976) / x
    elapsed = beyond / x
    crossed = 1 if beyond >= real(0.0) else 0
    share = elapsed / (real(gains.delay[0 if direction > 0 else 1]) * mean)
    area = real(gains.threshold[0 if direction > 0 else 1]) * (share * share)
    before = (sector + (5 if direction > 0 else 1)) % 6
    if crossed == 0:
        elapsed = elapsed + mean
        area = real(0.0)
    theta_z = crossing_angle(gains, sector if crossed else before, direction, real)
    angle = x * elapsed
    theta = wrapped_once(theta_z + (angle if direction > 0 else -angle), real)
    return BlockState(
        sector=sector,
        direction=direction,
        crossed=crossed,
        armed=0,
        lost=0,
        since=real(0.0),
        elapsed=elapsed,
        interval=mean,
        mean=mean,
        last=real(0.0),
        area=area,
        theta_z=theta_z,
        theta_e=theta,
        omega_e=omega_e if direction > 0 else -omega_e,
    )


def _see(gains: BlockGains, state: BlockState, y: Real, real: type) -> None:
    """A voltage behind the blanked time, rising through zero."""
    one, half = real(1.0), real(0.5)
    if state.crossed != 0:
        state.area = state.area + (half * (state.last + y)) * real(gains.t_s)
    elif y >= real(0.0):
        part = y / (y - state.last) if state.armed != 0 else real(0.0)
        found = state.elapsed - part
        low, high = half * state.mean, real(2.0) * state.mean
        found = low if found < low else found
        found = high if found > high else found
        state.mean = half * (state.interval + found)
        state.mean = one if state.mean < one else state.mean
        state.interval = found
        state.elapsed = part
        state.area = (half * y) * (part * real(gains.t_s))
        state.theta_z = crossing_angle(gains, state.sector, state.direction, real)
        state.crossed = 1
    else:
        state.armed = 1


def _due(gains: BlockGains, state: BlockState, real: type) -> bool:
    """Whether the current is to be handed on at the next instant at which a step acts."""
    way = 0 if state.direction > 0 else 1
    half = real(0.5)
    ahead = state.elapsed + real(gains.latency)
    if state.crossed == 0:
        return False
    if gains.by_integral == 0:
        return bool((real(gains.delay[way]) * state.mean) - ahead < half)
    reached = state.area + (state.last * real(gains.t_s)) * (real(gains.latency) + half)
    return bool(reached >= real(gains.threshold[way]) or ahead > state.mean)


def step(gains: BlockGains, state: BlockState, v: Sequence[Real], real: type) -> None:
    """One period, in place.

    Args:
        gains: Of the estimator.
        state: Before and after.
        v: Voltages of the terminals a, b, c in V against any potential.
        real: Floating type.
    """
    one = real(1.0)
    u = v[FLOATING[state.sector]] - real(0.33333334) * ((v[0] + v[1]) + v[2])
    y = u if rising(state.sector, state.direction) > 0 else -u
    state.since = state.since + one
    state.elapsed = state.elapsed + one
    blank = real(gains.blank_share) * state.mean
    blank = real(gains.blank_least) if blank < real(gains.blank_least) else blank
    if y < real(_LARGEST) and y > real(-_LARGEST):  # what is no number is not seen
        if state.since > blank:
            if state.since - blank > one:
                y = state.last + real(gains.smooth) * (y - state.last)
            _see(gains, state, y, real)
        state.last = y
    if state.elapsed > real(gains.patience) * state.mean:
        state.lost = 1
    held = state.elapsed if state.elapsed > state.mean else state.mean
    turn = real(1.0471975511965976) / held
    omega = turn / real(gains.t_s)
    angle = turn * (state.elapsed + real(gains.latency))
    angle = angle if angle < real(1.5707963267948966) else real(1.5707963267948966)
    state.omega_e = omega if state.direction > 0 else -omega
    state.theta_e = wrapped_once(state.theta_z + (angle if state.direction > 0 else -angle), real)
    if _due(gains, state, real):
        state.sector = (state.sector + (1 if state.direction > 0 else 5)) % 6
        state.since = real(0.0)
        state.crossed = 0
        state.armed = 0


def seen_angle(v: Sequence[Real], direction: int, real: type) -> tuple[int, Real, Real]:
    """Sector, angle beyond its crossing in rad and largest voltage between two terminals in V of a
    drive whose legs all rest.

    The sector is the one in which the line with the largest back-EMF is fed. Within 30 degrees
    tan x = sqrt(3) y/(largest), and x = tan x to 10 %.

    Args:
        v: Voltages of the terminals in V.
        direction: 1 forwards, -1 backwards.
        real: Floating type.
    """
    high = 0 if (v[0] >= v[1] and v[0] >= v[2]) else (1 if v[1] >= v[2] else 2)
    low = 0 if (v[0] < v[1] and v[0] < v[2]) else (1 if v[1] < v[2] else 2)
    if high == low:
        low = (high + 1) % 3
    sector = 2 * high + (0 if (high + 1) % 3 == low else 1)
    largest = v[high] - v[low]
    u = v[3 - high - low] - real(0.33333334) * ((v[0] + v[1]) + v[2])
    y = u if rising(sector, direction) > 0 else -u
    if not largest > real(0.0):
        return sector, real(0.0), real(0.0)
    return sector, real(1.7320508) * (y / largest), largest


REALS = (np.float32, np.float64)  # Floating types of the steps: of the emitted C, and of analysis.
