"""Steps of a switched drive from event to event: comparators that cross, carriers that turn,
samples that fall due.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.current_trace import CurrentTrace
from dqforge.machines.plants.fed_machine import Plant, evaluate

# Steps per electrical period at least: an excursion over a threshold and back within a step would
# be missed, and its height is an eighth of curvature times step squared.
_STEPS = 720


# Accuracy of an event in terms of the controller's scale (band or DC link).
_EVENT_ACCURACY = 1e-10


_SEARCH_STEPS = 100


# Commutations of a point between two turns of the carrier from which on its
# comparators are said to chatter.
_CHATTERING = 300


class Controller(Protocol):
    """What turns currents into commutations.

    ``interval`` in s is the time between the instants at which it samples or its inputs have a
    kink, inf without any; ``scale`` is of the size of its thresholds.
    """

    interval: float
    scale: float

    def margin(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> FloatArray:
        """Positive where a leg wants to commutate, continuous in time until it does, shape (N,
        3).
        """
        ...

    def decide(
        self, plant: Plant, state: FloatArray, time: FloatArray, legs: BoolArray
    ) -> BoolArray:
        """Switching state (N, 3) from a sampling instant on."""
        ...

    def react(
        self,
        plant: Plant,
        state: FloatArray,
        time: FloatArray,
        legs: BoolArray,
        wanted: NDArray[np.intp],
    ) -> BoolArray:
        """Switching state (N, 3) from an instant on at which the margin of the leg `wanted` (N,)
        has become positive.
        """
        ...


class LegByLeg:
    """Reaction of comparators that rule a leg each: the leg that wants to commutate does."""

    def react(
        self,
        _plant: Plant,
        _state: FloatArray,
        _time: FloatArray,
        legs: BoolArray,
        wanted: NDArray[np.intp],
    ) -> BoolArray:
        """Switching state (N, 3) with the leg `wanted` (N,) turned over."""
        turned = legs.copy()
        turned[np.arange(wanted.size), wanted] ^= True
        return turned


def _first_crossing(
    plant: Plant,
    controller: Controller,
    series: FloatArray,
    start: FloatArray,
    length: FloatArray,
    legs: BoolArray,
) -> FloatArray:
    """Time in s (N,) after which the largest margin, negative at 0 and positive after `length`,
    has become positive.

    Regula falsi after Illinois, aimed a little above 0, so that the margin is
    not negative where it stops.
    """
    accuracy = _EVENT_ACCURACY * controller.scale

    # Legs that do not want to commutate at the end do not count: without them the
    # margin has no kink, as a rule.
    ends = controller.margin(plant, evaluate(series, length), start + length, legs)

    def excess(time: FloatArray) -> FloatArray:
        margin = controller.margin(plant, evaluate(series, time), start + time, legs)
        return np.asarray(np.max(np.where(ends > 0.0, margin, -np.inf), axis=-1) - 0.5 * accuracy)

    low, high = np.zeros_like(length), length.copy()
    below, above = excess(low), np.max(ends, axis=-1) - 0.5 * accuracy
    found = np.where(below > -0.5 * accuracy, low, high)  # already positive at the start: now
    open_ = (below <= -0.5 * accuracy) & (above > 0.5 * accuracy)
    was_right = np.zeros(length.shape, dtype=np.bool_)
    was_left = np.zeros(length.shape, dtype=np.bool_)
    for _ in range(_SEARCH_STEPS):
        if not np.any(open_):
            break
        span = np.where(open_, above - below, 1.0)
        trial = np.where(open_, high - above * (high - low) / span, found)
        value = excess(trial)
        found = trial
        right = value > 0.0
        low, high = np.where(open_ & ~right, trial, low), np.where(open_ & right, trial, high)
        # An end that stays a second time keeps half of its value, so that it moves next time.
        below = np.where(right, np.where(was_right, 0.5 * below, below), value)
        above = np.where(right, value, np.where(was_left, 0.5 * above, above))
        was_right, was_left = right, ~right
        open_ &= np.abs(value) > 0.5 * accuracy
    return np.where(open_, high, found)


class _Walk:
    """Clocks, states and switching states of all points, and the pieces that they have gone
    through.
    """

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        state: FloatArray,
        legs: BoolArray,
        ends: tuple[FloatArray, FloatArray],
    ) -> None:
        self.plant, self.controller = plant, controller
        self.state, self.legs = state, legs.copy()
        self.time = np.zeros(plant.i_d.size)
        self.samples = np.zeros(plant.i_d.size)
        self.commutated = np.zeros(plant.i_d.size, dtype=np.int64)
        self.observed_from, self.end = ends
        step = 2.0 * math.pi / np.abs(plant.omega_e) / _STEPS
        self.step = np.minimum(step, plant.longest_step)
        self.pieces: list[tuple[FloatArray, FloatArray, FloatArray, BoolArray]] = []

    def decide(self, points: BoolArray) -> None:
        """Let the controller choose at its sampling instant."""
        if not np.any(points):
            return
        plant, time = self.plant.part(points), self.time[points]
        chosen = self.controller.decide(plant, self.state[points], time, self.legs[points])
        self.state[points] = plant.switched(self.state[points], plant.omega_e * time, chosen)
        self.legs[points] = chosen
        self.commutated[points] = 0

    def _commutate(self, points: BoolArray, legs: NDArray[np.intp]) -> None:
        index = np.nonzero(points)[0]
        self.legs[index] = self.controller.react(
            self.plant.part(points),
            self.state[index],
            self.time[index],
            self.legs[index],
            legs[index],
        )
        theta = self.plant.omega_e * self.time
        self.state = np.where(
            points[:, None], self.plant.switched(self.state, theta, self.legs), self.state
        )
        self.commutated[index] += 1
        if math.isfinite(self.controller.interval) and np.any(self.commutated > _CHATTERING):
            raise NoSolutionError(
                "the comparators chatter: the regulators' output is steeper than the triangle "
                "(slope_ratio); take a smaller kp, a faster carrier, or a comparator_band"
            )

    def _stop(self) -> tuple[FloatArray, BoolArray]:
        """Time in s of the next instant that no step may pass, and where it is one of the
        controller's.
        """
        border = np.where(self.time < self.observed_from, self.observed_from, self.end)
        if not math.isfinite(self.controller.interval):
            return border, np.zeros(border.shape, dtype=np.bool_)
        due = (self.samples + 1.0) * self.controller.interval
        return np.minimum(due, border), due <= border

    def go(self) -> None:
        """One piece for each point that has not reached its end."""
        stop, due = self._stop()
        rest = stop - self.time
        whole = rest <= self.step
        length = np.where(whole, rest, self.step)
        series = self.plant.series(self.state)
        margin = self.controller.margin(
            self.plant, evaluate(series, length), self.time + length, self.legs
        )
        crossing = (np.max(margin, axis=-1) > 0.0) & (self.time < self.end)
        if np.any(crossing):
            length[crossing] = _first_crossing(
                self.plant.part(crossing),
                self.controller,
                series[:, crossing],
                self.time[crossing],
                length[crossing],
                self.legs[crossing],
            )
        self.pieces.append((self.time.copy(), length, self.state, self.legs.copy()))
        self.state = evaluate(series, length)
        self.time = np.where(whole & ~crossing, stop, self.time + length)
        if np.any(crossing):
            margin = self.controller.margin(self.plant, self.state, self.time, self.legs)
            self._commutate(crossing, np.argmax(margin, axis=-1))
        reached = whole & ~crossing & due & (self.time < self.end)
        self.samples[reached] += 1.0
        self.decide(reached)


def follow(
    plant: Plant,
    controller: Controller,
    state: FloatArray,
    legs: BoolArray,
    settling: FloatArray,
    observed: FloatArray,
) -> CurrentTrace:
    """Step N operating points, each from event to event, to their ends.

    Args:
        plant, controller: The drive and what regulates it.
        state, legs: State (N, 9) and switching state (N, 3) at the angle 0.
        settling, observed: Times in s (N,) that are simulated only, and recorded after that.

    Raises:
        NoSolutionError: Comparators commutate without end between two turns of the carrier.
    """
    walk = _Walk(plant, controller, state, legs, (settling, settling + observed))
    walk.decide(np.full(plant.i_d.size, math.isfinite(controller.interval)))
    while np.any(walk.time < walk.end):
        walk.go()
    time, length, states, switched = (np.stack(parts) for parts in zip(*walk.pieces, strict=True))
    # What was before the observed time keeps its place with no length and the first
    # state of the observed time.
    first = np.argmax(time >= settling, axis=0)
    row = np.maximum(np.arange(len(time))[:, None], first)
    used = row[int(np.min(first)) :]
    column = np.arange(plant.i_d.size)
    kept = np.where(
        np.arange(int(np.min(first)), len(time))[:, None] < first, 0.0, length[used, column]
    )
    return CurrentTrace(
        plant, time[used, column], kept, states[used, column], switched[used, column]
    )
