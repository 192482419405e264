"""Losses of a fixed header on other machines than it was made for.

At a point the firmware is asked for a torque, and the currents of the header flow, in every machine
the same ones: what differs is what these currents cost there. A machine whose torque falls short
thereby looks no better than it is, since its torque error says so beside it. The DC link has the
voltage of the inverter given, whatever is drawn for the gain of the loops: losses are stated at
points of operation, of which the voltage is one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import InputError
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, drive_budget
from dqforge.optimizer.yields.fixed_header import FixedHeader
from dqforge.optimizer.yields.reference_yield import Machines, ReferencePoints, reference_points


@dataclass(frozen=True, slots=True)
class FixedDrive:
    """What is round every machine: the header that all are flashed with, the inverter that feeds
    them, and what is counted beside copper, conduction and switching.
    """

    header: FixedHeader
    inverter: Inverter
    options: BudgetOptions


def point_currents(header: FixedHeader, torque: FloatArray) -> ReferencePoints:
    """Currents of the header at points of operation.

    Args:
        header: The header.
        torque: Torques in N m that are asked for, shape (P,).

    Raises:
        InputError: A point lies beyond the end of the header.
    """
    for place, asked in enumerate(torque.tolist()):
        if abs(asked) > header.torque_max * (1.0 + 1e-6):
            raise InputError(
                f"losses.points.{place}: {asked:g} N m is beyond the {header.torque_max:g} N m at "
                "which the header clamps the torque; write a smaller torque"
            )
    return reference_points(header, torque)


def header_budget(
    drive: FixedDrive,
    machines: Machines,
    torque: FloatArray,
    omega_m: FloatArray,
    modulations: Sequence[ModulationName],
) -> DriveBudget:
    """Budget of N machines at P points with M modulators, arrays (M, 1, N P): the points of the
    first machine, then those of the second.

    Args:
        drive: Header and inverter.
        machines: N machines.
        torque, omega_m: Torques in N m that are asked for, and mechanical speeds in rad/s, shape
            (P,).
        modulations: M modulators.

    Raises:
        InputError: As `point_currents`.
    """
    points = point_currents(drive.header, torque)
    count = machines.count
    return drive_budget(
        machines.repeated(torque.size),
        drive.inverter,
        np.tile(points.i_d, count),
        np.tile(points.i_q, count),
        np.tile(omega_m, count),
        modulations,
        options=drive.options,
    )
