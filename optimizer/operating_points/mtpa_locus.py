"""The MTPA locus of any machine as a table over current: starts of the batched solver,
and a characteristic.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.current_region import CurrentRegion
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, torque_from_flux
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.local_terms import (
    cross_of_gradients,
    current_terms,
    newton_step,
    torque_terms,
)
from dqforge.optimizer.operating_points.mtpa import mtpa_at_current
from dqforge.optimizer.operating_points.region_edges import intervals_of, region_that_holds

_LEVELS = 160
_ANGLES = 121
_POLISHING_STEPS = 6

# Share of an edge by which a crossing may lie beyond its corner: rounding must not let it slip
# through.
_CORNER = 1e-9


@dataclass(frozen=True, slots=True)
class MtpaLocus:
    """Points of most torque for their current, ascending in current, arrays of shape (L,): A, A,
    A and N m.

    ``held`` marks those on the edge of a flux map's data, beyond which more torque may lie.
    """

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    held: NDArray[np.bool_]

    def start(self, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents near the locus for torque >= 0 in N m, shape (N,).

        Beyond the table its last point.
        """
        first = float(self.torque[0])
        # Below the first level the current follows a power of the torque: 1 with a magnet,
        # 1/2 without.
        power = np.log(self.current[1] / self.current[0]) / np.log(self.torque[1] / first)
        share = np.minimum(torque / first, 1.0) ** power
        return np.interp(torque, self.torque, self.i_d) * share, np.interp(
            torque, self.torque, self.i_q
        ) * share


def _scan(machine: Machine, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Best of an even grid of current angles per level, shape (L,) each."""
    angle = np.linspace(0.0, np.pi, _ANGLES)
    i_d = current[:, np.newaxis] * np.cos(angle)
    i_q = current[:, np.newaxis] * np.sin(angle)
    torque = torque_from_flux(
        machine.pole_pairs, *machine.flux(i_d.ravel(), i_q.ravel()), i_d.ravel(), i_q.ravel()
    )
    best = np.argmax(torque.reshape(i_d.shape), axis=1)
    rows = np.arange(current.size)
    return i_d[rows, best], i_q[rows, best]


def free_locus(machine: Machine, i_max: float) -> MtpaLocus:
    """Table of the MTPA locus up to ``i_max`` A (peak), wherever the data of a flux map end.

    Closed form for constant inductances; otherwise a scan of all angles per level, then Newton's
    method on |i|^2 = I^2 and parallel gradients of torque and |i|^2.

    Raises:
        InputError: The machine makes no torque with positive q current.
    """
    current = i_max * np.linspace(1.0 / _LEVELS, 1.0, _LEVELS) ** 1.5
    if isinstance(machine, LinearMachine):
        i_d, i_q = mtpa_at_current(machine, current)
    else:
        i_d, i_q = _scan(machine, current)
        for _ in range(_POLISHING_STEPS):
            jet = machine.jet(i_d, i_q)
            circle = current_terms(i_d, i_q)
            stationary = cross_of_gradients(torque_terms(machine, jet, i_d, i_q), circle)
            step_d, step_q = newton_step(circle, stationary, current**2, 0.0)
            size = np.hypot(step_d, step_q)
            damping = np.minimum(1.0, 0.1 * current / np.maximum(size, 1e-300))
            i_d, i_q = i_d + damping * step_d, i_q + damping * step_q
    torque = torque_from_flux(machine.pole_pairs, *machine.flux(i_d, i_q), i_d, i_q)
    if not (torque[0] > 0.0 and np.all(np.diff(torque) > 0.0)):
        raise InputError(
            "the machine's torque does not rise with the current along its MTPA locus; check the "
            "flux data"
        )
    return MtpaLocus(current, i_d, i_q, torque, np.zeros(torque.size, dtype=np.bool_))


def mtpa_locus(machine: Machine, i_max: float) -> MtpaLocus:
    """Table of the MTPA locus up to ``i_max`` A (peak), or up to the most torque that
    the data of a flux map hold.

    Args:
        machine: Any machine.
        i_max: Current limit in A (peak).

    Raises:
        InputError: As `free_locus`.
    """
    free, region = free_locus(machine, i_max), region_that_holds(machine, i_max)
    if region is None or bool(np.all(region.contains(free.i_d, free.i_q))):
        return free
    return _held_locus(machine, region, free)


def _held_locus(machine: Machine, region: CurrentRegion, free: MtpaLocus) -> MtpaLocus:
    """The locus with what lies beyond a region on its edge instead."""
    if not region.contains(free.i_d[-1:], free.i_q[-1:])[0]:
        end_d, end_q = (
            part.ravel() for part in intervals_of(machine, region, float(free.current[-1])).ends()
        )
        best = int(np.argmax(machine.torque(end_d, end_q)))
        end = np.array([end_d[best]]), np.array([end_q[best]])
        free = free_locus(machine, float(np.hypot(*end)[0]))
    else:
        end = free.i_d[-1:], free.i_q[-1:]
    held = ~region.contains(free.i_d, free.i_q)
    i_d, i_q = free.i_d.copy(), free.i_q.copy()
    i_d[held], i_q[held] = _best_on_circles(machine, region, free.current[held])
    i_d[-1:], i_q[-1:] = end
    torque = machine.torque(i_d, i_q)
    # Where less current makes as much torque, more current is no point of the locus.
    kept = torque > np.maximum.accumulate(np.append(0.0, torque[:-1]))
    return MtpaLocus(free.current[kept], i_d[kept], i_q[kept], torque[kept], held[kept])


def _best_on_circles(
    machine: Machine, region: CurrentRegion, current: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Most torque among the currents of a magnitude in A that lie on the edge of a region,
    shape (L,) each.
    """
    d, q = region.corner_d[:, np.newaxis, np.newaxis], region.corner_q[:, np.newaxis, np.newaxis]
    step_d, step_q = np.roll(d, -1, axis=0) - d, np.roll(q, -1, axis=0) - q
    square, half = step_d**2 + step_q**2, d * step_d + q * step_q
    under = half**2 - square * (d**2 + q**2 - current[:, np.newaxis] ** 2)
    share = (-half + np.array([-1.0, 1.0]) * np.sqrt(np.maximum(under, 0.0))) / square  # (K, L, 2)
    on_edge = (under >= 0.0) & (share >= -_CORNER) & (share <= 1.0 + _CORNER)
    i_d, i_q = d + share * step_d, q + share * step_q
    torque = np.where(on_edge, machine.torque(i_d, i_q), -np.inf)
    flat = np.moveaxis(torque, 1, 0).reshape(current.size, -1)
    best, rows = np.argmax(flat, axis=1), np.arange(current.size)
    found_d, found_q = (
        np.moveaxis(part, 1, 0).reshape(current.size, -1)[rows, best] for part in (i_d, i_q)
    )
    return found_d, found_q
