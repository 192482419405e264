"""Optimal operating points of any machine, whole arrays of torque and speed at once.

Least loss for a torque at a speed, within the current limit and the voltage limit of the modulator, the resistance drop
included. In two currents every optimum is the meeting of two curves: the torque and the valley of the loss, the torque
and the voltage limit, the voltage limit and the current limit, or the touching point of torque and voltage limit
(MTPV). Each is solved by Newton's method from a start that a scan of the feasible region gives, never from the user.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.synchronous import FloatArray, Machine
from dqforge.optimizer.feasible_region import FeasibleRegion, Limits, ray_angles, scan_region, voltage_radius
from dqforge.optimizer.local_terms import (
    LossCoefficients,
    Terms,
    cross,
    current_terms,
    loss_terms,
    newton_step,
    torque_terms,
    voltage_terms,
)
from dqforge.optimizer.mtpa_locus import MtpaLocus, mtpa_locus

IndexArray = NDArray[np.intp]
BoolArray = NDArray[np.bool_]

CHUNK = 32_768
"""Points solved together: bounds the memory whatever the number of points, and keeps the arrays in the cache."""

_NEWTON_STEPS = 16
_CROSSING_STEPS = 40
_SMALL_STEP = 1e-6
"""Newton step over current limit after which the next iterate is exact to rounding (the convergence is quadratic)."""

_ROUNDING = 1e-9
"""Relative slack within which a limit counts as kept."""


class Active(IntEnum):
    """What holds a point where it is."""

    NONE = 0
    VOLTAGE = 1
    CURRENT = 2
    BOTH = 3
    MTPV = 4
    UNREACHABLE = 5

    @property
    def label(self) -> str:
        """Name for tables: none, voltage, current, both, MTPV, unreachable."""
        return "MTPV" if self is Active.MTPV else self.name.lower()


@dataclass(frozen=True, slots=True)
class OptimalPoints:
    """Operating points, arrays of shape (N,).

    ``torque_request`` and ``torque`` in N m (equal where ``reached``), ``omega_m`` in rad/s, ``i_d``, ``i_q`` in A,
    ``voltage`` is the phase amplitude in V, ``loss`` in W by the objective's model. ``active`` holds codes of `Active`.
    ``kkt_residual`` is the largest of the relative violations of torque, limits, stationarity and multiplier signs.
    """

    torque_request: FloatArray
    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    voltage: FloatArray
    loss: FloatArray
    active: NDArray[np.int8]
    reached: BoolArray
    kkt_residual: FloatArray


@dataclass(frozen=True, slots=True)
class _Problem:
    """One chunk with torque counted positive (the q axis mirrored where it was negative), arrays of shape (N,)."""

    machine: Machine
    locus: MtpaLocus
    torque: FloatArray
    omega_e: FloatArray
    v_max: FloatArray
    i_max: float
    loss: LossCoefficients

    @property
    def soft(self) -> float:
        """Current in A over which the tip of |i| is rounded."""
        return 1e-6 * self.i_max

    def take(self, index: IndexArray) -> _Problem:
        return _Problem(
            self.machine,
            self.locus,
            self.torque[index],
            self.omega_e[index],
            self.v_max[index],
            self.i_max,
            self.loss.take(index),
        )


def _valley(problem: _Problem) -> tuple[FloatArray, FloatArray]:
    """Least loss on each torque curve, no limits regarded: currents in A, shape (N,)."""
    machine, i_max = problem.machine, problem.i_max
    i_d, i_q = problem.locus.start(problem.torque)
    live = np.arange(i_d.size)
    for _ in range(_NEWTON_STEPS):
        here, d, q = problem.take(live), i_d[live], i_q[live]
        jet = machine.jet(d, q)
        torque = torque_terms(machine, jet, d, q)
        valley = cross(loss_terms(here.loss, jet, d, q, problem.soft), torque)
        step_d, step_q = newton_step(torque, valley, here.torque, 0.0)
        size = np.hypot(step_d, step_q)
        finite = np.isfinite(size)
        damping = np.where(finite, np.minimum(1.0, 0.25 * i_max / np.maximum(size, 1e-300)), 0.0)
        i_d[live] = d + np.where(finite, damping * step_d, 0.0)
        i_q[live] = q + np.where(finite, damping * step_q, 0.0)
        # Relative to the current itself: near zero torque the valley is bent on the scale of the current.
        live = live[finite & (size > _SMALL_STEP * np.hypot(d, q) + 1e-13 * i_max)]
        if live.size == 0:
            break
    return i_d, i_q


def _crossing_start(
    region: FeasibleRegion, speed: IndexArray, torque: FloatArray, least_angle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Bracket of ray angles around the torque on the rising side of the boundary, and a first angle and radius.

    ``least_angle`` is the ray angle of the least torque where the torque lies below all scanned rays, else nan.
    """
    angles = ray_angles()
    scanned = region.torque[speed]
    rising = np.arange(angles.size) <= np.argmax(scanned, axis=1)[:, np.newaxis]
    reaches = rising & (scanned >= torque[:, np.newaxis])
    found = reaches.any(axis=1)
    most_angle = region.most_angle[speed]
    upper = np.where(found, np.argmax(reaches, axis=1), np.searchsorted(angles, most_angle))
    upper = np.clip(np.minimum(upper, np.searchsorted(angles, most_angle)), 1, angles.size - 1)
    rows = np.arange(speed.size)
    at_ray = found & (angles[upper] <= most_angle)
    low, high = angles[upper - 1], np.where(at_ray, angles[upper], most_angle)
    below, above = scanned[rows, upper - 1], np.where(at_ray, scanned[rows, upper], region.most_torque[speed])
    share = np.clip((torque - below) / np.maximum(above - below, 1e-300), 0.0, 1.0)
    radius = region.radius[speed]
    start_radius = radius[rows, upper - 1] * (1.0 - share) + radius[rows, upper] * share
    floored = np.flatnonzero(np.isfinite(least_angle))
    next_ray = np.minimum(np.searchsorted(angles, least_angle[floored]), angles.size - 1)
    low[floored], high[floored] = least_angle[floored], angles[next_ray]
    start_radius[floored] = radius[floored, next_ray]
    return low, high, low + share * (high - low), start_radius


def _crossing(
    problem: _Problem, limits: Limits, low: FloatArray, high: FloatArray, angle: FloatArray, radius: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where each torque curve enters the voltage limit on the side of less current: currents in A, shape (N,).

    Newton's method in both currents; the ray angle is kept inside a bracket that shrinks with every point on the limit.
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
        high[live] = np.where(near & (torque.value > wanted), np.minimum(high[live], now), high[live])
        step_d, step_q = newton_step(torque, voltage, wanted, square)
        next_d, next_q = d + step_d, q + step_q
        with np.errstate(invalid="ignore"):
            turned = np.arctan2(next_q - here.centre_q, next_d - here.centre_d)
            size = np.hypot(step_d, step_q)
            slack = 1e-7
            good = (turned >= low[live] - slack) & (turned <= high[live] + slack) & (size < problem.i_max)
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


@dataclass(slots=True)
class _State:
    """Solution of a chunk as it grows, arrays of shape (N,)."""

    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    active: NDArray[np.int8]
    reached: BoolArray
    least: BoolArray


def _solve_chunk(problem: _Problem) -> _State:
    """Unlimited optimum first; where it breaks a limit, the region's most torque or the crossing with the limit."""
    i_d, i_q = _valley(problem)
    limits = Limits(
        problem.machine, np.zeros_like(i_d), np.zeros_like(i_d), problem.omega_e, problem.v_max, problem.i_max
    )
    square = limits.voltage_square(i_d, i_q)
    kept = (np.hypot(i_d, i_q) <= problem.i_max * (1.0 + _ROUNDING)) & (square <= problem.v_max**2)
    kept &= problem.torque <= problem.locus.torque[-1] * (1.0 + _ROUNDING)
    state = _State(
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


def _solve_limited(problem: _Problem, state: _State, rest: IndexArray) -> None:
    """Points whose unlimited optimum breaks a limit."""
    pairs = np.stack([problem.omega_e[rest], problem.v_max[rest]], axis=1)
    unique, speed = np.unique(pairs, axis=0, return_inverse=True)
    speed = speed.reshape(-1)
    region = scan_region(problem.machine, problem.locus, unique[:, 0].copy(), unique[:, 1].copy(), problem.i_max)
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
    doubtful = np.flatnonzero(~too_much & (problem.torque[rest] < np.min(region.torque, axis=1)[speed]))
    least_angle = np.full(rest.size, np.nan)
    granted, least_angle[doubtful] = _grant_the_least(
        problem, state, rest[doubtful], region.limits.take(speed[doubtful])
    )
    crossing = ~too_much & ~held_by_current
    crossing[doubtful[granted]] = False
    index = rest[crossing]
    if index.size:
        start = _crossing_start(region, speed[crossing], problem.torque[index], least_angle[crossing])
        limits = region.limits.take(speed[crossing])
        state.i_d[index], state.i_q[index] = _crossing(problem.take(index), limits, *start)
        state.active[index] = Active.VOLTAGE


def _grant_the_least(
    problem: _Problem, state: _State, index: IndexArray, limits: Limits
) -> tuple[BoolArray, FloatArray]:
    """Give the point of least torque where even that is more than was asked for; returns where, and its ray angle.

    This happens next to the end of the speed range alone, where the resistance lets only braking currents keep the
    voltage limit. The least torque at a speed is the mirror image of the most torque at the opposite speed.
    """
    if index.size == 0:
        return np.zeros(0, dtype=np.bool_), np.zeros(0)
    mirrored = scan_region(problem.machine, problem.locus, -problem.omega_e[index], problem.v_max[index], problem.i_max)
    granted = problem.torque[index] < -mirrored.most_torque
    chosen = index[granted]
    state.i_d[chosen], state.i_q[chosen] = mirrored.most_d[granted], -mirrored.most_q[granted]
    state.torque[chosen] = -mirrored.most_torque[granted]
    state.reached[chosen], state.least[chosen] = False, True
    state.active[chosen] = np.where(mirrored.at_current[granted], Active.BOTH, Active.MTPV).astype(np.int8)
    return granted, np.arctan2(-mirrored.most_q - limits.centre_q, mirrored.most_d - limits.centre_d)


def _grant_the_most(state: _State, index: IndexArray, region: FeasibleRegion, speed: IndexArray) -> None:
    """Give the point of most torque where more was asked for, or where the speed cannot be had at all."""
    reachable = region.reachable[speed]
    state.i_d[index] = np.where(reachable, region.most_d[speed], region.limits.centre_d[speed])
    state.i_q[index] = np.where(reachable, region.most_q[speed], region.limits.centre_q[speed])
    state.torque[index] = np.where(reachable, region.most_torque[speed], 0.0)
    state.reached[index] = False
    by_voltage, by_current = region.at_voltage[speed], region.at_current[speed]
    code = np.where(by_voltage & by_current, Active.BOTH, np.where(by_voltage, Active.MTPV, Active.CURRENT))
    state.active[index] = np.where(reachable, code, Active.UNREACHABLE).astype(np.int8)


def _hold_by_current(problem: _Problem, state: _State, index: IndexArray) -> None:
    """Least total loss beyond the current limit: the torque curve meets the circle, on the side of the valley."""
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


def _norm(terms: Terms) -> FloatArray:
    """Length of the gradient, never quite zero so that it may divide."""
    return np.maximum(np.hypot(terms.d, terms.q), 1e-300)


def _two_multipliers(goal: Terms, first: Terms, second: Terms) -> tuple[FloatArray, FloatArray]:
    """Multipliers (a, b) of goal = a first + b second (gradients)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (first.d * second.q - first.q * second.d)
        return (goal.d * second.q - goal.q * second.d) * scale, (first.d * goal.q - first.q * goal.d) * scale


def _residual(problem: _Problem, state: _State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Largest relative violation of the conditions, torque in N m, voltage in V and loss in W, shape (N,)."""
    machine, d, q = problem.machine, state.i_d, state.i_q
    jet = machine.jet(d, q)
    torque = torque_terms(machine, jet, d, q)
    voltage = voltage_terms(machine, jet, d, q, problem.omega_e)
    loss = loss_terms(problem.loss, jet, d, q, problem.soft)
    circle = current_terms(d, q)
    most = float(problem.locus.torque[-1])
    square = problem.v_max**2
    over_voltage = np.maximum(voltage.value / square - 1.0, 0.0)
    over_current = np.maximum(circle.value / problem.i_max**2 - 1.0, 0.0)
    residual = np.maximum(np.abs(torque.value - state.torque) / most, np.maximum(over_voltage, over_current))
    active = state.active
    residual = np.where(active == Active.UNREACHABLE, 0.0, residual)
    # Near zero current the gradient of the loss vanishes; its direction is judged against a thousandth of its size.
    loss_scale = np.maximum(_norm(loss), 2e-3 * problem.loss.square * problem.i_max) * _norm(torque)
    slope = np.abs(loss.d * torque.q - loss.q * torque.d) / loss_scale
    residual = np.where(active == Active.NONE, np.maximum(residual, slope), residual)
    for code, limit, gap in (
        (Active.VOLTAGE, voltage, np.abs(voltage.value / square - 1.0)),
        (Active.CURRENT, circle, np.abs(circle.value / problem.i_max**2 - 1.0)),
    ):
        chosen = (active == code) & state.reached
        _, pull = _two_multipliers(loss, torque, limit)
        wrong = np.maximum(pull * _norm(limit) / _norm(loss), 0.0)
        residual = np.where(chosen, np.maximum(residual, np.maximum(gap, wrong)), residual)
    residual = _most_torque_residual(residual, state, torque, voltage, circle)
    return residual, torque.value, np.sqrt(voltage.value), loss.value


def _most_torque_residual(
    residual: FloatArray, state: _State, torque: Terms, voltage: Terms, circle: Terms
) -> FloatArray:
    """Add the conditions of most torque: its gradient lies between those of the limits that hold it."""
    for code, limit in ((Active.CURRENT, circle), (Active.MTPV, voltage)):
        chosen = (state.active == code) & ~state.reached
        sine = np.abs(torque.d * limit.q - torque.q * limit.d) / (_norm(torque) * _norm(limit))
        residual = np.where(chosen, np.maximum(residual, sine), residual)
    by_voltage, by_current = _two_multipliers(torque, voltage, circle)
    sense = np.where(state.least, -1.0, 1.0)
    with np.errstate(invalid="ignore"):
        wrong = np.maximum(-sense * by_voltage * _norm(voltage), -sense * by_current * _norm(circle)) / _norm(torque)
    return np.where(state.active == Active.BOTH, np.maximum(residual, np.maximum(wrong, 0.0)), residual)


def _as_points(values: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    array = np.broadcast_to(np.asarray(values, dtype=np.float64), shape).ravel()
    if not np.all(np.isfinite(array)):
        raise InputError(f"{name} must be finite; got nan or inf")
    return array


def copper_only(machine: Machine) -> LossCoefficients:
    """Coefficients of the winding alone, 3/2 R |i|^2 (1 W/A^2 for a machine without resistance: the same optimum)."""
    square = np.array(1.5 * machine.r_s if machine.r_s > 0.0 else 1.0)
    return LossCoefficients(square, np.array(0.0), np.array(0.0))


def optimal_points(
    machine: Machine,
    torque: ArrayLike,
    omega_m: ArrayLike,
    *,
    v_max: ArrayLike,
    i_max: float | None = None,
    loss: LossCoefficients | None = None,
) -> OptimalPoints:
    """Currents of least loss for arrays of torque and speed.

    Parameters
    ----------
    machine:
        Any machine: linear or flux map.
    torque, omega_m:
        Requested torque in N m and mechanical speed in rad/s, any sign, broadcast together to N points.
    v_max:
        Largest phase-voltage amplitude in V, positive, broadcast to the points.
    i_max:
        Current limit in A (peak); the machine's own when None.
    loss:
        What is minimised, as coefficients at each point; copper loss when None.

    Raises
    ------
    InputError
        A number is not finite or a limit not positive.

    Notes
    -----
    A negative torque is the mirror image (i_q, omega reversed) of a positive one. Where the torque cannot be had, the
    largest that can is returned with ``reached`` false, and ``active`` names what stands in the way.
    """
    shape = np.broadcast_shapes(np.shape(torque), np.shape(omega_m), np.shape(v_max))
    limit = machine.i_max if i_max is None else i_max
    request, speed = _as_points(torque, shape, "torque"), _as_points(omega_m, shape, "speed")
    volts = _as_points(v_max, shape, "v_max")
    if not (limit > 0.0 and np.all(volts > 0.0)):
        raise InputError("current and voltage limits must be positive")
    coefficients = copper_only(machine) if loss is None else loss
    spread = LossCoefficients(
        *(_as_points(values, shape, "loss") for values in (coefficients.square, coefficients.linear, coefficients.iron))
    )
    sign = np.where(request < 0.0, -1.0, 1.0)
    whole = _Problem(
        machine,
        mtpa_locus(machine, limit),
        np.abs(request),
        sign * machine.pole_pairs * speed,
        volts,
        limit,
        spread,
    )
    parts = []
    for start in range(0, request.size, CHUNK):
        problem = whole.take(np.arange(start, min(start + CHUNK, request.size)))
        state = _solve_chunk(problem)
        parts.append((state, *_residual(problem, state)))
    if not parts:
        empty = np.zeros(0)
        none = np.zeros(0, dtype=np.bool_)
        return OptimalPoints(empty, empty, empty, empty, empty, empty, empty, none.astype(np.int8), none, empty)
    i_d = np.concatenate([part[0].i_d for part in parts])
    i_q = np.concatenate([part[0].i_q for part in parts])
    reached = np.concatenate([part[0].reached for part in parts])
    produced = np.where(reached, request, sign * np.concatenate([part[2] for part in parts]))
    return OptimalPoints(
        torque_request=request,
        torque=produced,
        omega_m=speed,
        i_d=i_d,
        i_q=sign * i_q,
        voltage=np.concatenate([part[3] for part in parts]),
        loss=np.concatenate([part[4] for part in parts]),
        active=np.concatenate([part[0].active for part in parts]),
        reached=reached,
        kkt_residual=np.concatenate([part[1] for part in parts]),
    )
