"""Boundary of the allowed currents at each speed, on rays from the current of least flux."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine, torque_from_flux
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.local_terms import Terms, newton_step, voltage_terms

# First ray towards positive q currents. Most torque lies there: without a magnet, or with a weak
# one and l_d < l_q, the opposite currents make as much or a little less.
RAYS = 31
ANGLES = np.linspace(-0.5 * np.pi, np.pi, RAYS)
UPPER = int(np.searchsorted(ANGLES, -1e-9))
_RADIAL_STEPS = 12
INSIDE = 1.0 - 1e-6
BoolArray = NDArray[np.bool_]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Limits:
    """Current and voltage limit of a machine at N speeds, with the centre of the region they leave.

    ``centre_d``, ``centre_q`` in A, ``omega_e`` in rad/s, ``v_max`` in V (phase amplitude), shape
    (N,); ``i_max`` in A (peak).
    """

    machine: Machine
    centre_d: FloatArray
    centre_q: FloatArray
    omega_e: FloatArray
    v_max: FloatArray
    i_max: float

    def take(self, index: IndexArray) -> Limits:
        """Limits at some of the speeds, repeated as the index repeats them."""
        centre_d, centre_q = self.centre_d[index], self.centre_q[index]
        return Limits(
            self.machine, centre_d, centre_q, self.omega_e[index], self.v_max[index], self.i_max
        )

    def point(self, angle: FloatArray, radius: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents in A at ray angles and radii."""
        return self.centre_d + radius * np.cos(angle), self.centre_q + radius * np.sin(angle)

    def voltage_square(self, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
        """Squared phase voltage in V^2."""
        psi_d, psi_q = self.machine.flux(i_d, i_q)
        v_d = self.machine.r_s * i_d - self.omega_e * psi_q
        v_q = self.machine.r_s * i_q + self.omega_e * psi_d
        return v_d * v_d + v_q * v_q

    def circle_radius(self, angle: FloatArray) -> FloatArray:
        """Distance in A from the centre to the current circle along ray angles."""
        along = self.centre_d * np.cos(angle) + self.centre_q * np.sin(angle)
        square = along * along + self.i_max**2 - self.centre_d**2 - self.centre_q**2
        return -along + np.sqrt(np.maximum(square, 0.0))


def ray_angles() -> FloatArray:
    """Angles of the scanned rays in rad, from -pi/2 to pi, shape (K,)."""
    return ANGLES.copy()


def least_flux_current(machine: Machine, i_max: float) -> float:
    """Current on the d axis in A where the flux linkage vanishes, or the end of the limit
    that comes nearest to it.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).
    """
    grid = np.linspace(-i_max, i_max, 2001)
    psi_d, _ = machine.flux(grid, np.zeros_like(grid))
    current = float(grid[np.argmin(np.abs(psi_d))])
    point, zero = np.array([current]), np.zeros(1)
    for _ in range(6):
        jet = machine.jet(point, zero)
        point = np.clip(point - jet.psi_d / jet.l_dd, -i_max, i_max)
    # Strictly inside the circle, so that rays to every side have a length.
    return float(np.clip(point[0], -INSIDE * i_max, INSIDE * i_max))


def make_limits(machine: Machine, omega_e: FloatArray, v_max: FloatArray, i_max: float) -> Limits:
    """Limits with their centre: the current of least flux, or the short-circuit current
    where that one needs too much.

    The two differ by the resistance; the second matters near the end of the speed range only.

    Args:
        machine: Any machine.
        omega_e: Electrical speeds in rad/s, shape (N,).
        v_max: Largest phase-voltage amplitudes in V (peak), shape (N,).
        i_max: Current limit in A (peak).
    """
    least = least_flux_current(machine, i_max)
    limits = Limits(
        machine, np.full_like(omega_e, least), np.zeros_like(omega_e), omega_e, v_max, i_max
    )
    broken = np.flatnonzero(limits.voltage_square(limits.centre_d, limits.centre_q) >= v_max**2)
    if broken.size:
        limits.centre_d[broken], limits.centre_q[broken] = _short_circuit(limits.take(broken))
    return limits


def _short_circuit(limits: Limits) -> tuple[FloatArray, FloatArray]:
    """Currents of zero voltage, pulled back onto the current circle where they are larger,
    shape (N,).
    """
    machine, omega_e = limits.machine, limits.omega_e
    d, q, zero = limits.centre_d, limits.centre_q, np.zeros_like(omega_e)
    for _ in range(12):
        jet = machine.jet(d, q)
        v_d, v_q = machine.r_s * d - omega_e * jet.psi_q, machine.r_s * q + omega_e * jet.psi_d
        first = Terms(v_d, machine.r_s - omega_e * jet.l_qd, -omega_e * jet.l_qq, zero, zero, zero)
        second = Terms(v_q, omega_e * jet.l_dd, machine.r_s + omega_e * jet.l_dq, zero, zero, zero)
        step_d, step_q = newton_step(first, second, 0.0, 0.0)
        d, q = d + np.nan_to_num(step_d), q + np.nan_to_num(step_q)
        excess = np.maximum(np.hypot(d, q) / (INSIDE * limits.i_max), 1.0)
        d, q = d / excess, q / excess
    return d, q


def voltage_radius(
    limits: Limits, angle: FloatArray, radius: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Shorten rays until they end on the voltage limit; angles in rad and radii in A of shape (N,).

    Newton's method from outside: the squared voltage grows convexly along a ray of a linear
    machine, so that the steps approach from one side; a bracket keeps the steps of saturated
    machines safe. Returns the radius and whether the voltage limit was met.

    Args:
        limits: Limits with their centre.
        angle: Angles of the rays in rad, shape (N,).
        radius: Where the rays end at most, in A, shape (N,).
    """
    cosine, sine = np.cos(angle), np.sin(angle)
    low, high, found = np.zeros_like(radius), radius.copy(), radius.copy()
    outside = limits.voltage_square(*limits.point(angle, radius)) > limits.v_max**2
    live = np.flatnonzero(outside)
    for _ in range(_RADIAL_STEPS):
        if live.size == 0:
            break
        here = limits.take(live)
        r = found[live]
        i_d, i_q = here.point(angle[live], r)
        terms = voltage_terms(limits.machine, limits.machine.jet(i_d, i_q), i_d, i_q, here.omega_e)
        gap = terms.value - here.v_max**2
        high[live] = np.where(gap > 0.0, r, high[live])
        low[live] = np.where(gap <= 0.0, r, low[live])
        with np.errstate(divide="ignore", invalid="ignore"):
            step = r - gap / (terms.d * cosine[live] + terms.q * sine[live])
        safe = (step >= low[live]) & (step <= high[live])
        found[live] = np.where(safe, step, 0.5 * (low[live] + high[live]))
        live = live[np.abs(gap) > 1e-5 * here.v_max**2]
    return found, outside


def boundary(limits: Limits, angle: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Radius in A, torque in N m and whether the voltage limit binds, on rays of shape (N,).

    Args:
        limits: Limits with their centre.
        angle: Angles of the rays in rad, shape (N,).
    """
    radius, at_voltage = voltage_radius(limits, angle, limits.circle_radius(angle))
    return radius, torque_at(limits.machine, *limits.point(angle, radius)), at_voltage


def torque_at(machine: Machine, i_d: FloatArray, i_q: FloatArray) -> FloatArray:
    """Torque in N m at currents in A, any one shape."""
    return torque_from_flux(machine.pole_pairs, *machine.flux(i_d, i_q), i_d, i_q)
