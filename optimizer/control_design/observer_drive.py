"""A drive whose speed control runs on an observer, as one sampled system about a steady speed.

Everything is seen from the true rotor, where a steady drive stands still. Over one current sample,
in the order of the emitted code: the observer takes the currents of the instant and the voltage
that acted until then; the current controllers work in its angle, with its speed for decoupling;
their voltage acts from the next instant on; winding and shaft move under the voltage computed
before. The derivative of that step is the drive's state space, and with the torque reference held
over the samples of one speed period the loop can be opened there (docs/position-observers.md).

Parameters are exact and the dead time is nought: what is judged is the lag of the observer,
in phase with everything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.plants.drive_motion import ComplexArray, plants, steady_voltage
from dqforge.optimizer.observers.method import ObserverMethod
from dqforge.optimizer.observers.parts import EXACT, ObserverState, Pair
from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
from dqforge.optimizer.observers.steady_states import steady_observer, vector_count
from dqforge.optimizer.sampled_systems import SampledSystem

_SUBSTEPS = 4


_STEP = 1e-6


def _pair(value: ComplexArray) -> Pair:
    return value.real.copy(), value.imag.copy()


class Estimator(Protocol):
    """What the drive needs of an observer.

    Columns (M, n) are its state as it enters a step, in the true rotor's frame.

    ``start`` gives the columns of the steady state (1, n) at current and voltage (d + j q) and
    speed in rad/s with the sizes of noticeable changes; ``step`` (columns, voltage that acted,
    current) the columns that leave it, the angle error in rad and the electrical speed in rad/s;
    ``turned`` turns them on by the angle of a period.
    """

    def start(
        self, i: ComplexArray, v: ComplexArray, omega: float
    ) -> tuple[FloatArray, FloatArray]:
        """Columns and their sizes."""
        ...

    def step(
        self, columns: FloatArray, v: ComplexArray, i: ComplexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns, angle error, electrical speed."""
        ...

    def turned(self, columns: FloatArray, turn: FloatArray) -> FloatArray:
        """The columns seen from the rotor one period later."""
        ...


@dataclass(frozen=True, slots=True)
class PositionEstimator:
    """A position observer: vectors, scalars, angle error and electrical speed are its columns."""

    method: ObserverMethod
    gains: Any
    t_s: float
    machine: LinearMachine

    def start(
        self,
        i: ComplexArray,
        v: ComplexArray,  # noqa: ARG002
        omega: float,
    ) -> tuple[FloatArray, FloatArray]:
        """From the fixed point of the judgement, with exact parameters."""
        speed = np.array([omega])
        found = steady_observer(self.method, self.gains, self.t_s, plants(self.machine), i, speed)
        columns, count = found.states.copy(), 2 * vector_count(self.method)
        columns[:, -1] += omega
        size = np.ones_like(columns)
        for k in range(0, count, 2):
            norm = np.hypot(columns[:, k], columns[:, k + 1])
            size[:, k] = size[:, k + 1] = np.where(norm > 1e-6, norm, 1.0)
        if self.method.sizes is not None:
            size[:, count:-2] = self.method.sizes(columns[:, count:-2], speed)
        size[:, -1] = max(abs(omega), 1.0)
        return self.turned(columns, speed * self.t_s), size

    def step(
        self, columns: FloatArray, v: ComplexArray, i: ComplexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """One step of the method in double precision."""
        count = vector_count(self.method)
        vectors = tuple((columns[:, 2 * n], columns[:, 2 * n + 1]) for n in range(count))
        scalars = tuple(columns[:, n] for n in range(2 * count, columns.shape[1] - 2))
        before = ObserverState(vectors, columns[:, -2], columns[:, -1], scalars=scalars)
        after = self.method.step(self.gains, before, _pair(v), _pair(i), EXACT)
        delta = np.asarray(EXACT.wrap(after.theta_e))
        parts = [part for vector in after.vectors for part in vector] + list(after.scalars)
        return np.stack([*parts, delta, after.omega_e], axis=1), delta, np.asarray(after.omega_e)

    def turned(self, columns: FloatArray, turn: FloatArray) -> FloatArray:
        """Vectors and angle lie behind by what the rotor has turned."""
        found, back = columns.copy(), np.exp(-1j * turn)
        for k in range(0, 2 * vector_count(self.method), 2):
            vector = (columns[:, k] + 1j * columns[:, k + 1]) * back
            found[:, k], found[:, k + 1] = vector.real, vector.imag
        found[:, -2] -= turn
        return found


@dataclass(frozen=True, slots=True)
class SpeedEstimator:
    """The reduced-order observer with the angle of an encoder: zeta, last current,
    angle and speed are its columns.
    """

    observer: ReducedOrderObserver
    machine: LinearMachine

    def start(
        self, i: ComplexArray, v: ComplexArray, omega: float
    ) -> tuple[FloatArray, FloatArray]:
        """An exact estimate stays exact."""
        turn = omega * self.observer.t_s
        zeta = omega / self.machine.pole_pairs + self.observer.c * i[0].imag
        columns = np.array([[zeta, i[0].real, i[0].imag, -turn, omega]])
        size = np.array([[max(abs(omega), 1.0), 1.0, 1.0, 1.0, max(abs(omega), 1.0)]])
        for _ in range(2000):  # neglected couplings leave it a little beside the true speed
            after, _, _ = self.step(columns, v, i)
            columns = self.turned(after, np.array([turn]))
        return columns, size

    def step(
        self, columns: FloatArray, v: ComplexArray, i: ComplexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `dqforge.reports.observers.speed_header` emits it."""
        own, (zeta, last_d, last_q, back, omega) = self.observer, columns.T
        v_q = (v * np.exp(-1j * (back + 0.5 * own.t_s * omega))).imag
        u_q = v_q - omega * self.machine.l_d * last_d
        zeta = own.a * zeta + own.b_u * u_q + own.b_i * last_q
        speed = self.machine.pole_pairs * (zeta - own.c * i.imag)
        zero = np.zeros_like(zeta)
        return np.stack([zeta, i.real, i.imag, zero, speed], axis=1), zero, speed

    def turned(self, columns: FloatArray, turn: FloatArray) -> FloatArray:
        """Only the angle of the last sample lies behind."""
        found = columns.copy()
        found[:, -2] -= turn
        return found


@dataclass(frozen=True, slots=True)
class DriveData:
    """What of a design makes the system.

    ``current_gains`` are (kp, ki t_s) of both axes in V/A; ``reference`` maps a torque in N m to
    i_d + j i_q in A; ``filter_share`` is that of a new sample in the filter of the speed.
    """

    machine: LinearMachine
    t_s: float
    inertia: float
    current_gains: tuple[tuple[float, float], tuple[float, float]]
    reference: Callable[[float], complex]
    filter_share: float


def _moved(
    drive: DriveData, i: ComplexArray, omega: FloatArray, w: ComplexArray, load: float
) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Current, electrical speed and angle after a period under a voltage held
    in stationary coordinates.
    """
    machine = drive.machine
    p, h = machine.pole_pairs, drive.t_s / _SUBSTEPS

    def slope(
        i: ComplexArray, omega: FloatArray, theta: FloatArray
    ) -> tuple[ComplexArray, FloatArray]:
        v = w * np.exp(-1j * theta)
        d = (v.real - machine.r_s * i.real + omega * machine.l_q * i.imag) / machine.l_d
        q = (
            v.imag - machine.r_s * i.imag - omega * (machine.l_d * i.real + machine.psi_pm)
        ) / machine.l_q
        torque = 1.5 * p * (machine.psi_pm + (machine.l_d - machine.l_q) * i.real) * i.imag
        return d + 1j * q, p * (torque - load - machine.friction * omega / p) / drive.inertia

    theta = np.zeros_like(omega)
    for _ in range(_SUBSTEPS):
        a_i, a_w = slope(i, omega, theta)
        b_i, b_w = slope(i + 0.5 * h * a_i, omega + 0.5 * h * a_w, theta + 0.5 * h * omega)
        c_i, c_w = slope(
            i + 0.5 * h * b_i, omega + 0.5 * h * b_w, theta + 0.5 * h * (omega + 0.5 * h * a_w)
        )
        d_i, d_w = slope(i + h * c_i, omega + h * c_w, theta + h * (omega + 0.5 * h * b_w))
        theta = theta + h * omega + h * h / 6.0 * (a_w + b_w + c_w)
        i = i + h / 6.0 * (a_i + 2.0 * b_i + 2.0 * c_i + d_i)
        omega = omega + h / 6.0 * (a_w + 2.0 * b_w + 2.0 * c_w + d_w)
    return i, omega, theta


@dataclass(frozen=True, slots=True, eq=False)
class SteadyDrive:
    """A drive at a steady speed: its state ``x`` (n,), the sizes of changes (n,),
    the torque reference in N m.

    Columns: i_d, i_q, electrical speed, voltage that acted (d, q), voltage that acts next (d, q),
    integrals (d, q), filtered mechanical speed, then those of the estimator.
    """

    drive: DriveData
    estimator: Estimator
    x: FloatArray
    size: FloatArray
    torque: float
    base: complex

    def step(self, states: FloatArray, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """States (M, n) one current sample on, and the filtered speed (M,) in rad/s that
        the speed controller sees.
        """
        drive, machine = self.drive, self.drive.machine
        i, omega = states[:, 0] + 1j * states[:, 1], states[:, 2]
        acted, acting = states[:, 3] + 1j * states[:, 4], states[:, 5] + 1j * states[:, 6]
        columns, delta, seen = self.estimator.step(states[:, 10:], acted, i)
        speed = states[:, 9] + drive.filter_share * (seen / machine.pole_pairs - states[:, 9])
        own = i * np.exp(-1j * delta)
        change = 1e-4 * max(abs(self.torque), 1e-3 * machine.torque_per_ampere * machine.i_max)
        slope = (drive.reference(self.torque + change) - drive.reference(self.torque - change)) / (
            2.0 * change
        )
        error = self.base + slope * (torque - self.torque) - own
        (kp_d, ki_d), (kp_q, ki_q) = drive.current_gains
        integral = (states[:, 7] + ki_d * error.real) + 1j * (states[:, 8] + ki_q * error.imag)
        u = integral + kp_d * error.real + 1j * kp_q * error.imag
        u = u + 1j * seen * (machine.l_d * own.real + machine.psi_pm + 1j * machine.l_q * own.imag)
        made = u * np.exp(1j * (delta + 1.5 * drive.t_s * seen))
        load = self.torque - machine.friction * self.x[2] / machine.pole_pairs
        i, omega, turn = _moved(drive, i, omega, acting, load)
        back = np.exp(-1j * turn)
        parts = [i.real, i.imag, omega, (acting * back).real, (acting * back).imag]
        parts += [(made * back).real, (made * back).imag, integral.real, integral.imag, speed]
        return np.concatenate(
            [np.stack(parts, axis=1), self.estimator.turned(columns, turn)], axis=1
        ), speed

    def system(self) -> SampledSystem:
        """State space of a current sample: torque reference in N m to filtered
        mechanical speed in rad/s.
        """
        n, step = len(self.x), _STEP * self.size
        moved = np.concatenate([self.x + sign * np.diag(step) for sign in (1.0, -1.0)])
        states, speeds = self.step(moved, np.full(2 * n, self.torque))
        a = ((states[:n] - states[n:]) / (2.0 * step[:, None])).T
        c = (speeds[:n] - speeds[n:]) / (2.0 * step)
        change = 1e-3 * self.drive.machine.torque_per_ampere * self.drive.machine.i_max
        ends, _ = self.step(np.stack([self.x, self.x]), self.torque + np.array([change, -change]))
        b = (ends[0] - ends[1]) / (2.0 * change)
        return SampledSystem(a, b[:, None], c[None, :], np.zeros((1, 1)), self.drive.t_s)


def steady_drive(drive: DriveData, estimator: Estimator, omega: float) -> SteadyDrive:
    """The drive at an electrical speed in rad/s, loaded by its friction alone."""
    machine = drive.machine
    torque = machine.friction * omega / machine.pole_pairs
    i_dq = np.array([drive.reference(torque)], dtype=np.complex128)
    speed, turn = np.array([omega]), omega * drive.t_s
    v = steady_voltage(plants(machine), i_dq, speed, drive.t_s)
    columns, size = estimator.start(i_dq, v, omega)
    _, delta, seen = estimator.step(columns, v, i_dq)
    own = i_dq * np.exp(-1j * delta)
    u = v * np.exp(1j * (2.0 * turn - delta - 1.5 * drive.t_s * seen))
    integral = u - 1j * seen * (
        machine.l_d * own.real + machine.psi_pm + 1j * machine.l_q * own.imag
    )
    held = v * np.exp(1j * turn)
    parts = [
        i_dq.real,
        i_dq.imag,
        speed,
        v.real,
        v.imag,
        held.real,
        held.imag,
        integral.real,
        integral.imag,
    ]
    x = np.concatenate([np.concatenate(parts), seen / machine.pole_pairs, columns[0]])
    volt, ampere = abs(v[0]) + 1.0, machine.i_max
    own_size = np.array(
        [ampere, ampere, abs(omega), volt, volt, volt, volt, volt, volt, abs(omega)]
    )
    return SteadyDrive(
        drive, estimator, x, np.concatenate([own_size, size[0]]), torque, complex(own[0])
    )
