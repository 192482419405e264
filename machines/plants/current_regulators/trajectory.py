"""Trajectory tracking: an optimal pulse pattern whose edges are moved until the current follows.

Off line the pattern with the least distortion is found (`pulse_patterns`) and the current that it
drives in the steady state. On line the flux of the error from that current, L (i - i_ss) in Vs, is
sampled; the next edge of each leg is moved by the time in which the DC link makes up for it,

    dt = +-(psi_x - psi_ss,x) / v_dc,      + for an edge up, later where there is too much current,

within limits that keep the order of the edges. Such a step removes the error at the next edges of
the three legs, and a steady run keeps the pattern as it is.

Sources: paper 001 (Bezerra, COPPE/UFRJ 2004), section 6.2.4.5; J. Holtz, B. Beyer, IEEE
Transactions on Industry Applications 30(4), 1994, pp. 1048-1057, who track the flux linkage of the
stator.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.plants.current_regulators.pulse_patterns import (
    LEAST_WIDTH,
    PulsePattern,
    optimal_pattern,
)
from dqforge.machines.plants.fed_machine import I_D, I_Q, Plant, evaluate
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases

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
