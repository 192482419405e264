"""Regulators beyond hysteresis and ramp comparison: what they are told, and controllers."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import SampledRuleName
from dqforge.machines.plants.fed_machine import (
    I_D,
    I_Q,
    BridgeDrive,
    Controller,
    LegByLeg,
    Plant,
    evaluate,
)
from dqforge.machines.plants.regulator_rules import (
    COMMUTATIONS,
    LEGS,
    Codes,
    NextCodes,
    RuleConstants,
    codes_of,
)
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases, linear_voltage


@dataclass(frozen=True, slots=True)
class Sampled:
    """A sampled rule with its computing time of one sample, as it is emitted.

    Args:
        rule: ``predictive``, ``circle`` or ``look-up-table`` (paper 001, 6.2.4.4 and 6.2.4.3).
        t_s: Sampling period in s.
        next_codes: What the rule names.
        band, outer_band: As in `RuleConstants`, in A.
    """

    rule: SampledRuleName
    t_s: float
    next_codes: NextCodes
    band: float = 0.0
    outer_band: float = 0.0

    def constants(self, drive: BridgeDrive) -> RuleConstants:
        """What the rule knows of a drive."""
        machine = drive.machine
        return RuleConstants(
            self.rule,
            machine.r_s,
            machine.l_d,
            machine.l_q,
            machine.psi_pm,
            self.t_s,
            self.band,
            self.outer_band,
        )


@dataclass(frozen=True, slots=True)
class Circle:
    """The circle of Holtz and Stadtfeld (paper 001, 6.2.4.4), acting at the circle itself.

    Args:
        radius: Largest error in A.
        per_commutation: Whether the longest time counts per commutation, as in the source, or by
            itself.
    """

    radius: float
    per_commutation: bool = True


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Optimal pulse patterns whose edges track the current (paper 001, 6.2.4.5).

    Args:
        angles: Angles N in a quarter of the period: each leg turns on 2 N + 1 times per period.
        t_s: Sampling period in s of the error.
        offset: Error in A (i_d, i_q) with which a run starts; zero is the steady state.
        tracking: Whether the edges are moved; without it the pattern runs by itself.
    """

    angles: int
    t_s: float
    offset: tuple[float, float] = (0.0, 0.0)
    tracking: bool = True


FurtherScheme = Sampled | Circle | Trajectory


def _positive(name: str, value: float, unit: str) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise InputError(f"{name}: expected a positive number in {unit}, got {value!r}")


def check_further(drive: BridgeDrive, scheme: FurtherScheme) -> None:
    """Refuse numbers that no scheme can have, and a tied star point."""
    if drive.neutral_inductance is not None:
        raise InputError(
            "neutral_inductance: only hysteresis regulates three currents; leave the star point "
            "isolated"
        )
    if isinstance(scheme, Circle):
        _positive("radius", scheme.radius, "A")
        return
    _positive("t_s", scheme.t_s, "s")
    if isinstance(scheme, Trajectory):
        if scheme.angles < 1:
            raise InputError(f"angles: expected 1 at least, got {scheme.angles}")
    elif scheme.rule != "predictive":
        _positive("band", scheme.band, "A")
        if scheme.rule == "look-up-table" and not scheme.outer_band >= scheme.band:
            raise InputError("outer_band: expected the band in A at least")


def check_further_points(plant: Plant, scheme: FurtherScheme) -> None:
    """Refuse what the bridge cannot make: the circle and the pattern need it, rules judge by it."""
    machine, v_dc = plant.drive.machine, plant.drive.v_dc
    voltage = np.hypot(*machine.voltage(plant.i_d, plant.i_q, plant.omega_e))
    limit = linear_voltage(v_dc)
    if float(np.max(voltage)) >= limit and not isinstance(scheme, Trajectory):
        raise InputError(
            f"the references need {float(np.max(voltage)):.4g} V, the bridge makes {limit:.4g} V "
            "(v_dc/sqrt(3)); lower speed or currents, or raise v_dc"
        )
    if isinstance(scheme, Trajectory) and float(np.min(plant.omega_e)) <= 0.0:
        raise InputError("omega_m: pulse patterns are made for positive speeds")


def further_work(plant: Plant, scheme: FurtherScheme) -> FloatArray:
    """Commutations per second that are to be expected at most, shape (N,)."""
    if isinstance(scheme, Sampled):
        return np.full(plant.i_d.size, 3.0 / scheme.t_s)
    if isinstance(scheme, Trajectory):
        # The samples take as long as commutations do.
        edges = 3.0 * (4.0 * scheme.angles + 2.0) * np.abs(plant.omega_e) / (2.0 * math.pi)
        return np.asarray(edges + 1.0 / scheme.t_s)
    machine = plant.drive.machine
    slope = plant.drive.v_dc / min(machine.l_d, machine.l_q)
    return np.full(plant.i_d.size, 2.0 * slope / scheme.radius)


def further_start(
    plant: Plant, scheme: FurtherScheme, legs: BoolArray
) -> tuple[Controller, FloatArray, BoolArray]:
    """Controller, state (N, 9) and switching state (N, 3) at the angle 0; ``legs`` are those that
    the voltages of the references suggest.
    """
    if isinstance(scheme, Sampled):
        rule = DelayedRule(scheme.constants(plant.drive), scheme.next_codes, legs)
        return rule, plant.start(legs), legs
    if isinstance(scheme, Circle):
        controller = CircleController(
            scheme.radius, plant.i_d.size, per_commutation=scheme.per_commutation
        )
        return controller, plant.start(legs), legs
    steady = steady_trajectory(plant, *patterns_of(plant, scheme.angles))
    legs = steady.legs_at_start()
    state = steady.states[:, 0].copy()
    state[:, :2] += scheme.offset
    return TrajectoryController(steady, scheme.t_s, tracking=scheme.tracking), state, legs


# Trajectory tracking: an optimal pulse pattern whose edges are moved until the current follows.
#
# Off line the pattern with the least distortion is found (`pulse_patterns`) and the current that it
# drives in the steady state. On line the flux of the error from that current, L (i - i_ss) in Vs,
# is sampled; the next edge of each leg is moved by the time in which the DC link makes up for it,
#
#   dt = +-(psi_x - psi_ss,x) / v_dc,      + for an edge up, later where there is too much current,
#
# within limits that keep the order of the edges. Such a step removes the error at the next edges of
# the three legs, and a steady run keeps the pattern as it is.
#
# Sources: paper 001 (Bezerra, COPPE/UFRJ 2004), section 6.2.4.5; J. Holtz, B. Beyer, IEEE
# Transactions on Industry Applications 30(4), 1994, pp. 1048-1057, who track the flux linkage of
# the stator.

_SHIFTS = np.array([0.0, 2.0, 4.0]) * math.pi / 3.0


@dataclass(frozen=True, slots=True)
class SteadyTrajectory:
    """Pattern and steady current of N points.

    Args:
        edges: Angles of the rotor in rad at which each leg commutates, shape (N, 3, E), ascending
            from at least 0 over one turn.
        rising: Whether the leg goes up there, shape (N, 3, E).
        knots, states: Angles in rad at which any leg commutates, shape (N, K), from 0 on, and the
            steady states behind them, shape (N, K, 9).
    """

    edges: FloatArray
    rising: BoolArray
    knots: FloatArray
    states: FloatArray

    def legs_at_start(self) -> BoolArray:
        """Switching state at the angle 0, shape (N, 3): against the first edge."""
        return np.asarray(~self.rising[..., 0])


def patterns_of(plant: Plant, count: int) -> tuple[list[PulsePattern], FloatArray]:
    """Pattern of each point with N = ``count`` angles in a quarter, and the angle in rad of its
    voltage ahead of the d axis, shape (N,).

    Raises `NoSolutionError` where the DC link does not make the voltage.
    """
    v_d, v_q = plant.drive.machine.voltage(plant.i_d, plant.i_q, plant.omega_e)
    index = np.hypot(v_d, v_q) / (0.5 * plant.drive.v_dc)
    return [optimal_pattern(count, float(value)) for value in index], np.arctan2(v_q, v_d)


def _advanced(plant: Plant, state: FloatArray, duration: FloatArray) -> FloatArray:
    """States (N, 9) after durations in s of their own, shape (N,)."""
    steps = max(1, math.ceil(float(np.max(duration / plant.longest_step))))
    for _ in range(steps):
        state = evaluate(plant.series(state), duration / steps)
    return state


def steady_trajectory(
    plant: Plant, patterns: list[PulsePattern], ahead: FloatArray
) -> SteadyTrajectory:
    """The current that repeats itself under the patterns.

    Without the pattern's voltage the error from it decays by itself; one period of that decay,
    taken from two runs, gives the state that is its own image.

    Args:
        plant: N points, speeds positive.
        patterns, ahead: As of `patterns_of`; all of as many pulses.
    """
    # The sine of the pattern is the cosine of leg a's voltage, a quarter of a turn later.
    offset = 0.5 * math.pi + ahead
    listed = [pattern.edges() for pattern in patterns]
    angles = np.stack([edge for edge, _ in listed])[:, None, :]
    levels = np.stack([level for _, level in listed])[:, None, :]
    turned = np.mod(angles - offset[:, None, None] + _SHIFTS[:, None], 2.0 * math.pi)
    order = np.argsort(turned, axis=-1)
    edges = np.take_along_axis(turned, order, axis=-1)
    rising = np.take_along_axis(np.broadcast_to(levels, turned.shape), order, axis=-1) > 0.0
    count = edges.shape[0]
    flat = edges.reshape(count, -1)
    sequence = np.argsort(flat, axis=-1)
    knots = np.concatenate(
        [np.zeros((count, 1)), np.take_along_axis(flat, sequence, axis=-1)], axis=-1
    )
    leg = sequence // edges.shape[-1]
    up = np.take_along_axis(rising.reshape(count, -1), sequence, axis=-1)

    def run(start: FloatArray) -> tuple[FloatArray, FloatArray]:
        legs = ~rising[..., 0]
        state = plant.switched(start, np.zeros(count), legs)
        kept = [state]
        for k in range(knots.shape[1]):
            end = knots[:, k + 1] if k + 1 < knots.shape[1] else np.full(count, 2.0 * math.pi)
            state = _advanced(plant, state, (end - knots[:, k]) / plant.omega_e)
            if k + 1 < knots.shape[1]:
                legs = legs.copy()
                legs[np.arange(count), leg[:, k]] = up[:, k]
                state = plant.switched(state, end, legs)
                kept.append(state)
        return state, np.stack(kept, axis=1)

    base = plant.start(~rising[..., 0])
    end = run(base)[0][:, [I_D, I_Q]]
    columns = []
    for place in (I_D, I_Q):
        moved = base.copy()
        moved[:, place] += 1.0
        columns.append(run(moved)[0][:, [I_D, I_Q]] - end)
    decay = np.stack(columns, axis=-1)
    gap = (end - base[:, [I_D, I_Q]])[..., None]
    base[:, [I_D, I_Q]] += np.linalg.solve(np.eye(2) - decay, gap)[..., 0]
    return SteadyTrajectory(edges, rising, knots, run(base)[1])


class TrajectoryController:
    """Controller of `follow` that moves the edges of a pattern.

    Args:
        trajectory: Patterns and steady currents of all points.
        t_s: Sampling period in s.
        tracking: Whether edges are moved at all.
    """

    scale = 1.0

    def __init__(self, trajectory: SteadyTrajectory, t_s: float, *, tracking: bool = True) -> None:
        self.interval = t_s
        self._steady, self._tracking = trajectory, tracking
        shape = trajectory.edges.shape[:2]
        self._next = np.zeros(shape, dtype=np.intp)
        self._shift = np.zeros(shape)

    def _edge(self, number: NDArray[np.intp], step: int = 0) -> FloatArray:
        """Angle in rad of the next edge of each leg, or of one `step` further, shape (N, 3)."""
        edges = self._steady.edges[number]
        place = self._next[number] + step
        per_turn = edges.shape[-1]
        found = np.take_along_axis(edges, (place % per_turn)[..., None], axis=-1)[..., 0]
        return np.asarray(found + 2.0 * math.pi * (place // per_turn))

    def margin(
        self, plant: Plant, _state: FloatArray, time: FloatArray, _legs: BoolArray
    ) -> FloatArray:
        """Angle in rad by which the moved edge of each leg is past."""
        angle = (plant.omega_e * time)[:, None]
        return angle - self._edge(plant.number) - self._shift[plant.number]

    def steady_state(self, plant: Plant, time: FloatArray) -> FloatArray:
        """Steady state (N, 9) at times in s (N,)."""
        angle = np.mod(plant.omega_e * time, 2.0 * math.pi)
        knots, column = self._steady.knots[plant.number], np.arange(time.size)
        place = np.sum(knots <= angle[:, None], axis=-1) - 1
        start = self._steady.states[plant.number][column, place]
        return _advanced(plant, start, (angle - knots[column, place]) / plant.omega_e)

    def decide(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        """Sample the error and move the next edges."""
        if self._tracking:
            machine, number = plant.drive.machine, plant.number
            steady = self.steady_state(plant, time)
            flux = dq_to_phases(
                machine.l_d * (state[:, I_D] - steady[:, I_D]),
                machine.l_q * (state[:, I_Q] - steady[:, I_Q]),
                plant.omega_e * time,
            )
            speed = plant.omega_e[:, None]
            wanted = np.where(legs, -flux, flux) / plant.drive.v_dc * speed
            # An edge that is overdue is moved from now on.
            edge = self._edge(number)
            overdue = np.maximum(speed * time[:, None] - edge, 0.0)
            room = self._edge(number, 1) - edge, edge - self._edge(number, -1)
            upper = np.maximum(0.5 * room[0], 0.5 * LEAST_WIDTH)
            lower = np.maximum(0.5 * room[1], 0.5 * LEAST_WIDTH)
            self._shift[number] = np.clip(wanted + overdue, -lower, upper)
        return legs

    def react(
        self,
        plant: Plant,
        _state: FloatArray,
        _time: FloatArray,
        legs: BoolArray,
        wanted: NDArray[np.intp],
    ) -> BoolArray:
        """The leg whose edge is past commutates and waits for its next edge."""
        turned, row = legs.copy(), np.arange(wanted.size)
        turned[row, wanted] ^= True
        self._next[plant.number, wanted] += 1
        self._shift[plant.number, wanted] = 0.0
        return turned


# Synchronous optimal pulse patterns: switching angles with the least distortion of the current.
#
# The leg voltage over half the DC link is s(x) = +-1 with quarter-wave symmetry, of N angles in the
# first quarter; its amplitudes of odd orders, all sines, are
#
#     b_n = (4 sigma / (n pi)) (1 + 2 sum_i (-1)^i cos(n x_i)),    sigma = s(0+)
#
# The currents of an inductive machine have the amplitudes b_n / n, those of orders that 3 divides
# cancel with the star point isolated. The angles minimise the sum of their squares at a given b_1.
#
# Sources: J. Holtz, B. Beyer, "The trajectory tracking approach - a new method for minimum
# distortion PWM in dynamic high-power drives", IEEE Transactions on Industry Applications 30(4),
# 1994, pp. 1048-1057. The sums here were derived anew.

_HIGHEST = 151
LEAST_WIDTH = math.radians(0.25)  # Least angle in rad between two commutations of a leg.
_STARTS = 16


@dataclass(frozen=True, slots=True)
class PulsePattern:
    """Switching of a leg over a period of the voltage's sine.

    Args:
        angles: Angles of the first quarter in rad, shape (N,), ascending.
        sign: Leg voltage just behind the angle 0 over half the DC link, 1 or -1.
    """

    angles: FloatArray
    sign: int

    def edges(self) -> tuple[FloatArray, FloatArray]:
        """Angles in rad of all commutations of a period, ascending from 0, and the leg voltage
        behind each over half the DC link, shape (4 N + 2,) each.
        """
        x = self.angles
        half = np.concatenate([[0.0], x, math.pi - x[::-1]])
        levels = self.sign * (-1.0) ** np.arange(half.size)
        return np.concatenate([half, math.pi + half]), np.concatenate([levels, -levels])

    def amplitudes(self, orders: FloatArray) -> FloatArray:
        """Amplitudes over half the DC link of odd orders, shape (n,)."""
        return amplitudes(self.angles, self.sign, orders)


def amplitudes(angles: FloatArray, sign: int, orders: FloatArray) -> FloatArray:
    """b_n of the angles (N,) in rad of a quarter and the first level, of odd orders (n,)."""
    turn = (-1.0) ** np.arange(1, angles.size + 1)
    sums = 1.0 + 2.0 * np.cos(np.outer(orders, angles)) @ turn
    return np.asarray(4.0 * sign / (math.pi * orders) * sums)


def distortion_orders() -> FloatArray:
    """Odd orders from 5 on that 3 does not divide."""
    orders = np.arange(5, _HIGHEST + 1, 2)
    return np.asarray(orders[orders % 3 != 0], dtype=np.float64)


def distortion(angles: FloatArray, sign: int) -> float:
    """Root of the sum of (b_n / n)^2 over the orders of `distortion_orders`."""
    orders = distortion_orders()
    return float(np.sqrt(np.sum((amplitudes(angles, sign, orders) / orders) ** 2)))


@cache
def optimal_pattern(count: int, index: float) -> PulsePattern:
    """The pattern of ``count`` angles in a quarter that distorts the current least.

    Found by sequential quadratic programming from a fixed set of starts; the best of all is taken,
    which is a local optimum, as everywhere where such patterns are made.

    Args:
        count: N, at least 1.
        index: b_1: amplitude of the fundamental over half the DC link, 0 to below 4/pi.

    Raises:
        NoSolutionError: No start leads to the amplitude with the least widths.
    """
    found = []
    for sign in (1, -1):
        for start in _starts(count):
            angles = _improved(start, sign, index)
            if angles is not None:
                found.append((distortion(angles, sign), sign, angles))
    if not found:
        raise NoSolutionError(
            f"no pulse pattern of {2 * count + 1} pulses makes {index:.3g} of half the DC link; "
            "take fewer pulses or a higher DC-link voltage"
        )
    _, sign, angles = min(found, key=lambda entry: entry[0])
    return PulsePattern(angles, sign)


def continued_pattern(patterns: list[PulsePattern], index: float) -> PulsePattern | None:
    """The best of the patterns that others lead to at another fundamental, None where none does.

    Args:
        patterns: Patterns of as many angles.
        index: b_1, as of `optimal_pattern`.
    """
    found = []
    for pattern in patterns:
        angles = _improved(pattern.angles, pattern.sign, index)
        if angles is not None:
            found.append((distortion(angles, pattern.sign), pattern.sign, angles))
    if not found:
        return None
    _, sign, angles = min(found, key=lambda entry: entry[0])
    return PulsePattern(angles, sign)


def _starts(count: int) -> list[FloatArray]:
    """Angles that lie even in the quarter, in its upper part, and anywhere, the same each time."""
    spread = (np.arange(count) + 0.75) / (count + 0.5)
    lows = np.linspace(0.0, 0.75, 4)
    drawn = np.random.default_rng(count).uniform(0.0, 1.0, (_STARTS, count))
    shares = [low + (1.0 - low) * spread for low in lows] + list(np.sort(drawn, axis=-1))
    return [0.5 * math.pi * share for share in shares]


def _improved(start: FloatArray, sign: int, index: float) -> FloatArray | None:
    from scipy.optimize import minimize

    orders = distortion_orders()
    turn = (-1.0) ** np.arange(1, start.size + 1)
    scale = 1e4

    def target(x: FloatArray) -> tuple[float, FloatArray]:
        voltage = amplitudes(x, sign, orders)
        slopes = -8.0 * sign / math.pi * np.sin(np.outer(orders, x)) * turn
        part = voltage / orders**2
        return scale * float(np.sum(part * voltage)), np.asarray(2.0 * scale * (part @ slopes))

    def error(x: FloatArray) -> float:
        return float(amplitudes(x, sign, np.ones(1))[0]) - index

    def widths(x: FloatArray) -> FloatArray:
        ends = np.concatenate([[0.0], x, [0.5 * math.pi]])
        gaps = np.diff(ends)
        gaps[-1] *= 2.0
        return np.asarray(gaps - LEAST_WIDTH)

    found = minimize(
        target,
        start,
        jac=True,
        method="SLSQP",
        constraints=[{"type": "eq", "fun": error}, {"type": "ineq", "fun": widths}],
        options={"maxiter": 200, "ftol": 1e-12},
    )
    good = found.success and abs(error(found.x)) < 1e-8 and np.all(widths(found.x) > -1e-9)
    return np.asarray(found.x) if good else None


# The circle of Holtz and Stadtfeld, acting at the very instant at which the error reaches it.
#
# The error i* - i moves within a circle of the radius h around the reference. Where it arrives at
# the circle, the time until it would arrive again is predicted for each switching state, along a
# straight line in rotor coordinates; the state with the longest time per commutation is taken.
# While the voltage that the references need lies inside the hexagon of the bridge, the active
# vectors surround it, and at least one of them leads back into the circle from any place on it.
#
# Sources: paper 001 (Bezerra, COPPE/UFRJ 2004), section 6.2.4.4 and figure 6.15; J. Holtz, S.
# Stadtfeld, IPEC Tokyo 1983, pp. 1665-1675. The thesis takes "the state that stays on longest";
# over commutations, as in the source, the switching frequency is less.

_BLIND = 0.5  # Share of the predicted time before which the error is within the circle for certain.


def times_within(
    plant: Plant, state: FloatArray, time: FloatArray, codes: NDArray[np.int64]
) -> FloatArray:
    """Predicted times in s (..., N) until the error of states (N, 9) on the circle is on it again.

    Zero where a switching state leads out. ``codes`` (..., N) are the states that are tried.
    """
    legs = LEGS[codes]
    wide = np.broadcast_to(state, (*codes.shape, state.shape[-1]))
    theta = np.broadcast_to(plant.omega_e * time, codes.shape)
    slope = np.matmul(plant.matrix, plant.switched(wide, theta, legs)[..., None])[..., 0]
    x, y = plant.i_d - state[:, I_D], plant.i_q - state[:, I_Q]
    along = -(x * slope[..., I_D] + y * slope[..., I_Q])
    square = slope[..., I_D] ** 2 + slope[..., I_Q] ** 2
    return np.where(along < 0.0, -2.0 * along / np.where(square > 0.0, square, 1.0), 0.0)


class CircleController:
    """Controller of `follow` that acts at the circle itself.

    Args:
        radius: h in A.
        points: N operating points.
        per_commutation: Whether the time is weighed by the commutations that it costs.
    """

    def __init__(self, radius: float, points: int, *, per_commutation: bool = True) -> None:
        self.interval, self.scale = math.inf, radius
        self._radius, self._weighed = radius, per_commutation
        self._blind_until = np.zeros(points)

    def margin(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        """How far the error is outside, for each leg alike."""
        error = np.hypot(plant.i_d - state[:, I_D], plant.i_q - state[:, I_Q]) - self._radius
        early = time < self._blind_until[plant.number]
        return np.repeat(np.where(early, -self._radius, error)[:, None], legs.shape[-1], axis=-1)

    def decide(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        """Nothing is sampled."""
        return legs

    def react(
        self,
        plant: Plant,
        state: FloatArray,
        time: FloatArray,
        legs: BoolArray,
        _wanted: NDArray[np.intp],
    ) -> BoolArray:
        """The state with the longest predicted time within the circle per commutation."""
        codes = codes_of(legs)
        tried = np.broadcast_to(np.arange(8)[:, None], (8, codes.size))
        within = times_within(plant, state, time, tried)
        moves = np.maximum(COMMUTATIONS[codes, tried], 1)
        score = np.where(tried == codes, 0.0, within / (moves if self._weighed else 1))
        # Of both zero vectors, alike but for rounding, the nearer one.
        score = score * (1.0 - 1e-9 * moves)
        chosen = np.argmax(score, axis=0)
        self._blind_until[plant.number] = time + _BLIND * within[chosen, np.arange(codes.size)]
        return np.asarray(LEGS[chosen])


# A sampled rule in the loop: what it names at a sample is on from the next one.


class DelayedRule(LegByLeg):
    """Controller of `follow` around a sampled rule.

    Args:
        constants: The rule and what it knows of the drive.
        next_codes: What the rule names.
        legs: Switching states (N, 3) of the first sampling period.
    """

    def __init__(self, constants: RuleConstants, next_codes: NextCodes, legs: BoolArray) -> None:
        self.interval, self.scale = constants.t_s, 1.0
        self._constants, self._next = constants, next_codes
        self._named: Codes = codes_of(legs)

    def margin(
        self, _plant: Plant, _state: FloatArray, _time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        """Never positive: nothing commutates between samples."""
        return np.full(legs.shape, -1.0)

    def decide(
        self, plant: Plant, state: FloatArray, time: FloatArray, _legs: BoolArray
    ) -> BoolArray:
        """The state named a sample ago; the next one is named meanwhile."""
        now = self._named[plant.number]
        theta = np.mod(plant.omega_e * time, 2.0 * math.pi)
        self._named[plant.number] = self._next(
            self._constants,
            now,
            plant.i_d,
            plant.i_q,
            state[:, I_D],
            state[:, I_Q],
            np.cos(theta),
            np.sin(theta),
            plant.omega_e,
            np.full(now.shape, plant.drive.v_dc),
        )
        return np.asarray(LEGS[now])
