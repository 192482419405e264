"""The largest scalar under few small matrix inequalities, followed along its central path.

A general solver spends its time on sizes that these problems do not have, and goes on to the
optimum where the first matrix that serves would do. Here every step is a proposal, and the caller
may take it; and where the bound of the path says that no scalar above zero is left, it ends too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dqforge.machines.arrays import FloatArray
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
