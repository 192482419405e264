"""Speed steps that a torque slope lets the speed loop answer.

A torque that may only move at a slope s lags behind what the controller wants; for large errors the
loop is three integrators and a switch, and swings. The error below which it is the linear loop goes
with s/(kp omega_c): kp times the error at the crossover omega_c is what the torque has to follow.
Where it ends is found by the loop itself, sampled: inertia, friction, the PI controller with its
filter, torque limit, slope and back-calculation as they are emitted, the current loops as their
delay of one speed sample at most.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import filter_share
from dqforge.optimizer.loops.loop_gains import LoopGains

_STEPS = 81

_SETTLED = 0.05  # of the step

_PERIODS = 30.0  # of 1/omega_c until it must have settled


def answered_step(design: Design, speed: LoopGains, torque_max: float, slope: float) -> float:
    """Largest step of the speed in rad/s, up to the largest speed, that settles.

    Args:
        design: Machine with its inertia, and sampling.
        speed: The speed loop.
        torque_max: Largest torque in N m.
        slope: Of the torque, in N m/s.
    """
    most = design.machine.omega_m_max or design.control.bases.speed
    steps = np.geomspace(1e-3, 1.0, _STEPS) * most
    settled = _settles(design, speed, torque_max, slope, steps)
    free = _settles(design, speed, torque_max, np.inf, steps)
    held = np.flatnonzero(free & ~settled)
    return float(steps[-1]) if held.size == 0 else float(steps[max(0, int(held[0]) - 1)])


def _settles(
    design: Design, speed: LoopGains, torque_max: float, slope: float, steps: FloatArray
) -> BoolArray:
    """Which steps in rad/s settle within 5 % of them in time."""
    machine, loop = design.machine, design.control.speed_loop
    assert machine.inertia is not None
    assert loop is not None
    t_s = speed.t_s
    share = filter_share(loop.filter_time, design.control.t_s)
    inner = max(1, loop.ratio)
    shared = 1.0 - (1.0 - share) ** inner  # the filter runs at every current sample
    reach = torque_max / machine.inertia  # the torque limit needs its own time
    count = int((_PERIODS / speed.crossover + 4.0 * np.max(steps) / reach) / t_s) + 1
    omega, seen = np.zeros_like(steps), np.zeros_like(steps)
    torque, integral, acting = np.zeros_like(steps), np.zeros_like(steps), np.zeros_like(steps)
    late = np.zeros(steps.shape, dtype=np.float64)
    for k in range(count):
        seen = seen + shared * (omega - seen)
        error = steps - seen
        wanted = speed.kp * error + (integral + speed.ki_ts * error)
        high = np.minimum(torque + slope * t_s, torque_max)
        low = np.maximum(torque - slope * t_s, -torque_max)
        found = np.clip(wanted, low, high)
        integral = integral + speed.ki_ts * error + speed.anti_windup * t_s * (found - wanted)
        middle = 0.5 * (acting + torque)  # the torque moves along the slope within the sample
        acting, torque = torque, found
        omega = omega + t_s / machine.inertia * (middle - machine.friction * omega)
        if k > count - _PERIODS / (3.0 * speed.crossover * t_s):
            late = np.maximum(late, np.abs(omega - steps))
    return np.asarray(late < _SETTLED * steps, dtype=np.bool_)
