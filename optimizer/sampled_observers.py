"""Kalman filter and Matsui's estimators as methods of a design: how its few numbers become their gains."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from dqforge.machines.synchronous import LinearMachine
from dqforge.optimizer.ekf_tuning import tuned_ekf, usual_noise
from dqforge.optimizer.matsui import matsui
from dqforge.optimizer.observer_settings import ObserverTuning
from dqforge.optimizer.sampled_steps import (
    EkfGains,
    MatsuiCurrentGains,
    MatsuiVoltageGains,
    ekf_gains,
    matsui_gains,
)

_WIDTH = 200.0
_SPEED = 0.3


def usual_matsui(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Angle and speed at 200 rad/s, or 1/20 of the sampling rate in rad/s if less: a voltage error costs less so."""
    width = min(_WIDTH, 0.05 / t_s)
    return ObserverTuning(width, width, omega_floor=0.02 * omega_max)


def usual_matsui_current(machine: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """The speed as `usual_matsui`; the angle at 1000 rad/s or 1/5 of the sampling rate in rad/s, if less.

    What the speed errs by, by R or psi, costs the angle that over its pole (`closed_form_error`).
    """
    usual = usual_matsui(machine, t_s, omega_max)
    return ObserverTuning(usual.bandwidth, min(1000.0, 0.2 / t_s), omega_floor=usual.omega_floor)


def design_matsui_voltage(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> MatsuiVoltageGains:
    """Angle poles by ``pll_bandwidth`` and ``damping``, that of the speed by ``bandwidth`` (both rad/s)."""
    found = matsui_gains(
        matsui(
            machine,
            t_s,
            "voltage",
            tuning.pll_bandwidth,
            damping=tuning.damping,
            speed_bandwidth=tuning.bandwidth,
            omega_min=tuning.omega_floor,
            omega_max=omega_max,
        )
    )
    assert isinstance(found, MatsuiVoltageGains)
    return found


def design_matsui_current(
    machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float
) -> MatsuiCurrentGains:
    """Angle pole by ``pll_bandwidth``, that of the speed by ``bandwidth`` (both rad/s)."""
    found = matsui_gains(
        matsui(
            machine,
            t_s,
            "current",
            tuning.pll_bandwidth,
            speed_bandwidth=tuning.bandwidth,
            omega_min=tuning.omega_floor,
            omega_max=omega_max,
        )
    )
    assert isinstance(found, MatsuiCurrentGains)
    return found


def usual_ekf(_: LinearMachine, t_s: float, omega_max: float) -> ObserverTuning:
    """Nothing of it is used: the filter is tuned by its innovations."""
    return ObserverTuning(min(_WIDTH, 0.05 / t_s), min(_WIDTH, 0.05 / t_s), omega_floor=0.02 * omega_max)


@lru_cache(maxsize=16)
def _consistent(machine: LinearMachine, t_s: float, omega_max: float) -> EkfGains:
    noise = usual_noise(machine, 2.0 * omega_max * machine.psi_pm, t_s)
    i_ref = np.array([0.0, 0.5 * machine.i_max])
    return ekf_gains(tuned_ekf(machine, t_s, noise, _SPEED * omega_max, i_ref, omega_max=omega_max))


def design_ekf(machine: LinearMachine, tuning: ObserverTuning, t_s: float, omega_max: float) -> EkfGains:
    """Covariances of consistent innovations on simulated drives with the noise of `usual_noise` (`tuned_ekf`).

    The DC voltage, of which the noise of the voltage is a share, is taken as twice the back-EMF at ``omega_max``.
    """
    del tuning
    return _consistent(machine, t_s, omega_max)
