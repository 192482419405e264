"""The six sectors of block commutation: which phase is fed, which returns, which floats.

In sector s the current vector lies at -30 + 60 s electrical degrees. Turning forwards it is fed
while the d axis lies 120 to 60 degrees behind it, turning backwards 60 to 120 degrees ahead of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.phase_machines.phase_machine import (
    ANGLES,
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
    grid,
)
from dqforge.machines.records import dataclass

FED = (0, 0, 1, 1, 2, 2)  # Phase (0, 1, 2 for a, b, c) whose leg switches, by sector.
RETURN = (1, 2, 2, 0, 0, 1)  # Phase that returns the current, by sector.
FLOATING = (2, 1, 0, 2, 1, 0)  # Phase whose leg rests, by sector.
SECTOR = np.pi / 3.0


def middle(sector: int, direction: int) -> float:
    """Electrical angle in rad of the d axis in the middle of a sector, where the back-EMF of the
    phase that floats is zero for waveforms without even harmonics.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return -np.pi / 6.0 + SECTOR * sector - direction * np.pi / 2.0


def kept_fed(sector: int, direction: int) -> bool:
    """Whether the phase that carried the current before the sector began is the one that is fed;
    else it is the one that returns it.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return (sector % 2 == 1) == (direction > 0)


def rising(sector: int, direction: int) -> int:
    """Sign by which the voltage of the floating phase against the star of the terminals rises
    through zero over time in a sector: 1 or -1.

    Args:
        sector: 0 to 5.
        direction: 1 forwards, -1 backwards.
    """
    return direction if sector % 2 == 1 else -direction


# Position from the phase that floats: zero crossing and integral of the back-EMF, in the order
# of operations of the emitted C (paper 001, 7.2.1, methods 2 and 3).
#
# Once per period it is told the voltages of the three terminals, sampled in the middle of the
# on-time. Times count in periods, between samples by a line. After a commutation the voltage is
# left unseen while the phase that was switched off frees its current. A crossing that was missed
# there, or while the drive accelerates, counts at the first sample that shows its sign.
#
# The steps run on scalars of any floating type: double precision for analysis, single precision as
# the model of the C.

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


# What the waveform of a machine makes of block commutation.
#
# The terminals of the fed and of the returning phase lie at both rails, and the drops over their
# resistances and (equal) inductances cancel. Against the mean of all three terminals, a star of
# three resistors, the phase k that floats then shows
#
#     u = v_k - (v_a + v_b + v_c)/3 = omega_e g_k(theta),     g_k = f_k - (f_a + f_b + f_c)/3
#
# with f the back-EMF over the electrical speed: harmonics of the orders 3, 9, ... fall out. It
# crosses zero at theta_z; the current is handed on at theta_c, where the EMF of the phase that
# comes equals that of the phase that goes. For a sine theta_c - theta_z is 30 degrees and the
# integral in between psi (1 - cos 30 deg) = 0.134 psi; here both are those of the waveform itself.

_TURN = 2.0 * np.pi / 3.0


_UNFIT = "control.observer: {} is no waveform for blocks of 120 deg; write another observer"


_SALIENT = 1e-6  # relative difference of inductances above which a machine counts as salient


@dataclass(frozen=True, slots=True)
class BlockShape:
    """A waveform in block commutation, turning forwards (backwards it is the same, mirrored).

    Args:
        crossings: Electrical angles of the zero crossings in rad, of the sectors 0 to 5.
        delay: theta_c - theta_z in rad, mean of all sectors.
        spread: Largest deviation of a commutation by the means above from where it belongs, in rad.
        threshold: Integral of the voltage over time from crossing to commutation, in V s.
        slope: Least |dg/dtheta| at a crossing, in V s/rad^2.
        level: Least |g| at a commutation, in V s/rad.
        torque: Mean torque over the current in N m/A; ``ripple`` the peak to peak of it under
            constant current, over the mean.
        emf: Mean voltage of the two phases in series over the electrical speed, in V s/rad;
            ``peak`` its largest value.
    """

    crossings: tuple[float, ...]
    delay: float
    spread: float
    threshold: float
    slope: float
    level: float
    torque: float
    ripple: float
    emf: float
    peak: float


def phases_of(machine: Machine, phases: AnyPhaseMachine | None) -> AnyPhaseMachine:
    """The machine in phase quantities: as it is, or made of constant dq parameters.

    Args:
        machine: In dq coordinates.
        phases: Its phases where its back-EMF is no sine, None for others.

    Raises:
        NoSolutionError: Its inductances depend on the current.
    """
    if phases is not None:
        return phases
    if not isinstance(machine, LinearMachine):
        raise NoSolutionError(
            "control.observer: six-step drives are designed for constant inductances; write "
            "machine.model: linear or waveform"
        )
    theta = grid(ANGLES) - _TURN * np.arange(3)[:, np.newaxis]
    mean = 0.5 * (machine.l_d + machine.l_q)
    made = PhaseMachine(
        machine.pole_pairs,
        machine.r_s,
        mean,  # the star point floats: only the difference to the mutual inductance counts
        0.0,
        -machine.psi_pm * np.sin(theta),
        machine.i_max,
    )
    if abs(machine.l_q - machine.l_d) <= _SALIENT * mean:
        return made
    return SalientPhaseMachine.with_second_harmonic(made, (machine.l_d - machine.l_q) / 3.0)


def dq_inductances(machine: AnyPhaseMachine) -> tuple[float, float]:
    """Means of the inductances along and across the magnets in H.

    Args:
        machine: In phase quantities.
    """
    if isinstance(machine, SalientPhaseMachine):
        return machine.dq_inductances
    return (machine.l_s - machine.m_s,) * 2


def _series(waveform: FloatArray, turns: int) -> Callable[[FloatArray], FloatArray]:
    """The trigonometric polynomial through a periodic waveform, over electrical angles in rad."""
    spectrum = np.fft.rfft(waveform) * (2.0 / waveform.size)
    spectrum[0] *= 0.5
    spectrum = spectrum[: (waveform.size + 1) // 2]
    used = np.flatnonzero(np.abs(spectrum) > 1e-13 * np.max(np.abs(spectrum)))

    def at(theta: FloatArray) -> FloatArray:
        angle = np.multiply.outer(np.asarray(theta) / turns, used)
        return np.asarray(np.real(np.exp(1j * angle) @ spectrum[used]))

    return at


def _zero(function: Callable[[FloatArray], FloatArray], near: float, what: str) -> float:
    """The zero of a function within 30 degrees of an angle in rad."""
    from scipy.optimize import brentq

    low, high = near - SECTOR / 2.0, near + SECTOR / 2.0
    ends = function(np.array([low, high]))
    if ends[0] * ends[1] >= 0.0:
        raise NoSolutionError(_UNFIT.format(f"{what} 30 deg and more off its place"))
    return float(brentq(lambda x: float(function(np.array(x))), low, high, xtol=1e-13))


def _difference(
    one: Callable[[FloatArray], FloatArray], two: Callable[[FloatArray], FloatArray]
) -> Callable[[FloatArray], FloatArray]:
    return lambda x: one(x) - two(x)


def block_shape(machine: AnyPhaseMachine) -> BlockShape:
    """What the waveform of a machine makes of block commutation.

    Args:
        machine: In phase quantities; pole pairs that differ from each other enter with all their
            sectors.

    Raises:
        NoSolutionError: A crossing lies where no block of 120 degrees can be placed by it.
    """
    flux, turns = machine.flux, turns_of(machine)
    seen = flux - np.mean(flux, axis=0)
    waves = [_series(wave, turns) for wave in seen]
    crossings = np.empty((turns, 6))
    ends = np.empty((turns, 6))
    areas, slopes, levels = [], [], []
    for turn in range(turns):
        for sector in range(6):
            near = middle(sector, 1) + 2.0 * np.pi * turn
            wave, sign = waves[FLOATING[sector]], 1.0 if sector % 2 else -1.0
            after = (sector + 1) % 6
            comes = waves[FLOATING[sector]]
            goes = waves[FED[sector] if FED[after] != FED[sector] else RETURN[sector]]
            start = _zero(wave, near, "a zero crossing of the back-EMF")
            end = _zero(_difference(comes, goes), near + SECTOR / 2.0, "a crossing of two EMFs")
            crossings[turn, sector], ends[turn, sector] = start - near, end - near
            line = np.linspace(start, end, 401)
            along = sign * wave(line)
            if np.min(along) < -1e-6 * np.max(np.abs(along)):
                raise NoSolutionError(_UNFIT.format("a back-EMF that crosses zero once more"))
            areas.append(float(np.trapezoid(along, line)))
            slopes.append(sign * float(np.diff(wave(start + np.array([-1e-4, 1e-4])))[0]) / 2e-4)
            levels.append(sign * float(wave(np.array(end))))
    delay, mean = float(np.mean(ends - crossings)), np.mean(crossings, axis=0)
    current = _block_emf(waves, float(np.mean(ends)) - SECTOR / 2.0, turns)
    return BlockShape(
        crossings=tuple(float(middle(n, 1) + mean[n]) for n in range(6)),
        delay=delay,
        spread=float(np.max(np.abs(ends - (crossings + delay)))),
        threshold=float(np.mean(areas)),
        slope=min(slopes),
        level=min(levels),
        torque=machine.pole_pairs * float(np.mean(current)),
        ripple=float(np.ptp(current) / np.mean(current)),
        emf=float(np.mean(current)),
        peak=float(np.max(current)),
    )


def turns_of(machine: AnyPhaseMachine) -> int:
    """Electrical periods after which the waveform repeats.

    Args:
        machine: In phase quantities.
    """
    return (machine.phases if isinstance(machine, SalientPhaseMachine) else machine).turns


def _block_emf(
    waves: list[Callable[[FloatArray], FloatArray]], ahead: float, turns: int
) -> FloatArray:
    """Back-EMF of the two phases in series over the electrical speed within the blocks."""
    places = np.arange(120, dtype=np.float64) + 0.5
    inside: FloatArray = np.asarray(places / 120.0 * SECTOR - SECTOR / 2.0 + ahead)
    parts = []
    for turn in range(turns):
        for sector in range(6):
            theta: FloatArray = middle(sector, 1) + 2.0 * np.pi * turn + inside
            parts.append(_difference(waves[FED[sector]], waves[RETURN[sector]])(theta))
    return np.concatenate(parts)
