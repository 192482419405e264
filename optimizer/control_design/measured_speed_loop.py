"""The speed loop of a design on the speed that it measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import format_quantity, to_digits
from dqforge.optimizer.control_design.design_drive import (
    largest_stable_factor,
    least_pll_bandwidth,
    machine_top,
    observed_drive,
    position_estimator,
    reachable_speed,
    speed_estimator,
    speed_lag,
    top_speed,
)
from dqforge.optimizer.control_design.drive_model import DriveCases, drive_cases
from dqforge.optimizer.control_design.speed_range import (
    SpeedPi,
    SteadyDrives,
    cases_of,
    corner_box,
    judge_corners,
    limit_cycle,
    settling,
    steady_drives,
    steps_borne,
    tracked_box,
)
from dqforge.optimizer.estimators import TrackerEstimator
from dqforge.optimizer.loops.loop_gains import inertia_of, speed_delay, speed_model
from dqforge.optimizer.loops.observed_margins import DeadTimeCycle, ObservedLoop
from dqforge.optimizer.loops.pi_methods import calmer, largest_factor, loop_advice, speed_pi
from dqforge.optimizer.loops.plants import DisturbanceResponse, Edges, PiLoop, SpeedLoop, close_pi
from dqforge.optimizer.observers.conditions import lost_voltage
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
    from dqforge.machines.design.settings import SpeedLoopSettings, SpeedMeasurementSettings
    from dqforge.optimizer.control_design.drive_model import Estimator, ObservedDrive
    from dqforge.optimizer.estimators import TunedTracker
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.optimizer.observers.tuning import PositionObserver


_SHARES = np.array([0.02, 0.05, 0.1, 0.25, 0.5, 1.0])


_POINTS = 4000


_BISECTIONS = 40


_WHERE = "control.speed_loop.measurement"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSpeed:
    """What a measurement of the speed is like, and the speed loop with it.

    ``omega_m`` are mechanical speeds in rad/s, ``delay`` in s, ``resolution`` in rad/s,
    ``phase_margin`` in rad of the speed loop with the delay, all of shape (S,). ``lowest`` is the
    speed in rad/s from which the loop has the margin ``required`` in rad up to the largest speed of
    the drive.
    """

    edges: Edges
    omega_m: FloatArray
    delay: FloatArray
    resolution: FloatArray
    phase_margin: FloatArray
    lowest: float
    required: float

    @property
    def settings(self) -> SpeedMeasurementSettings:
        """Encoder and timer."""
        return self.edges.settings


def _margin(delayed: ComplexArray) -> float:
    """Least phase margin in rad of an open loop over a grid; endless without a crossover."""
    _, _, phase = grid_crossings(delayed)
    return float(np.min(phase, initial=np.inf))


class _Judge:
    """Phase margins of one loop over the speed."""

    def __init__(self, loop: PiLoop, edges: Edges) -> None:
        self._edges = edges
        nyquist = np.pi / edges.period
        self._omega = np.geomspace(1e-5 * nyquist, nyquist, _POINTS)
        self._values = loop.open_loop.response(self._omega)

    def __call__(self, omega_m: float) -> float:
        """Phase margin in rad at a mechanical speed in rad/s."""
        return _margin(self._values * self._edges.response(omega_m, self._omega))


def _sampled(loop: PiLoop | SpeedLoop) -> PiLoop:
    return loop.loop if isinstance(loop, SpeedLoop) else loop


def _lowest(judge: _Judge, required: float, bottom: float, top: float) -> float:
    """Least speed in rad/s from which the margin holds, given that it does at ``top``."""
    if judge(bottom) >= required:
        return bottom
    low, high = bottom, top
    for _ in range(_BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if judge(middle) >= required else (middle, high)
    return high


def _advice(design: Design, loops: tuple[LoopGains, LoopGains], edges: Edges) -> str:
    """What to write for a loop that holds; empty where no slower one does."""
    control, (i_q, speed) = design.control, loops
    settings = control.speed_loop
    assert settings is not None
    slower = slower_speed_pi(
        settings,
        speed,
        speed_delay(i_q, control.t_s, settings),
        (inertia_of(design.machine), design.machine.friction),
    )

    def holds(factor: float) -> bool:
        gains = slower(factor)
        if not min(gains) > 0.0:
            return False
        model = _sampled(speed_model(design.machine, i_q, control, gains))
        margin = _Judge(model, edges)(edges.settings.omega_from)
        return bool(np.abs(model.closed.poles[0]) < 1.0) and margin >= settings.min_phase_margin

    factor = largest_factor(holds)
    return "" if factor is None else speed_advice(settings, slower(ROUNDED * factor), factor)


def _require_range(edges: Edges) -> None:
    """Refuse a timer that runs over, and a lowest speed that counts as rest."""
    own, longest = edges.settings, edges.longest_period
    if edges.period > longest:
        clock = longest * own.clock / edges.period
        raise NoSolutionError(
            f"{_WHERE}: a timer of {own.counter_bits} bits overflows after "
            f"{format_quantity(longest, 's', 3)}, the speed is needed every "
            f"{format_quantity(edges.period, 's', 3)}; write a clock of "
            f"{format_quantity(to_digits(clock, 3, up=False), 'Hz', 3)} or less, or "
            "counter_bits: 32"
        )
    if own.omega_from < edges.least:
        raise NoSolutionError(
            f"{_WHERE}: below {format_quantity(edges.least, 'rpm', 3)} the shaft counts as at "
            f"rest, lowest is {format_quantity(own.omega_from, 'rpm', 3)}; write a faster one, or "
            "more lines"
        )


def measured_speed(design: Design, i_q: LoopGains, speed: LoopGains | None) -> MeasuredSpeed | None:
    """The speed loop with the delay of its measurement; None where the speed counts as exact.

    Args:
        design: Its ``control.speed_loop.measurement`` names encoder and timer.
        i_q, speed: The loops as tuned.

    Raises:
        NoSolutionError: The timer runs over within a speed period, or the loop has less margin than
            required at the speed from which it must hold; says what would.
    """
    settings = design.control.speed_loop
    if speed is None or settings is None or settings.measurement is None:
        return None
    edges, required = Edges(settings.measurement, speed.t_s), settings.min_phase_margin
    _require_range(edges)
    judge, lowest = _Judge(_sampled(speed.model), edges), edges.settings.omega_from
    if (reached := judge(lowest)) < required:
        advice = _advice(design, (i_q, speed), edges)
        delay = float(edges.mean_delay(np.array(lowest)))
        raise NoSolutionError(
            f"{_WHERE}: at {format_quantity(lowest, 'rpm', 3)} the speed is known "
            f"{format_quantity(delay, 's', 3)} late, which leaves the speed loop "
            f"{np.degrees(reached):.1f} deg of phase margin, {np.degrees(required):.3g} deg are "
            f"required; " + (advice or "no slower loop of this method has them: more lines")
        )
    machine = design.machine
    top = design.control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    omega_m = _SHARES * top
    return MeasuredSpeed(
        edges,
        omega_m,
        edges.mean_delay(omega_m),
        edges.resolution(omega_m),
        np.array([judge(float(omega)) for omega in omega_m]),
        _lowest(judge, required, min(1e-3 * top, lowest), lowest),
        required,
    )


# The speed loop of a design judged as it runs: on the speed and in the angle of its observer.
#
# The drive with its observer (`dqforge.optimizer.control_design.drive_model`) is lifted to the
# period of the speed controller and closed by its PI, at several speeds. Without an observer
# nothing changes (`dqforge.optimizer.loops.loop_gains`).

_OBSERVED_SHARES = np.array([0.1, 0.25, 0.5, 1.0])


_OBSERVED_POINTS = 1500


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


def _observed_margin(values: ComplexArray, grid: FloatArray) -> tuple[float, float]:
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
    cases = drive_cases(machine, np.maximum(_OBSERVED_SHARES * top, least))
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
    if own.stable and thorough:
        own = replace(own, relay=_relay(design, drive, pi, slower))
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


# What a dead time does to a loop over an observer that knows nothing of it: a relay in the voltage
# along the current, taken as a resistance of the plant alone.

_RELAY_POINTS, _BEYOND = 40, 30.0
# Share of the current limit below which a phase takes less than its whole dead time.
_SOFT = 0.02
_SLOWEST = 12  # Halvings of the gain by two steps each.


def _relay(
    design: Design,
    drive: ObservedDrive,
    pi: SpeedPi,
    slower: Callable[[float], tuple[float, float]],
) -> DeadTimeCycle | None:
    """The swing that a dead time keeps up without load at the lowest speed that is judged; None
    where it keeps up none.
    """
    lost, machine = max(lost_voltage(design)), drive.data.machine
    if not lost > 0.0 or machine.inertia is None:
        return None
    omega = float(_OBSERVED_SHARES[0]) * top_speed(design)
    # From far beyond the current limit, where next to nothing is lost, down to where a phase takes
    # less than its whole dead time.
    size = np.geomspace(_BEYOND * design.i_max, _SOFT * design.i_max, _RELAY_POINTS)
    grid = 4.0 * lost / (np.pi * size)
    cases = drive_cases(machine, np.full(grid.shape, omega), errors={"r_s": grid / machine.r_s})
    plants = _plants(steady_drives(drive, cases), cases.omega, pi.ratio)

    def poles(plant: _Plant, gains: tuple[float, float]) -> complex:
        return complex(plant.closed(*gains).closed.poles[0])

    def swings(gains: tuple[float, float]) -> int | None:
        """The first point that is not stable behind one that is."""
        sizes = [abs(poles(plant, gains)) for plant in plants]
        bad = next((n for n, radius in enumerate(sizes) if not radius < 1.0), 0)
        return bad or None

    gains = (pi.kp, pi.ki)
    at = swings(gains)
    if at is None:
        return None
    pole, period = poles(plants[at], gains), plants[at].closed(*gains).closed.t_s
    turning = abs(float(np.angle(pole)))
    if not turning > 0.0:
        return None
    # Beyond the current limit the torque is limited.
    free = float(np.sqrt(size[at - 1] * size[at]))
    current = min(free, design.i_max)
    omega_cycle = turning / period
    swing = 2.0 * machine.torque_per_ampere * current / (machine.inertia * omega_cycle)
    found = DeadTimeCycle(
        lost,
        4.0 * lost / (np.pi * free),
        current,
        omega_cycle,
        float(swing),
        limited=free > design.i_max,
    )
    factors = (0.5 ** (0.5 * step) for step in range(1, _SLOWEST + 1))
    factor = next((each for each in factors if swings(slower(each)) is None), None)
    if factor is None:
        return found
    loop = design.control.speed_loop
    assert loop is not None
    return replace(found, factor=factor, advice=speed_advice(loop, slower(factor), factor))


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
    grid = np.geomspace(1e-5 * nyquist, nyquist, _OBSERVED_POINTS)
    z = np.exp(1j * grid * t_s)
    responses = {plant.omega: plant.system.response(grid) for plant in plants}

    def found(factor: float, plant: _Plant) -> tuple[float, float]:
        kp, ki = slower(factor)
        return _observed_margin(responses[plant.omega] * (kp + ki * t_s * z / (z - 1.0)), grid)

    def holds(factor: float) -> bool:
        gains = slower(factor)
        if not min(gains) > 0.0:
            return False
        # One that is too slow to have a crossover on the grid is no advice.
        return all(
            abs(plant.closed(*gains).closed.poles[0]) < 1.0
            and np.inf > abs(found(factor, plant)[0]) >= required
            for plant in plants
        )

    factor = largest_factor(holds)
    if factor is None:
        return None, None
    return min(found(factor, plant)[1] for plant in plants), factor


# Slower speed loops of the same method, and how to ask for one.

# Share of the largest factor for which gains are printed: their four digits may round it up.
ROUNDED = 0.998


def slower_speed_pi(
    settings: SpeedLoopSettings, speed: LoopGains, t_sum: float, mechanics: tuple[float, float]
) -> Callable[[float], tuple[float, float]]:
    """Gains (kp in N m s/rad, ki in N m/rad) of a slower loop by a factor below one.

    Of gains that follow from no rule kp by the factor and ki by its square.

    Args:
        settings, speed: How the loop is tuned, and its gains.
        t_sum: Sum of the small delays in s.
        mechanics: Inertia in kg m^2 and friction in N m s.
    """
    if settings.method in ("given", "optimised"):
        return lambda factor: (speed.kp * factor, speed.ki * factor**2)
    return lambda factor: speed_pi(*mechanics, t_sum, calmer(settings, factor))


def speed_advice(settings: SpeedLoopSettings, gains: tuple[float, float], factor: float) -> str:
    """What to write for the slower loop.

    Args:
        settings: How the loop is tuned.
        gains: Of the slower loop.
        factor: The factor that made it.
    """
    if settings.method in ("given", "optimised"):
        return (
            f"it holds with control.speed_loop.kp = {gains[0]:.4g} N m s/rad and ki = "
            f"{gains[1]:.4g} N m/rad"
        )
    return loop_advice("control.speed_loop", settings, factor)
