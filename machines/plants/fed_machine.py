"""A machine fed by a switched bridge, solved exactly between the switching instants.

At constant speed the machine is a linear system in rotor coordinates. With the voltage vector of a
switching state, which stands still in the stator, as two more states it is one without input, x' =
M x, whose Taylor series converges to rounding over the short steps taken here. An instant within a
step is then a polynomial away.

Source: voltage equations of paper 000, (1); the zero sequence of a star point tied to the
middle of the DC link added.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import dq_to_phases, phases_to_dq

# Places in the state: currents, voltages, integrals of the current errors, and the constant 1.
I_D, I_Q, I_0, V_D, V_Q, V_0, Z_D, Z_Q, ONE = range(9)


STATES = 9


# Terms of the Taylor series, and the longest step in terms of the fastest time constant:
# 0.1^9 / 9! is 3e-15.
_TERMS = 9


_RELATIVE_STEP = 0.1


@dataclass(frozen=True, slots=True)
class BridgeDrive:
    """A star-connected machine at an ideal two-level bridge.

    Args:
        machine: Machine with constant inductances; r_s may be 0.
        v_dc: DC-link voltage in V, constant.
        neutral_inductance: Zero-sequence inductance in H of a star point that is tied to the middle
            of the DC link, None where the star point is isolated. Phases without mutual coupling
            have l_d = l_q = neutral_inductance.

    Raises:
        InputError: A voltage or an inductance that is not positive.
    """

    machine: LinearMachine
    v_dc: float
    neutral_inductance: float | None = None

    def __post_init__(self) -> None:
        inductances = {"l_d": self.machine.l_d, "l_q": self.machine.l_q}
        if self.neutral_inductance is not None:
            inductances["neutral_inductance"] = self.neutral_inductance
        for name, value, unit in [
            ("v_dc", self.v_dc, "V"),
            *((key, value, "H") for key, value in inductances.items()),
        ]:
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name}: expected a positive number in {unit}, got {value!r}")


@dataclass(frozen=True, slots=True)
class Plant:
    """The drive at N operating points of constant speed and constant references.

    Args:
        drive: Machine and bridge.
        i_d, i_q: Current references in A (peak), shape (N,).
        omega_e: Electrical speed in rad/s, shape (N,), not 0.
        matrix: M of x' = M x, shape (N, 9, 9).
        number: Number of each point, shape (N,), by which a controller with a memory finds its own.
    """

    drive: BridgeDrive
    i_d: FloatArray
    i_q: FloatArray
    omega_e: FloatArray
    matrix: FloatArray
    number: NDArray[np.intp]

    @property
    def longest_step(self) -> FloatArray:
        """Longest time in s over which `series` is exact to rounding, shape (N,)."""
        machine = self.drive.machine
        inductances = [machine.l_d, machine.l_q, *([self.drive.neutral_inductance or machine.l_d])]
        coupling = np.abs(self.omega_e) * max(machine.l_d / machine.l_q, machine.l_q / machine.l_d)
        return _RELATIVE_STEP / np.maximum(coupling, machine.r_s / min(inductances))

    def part(self, index: BoolArray | slice) -> Plant:
        """The plant at some of the points."""
        return Plant(
            self.drive,
            self.i_d[index],
            self.i_q[index],
            self.omega_e[index],
            self.matrix[index],
            self.number[index],
        )

    def start(
        self, legs: BoolArray, integral: tuple[FloatArray, FloatArray] | None = None
    ) -> FloatArray:
        """State (N, 9) at the angle 0 with the currents on their references.

        Args:
            legs: True where the upper switch is on, shape (N, 3).
            integral: Integrals of the current errors in A s, shape (N,) each; zero if None.
        """
        state = np.zeros((self.i_d.size, STATES))
        state[:, I_D], state[:, I_Q], state[:, ONE] = self.i_d, self.i_q, 1.0
        if integral is not None:
            state[:, Z_D], state[:, Z_Q] = integral
        return self.switched(state, np.zeros(self.i_d.size), legs)

    def switched(self, state: FloatArray, theta_e: FloatArray, legs: BoolArray) -> FloatArray:
        """State (..., 9) with the voltages of the switching state (..., 3) at the
        electrical angle (...) in rad.
        """
        leg = self.drive.v_dc * (legs - 0.5)
        changed = np.array(state)
        changed[..., V_D], changed[..., V_Q] = phases_to_dq(leg, theta_e)
        changed[..., V_0] = 0.0 if self.drive.neutral_inductance is None else np.mean(leg, axis=-1)
        return changed

    def series(self, state: FloatArray) -> FloatArray:
        """Taylor coefficients (K, ..., N, 9) of the solution from the state (..., N, 9) on."""
        terms = [state]
        for order in range(1, _TERMS):
            terms.append(np.matmul(self.matrix, terms[-1][..., None])[..., 0] / order)
        return np.stack(terms)

    def advance(self, state: FloatArray, duration: float) -> FloatArray:
        """State (..., N, 9) after `duration` in s with the switching state unchanged."""
        count = max(1, math.ceil(duration / float(np.min(self.longest_step))))
        for _ in range(count):
            state = evaluate(self.series(state), np.full(state.shape[:-1], duration / count))
        return state

    def phase_currents(self, state: FloatArray, theta_e: FloatArray) -> FloatArray:
        """Phase currents in A (..., 3) of states (..., 9) at electrical angles (...) in rad."""
        return dq_to_phases(state[..., I_D], state[..., I_Q], theta_e) + state[..., I_0, None]

    def phase_errors(self, state: FloatArray, theta_e: FloatArray) -> FloatArray:
        """Phase currents less their references in A, shape (..., N, 3), of states (..., N, 9)."""
        difference = dq_to_phases(state[..., I_D] - self.i_d, state[..., I_Q] - self.i_q, theta_e)
        return np.asarray(difference + state[..., I_0, None], dtype=np.float64)


def evaluate(series: FloatArray, time: FloatArray) -> FloatArray:
    """States (..., 9) after the times (...) in s from the coefficients (K, ..., 9) of
    `Plant.series`.
    """
    value = series[-1]
    for term in series[-2::-1]:
        value = value * time[..., None] + term
    return np.asarray(value, dtype=np.float64)


def build_plant(
    drive: BridgeDrive,
    i_d: FloatArray,
    i_q: FloatArray,
    omega_e: FloatArray,
    *,
    rotating: bool = True,
) -> Plant:
    """The drive at N operating points.

    Args:
        drive: Machine and bridge.
        i_d, i_q, omega_e: Current references in A (peak) and electrical speed in rad/s, shape (N,).
        rotating: Whether the errors are integrated in rotor coordinates, or in those of the stator.
    """
    machine = drive.machine
    matrix = np.zeros((i_d.size, STATES, STATES))
    matrix[:, I_D, I_D], matrix[:, I_Q, I_Q] = (
        -machine.r_s / machine.l_d,
        -machine.r_s / machine.l_q,
    )
    matrix[:, I_D, V_D], matrix[:, I_Q, V_Q] = 1.0 / machine.l_d, 1.0 / machine.l_q
    matrix[:, I_D, I_Q] = omega_e * machine.l_q / machine.l_d
    matrix[:, I_Q, I_D] = -omega_e * machine.l_d / machine.l_q
    matrix[:, I_Q, ONE] = -omega_e * machine.psi_pm / machine.l_q
    if drive.neutral_inductance is not None:
        matrix[:, I_0, I_0], matrix[:, I_0, V_0] = (
            -machine.r_s / drive.neutral_inductance,
            1.0 / drive.neutral_inductance,
        )
    matrix[:, V_D, V_Q], matrix[:, V_Q, V_D] = omega_e, -omega_e
    matrix[:, Z_D, I_D] = matrix[:, Z_Q, I_Q] = -1.0
    matrix[:, Z_D, ONE], matrix[:, Z_Q, ONE] = i_d, i_q
    if not rotating:
        matrix[:, Z_D, Z_Q], matrix[:, Z_Q, Z_D] = omega_e, -omega_e
    return Plant(drive, i_d, i_q, omega_e, matrix, np.arange(i_d.size))


# Steps of a switched drive from event to event: comparators that cross, carriers that turn,
# samples that fall due.

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


# What a simulated current regulator did: currents, commutations, errors,
# distortion and the balance of power.
#
# Averages are integrals by Gauss rules over the pieces between switching instants,
# so that no sampling smears an edge.

ComplexArray = NDArray[np.complex128]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(5)


_PLACES, _SHARES = 0.5 + 0.5 * _NODES, 0.5 * _WEIGHTS


@dataclass(frozen=True, slots=True)
class PowerBalance:
    """Mean powers over the observed time in W, arrays of the shape (N,).

    ``dc_link`` is what the bridge takes, from leg states and phase currents; ``copper`` is R times
    the squared phase currents; ``shaft`` is torque times speed; ``stored`` is the rate at which the
    field between the magnets takes up energy, 0 in the steady state but for the ripple.
    """

    dc_link: FloatArray
    copper: FloatArray
    shaft: FloatArray
    stored: FloatArray


@dataclass(frozen=True, slots=True)
class SwitchingFrequency:
    """Switching frequencies in Hz, shape (N,): a commutation up and one down are one cycle.

    ``average`` is that of the three legs together, commutations over twice the observed time and 3
    legs; ``lowest`` and ``highest`` belong to the longest and the shortest time between two
    turn-ons of one leg, NaN with less than two.
    """

    average: FloatArray
    lowest: FloatArray
    highest: FloatArray


@dataclass(frozen=True, slots=True)
class CurrentTrace:
    """The observed time at N operating points, in S pieces without commutation inside.

    Args:
        plant: The drive at the N points.
        time, length: Start in s from the angle 0, and length in s, of each piece, shape (S, N).
            Some have the length 0.
        state: State at the start of each piece, shape (S, N, 9).
        legs: True where the upper switch is on, shape (S, N, 3).
    """

    plant: Plant
    time: FloatArray
    length: FloatArray
    state: FloatArray
    legs: BoolArray

    @property
    def duration(self) -> FloatArray:
        """Observed time in s, shape (N,): whole electrical periods."""
        return np.asarray(np.sum(self.length, axis=0))

    def _theta(self, time: FloatArray) -> FloatArray:
        return np.asarray(self.plant.omega_e * time)

    def _samples(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights (5, S, N), which sum to 1 over pieces and nodes, angles (5, S, N) and states (5,
        S, N, 9).
        """
        series = self.plant.series(self.state)
        times = _PLACES[:, None, None] * self.length
        states = np.stack([evaluate(series, time) for time in times])
        return (
            _SHARES[:, None, None] * self.length / self.duration,
            self._theta(self.time + times),
            states,
        )

    def phase_currents(self, point: int, time: ArrayLike) -> FloatArray:
        """Phase currents in A, shape (n, 3), of one point at times in s (n,)
        within the observed ones.
        """
        wanted = np.atleast_1d(np.asarray(time, dtype=np.float64))
        one = self.plant.part(slice(point, point + 1))
        piece = np.clip(np.searchsorted(self.time[:, point], wanted, side="right") - 1, 0, None)
        states = evaluate(
            one.series(self.state[piece, point][:, None]),
            (wanted - self.time[piece, point])[:, None],
        )
        return one.phase_currents(states[:, 0], one.omega_e * wanted)

    def references(self, point: int, time: ArrayLike) -> FloatArray:
        """References of the phase currents in A, shape (n, 3), of one point at times in s (n,)."""
        wanted = np.atleast_1d(np.asarray(time, dtype=np.float64))
        one = self.plant.part(slice(point, point + 1))
        return one.phase_currents(
            np.stack([[one.i_d, one.i_q, 0 * one.i_q]]).reshape(1, 3), one.omega_e * wanted
        )

    def samples_of(self, point: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Weights (5, S), which sum to 1, phase currents in A and their errors, both (5, S, 3), of
        one point at the nodes of all pieces.
        """
        one = self.plant.part(slice(point, point + 1))
        series = one.series(self.state[:, point, None])
        length = self.length[:, point]
        times = _PLACES[:, None] * length
        states = np.stack([evaluate(series, time[:, None])[:, 0] for time in times])
        theta = one.omega_e * (self.time[:, point] + times)
        weight = _SHARES[:, None] * length / np.sum(length)
        return weight, one.phase_currents(states, theta), one.phase_errors(states, theta)

    def rms_error(self) -> FloatArray:
        """Root mean square of the errors of the three phase currents in A, shape (N,)."""
        weight, theta, states = self._samples()
        square = np.mean(self.plant.phase_errors(states, theta) ** 2, axis=-1)
        return np.asarray(np.sqrt(np.sum(weight * square, axis=(0, 1))))

    def largest_error(self) -> FloatArray:
        """Largest error of a phase current in A, shape (N,), at the starts of the pieces,
        where the slopes change.
        """
        error = np.abs(self.plant.phase_errors(self.state, self._theta(self.time)))
        return np.asarray(np.max(error, axis=(0, 2)))

    def spectrum(self, orders: ArrayLike) -> ComplexArray:
        """Harmonics of the phase currents in A (peak), shape (H, N, 3); of the order 0 the mean.

        The phasor X of the order n stands for Re(X exp(j n theta_e)). Orders up to some 450.

        Args:
            orders: Orders n, shape (H,); fractions with the denominator of the observed periods
                show subharmonics.
        """
        order = np.atleast_1d(np.asarray(orders, dtype=np.float64))
        weight, theta, states = self._samples()
        current = self.plant.phase_currents(states, theta) * weight[..., None]
        found = np.empty((order.size, self.plant.i_d.size, 3), dtype=np.complex128)
        for k, n in enumerate(order):
            scale = 2.0 if n else 1.0
            found[k] = scale * np.sum(current * np.exp(-1j * n * theta)[..., None], axis=(0, 1))
        return found

    def current_thd(self) -> FloatArray:
        """Distortion of the phase currents, shape (N,): r.m.s. of all but the
        fundamental over the fundamental.

        All three phases together; no order is left out.
        """
        weight, theta, states = self._samples()
        square = np.sum(
            weight[..., None] * self.plant.phase_currents(states, theta) ** 2, axis=(0, 1)
        )
        fundamental = np.mean(np.abs(self.spectrum([1])[0]) ** 2, axis=-1) / 2.0
        rest = np.mean(square, axis=-1) - fundamental
        return np.asarray(np.sqrt(np.maximum(rest, 0.0) / fundamental))

    def instants(self, point: int, phase: int) -> tuple[FloatArray, BoolArray]:
        """Switching instants of a leg: times in s (E,), and whether the upper
        switch turns on there (E,).
        """
        leg = self.legs[:, point, phase]
        (changed,) = np.nonzero(leg[1:] != leg[:-1])
        return self.time[changed + 1, point], leg[changed + 1]

    def commutations(self) -> NDArray[np.int64]:
        """Number of commutations of each leg, shape (N, 3); of both switches of a leg together."""
        return np.asarray(np.sum(self.legs[1:] != self.legs[:-1], axis=0), dtype=np.int64)

    def switching_frequency(self) -> SwitchingFrequency:
        """Average and range of the switching frequency."""
        average = np.sum(self.commutations(), axis=-1) / (6.0 * self.duration)
        lowest, highest = np.full((2, average.size), math.nan)
        for point in range(average.size):
            turn_ons = [
                time[on] for time, on in (self.instants(point, phase) for phase in range(3))
            ]
            gaps = np.concatenate([np.diff(times) for times in turn_ons])
            if gaps.size:
                lowest[point], highest[point] = 1.0 / np.max(gaps), 1.0 / np.min(gaps)
        return SwitchingFrequency(average, lowest, highest)

    def _field_energy(self, state: FloatArray) -> FloatArray:
        machine, neutral = self.plant.drive.machine, self.plant.drive.neutral_inductance or 0.0
        square_d, square_q, square_0 = (state[..., k] ** 2 for k in (I_D, I_Q, I_0))
        return np.asarray(
            0.75 * (machine.l_d * square_d + machine.l_q * square_q) + 1.5 * neutral * square_0
        )

    def power_balance(self) -> PowerBalance:
        """Where the power from the DC link goes."""
        machine, v_dc = self.plant.drive.machine, self.plant.drive.v_dc
        weight, theta, states = self._samples()
        current = self.plant.phase_currents(states, theta)
        leg = v_dc * (self.legs - 0.5)
        shaft = (
            machine.torque(states[..., I_D], states[..., I_Q])
            * self.plant.omega_e
            / machine.pole_pairs
        )
        end = evaluate(self.plant.series(self.state[-1]), self.length[-1])
        stored = (self._field_energy(end) - self._field_energy(self.state[0])) / self.duration
        powers = (np.sum(leg * current, axis=-1), machine.r_s * np.sum(current**2, axis=-1), shaft)
        dc_link, copper, mechanical = (np.sum(weight * power, axis=(0, 1)) for power in powers)
        return PowerBalance(dc_link=dc_link, copper=copper, shaft=mechanical, stored=stored)

    def fundamental_voltage(self) -> ComplexArray:
        """Mean voltage vector v_d + j v_q in V (peak), shape (N,), in rotor coordinates."""
        weight, _, states = self._samples()
        return np.asarray(np.sum(weight * (states[..., V_D] + 1j * states[..., V_Q]), axis=(0, 1)))
