"""Simulated drives to try observers on: any number at once, integrated between the samples,
with sensors that err.

The drive is controlled with its true angle, so that all observers see the same currents and
voltages. Between two samples it moves as `dqforge.machines.plants.drive_motion` says; unlike there,
noise acts on the machine itself besides on what is measured, as a Kalman filter assumes.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.errors import InputError
from dqforge.machines.plants.drive_motion import next_flux, plants
from dqforge.machines.records import dataclass
from dqforge.optimizer.observers.sampled_machine import turned

_GAIN = 0.3  # Share of a current error that the controller of the trials removes in one period.


@dataclass(frozen=True, slots=True)
class CurrentSensor:
    """Current measurement: a converter of ``bits`` over -full_scale .. full_scale in A,
    ``rms`` noise in A before it.

    The noise has to be about half a step or more for the sum of both to be white.
    """

    bits: int
    full_scale: float
    rms: float

    def __post_init__(self) -> None:
        """Refuse what is no sensor."""
        if not (self.bits >= 4 and self.full_scale > 0.0 and self.rms >= 0.0):
            raise InputError(
                "a current sensor needs 4 bits or more, a positive full scale and no negative "
                f"noise, got {self.bits} bits, {self.full_scale:g} A, {self.rms:g} A"
            )

    @property
    def step(self) -> float:
        """Least difference of two readings in A."""
        return self.full_scale / 2.0 ** (self.bits - 1)

    @property
    def variance(self) -> float:
        """Variance of one reading in A^2: noise and rounding."""
        return self.rms**2 + self.step**2 / 12.0

    def read(self, current: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Readings of currents in A, any shape."""
        noisy = current + self.rms * generator.standard_normal(np.shape(current))
        limited = np.clip(noisy, -self.full_scale, self.full_scale - self.step)
        return np.asarray(np.round(limited / self.step) * self.step)


def usual_sensor(machine: Machine) -> CurrentSensor:
    """What stands for a sensor that the design does not describe: 12 bits over 1.25 times i_max,
    one step of noise.
    """
    full_scale = 1.25 * machine.i_max
    return CurrentSensor(12, full_scale, full_scale / 2.0**11)


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """What S drives did over K periods.

    Args:
        t_s: Sampling period in s.
        v: Voltage in stator coordinates that acted over each period, as the firmware believes, in
            V, shape (K, S, 2).
        i: Measured current in stator coordinates at the samples in A, shape (K + 1, S, 2).
        theta, omega: True electrical angle in rad (not wrapped) and speed in rad/s at the samples,
            shape (K + 1, S).
        i_dq: True currents in rotor coordinates in A, shape (K + 1, S, 2).
    """

    t_s: float
    v: FloatArray
    i: FloatArray
    theta: FloatArray
    omega: FloatArray
    i_dq: FloatArray


def simulate(
    machine: Machine,
    t_s: float,
    omega: FloatArray,
    i_ref: FloatArray,
    *,
    sensor: CurrentSensor | None = None,
    voltage_rms: float = 0.0,
    theta_0: float | FloatArray = 0.0,
    seed: int = 0,
) -> Trial:
    """Drive machines along given speeds under current control with the true angle.

    Args:
        machine: The true machine; a saturated one counts with its constants at zero current.
        t_s: Sampling period in s.
        omega: Electrical speed at the samples in rad/s, shape (K + 1, S), straight in between.
        i_ref: Current references (i_d, i_q) in A, shape (2,) or (K, S, 2).
        sensor: Current measurement, None for an exact one.
        voltage_rms: Standard deviation in V, per axis and period, of the voltage that acts without
            the firmware's knowledge.
        theta_0: Electrical angle at the start in rad.
        seed: Of the random numbers.
    """
    machine = linearised(machine)
    generator = np.random.default_rng(seed)
    periods, drives = omega.shape[0] - 1, omega.shape[1]
    reference = np.broadcast_to(np.asarray(i_ref, dtype=np.float64), (periods, drives, 2))
    theta = (
        np.concatenate(
            [np.zeros((1, drives)), np.cumsum(0.5 * t_s * (omega[1:] + omega[:-1]), axis=0)]
        )
        + theta_0
    )
    i_dq, v = np.empty((periods + 1, drives, 2)), np.empty((periods, drives, 2))
    plant, inductance = plants(machine, count=drives), np.array([machine.l_d, machine.l_q])
    i_dq[0] = reference[0]
    psi = plant.flux(i_dq[0, :, 0] + 1j * i_dq[0, :, 1]) * np.exp(1j * theta[0])
    for k in range(periods):
        steady = np.stack(
            machine.voltage(reference[k, :, 0], reference[k, :, 1], omega[k]), axis=-1
        )
        wanted = steady + _GAIN / t_s * inductance * (reference[k] - i_dq[k])
        v[k] = turned(wanted, -(theta[k] + 0.5 * t_s * omega[k]))
        acting = v[k] + voltage_rms * generator.standard_normal((drives, 2))
        psi = next_flux(
            plant, psi, acting[:, 0] + 1j * acting[:, 1], theta[k], (omega[k], omega[k + 1]), t_s
        )
        now = plant.current(psi, theta[k + 1]) * np.exp(-1j * theta[k + 1])
        i_dq[k + 1, :, 0], i_dq[k + 1, :, 1] = now.real, now.imag
    i = turned(i_dq, -theta)
    return Trial(t_s, v, i if sensor is None else sensor.read(i, generator), theta, omega, i_dq)


def wandering_speed(
    mean: FloatArray | float, density: float, t_s: float, periods: int, drives: int, seed: int
) -> FloatArray:
    """Speeds in rad/s that change by white acceleration, shape (periods + 1, drives).

    ``density`` is the standard deviation of the change over one second, in rad/s^1.5; ``mean`` in
    rad/s is what it is added to, a number or shape (periods + 1, 1).
    """
    steps = density * np.sqrt(t_s) * np.random.default_rng(seed).standard_normal((periods, drives))
    return np.asarray(np.concatenate([np.zeros((1, drives)), np.cumsum(steps, axis=0)]) + mean)
