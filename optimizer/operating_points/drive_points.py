"""Least-loss operating points of a drive with what they lose and what they give: at points
and over maps, asked in SI numbers.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import contradiction
from dqforge.optimizer.operating_points.characteristics import (
    Characteristics,
    Envelope,
    Loci,
    characteristics,
    envelope,
    envelope_speeds,
    loci,
)
from dqforge.optimizer.operating_points.local_terms import LossCoefficients
from dqforge.optimizer.operating_points.loss_model import (
    loss_coefficients,
)
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.operating_map import (
    DrivePoints,
    OperatingMap,
    VoltageLimit,
    drive_points,
    fastest_speed,
    operating_map,
    voltage_limit,
)
from dqforge.optimizer.operating_points.point_problem import Active
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points

# What is minimised: the copper loss, or that of machine and inverter together.
Objective = Literal["copper", "total"]


@dataclass(frozen=True, slots=True)
class LimitedDrive:
    """A machine, what feeds it, and within what.

    ``limit`` is the voltage limit of the modulator, ``i_max`` the current limit in A (peak),
    ``extra`` the AC copper and iron loss of the machine. The bridge counts among the losses where
    ``inverter`` has a device.
    """

    machine: Machine
    inverter: Inverter
    limit: VoltageLimit
    i_max: float
    extra: MachineLoss = NO_EXTRA_LOSS


@dataclass(frozen=True, slots=True)
class DriveMap:
    """The motoring quadrant of a drive: its figures, its envelope over speed, its loci,
    and the map between them.
    """

    drive: LimitedDrive
    objective: Objective
    figures: Characteristics
    envelope: Envelope
    loci: Loci
    chart: OperatingMap


def limited_drive(
    design: Design, modulation: ModulationName = "svpwm", margin: float = 0.0
) -> LimitedDrive:
    """The drive of a design, within the linear range of a modulator less a share of it
    that is kept for control.

    Args:
        design: Machine, current limit and inverter.
        modulation: The modulator.
        margin: Share of the voltage of 0 to 1 that is kept for control.

    Raises:
        InputError: The design's strategy is not MTPA, or its topology has another modulator of its
            own.
    """
    if design.strategy != "mtpa":
        raise InputError(
            "operation.strategy: operating points take the least loss, but it is id0; write "
            "strategy: mtpa"
        )
    found = contradiction("modulation", design.inverter.topology, modulation)
    if found:
        raise InputError(found)
    limit = voltage_limit(design.inverter, modulation, margin)
    return LimitedDrive(design.machine, design.inverter, limit, design.i_max, design.machine_loss)


def _minimised(
    drive: LimitedDrive, objective: Objective, omega_m: ArrayLike
) -> LossCoefficients | None:
    """What is minimised at speeds in rad/s: None for the copper loss."""
    if objective == "copper":
        return None
    return loss_coefficients(
        drive.machine,
        omega_m,
        drive.inverter,
        extra=drive.extra,
        modulation=drive.limit.modulation,
    )


def points_within(
    drive: LimitedDrive, torque: ArrayLike, omega_m: ArrayLike, objective: Objective = "copper"
) -> DrivePoints:
    """Least-loss points of a drive within its limits, and what it loses at them.

    Args:
        drive: The machine within its limits.
        torque, omega_m: In N m and rad/s (mechanical), any sign, broadcast together to N points.
        objective: What is minimised.

    Raises:
        InputError: A number is not finite, or a limit is not positive.
    """
    return drive_points(
        drive.machine,
        drive.inverter,
        drive.limit,
        torque,
        omega_m,
        drive.i_max,
        loss=_minimised(drive, objective, omega_m),
        extra=drive.extra,
    )


def most_torque(drive: LimitedDrive, omega_m: float, sign: float = 1.0) -> OptimalPoints:
    """The point of most torque of a sign (1 or -1) at a mechanical speed in rad/s.

    Args:
        drive: The drive within its limits.
        omega_m: Mechanical speed in rad/s.
        sign: 1 for driving, -1 for braking torque.

    Raises:
        NoSolutionError: No current within its limit keeps the voltage limit at this speed.
    """
    machine, limit, i_max = drive.machine, drive.limit, drive.i_max
    beyond = sign * 2.0 * float(mtpa_locus(machine, i_max).torque[-1])
    most = optimal_points(machine, beyond, omega_m, v_max=limit.v_max, i_max=i_max)
    if most.active[0] != Active.UNREACHABLE:
        return most
    last = characteristics(machine, limit.v_max, i_max).speed_max
    end = "" if last is None else f"; it can be kept up to {last * 30.0 / np.pi:.4g} rpm"
    raise NoSolutionError(
        f"at {omega_m * 30.0 / np.pi:.4g} rpm no current within {i_max:.4g} A keeps the voltage "
        f"limit of {limit.v_max:.4g} V{end}"
    )


def map_within(
    drive: LimitedDrive, torques: int, speeds: int, objective: Objective = "copper"
) -> DriveMap:
    """Operating points from standstill to the largest speed and from no torque to the most,
    with their limits.

    Args:
        drive: The machine within its limits.
        torques, speeds: Numbers of grid points, from 2 on.
        objective: What is minimised.

    Raises:
        NoSolutionError: The resistance drop takes the whole voltage even at standstill.
    """
    machine, v_max, i_max = drive.machine, drive.limit.v_max, drive.i_max
    figures = characteristics(machine, v_max, i_max)
    fastest = fastest_speed(machine, figures, drive.limit, i_max)
    omega_m = np.linspace(0.0, fastest, speeds)
    chart = operating_map(
        machine,
        drive.inverter,
        drive.limit,
        np.linspace(0.0, figures.torque_max, torques),
        omega_m,
        i_max,
        loss=_minimised(drive, objective, omega_m),
        extra=drive.extra,
    )
    edge = envelope(machine, v_max, envelope_speeds(machine, v_max, fastest, i_max), i_max)
    return DriveMap(drive, objective, figures, edge, loci(machine, v_max, i_max), chart)
