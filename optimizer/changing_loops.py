"""What is proven of a saturating machine's current loops while the current changes.

Axis by axis, decoupled as if perfectly. The inductance may be any of those along the current
reference at every sample, and go wherever it likes from one to the next; the tolerances are
constant, and are cut into cells where one Lyapunov function does not serve all of them.

With constant gains the difference between any two currents obeys this, the inductance being an
average between both: whatever their course, they come together. Gains that follow the current do so
for small deviations from a current that is held; with gains and inductances of any two currents
(``any_current``), for deviations of any size from it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.cell_queue import common_lyapunov, contracts, lyapunov_frame
from dqforge.optimizer.certificates.matrix_inequalities import chained_matrices
from dqforge.optimizer.loops.gain_schedule import AxisSchedule, GainSchedule
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.robustness import Axis, DriveBox

if TYPE_CHECKING:
    from flint import fmpq


_CELLS = 64  # Cells of the tolerances at most.

# Pieces of the range of inductances that are tried where no function serves all of it.
_STEPS = (2, 4, 8, 16)
_PLACES = 5  # Currents between which the velocity form is tried.


@dataclass(frozen=True, slots=True)
class ChangingAxis:
    """What is proven of one axis.

    Args:
        axis: Which axis.
        inductance: Least and largest along the reference, in H.
        proven: Whether deviations are forgotten however fast the current changes; with scheduled
            gains small ones, and where the gains are those of the current that flows.
        any_current: Of scheduled gains whether they may be those of another current, such as the
            reference of a current on its way, and deviations of any size; None of constant gains.
        rate: Where it is not proven so: the largest change of the inductance per sample, as a
            factor, for which it is; None where it is not needed or none was found.
        cells: Cells of the tolerances that have a function each.
        velocity: Of scheduled gains a change of the current under which the velocity form grows,
            with the currents i_q in A; None where none was found.
    """

    axis: Axis
    inductance: Interval
    proven: bool
    any_current: bool | None
    rate: float | None
    cells: int
    velocity: tuple[Growth, Interval] | None


@dataclass(frozen=True, slots=True)
class _Axis:
    """One axis: its tolerances, and gains over inductances kp t_s/L, ki t_s^2/L with g = L'/L = 1.

    ``share`` is the interval of g over L/L' by the tolerances, ``rho`` that of R t_s/L over all.
    """

    share: Interval
    rho: Interval

    def proven(self, products: Callable[[Interval], tuple[tuple[float, float], ...]]) -> int | None:
        """Cells of the tolerances that serve, None where there would be too many."""
        waiting, found, tried = [self.share], 0, 0
        while waiting:
            low, high = waiting.pop()
            tried += 1
            loops = LoopRange(self.rho, products((low, high)))
            if common_matrix_of(loops) is not None:
                found += 1
            elif tried >= _CELLS or high - low < 1e-3 * low:
                return None
            else:
                waiting += [(low, 0.5 * (low + high)), (0.5 * (low + high), high)]
        return found


def _limits(box: DriveBox, axis: Axis, inductance: Interval) -> _Axis:
    tolerances, design = box.tolerances, box.design
    low_l, high_l = tolerances.limits("l_d" if axis == "i_d" else "l_q")
    low_v, high_v = tolerances.limits("v_dc")
    low_r, high_r = tolerances.limits("r_s")
    low_t, high_t = tolerances.limits("dead_time")
    dead = box.dead_time_resistance if high_t > low_t else 0.0
    least = design.machine.r_s * (1.0 + low_r) + dead * low_t * (1.0 + high_v)
    most = design.machine.r_s * (1.0 + high_r) + dead * high_t * (1.0 + high_v)
    t_s = design.control.t_s
    ends = [
        ohm * t_s / (value * (1.0 + deviation))
        for ohm in (least, most)
        for value in inductance
        for deviation in (low_l, high_l)
    ]
    return _Axis(
        share=((1.0 + low_v) / (1.0 + high_l), (1.0 + high_v) / (1.0 + low_l)),
        rho=(min(ends), max(ends)),
    )


def _constant(box: DriveBox, gains: LoopGains, axis: Axis, inductance: Interval) -> ChangingAxis:
    """Gains that do not follow: both go with 1/L together."""
    limits, t_s = _limits(box, axis, inductance), box.design.control.t_s

    def products(share: Interval, reach: Interval = inductance) -> tuple[tuple[float, float], ...]:
        ends = share[0] * t_s / reach[1], share[1] * t_s / reach[0]
        return tuple((end * gains.kp, end * gains.ki_ts) for end in ends)

    cells = limits.proven(products)
    rate = None if cells is not None else _rate(limits, products, inductance)
    return ChangingAxis(axis, inductance, cells is not None, None, rate, cells or 0, None)


def _rate(
    limits: _Axis,
    products: Callable[[Interval, Interval], tuple[tuple[float, float], ...]],
    inductance: Interval,
) -> float | None:
    """Largest factor by which the inductance may change in a sample, of those tried."""
    for pieces in _STEPS:
        ends = np.geomspace(*inductance, pieces + 1).tolist()
        cells = [
            LoopRange(limits.rho, products(limits.share, reach)).corners()
            for reach in pairwise(ends)
        ]
        if neighbours_fall(cells):
            return float(ends[1] / ends[0])
    return None


def _scheduled(box: DriveBox, schedule: GainSchedule, found: AxisSchedule) -> ChangingAxis:
    """Gains that follow: each over the inductance of the same current, or of any other."""
    inductance = float(np.min(found.inductance)), float(np.max(found.inductance))
    limits, t_s = _limits(box, found.axis, inductance), box.design.control.t_s
    gains = [np.asarray(found.kp), np.asarray(found.ki) * t_s]
    same = [_reached(values / found.inductance) for values in gains]
    other = [
        (float(np.min(values)) / inductance[1], float(np.max(values)) / inductance[0])
        for values in gains
    ]

    def over(sides: list[Interval]) -> Callable[[Interval], tuple[tuple[float, float], ...]]:
        (p_low, p_high), (q_low, q_high) = sides
        return lambda share: tuple(
            (share_p * t_s * p, share_q * t_s * q)
            for share_p, p in zip(share, (p_low, p_high), strict=True)
            for share_q, q in zip(share, (q_low, q_high), strict=True)
        )

    cells, anywhere = limits.proven(over(same)), limits.proven(over(other))
    return ChangingAxis(
        found.axis,
        inductance,
        cells is not None,
        anywhere is not None,
        None,
        cells or 0,
        _velocity(box, schedule, found),
    )


def _reached(values: FloatArray) -> Interval:
    """All values of a curve that is known at many currents: between two it moves by no more than
    the largest step.
    """
    step = float(np.max(np.abs(np.diff(values)), initial=0.0))
    return float(np.min(values)) - step, float(np.max(values)) + step


def _velocity(
    box: DriveBox, schedule: GainSchedule, found: AxisSchedule
) -> tuple[Growth, Interval] | None:
    """How the velocity form grows when the current jumps between a few of the reference."""
    places = np.linspace(0, found.inductance.size - 1, _PLACES).round().astype(int)
    t_s, r_s = box.design.control.t_s, box.design.machine.r_s
    steps = []
    for place in places.tolist():
        inductance, kp, ki = (float(of[place]) for of in (found.inductance, found.kp, found.ki))
        rho = r_s * t_s / inductance
        step = velocity_step(
            math.exp(-rho), -math.expm1(-rho) / rho, t_s / inductance, (kp, ki * t_s)
        )
        steps.append(step)
    growth = fastest_growth(np.array(steps))
    if growth is None:
        return None
    at = [float(schedule.i_q[places[place]]) for place in growth.places]
    return growth, (at[0], at[1])


def prove_changing_currents(
    box: DriveBox,
    largest: tuple[float, float],
    loops: tuple[LoopGains, LoopGains],
    schedule: GainSchedule | None,
) -> tuple[ChangingAxis, ...]:
    """What is proven of both axes while the inductances change; nothing of a linear machine.

    Args:
        box: The drive with its tolerances.
        largest: Largest incremental inductances (l_d, l_q) along the reference in H; the loops are
            tuned for the least ones.
        loops: The current loops of d and q.
        schedule: Their gains over the current, None where they are constant.
    """
    if isinstance(box.design.machine, LinearMachine):
        return ()
    plain = replace(box, spread=(1.0, 1.0))
    if schedule is not None:
        return tuple(_scheduled(plain, schedule, axis) for axis in schedule.axes)
    axes: tuple[Axis, Axis] = ("i_d", "i_q")
    return tuple(
        _constant(plain, loop, axis, (least, most))
        for axis, loop, least, most in zip(axes, loops, box.nominal, largest, strict=True)
    )


# The current loop of one axis over a sample, in flux linkage, while its inductance changes.
#
# Deviations of the flux linkage obey d psi/dt = g v - R i with i = psi/L at every instant, L an
# average of incremental inductances between two states. In phi = psi/(g t_s) only
#
#     alpha = exp(-rho),   beta = integral of exp(-rho ..),   rho = R t_s/L averaged over the sample
#     P = kp t_s g/L,   Q = ki t_s^2 g/L       at the sampling instant
#
# depend on it. Parallel form: v+ = -(P + Q) phi + I, I+ = I - Q phi. This is affine in alpha, beta,
# P and Q, each of which may take any value of an interval at every sample: corners say all.
#
# Velocity form: v+ = v - (P + Q) phi + (kp now) i before. A gain that changes leaves kp now less kp
# before, times i before, in the voltage for good.

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class LoopRange:
    """Intervals of what a loop may be at a sample.

    ``rho`` is R t_s/L. ``products`` are pairs (P, Q) whose convex hull holds all of them.
    """

    rho: Interval
    products: tuple[tuple[float, float], ...]

    def shares(self) -> tuple[Interval, Interval]:
        """Intervals of alpha and beta, rounded outwards."""
        low, high = self.rho
        return _outwards(_falling(low, high, _alpha)), _outwards(_falling(low, high, _beta))

    def corners(self) -> FloatArray:
        """Steps of (phi, v, I) at the corners, shape (V, 3, 3)."""
        alpha, beta = self.shares()
        found = [
            parallel_step(a, b, p, q)
            for a, b, (p, q) in itertools.product(alpha, beta, self.products)
        ]
        return np.array(found)


def _alpha(rho: Any) -> Any:
    return (-rho).exp()


def _beta(rho: Any) -> Any:
    return -(-rho).expm1() / rho if rho != 0 else rho + 1


def _falling(low: float, high: float, function: Any) -> tuple[Any, Any]:
    """Values of a falling function over an interval, as balls."""
    from flint import arb

    return function(arb(high)), function(arb(low))


def _outwards(balls: tuple[Any, Any]) -> Interval:
    low, high = float(balls[0].lower()), float(balls[1].upper())
    return float(np.nextafter(low, -np.inf)), float(np.nextafter(high, np.inf))


def parallel_step(alpha: float, beta: float, p: float, q: float) -> list[list[float]]:
    """The step of (phi, v, I) with the parallel form, rows of a 3 x 3 matrix.

    Args:
        alpha, beta: What is left of the flux linkage, and what a voltage adds to it.
        p, q: kp t_s g/L and ki t_s^2 g/L.
    """
    return [[alpha, beta, 0.0], [-(p + q), 0.0, 1.0], [-q, 0.0, 1.0]]


def velocity_step(
    alpha: float, beta: float, share: float, gains: tuple[float, float]
) -> list[list[float]]:
    """The step of (phi, v, i before) with the velocity form, v + kp (e - e before) + ki t_s e.

    Args:
        alpha, beta: What is left of the flux linkage, and what a voltage adds to it.
        share: Current over phi, in some unit.
        gains: kp and ki t_s at this sample, over that unit.
    """
    kp, ki_ts = gains
    return [[alpha, beta, 0.0], [-(kp + ki_ts) * share, 1.0, kp], [share, 0.0, 0.0]]


def falls_exactly(matrix: FloatArray, corners: FloatArray) -> bool:
    """Whether P > 0 and P - A^T P A > 0 at every corner, in rational numbers.

    Args:
        matrix: P, shape (3, 3), symmetric to the bit.
        corners: A, shape (V, 3, 3).
    """
    from flint import fmpq_mat

    def exact(values: FloatArray) -> Any:
        entries = [_rational(value) for value in values.ravel().tolist()]
        return fmpq_mat(*values.shape, entries)

    p = exact(matrix)
    if not _positive(p):
        return False
    steps = (exact(corner) for corner in corners)
    return all(_positive(p - step.transpose() * p * step) for step in steps)


def _rational(value: float) -> fmpq:
    from flint import fmpq

    return fmpq(*value.as_integer_ratio())


def _positive(matrix: Any) -> bool:
    """Sylvester's criterion."""
    from flint import fmpq_mat

    for size in range(1, matrix.nrows() + 1):
        part = fmpq_mat(size, size, [matrix[i, j] for i in range(size) for j in range(size)])
        if part.det() <= 0:
            return False
    return True


# One Lyapunov function for all that a loop may be, or several that follow each other.


def common_matrix_of(loops: LoopRange) -> FloatArray | None:
    """P that falls along every loop of a range, proven in rational numbers; None without one.

    Args:
        loops: What the loop may be at a sample.
    """
    corners = loops.corners()
    frame = lyapunov_frame(np.mean(corners, axis=0))
    if frame is None:
        return None
    matrix = common_lyapunov(corners, frame, lambda found: contracts(found, found, corners).whole)
    if matrix is None or not falls_exactly(matrix, corners):
        return None
    return matrix


@dataclass(frozen=True, slots=True)
class Growth:
    """A change of the loop under which it grows.

    ``factor`` per sample, while the loop stays ``stay`` samples each at the numbers ``places``.
    """

    factor: float
    stay: int
    places: tuple[int, int]


def fastest_growth(steps: FloatArray, longest: int = 8) -> Growth | None:
    """The pair of steps that grows most when they take turns, None where none grows.

    Args:
        steps: Steps that the loop may take, each stable by itself, shape (N, n, n).
        longest: Samples that each of both lasts at most.
    """
    best: Growth | None = None
    powers = steps
    for stay in range(1, longest + 1):
        for first, second in ((a, b) for a in range(len(steps)) for b in range(a)):
            product = powers[first] @ powers[second]
            radius = float(np.max(np.abs(np.linalg.eigvals(product)))) ** (0.5 / stay)
            if radius > 1.0 and (best is None or radius > best.factor):
                best = Growth(radius, stay, (second, first))
        powers = powers @ steps
    return best


def neighbours_fall(cells: Sequence[FloatArray]) -> bool:
    """Whether matrices P_1 .. P_K are found with A^T P_j A < P_i for all A of cell i, |i - j| <= 1.

    A loop that moves by one cell a sample at most then forgets; in doubles.

    Args:
        cells: Corners of the steps of each cell, shape (V, n, n).
    """
    frames = [lyapunov_frame(np.mean(cell, axis=0)) for cell in cells]
    kept = [frame for frame in frames if frame is not None]
    if len(kept) < len(cells):
        return False
    backs = [np.linalg.inv(frame) for frame in kept]
    places = range(len(cells))
    pairs = [(i, j) for i in places for j in places if abs(i - j) <= 1]
    links = [(i, j, kept[j] @ cells[i] @ backs[i]) for i, j in pairs]
    found = chained_matrices(links, [back.T @ back for back in backs], count=len(cells))
    if found is None:
        return False
    matrices = [
        frame.T @ matrix @ frame for frame, matrix in zip(kept, found.matrices, strict=True)
    ]
    return all(contracts(matrices[i], matrices[j], cells[i]).whole for i, j in pairs)
