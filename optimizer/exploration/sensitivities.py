"""What an output depends on, from the rows of a draw as they are: first-order sensitivities by the
means over bins of each input, and squared correlations beside them.

The first-order sensitivity of Y to X_i is Var(E[Y | X_i]) / Var(Y) (Saltelli and others 2008,
section 1.2.6). With B bins of X_i and N rows the variance of the bins' means is that of the
conditional mean, and a share (B - 1)/N of the rest by chance alone. That is taken off,

    S_i = (N - 1)/(N - B) (V_i/V - (B - 1)/(N - 1)),

as the adjusted correlation ratio does (Kelley 1935, doi:10.1073/pnas.21.9.554): an input without
influence has zero on average, and may come out a little below it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.dq_machines.flux_map import ScaledMachines
from dqforge.machines.dq_machines.synchronous import FluxJet
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.fitting import SideConditions
from dqforge.optimizer.curves.single_precision import power_of_series
from dqforge.optimizer.operating_points.mtpa_locus import free_locus

# Best fits of many curves at once by Chebyshev series on their own segments.
#
# In the local variable of each segment the side conditions do not depend on the breakpoints, so
# that all curves share one space of admissible series. Weighted least squares there are small
# systems, solved for all curves together; the minimax fit comes from reweighting (C. L. Lawson,
# Contributions to the theory of linear least maximum approximation, thesis, UCLA, 1961).
#
# Arrays keep the curves along their last axis, and every operation is a sum, product, quotient or
# root of single elements in a fixed order: no curve's numbers depend on how many others there are,
# on a library's kernels or on the processor.

_REWEIGHTINGS = 5  # More gain nothing: the error is within 1 or 2 % of the least one.
_NODES = 5  # Nodes of a segment per coefficient: between them the error rises by 2 %, seldom 5 %.
_LEAST_WEIGHT = 1e-10
_LEAST_PIVOT = 1e-14  # Share of a diagonal below which a pivot is rounding.


@dataclass(frozen=True, slots=True, eq=False)
class SeriesSpace:
    """Chebyshev series on S segments, degree n, that keep side conditions, looked at in P nodes.

    ``nodes`` in [-1, 1], shape (P,); ``basis`` the Chebyshev polynomials up to degree 2 n there,
    shape (2 n + 1, P). Functions that are not zero on segment s: their series ``parts[s]``, shape
    (A, n + 1), their places among all ``count`` functions ``places[s]``, and what turns the moments
    of the weights into their products, ``products[s]``, shape (A (A + 1) / 2, 2 n + 1).
    """

    degree: int
    nodes: FloatArray
    basis: FloatArray
    count: int
    parts: tuple[FloatArray, ...]
    places: tuple[tuple[int, ...], ...]
    products: tuple[FloatArray, ...]

    @property
    def segments(self) -> int:
        """Number of segments S."""
        return len(self.parts)


def lobatto_nodes(count: int) -> FloatArray:
    """Extrema of a Chebyshev polynomial on [-1, 1], ends included, ascending, shape (count,)."""
    return np.array([-math.cos(math.pi * place / (count - 1)) for place in range(count)])


def chebyshev_values(degree: int, nodes: FloatArray) -> FloatArray:
    """Chebyshev polynomials up to a degree at points of [-1, 1], shape (n + 1, P)."""
    rows = [np.ones_like(nodes), nodes + 0.0]
    while len(rows) <= degree:
        rows.append(2.0 * nodes * rows[-1] - rows[-2])
    return np.array(rows[: degree + 1])


@cache
def series_space(degree: int, segments: int, side: SideConditions) -> SeriesSpace:
    """Space of series of a degree on segments under side conditions.

    Args:
        degree: Degree n of each segment, at least 1.
        segments: Number of segments S.
        side: Equalities to keep.
    """
    nodes = lobatto_nodes(_NODES * (degree + 1) + 1)
    left = [(-1.0) ** order for order in range(degree + 1)]
    right = [1.0] * (degree + 1)
    at_start = ([left] if side.exact_at_zero else []) + [
        power_of_series(degree, power).tolist() for power in side.absent
    ]
    kept = [at_start if segment == 0 else [] for segment in range(segments)]
    parts: list[list[list[float]]] = [[] for _ in kept]
    places: list[list[int]] = [[] for _ in kept]
    count = 0
    for segment, conditions in enumerate(kept):
        seams = [left] * (side.continuous and segment > 0)
        seams += [right] * (side.continuous and segment < segments - 1)
        for free in _null_space(degree + 1, [*conditions, *seams]):
            parts[segment].append(free)
            places[segment].append(count)
            count += 1
    for seam in range(segments - 1 if side.continuous else 0):
        outer = [left] if seam > 0 else []
        parts[seam].append(_meeting(right, [*kept[seam], *outer]))
        outer = [right] if seam + 1 < segments - 1 else []
        parts[seam + 1].append(_meeting(left, outer))
        for segment in (seam, seam + 1):
            places[segment].append(count)
        count += 1
    arrays = tuple(np.array(part).reshape(-1, degree + 1) for part in parts)
    products = tuple(_products(part) for part in arrays)
    basis = chebyshev_values(2 * degree, nodes)
    return SeriesSpace(degree, nodes, basis, count, arrays, tuple(map(tuple, places)), products)


def _null_space(size: int, rows: list[list[float]]) -> list[list[float]]:
    """Orthonormal vectors that every row maps to zero, by Gram and Schmidt."""
    found: list[list[float]] = []
    for candidate in [*rows, *np.eye(size).tolist()]:
        vector = list(candidate)
        for _ in range(2):  # once more for the rounding of the first pass
            for other in found:
                share = math.fsum(a * b for a, b in zip(vector, other, strict=True))
                vector = [a - share * b for a, b in zip(vector, other, strict=True)]
        length = math.sqrt(math.fsum(a * a for a in vector))
        if length > 1e-6:
            found.append([a / length for a in vector])
    return found[len(rows) :]


def _meeting(end: list[float], conditions: list[list[float]]) -> list[float]:
    """The shortest series of value 1 at an end of its segment that keeps the conditions."""
    free = _null_space(len(end), conditions)
    shares = [math.fsum(a * b for a, b in zip(end, vector, strict=True)) for vector in free]
    size = math.fsum(share * share for share in shares)
    return [
        math.fsum(share * vector[k] for share, vector in zip(shares, free, strict=True)) / size
        for k in range(len(end))
    ]


def _products(part: FloatArray) -> FloatArray:
    """Products of functions as sums of Chebyshev moments: T_i T_j = (T_(i+j) + T_|i-j|) / 2.

    Series of shape (A, n + 1) to (A (A + 1) / 2, 2 n + 1), pairs (a, b <= a) row by row.
    """
    size = part.shape[1]
    rows = []
    for a in range(part.shape[0]):
        for b in range(a + 1):
            row = np.zeros(2 * size - 1)
            for i in range(size):
                for j in range(size):
                    half = 0.5 * part[a, i] * part[b, j]
                    row[i + j] += half
                    row[abs(i - j)] += half
            rows.append(row)
    return np.array(rows)


def combined(matrix: FloatArray, rows: FloatArray) -> FloatArray:
    """Product of a constant matrix (R, C) and rows (C, N), summed in the order of the columns."""
    total, term = (
        np.zeros((matrix.shape[0], rows.shape[1])),
        np.empty((matrix.shape[0], rows.shape[1])),
    )
    for column in range(rows.shape[0]):
        np.multiply(matrix[:, column, np.newaxis], rows[column], out=term)
        total += term
    return total


def series_values(space: SeriesSpace, series: FloatArray) -> FloatArray:
    """Values of series of shape (S, n + 1, N) at the nodes, shape (S, P, N)."""
    basis = space.basis[: space.degree + 1].T
    return np.stack([combined(basis, part) for part in series])


def weighted_fit(space: SeriesSpace, weights: FloatArray, values: FloatArray) -> FloatArray:
    """Series with the least weighted sum of squared errors at the nodes, shape (S, n + 1, N).

    Args:
        space: Admissible series.
        weights: Weights of the squares, shape (S, P, N).
        values: What is to be fitted at the nodes, shape (S, P, N).
    """
    count, size = space.count, weights.shape[2]
    normal, right = np.zeros((count, count, size)), np.zeros((count, size))
    for segment, (part, places) in enumerate(zip(space.parts, space.places, strict=True)):
        weight = weights[segment]
        squares = combined(space.products[segment], combined(space.basis, weight))
        moments = combined(space.basis[: space.degree + 1], weight * values[segment])
        found = combined(part, moments)
        pair = 0
        for a, row in enumerate(places):
            right[row] += found[a]
            for column in places[: a + 1]:
                normal[row, column] += squares[pair]
                pair += 1
    solution = _solved(normal, right)
    return np.stack(
        [
            combined(part.T, solution[list(places)])
            for part, places in zip(space.parts, space.places, strict=True)
        ]
    )


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions (F, N) of positive definite systems, lower halves (F, F, N), by Cholesky."""
    count = right.shape[0]
    factor, solution = normal.copy(), right.copy()
    inverse = np.empty_like(right)
    for column in range(count):
        least = _LEAST_PIVOT * normal[column, column] + 1e-300
        for before in range(column):
            factor[column:, column] -= factor[column:, before] * factor[column, before]
        inverse[column] = 1.0 / np.sqrt(np.maximum(factor[column, column], least))
        factor[column:, column] *= inverse[column]
        solution[column] *= inverse[column]
        solution[column + 1 :] -= factor[column + 1 :, column] * solution[column]
    for column in range(count - 1, -1, -1):
        for behind in range(column + 1, count):
            solution[column] -= factor[behind, column] * solution[behind]
        solution[column] *= inverse[column]
    return solution


def minimax_fit(space: SeriesSpace, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Series of nearly the least largest error, shape (S, n + 1, N), and that error at the nodes.

    Each reweighting multiplies the weights by the error that is left: they gather where the error
    of the best fit has its extrema.

    Args:
        space: Admissible series.
        values: What is to be fitted at the nodes, shape (S, P, N).
    """
    ones = np.ones_like(values)
    first = weighted_fit(space, ones, values)
    rest = values - series_values(space, first)
    scale = np.max(np.abs(rest), axis=(0, 1))
    # Corrections are fitted to what is left, so that rounding is a share of the error.
    rest /= np.where(scale > 0.0, scale, 1.0)
    left, weights = rest, ones
    best, worst = np.zeros_like(first), np.ones_like(scale)
    for _ in range(_REWEIGHTINGS):
        weights = weights * np.abs(left)
        weights /= np.maximum(np.max(weights, axis=(0, 1)), 1e-300)
        np.maximum(weights, _LEAST_WEIGHT, out=weights)
        correction = weighted_fit(space, weights, rest)
        left = rest - series_values(space, correction)
        size = np.max(np.abs(left), axis=(0, 1))
        better = size < worst
        worst = np.where(better, size, worst)
        best = np.where(better, correction, best)
    return first + scale * best, scale * worst


# MTPA loci, limit torques and currents of many machines over one flux map.
#
# The best angle of a current changes little with the scales of the map: Newton's method on the
# derivative of the torque by the angle starts from the nominal locus. A fixed number of steps, and
# rotations without angle functions, give a machine the same numbers in any batch.

_LEVELS = 32
_STEPS = 6
_LARGEST_STEP = 0.15  # Largest change of the angle in one step, in rad.

# Last change of the angle in rad above which a point counts as not found: the torque is flat there
# to its square.
_CONVERGED = 1e-9
_TORQUE_STEPS = 5
_TORQUE_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True, eq=False)
class ScaledLoci:
    """Points of most torque for their current, L of each of N machines, arrays of shape (L, N).

    ``current``, ``i_d``, ``i_q`` in A, ascending, the last at the current limit; ``torque`` in N m,
    its last row the limit torque. ``last_step`` is the largest last change of the angle in rad,
    shape (N,). ``solved`` is False, shape (N,), where the single path has to answer: a point did
    not settle, the torque does not rise along the locus, or it leaves the data of the map.
    """

    current: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque: FloatArray
    last_step: FloatArray
    solved: BoolArray

    @property
    def torque_max(self) -> FloatArray:
        """Largest torque in N m within the current limits, shape (N,); NaN where not solved."""
        return np.where(self.solved, self.torque[-1], np.nan)


def scaled_loci(machines: ScaledMachines) -> ScaledLoci:
    """MTPA loci up to each machine's ``i_max``.

    Args:
        machines: N machines over one flux map.

    Raises:
        InputError: The nominal machine makes no torque with positive q current.
    """
    shares = np.linspace(1.0 / _LEVELS, 1.0, _LEVELS)[:, np.newaxis]
    current = shares * np.sqrt(shares) * machines.i_max
    u, v = _nominal_directions(machines, current)
    step = np.zeros_like(current)
    for _ in range(_STEPS):
        i_d, i_q = current * u, current * v
        slope, bend = _by_angle(machines.jet(i_d, i_q), i_d, i_q)
        # Where the torque bends upwards the step leads the way that it rises.
        away = np.where(bend < 0.0, -bend, np.abs(bend) + 1e-300)
        step = np.clip(slope / away, -_LARGEST_STEP, _LARGEST_STEP)
        u, v = _turned(u, v, step)
    i_d, i_q = current * u, current * v
    torque = machines.torque(i_d, i_q)
    last = np.max(np.abs(step), axis=0)
    solved = (last < _CONVERGED) & (torque[0] > 0.0) & np.all(np.diff(torque, axis=0) > 0.0, axis=0)
    if not machines.nominal.flux_map.extrapolate:
        solved &= np.all(machines.known(i_d, i_q), axis=0)
    return ScaledLoci(current, i_d, i_q, torque, last, solved)


def _nominal_directions(
    machines: ScaledMachines, current: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Unit vectors of the nominal locus at currents that saturate as much, shape (L, N)."""
    nominal = machines.nominal
    locus = free_locus(nominal, nominal.i_max)
    saturating = current / machines.current
    i_d = np.interp(saturating, locus.current, locus.i_d / locus.current)
    i_q = np.interp(saturating, locus.current, locus.i_q / locus.current)
    size = np.sqrt(i_d * i_d + i_q * i_q)
    return i_d / size, i_q / size


def _by_angle(jet: FluxJet, i_d: FloatArray, i_q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """First and second derivative of T / (3/2 p) by the angle of the current, at its magnitude."""
    by_d = jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q
    by_q = jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d
    by_dd = jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd
    by_dq = jet.l_dd + jet.d_dq * i_q - jet.q_dq * i_d - jet.l_qq
    by_qq = 2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d
    slope = i_d * by_q - i_q * by_d
    bend = i_q * i_q * by_dd - 2.0 * i_d * i_q * by_dq + i_d * i_d * by_qq
    return slope, bend - i_d * by_d - i_q * by_q


def _turned(u: FloatArray, v: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors turned by small angles: by 2 atan(angle / 2), without a function of angles."""
    square = 0.25 * angle * angle
    cosine, sine = (1.0 - square) / (1.0 + square), angle / (1.0 + square)
    u, v = cosine * u - sine * v, sine * u + cosine * v
    size = np.sqrt(u * u + v * v)
    return u / size, v / size


def currents_on_loci(
    machines: ScaledMachines, loci: ScaledLoci, torque: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Currents (i_d, i_q) in A with least copper loss for torques, shape (P, N).

    NaN where a machine is not solved, or beyond its limit torque.

    Args:
        machines: N machines over one flux map.
        loci: Their loci.
        torque: Torques of any sign in N m, shape (P, N).
    """
    target = np.broadcast_to(np.abs(torque), (np.shape(torque)[0], machines.count))
    i_d, i_q = _between_points(loci, target)
    factor = 1.5 * machines.pole_pairs
    for _ in range(_TORQUE_STEPS):
        jet = machines.jet(i_d, i_q)
        by_d = jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q
        by_q = jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d
        by_dd = jet.d_dd * i_q - jet.q_dd * i_d - 2.0 * jet.l_qd
        by_dq = jet.l_dd + jet.d_dq * i_q - jet.q_dq * i_d - jet.l_qq
        by_qq = 2.0 * jet.l_dq + jet.d_qq * i_q - jet.q_qq * i_d
        # Torque as asked for, and gradients of torque and |i|^2 in parallel.
        missing = target / factor - (jet.psi_d * i_q - jet.psi_q * i_d)
        askew = i_d * by_q - i_q * by_d
        askew_d = by_q + i_d * by_dq - i_q * by_dd
        askew_q = i_d * by_qq - by_d - i_q * by_dq
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (by_d * askew_q - by_q * askew_d)
            step_d = (missing * askew_q + by_q * askew) * scale
            step_q = (-by_d * askew - missing * askew_d) * scale
        i_d = i_d + np.where(target > 0.0, step_d, 0.0)
        i_q = i_q + np.where(target > 0.0, step_q, 0.0)
    found = np.abs(machines.torque(i_d, i_q) - target) <= _TORQUE_ROUNDING * loci.torque[-1]
    found &= loci.solved & (target <= loci.torque[-1] * (1.0 + 1e-12))
    return np.where(found, i_d, np.nan), np.where(found, np.copysign(i_q, torque), np.nan)


def _between_points(loci: ScaledLoci, torque: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Currents between the points of the loci next to torques >= 0 in N m, shape (P, N).

    Below the first point the current follows a power of the torque: 1 with a magnet, 1/2 without.
    """
    above = np.zeros(torque.shape, dtype=np.intp)
    for row in loci.torque[:-1]:
        above += torque > row
    low, high = np.maximum(above - 1, 0), np.maximum(above, 1)

    def at(
        values: FloatArray, places: np.ndarray[tuple[int, ...], np.dtype[np.intp]]
    ) -> FloatArray:
        return np.asarray(np.take_along_axis(values, places, axis=0))

    first, second = loci.torque[0], loci.torque[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (torque - at(loci.torque, low)) / (at(loci.torque, high) - at(loci.torque, low))
        linear = np.log(second / first) < 1.5 * np.log(loci.current[1] / loci.current[0])
        start = torque / first
        start = np.where(linear, start, np.sqrt(start))
    is_start = above == 0
    found = [
        np.where(
            is_start,
            start * part[0],
            at(part, low) + share * (at(part, high) - at(part, low)),
        )
        for part in (loci.i_d, loci.i_q)
    ]
    return found[0], found[1]


# What an output depends on, from the rows of a draw as they are: first-order sensitivities by the
# means over bins of each input, and squared correlations beside them.
#
# The first-order sensitivity of Y to X_i is Var(E[Y | X_i]) / Var(Y) (Saltelli and others 2008,
# section 1.2.6). With B bins of X_i and N rows the variance of the bins' means is that of the
# conditional mean, and a share (B - 1)/N of the rest by chance alone. That is taken off,
#
#     S_i = (N - 1)/(N - B) (V_i/V - (B - 1)/(N - 1)),
#
# as the adjusted correlation ratio does (Kelley 1935, doi:10.1073/pnas.21.9.554): an input without
# influence has zero on average, and may come out a little below it.

BINS = 50  # Bins of each input.


@dataclass(frozen=True, slots=True, eq=False)
class BinnedOutput:
    """Sums of an output over the bins of D inputs; more rows are added by `plus`.

    Args:
        edges: Inner edges of the bins of each input, shape (D, B - 1), ascending.
        centre: A value of the output from which it is counted, and of each input, shape (1 + D,):
            sums of squares would cancel otherwise.
        counts, sums: Rows, and sum of the output, in each bin, shape (D, B).
        moments: Sums of products of the output and the inputs, shape (1 + D, 1 + D), and their own
            sums, shape (1 + D,), as the last row.
    """

    edges: FloatArray
    centre: FloatArray
    counts: FloatArray
    sums: FloatArray
    moments: FloatArray

    @property
    def rows(self) -> int:
        """Number of rows."""
        return round(float(np.sum(self.counts[0])))

    def plus(self, inputs: FloatArray, output: FloatArray) -> BinnedOutput:
        """With further rows, inputs (n, D) and output (n,); rows with what is no finite number
        count nowhere. Sums go on in the order of the calls, so that the same parts in the same
        order give the same digits.
        """
        known = np.isfinite(output) & np.all(np.isfinite(inputs), axis=1)
        shifted = np.column_stack([output[known], inputs[known]]) - self.centre
        counts, sums = self.counts.copy(), self.sums.copy()
        bins = counts.shape[1]
        for place, edges in enumerate(self.edges):
            which = np.searchsorted(edges, inputs[known, place], side="right")
            counts[place] += np.bincount(which, minlength=bins)
            sums[place] += np.bincount(which, weights=shifted[:, 0], minlength=bins)
        added = np.vstack([shifted.T @ shifted, np.sum(shifted, axis=0)])
        return BinnedOutput(self.edges, self.centre, counts, sums, self.moments + added)


def binned_output(inputs: FloatArray, output: FloatArray, bins: int = BINS) -> BinnedOutput:
    """Bins for an output, empty, with edges that hold equally many of the rows given.

    Args:
        inputs: Inputs of the first rows of the study, shape (n, D).
        output: Output of the same rows, shape (n,).
        bins: Number of bins B, fewer where there are fewer rows.
    """
    count = max(min(bins, inputs.shape[0] // 4), 1)
    shares = np.arange(1, count) / count
    edges = np.quantile(inputs, shares, axis=0).T if count > 1 else np.empty((inputs.shape[1], 0))
    whole = np.column_stack([output, inputs])
    finite = np.where(np.isfinite(whole), whole, 0.0)
    width = whole.shape[1]
    return BinnedOutput(
        edges=np.ascontiguousarray(edges),
        centre=np.mean(finite, axis=0) if len(whole) else np.zeros(width),
        counts=np.zeros((inputs.shape[1], count)),
        sums=np.zeros((inputs.shape[1], count)),
        moments=np.zeros((width + 1, width)),
    )


@dataclass(frozen=True, slots=True)
class Sensitivities:
    """What an output depends on, arrays of shape (D,) in the order of ``inputs``.

    Args:
        output, inputs: Names.
        rows: Rows that they come from.
        first: First-order sensitivities; NaN of an output that does not change.
        squared_correlation: Squares of the correlations: the same where the output is a straight
            line in the input.
        bias: What was taken off the plain quotient of variances of an input without influence.
        total: Total sensitivities, with all that an input does together with others; None from a
            draw that was not made for them.
    """

    output: str
    inputs: tuple[str, ...]
    rows: int
    first: FloatArray
    squared_correlation: FloatArray
    bias: float
    total: FloatArray | None = None

    def designed(self, first: FloatArray, total: FloatArray) -> Sensitivities:
        """With the sensitivities of a design that was made for them in place of those by bins."""
        return replace(self, first=first, total=total, bias=0.0)


def sensitivities(output: str, inputs: Sequence[str], found: BinnedOutput) -> Sensitivities:
    """Sensitivities of an output to inputs that were drawn independently of each other.

    Args:
        output, inputs: Names of the output and of the D inputs.
        found: The output over their bins.
    """
    rows, width = found.rows, found.moments.shape[1]
    unknown = np.full(width - 1, np.nan)
    filled = np.count_nonzero(found.counts, axis=1)
    if rows <= int(np.max(filled, initial=0)) + 1:
        return Sensitivities(output, tuple(inputs), rows, unknown, unknown, float("nan"))
    mean = found.moments[-1] / rows
    covariance = found.moments[:-1] / rows - np.outer(mean, mean)
    spread = np.diag(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        squared = covariance[0, 1:] ** 2 / (spread[0] * spread[1:])
        means = np.where(found.counts > 0.0, found.sums / found.counts, 0.0)
        between = np.sum(found.counts * (means - mean[0]) ** 2 * (found.counts > 0), axis=1) / rows
        plain = between / spread[0]
        first = (rows - 1) / (rows - filled) * (plain - (filled - 1) / (rows - 1))
    flat = not spread[0] > 1e-28 * (found.centre[0] ** 2 + spread[0])
    return Sensitivities(
        output,
        tuple(inputs),
        rows,
        unknown if flat else first,
        unknown if flat else squared,
        (int(np.max(filled)) - 1) / (rows - 1),
    )
