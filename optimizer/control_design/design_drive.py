"""The drive of a design on its observer, as `fixed_points.steady_drives` takes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.settings import filter_share
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import OBSERVER_KEYS
from dqforge.machines.plants.scenario import plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.drive_model import (
    DriveData,
    Estimator,
    ObservedDrive,
    PositionEstimator,
    SpeedEstimator,
)
from dqforge.optimizer.control_design.speed_range import SteadyDrives, steady_drives
from dqforge.optimizer.loops.pi_methods import largest_factor
from dqforge.optimizer.observers.parts import LARGEST_TURN, SteadyObserver, steady_observer
from dqforge.optimizer.observers.pll import FASTEST, PllGains
from dqforge.optimizer.observers.tuning import PositionObserver, retuned
from dqforge.optimizer.operating_points.characteristics import free_largest_speed
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.drive_model import DriveCases
    from dqforge.optimizer.control_design.speed_range import SpeedPi
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.optimizer.sampled_systems import ComplexArray


_KNOTS = 201


def position_estimator(position: PositionObserver) -> PositionEstimator:
    """A tuned position observer as columns of a drive's state."""
    return PositionEstimator(position.method, position.gains, position.t_s, position.machine)


def speed_estimator(observer: ReducedOrderObserver, design: Design) -> SpeedEstimator:
    """The reduced-order observer of a design as columns of a drive's state."""
    return SpeedEstimator(observer, linearised(design.machine))


def current_locus(choice: CurrentChoice) -> Callable[[FloatArray], ComplexArray]:
    """i_d + j i_q in A over torques in N m, by splines through the currents of a strategy.

    Beyond the largest torque they go on: there the firmware limits the torque, not they.
    """
    from scipy.interpolate import CubicSpline

    torques = np.linspace(-1.0, 1.0, _KNOTS) * choice.largest_torque()
    points = choice.points(torques)
    d, q = CubicSpline(torques, points.i_d), CubicSpline(torques, points.i_q)
    return lambda torque: np.asarray(d(torque) + 1j * q(torque), dtype=np.complex128)


def observed_drive(
    design: Design, current_loops: tuple[LoopGains, LoopGains], estimator: Estimator
) -> ObservedDrive:
    """A design's control with an estimator, on the machine as the design has it (linear).

    Args:
        design: With a speed loop.
        current_loops: Gains of i_d and i_q.
        estimator: What tells speed and angle.
    """
    control, settings = design.control, design.control.speed_loop
    machine = linearised(design.machine)
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)
    share = 1.0 if settings is None else filter_share(settings.filter_time, control.t_s)
    d, q = current_loops
    gains = ((d.kp, d.ki_ts), (q.kp, q.ki_ts))
    most = choice.largest_torque()
    return ObservedDrive(
        DriveData(machine, control.t_s, gains, current_locus(choice), most, share), estimator
    )


def machine_top(design: Design) -> float:
    """Largest electrical speed in rad/s that the design names."""
    machine, bases = design.machine, design.control.bases
    omega_m = bases.speed if machine.omega_m_max is None else machine.omega_m_max
    return machine.pole_pairs * omega_m


def reachable_speed(design: Design) -> float:
    """Electrical speed in rad/s up to which the dc link has the voltage without load; inf where
    nothing ends it. With field weakening that of any currents within their limit.
    """
    machine = linearised(design.machine)
    if design.weakening is not None:
        found = free_largest_speed(machine, design.v_max, design.i_max)
        return np.inf if found is None else found
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)
    locus, friction = current_locus(choice), machine.friction / machine.pole_pairs

    def excess(omega: float) -> float:
        torque = np.array([min(friction * omega, choice.largest_torque())])
        i = complex(locus(torque)[0])
        psi = machine.psi_pm + machine.l_d * i.real + 1j * machine.l_q * i.imag
        return abs(machine.r_s * i + 1j * omega * psi) - design.v_max

    low, high = 0.0, machine_top(design)
    if excess(high) <= 0.0:
        return np.inf
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) <= 0.0 else (low, middle)
    return low


def top_speed(design: Design) -> float:
    """Largest electrical speed in rad/s: that of the machine, as far as the dc link reaches it and
    sampling lets it be observed.
    """
    observed = LARGEST_TURN / design.control.t_s
    return min(machine_top(design), reachable_speed(design), observed)


# Speed loop and position observer chosen together, where a design leaves both open.
#
# The speed that a phase-locked loop hands over is its integral: it follows the true speed as
# w^2/(s^2 + 2 zeta w s + w^2), late by 2 zeta/w. The symmetrical optimum of the speed loop counts
# that among its small delays, T = 1/omega_cc + ratio t_s/2 + filter time + 2 zeta/w. Methods
# without such a loop are as late as their own phase is at the crossover 1/(a T) that the rule then
# has.

_SHARE = 0.5  # of the largest speed, at which a lag is found


_PER_SECOND = 0.1  # acceleration over the largest speed in 1/s, small enough to change nothing else


_ROUNDS = 60


def has_loop(position: PositionObserver) -> bool:
    """Whether the speed of an observer is that of a phase-locked loop."""
    return isinstance(getattr(position.gains, "pll", None), PllGains)


def speed_lag(position: PositionObserver, delays: float, spread: float) -> float:
    """By how much a position observer tells a changing speed too late, in s.

    Args:
        position: The observer.
        delays: The other small delays of the speed loop in s.
        spread: That of the symmetrical optimum.
    """
    if has_loop(position):
        return 2.0 * position.tuning.damping / position.tuning.pll_bandwidth
    errors, lag = speed_errors(position), 0.0
    for _ in range(_ROUNDS):
        crossover = 1.0 / (spread * (delays + lag))
        phase = -float(np.angle(errors.following(np.array([crossover]))[0]))
        lag = 0.5 * (lag + max(phase, 0.0) / crossover)
    return lag


@dataclass(frozen=True, slots=True, eq=False)
class SpeedErrors:
    """Errors e of an observer at a changing speed, e[k] = J e[k-1] + g (omega[k] - omega[k-1]).

    ``jacobian`` J (n, n), ``by_change`` g (n,); the last of the errors is that of the speed.
    """

    t_s: float
    jacobian: FloatArray
    by_change: FloatArray

    def following(self, frequency: FloatArray) -> ComplexArray:
        """Estimated over true speed at frequencies in rad/s, shape (N,)."""
        one, back = np.eye(len(self.jacobian)), np.exp(-1j * frequency * self.t_s)
        matrices = one - back[:, None, None] * self.jacobian
        sides = np.broadcast_to(self.by_change[:, None], (len(back), len(one), 1))
        errors = np.linalg.solve(matrices, sides)[:, -1, 0]
        return np.asarray(1.0 + (1.0 - back) * errors, dtype=np.complex128)


@lru_cache(maxsize=8)
def speed_errors(position: PositionObserver) -> SpeedErrors:
    """Those of a position observer without current; a constant acceleration, in which they rest,
    tells g.
    """
    rest, up, down = (_steady(position, sign) for sign in (0.0, 1.0, -1.0))
    jacobian = rest.jacobian[0]
    per_sample = 2.0 * _PER_SECOND * position.omega_max * position.t_s
    change = (up.states[0] - down.states[0]) / per_sample
    return SpeedErrors(position.t_s, jacobian, (np.eye(len(jacobian)) - jacobian) @ change)


def _steady(position: PositionObserver, sign: float) -> SteadyObserver:
    return steady_observer(
        position.method, position.gains, position.t_s, plants(position.machine),
        np.zeros(1, dtype=np.complex128), np.array([_SHARE * position.omega_max]),
        sign * _PER_SECOND * position.omega_max,
    )  # fmt: skip


# How far a speed loop on an observer is from being stable: by its gains, or by the observer's.

_TRIALS = 24


def largest_stable_factor(
    steady: SteadyDrives, ratio: int, slower: Callable[[float], tuple[float, float]]
) -> float | None:
    """Largest factor below one at which a loop is stable in all steady states; None without one.

    Args:
        steady: Of the drives.
        ratio: Current samples per speed sample.
        slower: (kp, ki) of the loop slowed down by a factor.
    """

    def holds(factor: float) -> bool:
        gains = slower(factor)
        return min(gains) > 0.0 and bool(np.all(steady.radius(ratio, *gains) < 1.0))

    return largest_factor(holds)


def least_pll_bandwidth(
    drive: ObservedDrive, position: PositionObserver, cases: DriveCases, speed: SpeedPi
) -> float | None:
    """Least bandwidth in rad/s above the present one of the observer's phase-locked loop with
    which a speed loop as it is becomes stable; None without one.

    Args:
        drive: With the observer as it is.
        position: The observer.
        cases: Speeds at which the loop has to be stable.
        speed: The speed controller.
    """
    if not has_loop(position) or "pll_bandwidth" not in OBSERVER_KEYS[position.method.name]:
        return None

    def stable(bandwidth: float) -> bool:
        other = retuned(position, replace(position.tuning, pll_bandwidth=bandwidth))
        moved = replace(drive, estimator=position_estimator(other))
        steady = steady_drives(moved, cases)
        return bool(np.all(steady.radius(speed.ratio, speed.kp, speed.ki) < 1.0))

    low = position.tuning.pll_bandwidth
    most = FASTEST / position.t_s
    for high in np.geomspace(low, most, _TRIALS).tolist()[1:]:
        if stable(high * (1.0 - 1e-9)):
            break
        low = high
    else:
        return None
    for _ in range(10):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if stable(middle) else (middle, high)
    return float(high)
