"""Operating points over torque and speed, their efficiency and the voltage limit behind them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.machine_loss import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.modulation.low_harmonics import LowHarmonics, low_harmonics
from dqforge.machines.names import ModulationName, OvermodulationName, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.linear_range import amplitude_limit, overmodulation_of
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.operating_points.characteristics import Characteristics
from dqforge.optimizer.operating_points.local_terms import LossCoefficients
from dqforge.optimizer.operating_points.loss_model import DriveLosses, drive_losses
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points


@dataclass(frozen=True, slots=True)
class VoltageLimit:
    """Where the voltage limit comes from: modulator, dc link in V, share kept free,
    the phase amplitude in V, the topology, and the method of overmodulation that is used.
    """

    modulation: ModulationName
    v_dc: float
    margin: float
    v_max: float
    topology: Topology = "three-wire"
    overmodulation: OvermodulationName = "none"

    @property
    def made_by(self) -> str:
        """Name of the modulator, or of the topology that has one of its own."""
        name = self.modulation if TOPOLOGIES[self.topology].modulated else self.topology
        return name if self.overmodulation == "none" else f"{name} with {self.overmodulation}"


@dataclass(frozen=True, slots=True)
class DrivePoints:
    """Operating points with their losses, all arrays of shape (N,).

    ``power`` is the mechanical power in W, negative where the machine brakes; ``efficiency`` as
    `efficiency` defines it, NaN without power. ``harmonics`` is what overmodulation adds, None
    where there is none.
    """

    points: OptimalPoints
    losses: DriveLosses
    power: FloatArray
    efficiency: FloatArray
    harmonics: LowHarmonics | None = None


@dataclass(frozen=True, slots=True)
class OperatingMap:
    """Operating points over a grid of N torques (N m) and M mechanical speeds (rad/s),
    arrays of shape (N, M).

    ``points`` and ``losses`` hold them row by row as arrays of shape (N M,). ``efficiency`` as
    `efficiency` defines it, NaN where the torque is not reached.
    """

    torque: FloatArray
    omega_m: FloatArray
    points: OptimalPoints
    losses: DriveLosses
    efficiency: FloatArray

    @property
    def loss(self) -> FloatArray:
        """Total loss in W, shape (N, M): machine, and with a device the inverter, too."""
        return self.losses.total.reshape(self.efficiency.shape)

    @property
    def with_inverter(self) -> bool:
        """Whether conduction and switching loss are counted."""
        return self.losses.with_inverter

    @property
    def best_efficiency(self) -> float:
        """Largest efficiency of all points; NaN where none has one."""
        return (
            float(np.nanmax(self.efficiency))
            if np.any(np.isfinite(self.efficiency))
            else float("nan")
        )


def voltage_limit(
    inverter: Inverter, modulation: ModulationName, margin: float = 0.0
) -> VoltageLimit:
    """Largest phase amplitude of the linear range of topology and modulator, or of overmodulation,
    less a margin (0 to 1) that is kept for control.

    Args:
        inverter: Topology, DC-link voltage, dead time and overmodulation.
        modulation: The modulator.
        margin: Share of 0 to 1 that is kept for control.
    """
    most = amplitude_limit(inverter, modulation, margin)
    method = overmodulation_of(inverter, modulation)
    return VoltageLimit(modulation, inverter.v_dc, margin, most, inverter.topology, method)


def efficiency(power: FloatArray, loss: FloatArray) -> FloatArray:
    """Power out over power in, any one shape, for mechanical power (negative:
    generating) and loss in W.

    Motoring P / (P + L), generating (|P| - L) / |P|; NaN without power, and where a generating
    machine loses more than the shaft brings, so that nothing comes out at either end.
    """
    size = np.abs(power)
    useful = (power > 0.0) | ((power < 0.0) & (loss <= size))
    put_in = np.where(power > 0.0, power + loss, size)
    given_out = np.where(power > 0.0, power, size - loss)
    return np.where(useful, given_out / np.where(useful, put_in, 1.0), np.nan)


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

    Args:
        machine, inverter, limit: The drive, and the voltage limit of its modulator.
        torque, omega_m: Torques in N m and mechanical speeds in rad/s of any sign; shapes that
            broadcast to (N,).
        i_max: Current limit in A (peak).
        loss: What is minimised, from `loss_coefficients` at the speeds; copper loss when None.
        extra: AC copper and iron loss, counted in the losses; ``loss`` says whether they are
            minimised, too.
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
    share = efficiency(power, losses.total)
    if limit.overmodulation == "none":
        return DrivePoints(points, losses, power, share)
    harmonics = low_harmonics(
        limit.overmodulation, machine, points.i_d, points.i_q, points.omega_m, v_dc=limit.v_dc
    )
    return DrivePoints(points, losses, power, share, harmonics)


def operating_map(
    machine: Machine,
    inverter: Inverter,
    limit: VoltageLimit,
    torque: FloatArray,
    omega_m: FloatArray,
    i_max: float,
    *,
    loss: LossCoefficients | None = None,
    extra: MachineLoss = NO_EXTRA_LOSS,
) -> OperatingMap:
    """Least-loss points over a grid, with the losses of the drive at them.

    Args:
        machine, inverter, limit: The drive, and the voltage limit of its modulator.
        torque, omega_m: Torques in N m, shape (N,), and mechanical speeds in rad/s, shape (M,), of
            any sign.
        i_max: Current limit in A (peak).
        loss: What is minimised, from `loss_coefficients` at the speeds, shape (M,); copper loss
            when None.
        extra: AC copper and iron loss, counted in the losses; ``loss`` says whether they are
            minimised, too.
    """
    wanted, speed = np.meshgrid(torque, omega_m, indexing="ij")
    found = drive_points(machine, inverter, limit, wanted, speed, i_max, loss=loss, extra=extra)
    share = np.where(found.points.reached, found.efficiency, np.nan).reshape(wanted.shape)
    return OperatingMap(torque, omega_m, found.points, found.losses, share)


def fastest_speed(
    machine: Machine, figures: Characteristics, limit: VoltageLimit, i_max: float
) -> float:
    """Speed in rad/s at which a map ends: that of the mechanics, or three times the base speed.

    Args:
        machine: Any machine; it may state a largest speed.
        figures: Its characteristics, with the base speed.
        limit: The voltage limit.
        i_max: Current limit in A (peak).

    Raises:
        NoSolutionError: The resistance drop takes the whole voltage even at standstill.
    """
    if machine.omega_m_max is not None:
        return machine.omega_m_max
    if figures.base_speed == 0.0:
        raise NoSolutionError(
            f"the resistance drop at {i_max:.4g} A takes more than the voltage limit of "
            f"{limit.v_max:.4g} V even at standstill, so that no map begins; give "
            "machine.max_speed, or a higher voltage"
        )
    return 3.0 * figures.base_speed
