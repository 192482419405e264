"""The currents that the limits allow at each speed, and the most torque among them.

The region inside both the current circle and the voltage limit is star-shaped about the current of
least flux. A scan of rays from there finds its boundary; Newton's method then finds the point of
most torque on it: the MTPA point of the current limit, the corner of both limits, or the touching
point of torque and voltage limit (MTPV).
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.ends_of_data.boundary import (
    ANGLES,
    INSIDE,
    RAYS,
    UPPER,
    BoolArray,
    IndexArray,
    Limits,
    boundary,
    make_limits,
    torque_at,
)
from dqforge.optimizer.operating_points.local_terms import (
    cross_of_gradients,
    current_terms,
    newton_step,
    torque_terms,
    voltage_terms,
)
from dqforge.optimizer.operating_points.mtpa_locus import MtpaLocus

_CIRCLE_POINTS = 65


_NEWTON_STEPS = 14


_GOLDEN_STEPS = 45


_TOLERANCE = 1e-9


@dataclass(frozen=True, slots=True)
class FeasibleRegion:
    """Boundary of the feasible currents at U speeds, and the point of most torque.

    ``reachable`` where the centre keeps the voltage limit, shape (U,); ``radius`` in A and
    ``torque`` in N m along `ray_angles`, shape (U, K); ``most_d``, ``most_q`` in A, ``most_torque``
    in N m and ``most_angle`` (its ray angle in rad), and ``at_voltage``, ``at_current`` whether
    these limits hold it there, shape (U,).
    """

    limits: Limits
    reachable: BoolArray
    radius: FloatArray
    torque: FloatArray
    most_d: FloatArray
    most_q: FloatArray
    most_torque: FloatArray
    most_angle: FloatArray
    at_voltage: BoolArray
    at_current: BoolArray


def _polish(
    limits: Limits, i_d: FloatArray, i_q: FloatArray, *, corner: bool
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Corner of both limits, or MTPV, from starting currents of shape (N,).

    Returns currents and convergence.
    """
    i_d, i_q = i_d.copy(), i_q.copy()
    done = np.zeros(i_d.size, dtype=np.bool_)
    live = np.arange(i_d.size)
    for _ in range(_NEWTON_STEPS):
        if live.size == 0:
            break
        here, d, q = limits.take(live), i_d[live], i_q[live]
        jet = limits.machine.jet(d, q)
        voltage = voltage_terms(limits.machine, jet, d, q, here.omega_e)
        other = (
            current_terms(d, q)
            if corner
            else cross_of_gradients(torque_terms(limits.machine, jet, d, q), voltage)
        )
        step_d, step_q = newton_step(
            voltage, other, here.v_max**2, limits.i_max**2 if corner else 0.0
        )
        size = np.hypot(step_d, step_q)
        finite = np.isfinite(size)
        damping = np.where(
            finite, np.minimum(1.0, 0.2 * limits.i_max / np.maximum(size, 1e-300)), 0.0
        )
        i_d[live] = d + np.where(finite, damping * step_d, 0.0)
        i_q[live] = q + np.where(finite, damping * step_q, 0.0)
        small = size < 1e-7 * limits.i_max
        done[live[small]] = True
        live = live[~small & finite]
    return i_d, i_q, done


@dataclass(slots=True)
class _Best:
    """The point of most torque found so far, per speed, shape (U,)."""

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    at_voltage: BoolArray
    at_current: BoolArray
    settled: BoolArray

    def offer(
        self,
        index: IndexArray,
        i_d: FloatArray,
        i_q: FloatArray,
        torque: FloatArray,
        valid: BoolArray,
        held: tuple[bool, bool],
    ) -> None:
        """Take points that are valid and no worse than the best.

        ``held`` says by voltage and by current limit.
        """
        better = valid & (torque >= self.torque[index] - _TOLERANCE * np.abs(self.torque[index]))
        chosen = index[better]
        self.i_d[chosen], self.i_q[chosen], self.torque[chosen] = (
            i_d[better],
            i_q[better],
            torque[better],
        )
        self.at_voltage[chosen], self.at_current[chosen] = held
        self.settled[chosen] = True


def _offer_exact_points(limits: Limits, locus: MtpaLocus, best: _Best) -> None:
    """Offer the three kinds of exact solution: MTPA at the current limit, the corners, and MTPV."""
    machine, count = limits.machine, limits.omega_e.size
    end_d, end_q = np.full(count, locus.i_d[-1]), np.full(count, locus.i_q[-1])
    kept = limits.voltage_square(end_d, end_q) <= limits.v_max**2 * (1.0 + _TOLERANCE)
    best.offer(
        np.arange(count), end_d, end_q, np.full(count, locus.torque[-1]), kept, (False, True)
    )
    open_rows = np.flatnonzero(~kept)
    here = limits.take(open_rows)
    _offer_mtpv(here, best, open_rows)
    for row, start_d, start_q in _corner_starts(here):
        i_d, i_q, done = _polish(here.take(row), start_d, start_q, corner=True)
        best.offer(open_rows[row], i_d, i_q, torque_at(machine, i_d, i_q), done, (True, True))
    # Once more from the corners: next to one the touching point may have been
    # missed from the best ray.
    _offer_mtpv(here, best, open_rows)


def _offer_mtpv(limits: Limits, best: _Best, rows: IndexArray) -> None:
    """Offer the touching point of torque and voltage limit, from the best so far.

    ``limits`` are those of ``rows``.
    """
    i_d, i_q, done = _polish(limits, best.i_d[rows], best.i_q[rows], corner=False)
    inside = np.hypot(i_d, i_q) <= limits.i_max * (1.0 + _TOLERANCE)
    best.offer(rows, i_d, i_q, torque_at(limits.machine, i_d, i_q), done & inside, (True, False))


def _corner_starts(limits: Limits) -> list[tuple[IndexArray, FloatArray, FloatArray]]:
    """First and last crossing of the voltage limit along the upper half circle:
    rows and currents in A.
    """
    angle = np.linspace(0.0, np.pi, _CIRCLE_POINTS)
    count = limits.omega_e.size
    wide = limits.take(np.repeat(np.arange(count), _CIRCLE_POINTS))
    i_d, i_q = (
        limits.i_max * np.tile(np.cos(angle), count),
        limits.i_max * np.tile(np.sin(angle), count),
    )
    gap = (wide.voltage_square(i_d, i_q) - wide.v_max**2).reshape(count, _CIRCLE_POINTS)
    change = (gap[:, 1:] > 0.0) != (gap[:, :-1] > 0.0)
    rows = np.flatnonzero(change.any(axis=1))
    first = np.argmax(change[rows], axis=1)
    last = change.shape[1] - 1 - np.argmax(change[rows][:, ::-1], axis=1)
    starts = []
    for place in (first, last):
        before, after = gap[rows, place], gap[rows, place + 1]
        crossing = angle[place] + (angle[1] - angle[0]) * before / (before - after)
        starts.append((rows, limits.i_max * np.cos(crossing), limits.i_max * np.sin(crossing)))
    return starts


def _settle_by_golden_section(limits: Limits, best: _Best, top: IndexArray) -> None:
    """Refine what no exact solution settled: golden section over the ray
    angle about the best ray.
    """
    rows = np.flatnonzero(~best.settled)
    if rows.size == 0:
        return
    here, ratio = limits.take(rows), 0.5 * (np.sqrt(5.0) - 1.0)
    low, high = ANGLES[np.maximum(top[rows] - 1, 0)], ANGLES[np.minimum(top[rows] + 1, RAYS - 1)]
    left, right = high - ratio * (high - low), low + ratio * (high - low)
    at_left, at_right = boundary(here, left)[1], boundary(here, right)[1]
    for _ in range(_GOLDEN_STEPS):
        lower = at_left > at_right
        low, high = np.where(lower, low, left), np.where(lower, right, high)
        fresh = np.where(lower, high - ratio * (high - low), low + ratio * (high - low))
        value = boundary(here, fresh)[1]
        left, right = np.where(lower, fresh, right), np.where(lower, left, fresh)
        at_left, at_right = np.where(lower, value, at_right), np.where(lower, at_left, value)
    angle = np.where(at_left > at_right, left, right)
    radius, torque, at_voltage = boundary(here, angle)
    best.i_d[rows], best.i_q[rows] = here.point(angle, radius)
    best.torque[rows] = torque
    best.at_voltage[rows] = at_voltage | (
        here.voltage_square(*here.point(angle, radius)) > INSIDE * here.v_max**2
    )
    best.at_current[rows] = np.hypot(best.i_d[rows], best.i_q[rows]) >= limits.i_max * (1.0 - 1e-6)


def scan_region(
    machine: Machine, locus: MtpaLocus, omega_e: FloatArray, v_max: FloatArray, i_max: float
) -> FeasibleRegion:
    """Feasible region and most torque at electrical speeds in rad/s of any sign, shape (U,).

    Torque is counted positive; ``locus`` is the machine's MTPA locus up to ``i_max`` A (peak),
    ``v_max`` the largest phase-voltage amplitude in V, shape (U,).

    Args:
        machine: Any machine.
        locus: Its MTPA locus up to the current limit.
        omega_e: Electrical speeds in rad/s of any sign, shape (U,).
        v_max: Largest phase-voltage amplitudes in V (peak), shape (U,).
        i_max: Current limit in A (peak).
    """
    limits = make_limits(machine, omega_e, v_max, i_max)
    count = omega_e.size
    reachable = limits.voltage_square(limits.centre_d, limits.centre_q) < v_max**2
    flat = boundary(limits.take(np.repeat(np.arange(count), RAYS)), np.tile(ANGLES, count))
    radius, torque = flat[0].reshape(count, RAYS), flat[1].reshape(count, RAYS)
    at_voltage = flat[2].reshape(count, RAYS)
    top, rows = np.argmax(torque[:, UPPER:], axis=1) + UPPER, np.arange(count)
    start = limits.point(ANGLES[top], radius[rows, top])
    held = at_voltage[rows, top]
    best = _Best(
        *start, torque[rows, top].copy(), held.copy(), ~held, np.zeros(count, dtype=np.bool_)
    )
    _offer_exact_points(limits, locus, best)
    _settle_by_golden_section(limits, best, top)
    angle = np.arctan2(best.i_q - limits.centre_q, best.i_d - limits.centre_d)
    return FeasibleRegion(
        limits,
        reachable,
        radius,
        torque,
        best.i_d,
        best.i_q,
        best.torque,
        angle,
        best.at_voltage,
        best.at_current,
    )
