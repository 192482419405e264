"""Position observers in integers on drives that move: fitted, run beside their exact models."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from drives import on_observer

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import DriveMotion, drive_motion
from dqforge.optimizer.fixed_observers.fixed_observer_fit import FixedObserverFit, fit_observer
from dqforge.optimizer.fixed_observers.kit import observe_codes
from dqforge.optimizer.observers.parts import Estimates, observe
from dqforge.optimizer.observers.solve import solve_observer
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.steps.integer_arithmetic import CodeArray

BENCH = "paper001-pmsm-bench"

RPM = 30.0 / math.pi


def observed_design(name: str, drive: str = BENCH) -> Design:
    """A library drive with a position observer, exported in both formats."""
    design = catalogue.load(drive)
    bases = design.control.bases
    fastest = design.machine.omega_m_max or bases.speed
    wide = replace(
        bases,
        current=max(bases.current, 1.25 * design.i_max),
        speed=max(bases.speed, 1.25 * fastest),
    )
    method: ObserverMethodName = name  # type: ignore[assignment]
    made = on_observer(design, ObserverSettings(method=method))
    control = replace(made.control, bases=wide)
    return replace(made, control=control, export=replace(design.export, control=("q15", "q31")))


@cache
def tuned(name: str, drive: str = BENCH) -> PositionObserver:
    """The observer, tuned once."""
    observer = solve_observer(observed_design(name, drive))[1]
    assert observer is not None
    return observer


@cache
def fitted(name: str, width: int, drive: str = BENCH) -> FixedObserverFit:
    """The observer in integers, fitted once."""
    return fit_observer(observed_design(name, drive), tuned(name, drive), width)


@dataclass(frozen=True)
class SideBySide:
    """Angles in degrees and mechanical speeds in rpm, of shape (samples, drives): what integers
    and doubles estimate, and what is true.
    """

    angle: FloatArray
    speed: FloatArray
    exact_angle: FloatArray
    exact_speed: FloatArray
    true_angle: FloatArray

    def apart(self, first: int, last: int | None = None) -> tuple[float, float]:
        """Largest differences of angle and speed between integers and doubles, from a sample on."""
        part = slice(first, last)
        angle = turned(self.angle - self.exact_angle)[part]
        return float(np.max(np.abs(angle))), float(
            np.max(np.abs(self.speed - self.exact_speed)[part])
        )


def turned(degrees: FloatArray) -> FloatArray:
    """Angles in degrees brought to -180 to 180."""
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)


def codes(values: FloatArray, base: float, width: int) -> CodeArray:
    """Values as codes of a full scale, saturated."""
    one = 2 ** (width - 1)
    found = np.clip(np.rint(values / base * one), -one, one - 1)
    return np.asarray(found, dtype=np.int64)


def motion(name: str, speeds: FloatArray, torque: FloatArray, drive: str = BENCH) -> DriveMotion:
    """Drives at shares of the full speed and of half the largest current, (samples, drives)."""
    design = observed_design(name, drive)
    machine = linearised(design.machine)
    speed = design.control.bases.speed * machine.pole_pairs
    currents = np.asarray(0.5j * design.i_max * torque, dtype=np.complex128)
    return drive_motion(machine, tuned(name, drive).t_s, speeds * speed, currents)


def beside(name: str, width: int, seen: DriveMotion, drive: str = BENCH) -> SideBySide:
    """Run an observer in integers and in double precision over what was measured."""
    design, observer, fit = (
        observed_design(name, drive),
        tuned(name, drive),
        fitted(name, width, drive),
    )
    bases, poles = design.control.bases, linearised(design.machine).pole_pairs
    exact: Estimates = observe(observer.method, observer.gains, seen)
    first = np.rint(seen.theta_e[0] / (2.0 * np.pi) * 2**width).astype(np.int64) % 2**width
    start = first, codes(seen.omega_e[0] / poles, bases.speed, width)
    samples = (
        codes(seen.v_alpha, bases.voltage, width),
        codes(seen.v_beta, bases.voltage, width),
        codes(seen.i_alpha, bases.current, width),
        codes(seen.i_beta, bases.current, width),
    )
    theta, omega = observe_codes(fit.observer.method, fit.observer.gains, width, start, samples)
    return SideBySide(
        angle=theta * (360.0 / 2**width),
        speed=omega * (bases.speed / 2 ** (width - 1) * RPM),
        exact_angle=np.degrees(np.asarray(exact.theta_e, dtype=np.float64)),
        exact_speed=np.asarray(exact.omega_e, dtype=np.float64) / poles * RPM,
        true_angle=np.degrees(seen.theta_e),
    )
