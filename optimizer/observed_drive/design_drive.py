"""The drive of a design on its observer, as `fixed_points.steady_drives` takes it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.settings import filter_share
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.optimizer.observed_drive.drive_model import DriveData, ObservedDrive
from dqforge.optimizer.observed_drive.estimator_columns import (
    Estimator,
    PositionEstimator,
    SpeedEstimator,
)
from dqforge.optimizer.observers.tuning_numbers import LARGEST_TURN
from dqforge.optimizer.operating_points.characteristics import free_largest_speed
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.optimizer.observers.tuning import PositionObserver
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
