"""Permanent-magnet drives drawn at random, from small 24 V motors to 560 V drives.

What is drawn is relative: resistance and inductance as shares of the rated impedance, the inertia
as the time in which rated torque reaches rated speed. The magnet flux follows from the rated
voltage v_r = 0.9 v_dc / sqrt(3) at rated speed and rated current in the q axis:

    (omega psi + R I)^2 + (omega L_d I)^2 = v_r^2

(of salient machines with L_d: they reach rated speed with a negative d current). The incremental
inductance along d falls with a magnetising current by the share s at the rated one,
psi_d = psi + L_d (i_d - s i_d^2/(2 I)).
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass

LINKS = (24.0, 48.0, 325.0, 560.0)  # DC-link voltages in V.
LOW_VOLTAGE = 100.0  # Links below it in V are switched by MOSFETs with a short dead time.
_SHARE_WITHOUT_SALIENCY = 0.4
_VOLTAGE_USED = 0.9


@dataclass(frozen=True, slots=True)
class RandomDrive:
    """A drive with its rated point.

    Args:
        machine: Its constants; ``i_max`` is the rated current I in A, ``omega_m_max`` the rated
            speed.
        v_dc: DC-link voltage in V.
        f_s: Switching and sampling frequency in Hz.
        dead_time: In s.
        saturation: Share s by which the incremental d inductance falls at the rated current.
        theta_e: Electrical angle at rest in rad.
        seed: Of the noise of a run.
    """

    machine: LinearMachine
    v_dc: float
    f_s: float
    dead_time: float
    saturation: float
    theta_e: float
    seed: int

    @property
    def omega_rated(self) -> float:
        """Rated electrical speed in rad/s."""
        assert self.machine.omega_m_max is not None
        return self.machine.pole_pairs * self.machine.omega_m_max

    @property
    def torque_rated(self) -> float:
        """Torque of the rated current in the q axis, in N m."""
        return self.machine.torque_per_ampere * self.machine.i_max

    @property
    def saliency(self) -> float:
        """L_q/L_d."""
        return self.machine.l_q / self.machine.l_d


def _log_uniform(generator: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** generator.uniform())


def random_drive(number: int, seed: int = 1) -> RandomDrive:
    """One drive; the same for the same number and seed.

    Args:
        number: Which, from 0 on.
        seed: Of the series.
    """
    generator = np.random.default_rng([seed, number])
    v_dc = float(generator.choice(LINKS))
    current = _log_uniform(generator, 3.0, 80.0)
    pole_pairs = int(generator.integers(2, 8))
    omega = 2.0 * math.pi * _log_uniform(generator, 60.0, 350.0)
    resistance = _log_uniform(generator, 0.015, 0.12)
    reactance = _log_uniform(generator, 0.12, 0.5)
    round_rotor = generator.uniform() < _SHARE_WITHOUT_SALIENCY
    saliency = 1.0 if round_rotor else float(generator.uniform(1.1, 2.5))
    saturation = float(generator.uniform(0.05, 0.3))
    acceleration_time = _log_uniform(generator, 0.03, 0.5)
    f_s = _log_uniform(generator, 8e3, 20e3)
    theta_e = float(generator.uniform(-math.pi, math.pi))
    v_rated = _VOLTAGE_USED * v_dc / math.sqrt(3.0)
    impedance = v_rated / current
    psi_pm = v_rated / omega * (math.sqrt(1.0 - reactance**2) - resistance)
    omega_m = omega / pole_pairs
    machine = LinearMachine(
        pole_pairs=pole_pairs,
        r_s=resistance * impedance,
        l_d=reactance * impedance / omega,
        l_q=saliency * reactance * impedance / omega,
        psi_pm=psi_pm,
        i_max=current,
        inertia=1.5 * pole_pairs * psi_pm * current * acceleration_time / omega_m,
        omega_m_max=omega_m,
    )
    dead_time = 0.5e-6 if v_dc < LOW_VOLTAGE else 3e-6
    noise_seed = int(generator.integers(1, 2**31))
    return RandomDrive(machine, v_dc, f_s, dead_time, saturation, theta_e, noise_seed)


def random_drives(count: int, seed: int = 1) -> tuple[RandomDrive, ...]:
    """The first drives of a series.

    Args:
        count: How many.
        seed: Of the series.
    """
    return tuple(random_drive(number, seed) for number in range(count))
