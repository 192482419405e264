"""What a machine can do over speed: limits of torque and power, base speed, characteristic current,
largest speed.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.flux_map import TorqueRipple, torque_ripple
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.losses.machine_budget import NO_EXTRA_LOSS, MachineLoss
from dqforge.machines.modulation.dead_time import LowHarmonics, low_harmonics
from dqforge.machines.names import ModulationName, OvermodulationName, Topology
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import (
    TOPOLOGIES,
    amplitude_limit,
    contradiction,
    overmodulation_of,
)
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.operating_points.ends_of_data import least_flux_current, make_limits
from dqforge.optimizer.operating_points.mtpa_locus import (
    Active,
    LossCoefficients,
    MtpaLocus,
    intervals_of,
    mtpa_locus,
    region_that_holds,
)
from dqforge.optimizer.operating_points.points import (
    DriveLosses,
    OptimalPoints,
    drive_losses,
    loss_coefficients,
    optimal_points,
)

_FASTEST = 1e6  # Electrical speed in rad/s beyond which a machine is said to have no largest speed.

# Multiple of the base speed up to which the largest power of a machine without largest speed is
# looked for.
_FAR = 10.0
_MTPV_POINTS = 80


@dataclass(frozen=True, slots=True)
class Characteristics:
    """Figures of a machine under a current and a voltage limit.

    ``torque_max`` in N m at low speed; ``base_speed`` in rad/s (mechanical), where it meets the
    voltage limit; ``characteristic_current`` in A whose d-axis flux cancels the magnet (None
    without magnet, or beyond a map); ``speed_max`` in rad/s up to which the voltage limit can be
    kept (None where there is no end); ``power_max`` in W, the largest mechanical power up to the
    speed that the machine's mechanics, or else ``speed_max``, permits (or ten times the base
    speed), at ``power_speed`` in rad/s. ``held`` names the figures (``torque_max``, ``base_speed``,
    ``speed_max``, ``power_max``) that the data of a flux map hold: more may lie beyond them.
    """

    torque_max: float
    base_speed: float
    characteristic_current: float | None
    speed_max: float | None
    power_max: float
    power_speed: float
    held: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Envelope:
    """Largest torque over speed: points of shape (N,), their speeds ascending.

    ``points`` are those of most motoring torque, ``braking`` those of most torque against the
    rotation, at the same speeds. ``weakening_torque`` in N m and ``weakening_speed`` in rad/s,
    shape (L,), are the line along which the MTPA currents take the voltage limit: to its right the
    field is weakened.
    """

    points: OptimalPoints
    braking: OptimalPoints
    weakening_torque: FloatArray
    weakening_speed: FloatArray

    @property
    def power(self) -> FloatArray:
        """Mechanical power of motoring in W, shape (N,)."""
        return self.points.torque * self.points.omega_m

    @property
    def braking_power(self) -> FloatArray:
        """Mechanical power of braking in W, shape (N,), negative: it flows into the machine."""
        return self.braking.torque * self.braking.omega_m


@dataclass(frozen=True, slots=True)
class Loci:
    """Lines in the plane of currents that bound what is sensible.

    ``i_max`` in A is the radius of the current limit, ``mtpa`` the locus of most torque per current
    up to it, ``mtpv`` the points of most torque per voltage within it by ascending speed, shape
    (K,), K = 0 where there are none.
    """

    i_max: float
    mtpa: MtpaLocus
    mtpv: OptimalPoints


def limit_speed(machine: Machine, i_d: FloatArray, i_q: FloatArray, v_max: float) -> FloatArray:
    """Mechanical speed in rad/s at which currents in A, shape (N,), take the
    phase voltage v_max in V.

    With the resistance drop |v|^2 = R^2 |i|^2 + 2 R omega (psi_d i_q - psi_q i_d) + omega^2 |psi|^2
    is quadratic in the speed; zero where the drop alone takes more, inf without flux.

    Args:
        machine: Any machine.
        i_d, i_q: Currents in A (peak), shape (N,).
        v_max: Phase-voltage amplitude in V (peak).
    """
    psi_d, psi_q = machine.flux(i_d, i_q)
    square, half = psi_d**2 + psi_q**2, machine.r_s * (psi_d * i_q - psi_q * i_d)
    rest = v_max**2 - machine.r_s**2 * (i_d**2 + i_q**2)
    root = half + np.sqrt(np.maximum(half**2 + square * rest, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        omega_e = np.where(rest > 0.0, rest / root, 0.0)
    return np.asarray(np.where(root > 0.0, omega_e, np.inf) / machine.pole_pairs)


def _largest_speed(machine: Machine, v_max: float, i_max: float) -> tuple[float | None, bool]:
    """Largest electrical speed in rad/s at which any current keeps the voltage limit, or None;
    and if data hold it.
    """
    free, region = free_largest_speed(machine, v_max, i_max), region_that_holds(machine, i_max)
    if region is None:
        return free, False
    limits = make_limits(
        machine, np.array([_FASTEST if free is None else free]), np.array([v_max]), i_max
    )
    if region.contains(limits.centre_d, limits.centre_q)[0]:
        return free, False
    # What is kept at a speed shrinks as the speed grows: its last measured
    # current lies on the edge.
    edges = intervals_of(machine, region, i_max)
    which, share = np.arange(edges.d.size), np.linspace(0.0, 1.0, 33)
    best = 0.0
    low, high = np.zeros(which.size), np.ones(which.size)
    for _ in range(7):
        trial = low[:, np.newaxis] + (high - low)[:, np.newaxis] * share
        speed = limit_speed(
            machine, *edges.point(np.repeat(which, share.size), trial.ravel()), v_max
        )
        speed = speed.reshape(trial.shape)
        chosen = int(np.argmax(np.max(speed, axis=1)))
        place = int(np.argmax(speed[chosen]))
        best = max(best, float(speed[chosen, place]))
        low, high = (
            trial[chosen, max(place - 1, 0)][np.newaxis],
            trial[chosen, min(place + 1, 32)][np.newaxis],
        )
        which = which[chosen : chosen + 1]
    fastest = best * machine.pole_pairs
    return (None if fastest >= _FASTEST else fastest), True


def free_largest_speed(machine: Machine, v_max: float, i_max: float) -> float | None:
    """Largest electrical speed in rad/s at which any current keeps the voltage limit, None where
    every speed does; wherever the data of a flux map end.

    Args:
        machine: Any machine.
        v_max, i_max: Phase amplitudes in V and A.
    """

    def kept(omega_e: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        volts = np.full_like(omega_e, v_max)
        limits = make_limits(machine, omega_e, volts, i_max)
        return np.asarray(limits.voltage_square(limits.centre_d, limits.centre_q) < volts**2)

    low, high = 0.0, _FASTEST
    if kept(np.array([high]))[0]:
        return None
    # A bundle of 64 trial speeds per step narrows the bracket by nearly two digits each time,
    # down to rounding.
    for _ in range(9):
        trial = np.linspace(low, high, 64)
        held = np.flatnonzero(kept(trial))
        last = int(held[-1]) if held.size else 0
        low, high = float(trial[last]), float(trial[min(last + 1, 63)])
    return low


def _characteristic_current(machine: Machine, i_max: float) -> float | None:
    """Current in A (peak) along -d that cancels the magnet's flux.

    None without magnet, or where a map ends before.
    """
    if machine.psi_pm == 0.0:
        return None
    if isinstance(machine, LinearMachine):
        return machine.psi_pm / machine.l_d
    least = least_flux_current(machine, i_max)
    region, current = machine.region, abs(least)
    if region is not None and not region.contains(np.array([least]), np.zeros(1))[0]:
        return None
    return current if current < (1.0 - 1e-5) * i_max else None


def envelope(
    machine: Machine, v_max: float, omega_m: FloatArray, i_max: float | None = None
) -> Envelope:
    """Largest torques at mechanical speeds in rad/s, shape (N,), for a phase-voltage limit in V.

    `envelope_speeds` makes speeds that show every kink.

    Args:
        machine: Any machine.
        v_max: Largest phase-voltage amplitude in V (peak).
        omega_m: Mechanical speeds in rad/s, shape (N,).
        i_max: Current limit in A (peak); that of the machine when None.
    """
    limit = machine.i_max if i_max is None else i_max
    locus = mtpa_locus(machine, limit)
    beyond = 2.0 * float(locus.torque[-1])
    points = optimal_points(machine, beyond, omega_m, v_max=v_max, i_max=limit)
    braking = optimal_points(machine, -beyond, omega_m, v_max=v_max, i_max=limit)
    return Envelope(
        points, braking, locus.torque, limit_speed(machine, locus.i_d, locus.i_q, v_max)
    )


def limit_changes(
    machine: Machine, v_max: float, omega_m: FloatArray, i_max: float, *, sign: float = 1.0
) -> FloatArray:
    """Speeds in rad/s where what holds the most torque changes, shape (K,):
    the kinks of the envelope.

    ``omega_m`` is a grid of ascending speeds in rad/s fine enough to part the changes; each is then
    narrowed to rounding. ``sign`` is 1 for motoring and -1 for braking torque at positive speeds.

    Args:
        machine: Any machine.
        v_max: Largest phase-voltage amplitude in V (peak).
        omega_m: Mechanical speeds in rad/s, ascending, shape (N,).
        i_max: Current limit in A (peak).
        sign: 1 for motoring, -1 for braking.
    """
    beyond = sign * 2.0 * float(mtpa_locus(machine, i_max).torque[-1])

    def held(speed: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.int8]]:
        found = optimal_points(machine, beyond, speed.ravel(), v_max=v_max, i_max=i_max)
        return found.active.reshape(speed.shape)

    before = np.flatnonzero(np.diff(held(omega_m)))
    low, high = omega_m[before], omega_m[before + 1]
    rows, share = np.arange(before.size), np.linspace(0.0, 1.0, 33)
    for _ in range(9 if before.size else 0):
        trial = low[:, np.newaxis] + (high - low)[:, np.newaxis] * share
        codes = held(trial)
        last = np.maximum(np.argmax(codes != codes[:, :1], axis=1), 1)
        low, high = trial[rows, last - 1], trial[rows, last]
    return high


def envelope_speeds(
    machine: Machine, v_max: float, fastest: float, i_max: float, count: int = 241
) -> FloatArray:
    """Evenly spaced speeds from 0 to ``fastest`` rad/s, and the kinks of both envelopes among them,
    ascending.

    Args:
        machine: Any machine.
        v_max: Largest phase-voltage amplitude in V (peak).
        fastest: Largest mechanical speed in rad/s.
        i_max: Current limit in A (peak).
        count: Number of evenly spaced speeds.
    """
    even = np.linspace(0.0, fastest, count)
    kinks = [limit_changes(machine, v_max, even, i_max, sign=sign) for sign in (1.0, -1.0)]
    return np.unique(np.concatenate([even, *kinks]))


def loci(machine: Machine, v_max: float, i_max: float | None = None) -> Loci:
    """Loci of a machine for a phase-voltage limit in V and a current limit in A (peak;
    its own when None).

    MTPV points run from the speed at which they first come within the current limit to the largest
    speed, or to a hundred times the first where there is none.

    Args:
        machine: Any machine.
        v_max: Largest phase-voltage amplitude in V (peak).
        i_max: Current limit in A (peak); that of the machine when None.
    """
    limit = machine.i_max if i_max is None else i_max
    locus = mtpa_locus(machine, limit)
    beyond = 2.0 * float(locus.torque[-1])
    base = float(limit_speed(machine, locus.i_d[-1:], locus.i_q[-1:], v_max)[0])
    last, _ = _largest_speed(machine, v_max, limit)
    end = 1e3 * base if last is None else last / machine.pole_pairs
    grid = np.geomspace(max(base, 1e-6 * end), end, 257) if end > 0.0 else np.zeros(1)
    speeds = np.unique(np.concatenate([grid, limit_changes(machine, v_max, grid, limit)]))
    found = optimal_points(machine, beyond, speeds, v_max=v_max, i_max=limit)
    touching = found.omega_m[found.active == Active.MTPV]
    if touching.size == 0:
        return Loci(limit, locus, _chosen(found, found.active == Active.MTPV))
    first = float(touching[0])
    # The flux linkage shrinks with 1/omega, so that even steps of that space the
    # points evenly in the plane.
    spaced = 1.0 / np.linspace(1.0 / first, 1.0 / min(end, 100.0 * first), _MTPV_POINTS)
    points = optimal_points(machine, beyond, spaced, v_max=v_max, i_max=limit)
    return Loci(limit, locus, _chosen(points, points.active == Active.MTPV))


def _chosen(
    points: OptimalPoints, mask: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
) -> OptimalPoints:
    """Some of the points, shape (K,)."""
    return OptimalPoints(
        **{field.name: getattr(points, field.name)[mask] for field in fields(OptimalPoints)}
    )


def characteristics(machine: Machine, v_max: float, i_max: float | None = None) -> Characteristics:
    """Figures of a machine for a phase-voltage limit in V and a current limit in A (peak;
    its own when None).

    Args:
        machine: Any machine.
        v_max: Largest phase-voltage amplitude in V (peak).
        i_max: Current limit in A (peak); that of the machine when None.
    """
    limit = machine.i_max if i_max is None else i_max
    locus = mtpa_locus(machine, limit)
    base_speed = float(limit_speed(machine, locus.i_d[-1:], locus.i_q[-1:], v_max)[0])
    last, last_held = _largest_speed(machine, v_max, limit)
    speed_max = None if last is None else last / machine.pole_pairs
    ends = [speed for speed in (machine.omega_m_max, speed_max) if speed is not None]
    power_max, power_speed, power_held = _largest_power(
        machine,
        v_max,
        limit,
        2.0 * float(locus.torque[-1]),
        min(ends, default=_FAR * base_speed),
        base_speed,
    )
    return Characteristics(
        torque_max=float(locus.torque[-1]),
        base_speed=base_speed,
        characteristic_current=_characteristic_current(machine, limit),
        speed_max=speed_max,
        power_max=power_max,
        power_speed=power_speed,
        held=tuple(
            name
            for name, held in (
                ("torque_max", bool(locus.held[-1])),
                ("base_speed", bool(locus.held[-1])),
                ("speed_max", last_held),
                ("power_max", power_held),
            )
            if held
        ),
    )


def _largest_power(
    machine: Machine, v_max: float, i_max: float, beyond: float, fastest: float, base_speed: float
) -> tuple[float, float, bool]:
    """Largest mechanical power in W up to ``fastest`` rad/s, its speed, and
    whether the data hold it.

    ``beyond`` is a torque above all others.
    """
    near = (
        np.linspace(base_speed, min(3.0 * base_speed, fastest), 100)
        if base_speed < fastest
        else np.zeros(0)
    )
    speeds = np.unique(np.concatenate([np.linspace(0.0, fastest, 300), near]))
    for _ in range(4):
        points = optimal_points(machine, beyond, speeds, v_max=v_max, i_max=i_max)
        power = points.torque * speeds
        best = int(np.argmax(power))
        found = float(power[best]), float(speeds[best]), bool(points.active[best] == Active.DATA)
        speeds = np.linspace(speeds[max(best - 1, 0)], speeds[min(best + 1, speeds.size - 1)], 41)
    return found


# Operating points over torque and speed, their efficiency and the voltage limit behind them.


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
    where there is none; ``turning`` the torque over the rotor angle, None where nothing is known of
    it.
    """

    points: OptimalPoints
    losses: DriveLosses
    power: FloatArray
    efficiency: FloatArray
    harmonics: LowHarmonics | None = None
    turning: TorqueRipple | None = None


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
    turning = torque_ripple(machine, points.i_d, points.i_q)
    if limit.overmodulation == "none":
        return DrivePoints(points, losses, power, share, turning=turning)
    harmonics = low_harmonics(
        limit.overmodulation, machine, points.i_d, points.i_q, points.omega_m, v_dc=limit.v_dc
    )
    return DrivePoints(points, losses, power, share, harmonics, turning)


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


# Least-loss operating points of a drive with what they lose and what they give: at points
# and over maps, asked in SI numbers.

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
    end = "" if last is None else f"; it can be kept up to {in_rpm(last):.4g} rpm"
    raise NoSolutionError(
        f"at {in_rpm(omega_m):.4g} rpm no current within {i_max:.4g} A keeps the voltage "
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
