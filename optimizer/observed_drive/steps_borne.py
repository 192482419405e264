"""Which steps of load and of speed a drive on its observer bears at every corner of its box.

Around a steady state the drive is linear as long as neither torque nor voltage meets its limit and
the speed stays where every corner is stable. Per corner, at three speeds of the range, the closed
loop answers to a unit step of the load with a dip D of the speed and a peak O of the torque, to one
of the reference with a peak P of the torque and an overshoot S. A load step L then needs

    speed - D L >= lowest speed,   T_0 + max(O, 2) L <= T_max,   |v(T_0 + max(O, 2) L)| <= v_max

and a step of the speed has what torque that leaves, (max(O, 2) - 1) L/P.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.optimizer.loops.observed_margins import LimitCycle, SpeedRange, StepsBorne
from dqforge.optimizer.observed_drive.speed_range import (
    CornerBox,
    SteadyDrives,
    cases_of,
    steady_drives,
)

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.optimizer.observed_drive.drive_cases import DriveCases
    from dqforge.optimizer.observed_drive.drive_model import ObservedDrive
    from dqforge.optimizer.observed_drive.speed_range import SpeedPi


_SPEED = 2  # column of the electrical speed


_TIMES = 20.0  # of J/kp, for which answers are followed


_MOST_PERIODS = 5000


_LEAST_PEAK = 2.0  # of the torque, over the load step that causes it


_SHARES = (1.0, 0.75, 0.5, 0.35, 0.2, 0.1, 0.05)  # of the largest load, tried one by one


_BISECTIONS = 20


@dataclass(frozen=True, slots=True)
class _Answers:
    """The worst of all corners: ``dip`` in rad/s (electrical) per N m, ``peak`` in N m per N m,
    ``effort`` in N m s/rad (mechanical), ``overshoot`` over the step, ``idle`` in N m without load.
    """

    dip: float
    peak: float
    effort: float
    overshoot: float
    idle: float


def steps_borne(
    drive: ObservedDrive, machine: LinearMachine, speed: SpeedPi, box: CornerBox, held: SpeedRange
) -> StepsBorne:
    """Steps that the drive bears within a range.

    Args:
        drive, machine, speed, box: As of
            `dqforge.optimizer.observed_drive.speed_range.speed_range`.
        held: Where every corner holds.
    """
    corners = (*box.corners(dead_time=False), *box.corners(dead_time=False, braking=True))
    cases = [
        cases_of(machine, corners, omega) for omega in np.geomspace(held.low, held.high, 3).tolist()
    ]
    found = [_answers(drive, each, speed) for each in cases]
    dip, peak, effort, overshoot, idle = (
        max(getattr(each, name) for each in found)
        for name in ("dip", "peak", "effort", "overshoot", "idle")
    )
    rise = max(peak, _LEAST_PEAK)
    most = min(max(box.loads), (drive.data.torque_max - idle) / rise)
    for share in _SHARES:
        load = share * most
        low, torque = held.low + dip * load, idle + rise * load
        high = _reached(drive, cases[-1], torque, (held.low, held.high), box.v_max)
        if load > 0.0 and low < high:
            step = machine.pole_pairs * (rise - 1.0) * load / effort
            return StepsBorne(load, low, high, step, overshoot)
    return StepsBorne(0.0, held.low, held.high, 0.0, overshoot)


def _answers(drive: ObservedDrive, cases: DriveCases, speed: SpeedPi) -> _Answers:
    steady = steady_drives(drive, cases)
    whole = steady.closed(speed.ratio, speed.kp, speed.ki)
    by_load, by_speed = _inputs(drive, cases, steady, speed)
    period = speed.ratio * steady.t_s
    least = _TIMES * float(np.max(cases.inertia)) / (speed.kp * period)
    x = np.zeros((*by_load.shape, 2))
    both = np.stack([by_load, by_speed], axis=-1)
    gain = speed.kp + speed.ki * period
    dip = peak = effort = fast = 0.0
    for _ in range(min(_MOST_PERIODS, max(50, math.ceil(least)))):
        torque = x[:, -1] - gain * np.sum(steady.c[:, :, None] * x[:, :-1], axis=1)
        dip = max(dip, float(np.max(np.abs(x[:, _SPEED, 0]))))
        fast = max(fast, float(np.max(x[:, _SPEED, 1])))
        peak = max(peak, float(np.max(np.abs(torque[:, 0]))))
        effort = max(effort, float(np.max(np.abs(torque[:, 1] + gain))))
        x = whole @ x + both
    pole_pairs = drive.data.machine.pole_pairs
    idle = float(np.max(np.abs(steady.torque[cases.load == 0.0]), initial=0.0))
    return _Answers(dip, peak, effort, max(fast / pole_pairs - 1.0, 0.0), idle)


def _inputs(
    drive: ObservedDrive, cases: DriveCases, steady: SteadyDrives, speed: SpeedPi
) -> tuple[FloatArray, FloatArray]:
    """How a unit step of the load, and of the reference (mechanical), enter a speed period,
    shape (M, n + 1).
    """
    step = 1e-4 * drive.data.torque_max
    after = [
        drive.step(replace(cases, load=cases.load + sign * step), steady.states, steady.torque)[0]
        for sign in (1.0, -1.0)
    ]
    own = (after[0] - after[1]) / (2.0 * step)
    load, torque = np.zeros_like(own), np.zeros_like(own)
    for _ in range(speed.ratio):
        load = (steady.a @ load[..., None])[..., 0] + own
        torque = (steady.a @ torque[..., None])[..., 0] + steady.b
    integral = speed.ki * speed.ratio * steady.t_s
    one = np.ones((len(own), 1))
    return (
        np.concatenate([load, 0.0 * one], axis=1),
        np.concatenate([(speed.kp + integral) * torque, integral * one], axis=1),
    )


def _reached(
    drive: ObservedDrive,
    cases: DriveCases,
    torque: float,
    between: tuple[float, float],
    v_max: float,
) -> float:
    """Largest electrical speed in rad/s between two at which every corner has the voltage for a
    torque in N m; 0 where the lower one is too fast.
    """
    i = complex(drive.data.reference(np.array([torque]))[0])

    def enough(omega: float) -> bool:
        psi = cases.psi_pm + cases.l_d * i.real + 1j * cases.l_q * i.imag
        volts = np.abs(cases.r_s * i + 1j * omega * psi) / cases.link
        return bool(np.all(volts <= v_max))

    low, high = between
    if enough(high):
        return high
    if not enough(low):
        return 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if enough(middle) else (low, middle)
    return low


# How an unstable speed loop on an observer swings in the end.
#
# Its torque becomes a square wave at its limit, the speed a triangle. The fundamental of that
# torque, 4/pi T_max, moves the shaft by T/(J omega): from peak to peak
#
#     8 T_max/(pi J omega_osc),   omega_osc = 0.9 times the frequency of the unstable pole
#
# (the limit slows the swing: simulated drives swing at 0.82 to 0.93 times that frequency).

SLOWING = 0.9  # Frequency of the limit cycle over that of the unstable pole.


def limit_cycle(
    pole: complex, period: float, torque_max: float, inertia: float
) -> LimitCycle | None:
    """Frequency and size of the swing; None of a stable pole, or one that does not swing.

    Args:
        pole: The largest of the closed loop, in the z plane.
        period: Period of the speed controller in s.
        torque_max: Limit of its torque in N m.
        inertia: In kg m^2.
    """
    turning = abs(float(np.angle(pole)))
    if not abs(pole) >= 1.0 or turning < 1e-9:
        return None
    omega = SLOWING * turning / period
    return LimitCycle(omega, 8.0 * torque_max / (np.pi * inertia * omega))
