"""The saliency tracker at work on simulated drives, its own voltage included."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.machines.plants.drive_motion import next_flux, plants
from dqforge.optimizer.observers.models.matsui_model import ObserverRun
from dqforge.optimizer.observers.sampled_machine import turned
from dqforge.optimizer.observers.trials import CurrentSensor, Trial
from dqforge.optimizer.saliency.sampled_injection import Injection


def track(
    tracker: Injection,
    machine: Machine,
    omega: FloatArray,
    i_ref: tuple[float, float],
    *,
    theta_error: float = 0.0,
    sensor: CurrentSensor | None = None,
    seed: int = 0,
) -> tuple[ObserverRun, Trial]:
    """Follow S drives along given speeds (electrical, rad/s, shape (K + 1, S)).

    The fundamental voltage is the steady one of ``i_ref`` in A at the true angle, without any
    controller, so that all that moves the currents besides is the injection, one period after it
    was asked for.

    Returns:
        The estimates, and what was measured; its voltages include the injection.
    """
    linear = linearised(machine)
    generator = np.random.default_rng(seed)
    t_s, n = tracker.t_s, tracker.samples
    periods, drives = omega.shape[0] - 1, omega.shape[1]
    theta = np.concatenate(
        [np.zeros((1, drives)), np.cumsum(0.5 * t_s * (omega[1:] + omega[:-1]), axis=0)]
    )
    reference = [np.full(drives, current) for current in i_ref]
    plant = plants(linear, count=drives)
    i_dq = np.empty((periods + 1, drives, 2))
    i_dq[0] = i_ref
    i, v = np.empty_like(i_dq), np.empty((periods, drives, 2))
    psi = plant.flux(i_dq[0, :, 0] + 1j * i_dq[0, :, 1]) * np.exp(1j * theta[0])
    estimate, speed = np.empty((periods + 1, drives)), np.empty((periods + 1, drives))
    angle, rate = theta[0] + theta_error, omega[0].copy()
    products, asked = np.zeros((n, drives)), np.zeros((drives, 2))
    gain = 1.0 / (n * tracker.gain)
    for k in range(periods + 1):
        i[k] = turned(i_dq[k], -theta[k])
        i[k] = i[k] if sensor is None else sensor.read(i[k], generator)
        if k > 0:
            angle = angle + t_s * rate
            products[k % n] = turned(i[k], angle)[:, 1] * tracker.reference[k % n]
            found = gain * np.sum(products, axis=0)
            rate = np.clip(rate + tracker.k_i * found, -tracker.omega_max, tracker.omega_max)
            angle = angle + tracker.k_p * found
        estimate[k], speed[k] = angle, rate
        if k == periods:
            break
        steady = np.stack(linear.voltage(reference[0], reference[1], omega[k]), axis=-1)
        v[k] = turned(steady, -(theta[k] + 0.5 * t_s * omega[k])) + asked
        wave = np.stack(
            [np.full(drives, tracker.voltage * tracker.carrier[k % n]), np.zeros(drives)], axis=-1
        )
        asked = turned(wave, -(angle + 1.5 * t_s * rate))
        psi = next_flux(
            plant, psi, v[k, :, 0] + 1j * v[k, :, 1], theta[k], (omega[k], omega[k + 1]), t_s
        )
        now = plant.current(psi, theta[k + 1]) * np.exp(-1j * theta[k + 1])
        i_dq[k + 1, :, 0], i_dq[k + 1, :, 1] = now.real, now.imag
    return ObserverRun(estimate, speed), Trial(t_s, v, i, theta, omega, i_dq)
