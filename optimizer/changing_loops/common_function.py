"""One Lyapunov function for all that a loop may be, or several that follow each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.contraction import common_lyapunov, contracts, lyapunov_frame
from dqforge.optimizer.box_proofs.matrix_inequalities import chained_matrices
from dqforge.optimizer.changing_loops.changing_steps import LoopRange, falls_exactly


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
