"""The sensitivity of both current loops together over a box of drives: found, and bounded.

S is the map from a disturbance of both voltages (d, q) to the voltages that the loops then ask for.
Its largest singular value over all frequencies, M, bounds what the loops bear at once in both axes:
turned by any constant angle up to 2 asin(1/(2 M)), the voltages still make stable loops. The values
of M_s axis by axis say nothing of that, and above some 0.1 rad of turn per sample they are far too
small.

M bounds S over a cell if one P > 0 has, at every corner and with what they leave out,

    [A B; C 1]^T diag(P, 1) [A B; C 1]  <  diag(P, M^2 1),      B: into v,   C: the rows of v in A
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import cache

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.cell_queue import (
    CELL_WORK,
    BoxDrive,
    Cell,
    Contraction,
    CurrentLoopBox,
    Cut,
    Empty,
    Open,
    Proven,
    Tree,
    Verdict,
    contracts,
    corner_points,
    drive_at,
    largest_moduli,
    loop_matrices,
    lyapunov_frame,
    parameters_of,
    reach_of,
    remainder,
    root_cell,
    rounded,
    search,
    shrunk,
    slopes,
)
from dqforge.optimizer.certificates.matrix_inequalities import Blocks, Budget, climb

CELLS = 120
MOST_WORK = 2500  # Part of `WORK` that the bound may take.
_OVER = 1.097  # Bound that is asked for, over the largest value found.
_SPEEDS = 5

# Frequencies in rad per sample at which values are found.
_FREQUENCIES = np.concatenate([np.geomspace(1e-3, 0.1, 20), np.linspace(0.1, np.pi, 80)[1:]])
_SCALES = 4.0 ** np.arange(-6, 10)


@dataclass(frozen=True, slots=True, eq=False)
class SensitivitySearch:
    """Sensitivity of both axes together over a box.

    ``found`` is the largest value met and ``at`` the drive that has it, ``bound`` what no drive
    exceeds (inf where the search ended before), ``tree`` the cells that prove it.
    """

    root: Cell
    found: float
    at: BoxDrive
    bound: float
    tree: Tree[FloatArray]


def sensitivities(box: CurrentLoopBox, points: FloatArray) -> FloatArray:
    """Largest singular value of S over a grid of frequencies and about its peak, shape (N,).

    Args:
        box: The control.
        points: b_d, b_q, s and x of stable loops, shape (N, 4).
    """
    matrices = loop_matrices(box, points)
    resonances = np.abs(np.angle(np.linalg.eigvals(matrices)))
    grid = np.broadcast_to(_FREQUENCIES, (len(points), _FREQUENCIES.size))
    frequencies = np.sort(np.concatenate([grid, resonances], axis=1), axis=1)
    values = _largest_values(matrices, frequencies)
    rows, best = np.arange(len(points)), values.max(axis=1)
    for _ in range(2):
        peak = np.argmax(values, axis=1)
        low = frequencies[rows, np.maximum(peak - 1, 0)]
        high = frequencies[rows, np.minimum(peak + 1, frequencies.shape[1] - 1)]
        frequencies = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 9)
        values = _largest_values(matrices, frequencies)
        best = np.maximum(best, values.max(axis=1))
    return np.asarray(best, dtype=np.float64)


def _largest_values(matrices: FloatArray, frequencies: FloatArray) -> FloatArray:
    """Largest singular values of S of N loops at F frequencies in rad per sample each, shape
    (N, F).
    """
    inner = np.exp(1j * frequencies)[:, :, None, None] * np.eye(6) - matrices[:, None]
    into = np.zeros((1, 1, 6, 2), dtype=np.complex128)
    into[..., 2, 0] = into[..., 3, 1] = 1.0
    answer = np.linalg.solve(inner, np.broadcast_to(into, (*inner.shape[:2], 6, 2)))
    whole = matrices[:, None, 2:4, :] @ answer + np.eye(2)
    # largest singular value of a 2x2 matrix: from its norm and its determinant
    square = (np.abs(whole) ** 2).sum(axis=(2, 3))
    determinant = np.abs(np.linalg.det(whole)) ** 2
    root = np.sqrt(np.maximum(square**2 - 4.0 * determinant, 0.0))
    return np.asarray(np.sqrt(0.5 * (square + root)), dtype=np.float64)


def extended(closed: FloatArray) -> FloatArray:
    """[A B; C 1] of closed loops, shape (N, 8, 8)."""
    whole = np.zeros((len(closed), 8, 8))
    whole[:, :6, :6] = closed
    whole[:, 2, 6] = whole[:, 3, 7] = whole[:, 6, 6] = whole[:, 7, 7] = 1.0
    whole[:, 6:, :6] = closed[:, 2:4]
    return whole


def bound_sensitivity(
    box: CurrentLoopBox, largest: int = CELLS, work: int = MOST_WORK
) -> SensitivitySearch:
    """The largest sensitivity that is found in a box, and a bound within 10 % of it.

    Args:
        box: Control and drives, all of them stable.
        largest: How many cells are looked at.
        work: Work that may be done.
    """
    left = Budget(work)
    known = _Known(box, left)
    root = root_cell(box)

    def urgency(cell: Cell) -> float:
        return float(sensitivities(box, cell.middle[None])[0]) if _stable(box, cell) else np.inf

    tree = search(root, known.verdict, urgency, largest, lambda: left.left > 0)
    bound = known.asked if tree.complete else np.inf
    return SensitivitySearch(root, known.found, known.at, bound, tree)


def _stable(box: CurrentLoopBox, cell: Cell) -> bool:
    return bool(largest_moduli(loop_matrices(box, cell.middle[None]))[0] < 1.0)


class _Known:
    """The largest value met so far, and what it makes of a cell."""

    def __init__(self, box: CurrentLoopBox, budget: Budget) -> None:
        self._box, self._budget = box, budget
        self._full = np.maximum(root_cell(box).width, 1e-300)
        ends = (box.r_s, box.dead_time, box.l_d, box.l_q, box.gain)
        drives = [
            BoxDrive(r_s + dead_time * gain, l_d, l_q, gain, float(omega))
            for r_s, dead_time, l_d, l_q, gain in itertools.product(
                *(dict.fromkeys(pair) for pair in ends)
            )
            for omega in dict.fromkeys(np.linspace(0.0, box.omega_e, _SPEEDS))
        ]
        self.found, self.at, self.asked = 0.0, drives[0], 0.0
        self._meet(drives)

    def _meet(self, drives: list[BoxDrive]) -> None:
        values = sensitivities(self._box, np.array([parameters_of(self._box, d) for d in drives]))
        worst = int(np.argmax(values))
        if values[worst] > self.found:
            self.found, self.at = float(values[worst]), drives[worst]
            self.asked = float(f"{_OVER * self.found:.4g}")

    def verdict(self, cell: Cell) -> Verdict[FloatArray]:
        """Proven by a matrix for what is asked now, cut otherwise."""
        self._budget.take(CELL_WORK)
        inside = shrunk(self._box, cell)
        if inside is None:
            return Empty()
        points = corner_points(inside)
        matrices = loop_matrices(self._box, np.vstack([points, inside.middle]))
        stable = largest_moduli(matrices) < 1.0
        frame = lyapunov_frame(matrices[-1]) if stable[-1] else None
        seen = Contraction(corners=False, whole=False)
        if frame is not None and stable.all():
            drives = [drive_at(self._box, point) for point in points]
            self._meet([drive for drive in drives if drive is not None] or [self.at])
            found, seen = self._matrix(inside, matrices[:-1], frame)
            if found is not None:
                return Proven(found)
        relative = inside.width / self._full
        if np.max(relative) < 1e-5:
            return Open(inside)
        reach = slopes(self._box, inside) if seen.corners else reach_of(self._box, inside, frame)
        axis = int(np.argmax(inside.width * reach))
        return Cut(axis, float(inside.middle[axis]), inside)

    def _matrix(
        self, cell: Cell, corners: FloatArray, frame: FloatArray
    ) -> tuple[FloatArray | None, Contraction]:
        rest, whole = remainder(self._box, cell), extended(corners)
        kept: list[FloatArray] = []
        seen = [Contraction(corners=False, whole=False)]

        def taken(matrix: FloatArray) -> bool:
            digits = rounded(matrix, scaled=False)
            before, after = bordered(digits, self.asked**2), bordered(digits, 1.0)
            seen.append(contracts(before, after, whole, rest))
            kept.append(digits)
            return seen[-1].whole

        _bounded_real(whole, frame, self.asked**2, taken, self._budget)
        return (kept[-1] if seen[-1].whole else None), seen[-1]


def bordered(matrix: FloatArray, value: float) -> FloatArray:
    """diag(P, value, value)."""
    whole = value * np.eye(len(matrix) + 2)
    whole[: len(matrix), : len(matrix)] = matrix
    return whole


def _bounded_real(
    whole: FloatArray,
    frame: FloatArray,
    square: float,
    taken: Callable[[FloatArray], bool],
    budget: Budget,
) -> None:
    """Proposes matrices P that bound the sensitivity at all corners until one is taken.

    Climbs with t in diag(P, M^2 1) - Z^T diag(P, 1) Z >= t diag(Q, 1), all in the frame.

    Args:
        whole: Z = [A B; C 1] of the corners, shape (V, 8, 8).
        frame: T of the loop in the middle, shape (6, 6).
        square: M^2.
        taken: Whether a proposal serves.
        budget: Steps that may be taken.
    """
    turn, back = bordered(frame, 1.0), np.linalg.inv(bordered(frame, 1.0))
    seen = turn @ whole @ back
    turned = np.swapaxes(seen, 1, 2)
    parts, ends = _parts(), bordered(np.zeros((6, 6)), 1.0)
    slopes_of = np.empty((len(whole), len(parts) + 1, 8, 8))
    slopes_of[:, :-1] = parts - turned[:, None] @ parts @ seen[:, None]
    slopes_of[:, -1] = -back.T @ back
    blocks = Blocks(square * ends - turned @ ends @ seen, slopes_of)
    start = _best_start(blocks, turn)

    def serves(unknowns: FloatArray) -> bool:
        if unknowns[-1] <= 0.0:
            return False
        inner = np.einsum("n,nij->ij", unknowns[:-1], parts[:, :6, :6])
        matrix = frame.T @ inner @ frame
        return taken(0.5 * (matrix + matrix.T))

    climb(blocks, start, serves, hopeless=1e-7, budget=budget)


def _best_start(blocks: Blocks, turn: FloatArray) -> FloatArray:
    """The multiple of P = 1 that is nearest to serving, with a t below what it has."""
    unit = np.concatenate([np.trace(_parts(), axis1=1, axis2=2), [0.0]])
    trials = [blocks.at(scale * unit) for scale in _SCALES]
    least = [float(np.linalg.eigvalsh(turn.T @ trial @ turn).min()) for trial in trials]
    best = int(np.argmax(least))
    start = _SCALES[best] * unit
    start[-1] = least[best] - 0.3 * abs(least[best]) - 0.05
    return np.asarray(start, dtype=np.float64)


@cache
def _parts() -> FloatArray:
    """A basis of diag(P, 0, 0), shape (21, 8, 8)."""
    parts = np.zeros((21, 8, 8))
    for place, (column, row) in enumerate(zip(*np.tril_indices(6), strict=True)):
        parts[place, row, column] = parts[place, column, row] = 1.0
    return parts
