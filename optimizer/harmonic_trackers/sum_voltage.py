"""The third harmonic as a tracker of a design: what the sum of the phase voltages may hold besides,
its usual tuning, its range.

Currents that add up to zero leave nothing in the sum where the inductances seen by each phase add
up to the same, L_aa + L_ba + L_ca = ...: a saliency of the second harmonic does so. What differs
from phase to phase or over the angle, times the largest current, is a flux beside the third
harmonic's, and turns the angle by that over three times its amplitude.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.machines.transforms import Reals
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.estimators.tracker import Tracker, TrackerLoop
from dqforge.optimizer.harmonic_trackers.third_harmonic import (
    ThirdHarmonic,
    other_harmonics,
    third_harmonic,
)
from dqforge.optimizer.harmonic_trackers.tracking_steps import (
    ThirdHarmonicGains,
    ThirdHarmonicState,
    third_harmonic_gains,
    third_harmonic_start,
    third_harmonic_step,
)
from dqforge.optimizer.observers.judgement import ANGLE_LIMIT
from dqforge.optimizer.observers.parts import Arithmetic, Pair

_LOOP = (
    0.15  # double pole of the loop over the largest electrical speed: a fifth of it is the least
)


_DRIFT = 0.5  # that of flux and offset over the loop's


_SLOWEST = 2.0 * math.pi * 0.5  # in rad/s


def usual_loop(omega_max: float, t_s: float) -> float:
    """Double pole of the loop in rad/s with which the range begins at a fifth of the largest speed.

    Args:
        omega_max: Largest electrical speed in rad/s.
        t_s: Sampling period in s.
    """
    return min(max(_LOOP * omega_max, _SLOWEST), 0.5 / t_s)


def current_angle(machine: SalientPhaseMachine, amplitude: float, i_max: float) -> float:
    """Angle in rad by which currents may turn the third harmonic, at most.

    Args:
        machine: Whose inductances vary.
        amplitude: Of the integral of the sum voltage in V s.
        i_max: Largest current in A, peak.
    """
    sums = np.sum(machine.inductance, axis=1)
    away = sums - np.mean(sums)
    away = away - np.mean(away, axis=1, keepdims=True)  # the same of all phases carries no current
    return float(np.max(np.linalg.norm(away, axis=1))) * math.sqrt(1.5) * i_max / (3.0 * amplitude)


def design_third_harmonic(design: Design, settings: ObserverSettings) -> ThirdHarmonicGains:
    """Gains of the firmware.

    Args:
        design: Machine, topology and sampling.
        settings: ``pll_bandwidth`` is the double pole of the loop, ``bandwidth`` that of flux and
            offset.

    Raises:
        InputError: A pole is out of range, or the neutral carries a current.
        NoSolutionError: There is no third harmonic, too little of it, or too much besides.
    """
    machine, phases, t_s = design.machine, design.phase_machine, design.control.t_s
    omega_m = machine.omega_m_max
    omega_m = design.control.bases.speed if omega_m is None else omega_m
    omega_max = 1.2 * omega_m * machine.pole_pairs
    loop = settings.pll_bandwidth
    loop = usual_loop(omega_max / 1.2, t_s) if loop is None else loop
    drift = _DRIFT * loop if settings.bandwidth is None else settings.bandwidth
    plain = phases.phases if isinstance(phases, SalientPhaseMachine) else phases
    found = third_harmonic(plain, t_s, loop, drift=drift, omega_max=omega_max)
    rule = TOPOLOGIES[design.inverter.topology]
    if rule.neutral or rule.diodes:
        raise InputError(
            f"inverter.topology: {design.inverter.topology} lets the phase currents add up to "
            "something, which the sum of the phase voltages then shows beside the third harmonic; "
            "write three-wire, or another control.observer.method"
        )
    assert plain is not None
    angle = other_harmonics(plain)
    if isinstance(phases, SalientPhaseMachine):
        angle += current_angle(phases, found.amplitude, design.i_max)
    if angle > ANGLE_LIMIT:
        raise NoSolutionError(
            "control.observer: other harmonics of the sum of the phase voltages, and currents, "
            f"turn the angle of the third by up to {math.degrees(angle):.3g} deg, "
            f"{math.degrees(ANGLE_LIMIT):.3g} deg are permitted; choose another method"
        )
    gains = third_harmonic_gains(found)
    _require_speed(design, gains)
    return gains


def _require_speed(design: Design, gains: ThirdHarmonicGains) -> None:
    """Refuse a simulation that runs on it below its range."""
    wanted = None if design.simulation is None else design.simulation.sensorless
    least = _as_designed(gains).least_speed / design.machine.pole_pairs
    if wanted is not None and wanted.below < least * (1.0 - 1e-9):
        raise NoSolutionError(
            f"simulation.sensorless: third-harmonic holds from {format_quantity(least, 'rpm')} on, "
            f"the drive would run on it down to {format_quantity(wanted.below, 'rpm')}; write "
            f"below: {format_quantity(1.02 * least, 'rpm', 3)} or more, or a smaller "
            "control.observer.pll_bandwidth"
        )


def _as_designed(gains: ThirdHarmonicGains) -> ThirdHarmonic:
    """The tracker that the gains are of."""
    return ThirdHarmonic(
        gains.t_s,
        gains.amplitude,
        gains.phase,
        gains.k,
        gains.k_b,
        gains.k_p,
        gains.k_i,
        gains.omega_max,
    )


def _speeds(design: Design, gains: ThirdHarmonicGains) -> tuple[float, float]:
    del design
    return _as_designed(gains).least_speed, gains.omega_max


def _start(gains: ThirdHarmonicGains, theta_e: Reals, omega_e: Reals) -> ThirdHarmonicState:
    del gains
    return third_harmonic_start(theta_e, omega_e)


def _step(
    gains: ThirdHarmonicGains,
    state: ThirdHarmonicState,
    v: Pair,
    i: Pair,
    heard: tuple[Reals, ...],
    maths: Arithmetic,
) -> ThirdHarmonicState:
    return third_harmonic_step(gains, state, v, i, maths, heard[0])


def _in_words(gains: ThirdHarmonicGains) -> str:
    loop = math.sqrt(gains.k_i / gains.t_s)
    drift = math.sqrt(gains.k_b / gains.t_s)
    return (
        f"flux of {gains.amplitude:.4g} V s in the sum; loop {loop:.4g} rad/s, flux and offset "
        f"{drift:.4g} rad/s"
    )


def _tracking(gains: ThirdHarmonicGains) -> TrackerLoop:
    """The loop for the judgement of a speed loop: it sees the error of the predicted angle, on
    average over the ripple of twice the third harmonic, to which it is slow in its range.
    """
    return TrackerLoop(gains.t_s, gains.k_p, gains.k_i, ((0, 1.0),))


TRACKER = Tracker(
    name="third-harmonic",
    code="third_harmonic",
    title="third harmonic of the back-EMF with phase-locked loop",
    design=design_third_harmonic,
    start=_start,
    step=_step,
    gains=ThirdHarmonicGains,
    speeds=_speeds,
    in_words=_in_words,
    hears=("sum-voltage",),
    at_speed=True,
    loop=_tracking,
)
