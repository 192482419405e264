"""What a machine can do over speed: limits of torque and power, base speed, characteristic current,
largest speed.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.ends_of_data.boundary import least_flux_current, make_limits
from dqforge.optimizer.operating_points.mtpa_locus import MtpaLocus, mtpa_locus
from dqforge.optimizer.operating_points.point_problem import Active
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points
from dqforge.optimizer.operating_points.region_edges import intervals_of, region_that_holds

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
