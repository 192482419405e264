"""The steps by which the loops of a firmware are tried: of current, torque and speed, at rest and
at half of the base speed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.plants.scenario import ControlMode, Profile, Scenario
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.dq_machines.synchronous import Machine
    from dqforge.optimizer.firmware.configuration import DriveValues
    from dqforge.optimizer.firmware.profile import LoopProfile, PiController

# Of the current limit: step of the current, and (times its torque) of the torque.
CURRENT_SHARE = 0.5

# Of the base speed: steps of the speed, which leave the current limit alone and which do not.
SMALL_SHARE, LARGE_SHARE = 0.05, 0.8
_CONSTANTS = 12.0  # slowest time constants that a step is given
_LONGEST = 20.0
_MOST_SAMPLES = 400_000


@dataclass(frozen=True, slots=True)
class StandardStep:
    """One step: what it is called, from which to which reference, when, and its scenario."""

    name: str
    before: float
    after: float
    time: float
    scenario: Scenario


def standard_steps(
    profile: LoopProfile, values: DriveValues, machine: Machine, i_max: float, v_dc: float
) -> tuple[tuple[StandardStep, ...], tuple[str, ...]]:
    """The steps that a configuration is put through, and sentences on those left out.

    Args:
        profile: The loops.
        values: What the firmware is told.
        machine: The machine that is there.
        i_max: Current limit in A (peak of phase).
        v_dc: Voltage of the dc link in V.
    """
    base = base_speed(profile, machine, i_max, v_dc)
    left_out: list[str] = []
    speeds = (0.0, 0.5 * base) if base > 0.0 else (0.0,)
    steps = [_driven(profile, machine, "current", CURRENT_SHARE * i_max, speed) for speed in speeds]
    constant = 1.5 * (values.pole_pairs or 0) * (values.psi_pm or 0.0)
    if constant > 0.0:
        torque = CURRENT_SHARE * i_max * constant
        steps += [_driven(profile, machine, "torque", torque, speed) for speed in speeds]
    else:
        left_out.append("no step of the torque: the firmware is told of no magnet flux linkage")
    if profile.speed is None:
        left_out.append("no step of the speed: the configuration has no speed controller")
    elif machine.inertia is None:
        left_out.append("no step of the speed: the design has no machine.inertia")
    elif base <= 0.0:
        left_out.append("no step of the speed: the voltage does not reach beyond standstill")
    else:
        steps += [
            _free(profile, machine, i_max, name, before, before + share * base)
            for name, before, share in (
                ("small speed step at rest", 0.0, SMALL_SHARE),
                ("large speed step at rest", 0.0, LARGE_SHARE),
                ("small speed step at half of the base speed", 0.5 * base, SMALL_SHARE),
            )
        ]
    return tuple(steps), tuple(left_out)


def base_speed(profile: LoopProfile, machine: Machine, i_q: float, v_dc: float) -> float:
    """Mechanical speed in rad/s at which a q current alone takes the whole voltage, at most the
    machine's largest; 0 where it does so at rest.

    Args:
        profile: Whose share of the voltage holds.
        machine: The machine.
        i_q: Current in A (peak of phase).
        v_dc: Voltage of the dc link in V.
    """
    v_max = profile.current.voltage_share * v_dc / math.sqrt(3.0)
    flux_d, flux_q = machine.flux(np.array([0.0]), np.array([i_q]))
    psi_d, psi_q, drop = float(flux_d[0]), float(flux_q[0]), machine.r_s * i_q
    square, middle = psi_d**2 + psi_q**2, drop * psi_d
    if square <= 0.0 or drop >= v_max:
        return 0.0
    omega_e = (-middle + math.sqrt(middle**2 + square * (v_max**2 - drop**2))) / square
    return min(omega_e / machine.pole_pairs, machine.omega_m_max or math.inf)


def _slow_current(profile: LoopProfile, machine: Machine) -> float:
    """Slowest time constant of the current loops in s."""
    found = []
    for pi, inductance in ((profile.current.d, machine.l_d), (profile.current.q, machine.l_q)):
        if pi.ki > 0.0:
            found.append((machine.r_s + pi.kp) / pi.ki)
        found += [inductance / (machine.r_s + abs(pi.kp)), pi.filter_time, 10.0 * pi.t_s]
    return max(found)


def _slow_estimate(profile: LoopProfile) -> float:
    """Slowest time constant of the speed that the firmware makes, in s."""
    if profile.speed is None:
        return 0.0
    speed = profile.speed.feedback
    if speed.kind == "pll" and speed.ki > 0.0:
        return max(speed.kp / speed.ki, 2.0 / max(speed.kp, 1e-12))
    return {"low-pass": speed.filter_time, "difference": speed.samples * speed.t_s}.get(
        speed.kind, 0.0
    )


def _slow_speed(profile: LoopProfile, pi: PiController, machine: Machine) -> float:
    """Slowest time constant of the speed loop in s."""
    rate = pi.kp * machine.torque_per_ampere / max(machine.inertia or 0.0, 1e-12)
    found = [_slow_current(profile, machine), _slow_estimate(profile), pi.filter_time, 5.0 * pi.t_s]
    if rate > 0.0:
        found.append(2.0 / rate)
    if pi.ki > 0.0:
        found.append(pi.kp / pi.ki)
    return max(found)


def _bounded(duration: float, t_s: float) -> float:
    return min(max(duration, 40.0 * t_s), 0.5 * _LONGEST, 0.5 * _MOST_SAMPLES * t_s)


def _driven(
    profile: LoopProfile, machine: Machine, mode: ControlMode, after: float, speed: float
) -> StandardStep:
    """A step of current or torque while a load machine holds the speed, which it has come to."""
    t_s = profile.current.d.t_s
    length = _bounded(_CONSTANTS * _slow_current(profile, machine), t_s)
    follows = profile.current.cross or profile.current.back_emf or profile.current.angle_advance
    wait = _bounded(length + (_CONSTANTS * _slow_estimate(profile) if follows else 0.0), t_s)
    shaft = Profile((0.0, 0.25 * wait), (0.0, speed), "linear")
    scenario = Scenario(
        wait + length,
        mode,
        Profile((0.0, wait), (0.0, after)),
        shaft=shaft,
        dead_time=0.0,
    )
    return StandardStep(_named(mode, speed), 0.0, after, wait, scenario)


def _free(
    profile: LoopProfile,
    machine: Machine,
    i_max: float,
    name: str,
    before: float,
    after: float,
) -> StandardStep:
    """A step of the speed of a free shaft without load."""
    assert profile.speed is not None
    pi, ramp = profile.speed.pi, profile.speed.ramp
    t_s = profile.current.d.t_s
    torque = max(machine.torque_per_ampere * i_max, 1e-12)
    moving = 3.0 * (machine.inertia or 0.0) * (after - before) / torque
    moving += (after - before) / ramp if ramp else 0.0
    settling = _CONSTANTS * _slow_speed(profile, pi, machine)
    length = _bounded(settling + moving, t_s)
    wait = _bounded(settling, t_s) if before else 0.0
    scenario = Scenario(
        wait + length,
        "speed",
        Profile((0.0, wait), (before, after)) if wait else Profile((0.0,), (after,)),
        dead_time=0.0,
        omega_m=before,
    )
    return StandardStep(name, before, after, wait, scenario)


def _named(mode: ControlMode, speed: float) -> str:
    return f"{mode} step {'at half of the base speed' if speed else 'at rest'}"
