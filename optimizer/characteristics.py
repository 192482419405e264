"""What a machine can do over speed: limits of torque and power, base speed, characteristic current, largest speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqforge.machines.inverter import Inverter
from dqforge.machines.modulation import linear_limit
from dqforge.machines.settings import ModulationName
from dqforge.machines.synchronous import FloatArray, LinearMachine, Machine, copper_loss
from dqforge.optimizer.feasible_region import least_flux_current, make_limits
from dqforge.optimizer.loss_budget import loss_budget
from dqforge.optimizer.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points import OptimalPoints, optimal_points

_FASTEST = 1e6
"""Electrical speed in rad/s beyond which a machine is said to have no largest speed."""


@dataclass(frozen=True, slots=True)
class Characteristics:
    """Figures of a machine under a current and a voltage limit.

    ``torque_max`` in N m at low speed; ``base_speed`` in rad/s (mechanical), where it meets the voltage limit;
    ``characteristic_current`` in A whose d-axis flux cancels the magnet (None without magnet, or beyond a map);
    ``speed_max`` in rad/s up to which the voltage limit can be kept (None where there is no end); ``power_max`` in W,
    the largest mechanical power found, at ``power_speed`` in rad/s.
    """

    torque_max: float
    base_speed: float
    characteristic_current: float | None
    speed_max: float | None
    power_max: float
    power_speed: float


@dataclass(frozen=True, slots=True)
class VoltageLimit:
    """Where the voltage limit comes from: modulator, dc link in V, share kept free, and the phase amplitude in V."""

    modulation: ModulationName
    v_dc: float
    margin: float
    v_max: float


@dataclass(frozen=True, slots=True)
class OperatingMap:
    """Operating points over a grid of N torques (N m) and M mechanical speeds (rad/s), arrays of shape (N, M).

    ``points`` holds them row by row as arrays of shape (N M,). ``loss`` in W is copper loss, and with a device
    conduction and switching loss, too; ``efficiency`` is mechanical power over itself plus loss, NaN where the torque
    is not reached or there is no power.
    """

    torque: FloatArray
    omega_m: FloatArray
    points: OptimalPoints
    loss: FloatArray
    efficiency: FloatArray
    with_inverter: bool


@dataclass(frozen=True, slots=True)
class Envelope:
    """Largest motoring torque over speed: points of shape (N,), their speeds ascending.

    ``weakening_torque`` in N m and ``weakening_speed`` in rad/s, shape (L,), are the line along which the MTPA currents
    take the voltage limit: to its right the field is weakened.
    """

    points: OptimalPoints
    weakening_torque: FloatArray
    weakening_speed: FloatArray

    @property
    def power(self) -> FloatArray:
        """Mechanical power in W, shape (N,)."""
        return self.points.torque * self.points.omega_m


def limit_speed(machine: Machine, i_d: FloatArray, i_q: FloatArray, v_max: float) -> FloatArray:
    """Mechanical speed in rad/s at which currents in A, shape (N,), take the phase voltage v_max in V.

    With the resistance drop |v|^2 = R^2 |i|^2 + 2 R omega (psi_d i_q - psi_q i_d) + omega^2 |psi|^2 is quadratic in the
    speed; zero where the drop alone takes more, inf without flux.
    """
    psi_d, psi_q = machine.flux(i_d, i_q)
    square, half = psi_d**2 + psi_q**2, machine.r_s * (psi_d * i_q - psi_q * i_d)
    rest = v_max**2 - machine.r_s**2 * (i_d**2 + i_q**2)
    root = half + np.sqrt(np.maximum(half**2 + square * rest, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        omega_e = np.where(rest > 0.0, rest / root, 0.0)
    return np.asarray(np.where(root > 0.0, omega_e, np.inf) / machine.pole_pairs)


def _largest_speed(machine: Machine, v_max: float, i_max: float) -> float | None:
    """Largest electrical speed in rad/s at which any current of the limit keeps the voltage limit, or None."""

    def kept(omega_e: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        volts = np.full_like(omega_e, v_max)
        limits = make_limits(machine, omega_e, volts, i_max)
        return np.asarray(limits.voltage_square(limits.centre_d, limits.centre_q) < volts**2)

    low, high = 0.0, _FASTEST
    if kept(np.array([high]))[0]:
        return None
    # A bundle of 64 trial speeds per step narrows the bracket by nearly two digits each time, down to rounding.
    for _ in range(9):
        trial = np.linspace(low, high, 64)
        held = np.flatnonzero(kept(trial))
        last = int(held[-1]) if held.size else 0
        low, high = float(trial[last]), float(trial[min(last + 1, 63)])
    return low


def _characteristic_current(machine: Machine, i_max: float) -> float | None:
    """Current in A (peak) along -d that cancels the magnet's flux; None without magnet, or where a map ends before."""
    if machine.psi_pm == 0.0:
        return None
    if isinstance(machine, LinearMachine):
        return machine.psi_pm / machine.l_d
    current = abs(least_flux_current(machine, i_max))
    return current if current < (1.0 - 1e-5) * i_max else None


def envelope(machine: Machine, v_max: float, omega_m: FloatArray, i_max: float | None = None) -> Envelope:
    """Largest motoring torque at mechanical speeds in rad/s, shape (N,), for a phase-voltage limit in V."""
    limit = machine.i_max if i_max is None else i_max
    locus = mtpa_locus(machine, limit)
    points = optimal_points(machine, 2.0 * float(locus.torque[-1]), omega_m, v_max=v_max, i_max=limit)
    return Envelope(points, locus.torque, limit_speed(machine, locus.i_d, locus.i_q, v_max))


def characteristics(machine: Machine, v_max: float, i_max: float | None = None) -> Characteristics:
    """Figures of a machine for a phase-voltage limit in V and a current limit in A (peak; its own when None)."""
    limit = machine.i_max if i_max is None else i_max
    locus = mtpa_locus(machine, limit)
    base_speed = float(limit_speed(machine, locus.i_d[-1:], locus.i_q[-1:], v_max)[0])
    last = _largest_speed(machine, v_max, limit)
    speed_max = None if last is None else last / machine.pole_pairs
    fastest = 10.0 * base_speed if speed_max is None else speed_max
    speeds = np.unique(np.concatenate([np.linspace(0.0, fastest, 400), np.linspace(base_speed, 3 * base_speed, 200)]))
    power = envelope(machine, v_max, speeds[speeds <= fastest], limit)
    best = int(np.argmax(power.power))
    return Characteristics(
        torque_max=float(locus.torque[-1]),
        base_speed=base_speed,
        characteristic_current=_characteristic_current(machine, limit),
        speed_max=speed_max,
        power_max=float(power.power[best]),
        power_speed=float(power.points.omega_m[best]),
    )


def voltage_limit(inverter: Inverter, modulation: ModulationName, margin: float = 0.0) -> VoltageLimit:
    """Largest phase amplitude of a modulator's linear range, less a margin (0 to 1) that is kept for control."""
    v_max = float(linear_limit(modulation, inverter.v_dc)) * (1.0 - margin)
    return VoltageLimit(modulation, inverter.v_dc, margin, v_max)


def operating_map(
    machine: LinearMachine,
    inverter: Inverter,
    limit: VoltageLimit,
    torque: FloatArray,
    omega_m: FloatArray,
    i_max: float,
) -> OperatingMap:
    """Least-copper-loss points over a grid, with the losses of the drive at them.

    Parameters
    ----------
    machine, inverter, limit:
        The drive, and the voltage limit of its modulator.
    torque, omega_m:
        Torques in N m, shape (N,), and mechanical speeds in rad/s, shape (M,).
    i_max:
        Current limit in A (peak).
    """
    wanted, speed = np.meshgrid(torque, omega_m, indexing="ij")
    points = optimal_points(machine, wanted, speed, v_max=limit.v_max, i_max=i_max)
    loss = copper_loss(machine.r_s, points.i_d, points.i_q)
    if inverter.device is not None:
        drive = (points.i_d, points.i_q, points.omega_m)
        loss = loss_budget(machine, inverter, *drive, limit.modulation, on_runaway="mark").total
    power = points.torque * points.omega_m
    useful = points.reached & (power > 0.0)
    efficiency = np.full(power.size, np.nan)
    efficiency[useful] = power[useful] / (power[useful] + loss[useful])
    return OperatingMap(
        torque,
        omega_m,
        points,
        loss.reshape(wanted.shape),
        efficiency.reshape(wanted.shape),
        inverter.device is not None,
    )
