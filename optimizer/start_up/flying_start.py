"""Speed and angle of a rotor that already turns, from the currents of short pulses.

All lower switches short the winding for a time T and open again; the EMF alone has made a current,
which dies in the diodes. In the frame of the rotor every pulse makes the same current i_0(omega),
so that two of them that begin a time S apart differ by the angle that the rotor has turned:

    i_1 = i_0 exp(j theta_1),  i_2 = i_0 exp(j theta_2):
    omega = arg(i_2 / i_1) / S,   unique while |omega| S < pi
    theta = arg(i_2) - arg(i_0(omega))

with the short-circuit current of the model

    di_d/dt = (-R i_d + omega L_q i_q)/L_d
    di_q/dt = (-R i_q - omega L_d i_d - omega psi)/L_q     from rest

at first i_q = -omega psi T/L_q. Its direction does not depend on psi and hardly on R. Noise of
sigma per component turns a current |i| by sigma/|i|, the speed by sqrt(2) sigma/(|i| S): a third
pulse after a longer time S_3, whose turns the first pair tells, divides that by S_3/S.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.optimizer.sampled_systems import ComplexArray

LEVEL = 0.15  # Share of the largest current that a pulse is to reach.

# Angle in rad that the rotor may turn between two pulses at the largest speed.
TURN = 0.8 * math.pi
LONG = 5.0  # How much longer the third pulse waits than the second.
LONG_BELOW = 0.2  # Share of the largest speed below which the third pulse is needed.
STANDSTILL = 0.05  # Share of the largest speed below which the rotor counts as at rest.
LEAST_FRACTION = 0.05  # Shortest pulse as a share of a sampling period.


@dataclass(frozen=True, slots=True)
class FlyingStart:
    """Pulses by which a turning rotor is found.

    Args:
        fraction: Length of the shortest pulse in sampling periods, at most 1: with it the largest
            speed makes no more than the largest current.
        longest: Length of the longest pulse in sampling periods. A pulse that has not made
            ``level`` is tried again with twice the length.
        spacing: From the begin of a pulse to that of the next one, in sampling periods.
        long_spacing: From the begin of the second pulse to that of the third one, in sampling
            periods.
        level: Current in A that a pulse is to reach.
        peak: Current in A of the shortest pulse at the largest speed.
        omega_max, omega_long, omega_least: Electrical speeds in rad/s: the largest that is unique,
            the one below which the third pulse is needed, and the one below which the rotor counts
            as at rest.
    """

    fraction: float
    longest: int
    spacing: int
    long_spacing: int
    level: float
    peak: float
    omega_max: float
    omega_long: float
    omega_least: float


def short_circuit_current(machine: LinearMachine, omega: FloatArray, time: float) -> ComplexArray:
    """Current i_d + j i_q in A after a short circuit from rest.

    Args:
        machine: Its constants.
        omega: Electrical speeds in rad/s, shape (N,).
        time: Length of the short circuit in s.
    """
    omega = np.asarray(omega, dtype=np.float64)
    d, q = machine.r_s / machine.l_d, machine.r_s / machine.l_q
    # x = exp(A time) x_0 + ..., A of the second order: mean rate, and what is left of it.
    mean = -0.5 * (d + q)
    root = np.sqrt((0.25 * (d - q) ** 2 - omega**2).astype(np.complex128))
    hyperbolic = np.where(
        np.abs(root) * time > 1e-8, np.sinh(root * time) / np.where(root == 0.0, 1.0, root), time
    )
    decay = np.exp(mean * time)
    even, odd = (decay * np.cosh(root * time)).real, (decay * hyperbolic).real
    # Deviation from the steady short-circuit current, at first minus that current.
    square = d * q + omega**2
    steady_d = -(omega**2) * machine.psi_pm / (machine.l_d * square)
    steady_q = -omega * d * machine.psi_pm / (machine.l_q * square)
    cross_d, cross_q = omega * machine.l_q / machine.l_d, -omega * machine.l_d / machine.l_q
    first_d = even + odd * (-d - mean)
    first_q = even + odd * (-q - mean)
    i_d = steady_d - (first_d * steady_d + odd * cross_d * steady_q)
    i_q = steady_q - (odd * cross_q * steady_d + first_q * steady_q)
    return np.asarray(i_d + 1j * i_q)


def _fraction(machine: LinearMachine, t_s: float, omega_max: float, i_limit: float) -> float:
    """Largest share of a period, halved from 1 on, whose current does not exceed the limit."""
    fraction, speed = 1.0, np.array([omega_max])
    while fraction > LEAST_FRACTION:
        if abs(short_circuit_current(machine, speed, fraction * t_s)[0]) <= i_limit:
            return fraction
        fraction *= 0.5
    return 0.0


def plan_flying_start(
    machine: LinearMachine,
    t_s: float,
    omega_max: float,
    *,
    fractions: bool = False,
    i_limit: float | None = None,
) -> FlyingStart:
    """Pulses for speeds up to ``omega_max``.

    Args:
        machine: Its constants; ``i_max`` is the largest current.
        t_s: Sampling period in s.
        omega_max: Largest electrical speed in rad/s.
        fractions: Whether pulses shorter than a sampling period can be made.
        i_limit: Current in A that no pulse may exceed; None for ``machine.i_max``.

    Raises:
        NoSolutionError: There is no magnet, the shortest pulse makes too much current, or the rotor
            turns too far between two pulses; the message has the number.
    """
    where, limit = "control.start_up.flying_start", machine.i_max if i_limit is None else i_limit
    if not machine.psi_pm > 0.0:
        raise NoSolutionError(f"{where}: a rotor without magnets makes no current of its own")
    fraction = _fraction(machine, t_s, omega_max, limit)
    if fraction == 0.0 or (fraction < 1.0 and not fractions):
        peak = abs(short_circuit_current(machine, np.array([omega_max]), t_s)[0])
        raise NoSolutionError(
            f"{where}: a short circuit of one sampling period makes {peak:.3g} A at "
            f"{omega_max:.4g} rad/s, more than {limit:.3g} A; sample faster, or start from rest"
        )
    spacing = math.floor(TURN / (omega_max * t_s))
    if spacing < 3:
        raise NoSolutionError(
            f"{where}: the rotor turns {math.degrees(3.0 * omega_max * t_s):.3g} deg in three "
            f"sampling periods, the least between two pulses; at most "
            f"{math.degrees(TURN):.3g} deg can be told apart"
        )
    peak = float(abs(short_circuit_current(machine, np.array([omega_max]), fraction * t_s)[0]))
    return FlyingStart(
        fraction=fraction,
        longest=max(1, spacing - 2),
        spacing=spacing,
        long_spacing=round(LONG * spacing),
        level=LEVEL * machine.i_max,
        peak=peak,
        omega_max=omega_max,
        omega_long=LONG_BELOW * omega_max,
        omega_least=STANDSTILL * omega_max,
    )


def speed_of_pair(first: ComplexArray, second: ComplexArray, spacing: float) -> FloatArray:
    """Electrical speed in rad/s from the currents of two pulses.

    Args:
        first, second: Currents alpha + j beta in A at the ends of two equal pulses, shape (N,).
        spacing: Time between them in s.
    """
    return np.asarray(np.angle(second * np.conj(first)) / spacing, dtype=np.float64)


def refined_speed(
    omega: FloatArray, second: ComplexArray, third: ComplexArray, long_spacing: float
) -> FloatArray:
    """Electrical speed in rad/s from a later pair, its turns told by a rough speed.

    Args:
        omega: Rough electrical speed in rad/s, shape (N,).
        second, third: Currents alpha + j beta in A at the ends of two equal pulses, shape (N,).
        long_spacing: Time between them in s.
    """
    gap = np.angle(third * np.conj(second) * np.exp(-1j * omega * long_spacing))
    return np.asarray(omega + gap / long_spacing, dtype=np.float64)


def angle_of_pulse(
    machine: LinearMachine, current: ComplexArray, omega: FloatArray, time: float
) -> FloatArray:
    """Electrical angle in rad at the end of a pulse, wrapped to -pi to pi.

    Args:
        machine: Its constants.
        current: Current alpha + j beta in A at the end of the pulse, shape (N,).
        omega: Electrical speed in rad/s, shape (N,).
        time: Length of the pulse in s.
    """
    model = short_circuit_current(machine, omega, time)
    return np.asarray(np.angle(current * np.conj(model)), dtype=np.float64)
