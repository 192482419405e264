"""The machine from one sample to the next, exactly, in a frame that turns with the rotor:
what observers predict with.

Over one period the inverter holds its voltage in stator coordinates and the speed omega changes
little. In the rotor's frame the held voltage then turns backwards, and currents, voltage and
back-EMF follow one linear equation,

    L_d di_d/dt = v_d - R i_d + omega L_q i_q              dv_d/dt =  omega v_q
    L_q di_q/dt = v_q - R i_q - omega (L_d i_d + psi)      dv_q/dt = -omega v_d

whose matrix exponential gives, without approximation for a constant speed,

    i[k+1] = Phi(omega) i[k] + Gamma(omega) v[k] + h(omega)

with i[k] and v[k] in the frame of the beginning and i[k+1] in that of the end of the period. Phi,
Gamma and h are entire functions of omega; mirrored in the d axis the machine runs backwards, so
that each entry is even or odd. Polynomials of four coefficients in (omega t_s)^2 hold them to some
1e-9 over the speed range, without any function of libm.

References:
    K. J. Astroem, B. Wittenmark, "Computer-Controlled Systems", 3rd edition, 1997, chapter 2; the
    equations are (7.23) and (7.24) of paper 001 with L_d and L_q kept apart.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass

TERMS = 4

# Parity of the rows phi_dd, phi_dq, phi_qd, phi_qq, gamma_dd, gamma_dq, gamma_qd, gamma_qq, h_d,
# h_q in omega.
ODD = np.array([False, True, True, False, False, True, True, False, False, True])

# omega t_s in rad: six samples per electrical turn; beyond, the speed is not constant over a sample
# in any sense.
_NODES = 16
_LARGEST_TURN = 1.0
_RESERVE = 1.2


@dataclass(frozen=True, slots=True, eq=False)
class SampledMachine:
    """Phi, Gamma and h as polynomials of the speed.

    Args:
        machine: The linear machine.
        t_s: Sampling period in s.
        omega_max: Largest electrical speed in rad/s for which the polynomials hold; beyond it the
            speed is limited.
        table: Coefficients of rising powers of (omega t_s)^2 of the ten entries in the order of
            `ODD`, shape (10, 4); an odd entry has the factor omega t_s besides. Phi has no unit,
            Gamma is in A/V, h in A.
        error: Largest deviation from the matrix exponential, over the largest of the entry.
    """

    machine: LinearMachine
    t_s: float
    omega_max: float
    table: FloatArray
    error: float

    def entries(self, omega: FloatArray) -> FloatArray:
        """The ten entries at electrical speeds in rad/s, shape (...) -> (..., 10)."""
        return self.entries_and_slopes(omega)[0]

    def slopes(self, omega: FloatArray) -> FloatArray:
        """Derivatives of the ten entries by the speed, per rad/s, shape (...) -> (..., 10)."""
        return self.entries_and_slopes(omega)[1]

    def entries_and_slopes(self, omega: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The ten entries with their derivatives, both shapes as of `entries`."""
        limit = self.omega_max
        x = np.minimum(np.maximum(omega, -limit), limit)[..., np.newaxis] * self.t_s
        s = x * x
        c = np.ascontiguousarray(self.table.T)
        value = ((c[3] * s + c[2]) * s + c[1]) * s + c[0]
        rate = (3.0 * c[3] * s + 2.0 * c[2]) * s + c[1]
        entries = np.where(ODD, x * value, value)
        return entries, np.where(ODD, value + 2.0 * s * rate, 2.0 * x * rate) * self.t_s

    def predict(self, omega: FloatArray, i: FloatArray, v: FloatArray) -> FloatArray:
        """Currents at the end of the period in A, shape (..., 2), from those and the
        voltage at its beginning.
        """
        return applied(self.entries(omega), i, v)


def applied(entries: FloatArray, i: FloatArray, v: FloatArray) -> FloatArray:
    """Phi i + Gamma v + h of ten entries, shape (..., 10), for dq vectors of shape (..., 2)."""
    i_d, i_q, v_d, v_q = i[..., :1], i[..., 1:], v[..., :1], v[..., 1:]
    by_current = entries[..., 0:4:2] * i_d + entries[..., 1:4:2] * i_q
    by_voltage = by_current + entries[..., 4:8:2] * v_d + entries[..., 5:8:2] * v_q
    return np.asarray(by_voltage + entries[..., 8:])


def turned(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """A vector, shape (..., 2), in a frame that is ahead by ``angle`` in rad, shape (...)."""
    c, s = np.cos(angle), np.sin(angle)
    d, q = c * vector[..., 0] + s * vector[..., 1], c * vector[..., 1] - s * vector[..., 0]
    found = np.empty((*np.shape(d), 2))
    found[..., 0], found[..., 1] = d, q
    return found


def wrapped(angle: FloatArray) -> FloatArray:
    """Angle in rad brought to [-pi, pi), any shape."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def exact_entries(machine: LinearMachine, omega: FloatArray, t_s: float) -> FloatArray:
    """The ten entries by matrix exponentials, speeds in rad/s of shape (N,) -> (N, 10)."""
    from scipy.linalg import expm

    omega = np.asarray(omega, dtype=np.float64)
    a = np.zeros((len(omega), 5, 5))
    a[:, 0, 0], a[:, 1, 1] = -machine.r_s / machine.l_d, -machine.r_s / machine.l_q
    a[:, 0, 1], a[:, 1, 0] = omega * machine.l_q / machine.l_d, -omega * machine.l_d / machine.l_q
    a[:, 0, 2], a[:, 1, 3] = 1.0 / machine.l_d, 1.0 / machine.l_q
    a[:, 1, 4] = -omega * machine.psi_pm / machine.l_q
    a[:, 2, 3], a[:, 3, 2] = omega, -omega
    found = np.asarray(expm(a * t_s))
    order = [(0, 0), (0, 1), (1, 0), (1, 1), (0, 2), (0, 3), (1, 2), (1, 3), (0, 4), (1, 4)]
    return np.stack([found[:, r, c] for r, c in order], axis=1)


def electrical_limit(machine: Machine, t_s: float, omega_max: float | None = None) -> float:
    """Largest electrical speed in rad/s that an observer serves: a fifth above the machine's,
    or six samples per turn.

    ``omega_max`` in rad/s overrides that of the machine.
    """
    most = _LARGEST_TURN / t_s
    if omega_max is None:
        of_machine = machine.omega_m_max
        return most if of_machine is None else min(most, _RESERVE * machine.pole_pairs * of_machine)
    if not 0.0 < omega_max <= most:
        raise NoSolutionError(
            f"control.observer: at {omega_max:g} rad/s (electrical) a turn has fewer than six "
            f"samples of {t_s:g} s; sample faster, or stay below {most:g} rad/s"
        )
    return omega_max


def sampled_machine(machine: Machine, t_s: float, omega_max: float | None = None) -> SampledMachine:
    """Sample a machine without approximation for |omega| up to ``omega_max`` in
    rad/s (`electrical_limit`).

    A saturated machine counts with its constants at zero current.

    Raises:
        InputError: The sampling period is not positive.
        NoSolutionError: The speed is too high for the sampling.
    """
    if not t_s > 0.0:
        raise InputError(f"the sampling period must be positive, got {t_s:g} s")
    linear = linearised(machine)
    limit = electrical_limit(linear, t_s, omega_max)
    most = (limit * t_s) ** 2
    nodes = 0.5 * most * (1.0 + np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES))
    x = np.sqrt(nodes)
    values = exact_entries(linear, x / t_s, t_s) / np.where(ODD, x[:, np.newaxis], 1.0)
    scaled = np.vander(nodes / most, TERMS, increasing=True)
    table = (
        np.linalg.lstsq(scaled, values, rcond=None)[0] / most ** np.arange(TERMS)[:, np.newaxis]
    ).T
    model = SampledMachine(linear, t_s, limit, table, 0.0)
    check = np.linspace(-limit, limit, 65)
    exact = exact_entries(linear, check, t_s)
    scale = np.maximum(np.max(np.abs(exact), axis=0), 1e-300)
    error = float(np.max(np.abs(model.entries(check) - exact) / scale))
    return SampledMachine(linear, t_s, limit, table, error)
