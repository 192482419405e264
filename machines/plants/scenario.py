"""What a drive goes through in a simulation: references, load, sensors, and how the machine
differs from its data; and many linear drives that go through it at once, averaged.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.names import OpenPhase, StartLoadName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY

# Many drives in motion at once: linear dq machines under field-oriented current control, as the
# firmware sees them.
#
# A reference for judging observers. The speed is given, so that nothing but the observer can be
# wrong. Per period
#
#     the currents are sampled at k t_s; a PI controller with decoupling computes a voltage from
#     them with the true angle;
#     it acts from (k + 1) t_s to (k + 2) t_s, held in stationary coordinates (one period of
#     computation delay).
#
# The machine is integrated in stationary coordinates,
#
#     dpsi/dt = v - R i,    i = exp(j theta) L^-1 (exp(-j theta) psi - psi_pm),
#
# by the classical Runge-Kutta method of fourth order in ``substeps`` steps per period, in which
# the speed runs linearly from sample to sample and the angle is its exact integral.

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, slots=True, eq=False)
class Plants:
    """Parameters of N machines, arrays of shape (N,): ``r_s`` in Ohm, ``l_d``, ``l_q`` in H,
    ``psi_pm`` in Wb.
    """

    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    psi_pm: FloatArray

    def current(self, psi: ComplexArray, theta: FloatArray) -> ComplexArray:
        """Current alpha + j beta in A of a flux linkage alpha + j beta in Wb at angles in rad,
        shape (N,).
        """
        turn = np.exp(1j * theta)
        own = psi * np.conj(turn) - self.psi_pm
        return np.asarray(
            (own.real / self.l_d + 1j * own.imag / self.l_q) * turn, dtype=np.complex128
        )

    def flux(self, i_dq: ComplexArray) -> ComplexArray:
        """Flux linkage d + j q in Wb of a current d + j q in A, shape (N,)."""
        return np.asarray(
            self.psi_pm + self.l_d * i_dq.real + 1j * self.l_q * i_dq.imag, dtype=np.complex128
        )


@dataclass(frozen=True, slots=True, eq=False)
class DriveMotion:
    """What happened at the sampling instants k t_s, arrays of shape (steps, N).

    ``v_alpha``, ``v_beta`` in V is the voltage that acted over the period that ENDS at instant k
    (row 0: the one before the start); ``i_alpha``, ``i_beta`` in A the currents at instant k;
    ``theta_e`` in rad (not wrapped) and ``omega_e`` in rad/s the electrical angle and speed;
    ``i_d``, ``i_q`` in A the true dq currents.
    """

    t_s: float
    v_alpha: FloatArray
    v_beta: FloatArray
    i_alpha: FloatArray
    i_beta: FloatArray
    theta_e: FloatArray
    omega_e: FloatArray
    i_d: FloatArray
    i_q: FloatArray

    def measured(self, i_noise: float, v_noise: float = 0.0, seed: int = 0) -> DriveMotion:
        """The same motion with independent normal noise of r.m.s. ``i_noise`` A and
        ``v_noise`` V on each component.
        """
        generator = np.random.default_rng(seed)
        i, v = (
            scale * generator.standard_normal((2, *self.i_alpha.shape))
            for scale in (i_noise, v_noise)
        )
        return replace(
            self,
            i_alpha=self.i_alpha + i[0],
            i_beta=self.i_beta + i[1],
            v_alpha=self.v_alpha + v[0],
            v_beta=self.v_beta + v[1],
        )


def plants(
    machine: LinearMachine, errors: Mapping[str, ArrayLike] | None = None, count: int = 1
) -> Plants:
    """N machines that differ from ``machine`` by relative errors.

    Args:
        errors: Relative errors, e.g. ``{"r_s": [0.0, 0.3]}`` for a second drive whose resistance is
            30 % higher than ``machine`` says; of ``r_s``, ``l_d``, ``l_q``, ``psi_pm``, scalars or
            shape (N,).
        count: Least number of drives N.

    Raises:
        InputError: An unknown parameter is named.
    """
    given = dict(errors or {})
    names = ("r_s", "l_d", "l_q", "psi_pm")
    unknown = sorted(set(given) - set(names))
    if unknown:
        raise InputError(f"plant error of {unknown[0]} is unknown; write one of {', '.join(names)}")
    parts = [
        getattr(machine, name) * (1.0 + np.asarray(given.get(name, 0.0), dtype=np.float64))
        for name in names
    ]
    shape = np.broadcast_shapes((count,), *(part.shape for part in parts))
    return Plants(*(np.array(np.broadcast_to(part, shape), dtype=np.float64) for part in parts))


def next_flux(
    plant: Plants,
    psi: ComplexArray,
    v: ComplexArray,
    theta: FloatArray,
    omega: tuple[FloatArray, FloatArray],
    t_s: float,
    substeps: int = 4,
) -> ComplexArray:
    """Flux linkage alpha + j beta in Wb one period later, all arrays of shape (N,).

    Args:
        psi: Flux linkage at the start, in Wb.
        v: Voltage alpha + j beta in V, held.
        theta: Electrical angle at the start, in rad.
        omega: Electrical speed in rad/s at the start and at the end; linear in between.
    """
    step, ramp = t_s / substeps, (omega[1] - omega[0]) / t_s

    def slope(time: float, flux: ComplexArray) -> ComplexArray:
        return v - plant.r_s * plant.current(flux, theta + (omega[0] + 0.5 * ramp * time) * time)

    for k in range(substeps):
        time = k * step
        first = slope(time, psi)
        second = slope(time + 0.5 * step, psi + 0.5 * step * first)
        third = slope(time + 0.5 * step, psi + 0.5 * step * second)
        fourth = slope(time + step, psi + step * third)
        psi = psi + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth)
    return psi


def _exponentials(matrices: FloatArray) -> FloatArray:
    """Exponentials of small matrices, shape (N, n, n), by Taylor series and squaring (scipy's:
    in a loop).
    """
    halvings = 6
    scaled = matrices / 2.0**halvings
    total = power = np.broadcast_to(np.eye(matrices.shape[-1]), matrices.shape)
    for k in range(1, 14):
        power = power @ scaled / k
        total = total + power
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total, dtype=np.float64)


def steady_voltage(
    plant: Plants, i_dq: ComplexArray, omega: FloatArray, t_s: float
) -> ComplexArray:
    """Voltage d + j q in V, in rotor coordinates at the END of a period,
    that brings the current back where it began.

    Held in stationary coordinates it turns by -omega t_s within the period; the state (i_d, i_q,
    v_d, v_q, 1) is linear and its transition an exponential, so that the voltage is exact. Speeds
    have shape (N,), currents and voltages (..., N): several currents share the transitions.
    """
    zero = np.zeros_like(omega)
    rows = [
        [-plant.r_s / plant.l_d, omega * plant.l_q / plant.l_d, 1.0 / plant.l_d + zero, zero, zero],
        [
            -omega * plant.l_d / plant.l_q,
            -plant.r_s / plant.l_q,
            zero,
            1.0 / plant.l_q + zero,
            -omega * plant.psi_pm / plant.l_q,
        ],
        [zero, zero, zero, omega, zero],
        [zero, zero, -omega, zero, zero],
        [zero, zero, zero, zero, zero],
    ]
    matrix = np.moveaxis(
        np.array([[np.broadcast_to(x, zero.shape) for x in row] for row in rows]), -1, 0
    )
    step = _exponentials(matrix * t_s)
    i = np.stack(np.broadcast_arrays(i_dq.real, i_dq.imag, zero)[:2], axis=-1)
    rest = i - np.einsum("nij,...nj->...ni", step[:, :2, :2], i) - step[:, :2, 4]
    v = np.linalg.solve(step[:, :2, 2:4], rest[..., None])[..., 0]
    return np.asarray((v[..., 0] + 1j * v[..., 1]) * np.exp(-1j * omega * t_s), dtype=np.complex128)


def drive_motion(
    machine: LinearMachine,
    t_s: float,
    omega_e: FloatArray,
    i_dq: ComplexArray,
    errors: Mapping[str, ArrayLike] | None = None,
    *,
    theta_0: ArrayLike = 0.0,
    bandwidth: float | None = None,
    v_dq_added: ComplexArray | None = None,
    substeps: int = 4,
) -> DriveMotion:
    """Drives that follow speeds and current references with the true angle,
    from the steady state of their first row.

    Args:
        machine: What the controller knows.
        t_s: Sampling period in s.
        omega_e: Electrical speed at the sampling instants in rad/s, shape (steps, N) or (steps, 1).
        i_dq: Current references i_d + j i_q in A, broadcast against (steps, N).
        errors: What the true machines differ by, as for `plants`.
        theta_0: Electrical angle at the first instant in rad, scalar or shape (N,).
        bandwidth: Bandwidth of the current control in rad/s; None for 2 pi/(12 t_s), a twelfth of
            the sampling rate.
        v_dq_added: Voltage d + j q in V added to what the controller commands at instant k
            (injection), broadcast to (steps, N).

    References:
        docs/methods/current-and-speed-loops.md (controller with decoupling, delay of one period and
        a half).
    """
    omega = np.asarray(omega_e, dtype=np.float64)
    plant = plants(machine, errors, max(omega.shape[1], np.shape(i_dq)[-1] if np.ndim(i_dq) else 1))
    shape = (len(omega), len(plant.r_s))
    omega = np.array(np.broadcast_to(omega, shape))
    reference = np.broadcast_to(np.asarray(i_dq, dtype=np.complex128), shape)
    added = np.broadcast_to(
        np.asarray(0.0 if v_dq_added is None else v_dq_added, dtype=np.complex128), shape
    )
    control = plants(machine)
    width = 2.0 * np.pi / (12.0 * t_s) if bandwidth is None else bandwidth
    kp_d, kp_q, ki_ts = width * machine.l_d, width * machine.l_q, width * machine.r_s * t_s

    theta = np.array(np.broadcast_to(np.asarray(theta_0, dtype=np.float64), shape[1:]))
    i_now = np.array(reference[0])
    psi = plant.flux(i_now) * np.exp(1j * theta)
    # The integrals hold what the controller does not know of its machine,
    # so that wrong ones stand still as well.
    steady = steady_voltage(plant, i_now, omega[0], t_s)
    integral = steady * np.exp(0.5j * omega[0] * t_s) - 1j * omega[0] * control.flux(i_now)
    pending, before = steady * np.exp(1j * (theta + omega[0] * t_s)), steady * np.exp(1j * theta)
    rows = np.empty((3, *shape), dtype=np.complex128)  # voltage that acted, current, dq current
    angles = np.empty(shape)
    for k in range(shape[0]):
        current = plant.current(psi, theta)
        i_now = current * np.exp(-1j * theta)
        rows[0, k], rows[1, k], rows[2, k], angles[k] = before, current, i_now, theta
        if k + 1 == shape[0]:
            break
        error = reference[k] - i_now
        integral = integral + ki_ts * error
        command = (
            integral
            + kp_d * error.real
            + 1j * kp_q * error.imag
            + 1j * omega[k] * control.flux(i_now)
        )
        after = (command + added[k]) * np.exp(1j * (theta + CURRENT_DELAY * t_s * omega[k]))
        psi = next_flux(plant, psi, pending, theta, (omega[k], omega[k + 1]), t_s, substeps)
        theta = theta + 0.5 * t_s * (omega[k] + omega[k + 1])
        before, pending = pending, after
    return DriveMotion(
        t_s,
        v_alpha=rows[0].real.copy(),
        v_beta=rows[0].imag.copy(),
        i_alpha=rows[1].real.copy(),
        i_beta=rows[1].imag.copy(),
        theta_e=angles,
        omega_e=omega,
        i_d=rows[2].real.copy(),
        i_q=rows[2].imag.copy(),
    )


# What a drive goes through in a simulation: references, load, sensors, and how the machine differs
# from its data.

ControlMode = Literal["speed", "torque", "current", "open-loop"]


InverterModel = Literal["averaged", "switched"]


Shape = Literal["hold", "linear"]


SpeedSource = Literal["difference", "exact", "observer", "measured"]


@dataclass(frozen=True, slots=True)
class Profile:
    """A value over time: points, held until the next or joined by lines, and a sine on top.

    Before its first point and behind its last one the value is that of the point.

    Args:
        times: In s, strictly ascending, at least one.
        values: In the unit of what they describe, as many.
        shape: ``hold`` or ``linear``.
        amplitude, frequency: Of amplitude sin(2 pi frequency t), in the unit of the values and in
            Hz.

    Raises:
        InputError: No point, times that do not ascend, or a number that is not finite.
    """

    times: tuple[float, ...] = (0.0,)
    values: tuple[float, ...] = (0.0,)
    shape: Shape = "hold"
    amplitude: float = 0.0
    frequency: float = 0.0

    def __post_init__(self) -> None:
        """Refuse points that are no function of time."""
        if not self.times or len(self.times) != len(self.values):
            raise InputError(
                f"a profile needs as many times as values, got {len(self.times)} and "
                f"{len(self.values)}"
            )
        numbers = np.array([*self.times, *self.values, self.amplitude, self.frequency])
        if not np.all(np.isfinite(numbers)):
            raise InputError("a profile must consist of finite numbers")
        for before, after in pairwise(self.times):
            if after <= before:
                raise InputError(
                    f"time {after:g} s does not lie after {before:g} s; let the times of a profile "
                    "ascend"
                )

    def at(self, time: FloatArray) -> FloatArray:
        """Values at times in s, any shape."""
        times, values = np.array(self.times), np.array(self.values)
        if self.shape == "linear":
            found = np.interp(time, times, values)
        else:
            found = values[np.maximum(np.searchsorted(times, time, side="right") - 1, 0)]
        return np.asarray(
            found + self.amplitude * np.sin(2.0 * np.pi * self.frequency * np.asarray(time))
        )

    @property
    def largest(self) -> float:
        """Bound of the magnitude."""
        return float(np.max(np.abs(self.values))) + abs(self.amplitude)

    def scaled(self, factor: float) -> Profile:
        """The profile times a factor."""
        values = tuple(factor * value for value in self.values)
        return Profile(self.times, values, self.shape, factor * self.amplitude, self.frequency)


def constant(value: float) -> Profile:
    """A profile that never changes."""
    return Profile((0.0,), (value,))


@dataclass(frozen=True, slots=True)
class Encoder:
    """Position sensor.

    ``lines`` per revolution give four times as many counts; 0 is an exact angle. ``speed`` comes
    from the ``difference`` of the counts over a period of the speed controller, from the
    ``observer`` of the design, is ``measured`` as the design says, or is ``exact``.
    ``misalignment`` in rad (electrical) is added to the angle. For a ``measured`` speed ``edges``
    of each line are captured by a timer of ``clock`` Hz.
    ``absent``: there is none, the drive starts by `control.start_up`.
    """

    lines: int = 0
    speed: SpeedSource = "difference"
    misalignment: float = 0.0
    edges: int = 4
    clock: float = 0.0
    absent: bool = False


@dataclass(frozen=True, slots=True)
class Sensorless:
    """Control with angle and speed of the position observer while the drive turns fast enough.

    It begins where the speed that the controller knows reaches ``above`` and ends where that falls
    under ``below``, both mechanical in rad/s.

    Raises:
        InputError: A speed is negative, or ``below`` exceeds ``above``.
    """

    above: float
    below: float

    def __post_init__(self) -> None:
        """Refuse speeds between which it would never rest."""
        if not 0.0 <= self.below <= self.above < np.inf:
            raise InputError(
                f"sensorless control from {self.above:g} rad/s cannot end below {self.below:g} "
                "rad/s"
            )


@dataclass(frozen=True, slots=True)
class CurrentSensor:
    """Sensors and converters of the phase currents.

    ``bits`` (0: exact) span -``full_scale`` to +``full_scale`` A; ``noise`` in A is the standard
    deviation of a normal distribution; ``offset`` in A and ``gain_error`` (relative) are those of
    the phases a, b and c.
    """

    bits: int = 0
    full_scale: float = 1.0
    noise: float = 0.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gain_error: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PlantErrors:
    """How the plant differs from the data that the controller was made for, relative:
    0.1 is 10 % more.

    ``l_d`` and ``l_q`` scale flux linkages without the magnets', of saturated machines those of
    each axis; of machines with another back-EMF than a sine ``l_d`` scales the inductance,
    ``psi_pm`` the whole back-EMF.
    """

    r_s: float = 0.0
    l_d: float = 0.0
    l_q: float = 0.0
    psi_pm: float = 0.0
    inertia: float = 0.0
    v_dc: float = 0.0


@dataclass(frozen=True, slots=True)
class Drift:
    """How resistance and magnet flux linkage of the plant move while it runs: by lines from nothing
    at ``begin`` to the whole at ``end``, both in s.

    ``r_s`` and ``psi_pm`` are relative, over the data of the design, and add to `PlantErrors`.

    Raises:
        InputError: It does not end behind its beginning.
    """

    begin: float
    end: float
    r_s: float = 0.0
    psi_pm: float = 0.0

    def __post_init__(self) -> None:
        """Refuse instants out of order."""
        if not 0.0 <= self.begin < self.end < np.inf:
            raise InputError(
                f"a drift from {self.begin:g} s cannot end at {self.end:g} s; write a later end"
            )

    def share(self, time: FloatArray) -> FloatArray:
        """Share of the whole at times in s, any shape."""
        return np.clip((np.asarray(time) - self.begin) / (self.end - self.begin), 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class PhaseOpening:
    """A phase that opens while the drive runs.

    Its switches rest from ``time`` in s on; once its diodes have let its current die it is open for
    good. The controller is told ``detected_after`` s later, never where that is None.
    """

    phase: OpenPhase
    time: float
    detected_after: float | None = None

    def __post_init__(self) -> None:
        """Refuse instants before the start."""
        if not 0.0 <= self.time < np.inf or (self.detected_after or 0.0) < 0.0:
            raise InputError(
                f"phase {self.phase} cannot open at {self.time:g} s and be found after "
                f"{self.detected_after} s; neither may be negative"
            )


@dataclass(frozen=True, slots=True)
class ElasticBrake:
    """A brake that holds the shaft by a spring where it is at ``time`` in s.

    ``stiffness`` in N m/rad, positive, and ``damping`` in N m s/rad (mechanical).
    """

    time: float
    stiffness: float
    damping: float = 0.0


@dataclass(frozen=True, slots=True)
class Scenario:
    """One simulation.

    Args:
        duration: In s.
        mode: What `reference` is: mechanical speed in rad/s, torque in N m, i_q in A (then
            `reference_d` is i_d in A), or for ``open-loop`` the duty cycle of phase a (and
            `reference_d` that of b; c takes what is missing to 1.5).
        reference, reference_d: References over time; the controller sees them at its samples.
        load: Load torque in N m, against positive speed.
        shaft: Mechanical speed in rad/s that a load machine imposes; None where the shaft is free.
        v_dc: DC-link voltage in V over time; None for that of the inverter.
        inverter: ``averaged``: duty cycles act as voltages; ``switched``: every switching instant
            of a symmetric carrier.
        dead_time: In s; None for that of the inverter.
        encoder, sensor, errors: Sensors, and differences between plant and data.
        omega_m, theta_e: Speed in rad/s (mechanical) and electrical angle in rad at the start.
        seed: Of the noise.
        sensorless: When angle and speed come from the position observer; None for never.
        sub_steps: Integration steps per control period; None for as many as the accuracy needs.
        open_phase: Phase that opens; None for none. Phase machines only.
        duties: Duty cycles of all legs over time for ``open-loop``, in the order of `TOPOLOGIES`,
            instead of the references; empty for none.
        load_kind: ``active``: the load acts always, as a hoist does; ``friction``: it is the
            magnitude of a torque that acts against the motion, whichever way, and holds a shaft at
            rest.
        brake: A brake that grips during the run; None for none.
        stop: Instant in s at which the command of a drive without encoder goes; None for never.
        drift: How the plant's resistance and magnets change; None for not at all.
    """

    duration: float
    mode: ControlMode
    reference: Profile
    reference_d: Profile = field(default_factory=Profile)
    load: Profile = field(default_factory=Profile)
    shaft: Profile | None = None
    v_dc: Profile | None = None
    inverter: InverterModel = "averaged"
    dead_time: float | None = None
    encoder: Encoder = field(default_factory=Encoder)
    sensor: CurrentSensor = field(default_factory=CurrentSensor)
    errors: PlantErrors = field(default_factory=PlantErrors)
    omega_m: float = 0.0
    theta_e: float = 0.0
    seed: int = 1
    sub_steps: int | None = None
    sensorless: Sensorless | None = None
    open_phase: PhaseOpening | None = None
    duties: tuple[Profile, ...] = ()
    load_kind: StartLoadName = "active"
    brake: ElasticBrake | None = None
    stop: float | None = None
    drift: Drift | None = None
