"""Control of a six-step drive in the order of operations of the emitted C: catching a rotor that
turns, forced start, blocks by the estimator, current and speed.

    stopped -> caught (all legs rest, the back-EMF shows whether and how the rotor turns)
    caught  -> running, where it turns fast enough; else aligning in one block, then in the next
    aligning -> ramp: blocks at a frequency that rises -> caught -> running, or the fault no-start
    running -> stopped where the reference asks for no speed; fault lost where no crossing comes

One leg is chopped, both switches in turn, the other stays at its rail, the third rests. While the
chopped leg lies at the other's rail, the star point does so too, and the diode of the third leg at
that rail conducts where its back-EMF points there. The integral is taken while it must not: where
that EMF falls, the returning leg is chopped instead of the fed one. Up to the crossing, where such
a current is nothing, it does not matter, and the fed leg is chopped throughout.

Alignment and ramp apply a voltage, that of the start current and of the back-EMF at the forced
speed: a regulated current would leave the rotor to swing without damping. Above the limit the
current controller takes off what is too much.

The current is that of the phase which both blocks share, so that a commutation does not show in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.records import dataclass
from dqforge.optimizer.six_step.sectors import (
    FED,
    RETURN,
    BlockGains,
    BlockState,
    Real,
    kept_fed,
    rising,
    seen_angle,
)
from dqforge.optimizer.six_step.sectors import start as start_estimator
from dqforge.optimizer.six_step.sectors import step as estimate

STOPPED, CATCHING, ALIGNING, RAMP, RUNNING, FAULT = range(6)

# Names of the stages, by their numbers.
STAGES = ("stopped", "catching", "aligning", "ramp", "running", "fault")
NO_FAULT, NO_START, LOST = range(3)
FAULTS = ("none", "no start", "lost")  # Names of the faults, by their numbers.


@dataclass(frozen=True, slots=True)
class SixStepGains:
    """Numbers of the control.

    Args:
        observer: Of the estimator.
        kp, ki_ts: Of the current of two phases in series, V/A; the integral's per period.
        emf: Mean back-EMF of two phases in series over the electrical speed in V s/rad.
        torque: Torque over current in N m/A.
        i_max: Limit of the current reference in A.
        duty_least: Least duty cycle while the position is estimated, so that the on-time can be
            sampled.
        speed_kp, speed_ki_ts: Of the speed at the least speed, N m s/rad; the integral's per period
            of the speed controller.
        omega_low, speed_scale: Least electrical speed in rad/s, and how far the gains may rise with
            the speed.
        pole_pairs: Number of pole pairs.
        ratio: Periods per period of the speed controller.
        omega_least: Mechanical speed reference in rad/s below which the drive stops.
        omega_caught: Least electrical speed in rad/s from which it runs on its estimator.
        i_start, v_start: Current of alignment and ramp in A, and the voltage in V that two phases
            in series at rest take for it, dead time included.
        align: Periods of each of the two blocks of the alignment.
        rise, rate: Of the ramp: blocks per period, its rise per period and its end.
        settle, gap: Periods from the opening of all legs to the first look at the back-EMF, and
            from there to the second.
    """

    observer: BlockGains
    kp: float
    ki_ts: float
    emf: float
    torque: float
    i_max: float
    duty_least: float
    speed_kp: float
    speed_ki_ts: float
    omega_low: float
    speed_scale: float
    pole_pairs: float
    ratio: int
    omega_least: float
    omega_caught: float
    i_start: float
    v_start: float
    align: int
    rise: float
    rate: float
    settle: int
    gap: int


@dataclass(slots=True)
class SixStepState:
    """What the control holds; whole numbers but for ``rate`` and ``phase`` of the ramp, ``beyond``
    of the first look, the ``integral`` of the current in V, that of the speed and the ``asked``
    torque in N m. ``ramped`` says that the ramp is over.
    """

    stage: int
    fault: int
    direction: int
    sector: int
    count: int
    ramped: int
    seen: int
    tick: int
    rate: Real
    phase: Real
    beyond: Real
    integral: Real
    speed_integral: Real
    asked: Real
    current: Real
    observer: BlockState


@dataclass(frozen=True, slots=True)
class Legs:
    """What the legs do until the next step: the phases ``high`` and ``low``, -1 where all rest, and
    which of both is ``chopped``: ``duty`` is the share of the period, about its middle, in which it
    lies at its own rail, else at that of the other.
    """

    high: int
    low: int
    chopped: int
    duty: Real


def reset(gains: SixStepGains, real: type) -> SixStepState:
    """A drive at rest, without a fault.

    Args:
        gains: Of the control.
        real: Floating type.
    """
    zero = real(0.0)
    observer = start_estimator(gains.observer, 0, 1, real(gains.omega_caught), zero, real)
    whole = (STOPPED, NO_FAULT, 1, 0, 0, 0, 0, 0)
    return SixStepState(*whole, zero, zero, zero, zero, zero, zero, zero, observer)


def _begin(state: SixStepState, stage: int, real: type) -> None:
    state.stage = stage
    state.count = 0
    state.integral = real(0.0)


def _catch(gains: SixStepGains, state: SixStepState, v: Sequence[Real], real: type) -> None:
    """All legs rest: two looks at the back-EMF."""
    state.count += 1
    if state.count == gains.settle:
        state.seen, state.beyond, _ = seen_angle(v, state.direction, real)
    if state.count < gains.settle + gains.gap:
        return
    sector, beyond, largest = seen_angle(v, state.direction, real)
    blocks = (sector - state.seen if state.direction > 0 else state.seen - sector) % 6
    blocks = blocks - 6 if blocks > 3 else blocks
    turned = real(1.0471976) * real(blocks) + (beyond - state.beyond)
    omega = turned / (real(gains.gap) * real(gains.observer.t_s))
    held = real(0.5) * (real(gains.emf) * real(gains.omega_caught))
    least = real(0.7) * real(gains.omega_caught)
    if largest >= held and omega >= least:
        state.sector = sector
        x = omega * real(gains.observer.t_s)
        ahead = beyond + x * real(gains.observer.latency)
        state.observer = start_estimator(
            gains.observer, sector, state.direction, omega, ahead, real
        )
        state.speed_integral = real(0.5) * (real(gains.torque) * real(gains.i_start))
        state.tick = 0
        _begin(state, RUNNING, real)
    elif state.ramped != 0:
        state.fault = NO_START
        _begin(state, FAULT, real)
    elif largest >= held and omega <= -least:
        state.count = 0  # it turns the other way: wait
    else:
        state.sector = 0
        _begin(state, ALIGNING, real)


def _force(gains: SixStepGains, state: SixStepState, real: type) -> None:
    """Alignment in two blocks, then blocks at a rising frequency."""
    one = 1 if state.direction > 0 else 5
    if state.stage == ALIGNING:
        state.count += 1
        if state.count == gains.align:
            state.sector = (state.sector + one) % 6
        if state.count >= 2 * gains.align:
            state.rate = real(0.0)
            state.phase = real(0.0)
            state.stage = RAMP
        return
    state.rate = state.rate + real(gains.rise)
    state.phase = state.phase + state.rate
    if state.phase >= real(1.0):
        state.phase = state.phase - real(1.0)
        state.sector = (state.sector + one) % 6
    if state.rate >= real(gains.rate):
        state.ramped = 1
        _begin(state, CATCHING, real)


def _begin_start(state: SixStepState, direction: int, real: type) -> None:
    state.direction = direction
    state.ramped = 0
    state.fault = NO_FAULT
    _begin(state, CATCHING, real)


def _measured(state: SixStepState, i: Sequence[Real], sector: int) -> Real:
    if kept_fed(sector, state.direction):
        return i[FED[sector]]
    return -i[RETURN[sector]]


def _voltage(gains: SixStepGains, state: SixStepState, i: Real, v_dc: Real, real: type) -> Real:
    """Duty cycle of the fed leg by the current controller."""
    zero, one = real(0.0), real(1.0)
    running = state.stage == RUNNING
    omega = state.observer.omega_e
    speed = omega if omega >= zero else -omega
    ahead = real(gains.emf) * speed if running else zero
    low = real(gains.duty_least) if running else zero
    error = state.current - i
    wanted = (ahead + state.integral) + real(gains.kp) * error
    if not running:
        rate = state.rate if state.stage == RAMP else zero
        over = i - real(gains.i_max)
        wanted = real(gains.v_start) + (real(gains.emf) * rate) * (
            real(1.0471976) / real(gains.observer.t_s)
        )
        wanted = wanted - real(gains.kp) * (over if over > zero else zero)
        error = zero
    duty = wanted / v_dc if v_dc > zero else zero
    if duty >= low and duty <= one:
        state.integral = state.integral + real(gains.ki_ts) * error
    elif duty > one:
        duty = one
        state.integral = state.integral + real(gains.ki_ts) * (error if error < zero else zero)
    else:
        duty = low
        state.integral = state.integral + real(gains.ki_ts) * (error if error > zero else zero)
    return duty


def _wanted_current(gains: SixStepGains, state: SixStepState, real: type) -> Real:
    zero = real(0.0)
    if state.stage != RUNNING:
        return real(gains.i_start)
    along = state.asked if state.direction > 0 else -state.asked
    current = along / real(gains.torque)
    current = zero if not current > zero else current
    return current if current < real(gains.i_max) else real(gains.i_max)


def speed_control(gains: SixStepGains, state: SixStepState, reference: Real, real: type) -> Real:
    """Torque in N m for a mechanical speed reference in rad/s; call it before `step`.

    A stopped drive starts where the reference asks for a speed, and a running one stops where it
    asks for none, or for the other direction.

    Args:
        gains: Of the control.
        state: Before and after.
        reference: Mechanical speed in rad/s.
        real: Floating type.
    """
    zero = real(0.0)
    way = 1 if reference >= zero else -1
    size = reference if way > 0 else -reference
    wanted = bool(size >= real(gains.omega_least))
    if state.stage == STOPPED:
        if wanted:
            _begin_start(state, way, real)
    elif state.stage == RUNNING:
        if not wanted or way != state.direction:
            slow = state.observer.omega_e if way > 0 else -state.observer.omega_e
            slow = slow if slow >= zero else -slow
            if state.observer.lost != 0 or slow < real(gains.omega_caught):
                _begin(state, STOPPED, real)
            state.asked = zero
            state.speed_integral = zero
        elif state.tick == 0:
            most = real(gains.torque) * real(gains.i_max)
            omega = state.observer.omega_e / real(gains.pole_pairs)
            error = reference - omega
            error = error if way > 0 else -error
            seen = state.observer.omega_e if way > 0 else -state.observer.omega_e
            scale = seen / real(gains.omega_low)
            scale = scale if scale > real(1.0) else real(1.0)
            scale = scale if scale < real(gains.speed_scale) else real(gains.speed_scale)
            asked = (scale * real(gains.speed_kp)) * error + state.speed_integral
            if (asked < most or error < zero) and (asked > zero or error > zero):
                gain = (scale * scale) * real(gains.speed_ki_ts)
                state.speed_integral = state.speed_integral + gain * error
            asked = most if asked > most else asked
            asked = zero if not asked > zero else asked
            state.asked = asked if way > 0 else -asked
    state.tick = state.tick + 1 if state.tick + 1 < gains.ratio else 0
    return state.asked


def torque_control(state: SixStepState, reference: Real, real: type) -> Real:
    """Torque in N m that is asked for; a stopped drive starts in its direction.

    Args:
        state: Before and after.
        reference: In N m; against the rotation it counts as none.
        real: Floating type.
    """
    zero = real(0.0)
    if state.stage == STOPPED and (reference > zero or reference < zero):
        _begin_start(state, 1 if reference > zero else -1, real)
    state.asked = zero if np.isnan(reference) else reference
    return state.asked


def step(
    gains: SixStepGains,
    state: SixStepState,
    v: Sequence[Real],
    i: Sequence[Real],
    v_dc: Real,
    real: type,
) -> Legs:
    """One period, in place: what the legs do in the next one.

    Args:
        gains: Of the control.
        state: Before and after.
        v: Voltages of the terminals in V, sampled in the middle of the period.
        i: Currents into the phases in A, sampled there.
        v_dc: Voltage of the link in V.
        real: Floating type.
    """
    before = state.sector
    if state.stage == CATCHING:
        _catch(gains, state, v, real)
    elif state.stage == RUNNING:
        estimate(gains.observer, state.observer, v, real)
        state.sector = state.observer.sector
        if state.observer.lost != 0:
            state.fault = LOST
            _begin(state, FAULT, real)
    elif state.stage in (ALIGNING, RAMP):
        _force(gains, state, real)
    if state.stage in (STOPPED, CATCHING, FAULT):
        return Legs(-1, -1, -1, real(0.0))
    state.current = _wanted_current(gains, state, real)
    duty = _voltage(gains, state, _measured(state, i, before), v_dc, real)
    high, low = FED[state.sector], RETURN[state.sector]
    falls = rising(state.sector, state.direction) < 0
    upside = state.stage == RUNNING and gains.observer.by_integral != 0 and falls
    return Legs(high, low, low if upside else high, duty)
