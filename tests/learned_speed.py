"""Fuzzy and neural controllers of the speed beside PI, tuned alike and tried on other drives.

Each gives the change of the torque from the error of the speed and its change (velocity form), both
as shares of what the controller is made for:

    PI      d = k_i e + k_p (e - e')
    fuzzy   d = sum of c_mn over the rules, weighted by mu_m(e) mu_n(e - e')
    neural  d = sum of v_k tanh(w_k1 e + w_k2 (e - e'))

Rules are those of Sugeno of order zero on five triangular sets each; with c_mn linear in m and n
they are PI (a partition of unity interpolates linearly), so that each search begins at the tuned
PI. Chapter 7.2.8 of paper 001 names both without a design; sets, layers, drives and criterion are
chosen here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any

import numpy as np
from scipy.optimize import differential_evolution

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.learned_correction.corrected_flux import hyperbolic_tangent
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, Member, limited
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import record_structs, record_values
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression
from dqforge.reports.verification.measured_cost import cost_on_target

SETS = 5
HIDDEN = 4
# Rules that are free: the table is odd, its centre 0.
_FREE = (SETS * SETS - 1) // 2
_GENERATIONS, _CROWD = 60, 48
_ANSWER = 4.0  # Delays in which a quick controller answers a load.
_OVERSHOOT = 2.0  # Weight of the overshoot, a share of the step, in the criterion.
_SPREAD = 4.0  # Gains are sought up to so many times the first, and down to as little.


@dataclass(frozen=True, slots=True)
class SpeedDrives:
    """Drives with a speed loop, arrays of shape (N,), per unit of a base torque and speed.

    ``mechanical`` is the time in s in which the base torque reaches the base speed, ``delay`` the
    time constant of torque behind its reference in s, ``step`` the speed that is asked for,
    ``load`` the torque that comes at half of the run, ``gain`` torque over what is asked for.
    """

    mechanical: FloatArray
    delay: FloatArray
    step: FloatArray
    load: FloatArray
    gain: FloatArray


def drives(count: int, mechanical: float, delay: float, seed: int) -> SpeedDrives:
    """Drives around one: inertia of half to three times, torque 15 % off, small and large steps."""
    rng = np.random.default_rng(seed)
    return SpeedDrives(
        mechanical * 2.0 ** rng.uniform(-1.0, math.log2(3.0), count),
        delay * rng.uniform(0.8, 1.5, count),
        rng.uniform(0.02, 0.5, count),
        rng.uniform(-0.7, 0.7, count),
        rng.uniform(0.85, 1.15, count),
    )


# The controllers, as steps.


def pi_change(o: Arithmetic, numbers: Sequence[Any], e: Reals, de: Reals) -> Reals:
    """Change of the torque by PI with ``numbers`` k_i and k_p."""
    return o.multiply_add(o.at(numbers, 0), e, o.at(numbers, 1) * de)


def _share(o: Arithmetic, name: str, place: Reals, at: int) -> Reals:
    """Membership of the triangular set at a place."""
    apart = o.let(f"{name}_apart_{at}", place - float(at) if at else place)
    left = o.let(f"{name}_left_{at}", 1.0 - o.choose(apart < 0.0, -apart, apart))
    return o.let(f"{name}_{at}", o.choose(left > 0.0, left, o.full(0.0, place)))


def fuzzy_change(o: Arithmetic, numbers: Sequence[Any], e: Reals, de: Reals) -> Reals:
    """The same by 25 rules; ``numbers`` are their consequents, row by row of e."""
    places = [o.let(name, 2.0 + 2.0 * limited(o, x, 1.0)) for name, x in (("at", e), ("to", de))]
    first, second = (
        [_share(o, name, place, n) for n in range(SETS)]
        for name, place in zip(("e", "de"), places, strict=True)
    )
    total: Any = None
    for m in range(SETS):
        row: Any = None
        for n in range(SETS):
            term = o.at(numbers, SETS * m + n) * second[n]
            row = term if row is None else row + term
        part = first[m] * o.let(f"row_{m}", row)
        total = part if total is None else total + part
    found: Reals = total
    return found


def neural_change(o: Arithmetic, numbers: Sequence[Any], e: Reals, de: Reals) -> Reals:
    """The same by neurons without offsets; ``numbers`` are v, w of e and w of the change."""
    total: Any = None
    for k in range(HIDDEN):
        v, w, u = (o.at(numbers, 3 * k + n) for n in range(3))
        inner = o.let(f"inner_{k}", o.multiply_add(w, e, u * de))
        part = v * o.let(f"bent_{k}", o.call(hyperbolic_tangent, inner))
        total = part if total is None else total + part
    found: Reals = total
    return found


Change = Callable[[Arithmetic, Sequence[Any], Reals, Reals], Reals]


def odd_table(free: FloatArray) -> FloatArray:
    """The consequents of `fuzzy_change` from the free ones, shape (12, ...) to (25, ...)."""
    centre = np.zeros((1, *free.shape[1:]))
    return np.concatenate([free, centre, -free[::-1]])


def linear_table(k_i: float, k_p: float) -> FloatArray:
    """The free consequents that are PI on errors and changes of -1 to 1, shape (12,)."""
    at = np.linspace(-1.0, 1.0, SETS)
    return np.asarray((k_i * at[:, None] + k_p * at).ravel()[:_FREE])


# The closed loop.


@dataclass(frozen=True, slots=True)
class SpeedRuns:
    """What a controller makes of each drive, shape (..., N): time integral of the error over that
    of a start with all the torque and a load that is answered in four delays; overshoot as a share
    of the step.
    """

    error: FloatArray
    overshoot: FloatArray

    @property
    def criterion(self) -> FloatArray:
        """Mean over the drives, and half of the worst."""
        cost = self.error + _OVERSHOOT * self.overshoot
        return np.asarray(np.mean(cost, axis=-1) + 0.5 * np.max(cost, axis=-1))


@dataclass(frozen=True, slots=True)
class SpeedScales:
    """Sampling period of the controller in s, length of a run in samples, and the error and change
    (per unit of the base speed) for which `fuzzy_change` and `neural_change` are made.
    """

    period: float
    samples: int
    error: float
    change: float


def run(change: Change, numbers: FloatArray, plant: SpeedDrives, scales: SpeedScales) -> SpeedRuns:
    """Drive each plant with each set of numbers.

    Torque and its reference stay within 1 per unit. The load torque comes at half of the run.

    Args:
        change: The controller.
        numbers: Shape (K, S) or (K,), S sets of K numbers.
        plant: N drives.
        scales: Of the controller.
    """
    own = np.asarray(numbers, dtype=np.float64).reshape(len(numbers), -1, 1)
    shape = (own.shape[1], plant.step.size)
    speed, torque, asked, last = (np.zeros(shape) for _ in range(4))
    area, over = np.zeros(shape), np.zeros(shape)
    kept = np.exp(-scales.period / plant.delay)
    for k in range(scales.samples):
        loaded = k >= scales.samples // 2
        e = plant.step - speed
        d = change(EXACT, tuple(own), e / scales.error, (e - last) / scales.change)
        asked = np.clip(asked + d, -1.0, 1.0)
        last = e
        wanted = plant.gain * asked
        mean = wanted + (torque - wanted) * plant.delay / scales.period * (1.0 - kept)
        torque = wanted + (torque - wanted) * kept
        speed = speed + scales.period / plant.mechanical * (mean - plant.load * loaded)
        area += scales.period * np.abs(e)
        if not loaded:
            over = np.maximum(over, -e / plant.step)
    start = 0.5 * plant.step**2 * plant.mechanical + plant.step * plant.delay
    answer = _ANSWER * (plant.delay + scales.period)
    load = np.abs(plant.load) * answer**2 / plant.mechanical
    found = np.nan_to_num(area / (start + load), nan=1e6, posinf=1e6)
    return SpeedRuns(found.reshape(*numbers.shape[1:], -1), over.reshape(*numbers.shape[1:], -1))


# Tuning of all three by the same search.


@dataclass(frozen=True, slots=True)
class SpeedController:
    """A tuned controller: its name, step and numbers, and what it does to the drives of which it
    learned and to others.
    """

    name: str
    change: Change
    numbers: FloatArray
    learned: SpeedRuns
    other: SpeedRuns


def tuned(
    first: tuple[float, float], learn: SpeedDrives, other: SpeedDrives, scales: SpeedScales
) -> tuple[SpeedController, ...]:
    """PI with the first gains, PI, fuzzy and neural controllers that were sought from there, each
    with the same number of runs.

    Args:
        first: k_i and k_p of `pi_change` with errors as shares of ``scales``.
        learn, other: Drives that the search sees, and drives that it does not.
        scales: Of the controllers.
    """
    begin = np.array(first)

    def least(
        change: Change, numbers: FloatArray, whole: Callable[[FloatArray], FloatArray] = np.asarray
    ) -> FloatArray:
        return sought(lambda x: run(change, whole(x), learn, scales).criterion, numbers)

    pi = least(pi_change, begin)
    line = linear_table(*pi)
    # Neurons that bend little are PI: v w e with w small.
    neurons = np.ravel([(1.0 / HIDDEN / 0.2, 0.2 * pi[0], 0.2 * pi[1])] * HIDDEN)
    fuzzy = odd_table(least(fuzzy_change, line, odd_table))
    neural = least(neural_change, neurons)
    return tuple(
        SpeedController(
            name,
            change,
            numbers,
            run(change, numbers, learn, scales),
            run(change, numbers, other, scales),
        )
        for name, change, numbers in (
            ("PI of the design", pi_change, begin),
            ("PI, sought", pi_change, pi),
            ("fuzzy", fuzzy_change, fuzzy),
            ("neural", neural_change, neural),
        )
    )


def sought(criterion: Callable[[FloatArray], FloatArray], begin: FloatArray) -> FloatArray:
    """Numbers with the least criterion, from what is there already on.

    Args:
        criterion: Shape (K, S) to (S,).
        begin: Shape (K,).
    """
    size = np.maximum(np.abs(begin), 0.2 * np.max(np.abs(begin)))
    low, high = begin - _SPREAD * size, begin + _SPREAD * size
    rng = np.random.default_rng(begin.size)
    crowd = begin + size * rng.normal(0.0, 0.4, (_CROWD, begin.size))
    crowd[0] = begin
    found = differential_evolution(
        criterion,
        np.column_stack([low, high]),
        init=np.clip(crowd, low, high),
        maxiter=_GENERATIONS,
        rng=np.random.default_rng(0),
        vectorized=True,
        updating="deferred",
        polish=False,
        tol=0.0,
    )
    return np.asarray(found.x)


# What the firmware would hold.


@dataclass(frozen=True, slots=True)
class ControllerNumbers:
    """Numbers of a controller."""

    numbers: Annotated[tuple[float, ...], Member("of the controller")]


def changing(change: Change) -> Callable[..., Reals]:
    """The step of a controller with its numbers in a record."""

    def step(o: Arithmetic, gains: ControllerNumbers, e: Reals, de: Reals) -> Reals:
        """Change of the torque, per unit, from the error and its change as shares."""
        return change(o, gains.numbers, e, de)

    return step


# The drive of the thesis, and the table of the page.

BENCH = "paper001-pmsm-bench"
LEARNED, OTHERS = 48, 400  # Drives.


def bench() -> tuple[tuple[float, float], float, float, SpeedScales]:
    """First gains of the thesis's drive, its mechanical time and delay in s, and the scales."""
    design = catalogue.load(BENCH)
    found = solve_gains(design, proofs=False).speed
    assert found is not None
    machine, speed = design.machine, design.control.bases.speed
    torque = 1.5 * machine.pole_pairs * machine.psi_pm * design.i_max
    assert machine.inertia is not None
    mechanical = machine.inertia * speed / torque
    delay = 3.0 * design.control.t_s + 0.5 * found.t_s
    scales = SpeedScales(found.t_s, round(8.0 * mechanical / found.t_s), 0.2, 0.02)
    per_unit = speed / torque
    first = found.ki * found.t_s * per_unit * scales.error, found.kp * per_unit * scales.change
    return first, mechanical, delay, scales


def sources(change: Change, numbers: FloatArray) -> dict[str, bytes]:
    """A header with the controller, and a function that costs can be taken of."""
    gains, functions = ControllerNumbers(tuple(map(float, numbers))), Functions()
    reader = StepReader("speed", functions, Block("", set()))
    reader.write("change", changing(change), [gains, Expression("e"), Expression("de")])
    lines = [
        "#include <math.h>",
        *(line for part in record_structs(gains, "speed") for line in part),
        *functions.texts.values(),
        "static const speed_controller_numbers_t SPEED_NUMBERS = {",
        *record_values(gains, None),
        "};",
        "static inline void speed_at(float e, float *d, float *rest)",
        "{",
        "    *d = speed_change(&SPEED_NUMBERS, e, 0.3F * e);",
        "    *rest = 0.0F;",
        "}",
    ]
    return {"step.h": "\n".join([*lines, ""]).encode("ascii")}


def instructions(change: Change, numbers: FloatArray) -> float:
    """Of a controller on a Cortex-M4F."""
    errors = np.linspace(-1.5, 1.5, 64).astype(np.float32)
    made = sources(change, numbers)
    return cost_on_target(made, "step.h", "speed_at", "cortex-m4", errors).instructions


def speed_controllers() -> Iterator[tuple[str, ...]]:
    """Three kinds of controller on drives that the search did not see."""
    first, mechanical, delay, scales = bench()
    learn, other = (drives(count, mechanical, delay, count) for count in (LEARNED, OTHERS))
    yield (
        "controller", "numbers", "instructions M4F", "error, mean / worst",
        "overshoot, mean / worst",
    )  # fmt: skip
    for one in tuned(first, learn, other, scales):
        error, over = one.other.error, 100.0 * one.other.overshoot
        yield (
            one.name,
            str(one.numbers.size),
            f"{instructions(one.change, one.numbers):.0f}",
            f"{error.mean():.2f} / {error.max():.2f}",
            f"{over.mean():.1f} / {over.max():.0f} %",
        )
