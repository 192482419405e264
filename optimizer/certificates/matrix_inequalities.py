"""Small linear matrix inequalities: the largest scalar under few of them, followed along its
central path, and the whole handed to a solver without a modelling language between.

A general solver spends its time on sizes that these problems do not have, and goes on to the
optimum where the first matrix that serves would do. Here every step is a proposal, and the caller
may take it; and where the bound of the path says that no scalar above zero is left, it ends too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.records import dataclass

# First weight of the scalar against the barrier, and its growth once the path is near.
_STEPS = 60
_WEIGHT, _FASTER = 30.0, 6.0
_HEAVIEST = 1e11


@dataclass(slots=True)
class Budget:
    """Work that is left, in steps of the path; counted, not timed, so that the same design gives
    the same bytes.
    """

    left: int

    def take(self, steps: int) -> None:
        """Count work that is done."""
        self.left = max(0, self.left - steps)


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """Inequalities ``constant`` + sum of y_i ``slopes[:, i]`` >= 0.

    Shapes (B, m, m) and (B, N, m, m); the last unknown is the scalar.
    """

    constant: FloatArray
    slopes: FloatArray

    def at(self, unknowns: FloatArray) -> FloatArray:
        """The matrices that must be positive, shape (B, m, m)."""
        found = self.constant + np.einsum("bnij,n->bij", self.slopes, unknowns)
        return np.asarray(found, dtype=np.float64)


def climb(
    blocks: Blocks,
    start: FloatArray,
    taken: Callable[[FloatArray], bool],
    hopeless: float = -np.inf,
    budget: Budget | None = None,
) -> FloatArray | None:
    """Unknowns with the largest last one, or the first that the caller takes.

    Args:
        blocks: What must hold.
        start: Unknowns that satisfy it strictly, shape (N,).
        taken: Whether unknowns already serve; asked at every step.
        hopeless: Where the last unknown cannot exceed this, None is returned.
        budget: Steps that may be taken; with none left None is returned.
    """
    unknowns, weight = start, _WEIGHT
    degree = blocks.constant.shape[0] * blocks.constant.shape[1]
    for _ in range(_STEPS):
        if budget is not None:
            if budget.left == 0:
                return None
            budget.take(1)
        step = _step(blocks, unknowns, weight)
        if step is None:
            return unknowns
        unknowns, decrement = step
        if taken(unknowns):
            return unknowns
        if decrement < 1.0:
            bound = unknowns[-1] + degree * (1.0 + decrement) / weight
            if bound <= hopeless:
                return None
            if weight > _HEAVIEST or degree / weight < 1e-5 * abs(unknowns[-1]):
                return unknowns
            weight *= _FASTER
    return unknowns


def _step(blocks: Blocks, unknowns: FloatArray, weight: float) -> tuple[FloatArray, float] | None:
    """One step towards the path, and how far from it the step began; None where numbers end."""
    try:
        lower = np.linalg.cholesky(blocks.at(unknowns))
        turned = np.swapaxes(np.linalg.inv(lower), 1, 2)
        seen = _seen(blocks.slopes, turned)
        rows = seen.reshape(*seen.shape[:2], -1)
        gradient = -np.trace(seen, axis1=2, axis2=3).sum(0)
        gradient[-1] -= weight
        # block by block: one large product would wake all threads of the library, every step
        curvature = (rows @ np.swapaxes(rows, 1, 2)).sum(axis=0)
        direction = np.linalg.solve(curvature, -gradient)
        change = (direction @ rows).reshape(blocks.constant.shape)
        stretch = np.asarray(np.linalg.eigvalsh(change), dtype=np.float64)
    except np.linalg.LinAlgError:
        return None
    decrement = float(np.sqrt(max(0.0, -gradient @ direction)))
    length = _best_length(stretch, weight * float(direction[-1]))
    found = unknowns + length * direction
    return (found, decrement) if np.isfinite(found).all() else None


def _seen(slopes: FloatArray, turned: FloatArray) -> FloatArray:
    """T^T S T of symmetric slopes, T of each block: two products per block instead of two per
    slope.
    """
    blocks, count, size, _ = slopes.shape
    half = slopes.reshape(blocks, count * size, size) @ turned
    half = np.swapaxes(half.reshape(slopes.shape), 2, 3).reshape(blocks, count * size, size)
    return np.asarray((half @ turned).reshape(slopes.shape), dtype=np.float64)


def _best_length(stretch: FloatArray, gain: float) -> float:
    """The step length that the barrier likes best: the largest gain a + sum of log(1 + a
    stretch).
    """
    most = 0.95 / max(-float(stretch.min()), 1e-12)
    length = min(1.0, most)
    for _ in range(6):
        part = stretch / (1.0 + length * stretch)
        slope, curve = gain + float(part.sum()), -float((part**2).sum())
        length = min(max(length - slope / min(curve, -1e-300), 0.1 * length), most)
    return length


# Small linear matrix inequalities, handed to the solver without a modelling language between.
#
# Unknown are symmetric matrices P_1 .. P_K and one scalar t. An inequality reads
#
#     sum of sign L^T P_k L  +  t T  +  F  >= 0        (not negative as a matrix)
#
# and the largest (or least) t is asked for. That covers a common P for many closed loops, P -
# A_v^T P A_v >= t Q with P <= 1, chains of different ones, P_k - A_v^T P_(k+1) A_v >= t Q, and the
# bounded-real inequality, where t is the square of the gain.
#
# What is returned is a proposal: the caller checks it, so that no status of the solver counts.


@dataclass(frozen=True, slots=True, eq=False)
class Term:
    """``sign`` L^T P L of the unknown number ``unknown``; ``left`` is L, shape (n, m)."""

    unknown: int
    left: FloatArray
    sign: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Inequality:
    """Sum of ``terms`` + t ``slope`` + ``constant`` >= 0, matrices of shape (m, m).

    None stands for a matrix of zeros.
    """

    terms: tuple[Term, ...]
    slope: FloatArray | None = None
    constant: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """The scalar and the matrices that the solver ended with, symmetric to the bit."""

    scalar: float
    matrices: tuple[FloatArray, ...]


@lru_cache(maxsize=32)
def _triangle(size: int) -> tuple[IndexArray, IndexArray]:
    """Rows and columns of the upper triangle, column by column, shape (n(n+1)/2,)."""
    columns, rows = np.tril_indices(size)
    return rows, columns


@lru_cache(maxsize=32)
def _weights(size: int) -> FloatArray:
    """What the entries of the triangle are multiplied by, so that norms stay, shape
    (n(n+1)/2,).
    """
    rows, columns = _triangle(size)
    return np.asarray(np.where(rows == columns, 1.0, np.sqrt(2.0)), dtype=np.float64)


def _vector(matrix: FloatArray) -> FloatArray:
    """A symmetric matrix as the solver's vector."""
    rows, columns = _triangle(len(matrix))
    return np.asarray(matrix[rows, columns] * _weights(len(matrix)), dtype=np.float64)


def _block(left: FloatArray) -> FloatArray:
    """The map from the entries of P to the vector of L^T P L."""
    size, order = left.shape
    i, j = _triangle(size)
    a, b = _triangle(order)
    straight = left[i[None, :], a[:, None]] * left[j[None, :], b[:, None]]
    crossed = left[j[None, :], a[:, None]] * left[i[None, :], b[:, None]]
    both = np.where(i == j, straight, straight + crossed)
    return np.asarray(both * _weights(order)[:, None], dtype=np.float64)


def solve_inequalities(
    inequalities: Sequence[Inequality], sizes: Sequence[int], *, least: bool = False
) -> Proposal | None:
    """The matrices and the largest (``least``: the least) scalar of a set of inequalities.

    None where the solver ends with numbers that are not finite.

    Args:
        inequalities: What must hold.
        sizes: Rows of each unknown matrix.
        least: Whether the least scalar is asked for instead of the largest.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    counts = [size * (size + 1) // 2 for size in sizes]
    starts = np.concatenate([[0], np.cumsum(counts)])
    unknowns = int(starts[-1]) + 1
    rows, right, cones = [], [], []
    for inequality in inequalities:
        order = inequality.terms[0].left.shape[1]
        length = order * (order + 1) // 2
        coefficients = np.zeros((length, unknowns))
        for term in inequality.terms:
            place = slice(starts[term.unknown], starts[term.unknown + 1])
            coefficients[:, place] += term.sign * _block(term.left)
        if inequality.slope is not None:
            coefficients[:, -1] = _vector(inequality.slope)
        rows.append(csc_matrix(-coefficients))
        constant = inequality.constant
        right.append(np.zeros(length) if constant is None else _vector(constant))
        cones.append(clarabel.PSDTriangleConeT(order))
    aim = np.zeros(unknowns)
    aim[-1] = 1.0 if least else -1.0
    found = _solved(csc_matrix((unknowns, unknowns)), aim, _stacked(rows), right, cones)
    if not np.isfinite(found).all():
        return None
    pieces = (found[starts[k] : starts[k + 1]] for k in range(len(sizes)))
    matrices = tuple(_matrix(piece, size) for piece, size in zip(pieces, sizes, strict=True))
    return Proposal(float(found[-1]), matrices)


def _stacked(rows: list[object]) -> object:
    from scipy.sparse import vstack

    return vstack(rows, format="csc")


def _solved(
    square: object, aim: FloatArray, rows: object, right: list[FloatArray], cones: list[object]
) -> FloatArray:
    """The unknowns that the solver ends with."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.direct_solve_method = "qdldl"  # one thread, so that the same input gives the same
    solver = clarabel.DefaultSolver(square, aim, rows, np.concatenate(right), cones, settings)
    return np.asarray(solver.solve().x, dtype=np.float64)


def _matrix(entries: FloatArray, size: int) -> FloatArray:
    rows, columns = _triangle(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = entries
    matrix[columns, rows] = entries
    return matrix


def chained_matrices(
    links: Sequence[tuple[int, int, FloatArray]], weights: Sequence[FloatArray], *, count: int
) -> Proposal | None:
    """P_1 .. P_K <= 1 with the largest t such that P_a - A_v^T P_b A_v >= t Q_a on every link.

    Args:
        links: Numbers a and b of the matrices before and after a step, and the steps A_v between
            them, shape (V, n_b, n_a).
        weights: Q of each matrix, shape (n_k, n_k).
        count: K.
    """
    units = [np.eye(len(weight)) for weight in weights]
    inequalities = [
        Inequality((Term(a, units[a]), Term(b, matrix, -1.0)), slope=-weights[a])
        for a, b, closed in links
        for matrix in closed
    ]
    inequalities += [
        Inequality((Term(k, units[k], -1.0),), constant=units[k]) for k in range(count)
    ]
    return solve_inequalities(inequalities, [len(unit) for unit in units])
