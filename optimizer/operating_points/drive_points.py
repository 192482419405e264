"""Least-loss operating points of a drive with what they lose and what they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.optimizer.operating_points.characteristics import VoltageLimit, efficiency
from dqforge.optimizer.operating_points.local_terms import LossCoefficients
from dqforge.optimizer.operating_points.loss_model import DriveLosses, drive_losses
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points


@dataclass(frozen=True, slots=True)
class DrivePoints:
    """Operating points with their losses, all arrays of shape (N,).

    ``power`` is the mechanical power in W, negative where the machine brakes; ``efficiency`` as
    `efficiency` defines it, NaN without power.
    """

    points: OptimalPoints
    losses: DriveLosses
    power: FloatArray
    efficiency: FloatArray


def drive_points(
    machine: Machine,
    inverter: Inverter,
    limit: VoltageLimit,
    torque: ArrayLike,
    omega_m: ArrayLike,
    i_max: float,
    *,
    loss: LossCoefficients | None = None,
    extra: MachineLoss = NO_EXTRA_LOSS,
) -> DrivePoints:
    """Least-loss points with the losses of the drive at them.

    Parameters
    ----------
    machine, inverter, limit:
        The drive, and the voltage limit of its modulator.
    torque, omega_m:
        Torques in N m and mechanical speeds in rad/s of any sign; shapes that broadcast to (N,).
    i_max:
        Current limit in A (peak).
    loss:
        What is minimised, from `loss_coefficients` at the speeds; copper loss when None.
    extra:
        AC copper and iron loss, counted in the losses; ``loss`` says whether they are minimised,
        too.
    """
    points = optimal_points(machine, torque, omega_m, v_max=limit.v_max, i_max=i_max, loss=loss)
    losses = drive_losses(
        machine,
        inverter,
        points.i_d,
        points.i_q,
        points.omega_m,
        modulation=limit.modulation,
        extra=extra,
    )
    power = np.asarray(points.torque * points.omega_m)
    return DrivePoints(points, losses, power, efficiency(power, losses.total))
