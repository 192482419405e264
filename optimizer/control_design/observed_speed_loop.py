"""The speed loop of a design judged as it runs: on the speed and in the angle of its observer.

The drive with its observer (`dqforge.optimizer.observed_drive`) is lifted to the
period of the speed controller and closed by its PI, at several speeds. Without an observer nothing
changes (`dqforge.optimizer.loops.gains`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.slower_speed_loop import (
    ROUNDED,
    slower_speed_pi,
    speed_advice,
)
from dqforge.optimizer.estimators.tracker_columns import TrackerEstimator
from dqforge.optimizer.loops.analysis import inertia_of
from dqforge.optimizer.loops.gains import speed_delay
from dqforge.optimizer.loops.observed_margins import ObservedLoop
from dqforge.optimizer.loops.pi_methods import largest_factor
from dqforge.optimizer.loops.plants import DisturbanceResponse, PiLoop, close_pi
from dqforge.optimizer.observed_drive.design_drive import (
    machine_top,
    observed_drive,
    position_estimator,
    reachable_speed,
    speed_estimator,
    top_speed,
)
from dqforge.optimizer.observed_drive.drive_cases import DriveCases, drive_cases
from dqforge.optimizer.observed_drive.fixed_points import SteadyDrives, steady_drives
from dqforge.optimizer.observed_drive.limit_cycle import limit_cycle
from dqforge.optimizer.observed_drive.speed_range import SpeedPi, judge_corners, settling
from dqforge.optimizer.observed_drive.stability_limits import (
    largest_stable_factor,
    least_pll_bandwidth,
)
from dqforge.optimizer.observed_drive.steps_borne import steps_borne
from dqforge.optimizer.observed_drive.tolerance_corners import (
    cases_of,
    corner_box,
    tracked_box,
)
from dqforge.optimizer.observed_drive.tuning_rule import speed_lag
from dqforge.optimizer.sampled_systems import (
    ComplexArray,
    SampledSystem,
    grid_crossings,
    lift,
    loop_margins,
)

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.machines.design.settings import SpeedLoopSettings
    from dqforge.optimizer.estimators.solve import TunedTracker
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observed_drive.drive_model import ObservedDrive
    from dqforge.optimizer.observed_drive.estimator_columns import Estimator
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.optimizer.observers.tuning import PositionObserver

_SHARES = np.array([0.1, 0.25, 0.5, 1.0])


_POINTS = 1500


_RESERVE = 1.5  # factor of the gains that the corners of a chosen loop bear


_CHOSEN_AT = (1.0, 0.4, 0.1)  # shares of the top speed, downwards


_FACTORS = tuple((0.8 ** np.arange(8)).tolist())  # a slower integral takes seconds after a step


@dataclass(frozen=True, slots=True, eq=False)
class _Plant:
    """The drive at one electrical speed in rad/s from torque to speed, per speed sample."""

    omega: float
    system: SampledSystem

    def closed(self, kp: float, ki: float) -> PiLoop:
        """With the PI around it."""
        return close_pi(self.system, kp, ki)


def _plants(steady: SteadyDrives, omega: FloatArray, ratio: int) -> list[_Plant]:
    found = []
    for place, speed in enumerate(omega.tolist()):
        system = lift(steady.system(place), ratio)
        wide = replace(system, b=np.hstack([system.b, np.zeros_like(system.b)]), d=np.zeros((1, 2)))
        found.append(_Plant(speed, wide))
    return found


def _margin(values: ComplexArray, grid: FloatArray) -> tuple[float, float]:
    """Least phase margin in rad and its crossover in rad/s by interpolation on the grid; (inf,
    nan) without one.
    """
    at, share, phase = grid_crossings(values)
    if not at.size:
        return float("inf"), float("nan")
    phase = np.angle(np.exp(1j * phase))
    worst = int(np.argmin(np.abs(phase)))
    return float(phase[worst]), float(
        grid[at[worst]] ** (1.0 - share[worst]) * grid[at[worst] + 1] ** share[worst]
    )


def _slower(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains],
    position: PositionObserver | None,
    tracker: TunedTracker | None,
) -> Callable[[float], tuple[float, float]]:
    """Gains of a slower loop of the same method by a factor below one."""
    settings, inertia = design.control.speed_loop, inertia_of(design.machine)
    assert settings is not None
    t_sum = speed_delay(loops[1], design.control.t_s, settings)
    if settings.counts_observer and position is not None:
        t_sum += speed_lag(position, t_sum, settings.spread)
    if settings.counts_observer and tracker is not None and tracker.loop is not None:
        t_sum += tracker.loop.lag
    return slower_speed_pi(settings, loops[2], t_sum, (inertia, design.machine.friction))


def held_by_corners(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains],
    position: PositionObserver,
) -> float | None:
    """Largest factor at which the rule's loop holds at every corner of the tolerances, and is
    stable there with `_RESERVE` times the gains; 1 where it is already, None where no slower one is
    at the top speed. Lower speeds at which no factor helps are left to the range.

    Args:
        design: With a speed loop.
        loops: i_d, i_q and speed, as tuned.
        position: The observer.
    """
    settings = design.control.speed_loop
    assert settings is not None
    machine, box = linearised(design.machine), corner_box(design)
    corners = (*box.corners(dead_time=False), *box.corners(dead_time=False, braking=True))
    drive = observed_drive(design, loops[:2], position_estimator(position))
    slower, inertia = _slower(design, loops, position, None), inertia_of(design.machine)

    def holds(steady: SteadyDrives, factor: float) -> bool:
        kp, ki = slower(factor)
        loop = SpeedPi(kp, ki, settings.ratio)
        stable = steady.radius(settings.ratio, _RESERVE * kp, _RESERVE * ki) < 1.0
        return bool(np.all(stable & (settling(steady, loop, inertia) >= 1.0)))

    top, chosen = top_speed(design), 1.0
    held: list[SteadyDrives] = []
    for share in _CHOSEN_AT:
        steady = steady_drives(drive, cases_of(machine, corners, share * top))
        every = [*held, steady]
        factor = next(
            (
                each
                for each in _FACTORS
                if each <= chosen and all(holds(one, each) for one in every)
            ),
            None,
        )
        if factor is None:
            break
        chosen, held = factor, every
    return chosen if held else None


def slower_advice(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains],
    position: PositionObserver,
    factor: float,
) -> str:
    """What to write for the loop that `held_by_corners` found."""
    settings = design.control.speed_loop
    assert settings is not None
    slower = _slower(design, loops, position, None)
    return speed_advice(settings, slower(ROUNDED * factor), factor)


def judge_observed(
    design: Design,
    loops: tuple[LoopGains, LoopGains, LoopGains],
    observer: ReducedOrderObserver | None,
    position: PositionObserver | None,
    tracker: TunedTracker | None = None,
    *,
    thorough: bool = True,
    slowed: float | None = None,
) -> LoopGains:
    """The speed loop's gains with poles and margins as they are over the observer.

    Args:
        loops: i_d, i_q and speed, as tuned for an encoder.
        observer, position, tracker: One of them, or none: then the gains come back as they are. So
            they do over a tracker that states no loop of its own; one with a loop is judged where
            it tracks.
        thorough: Whether corners are looked at, and what makes an unstable loop stable.
        slowed: Spread of the loop where `held_by_corners` chose it.
    """
    speed, settings = loops[2], design.control.speed_loop
    assert settings is not None
    machine = linearised(design.machine)
    if position is not None:
        name = position.method.title
        estimator: Estimator = position_estimator(position)
    elif observer is not None:
        name, estimator = "reduced-order speed observer", speed_estimator(observer, design)
    elif tracker is not None and tracker.loop is not None:
        name, estimator = tracker.tracker.title, TrackerEstimator(tracker.loop)
    else:
        return speed
    # exact data, no dead time, no load but friction
    top = top_speed(design) if tracker is None else min(top_speed(design), tracker.omega_high)
    least = 0.0 if tracker is None else tracker.omega_low
    cases = drive_cases(machine, np.maximum(_SHARES * top, least))
    drive = observed_drive(design, loops[:2], estimator)
    steady = steady_drives(drive, cases)
    plants = _plants(steady, cases.omega, settings.ratio)
    closed = [plant.closed(speed.kp, speed.ki) for plant in plants]
    margins = [loop_margins(loop.open_loop) for loop in closed]
    radius = np.array([abs(loop.closed.poles[0]) for loop in closed])
    phase = np.array([found.phase_margin for found in margins])
    worst = int(np.argmax(radius)) if np.max(radius) >= 1.0 else int(np.argmin(np.abs(phase)))
    crossover = np.array([found.crossover for found in margins])
    own = ObservedLoop(
        name,
        cases.omega,
        crossover,
        phase,
        radius,
        worst,
        closed[worst],
        settings.min_phase_margin,
        float(crossover[worst]),
        "",
        slowed=slowed,
        beyond=machine_top(design) if reachable_speed(design) < machine_top(design) else None,
    )
    slower = _slower(design, loops, position, tracker)
    if not own.holds:
        left, factor = _left(plants, slower, settings.min_phase_margin)
        text = "" if factor is None else speed_advice(settings, slower(ROUNDED * factor), factor)
        own = replace(own, left=left, advice=text)
    pi = SpeedPi(speed.kp, speed.ki, settings.ratio)
    if not own.stable and observer is None and thorough:
        own = _unstable(own, drive, position, (steady, cases), (settings, slower, pi))
    if observer is None and thorough:
        box = tracked_box(design) if position is None else corner_box(design)
        corners = judge_corners(drive, machine, pi, box, top, least)
        if corners.binding.any:
            steps = steps_borne(drive, machine, pi, box, corners.binding)
            corners = replace(corners, steps=steps)
        own = replace(own, corners=replace(corners, leaves=_leaves(design)))
    silent = DisturbanceResponse(np.nan, np.nan)
    return replace(
        speed,
        poles=closed[worst].closed.poles,
        margins=margins[worst],
        disturbance=silent,
        model=closed[worst],
        observed=own,
    )


def _leaves(design: Design) -> float | None:
    """Electrical speed in rad/s down to which the simulation stays on the observer."""
    wanted = None if design.simulation is None else design.simulation.sensorless
    return None if wanted is None else wanted.below * design.machine.pole_pairs


def _unstable(
    own: ObservedLoop,
    drive: ObservedDrive,
    position: PositionObserver | None,
    nominal: tuple[SteadyDrives, DriveCases],
    loop: tuple[SpeedLoopSettings, Callable[[float], tuple[float, float]], SpeedPi],
) -> ObservedLoop:
    """How an unstable loop swings, and what makes it stable."""
    (steady, cases), (settings, slower, pi) = nominal, loop
    factor = largest_stable_factor(steady, pi.ratio, slower)
    inertia = drive.data.machine.inertia
    assert inertia is not None
    return replace(
        own,
        cycle=limit_cycle(
            complex(own.loop.closed.poles[0]),
            own.loop.closed.t_s,
            drive.data.torque_max,
            inertia,
        ),
        stable_advice=""
        if factor is None
        else speed_advice(settings, slower(ROUNDED * factor), factor),
        pll_least=None if position is None else least_pll_bandwidth(drive, position, cases, pi),
    )


def _left(
    plants: list[_Plant],
    slower: Callable[[float], tuple[float, float]],
    required: float,
) -> tuple[float | None, float | None]:
    """Least crossover in rad/s over the speeds of the fastest loop that holds, and its factor.

    None where none does.
    """
    t_s = plants[0].system.t_s
    nyquist = np.pi / t_s
    grid = np.geomspace(1e-5 * nyquist, nyquist, _POINTS)
    z = np.exp(1j * grid * t_s)
    responses = {plant.omega: plant.system.response(grid) for plant in plants}

    def found(factor: float, plant: _Plant) -> tuple[float, float]:
        kp, ki = slower(factor)
        return _margin(responses[plant.omega] * (kp + ki * t_s * z / (z - 1.0)), grid)

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
