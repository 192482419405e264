"""What the correction is told, and where it is silent.

Six inputs, in the angle of the observer: residual psi^_d - psi_model,d in Wb, omega_low/|omega|, at
most 1, current (d, q) in A, u = (|omega| - omega_m)/(|omega| + omega_m), which is the hyperbolic
tangent of half the logarithm of |omega|/omega_m, and the residual on q in Wb. The last tells
nothing: where the phase-locked loop rests, psi^ - L_q i lies on d and the residual on q is nil. It
is watched, for where it is not small the loop is not at rest.

A drive that turns backwards is seen in a mirror (q components and the correction change their
sign), so that what is learned forwards holds backwards exactly. Each input is brought to -1 to 1
over the range that was trained; where one lies outside, or is not a number, there is no correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.plants.scenario import ComplexArray, Plants, steady_voltage
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.observers.methods.flux import flux_of_voltage
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.reduced_order import Limits, Training, TrainingBox
from dqforge.optimizer.steps.step_arithmetic import EXACT, Arithmetic, Member, at_least

INPUTS = 6
TOLD = 5  # Of which the first five are learned from.
Inputs = tuple[Reals, ...]  # The six inputs, each shape (N,).


@dataclass(frozen=True, slots=True)
class CorrectionFrame:
    """What the correction is told: input k counts as (value - centre[k]) scale[k]."""

    middle: Annotated[float, Member("geometric mean of the trained speeds", "rad/s")]
    low: Annotated[float, Member("least trained speed", "rad/s")]
    centre: Annotated[tuple[float, ...], Member("of each input")]
    scale: Annotated[tuple[float, ...], Member("... which is multiplied by this")]
    share: Annotated[float, Member("of a new value in the filter of the correction")]
    limit: Annotated[float, Member("largest correction", "rad")]

    def __post_init__(self) -> None:
        """Refuse what has not six inputs."""
        if not len(self.centre) == len(self.scale) == INPUTS:
            raise ValueError("a correction has six inputs")


# A frame in which nothing is ever corrected, of an observer that has not been trained.
SILENT = CorrectionFrame(1.0, 1.0, (3.0,) * INPUTS, (1.0,) * INPUTS, 1.0, 0.0)


def _single(value: float) -> float:
    """The number that single precision has for it."""
    return float(np.float32(value))


def speed_inputs(frame: Any, size: Reals, maths: Arithmetic) -> tuple[Reals, Reals]:
    """The two inputs of a size of the speed in rad/s."""
    u = (size - frame.middle) / (size + frame.middle)
    return u, frame.low / at_least(maths, size, frame.low)


def brought(frame: Any, raw: Inputs) -> Inputs:
    """Inputs over their trained ranges, -1 to 1."""
    return tuple(
        (value - centre) * scale
        for value, centre, scale in zip(raw, frame.centre, frame.scale, strict=True)
    )


def outside(x: Inputs, o: Arithmetic) -> Reals:
    """0 within the trained ranges, 1 where a current or the speed lies beyond, else 2 where the
    residual does. Not-a-number lies outside.
    """
    within = [o.magnitude(value) <= 1.0 for value in x]
    known = within[1] & within[2] & within[3] & within[4]
    zero, one, two = (o.full(code, x[0]) for code in (0.0, 1.0, 2.0))
    return o.choose(known, o.choose(within[0] & within[5], zero, two), one)


def frame_of(seen: SteadyErrors, box: TrainingBox, share: float, limit: float) -> CorrectionFrame:
    """The frame of a training.

    Args:
        seen: The drives that are trained on: their residuals and currents bound the inputs; the
            residual on q, which is nil at rest, may be half as far from it as the other one varies.
        box: Bounds the speeds.
        share: Of a new value in the filter.
        limit: Of the correction, in rad.
    """
    middle = float(np.sqrt(box.omega_low * box.omega_high))
    ends = np.array([box.omega_low, box.omega_high])
    open_frame = CorrectionFrame(
        middle, box.omega_low, (0.0,) * INPUTS, (1.0,) * INPUTS, share, limit
    )
    u, v = speed_inputs(open_frame, ends, EXACT)

    def ends_of(part: FloatArray) -> tuple[float, float]:
        return float(np.min(part)), float(np.max(part))

    along = ends_of(seen.residual.real)
    across = 0.5 * (along[1] - along[0])
    ranges = [
        along,
        (float(v[1]), float(v[0])),
        ends_of(seen.current.real),
        ends_of(seen.current.imag),
        (float(u[0]), float(u[1])),
        (-across, across),
    ]
    return CorrectionFrame(
        _single(middle),
        _single(box.omega_low),
        tuple(_single(0.5 * (low + high)) for low, high in ranges),
        tuple(_single(2.0 / (high - low)) for low, high in ranges),
        _single(share),
        _single(limit),
    )


def inputs_of(frame: CorrectionFrame, seen: SteadyErrors) -> FloatArray:
    """Inputs of drives that turn forwards, shape (6, M)."""
    u, v = speed_inputs(frame, seen.omega, EXACT)
    raw = (
        seen.residual.real,
        v,
        seen.current.real,
        seen.current.imag,
        u,
        seen.residual.imag,
    )
    return np.stack(brought(frame, raw))


# Steady angle errors of the flux observer on drives that differ from its data.
#
# The current controllers hold the current that is commanded, i^ = i^_d + j i^_q in the angle of the
# observer. In coordinates that turn with that angle, which is ahead of the rotor by delta, voltage,
# flux linkage and the observer's two models are sums of three terms: a part that does not depend on
# delta (resistance, mean inductance), one in exp(-j delta) (the magnet), one in exp(-2 j delta)
# (saliency). So is the active flux that the phase-locked loop turns to,
#
#     psi_a(delta) = c_0 + c_1 exp(-j delta) + c_2 exp(-2 j delta),
#
# and three evaluations of the emitted equations give its coefficients exactly. The loop rests where
# Im psi_a = 0 with Re psi_a > 0 and a falling Im psi_a: of all such angles that next to zero is the
# error. It is a fixed point of `dqforge.optimizer.observers.parts`, found for 20,000 drives
# in a fraction of a second.

# Share of the largest current below which a dead time takes less than its whole voltage.
SOFT = 0.02

# Angle error in rad beyond which the angle counts as lost: no correction would help.
LARGEST_ERROR = 2.0
NOISE = 0.003  # Standard deviation of the residual over psi_pm, on each axis, that is trained.
_GRID = np.radians(np.arange(-180.0, 181.0, 10.0))
_HALVINGS = 45


@dataclass(frozen=True, slots=True, eq=False)
class SteadyErrors:
    """M drives at rest in the observer's coordinates.

    ``omega`` in rad/s; ``current`` i_d + j i_q in A as it is controlled; ``residual`` flux linkage
    of the observer less that of its current model, d + j q in Wb; ``error`` estimated minus true
    angle in rad. All in the angle of the observer, shape (M,). ``held`` says which drives have a
    steady state at all.
    """

    omega: FloatArray
    current: ComplexArray
    residual: ComplexArray
    error: FloatArray
    held: NDArray[np.bool_]

    def only(self, rows: NDArray[np.bool_]) -> SteadyErrors:
        """Some of the drives."""
        return SteadyErrors(
            self.omega[rows],
            self.current[rows],
            self.residual[rows],
            self.error[rows],
            self.held[rows],
        )


# Voltage d + j q in V, at the end of a period in the frame of the rotor, that a steady state takes
# without current, and what one ampere of i_d and of i_q adds to it.
Volts = tuple[ComplexArray, ComplexArray, ComplexArray]


def volts_of(plant: Plants, omega: FloatArray, t_s: float) -> Volts:
    """Voltages of M machines at speeds in rad/s: exact, and linear in the current."""
    currents = np.array([[0j], [1.0 + 0j], [1j]])
    bare, along, across = steady_voltage(plant, currents, omega, t_s)
    return bare, along - bare, across - bare


def _flux(
    gains: FluxGains,
    volts: Volts,
    current: ComplexArray,
    omega: FloatArray,
    lost: ComplexArray,
    delta: float | FloatArray,
) -> tuple[ComplexArray, ComplexArray]:
    """Flux linkage of the observer and of its current model in Wb, in its own coordinates."""
    ahead, x = np.exp(1j * np.asarray(delta)), gains.path.t_s * omega
    i = current * ahead
    back = np.exp(-1j * x)
    v = volts[0] + volts[1] * i.real + volts[2] * i.imag + lost * ahead * np.exp(-0.5j * x)
    last, zero = i * back, np.zeros_like(omega)
    parts = [(z.real, z.imag) for z in (v, last, i)]
    gained = flux_of_voltage(EXACT, gains.path, (zero, zero), parts[0], parts[1], parts[2], x)
    alpha = np.minimum(gains.alpha_1 * np.abs(x) + gains.alpha_0, 1.0)
    model = gains.l_d * current.real + gains.psi_pm + 1j * gains.l_q * current.imag
    path = (gained[0] + 1j * gained[1]) / ahead
    psi = ((1.0 - alpha) * path + alpha * model) / (1.0 - (1.0 - alpha) * back)
    return np.asarray(psi, dtype=np.complex128), np.asarray(model, dtype=np.complex128)


def _coefficients(samples: list[ComplexArray]) -> list[ComplexArray]:
    """Those of a polynomial in exp(-j delta) by its values at three equal steps of a turn."""
    turns = 2.0 * np.pi * np.arange(3) / 3.0
    return [
        np.asarray(
            sum(value * np.exp(1j * n * turn) for value, turn in zip(samples, turns, strict=True))
            / 3.0
        )
        for n in range(3)
    ]


def _rest(c: list[ComplexArray]) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The angle next to zero at which the loop rests, and whether there is one."""

    def value(delta: float | FloatArray) -> ComplexArray:
        turn = np.exp(-1j * np.asarray(delta))
        return np.asarray(c[0] + (c[1] + c[2] * turn) * turn)

    least = np.full(c[0].shape, np.inf)
    start = np.zeros(c[0].shape)
    before = value(_GRID[0])
    for low, high in zip(_GRID[:-1].tolist(), _GRID[1:].tolist(), strict=True):
        after = value(high)
        falls = (before.imag > 0.0) & (after.imag <= 0.0) & (before.real + after.real > 0.0)
        nearer = falls & (abs(0.5 * (low + high)) < least)
        least = np.where(nearer, abs(0.5 * (low + high)), least)
        start = np.where(nearer, low, start)
        before = after
    low_end, high_end = start, start + (_GRID[1] - _GRID[0])
    for _ in range(_HALVINGS):
        middle = 0.5 * (low_end + high_end)
        above = value(middle).imag > 0.0
        low_end, high_end = np.where(above, middle, low_end), np.where(above, high_end, middle)
    return 0.5 * (low_end + high_end), np.isfinite(least)


def steady_errors(
    gains: FluxGains,
    volts: Volts,
    current: ComplexArray,
    omega: FloatArray,
    lost: FloatArray,
    i_max: float,
) -> SteadyErrors:
    """Where the observer rests on M drives.

    Args:
        gains: Of the flux observer.
        volts: Of the true machines, see `volts_of`.
        current: i_d + j i_q in A in the angle of the observer, shape (M,).
        omega: Electrical speed in rad/s, not nil, shape (M,).
        lost: Voltage in V along the current that the observer knows nothing of, shape (M,).
        i_max: Largest current in A; below `SOFT` of it the lost voltage fades.
    """
    along = lost * current / np.sqrt(np.abs(current) ** 2 + (SOFT * i_max) ** 2)
    samples = []
    for delta in (2.0 * np.pi * np.arange(3) / 3.0).tolist():
        psi, _ = _flux(gains, volts, current, omega, along, delta)
        samples.append(psi - gains.l_q * current)
    error, held = _rest(_coefficients(samples))
    psi, model = _flux(gains, volts, current, omega, along, error)
    return SteadyErrors(omega, current, psi - model, error, held & (np.abs(error) < LARGEST_ERROR))


@dataclass(frozen=True, slots=True, eq=False)
class Drives:
    """M drives, at a speed in rad/s each: the voltages that they take, the ``current`` i_d + j i_q
    in A that is commanded, the voltage ``lost`` along it in V, and the ``noise`` of the residual
    in Wb.
    """

    volts: Volts
    omega: FloatArray
    current: ComplexArray
    lost: FloatArray
    noise: ComplexArray
    i_max: float

    def at_rest(self, gains: FluxGains, correction: FloatArray | float = 0.0) -> SteadyErrors:
        """Where the observer rests if the currents are held in its angle with a correction.

        Args:
            gains: Of the flux observer.
            correction: Angle in rad that is added to the observer's, shape (M,) or one for all.
        """
        current = self.current * np.exp(1j * np.asarray(correction))
        found = steady_errors(gains, self.volts, current, self.omega, self.lost, self.i_max)
        return SteadyErrors(
            found.omega, found.current, found.residual + self.noise, found.error, found.held
        )


def drawn(machine: LinearMachine, box: TrainingBox, t_s: float, count: int, seed: int) -> Drives:
    """Drives of a box at any speed and current.

    Speeds are even in their logarithm, parameters and the lost voltage between their limits, i_q to
    both sides and i_d from its least value to a little above nought, within the largest current and
    a twentieth more. Forwards alone: backwards everything is mirrored.
    """
    generator = np.random.default_rng(seed)

    def between(low: float, high: float) -> FloatArray:
        return generator.uniform(low, high, count)

    omega = np.exp(between(float(np.log(box.omega_low)), float(np.log(box.omega_high))))
    plant = Plants(
        machine.r_s * (1.0 + between(*box.r_s)),
        machine.l_d * (1.0 + between(*box.l_d)),
        machine.l_q * (1.0 + between(*box.l_q)),
        machine.psi_pm * (1.0 + between(*box.psi_pm)),
    )
    largest = 1.05 * box.i_max
    i_d, i_q = between(box.i_d_low, 0.05 * box.i_max), between(-largest, largest)
    current: ComplexArray = i_d + 1j * i_q
    current /= np.maximum(1.0, np.abs(current) / largest)
    noise: ComplexArray = generator.standard_normal(count) + 1j * generator.standard_normal(count)
    noise *= NOISE * machine.psi_pm
    volts = volts_of(plant, omega, t_s)
    return Drives(volts, omega, current, between(*box.lost), noise, box.i_max)


# What a trained correction gains on drives that it has not seen, within its box and beyond.

POINTS = 20_000  # Drives drawn for a training.
TRIED = 8_000  # Drives drawn for its assessment, and as many beyond the box.
LEAST_HELD = 0.2  # Least share of the drives of the box at which the observer has a steady state.
ALONE, REGRESSION = "flux observer alone", "linear regression"

# Corrected once, with the currents still held in the angle that is not corrected.
ANSWERED = "first answer"

# At rest with the correction: the currents are held in the corrected angle.
CORRECTED = "corrected"
_TRAINED, _TRIED, _BEYOND = 1, 2, 3  # seeds
_EDGES = (0.03, 0.06, 0.12, 0.3, 1.0)
_PASSES = 8

# Inputs of -1 to 1, shape (6, M) -> correction in rad, shape (M,).
Corrects = Callable[[FloatArray], FloatArray]


@lru_cache(maxsize=4)
def training_drives(
    gains: FluxGains, machine: LinearMachine, box: TrainingBox, count: int = POINTS
) -> SteadyErrors:
    """The drives that are trained on, each with some share of its error corrected already.

    The correction turns the angle in which the currents are held, and with it what the observer
    sees: what is learned has to be right before it acts, when it has acted, and in between.

    Raises:
        NoSolutionError: The observer holds on hardly any of them.
    """
    drives = drawn(machine, box, gains.path.t_s, count, _TRAINED)
    bare = drives.at_rest(gains)
    share = float(np.mean(bare.held))
    if share < LEAST_HELD:
        raise NoSolutionError(
            f"control.observer: the flux observer has a steady angle on {100.0 * share:.3g} % of "
            "the drives of its tolerance box alone; there is nothing to learn from, narrow "
            "control.tolerances or write method: flux"
        )
    done = np.random.default_rng(_TRAINED).uniform(0.0, 1.0, count)
    found = drives.at_rest(gains, np.where(bare.held, -done * bare.error, 0.0))
    return found.only(found.held & bare.held)


@lru_cache(maxsize=4)
def _fresh(
    gains: FluxGains, machine: LinearMachine, box: TrainingBox, seed: int
) -> tuple[Drives, SteadyErrors]:
    drives = drawn(machine, box, gains.path.t_s, TRIED, seed)
    return drives, drives.at_rest(gains)


def beyond(box: TrainingBox) -> Limits:
    """Relative errors of R above the box that are tried: 30 % of R more."""
    return box.r_s[1], box.r_s[1] + 0.3


def _regression(seen: SteadyErrors, box: TrainingBox) -> FloatArray:
    """Columns of a linear regression, shape (15, M): residual, currents and the size of i_q, by
    one, the logarithm of the speed, and its inverse.
    """
    one = np.ones_like(seen.omega)
    speeds = [one, np.log(seen.omega / box.omega_high), box.omega_low / seen.omega]
    d, q = seen.current.real / box.i_max, seen.current.imag / box.i_max
    values = [one, seen.residual.real / box.i_max, d, q, np.abs(q)]
    return np.stack([speed * value for speed in speeds for value in values])


def _in_the_loop(
    gains: FluxGains, drives: Drives, frame: CorrectionFrame, corrects: Corrects
) -> tuple[FloatArray, Any, Any]:
    """Errors in rad where correction and drive have come to rest together, where there is such a
    rest, and where the correction acts.

    Halfway to each new answer: as the filter of the correction, slowly.
    """
    kappa = np.zeros_like(drives.omega)
    for _ in range(_PASSES):
        seen = drives.at_rest(gains, kappa)
        answer, _ = _answer(frame, corrects, seen)
        kappa = np.where(seen.held, 0.5 * (kappa + answer), kappa)
    seen = drives.at_rest(gains, kappa)
    return seen.error + kappa, seen.held, _answer(frame, corrects, seen)[1]


def _answer(
    frame: CorrectionFrame, corrects: Corrects, seen: SteadyErrors
) -> tuple[FloatArray, Any]:
    """The correction in rad as it is emitted: silent outside its trained ranges; where it acts."""
    x = inputs_of(frame, seen)
    acts = outside(tuple(x), EXACT) == 0.0
    return np.where(acts, corrects(x), 0.0), acts


def assessed(
    gains: FluxGains,
    machine: LinearMachine,
    box: TrainingBox,
    trained: SteadyErrors,
    frame: CorrectionFrame,
    omega_max: float,
    corrects: Corrects,
    rules: float | None,
    numbers: int,
) -> Training:
    """Errors with and without a correction, on drives drawn anew.

    Args:
        gains: Of the flux observer.
        trained: The drives that were trained on.
        frame: What the correction is told, and its limit.
        omega_max: Largest electrical speed in rad/s, of which the bands are shares.
        corrects: What was learned.
        rules: Bound of its rules in rad, None where it has none.
        numbers: How many constants were learned.
    """
    linear = least_squares(_regression(trained, box), -trained.error)
    further = replace(box, r_s=beyond(box))
    edges = omega_max * np.stack([_EDGES[:-1], _EDGES[1:]], axis=1)
    found: list[dict[str, Any]] = []
    for where, seed in ((box, _TRIED), (further, _BEYOND)):
        drives, bare = _fresh(gains, machine, where, seed)
        error, held, acts = _in_the_loop(gains, drives, frame, corrects)
        left = {
            ALONE: bare.error,
            REGRESSION: bare.error + np.einsum("i,in->n", linear, _regression(bare, box)),
            ANSWERED: bare.error + _answer(frame, corrects, bare)[0],
            CORRECTED: error,
        }
        found.append(_by_band(bare, edges, left, held & bare.held, acts))
    inner, outer = found
    return Training(
        box,
        edges,
        inner["rms"],
        inner["largest"],
        outer["rms"],
        beyond(box),
        inner["held"],
        inner["acts"],
        outer["acts"],
        frame.limit,
        rules,
        numbers,
        len(trained.error),
    )


def _by_band(
    tried: SteadyErrors, edges: FloatArray, left: dict[str, FloatArray], both: Any, acts: Any
) -> dict[str, Any]:
    """R.m.s. and largest errors in rad per band, and shares of the drives; nought where the
    observer holds on none. ``both`` are the drives that are at rest without and with a correction.
    """
    bands = [(tried.omega >= low) & (tried.omega <= high) for low, high in edges.tolist()]

    def over(function: Callable[[FloatArray], Any], name: str) -> FloatArray:
        held = both if name == CORRECTED else tried.held
        parts = [left[name][band & held] for band in bands]
        return np.array([float(function(part)) if part.size else 0.0 for part in parts])

    def root(part: FloatArray) -> Any:
        return np.sqrt(np.mean(part**2))

    def share(of: Any, among: Any) -> FloatArray:
        counts = [max(1, int(np.count_nonzero(band & among))) for band in bands]
        return np.array(
            [
                np.count_nonzero(band & among & of) / count
                for band, count in zip(bands, counts, strict=True)
            ]
        )

    return {
        "rms": {name: over(root, name) for name in left},
        "largest": {name: over(lambda part: np.max(np.abs(part)), name) for name in left},
        "held": share(tried.held, np.ones_like(tried.held)),
        "acts": share(acts, both),
    }


# Takagi-Sugeno rules: four speeds by four currents, each with a linear answer.
#
# The memberships are hats over the knots of two inputs, of which two overlap and sum to one. The
# answer is the mean of four neighbouring rules with weights that are not negative and sum to one:
#
#     y = sum_kl h_k(u) h_l(i_q) (c_kl0 + c_kl1 r_d + c_kl2 v + c_kl3 i_d + c_kl4 i_q)
#
# It is linear in the 80 numbers c: one least-squares solve trains it. And it lies between the least
# and the largest of its rules, each of which is largest in a corner of its box: that bounds it.
#
# References:
#     T. Takagi, M. Sugeno, "Fuzzy identification of systems and its applications to modeling and
#     control", IEEE Trans. Systems, Man and Cybernetics 15, 1985; paper 001, 7.2.8.

KNOTS = 4
TERMS = 5

# Of i_q over its range: two close to nought, where the voltage of a dead time turns over.
CURRENT_KNOTS = (-1.0, -0.125, 0.125, 1.0)

# Of u over its range, nearly even in the logarithm of the speed.
SPEED_KNOTS = (-1.0, -0.3125, 0.3125, 1.0)
_SPEED, _CURRENT = 4, 3  # which inputs the memberships are of


@dataclass(frozen=True, slots=True)
class FuzzyRules:
    """Knots and the inverse of their distances for speed and current, and the answers of the rules:
    speed by speed, current by current, five numbers each in rad.
    """

    speed_knots: tuple[float, ...]
    speed_slopes: Annotated[tuple[float, ...], Member("inverse of their distances")]
    current_knots: tuple[float, ...]
    current_slopes: tuple[float, ...]
    answers: Annotated[
        tuple[float, ...], Member("speed by speed, current by current, five factors each", "rad")
    ]

    def __post_init__(self) -> None:
        """Refuse another number of rules."""
        sizes = [len(self.speed_knots), len(self.current_knots)]
        slopes = [len(self.speed_slopes), len(self.current_slopes)]
        if sizes != [KNOTS] * 2 or slopes != [KNOTS - 1] * 2:
            raise ValueError("rules have four speeds and four currents")
        if len(self.answers) != KNOTS * KNOTS * TERMS:
            raise ValueError("rules have sixteen answers of five numbers")


def _slopes(knots: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(float(np.float32(1.0 / (after - before))) for before, after in pairwise(knots))


def _rules(answers: FloatArray) -> FuzzyRules:
    return FuzzyRules(
        SPEED_KNOTS,
        _slopes(SPEED_KNOTS),
        CURRENT_KNOTS,
        _slopes(CURRENT_KNOTS),
        tuple(float(np.float32(value)) for value in answers),
    )


NO_RULES = _rules(np.zeros(KNOTS * KNOTS * TERMS))  # Rules that answer nought.


def rule(o: Arithmetic, answers: Any, x: Inputs, number: Any) -> Reals:
    """Answer of one rule in rad."""
    begin = o.let("begin", number * TERMS)
    return o.summed(
        "total",
        o.at(answers, begin),
        TERMS - 1,
        lambda term: o.at(answers, begin + (term + 1)) * o.at(x, term),
    )


def mean_of_rules(o: Arithmetic, rules: FuzzyRules, x: Inputs, k: Any, n: Any) -> Reals:
    """Mean of the four rules from speed k and current n on, rad: no larger than the largest of
    them.
    """
    speed, current = x[_SPEED], x[_CURRENT]
    f = o.let("f", (speed - o.at(rules.speed_knots, k)) * o.at(rules.speed_slopes, k))
    g = o.let("g", (current - o.at(rules.current_knots, n)) * o.at(rules.current_slopes, n))
    number = o.let("number", k * KNOTS + n)
    faster = o.let("faster", number + KNOTS)

    def along(name: str, at: Any) -> Reals:
        first = o.let(name, o.call(rule, rules.answers, x, at))
        mean: Reals = first + g * (o.call(rule, rules.answers, x, at + 1) - first)
        return mean

    low, high = o.let("low", along("first", number)), o.let("high", along("second", faster))
    found: Reals = low + f * (high - low)
    return found


def answered(o: Arithmetic, rules: FuzzyRules, x: Inputs) -> Reals:
    """What the rules answer to inputs of -1 to 1, rad."""
    k = o.reached("k", [x[_SPEED] >= knot for knot in rules.speed_knots[1:-1]])
    n = o.reached("n", [x[_CURRENT] >= knot for knot in rules.current_knots[1:-1]])
    return o.call(mean_of_rules, rules, x, k, n)


def _hats(knots: tuple[float, ...], x: FloatArray) -> FloatArray:
    return np.stack([np.interp(x, knots, row) for row in np.eye(KNOTS)])


def trained_rules(x: FloatArray, wanted: FloatArray) -> FuzzyRules:
    """The rules with the least sum of squares.

    Args:
        x: Inputs of -1 to 1, shape (6, M).
        wanted: Corrections in rad, shape (M,).
    """
    speed, current = _hats(SPEED_KNOTS, x[_SPEED]), _hats(CURRENT_KNOTS, x[_CURRENT])
    terms = np.concatenate([np.ones((1, x.shape[1])), x[: TERMS - 1]])
    columns = speed[:, None, None] * current[None, :, None] * terms[None, None]
    return _rules(least_squares(columns.reshape(-1, x.shape[1]), wanted))


def largest_rule(rules: FuzzyRules, frame: CorrectionFrame) -> float:
    """Bound in rad of what the rules answer within the trained ranges.

    Each rule is linear: it is largest where every input is at that end of its range which its
    factor asks for. Speed and current lie where the rule has a weight, between its neighbouring
    knots.

    Args:
        frame: Of the inputs.
    """
    answers = np.array(rules.answers).reshape(KNOTS, KNOTS, TERMS)
    current, speed = np.array(rules.current_knots), np.array(rules.speed_knots)
    u = speed / frame.scale[_SPEED] + frame.centre[_SPEED]
    inverse = np.minimum(frame.low * (1.0 - u) / (frame.middle * (1.0 + u)), 1.0)
    v = (inverse - frame.centre[1]) * frame.scale[1]
    low, high = [0, 0, 1, 2], [1, 2, 3, 3]
    sums = [
        answers[..., 0]
        + answers[..., 2] * v[slow][:, None]
        + answers[..., 4] * current[near][None, :]
        for slow in (low, high)
        for near in (low, high)
    ]
    rest = np.abs(answers[..., 1]) + np.abs(answers[..., 3])
    return float(np.max(rest + np.max(np.abs(sums), axis=0)))


# Least squares of many samples in few unknowns, in a fixed order of operations.

# Share of the mean square of a column that is added: unknowns that no sample tells are nought.
_RIDGE = 1e-10


def least_squares(columns: FloatArray, wanted: FloatArray) -> FloatArray:
    """Factors of K columns, shape (K, M), whose sum is nearest to ``wanted``, shape (M,).

    By the normal equations and Cholesky's factors, summed by numpy's own loops and not by a linear
    algebra library, whose order of summation depends on its threads.
    """
    square = np.einsum("in,jn->ij", columns, columns)
    right = np.einsum("in,n->i", columns, wanted)
    count = len(right)
    square[np.arange(count), np.arange(count)] += (
        _RIDGE * float(np.mean(np.diag(square))) + np.finfo(float).tiny
    )
    factor = np.zeros_like(square)
    for k in range(count):
        rest = square[k:, k] - np.einsum("ij,j->i", factor[k:, :k], factor[k, :k])
        factor[k:, k] = rest / np.sqrt(rest[0])
    found = np.zeros(count)
    for k in range(count):
        found[k] = (right[k] - np.einsum("j,j->", factor[k, :k], found[:k])) / factor[k, k]
    for k in reversed(range(count)):
        behind = np.einsum("j,j->", factor[k + 1 :, k], found[k + 1 :])
        found[k] = (found[k] - behind) / factor[k, k]
    return found


# What a design says of a correction, and what it leaves open.

# Time constant of the filter of the correction in s where the design names none.
FILTER_TIME = 0.02


def frame_for(
    gains: FluxGains, machine: LinearMachine, settings: ObserverSettings, box: TrainingBox
) -> CorrectionFrame:
    """What the correction is told; its limit is the largest error of the training where the design
    names none.

    Args:
        gains: Of the flux observer.
        settings: The observer of the design.
    """
    drives = training_drives(gains, machine, box)
    time = FILTER_TIME if settings.correction_filter is None else settings.correction_filter
    limit = settings.correction_limit
    if limit is None:
        limit = float(np.max(np.abs(drives.error)))
    share = float(-np.expm1(-gains.path.t_s / time))
    return frame_of(drives, box, share, limit)
