"""A box cut into cells until each is decided, the worst first.

What a cell is, and what proves it, the caller says; here stands the order, the tree of the cuts,
and when to stop.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import field
from functools import lru_cache
from typing import Generic, TypeVar

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.matrix_inequalities import Blocks, Budget, climb

Payload = TypeVar("Payload")


@dataclass(frozen=True, slots=True, eq=False)
class Cell:
    """Least and largest value of every parameter, shape (D,)."""

    low: FloatArray
    high: FloatArray

    @property
    def middle(self) -> FloatArray:
        """The point between both."""
        return np.asarray(0.5 * (self.low + self.high), dtype=np.float64)

    @property
    def width(self) -> FloatArray:
        """How far the cell reaches in every parameter."""
        return np.asarray(self.high - self.low, dtype=np.float64)

    def halves(self, axis: int, value: float) -> tuple[Cell, Cell]:
        """The parts below and above a value of one parameter."""
        high, low = self.high.copy(), self.low.copy()
        high[axis] = low[axis] = value
        return Cell(self.low, high), Cell(low, self.high)


@dataclass(frozen=True, slots=True)
class Empty:
    """No drive of the box lies in the cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Proven(Generic[Payload]):
    """The cell is proven by ``payload``."""

    payload: Payload


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """The cell, shrunk to ``cell`` first, is cut at ``value`` of parameter ``axis``."""

    axis: int
    value: float
    cell: Cell


@dataclass(frozen=True, slots=True, eq=False)
class Refuted:
    """The drive ``point`` of the cell does what none should."""

    point: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Open:
    """Nothing is known of the cell: the search ended before."""

    cell: Cell


Verdict = Empty | Proven[Payload] | Cut | Refuted | Open


@dataclass(slots=True)
class Node(Generic[Payload]):
    """A node of the tree: its verdict and, behind a cut, the nodes below and above it."""

    verdict: Verdict[Payload]
    children: tuple[int, int] | None = None


@dataclass(slots=True)
class Tree(Generic[Payload]):
    """Nodes of a search, the root first, and how many cells were looked at."""

    nodes: list[Node[Payload]] = field(default_factory=list)
    examined: int = 0
    counterexample: FloatArray | None = None

    @property
    def open_cells(self) -> list[Cell]:
        """Cells that were not decided."""
        return [node.verdict.cell for node in self.nodes if isinstance(node.verdict, Open)]

    @property
    def complete(self) -> bool:
        """Whether every cell is decided and none refuted."""
        return self.counterexample is None and not self.open_cells

    def preorder(self) -> list[Verdict[Payload]]:
        """Verdicts in the order cut, all below, all above: the tree without its numbers."""
        found, waiting = [], [0]
        while waiting:
            node = self.nodes[waiting.pop()]
            found.append(node.verdict)
            if node.children is not None:
                waiting += reversed(node.children)
        return found


def search(
    root: Cell,
    examine: Callable[[Cell], Verdict[Payload]],
    urgency: Callable[[Cell], float],
    largest: int,
    more: Callable[[], bool] = lambda: True,
) -> Tree[Payload]:
    """Cut a box until all of it is decided, the most urgent cell first.

    Args:
        root: The box.
        examine: What a cell is: empty, proven, to be cut, refuted (which ends the search), or open.
        urgency: The larger, the sooner a cell is looked at.
        largest: How many cells are looked at; the others stay open.
        more: Whether there is work left for another cell.
    """
    tree: Tree[Payload] = Tree([Node(Open(root))])
    waiting = [(-urgency(root), 0)]
    while waiting and tree.examined < largest and more():
        _, index = heapq.heappop(waiting)
        node = tree.nodes[index]
        assert isinstance(node.verdict, Open)
        node.verdict = examine(node.verdict.cell)
        tree.examined += 1
        if isinstance(node.verdict, Refuted):
            tree.counterexample = node.verdict.point
            break
        if isinstance(node.verdict, Cut):
            halves = node.verdict.cell.halves(node.verdict.axis, node.verdict.value)
            node.children = (len(tree.nodes), len(tree.nodes) + 1)
            for place, half in zip(node.children, halves, strict=True):
                tree.nodes.append(Node(Open(half)))
                heapq.heappush(waiting, (-urgency(half), place))
    return tree


# Both current loops together in four parameters instead of six, and what encloses them.
#
# In flux linkage over voltage gain and sampling period, phi = psi/(g t_s), the loop of a drive with
# R, L_d, L_q, voltage gain g and electrical speed omega depends on
#
#     b_d = g L_d'/L_d,   b_q = g L_q'/L_q,   s = R/g in Ohm,   x = omega t_s
#
# alone (L' in the control's decoupling). Per sample, with rho_a = t_s/L_a' in 1/Ohm,
# p_a = kp_a t_s/L_a' and q_a = ki_a t_s^2/L_a':
#
#     F = [[-s rho_d b_d, x], [-x, -s rho_q b_q]],   W = x [[0, 1], [-1, 0]],   Phi = exp(F)
#     Gam = integral of exp(F (1-u)) exp(W (u - 1/2)) over 0 <= u <= 1     (advance of 1.5 t_s)
#     phi+ = Phi phi + Gam v;   v+ = K phi + I;   I+ = I - diag(q_d b_d, q_q b_q) phi
#     K = [[-(p_d+q_d) b_d, -x b_q], [x b_d, -(p_q+q_q) b_q]]
#
# Magnets and references move no pole, and the other sense of rotation is the same loop seen from
# the other side, so that x >= 0 is enough. What the compensation of the dead time gets wrong acts
# as a resistance that goes with the voltage gain, c g: it widens s by c.
#
# The voltage gain is in three of the parameters: not every cell of them holds a drive.

# Relative width by which cells are shrunk too little, so that rounding loses no drive.
_OUTWARD = 1e-12
_TERMS = 18  # Terms of the exponential series, enough for norms up to 1.


@dataclass(frozen=True, slots=True)
class CurrentLoopBox:
    """All that the proof is about: the control, and the drives that it must serve.

    Args:
        t_s: Sampling period in s; the voltage is turned ahead by 1.5 of it.
        kp, ki_ts: Gains of (d, q), both in V/A.
        decoupling: Inductances (d, q) in H of the control's decoupling.
        r_s: Least and largest resistance in Ohm, not negative.
        dead_time: Least and largest resistance in Ohm that the rest of the dead time adds at a
            voltage gain of 1; it goes with the gain.
        l_d, l_q: Least and largest inductance in H.
        gain: Least and largest gain of the voltage.
        omega_e: Largest electrical speed in rad/s, in either sense.
    """

    t_s: float
    kp: tuple[float, float]
    ki_ts: tuple[float, float]
    decoupling: tuple[float, float]
    r_s: tuple[float, float]
    dead_time: tuple[float, float]
    l_d: tuple[float, float]
    l_q: tuple[float, float]
    gain: tuple[float, float]
    omega_e: float


@dataclass(frozen=True, slots=True)
class BoxDrive:
    """One drive of a box at a speed: Ohm, H, the gain of the voltage, and rad/s.

    ``r_s`` holds what the dead time adds.
    """

    r_s: float
    l_d: float
    l_q: float
    gain: float
    omega_e: float


def root_cell(box: CurrentLoopBox) -> Cell:
    """The smallest cell that holds all drives of a box."""
    (g_low, g_high), (r_low, r_high) = box.gain, box.r_s
    low = [g_low * box.decoupling[0] / box.l_d[1], g_low * box.decoupling[1] / box.l_q[1]]
    high = [g_high * box.decoupling[0] / box.l_d[0], g_high * box.decoupling[1] / box.l_q[0]]
    low += [r_low / g_high + box.dead_time[0], 0.0]
    high += [r_high / g_low + box.dead_time[1], box.omega_e * box.t_s]
    return Cell(np.array(low), np.array(high))


def gain_interval(box: CurrentLoopBox, cell: Cell) -> tuple[float, float]:
    """Voltage gains with which drives may lie in a cell; crossed where none can."""
    low, high = box.gain
    for axis, inductance in ((0, box.l_d), (1, box.l_q)):
        reference = box.decoupling[axis]
        low = max(low, cell.low[axis] * inductance[0] / reference)
        high = min(high, cell.high[axis] * inductance[1] / reference)
    most, least = cell.high[2] - box.dead_time[0], cell.low[2] - box.dead_time[1]
    if most <= 0.0:
        return (low, high) if box.r_s[0] == 0.0 and most == 0.0 else (1.0, 0.0)
    low = max(low, box.r_s[0] / most)
    high = min(high, box.r_s[1] / least) if least > 0.0 else high
    return float(low), float(high)


def shrunk(box: CurrentLoopBox, cell: Cell) -> Cell | None:
    """The part of a cell that holds drives, a hair too large; None where there are none."""
    low, high = gain_interval(box, cell)
    if low > high * (1.0 + _OUTWARD):
        return None
    low, high = low * (1.0 - _OUTWARD), high * (1.0 + _OUTWARD)
    ends = root_cell(
        CurrentLoopBox(
            box.t_s, box.kp, box.ki_ts, box.decoupling, box.r_s, box.dead_time,
            box.l_d, box.l_q, (low, high), box.omega_e,
        )
    )  # fmt: skip
    below, above = np.maximum(cell.low, ends.low), np.minimum(cell.high, ends.high)
    return Cell(below, np.maximum(below, above))


def drive_at(box: CurrentLoopBox, point: FloatArray) -> BoxDrive | None:
    """A drive of the box with given parameters, None where there is none.

    Args:
        box: The drives.
        point: b_d, b_q, s in Ohm and x.
    """
    low, high = gain_interval(box, Cell(point, point))
    if low > high * (1.0 + 1e-9):
        return None
    gain = float(np.clip(0.5 * (low + high), *box.gain))
    l_d = float(np.clip(gain * box.decoupling[0] / point[0], *box.l_d))
    l_q = float(np.clip(gain * box.decoupling[1] / point[1], *box.l_q))
    least, most = (r + c * gain for r, c in zip(box.r_s, box.dead_time, strict=True))
    return BoxDrive(
        float(np.clip(point[2] * gain, least, most)), l_d, l_q, gain, float(point[3]) / box.t_s
    )


def parameters_of(box: CurrentLoopBox, drive: BoxDrive) -> FloatArray:
    """b_d, b_q, s in Ohm and x of a drive, shape (4,)."""
    g = drive.gain
    return np.array(
        [
            g * box.decoupling[0] / drive.l_d,
            g * box.decoupling[1] / drive.l_q,
            drive.r_s / g,
            drive.omega_e * box.t_s,
        ]
    )


def loop_matrices(box: CurrentLoopBox, points: FloatArray) -> FloatArray:
    """Closed loops of (phi_d, phi_q, v_d, v_q, I_d, I_q), shape (N, 6, 6).

    Args:
        box: The control.
        points: b_d, b_q, s in Ohm and x, shape (N, 4).
    """
    b_d, b_q, s, x = np.asarray(points, dtype=np.float64).T
    scale = box.t_s / np.array(box.decoupling)
    q_d, q_q = np.array(box.ki_ts) * scale
    both_d, both_q = (np.array(box.kp) + np.array(box.ki_ts)) * scale
    flow = np.zeros((len(x), 4, 4))
    flow[:, 0, 0], flow[:, 1, 1] = -s * scale[0] * b_d, -s * scale[1] * b_q
    flow[:, 0, 1] = flow[:, 2, 3] = x
    flow[:, 1, 0] = flow[:, 3, 2] = -x
    flow[:, 0, 2] = flow[:, 1, 3] = 1.0
    held = _exponential(flow)
    cosine, sine = np.cos(0.5 * x), np.sin(0.5 * x)
    turned = held[:, :2, 2:]
    matrix = np.zeros((len(x), 6, 6))
    matrix[:, :2, :2] = held[:, :2, :2]
    matrix[:, :2, 2] = turned[:, :, 0] * cosine[:, None] + turned[:, :, 1] * sine[:, None]
    matrix[:, :2, 3] = turned[:, :, 1] * cosine[:, None] - turned[:, :, 0] * sine[:, None]
    matrix[:, 2, 0], matrix[:, 3, 1] = -both_d * b_d, -both_q * b_q
    matrix[:, 2, 1], matrix[:, 3, 0] = -x * b_q, x * b_d
    matrix[:, 2, 4] = matrix[:, 3, 5] = matrix[:, 4, 4] = matrix[:, 5, 5] = 1.0
    matrix[:, 4, 0], matrix[:, 5, 1] = -q_d * b_d, -q_q * b_q
    return matrix


def _exponential(flow: FloatArray) -> FloatArray:
    """Exponentials of matrices, shape (N, n, n), by their series, halved until it converges."""
    largest = float(np.abs(flow).sum(axis=2).max())
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300)))))
    small = flow / 2.0**halvings
    unit = np.eye(flow.shape[1])
    found = unit + small / _TERMS
    for order in range(_TERMS - 1, 0, -1):
        found = unit + small @ found / order
    for _ in range(halvings):
        found = found @ found
    return np.asarray(found, dtype=np.float64)


def corner_points(cell: Cell) -> FloatArray:
    """Corners of a cell, each once, shape (V, D); a parameter that does not vary has one end."""
    ends = [
        (low,) if low == high else (low, high)
        for low, high in zip(cell.low, cell.high, strict=True)
    ]
    return np.array(list(itertools.product(*ends)))


def slopes(box: CurrentLoopBox, cell: Cell) -> FloatArray:
    """Largest size of the derivative of F with each parameter, in the 2-norm, shape (4,)."""
    rho_d, rho_q = box.t_s / box.decoupling[0], box.t_s / box.decoupling[1]
    s = max(abs(cell.low[2]), abs(cell.high[2]))
    return np.array([s * rho_d, s * rho_q, max(rho_d * cell.high[0], rho_q * cell.high[1]), 1.0])


def remainder(box: CurrentLoopBox, cell: Cell) -> Remainder:
    """What the corners of a cell leave out of Phi and Gam.

    Multilinear interpolation errs by at most the sum of w^2/8 times the second derivative in each
    parameter alone; exp(F u) does not grow while no resistance is negative, and by exp(r) where
    one is.
    """
    largest = slopes(box, cell)
    steps = cell.width * largest
    growth = np.exp(max(0.0, -cell.low[2]) * largest[2])
    e_phi = float(growth * np.sum(steps**2) / 8.0)
    e_gam = float(growth * (np.sum(steps[:3] ** 2) / 24.0 + steps[3] ** 2 / 12.0))
    return Remainder((0, 1), (((0, 1), e_phi), ((2, 3), e_gam)))


def largest_moduli(matrices: FloatArray) -> FloatArray:
    """Largest modulus of the eigenvalues of each matrix, shape (N,)."""
    return np.asarray(np.max(np.abs(np.linalg.eigvals(matrices)), axis=1), dtype=np.float64)


# Finds a Lyapunov matrix for every cell of a box of drives, or a drive that is unstable.
#
# All in doubles: what is found here is a proposal, which the checker confirms in balls before
# anybody states it.

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


# Whether P falls along every closed loop of a cell: its corners, and a small rest, in doubles.
#
# Over a cell of parameters a closed loop A is a convex combination of its corners A_v plus U E,
# where U picks the rows that are not multi-affine and E is bounded column group by column group.
# With M_v = P - A_v^T P A_v > 0 and X M_v X^T = 1, every loop of the cell contracts if
#
#     2 |X A_v^T P U| a + |U^T P U| a^2 < 1,     a = sum of e_j |X_j|
#
# at every corner, X_j the columns of X that meet the states of group j. (A -> A^T P A is convex, so
# that the corners stand for everything between.) The same holds for a step from P before to another
# P after.

_SLACK = 1e-5  # What the left-hand side keeps from 1, so that rounding does not decide.


@dataclass(frozen=True, slots=True)
class Remainder:
    """What the corners leave out: ``rows`` of the matrix that err, and by how much.

    ``groups`` are pairs of the columns of a block and the bound of its 2-norm.
    """

    rows: tuple[int, ...]
    groups: tuple[tuple[tuple[int, ...], float], ...]


NOTHING_LEFT = Remainder((), ())


@dataclass(frozen=True, slots=True)
class Contraction:
    """``corners``: whether they alone contract; ``whole``: whether the remainder does too."""

    corners: bool
    whole: bool


def contracts(
    before: FloatArray, after: FloatArray, closed: FloatArray, remainder: Remainder = NOTHING_LEFT
) -> Contraction:
    """Whether x^T P x falls over a step, at the corners and with the remainder.

    Args:
        before, after: P before and after the step, shapes (n, n) and (m, m); the same for one
            common P.
        closed: Corners of the step, shape (V, m, n).
        remainder: What the corners leave out.
    """
    fall = before - np.swapaxes(closed, 1, 2) @ after @ closed
    fall = 0.5 * (fall + np.swapaxes(fall, 1, 2))
    try:
        np.linalg.cholesky(before)
        np.linalg.cholesky(after)
        lower = np.linalg.cholesky(fall)
    except np.linalg.LinAlgError:
        return Contraction(corners=False, whole=False)
    frame = np.linalg.inv(lower)
    if not np.isfinite(frame).all():
        return Contraction(corners=False, whole=False)
    return Contraction(corners=True, whole=_rest_falls(frame, after, closed, remainder))


def _rest_falls(
    frame: FloatArray, after: FloatArray, closed: FloatArray, remainder: Remainder
) -> bool:
    rows = list(remainder.rows)
    reach = np.zeros(len(closed))
    for columns, bound in remainder.groups:
        reach += bound * np.sqrt((frame[:, :, list(columns)] ** 2).sum((1, 2)))
    cross = np.sqrt(((frame @ np.swapaxes(closed, 1, 2) @ after[:, rows]) ** 2).sum((1, 2)))
    own = float(np.sqrt((after[np.ix_(rows, rows)] ** 2).sum()))
    return bool((2.0 * cross * reach + own * reach**2 < 1.0 - _SLACK).all())


def lyapunov_frame(closed: FloatArray) -> FloatArray | None:
    """The frame T in which one stable loop contracts most evenly: P_0 = T^T T with
    A^T P_0 A - P_0 + 1 = 0; None where the loop is not stable enough for a double.

    Args:
        closed: The loop, shape (n, n).
    """
    from scipy.linalg import solve_discrete_lyapunov

    try:
        matrix = solve_discrete_lyapunov(closed.T, np.eye(len(closed)))
        return np.asarray(np.linalg.cholesky(0.5 * (matrix + matrix.T)).T, dtype=np.float64)
    except np.linalg.LinAlgError:
        return None


def common_lyapunov(
    closed: FloatArray,
    frame: FloatArray,
    taken: Callable[[FloatArray], bool] | None = None,
    budget: Budget | None = None,
) -> FloatArray | None:
    """A P that falls along all corners; None where there is none.

    In the frame, asked for is the largest t with P - A_v^T P A_v >= t T^-T T^-1 and a trace of n,
    from P = 1, which is the answer of the loop in the middle (t = 1). Slow integrators would drown
    without the frame.

    Args:
        closed: Corners, shape (V, n, n).
        frame: T of the loop in the middle, shape (n, n).
        taken: Whether a proposal already serves; without it, that with the largest t is returned.
        budget: Steps that may be taken.
    """
    back = np.linalg.inv(frame)
    seen = frame @ closed @ back
    turned = np.swapaxes(seen, 1, 2)
    weight = back.T @ back
    parts = _traceless(len(frame))
    slopes = np.empty((len(closed), len(parts) + 1, *frame.shape))
    slopes[:, :-1] = parts - turned[:, None] @ parts @ seen[:, None]
    slopes[:, -1] = -weight
    blocks = Blocks(np.eye(len(frame)) - turned @ seen, slopes)
    # T^T (P - A^T P A) T against the unit matrix, as the weight is T^-T T^-1
    least = float(np.linalg.eigvalsh(frame.T @ blocks.constant @ frame).min())
    start = np.zeros(len(parts) + 1)
    start[-1] = least - 0.3 * abs(least) - 0.05

    def matrix(unknowns: FloatArray) -> FloatArray:
        inner = np.eye(len(frame)) + np.einsum("n,nij->ij", unknowns[:-1], parts)
        whole = frame.T @ inner @ frame
        return np.asarray(0.5 * (whole + whole.T), dtype=np.float64)

    def serves(unknowns: FloatArray) -> bool:
        return taken is not None and unknowns[-1] > 0.0 and taken(matrix(unknowns))

    found = climb(blocks, start, serves, hopeless=1e-7, budget=budget)
    return None if found is None or found[-1] <= 1e-7 else matrix(found)


@lru_cache(maxsize=8)
def _traceless(size: int) -> FloatArray:
    """A basis of the symmetric matrices without trace, shape (n(n+1)/2 - 1, n, n)."""
    parts = []
    for column in range(size):
        for row in range(column + 1):
            part = np.zeros((size, size))
            part[row, column] = part[column, row] = 1.0
            parts.append(part - np.trace(part) / size * np.eye(size))
    return np.array(parts[:-1])
