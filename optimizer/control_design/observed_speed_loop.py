"""The speed loop of a design judged as it runs: on the speed and in the angle of its observer.

The drive with its observer (`dqforge.optimizer.control_design.observer_drive`) is lifted to the
period of the speed controller and closed by its PI, at several speeds. Without an observer nothing
changes (`dqforge.optimizer.loops.gains`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import SpeedLoopSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.optimizer.control_design.observer_drive import (
    DriveData,
    Estimator,
    PositionEstimator,
    SpeedEstimator,
    steady_drive,
)
from dqforge.optimizer.loops.gains import speed_delay
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.observed_margins import ObservedLoop
from dqforge.optimizer.loops.pi_methods import calmer, largest_factor, loop_advice, speed_pi
from dqforge.optimizer.loops.plants import DisturbanceResponse, PiLoop, close_pi
from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.observers.tuning_numbers import LARGEST_TURN
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.sampled_systems import ComplexArray, SampledSystem, lift, loop_margins

_SHARES = np.array([0.1, 0.25, 0.5, 1.0])


_POINTS = 1500


def _reference(machine: LinearMachine, design: Design) -> Callable[[float], complex]:
    """i_d + j i_q in A over torque in N m by the strategy of the design."""
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)

    def currents(torque: float) -> complex:
        points = choice.points(np.array([torque]))
        return complex(points.i_d[0], points.i_q[0])

    return currents


def _filter_share(filter_time: float, t_s: float) -> float:
    return 1.0 if filter_time <= 0.0 else float(-np.expm1(-t_s / filter_time))


@dataclass(frozen=True, slots=True, eq=False)
class _Plant:
    """The drive at one electrical speed in rad/s from torque to speed, per speed sample.

    Its response over a grid.
    """

    omega: float
    system: SampledSystem
    response: ComplexArray

    def closed(self, kp: float, ki: float) -> PiLoop:
        """With the PI around it."""
        return close_pi(self.system, kp, ki)


def _plants(
    design: Design, gains: tuple[LoopGains, LoopGains], estimator: Estimator, grid: FloatArray
) -> list[_Plant]:
    machine, control = linearised(design.machine), design.control
    settings = control.speed_loop
    assert settings is not None
    assert machine.inertia is not None
    drive = DriveData(
        machine,
        control.t_s,
        machine.inertia,
        ((gains[0].kp, gains[0].ki_ts), (gains[1].kp, gains[1].ki_ts)),
        _reference(machine, design),
        _filter_share(settings.filter_time, control.t_s),
    )
    omega_m = control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    top = min(machine.pole_pairs * omega_m, LARGEST_TURN / control.t_s)
    found = []
    for omega in (_SHARES * top).tolist():
        system = lift(steady_drive(drive, estimator, omega).system(), settings.ratio)
        wide = replace(system, b=np.hstack([system.b, np.zeros_like(system.b)]), d=np.zeros((1, 2)))
        found.append(_Plant(omega, wide, system.response(grid)))
    return found


def _margin(values: ComplexArray, grid: FloatArray) -> tuple[float, float]:
    """Least phase margin in rad and its crossover in rad/s by interpolation on the grid; (inf,
    nan) without one.
    """
    size = np.log(np.abs(values))
    at = np.flatnonzero(np.sign(size[:-1]) * np.sign(size[1:]) < 0)
    if not at.size:
        return float("inf"), float("nan")
    share = size[at] / (size[at] - size[at + 1])
    first, turn = np.angle(-values[at]), np.angle(values[at + 1] / values[at])
    phase = np.angle(np.exp(1j * (first + share * turn)))
    worst = int(np.argmin(np.abs(phase)))
    return float(phase[worst]), float(
        grid[at[worst]] ** (1.0 - share[worst]) * grid[at[worst] + 1] ** share[worst]
    )


def _slower(
    design: Design, speed: LoopGains, t_sum: float, inertia: float
) -> Callable[[float], tuple[float, float]]:
    """Gains of a slower loop of the same method by a factor below one.

    Of given gains kp by it and ki by its square.
    """
    settings = design.control.speed_loop
    assert settings is not None
    if settings.method in ("given", "optimised"):
        return lambda factor: (speed.kp * factor, speed.ki * factor**2)
    return lambda factor: speed_pi(
        inertia, design.machine.friction, t_sum, calmer(settings, factor)
    )


def _advice(settings: SpeedLoopSettings, gains: tuple[float, float], factor: float) -> str:
    if settings.method in ("given", "optimised"):
        return (
            f"it holds with control.speed_loop.kp = {gains[0]:.4g} N m s/rad and ki = "
            f"{gains[1]:.4g} N m/rad"
        )
    return loop_advice("control.speed_loop", settings, factor)


def judge_observed(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains],
    observer: ReducedOrderObserver | None,
    position: PositionObserver | None,
) -> LoopGains:
    """The speed loop's gains with poles and margins as they are over the observer.

    Parameters
    ----------
    loops:
        i_d, i_q and speed, as tuned for an encoder.
    observer, position:
        One of them, or none: then the gains come back as they are.
    """
    speed, settings = loops[2], design.control.speed_loop
    assert settings is not None
    machine = linearised(design.machine)
    if position is not None:
        name = position.method.title
        estimator: Estimator = PositionEstimator(
            position.method, position.gains, position.t_s, position.machine
        )
    elif observer is not None:
        name, estimator = "reduced-order speed observer", SpeedEstimator(observer, machine)
    else:
        return speed
    assert machine.inertia is not None
    nyquist = np.pi / speed.t_s
    grid = np.geomspace(1e-5 * nyquist, nyquist, _POINTS)
    plants = _plants(design, loops[:2], estimator, grid)
    closed = [plant.closed(speed.kp, speed.ki) for plant in plants]
    margins = [loop_margins(loop.open_loop) for loop in closed]
    radius = np.array([abs(loop.closed.poles[0]) for loop in closed])
    phase = np.array([found.phase_margin for found in margins])
    worst = int(np.argmax(radius)) if np.max(radius) >= 1.0 else int(np.argmin(np.abs(phase)))
    crossover = np.array([found.crossover for found in margins])
    own = ObservedLoop(
        name,
        np.array([plant.omega for plant in plants]),
        crossover,
        phase,
        radius,
        worst,
        closed[worst],
        settings.phase_margin_min,
        float(crossover[worst]),
        "",
    )
    if not own.holds:
        slower = _slower(
            design, speed, speed_delay(loops[1], design.control.t_s, settings), machine.inertia
        )
        left, factor = _left(plants, grid, slower, settings.phase_margin_min)
        text = "" if factor is None else _advice(settings, slower(factor), factor)
        own = replace(own, left=left, advice=text)
    silent = DisturbanceResponse(np.nan, np.nan)
    return replace(
        speed,
        poles=closed[worst].closed.poles,
        margins=margins[worst],
        disturbance=silent,
        model=closed[worst],
        observed=own,
    )


def _left(
    plants: list[_Plant],
    grid: FloatArray,
    slower: Callable[[float], tuple[float, float]],
    required: float,
) -> tuple[float | None, float | None]:
    """Least crossover in rad/s over the speeds of the fastest loop that holds, and its factor.

    None where none does.
    """
    z = np.exp(1j * grid * plants[0].system.t_s)

    def found(factor: float, plant: _Plant) -> tuple[float, float]:
        kp, ki = slower(factor)
        return _margin(plant.response * (kp + ki * plant.system.t_s * z / (z - 1.0)), grid)

    def holds(factor: float) -> bool:
        gains = slower(factor)
        if not min(gains) > 0.0:
            return False
        return all(
            abs(plant.closed(*gains).closed.poles[0]) < 1.0
            and abs(found(factor, plant)[0]) >= required
            for plant in plants
        )

    factor = largest_factor(holds)
    if factor is None:
        return None, None
    return min(found(factor, plant)[1] for plant in plants), factor
