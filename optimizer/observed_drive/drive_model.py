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

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.plants.drive_motion import ComplexArray, plants, steady_voltage
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.dq_machines.synchronous import LinearMachine
    from dqforge.optimizer.observed_drive.drive_cases import DriveCases, Estimator

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
        u = v * np.exp(1j * (2.0 * omega * t_s - delta - 1.5 * t_s * seen))
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
        made = u * np.exp(1j * (delta + 1.5 * data.t_s * seen))
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
