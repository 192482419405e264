"""One current sample of a drive whose control runs on an observer, for any number of drives.

Everything is seen from the true rotor, where a steady drive stands still. Over one current sample,
in the order of the emitted code: the observer takes the currents of the instant and the voltage
that was commanded until then; the current controllers work in its angle, with its speed for
decoupling, on the references of the torque; their voltage acts from the next instant on. Winding
and shaft move under the voltage computed before,

    L_d di_d/dt = v_d - R i_d + omega L_q i_q
    L_q di_q/dt = v_q - R i_q - omega (L_d i_d + psi)
    J/p domega/dt = 3/2 p (psi + (L_d - L_q) i_d) i_q - T_L - B omega/p

with the machine's own R, L, psi and J, by the classical Runge-Kutta method, the voltage turning
back by the true angle. What a dead time costs lies along the current, softened around zero:

    v = share v_commanded - V_lost i/sqrt(|i|^2 + (0.02 I)^2),   V_lost = 4/pi f_sw t_e V_dc
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.plants.scenario import ComplexArray, plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import CURRENT_DELAY
from dqforge.optimizer.observers.parts import ObserverState, steady_observer, vector_count
from dqforge.optimizer.steps.step_arithmetic import EXACT, Pair

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.optimizer.observers.parts import ObserverMethod
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver


# What drives on an observer are judged at: speeds, loads, and how far they are from their data.

# Relative errors that a drive may have.
RELATIVE = ("r_s", "l_d", "l_q", "psi_pm", "inertia", "v_dc")


@dataclass(frozen=True, slots=True, eq=False)
class DriveCases:
    """M drives, arrays of shape (M,).

    Args:
        omega: Electrical speed in rad/s that the speed controller holds, as its observer tells it.
        load: Torque in N m beside the friction.
        r_s, l_d, l_q, psi_pm, inertia: Of the true machine and shaft, in Ohm, H, H, Wb and kg m^2.
        link: Voltage that acts, over the one that duty cycles are made for.
        lost: Voltage in V along the current that a dead time costs.
    """

    omega: FloatArray
    load: FloatArray
    r_s: FloatArray
    l_d: FloatArray
    l_q: FloatArray
    psi_pm: FloatArray
    inertia: FloatArray
    link: FloatArray
    lost: FloatArray

    def _made(self, change: Callable[[str], FloatArray]) -> DriveCases:
        return DriveCases(**{part.name: change(part.name) for part in fields(self)})

    def taken(self, index: NDArray[np.intp]) -> DriveCases:
        """Some of them, by index."""
        return self._made(lambda name: np.asarray(getattr(self, name)[index]))

    def tiled(self, count: int) -> DriveCases:
        """All of them, ``count`` times in a row."""
        return self._made(lambda name: np.tile(getattr(self, name), count))

    def towards(self, other: DriveCases, share: float) -> DriveCases:
        """Drives on the way from these (share 0) to others (share 1)."""
        return self._made(
            lambda name: (1.0 - share) * getattr(self, name) + share * getattr(other, name)
        )


def drive_cases(
    machine: LinearMachine,
    omega: ArrayLike,
    load: ArrayLike = 0.0,
    errors: Mapping[str, ArrayLike] | None = None,
    lost: ArrayLike = 0.0,
) -> DriveCases:
    """Cases of a machine with its inertia; everything is broadcast to one shape (M,).

    Args:
        machine: As the design has it.
        omega: Electrical speeds in rad/s.
        load: Torques in N m beside the friction.
        errors: Relative errors by the names of `RELATIVE`: 0.3 is 30 % more than the data say.
        lost: Voltages in V along the current that the dead time costs.

    Raises:
        InputError: An error of something else is named, or the inertia is not known.
    """
    given = dict(errors or {})
    unknown = sorted(set(given) - set(RELATIVE))
    if unknown:
        raise InputError(f"error of {unknown[0]} is unknown; write one of {', '.join(RELATIVE)}")
    if machine.inertia is None:
        raise InputError("a drive on its observer needs the inertia; write machine.inertia")
    base = {
        "r_s": machine.r_s, "l_d": machine.l_d, "l_q": machine.l_q, "psi_pm": machine.psi_pm,
        "inertia": machine.inertia, "v_dc": 1.0,
    }  # fmt: skip
    parts = {
        name: value * (1.0 + np.asarray(given.get(name, 0.0), dtype=np.float64))
        for name, value in base.items()
    }
    parts |= {"omega": np.asarray(omega), "load": np.asarray(load), "lost": np.asarray(lost)}
    parts["link"] = parts.pop("v_dc")
    shape = np.broadcast_shapes((1,), *(part.shape for part in parts.values()))
    return DriveCases(
        **{
            name: np.array(np.broadcast_to(part, shape), dtype=np.float64)
            for name, part in parts.items()
        }
    )


def exact_cases(machine: LinearMachine, cases: DriveCases) -> DriveCases:
    """The same speeds and loads with exact data and without dead time."""
    return drive_cases(machine, cases.omega, cases.load)


# Observers as columns of the state of a drive, seen from its true rotor.
#
# There a steady drive stands still, and so does its observer: angle and vectors are relative to the
# rotor, whose turning within a period is taken off at its end.

_SETTLING = 2000
_NEWTON_STEPS = 6

# Share of a speed by which the observer starts beside the place of its rest: more than the rounding
# of Newton's method, less than many steps.
_BESIDE = 1e-12


def _pair(value: ComplexArray) -> Pair:
    return value.real.copy(), value.imag.copy()


class Estimator(Protocol):
    """What the drive needs of an observer.

    Columns (M, n) are its state as it enters a step, in the true rotor's frame.

    ``start`` gives the columns of the steady state with exact data at currents and voltages
    (d + j q) and electrical speeds in rad/s, all (M,), with the sizes of noticeable changes;
    ``step`` (columns, voltage that acted, current) the columns that leave it, the angle error in
    rad and the electrical speed in rad/s; ``turned`` turns them on by the angle of a period.
    """

    def start(
        self, i: ComplexArray, v: ComplexArray, omega: FloatArray
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
        omega: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """From the fixed point of the judgement, with exact parameters."""
        machines = plants(self.machine, count=len(omega))
        found = steady_observer(self.method, self.gains, self.t_s, machines, i, omega)
        columns, count = found.states.copy(), 2 * vector_count(self.method)
        columns[:, -1] += omega
        size = np.ones_like(columns)
        for k in range(0, count, 2):
            norm = np.hypot(columns[:, k], columns[:, k + 1])
            size[:, k] = size[:, k + 1] = np.where(norm > 1e-6, norm, 1.0)
        if self.method.sizes is not None:
            size[:, count:-2] = self.method.sizes(columns[:, count:-2], omega)
        size[:, -1] = np.maximum(np.abs(omega), 1.0)
        return self.turned(columns, omega * self.t_s), size

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
        self, i: ComplexArray, v: ComplexArray, omega: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Where its estimate stays: neglected couplings leave it a little beside the true speed.

        Newton's method leads next to that place, on the side of the true speed; the observer
        itself goes the rest of the way, until no digit changes. So the place is the one at which it
        would come to rest from the true speed, to the last digit, which central differences later
        magnify.
        """
        turn = omega * self.observer.t_s
        told = self._told(i, v, omega)
        told = told + _BESIDE * np.sign(omega - told) * np.abs(told)
        zeta = told / self.machine.pole_pairs + self.observer.c * i.imag
        columns = np.stack([zeta, i.real, i.imag, -turn, told], axis=1)
        for _ in range(_SETTLING):
            after, _, _ = self.step(columns, v, i)
            before, columns = columns, self.turned(after, turn)
            if np.array_equal(before, columns):
                break
        speed, one = np.maximum(np.abs(omega), 1.0), np.ones_like(omega)
        return columns, np.stack([speed, one, one, one, speed], axis=1)

    def _told(self, i: ComplexArray, v: ComplexArray, omega: FloatArray) -> FloatArray:
        """Electrical speed w in rad/s that the observer tells of a steady drive, shape (M,).

        It solves ``zeta = (b_u u_q(w) + b_i i_q)/(1 - a), w = p (zeta - c i_q)`` by Newton's
        method; the true speed where that leads nowhere.
        """
        own, p, told = self.observer, self.machine.pole_pairs, omega
        for _ in range(_NEWTON_STEPS):
            seen = v * np.exp(1j * own.t_s * (omega - 0.5 * told))
            u_q = seen.imag - told * self.machine.l_d * i.real
            zeta = (own.b_u * u_q + own.b_i * i.imag) / (1.0 - own.a)
            by_told = -0.5 * own.t_s * seen.real - self.machine.l_d * i.real
            slope = 1.0 - p * own.b_u / (1.0 - own.a) * by_told
            told = told - (told - p * (zeta - own.c * i.imag)) / slope
        return np.where(np.isfinite(told), told, omega)

    def step(
        self, columns: FloatArray, v: ComplexArray, i: ComplexArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `dqforge.reports.observers.position_header` emits it."""
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


# One current sample of a drive whose control runs on an observer, for any number of drives.
#
# Everything is seen from the true rotor, where a steady drive stands still. Over one current
# sample, in the order of the emitted code: the observer takes the currents of the instant and the
# voltage that was commanded until then; the current controllers work in its angle, with its speed
# for decoupling, on the references of the torque; their voltage acts from the next instant on.
# Winding and shaft move under the voltage computed before,
#
#     L_d di_d/dt = v_d - R i_d + omega L_q i_q
#     L_q di_q/dt = v_q - R i_q - omega (L_d i_d + psi)
#     J/p domega/dt = 3/2 p (psi + (L_d - L_q) i_d) i_q - T_L - B omega/p
#
# with the machine's own R, L, psi and J, by the classical Runge-Kutta method, the voltage turning
# back by the true angle. What a dead time costs lies along the current, softened around zero:
#
#     v = share v_commanded - V_lost i/sqrt(|i|^2 + (0.02 I)^2),   V_lost = 4/pi f_sw t_e V_dc

# Columns of a drive without its observer: i_d, i_q, electrical speed, voltage that acted (d, q),
# voltage that acts next (d, q), integrals (d, q), filtered mechanical speed.
OWN = 10
_SUBSTEPS = 4
_SOFTENING = 0.02  # of the current limit


@dataclass(frozen=True, slots=True)
class DriveData:
    """What of a design makes the system.

    ``current_gains`` are (kp, ki t_s) of both axes in V/A; ``reference`` maps torques in N m to
    i_d + j i_q in A, ``torque_max`` in N m is the largest of them; ``filter_share`` is that of a
    new sample in the filter of the speed.
    """

    machine: LinearMachine
    t_s: float
    current_gains: tuple[tuple[float, float], tuple[float, float]]
    reference: Callable[[FloatArray], ComplexArray]
    torque_max: float
    filter_share: float


@dataclass(frozen=True, slots=True, eq=False)
class ObservedDrive:
    """A drive of a design with its estimator."""

    data: DriveData
    estimator: Estimator

    def start(self, cases: DriveCases) -> tuple[FloatArray, FloatArray, FloatArray]:
        """States and sizes of noticeable changes, shape (M, n), and torques in N m, shape (M,):
        steady states as an exact observer would have them.
        """
        data, machine, t_s = self.data, self.data.machine, self.data.t_s
        torque = cases.load + machine.friction * cases.omega / machine.pole_pairs
        i, omega = data.reference(torque), cases.omega
        v = steady_voltage(plants(machine, count=len(omega)), i, omega, t_s)
        columns, size = self.estimator.start(i, v, omega)
        _, delta, seen = self.estimator.step(columns, v, i)
        own, held = i * np.exp(-1j * delta), v * np.exp(1j * omega * t_s)
        u = v * np.exp(1j * (2.0 * omega * t_s - delta - CURRENT_DELAY * t_s * seen))
        integral = u - 1j * seen * self._flux(own)
        parts = [i.real, i.imag, omega, v.real, v.imag, held.real, held.imag]
        parts += [integral.real, integral.imag, seen / machine.pole_pairs]
        volt, ampere, one = np.abs(v) + 1.0, machine.i_max, np.ones_like(omega)
        speed = np.maximum(np.abs(omega), 1.0)
        sizes = [ampere * one, ampere * one, speed, *6 * [volt], speed]
        return (
            np.concatenate([np.stack(parts, axis=1), columns], axis=1),
            np.concatenate([np.stack(sizes, axis=1), size], axis=1),
            torque,
        )

    def _flux(self, i: ComplexArray) -> ComplexArray:
        machine = self.data.machine
        return machine.psi_pm + machine.l_d * i.real + 1j * machine.l_q * i.imag

    def step(
        self, cases: DriveCases, states: FloatArray, torque: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """States (M, n) one current sample on, and the filtered speeds (M,) in rad/s that the
        speed controller sees, under torque references in N m.
        """
        data, machine = self.data, self.data.machine
        i, omega = states[:, 0] + 1j * states[:, 1], states[:, 2]
        acted, acting = states[:, 3] + 1j * states[:, 4], states[:, 5] + 1j * states[:, 6]
        columns, delta, seen = self.estimator.step(states[:, OWN:], acted, i)
        speed = states[:, 9] + data.filter_share * (seen / machine.pole_pairs - states[:, 9])
        own = i * np.exp(-1j * delta)
        error = data.reference(torque) - own
        (kp_d, ki_d), (kp_q, ki_q) = data.current_gains
        integral = (states[:, 7] + ki_d * error.real) + 1j * (states[:, 8] + ki_q * error.imag)
        u = integral + kp_d * error.real + 1j * kp_q * error.imag + 1j * seen * self._flux(own)
        made = u * np.exp(1j * (delta + CURRENT_DELAY * data.t_s * seen))
        i, omega, turn = self._moved(cases, i, omega, acting)
        back = np.exp(-1j * turn)
        acting, made = acting * back, made * back
        parts = [i.real, i.imag, omega, acting.real, acting.imag, made.real, made.imag]
        parts += [integral.real, integral.imag, speed]
        turned = self.estimator.turned(columns, turn)
        return np.concatenate([np.stack(parts, axis=1), turned], axis=1), speed

    def _moved(
        self, cases: DriveCases, i: ComplexArray, omega: FloatArray, held: ComplexArray
    ) -> tuple[ComplexArray, FloatArray, FloatArray]:
        """Current, electrical speed and angle after a period under a voltage held
        in stationary coordinates.
        """
        machine, h = self.data.machine, self.data.t_s / _SUBSTEPS
        p, soft = machine.pole_pairs, (_SOFTENING * machine.i_max) ** 2
        w, lossy = cases.link * held, bool(np.any(cases.lost))

        def slope(
            i: ComplexArray, omega: FloatArray, theta: FloatArray
        ) -> tuple[ComplexArray, FloatArray]:
            v = w * np.exp(-1j * theta) - cases.r_s * i
            if lossy:
                v = v - cases.lost * i / np.sqrt(i.real * i.real + i.imag * i.imag + soft)
            d = (v.real + omega * cases.l_q * i.imag) / cases.l_d
            q = (v.imag - omega * (cases.l_d * i.real + cases.psi_pm)) / cases.l_q
            torque = 1.5 * p * (cases.psi_pm + (cases.l_d - cases.l_q) * i.real) * i.imag
            left = torque - cases.load - machine.friction * omega / p
            return d + 1j * q, p * left / cases.inertia

        theta = np.zeros_like(omega)
        for _ in range(_SUBSTEPS):
            a_i, a_w = slope(i, omega, theta)
            b_i, b_w = slope(i + 0.5 * h * a_i, omega + 0.5 * h * a_w, theta + 0.5 * h * omega)
            middle = theta + 0.5 * h * (omega + 0.5 * h * a_w)
            c_i, c_w = slope(i + 0.5 * h * b_i, omega + 0.5 * h * b_w, middle)
            end = theta + h * (omega + 0.5 * h * b_w)
            d_i, d_w = slope(i + h * c_i, omega + h * c_w, end)
            theta = theta + h * omega + h * h / 6.0 * (a_w + b_w + c_w)
            i = i + h / 6.0 * (a_i + 2.0 * b_i + 2.0 * c_i + d_i)
            omega = omega + h / 6.0 * (a_w + 2.0 * b_w + 2.0 * c_w + d_w)
        return i, omega, theta
