"""The batched solver of one chunk of points: Newton's method from starts that a scan of the
feasible region gives.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.ends_of_data import (
    ANGLES,
    INSIDE,
    RAYS,
    UPPER,
    BoolArray,
    IndexArray,
    Limits,
    boundary,
    make_limits,
    ray_angles,
    torque_at,
    voltage_radius,
)
from dqforge.optimizer.operating_points.mtpa_locus import (
    Active,
    MtpaLocus,
    Problem,
    State,
    cross_of_gradients,
    current_terms,
    loss_terms,
    newton_step,
    torque_terms,
    voltage_terms,
)

_NEWTON_STEPS = 16
_CROSSING_STEPS = 40

# Newton step over current after which the next iterate is exact to rounding (the convergence is
# quadratic).
_SMALL_STEP = 1e-6
_ROUNDING = 1e-9  # Relative slack within which a limit counts as kept.


def _valley(problem: Problem) -> tuple[FloatArray, FloatArray]:
    """Least loss on each torque curve, no limits regarded: currents in A, shape (N,)."""
    machine, i_max = problem.machine, problem.i_max
    i_d, i_q = problem.locus.start(problem.torque)
    live = np.arange(i_d.size)
    for _ in range(_NEWTON_STEPS):
        here, d, q = problem.take(live), i_d[live], i_q[live]
        jet = machine.jet(d, q)
        torque = torque_terms(machine, jet, d, q)
        valley = cross_of_gradients(loss_terms(here.loss, jet, d, q, problem.soft), torque)
        step_d, step_q = newton_step(torque, valley, here.torque, 0.0)
        size = np.hypot(step_d, step_q)
        finite = np.isfinite(size)
        damping = np.where(finite, np.minimum(1.0, 0.25 * i_max / np.maximum(size, 1e-300)), 0.0)
        i_d[live] = d + np.where(finite, damping * step_d, 0.0)
        i_q[live] = q + np.where(finite, damping * step_q, 0.0)
        # Relative to the current itself: near zero torque the valley is bent on
        # the scale of the current.
        live = live[finite & (size > _SMALL_STEP * np.hypot(d, q) + 1e-13 * i_max)]
        if live.size == 0:
            break
    return i_d, i_q


def _crossing_start(
    region: FeasibleRegion, speed: IndexArray, torque: FloatArray, least_angle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Bracket of ray angles around the torque on the rising side of the boundary,
    and a first angle and radius.

    ``least_angle`` is the ray angle of the least torque where the torque lies below
    all scanned rays, else nan.
    """
    angles = ray_angles()
    scanned = region.torque[speed]
    # The last rise before the most torque: an earlier one belongs to the opposite currents.
    top = np.argmax(scanned[:, UPPER:], axis=1) + UPPER
    rising = np.arange(angles.size) <= top[:, np.newaxis]
    below = rising & (scanned < torque[:, np.newaxis])
    last = angles.size - 1 - np.argmax(below[:, ::-1], axis=1)
    after = np.where(below.any(axis=1), last + 1, 0)
    found = after <= top
    most_angle = region.most_angle[speed]
    upper = np.where(found, after, np.searchsorted(angles, most_angle))
    upper = np.clip(np.minimum(upper, np.searchsorted(angles, most_angle)), 1, angles.size - 1)
    rows = np.arange(speed.size)
    at_ray = found & (angles[upper] <= most_angle)
    low, high = angles[upper - 1], np.where(at_ray, angles[upper], most_angle)
    below, above = (
        scanned[rows, upper - 1],
        np.where(at_ray, scanned[rows, upper], region.most_torque[speed]),
    )
    share = np.clip((torque - below) / np.maximum(above - below, 1e-300), 0.0, 1.0)
    radius = region.radius[speed]
    start_radius = radius[rows, upper - 1] * (1.0 - share) + radius[rows, upper] * share
    floored = np.flatnonzero(np.isfinite(least_angle))
    next_ray = np.minimum(np.searchsorted(angles, least_angle[floored]), angles.size - 1)
    low[floored], high[floored] = least_angle[floored], angles[next_ray]
    start_radius[floored] = radius[floored, next_ray]
    return low, high, low + share * (high - low), start_radius


def _crossing(
    problem: Problem,
    limits: Limits,
    low: FloatArray,
    high: FloatArray,
    angle: FloatArray,
    radius: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Where each torque curve enters the voltage limit on the side of less current: currents in A,
    shape (N,).

    Newton's method in both currents; the ray angle is kept inside a bracket that shrinks with
    every point on the limit.
    """
    machine = problem.machine
    low, high = low.copy(), high.copy()
    i_d, i_q = limits.point(angle, radius)
    live = np.arange(angle.size)
    for _ in range(_CROSSING_STEPS):
        here, d, q = limits.take(live), i_d[live], i_q[live]
        wanted = problem.torque[live]
        jet = machine.jet(d, q)
        torque = torque_terms(machine, jet, d, q)
        voltage = voltage_terms(machine, jet, d, q, here.omega_e)
        square = here.v_max**2
        now = np.arctan2(q - here.centre_q, d - here.centre_d)
        near = np.abs(voltage.value - square) < 1e-9 * square
        low[live] = np.where(near & (torque.value < wanted), np.maximum(low[live], now), low[live])
        high[live] = np.where(
            near & (torque.value > wanted), np.minimum(high[live], now), high[live]
        )
        step_d, step_q = newton_step(torque, voltage, wanted, square)
        next_d, next_q = d + step_d, q + step_q
        with np.errstate(invalid="ignore"):
            turned = np.arctan2(next_q - here.centre_q, next_d - here.centre_d)
            size = np.hypot(step_d, step_q)
            slack = 1e-7
            good = (
                (turned >= low[live] - slack)
                & (turned <= high[live] + slack)
                & (size < problem.i_max)
            )
        bad = np.flatnonzero(~good)
        if bad.size:
            middle = 0.5 * (low[live[bad]] + high[live[bad]])
            stuck = here.take(bad)
            length, _ = voltage_radius(stuck, middle, 2.0 * stuck.circle_radius(middle) + 1e-9)
            next_d[bad], next_q[bad] = stuck.point(middle, length)
        i_d[live], i_q[live] = next_d, next_q
        live = live[~(good & (size < _SMALL_STEP * problem.i_max))]
        if live.size == 0:
            break
    return i_d, i_q


def solve_chunk(problem: Problem) -> State:
    """Unlimited optimum first; where it breaks a limit, the region's most torque or
    the crossing with the limit.

    Args:
        problem: Machine, torques and limits of the points.
    """
    i_d, i_q = _valley(problem)
    limits = Limits(
        problem.machine,
        np.zeros_like(i_d),
        np.zeros_like(i_d),
        problem.omega_e,
        problem.v_max,
        problem.i_max,
    )
    square = limits.voltage_square(i_d, i_q)
    kept = (np.hypot(i_d, i_q) <= problem.i_max * (1.0 + _ROUNDING)) & (square <= problem.v_max**2)
    kept &= problem.torque <= problem.locus.torque[-1] * (1.0 + _ROUNDING)
    state = State(
        i_d,
        i_q,
        problem.torque.copy(),
        np.zeros(i_d.size, dtype=np.int8),
        np.ones(i_d.size, dtype=np.bool_),
        np.zeros(i_d.size, dtype=np.bool_),
    )
    rest = np.flatnonzero(~kept)
    if rest.size:
        _solve_limited(problem, state, rest)
    return state


def _solve_limited(problem: Problem, state: State, rest: IndexArray) -> None:
    """Points whose unlimited optimum breaks a limit."""
    pairs = np.stack([problem.omega_e[rest], problem.v_max[rest]], axis=1)
    unique, speed = np.unique(pairs, axis=0, return_inverse=True)
    speed = speed.reshape(-1)
    region = scan_region(
        problem.machine, problem.locus, unique[:, 0].copy(), unique[:, 1].copy(), problem.i_max
    )
    most = region.most_torque[speed]
    too_much = (problem.torque[rest] > most * (1.0 + 1e-12)) | ~region.reachable[speed]
    _grant_the_most(state, rest[too_much], region, speed[too_much])
    held_by_current = ~too_much & (
        Limits(
            problem.machine,
            np.zeros(rest.size),
            np.zeros(rest.size),
            problem.omega_e[rest],
            problem.v_max[rest],
            problem.i_max,
        ).voltage_square(state.i_d[rest], state.i_q[rest])
        <= problem.v_max[rest] ** 2
    )
    _hold_by_current(problem, state, rest[held_by_current])
    doubtful = np.flatnonzero(
        ~too_much & (problem.torque[rest] < np.min(region.torque, axis=1)[speed])
    )
    least_angle = np.full(rest.size, np.nan)
    granted, least_angle[doubtful] = _grant_the_least(
        problem, state, rest[doubtful], region.limits.take(speed[doubtful])
    )
    crossing = ~too_much & ~held_by_current
    crossing[doubtful[granted]] = False
    index = rest[crossing]
    if index.size:
        start = _crossing_start(
            region, speed[crossing], problem.torque[index], least_angle[crossing]
        )
        limits = region.limits.take(speed[crossing])
        state.i_d[index], state.i_q[index] = _crossing(problem.take(index), limits, *start)
        state.active[index] = Active.VOLTAGE


def _grant_the_least(
    problem: Problem, state: State, index: IndexArray, limits: Limits
) -> tuple[BoolArray, FloatArray]:
    """Give the point of least torque where even that is more than was asked for.

    Returns where, and its ray angle.

    This happens next to the end of the speed range alone, where the resistance lets only braking
    currents keep the voltage limit. The least torque at a speed is the mirror image of the most
    torque at the opposite speed.
    """
    if index.size == 0:
        return np.zeros(0, dtype=np.bool_), np.zeros(0)
    mirrored = scan_region(
        problem.machine, problem.locus, -problem.omega_e[index], problem.v_max[index], problem.i_max
    )
    granted = problem.torque[index] < -mirrored.most_torque
    chosen = index[granted]
    state.i_d[chosen], state.i_q[chosen] = mirrored.most_d[granted], -mirrored.most_q[granted]
    state.torque[chosen] = -mirrored.most_torque[granted]
    state.reached[chosen], state.least[chosen] = False, True
    state.active[chosen] = np.where(mirrored.at_current[granted], Active.BOTH, Active.MTPV).astype(
        np.int8
    )
    return granted, np.arctan2(
        -mirrored.most_q - limits.centre_q, mirrored.most_d - limits.centre_d
    )


def _grant_the_most(
    state: State, index: IndexArray, region: FeasibleRegion, speed: IndexArray
) -> None:
    """Give the point of most torque where more was asked for, or where the
    speed cannot be had at all.
    """
    reachable = region.reachable[speed]
    state.i_d[index] = np.where(reachable, region.most_d[speed], region.limits.centre_d[speed])
    state.i_q[index] = np.where(reachable, region.most_q[speed], region.limits.centre_q[speed])
    state.torque[index] = np.where(reachable, region.most_torque[speed], 0.0)
    state.reached[index] = False
    by_voltage, by_current = region.at_voltage[speed], region.at_current[speed]
    code = np.where(
        by_voltage & by_current, Active.BOTH, np.where(by_voltage, Active.MTPV, Active.CURRENT)
    )
    state.active[index] = np.where(reachable, code, Active.UNREACHABLE).astype(np.int8)


def _hold_by_current(problem: Problem, state: State, index: IndexArray) -> None:
    """Least total loss beyond the current limit: the torque curve meets the circle,
    on the side of the valley.
    """
    if index.size == 0:
        return
    d, q, wanted = state.i_d[index], state.i_q[index], problem.torque[index]
    scale = problem.i_max / np.hypot(d, q)
    d, q = d * scale, q * scale
    for _ in range(_NEWTON_STEPS):
        torque = torque_terms(problem.machine, problem.machine.jet(d, q), d, q)
        step_d, step_q = newton_step(torque, current_terms(d, q), wanted, problem.i_max**2)
        d, q = d + np.nan_to_num(step_d), q + np.nan_to_num(step_q)
    state.i_d[index], state.i_q[index], state.active[index] = d, q, Active.CURRENT


# The currents that the limits allow at each speed, and the most torque among them.
#
# The region inside both the current circle and the voltage limit is star-shaped about the current
# of least flux. A scan of rays from there finds its boundary; Newton's method then finds the point
# of most torque on it: the MTPA point of the current limit, the corner of both limits, or the
# touching point of torque and voltage limit (MTPV).

_CIRCLE_POINTS = 65


_FEASIBLE_REGION_NEWTON_STEPS = 14


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
    for _ in range(_FEASIBLE_REGION_NEWTON_STEPS):
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
