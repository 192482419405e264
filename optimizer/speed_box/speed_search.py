"""A cyclic certificate per cell: P_0 .. P_m, one for each current sample between two of the speed.

    U^T P_1 U < P_0,      A_v^T P_(k+1) A_v < P_k   for k = 1 .. m,   P_(m+1) = P_0

at the corners A_v of the cell and with what they leave out. The power of the inner step is never
formed, since nothing is multi-affine behind it; what is proven so permits the drive to change
within a cell at every current sample.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.box_proofs.cell_queue import (
    Cell,
    Cut,
    Empty,
    Open,
    Proven,
    Refuted,
    Tree,
    Verdict,
    search,
)
from dqforge.optimizer.box_proofs.contraction import Contraction
from dqforge.optimizer.box_proofs.matrix_inequalities import chained_matrices
from dqforge.optimizer.speed_box.cycle_contraction import step_contracts
from dqforge.optimizer.speed_box.speed_loop_steps import SpeedLoopNumbers, cell_corners
from dqforge.optimizer.speed_box.speed_parameters import SpeedBox

Chain = tuple[FloatArray, ...]  # P_0 without the torque command, P_1 .. P_m with it.
_SMALLEST = 1e-6  # Share of the box below which a cell is not cut any more.


@dataclass(frozen=True, slots=True)
class Effort:
    """``cells`` at most are looked at; below ``remainder`` a cell is worth an inequality."""

    cells: int
    remainder: float = 1e-2


@dataclass(frozen=True, slots=True)
class _Links:
    """Steps of a cycle: numbers of the matrices before and after, and the corners of the step."""

    update: FloatArray
    steps: FloatArray
    ratio: int

    def every(self) -> list[tuple[int, int, FloatArray]]:
        """The update, the steps between, and the last one, which drops the torque command."""
        keep = np.delete(np.arange(self.steps.shape[1]), self.steps.shape[1] - 2)
        inner = [(k, k + 1, self.steps) for k in range(1, self.ratio)]
        return [(0, 1, self.update), *inner, (self.ratio, 0, self.steps[:, keep])]


@dataclass(frozen=True, slots=True)
class SpeedSearch:
    """The search over one box."""

    loop: SpeedLoopNumbers
    box: SpeedBox
    effort: Effort

    def run(self) -> Tree[Chain]:
        """Cut the box until all of it is proven, a drive refutes it, or the effort is spent."""
        return search(self.box.root(), self._examined, self._urgency, self.effort.cells)

    def _urgency(self, cell: Cell) -> float:
        return float(self._radius(cell.middle))

    def _radius(self, parameters: FloatArray) -> float:
        step = self.loop.steps(parameters[np.newaxis])[0]
        return float(np.max(np.abs(np.linalg.eigvals(self.loop.cycle(step)))))

    def _examined(self, cell: Cell) -> Verdict[Chain]:
        kept = self.box.contracted(cell)
        if kept is None:
            return Empty()
        if self._radius(kept.middle) < 1.0:
            return self._tried(kept)
        point = self.box.drive(kept)
        if point is not None and self._radius(point) >= 1.0:
            return Refuted(point)
        return self._cut(kept, np.max(self.loop.left_out(kept)[:-1], axis=(1, 2)))

    def _tried(self, cell: Cell) -> Verdict[Chain]:
        """The chain of a cell, or where to cut it.

        The corners are asked for one only where what they leave out is small, since an inequality
        costs far more than a cut.
        """
        parts = self.loop.left_out(cell)
        whole = np.sum(parts, axis=0)
        frames = self._frames(cell) if np.max(whole) <= self.effort.remainder else None
        if frames is None:
            return self._cut(cell, np.max(parts[:-1], axis=(1, 2)))
        steps = self.loop.steps(cell_corners(cell))
        links = _Links(self.loop.update()[np.newaxis], steps, self.loop.ratio)
        found = Contraction(corners=False, whole=False)
        for proposal in (_of_middle, _proposed):
            chain = proposal(links, frames)
            found = found if chain is None else _falls(chain, links, whole)
            if chain is not None and found.whole:
                return Proven(chain)
        if found.corners:
            return self._cut(cell, _weighed(parts[:-1], frames[1]))
        return self._cut(cell, self._reach(cell, frames))

    def _cut(self, cell: Cell, sizes: FloatArray) -> Verdict[Chain]:
        root = self.box.root()
        relative = cell.width / np.where(root.width > 0.0, root.width, 1.0)
        if float(np.max(relative)) < _SMALLEST:
            return Open(cell)
        axis = int(np.argmax(np.where(cell.width > 0.0, sizes, -1.0)))
        return Cut(axis, float(cell.middle[axis]), cell)

    def _frames(self, cell: Cell) -> list[FloatArray] | None:
        """T_k of the loop in the middle, P_k = T_k^T T_k falling by 1 at every step."""
        step = self.loop.steps(cell.middle[np.newaxis])[0]
        links = _Links(self.loop.update()[np.newaxis], step[np.newaxis], self.loop.ratio).every()
        whole = np.eye(self.loop.size - 1)
        weight = np.zeros_like(whole)
        for _, _, closed in links:
            weight += whole.T @ whole
            whole = closed[0] @ whole
        try:
            first = _summed(whole, weight)
            matrices = [0.5 * (first + first.T)]
            for _, _, closed in reversed(links[1:]):
                back = closed[0].T @ matrices[-1] @ closed[0]
                matrices.append(back + np.eye(len(back)))
            ordered = [matrices[0], *reversed(matrices[1:])]
            return [np.linalg.cholesky(matrix).T for matrix in ordered]
        except np.linalg.LinAlgError:
            return None

    def _reach(self, cell: Cell, frames: list[FloatArray]) -> FloatArray:
        """How far each parameter moves a whole cycle, in the frame of the middle."""
        found, back = [], np.linalg.inv(frames[0])
        for axis in range(len(cell.low)):
            ends = np.stack([cell.middle, cell.middle])
            ends[0, axis], ends[1, axis] = cell.low[axis], cell.high[axis]
            low, high = (self.loop.cycle(step) for step in self.loop.steps(ends))
            found.append(np.linalg.norm(frames[0] @ (high - low) @ back, 2))
        return np.array(found)


def _summed(closed: FloatArray, weight: FloatArray) -> FloatArray:
    """Sum of A^T^k W A^k over all k: twice as many terms at every turn, while A^k is not small.

    Raises:
        LinAlgError: A is not stable enough for that.
    """
    total = weight
    for _ in range(40):
        total = total + closed.T @ total @ closed
        closed = closed @ closed
        if np.linalg.norm(closed) < 1e-12:
            return total
    raise np.linalg.LinAlgError


def _weighed(parts: FloatArray, frame: FloatArray) -> FloatArray:
    """What each parameter leaves out, in the frame of the middle."""
    _, rows, columns = parts.shape
    heights = np.linalg.norm(frame[:, :rows], axis=0)
    widths = np.linalg.norm(np.linalg.inv(frame)[:columns], axis=1)
    return np.asarray(np.einsum("prc,r,c->p", parts, heights, widths), dtype=np.float64)


def _falls(chain: Chain, links: _Links, left_out: FloatArray) -> Contraction:
    """Whether x^T P x falls at every step of the cycle; the update itself leaves nothing out."""
    found = [
        step_contracts(chain[a], chain[b], closed, left_out if a > 0 else 0.0 * left_out)
        for a, b, closed in links.every()
    ]
    return Contraction(all(of.corners for of in found), all(of.whole for of in found))


def _of_middle(_: _Links, frames: list[FloatArray]) -> Chain:
    """The chain of the loop in the middle of the cell, for which nothing needs to be solved."""
    return tuple(frame.T @ frame for frame in frames)


def _proposed(links: _Links, frames: list[FloatArray]) -> Chain | None:
    backs = [np.linalg.inv(frame) for frame in frames]
    turned = [(a, b, frames[b] @ closed @ backs[a]) for a, b, closed in links.every()]
    found = chained_matrices(turned, [back.T @ back for back in backs], count=len(frames))
    if found is None or found.scalar <= 1e-7:
        return None
    pairs = zip(frames, found.matrices, strict=True)
    chain = [frame.T @ matrix @ frame for frame, matrix in pairs]
    return tuple(0.5 * (matrix + matrix.T) for matrix in chain)
