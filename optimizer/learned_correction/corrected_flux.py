"""The flux observer with a correction behind it.

    theta^ = theta_f + kappa,   kappa += share (y - kappa)

theta_f is the angle of the flux observer and its phase-locked loop, which run as they do without a
correction; y is what was learned, within the limit, and nought where an input lies outside its
trained range. The correction never enters the loop: it is added to the angle that is handed out
and taken from it before the next step. Beside kappa the state keeps the share of samples at which
the correction acted, by the same filter, and why it did not at the last one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.learned_correction.correction_frame import (
    TOLD,
    Inputs,
    brought,
    outside,
    speed_inputs,
)
from dqforge.optimizer.observers.methods import flux
from dqforge.optimizer.observers.parts import (
    ObserverState,
    ObserverTuning,
    StateMembers,
    flux_in_words,
)
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member, Pair


class LearnedCorrection(NamedTuple):
    """What a sample says of the correction."""

    angle: Annotated[Reals, Member("correction that it asks for", "rad")]
    outside: Annotated[Reals, Member("0: it acts; 1: current or speed beyond; 2: the residual is")]


# (arithmetic, gains, flux linkage, current, angle, speed) -> what the sample says.
Corrects = Callable[[Arithmetic, Any, Pair, Pair, Reals, Reals], LearnedCorrection]

# (arithmetic, gains, inputs of -1 to 1) -> correction in rad.
Learned = Callable[[Arithmetic, Any, Inputs], Reals]

MEMBERS = StateMembers(
    (
        ("psi", Member("stator flux linkage", "Wb")),
        ("i", Member("last current", "A")),
    ),
    (
        ("correction", Member("added to the angle of the flux observer", "rad")),
        ("hits", Member("share of the last samples at which the correction acted")),
        (
            "outside",
            Member("0: it acts; 1: current or speed beyond what was trained; 2: the residual is"),
        ),
    ),
)


def start(theta_e: Reals, omega_e: Reals) -> ObserverState:
    """State before the first step; shapes (N,)."""
    zero = np.zeros_like(theta_e)
    return ObserverState(
        ((zero, zero), (zero, zero)), theta_e, omega_e, False, scalars=(zero, zero, zero)
    )


def inputs(o: Arithmetic, gains: Any, psi: Pair, i: Pair, theta: Reals, omega: Reals) -> Inputs:
    """What the correction is told after a step of the flux observer, -1 to 1 where it was trained.

    Backwards everything is seen in a mirror.
    """
    own, frame = gains.flux, gains.frame
    turn = o.let("turn", o.rotation(theta))
    flux, current = o.let("flux", o.park(psi, turn)), o.let("current", o.park(i, turn))
    along = o.let("along", flux.d - (own.l_d * current.d + own.psi_pm), "residual on d, Wb")
    across = o.let("across", flux.q - own.l_q * current.q, "residual on q, Wb")
    size = o.let("size", o.choose(omega < 0.0, -omega, omega), "of the speed, rad/s")
    u, v = speed_inputs(frame, size, o)
    raw = (
        along,
        v,
        current.d,
        o.choose(omega < 0.0, -current.q, current.q),
        u,
        o.choose(omega < 0.0, -across, across),
    )
    return o.let("x", brought(frame, raw))


def limited(o: Arithmetic, y: Reals, limit: Any) -> Reals:
    """A correction within -limit to limit."""
    below = o.let("below", o.choose(y < limit, y, limit))
    return o.choose(below > -limit, below, -limit)


def told(
    o: Arithmetic,
    learned: Learned,
    gains: Any,
    psi: Pair,
    i: Pair,
    theta: Reals,
    omega: Reals,
) -> LearnedCorrection:
    """What was learned, within its limit, where every input lies in its range; else nought."""
    x = inputs(o, gains, psi, i, theta, omega)
    why = o.let("why", outside(x, o))
    y = o.let("y", o.choose(why <= 0.0, o.call(learned, gains, x), o.full(0.0, theta)))
    within = o.let("within", limited(o, y, gains.frame.limit))
    return LearnedCorrection(o.choose(omega < 0.0, -within, within), why)


def step(
    corrects: Corrects, gains: Any, state: ObserverState, v: Pair, i: Pair, maths: Arithmetic
) -> ObserverState:
    """One sample: ``v`` in V acted over the period that ends at the sampling instant of ``i`` in A,
    shapes (N,).
    """
    o, (kappa, hits, _) = maths, state.scalars
    own = o.let("own", o.wrap(state.theta_e - kappa), "angle of the flux observer, rad")
    core = ObserverState(state.vectors, own, state.omega_e, state.started)
    after = flux.step(gains.flux, core, v, i, o)
    if not state.started:
        return ObserverState(after.vectors, state.theta_e, after.omega_e, scalars=state.scalars)
    angle, omega = o.let("angle", after.theta_e, "its angle, rad"), o.let("omega", after.omega_e)
    psi, last = after.vectors
    now = o.let("now", o.call(corrects, gains, psi, last, angle, omega))
    share, one = gains.frame.share, o.full(1.0, omega)
    kappa = o.let("correction", kappa + share * (now.angle - kappa), "rad")
    hit = o.choose(now.outside <= 0.0, one, o.full(0.0, omega))
    hits = hits + share * (hit - hits)
    return ObserverState(
        after.vectors, o.wrap(angle + kappa), omega, scalars=(kappa, hits, now.outside)
    )


def sizes(scalars: FloatArray, _omega: FloatArray) -> FloatArray:
    """A hundredth of a radian, and one, see `ObserverMethod`.

    Args:
        scalars: Of M states, shape (M, 3).
    """
    return np.broadcast_to(np.array([0.01, 1.0, 1.0]), scalars.shape).copy()


def scale(gains: Any) -> tuple[float, float]:
    """Sampling period in s and magnet flux linkage in Wb.

    Args:
        gains: With a member ``flux``.
    """
    return float(gains.flux.path.t_s), float(gains.flux.psi_pm)


# A small network: five inputs, two hidden layers, one answer, hyperbolic tangents throughout.
#
#     a = tanh(W_1 x + b_1),  b = tanh(W_2 a + b_2),  y = limit tanh(w_3 b + b_3)
#
# The limit is part of the network: nothing larger can come out. Beyond that nothing is proven of
# it. tanh is the rational function of `hyperbolic_tangent` here, in training and in the emitted C
# alike.
#
# The training is Levenberg and Marquardt's method on the mean square from seeded weights, for fixed
# numbers of steps: most on every eighth drive, the last on all. What a network answers at one point
# scatters with the drives that it saw, and with the last digits by which its way begins: on 10,000
# drives it left up to 0.7 of the flux observer's error where the mean of eight networks left 0.1.

STEPS = ((8, 60), (1, 6))  # Every how manieth drive, and so many steps.
SEED = 20
_DAMPING = 1.0e-5  # Of the first step, added to the mean squares of the slopes.
_EASED, _RAISED, _MOST_RAISED = 3.0, 4.0, 12
_BLOCK = 1024  # Drives.
END = 4.97  # Size of the argument from which on the rational function is replaced by its sign.
TANH_ERROR = 1.0e-4  # Largest difference of `hyperbolic_tangent` from the hyperbolic tangent.
_UPPER = (135135.0, 17325.0, 378.0, 1.0)
_LOWER = (135135.0, 62370.0, 3150.0, 28.0)


@dataclass(frozen=True, slots=True)
class Network:
    """Weights, row by row: as many rows as the layer has neurons."""

    weights_1: Annotated[tuple[float, ...], Member("neuron by neuron")]
    offsets_1: tuple[float, ...]
    weights_2: tuple[float, ...]
    offsets_2: tuple[float, ...]
    weights_3: tuple[float, ...]
    offset_3: float

    def __post_init__(self) -> None:
        """Refuse layers that do not fit."""
        first, second = len(self.offsets_1), len(self.offsets_2)
        if (len(self.weights_1), len(self.weights_2), len(self.weights_3)) != (
            TOLD * first,
            first * second,
            second,
        ):
            raise ValueError("the layers of the network do not fit")

    @property
    def size(self) -> int:
        """How many numbers it has."""
        parts = (self.weights_1, self.offsets_1, self.weights_2, self.offsets_2, self.weights_3)
        return sum(map(len, parts)) + 1


# A network that answers nought.
NO_NETWORK = Network((0.0,) * TOLD, (0.0,), (0.0,), (0.0,), (0.0,), 0.0)


def hyperbolic_tangent(o: Arithmetic, argument: Reals) -> Reals:
    """Hyperbolic tangent by Lambert's continued fraction to the seventh power, within -1 to 1 for
    every argument; largest error 1e-4.

    Args:
        argument: Any shape.
    """
    below = o.let("below", o.choose(argument < END, argument, o.full(END, argument)))
    x = o.let("x", o.choose(below > -END, below, o.full(-END, argument)))
    q = o.let("q", x * x)
    upper = o.let("upper", _UPPER[0] + q * (_UPPER[1] + q * (_UPPER[2] + q)))
    lower = o.let("lower", _LOWER[0] + q * (_LOWER[1] + q * (_LOWER[2] + q * _LOWER[3])))
    t = o.let("t", (x * upper) / lower)
    most = o.let("most", o.choose(t < 1.0, t, o.full(1.0, t)))
    return o.choose(most > -1.0, most, o.full(-1.0, t))


def _layer(o: Arithmetic, name: str, weights: Any, offsets: Any, x: Inputs) -> Inputs:
    """Neurons of a layer; products are added in the order of the inputs."""
    columns = len(x)

    def neuron(n: Any) -> Reals:
        def product(k: Any) -> Reals:
            return o.at(weights, n * columns + k) * o.at(x, k)

        return o.call(hyperbolic_tangent, o.summed("total", o.at(offsets, n), columns, product))

    return o.each(name, len(offsets), neuron)


def answered(o: Arithmetic, network: Network, limit: Any, x: Inputs) -> Reals:
    """What the network answers to inputs of -1 to 1, rad."""
    first = _layer(o, "first", network.weights_1, network.offsets_1, x[:TOLD])
    second = _layer(o, "second", network.weights_2, network.offsets_2, first)
    last = o.summed(
        "last",
        network.offset_3,
        len(second),
        lambda n: o.at(network.weights_3, n) * o.at(second, n),
    )
    found: Reals = limit * o.call(hyperbolic_tangent, last)
    return found


def _curve(x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`hyperbolic_tangent` in double precision, and its derivative."""
    inside = np.abs(x) < END
    x = np.clip(x, -END, END)
    q = x * x
    upper = _UPPER[0] + q * (_UPPER[1] + q * (_UPPER[2] + q * _UPPER[3]))
    lower = _LOWER[0] + q * (_LOWER[1] + q * (_LOWER[2] + q * _LOWER[3]))
    upper_slope = _UPPER[1] + q * (2.0 * _UPPER[2] + q * (3.0 * _UPPER[3]))
    lower_slope = _LOWER[1] + q * (2.0 * _LOWER[2] + q * (3.0 * _LOWER[3]))
    t = x * upper / lower
    slope = (upper + 2.0 * q * upper_slope - 2.0 * x * t * lower_slope) / lower
    within = inside & (np.abs(t) < 1.0)
    return np.clip(t, -1.0, 1.0), np.where(within, slope, 0.0)


def _parts(
    flat: FloatArray, first: int, second: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]:
    ends = np.cumsum([TOLD * first, first, first * second, second, second])
    a, b, c, d, e, f = np.split(flat, ends)
    return a.reshape(first, TOLD), b, c.reshape(second, first), d, e, float(f[0])


def _run(
    flat: FloatArray, x: FloatArray, hidden: tuple[int, int]
) -> list[tuple[FloatArray, FloatArray]]:
    """Values and slopes of the tangents of each layer."""
    w_1, b_1, w_2, b_2, w_3, b_3 = _parts(flat, *hidden)
    one = _curve(w_1 @ x + b_1[:, None])
    two = _curve(w_2 @ one[0] + b_2[:, None])
    return [one, two, _curve(w_3 @ two[0] + b_3)]


def residuals(
    flat: FloatArray, x: FloatArray, wanted: FloatArray, hidden: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Answers less those wanted over the limit, shape (M,), and their slopes, shape (weights, M).

    Args:
        flat: All weights.
        x: Inputs of -1 to 1, shape (5, M).
        wanted: Corrections over the limit, shape (M,).
        hidden: Neurons of the hidden layers.
    """
    _, _, w_2, _, w_3, _ = _parts(flat, *hidden)
    (one, one_slope), (two, two_slope), (last, back_3) = _run(flat, x, hidden)
    back_2 = w_3[:, None] * back_3 * two_slope
    back_1 = (w_2.T @ back_2) * one_slope
    slopes = [
        (back_1[:, None] * x).reshape(-1, len(wanted)),
        back_1,
        (back_2[:, None] * one).reshape(-1, len(wanted)),
        back_2,
        back_3 * two,
        back_3[None],
    ]
    return last - wanted, np.concatenate(slopes)


def _descended(
    flat: FloatArray, x: FloatArray, wanted: FloatArray, hidden: tuple[int, int], steps: int
) -> FloatArray:
    """Weights after so many steps of damped least squares, fewer where none leads down.

    By the normal equations: of 80,000 drives a factor of the slopes takes ten times as long.
    """
    # Blocks whose slopes the processor's cache holds.
    blocks = [slice(at, at + _BLOCK) for at in range(0, len(wanted), _BLOCK)]

    def square(weights: FloatArray) -> float:
        gaps = [_run(weights, x[:, own], hidden)[-1][0] - wanted[own] for own in blocks]
        return sum(float(gap @ gap) for gap in gaps)

    ridge, least = _DAMPING * len(wanted), square(flat)
    for _ in range(steps):
        slope, curvature = np.zeros(flat.size), np.zeros((flat.size, flat.size))
        for own in blocks:
            gap, slopes = residuals(flat, x[:, own], wanted[own], hidden)
            slope += slopes @ gap
            curvature += slopes @ slopes.T
        for _ in range(_MOST_RAISED):
            tried = flat - np.linalg.solve(curvature + ridge * np.eye(flat.size), slope)
            found = square(tried)
            if found < least:
                break
            ridge *= _RAISED
        else:
            return flat
        flat, least, ridge = tried, found, ridge / _EASED
    return flat


def trained_network(
    x: FloatArray, wanted: FloatArray, hidden: tuple[int, int], limit: float
) -> Network:
    """A network of two hidden layers.

    Args:
        x: Inputs of -1 to 1, shape (6, M).
        wanted: Corrections in rad, shape (M,).
        hidden: Neurons of the hidden layers.
        limit: Of the answer in rad.
    """
    first, second = hidden
    generator = np.random.default_rng(SEED)

    def spread(rows: int, columns: int) -> FloatArray:
        return np.asarray(generator.standard_normal(rows * columns) / np.sqrt(columns))

    begin = [spread(first, TOLD), np.zeros(first), spread(second, first), np.zeros(second)]
    flat = np.concatenate([*begin, spread(1, second), np.zeros(1)])
    for every, steps in STEPS:
        seen, shares = np.ascontiguousarray(x[:TOLD, ::every]), wanted[::every] / limit
        flat = _descended(flat, seen, shares, hidden, steps)
    w_1, b_1, w_2, b_2, w_3, b_3 = _parts(flat.astype(np.float32).astype(np.float64), *hidden)
    plain = [tuple(part.ravel().tolist()) for part in (w_1, b_1, w_2, b_2, w_3)]
    return Network(plain[0], plain[1], plain[2], plain[3], plain[4], b_3)


# By what numbers a correction works, in words.


def in_words(tuning: ObserverTuning, gains: Any, t_s: float, what: str) -> str:
    """Numbers of the flux observer, then those of the correction.

    Args:
        gains: With a member ``frame``.
        t_s: Sampling period in s.
        what: What was learned.
    """
    frame = gains.frame
    words = flux_in_words(tuning, gains, t_s)
    if frame.share >= 1.0:
        return f"{words}; no correction is trained"
    filter_time = -t_s / math.log1p(-frame.share)
    return (
        f"{words}; correction: {what}, at most {math.degrees(frame.limit):.3g} deg, filter "
        f"{1e3 * filter_time:.3g} ms"
    )
