"""Which harmonics of the currents get integrators that turn with them."""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.transforms import clarke_matrix
from dqforge.optimizer.phase_control.phase_controller import HarmonicGains

RATE = 60.0  # Rate of learning in 1/s: a time constant of 17 ms.
CALM = 30.0  # Least ratio of the current loop's bandwidth to the rate.

# Error over the current limit above which the integrators rest: a torque step, no disturbance.
ERROR_SHARE = 1.0 / 6.0
HIGHEST = 13  # Highest order that is looked at.
WORTH = 0.05  # Share of the largest disturbance from which on an order is worth an integrator.

# Most orders in the plane and of the zero sequence; each costs a sine and two states.
MOST = (8, 4)
SLOW = 0.1  # Share of the top speed at which an order must still lie below the frequency limit.


def harmonic_orders(
    phase_currents: FloatArray, flux: FloatArray, turns: int
) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Signed orders in the plane, and orders of the zero sequence, largest disturbance first.

    Disturbances are the dead time, whose voltage has the sign of each phase current, and errors
    of the back-EMF, which has the orders of the table. Equal phases with mirrored half waves have
    -5, 7, -11, 13 and 3, 9. The order 1 is what the plain integrators hold, and in the plane 0 is
    an offset of the sensors, which no integrator sees.

    Args:
        phase_currents: Currents of the phases per torque over the period, shape (3, N).
        flux: Back-EMF of the phases over electrical speed in Wb, shape (3, N), on the same angles.
        turns: Electrical periods that the columns span.
    """
    plane: dict[int, float] = {}
    zero: dict[int, float] = {}
    still = np.abs(phase_currents) <= 1e-9 * np.max(np.abs(phase_currents))
    for signal in (np.where(still, 0.0, np.sign(phase_currents)), flux / np.max(np.abs(flux))):
        alpha, beta, mean = clarke_matrix() @ signal
        vector = np.fft.fft(alpha + 1j * beta) / alpha.size
        line = 2.0 * np.fft.fft(mean) / mean.size
        for order in range(-HIGHEST, HIGHEST + 1):
            size = float(np.abs(vector[order * turns]))
            plane[order] = max(plane.get(order, 0.0), size)
            if order > 0:
                zero[order] = max(zero.get(order, 0.0), float(np.abs(line[order * turns])))
    for order in (0, 1):
        plane.pop(order)
    return _largest(plane, MOST[0]), _largest(zero, MOST[1])


def _largest(sizes: dict[int, float], most: int) -> tuple[int, ...]:
    """Orders worth an integrator, the strongest ones, in ascending magnitude."""
    worth = [order for order, size in sizes.items() if size >= WORTH]
    strongest = sorted(worth, key=lambda order: (-round(sizes[order], 9), abs(order), order))
    return tuple(sorted(strongest[:most], key=lambda order: (abs(order), order)))


def harmonic_gains(
    orders: tuple[tuple[int, ...], tuple[int, ...]],
    t_s: float,
    bandwidth: float,
    i_max: float,
    omega_e_max: float,
    *,
    neutral: bool,
) -> HarmonicGains | None:
    """Integrators for orders of the plane and of the zero sequence, None where none are left.

    Args:
        orders: As `harmonic_orders` finds them.
        t_s: Sampling period in s.
        bandwidth: Of the current loops in rad/s, kp over the inductance: the least of all axes.
        i_max: Current limit in A, peak.
        omega_e_max: Top speed in rad/s, electrical.
        neutral: Whether the legs drive a zero sequence.
    """
    frequency_max = 1.0 / (6.0 * t_s)
    highest = 2.0 * np.pi * frequency_max / (SLOW * omega_e_max)
    plane, zero = (tuple(m for m in part if abs(m) <= highest) for part in orders)
    zero = zero if neutral else ()
    if not plane and not zero:
        return None
    return HarmonicGains(
        plane=plane,
        zero=zero,
        rate=min(RATE, bandwidth / CALM),
        frequency_max=frequency_max,
        error_max=ERROR_SHARE * i_max,
    )
