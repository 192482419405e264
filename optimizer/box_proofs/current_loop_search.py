"""Finds a Lyapunov matrix for every cell of a box of drives, or a drive that is unstable.

All in doubles: what is found here is a proposal, which the checker confirms in balls before anybody
states it.
"""

from __future__ import annotations

import itertools

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
from dqforge.optimizer.box_proofs.contraction import (
    Contraction,
    common_lyapunov,
    contracts,
    lyapunov_frame,
)
from dqforge.optimizer.box_proofs.current_loop_model import (
    BoxDrive,
    CurrentLoopBox,
    corner_points,
    drive_at,
    largest_moduli,
    loop_matrices,
    parameters_of,
    remainder,
    root_cell,
    shrunk,
    slopes,
)
from dqforge.optimizer.box_proofs.interior_point import Budget

CELLS = 500  # Cells that are looked at before the rest is left open.

# Work of both proofs of both current loops of a design, in steps of the interior point: near the
# border of stability two to three seconds of a processor core.
WORK = 4500
CELL_WORK = 5  # What looking at a cell, and checking it in balls, counts.
_NARROWEST = 1e-6  # Relative width below which a cell is not cut again.
_SPEEDS = 5
_DIGITS = 12  # Significant digits of a matrix that is kept.


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLoopSearch:
    """What a search found: the tree below the cell of all drives, and the drive that is unstable,
    None where none was met.
    """

    root: Cell
    tree: Tree[FloatArray]
    counterexample: BoxDrive | None

    @property
    def complete(self) -> bool:
        """Whether a matrix was found for every cell."""
        return self.tree.complete


def find_certificate(
    box: CurrentLoopBox, largest: int = CELLS, budget: Budget | None = None
) -> CurrentLoopSearch:
    """Cut a box of drives into cells that one matrix each proves.

    Args:
        box: Control and drives.
        largest: How many cells are looked at.
        budget: Work that may be done, which is taken from it.
    """
    root = root_cell(box)
    left = Budget(WORK) if budget is None else budget
    outside = unstable_corner(box)
    if outside is not None:
        tree: Tree[FloatArray] = Tree(counterexample=parameters_of(box, outside))
        return CurrentLoopSearch(root, tree, outside)
    full = np.maximum(root.width, 1e-300)

    def examine(cell: Cell) -> Verdict[FloatArray]:
        left.take(CELL_WORK)
        return _verdict(box, cell, full, left)

    def urgency(cell: Cell) -> float:
        return float(largest_moduli(loop_matrices(box, cell.middle[None]))[0])

    tree = search(root, examine, urgency, largest, lambda: left.left > 0)
    point = tree.counterexample
    return CurrentLoopSearch(root, tree, None if point is None else drive_at(box, point))


def unstable_corner(box: CurrentLoopBox) -> BoxDrive | None:
    """The most unstable corner of the drives themselves at five speeds; None where all are
    stable.
    """
    ends = (box.r_s, box.dead_time, box.l_d, box.l_q, box.gain)
    speeds = np.linspace(0.0, box.omega_e, _SPEEDS)
    drives = [
        BoxDrive(r_s + dead_time * gain, l_d, l_q, gain, float(omega))
        for r_s, dead_time, l_d, l_q, gain in itertools.product(
            *(dict.fromkeys(pair) for pair in ends)
        )
        for omega in dict.fromkeys(speeds)
    ]
    points = np.array([parameters_of(box, drive) for drive in drives])
    moduli = largest_moduli(loop_matrices(box, points))
    worst = int(np.argmax(moduli))
    return drives[worst] if moduli[worst] >= 1.0 else None


def _verdict(
    box: CurrentLoopBox, cell: Cell, full: FloatArray, budget: Budget
) -> Verdict[FloatArray]:
    """What one cell is."""
    inside = shrunk(box, cell)
    if inside is None:
        return Empty()
    points = corner_points(inside)
    matrices = loop_matrices(box, np.vstack([points, inside.middle]))
    corners, middle = matrices[:-1], matrices[-1]
    moduli = largest_moduli(matrices)
    unstable = _refuted(box, np.vstack([points, inside.middle]), moduli)
    if unstable is not None:
        return Refuted(unstable)
    frame = lyapunov_frame(middle) if moduli[-1] < 1.0 else None
    by_remainder = False
    if frame is not None and moduli.max() < 1.0:
        found, by_remainder = _matrix(box, inside, corners, frame, budget)
        if found is not None:
            return Proven(found)
    relative = inside.width / full
    if np.max(relative) < _NARROWEST:
        return Open(inside)
    reach = slopes(box, inside) if by_remainder else reach_of(box, inside, frame)
    axis = int(np.argmax(inside.width * reach * (relative > 0.5 * _NARROWEST)))
    return Cut(axis, float(inside.middle[axis]), inside)


def _refuted(box: CurrentLoopBox, points: FloatArray, moduli: FloatArray) -> FloatArray | None:
    """The worst of points that is unstable and belongs to a drive."""
    for row in np.argsort(-moduli):
        if moduli[row] < 1.0:
            return None
        drive = drive_at(box, points[row])
        if drive is None:
            continue
        point = parameters_of(box, drive)
        if largest_moduli(loop_matrices(box, point[None]))[0] >= 1.0:
            return point
    return None


def _matrix(
    box: CurrentLoopBox, cell: Cell, corners: FloatArray, frame: FloatArray, budget: Budget
) -> tuple[FloatArray | None, bool]:
    """A matrix for the cell, or None and whether the remainder alone is in its way."""
    rest = remainder(box, cell)
    own = rounded(frame.T @ frame)
    if contracts(own, own, corners, rest).whole:
        return own, False
    seen = [Contraction(corners=False, whole=False)]

    def taken(matrix: FloatArray) -> bool:
        digits = rounded(matrix)
        seen.append(contracts(digits, digits, corners, rest))
        return seen[-1].whole

    found = common_lyapunov(corners, frame, taken, budget)
    return rounded(found) if found is not None and seen[-1].whole else None, seen[-1].corners


def rounded(matrix: FloatArray, *, scaled: bool = True) -> FloatArray:
    """A matrix of few digits, symmetric to the bit; ``scaled`` with its largest entry near 1."""
    whole = matrix / 2.0 ** np.floor(np.log2(np.abs(matrix).max())) if scaled else matrix
    upper = np.triu(np.array([[float(f"{x:.{_DIGITS}g}") for x in row] for row in whole]))
    return np.asarray(upper + np.triu(upper, 1).T, dtype=np.float64)


def reach_of(box: CurrentLoopBox, cell: Cell, frame: FloatArray | None) -> FloatArray:
    """How far the loop changes with each parameter, per its width, shape (4,)."""
    middle = cell.middle
    ends = np.repeat(middle[None], 8, axis=0)
    for axis in range(4):
        ends[2 * axis, axis], ends[2 * axis + 1, axis] = cell.high[axis], cell.low[axis]
    matrices = loop_matrices(box, ends)
    changes = matrices[::2] - matrices[1::2]
    if frame is not None:
        changes = frame @ changes @ np.linalg.inv(frame)
    sizes = np.linalg.norm(changes, 2, axis=(1, 2))
    return np.asarray(sizes / np.maximum(cell.width, 1e-300), dtype=np.float64)
