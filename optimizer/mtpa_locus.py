"""The MTPA locus of any machine as a table over current: starts of the batched solver, and a characteristic."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.synchronous import FloatArray, LinearMachine, Machine, torque_from_flux
from dqforge.optimizer.local_terms import cross, current_terms, newton_step, torque_terms
from dqforge.optimizer.mtpa import mtpa_at_current

_LEVELS = 160
_ANGLES = 121
_POLISHING_STEPS = 6


@dataclass(frozen=True, slots=True)
class MtpaLocus:
    """Points of most torque for their current, ascending in current, arrays of shape (L,): A, A, A and N m."""

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray

    def start(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents near the locus for torque >= 0 in N m, shape (N,); beyond the table its last point."""
        first = float(self.torque[0])
        # Below the first level the current follows a power of the torque: 1 with a magnet, 1/2 without.
        power = np.log(self.current[1] / self.current[0]) / np.log(self.torque[1] / first)
        share = np.minimum(torque / first, 1.0) ** power
        return np.interp(torque, self.torque, self.i_d) * share, np.interp(torque, self.torque, self.i_q) * share


def _scan(machine: Machine, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best of an even grid of current angles per level, shape (L,) each."""
    angle = np.linspace(0.0, np.pi, _ANGLES)
    i_d = current[:, np.newaxis] * np.cos(angle)
    i_q = current[:, np.newaxis] * np.sin(angle)
    torque = torque_from_flux(machine.pole_pairs, *machine.flux(i_d.ravel(), i_q.ravel()), i_d.ravel(), i_q.ravel())
    best = np.argmax(torque.reshape(i_d.shape), axis=1)
    rows = np.arange(current.size)
    return i_d[rows, best], i_q[rows, best]


def mtpa_locus(machine: Machine, i_max: float) -> MtpaLocus:
    """Table of the MTPA locus up to ``i_max`` A (peak).

    Closed form for constant inductances; otherwise a scan of all angles per level, then Newton's method on
    |i|^2 = I^2 and parallel gradients of torque and |i|^2.

    Raises
    ------
    InputError
        The machine makes no torque with positive q current.
    """
    current = i_max * np.linspace(1.0 / _LEVELS, 1.0, _LEVELS) ** 1.5
    if isinstance(machine, LinearMachine):
        i_d, i_q = mtpa_at_current(machine, current)
    else:
        i_d, i_q = _scan(machine, current)
        for _ in range(_POLISHING_STEPS):
            jet = machine.jet(i_d, i_q)
            circle = current_terms(i_d, i_q)
            stationary = cross(torque_terms(machine, jet, i_d, i_q), circle)
            step_d, step_q = newton_step(circle, stationary, current**2, 0.0)
            size = np.hypot(step_d, step_q)
            damping = np.minimum(1.0, 0.1 * current / np.maximum(size, 1e-300))
            i_d, i_q = i_d + damping * step_d, i_q + damping * step_q
    torque = torque_from_flux(machine.pole_pairs, *machine.flux(i_d, i_q), i_d, i_q)
    if not (torque[0] > 0.0 and np.all(np.diff(torque) > 0.0)):
        raise InputError(
            "the machine's torque does not rise with the current along its MTPA locus; check the flux data"
        )
    return MtpaLocus(current, i_d, i_q, torque)
