"""What is proven of a design's speed loop: all of its box, or which share."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import filter_share
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.cell_queue import (
    Cell,
    Contraction,
    Cut,
    Empty,
    Open,
    Proven,
    Refuted,
    Tree,
    Verdict,
    search,
)
from dqforge.optimizer.certificates.matrix_inequalities import chained_matrices
from dqforge.optimizer.loops.loop_gains import LoopGains
from dqforge.optimizer.loops.robustness import DriveBox

_ROUNDED = 1e-12  # Share by which the torque factor, a result of several operations, is widened.

# Inequalities of a search: a cell has one per corner and current sample. Counted, not timed, so
# that the same design gives the same bytes.
_SAMPLES = 20_000
_SEED = 20_261_122
_QUICK, _THOROUGH = 640, 30_000
_LARGEST = 16  # Cells of a quick search at most.


@dataclass(frozen=True, slots=True)
class SpeedProof:
    """What is proven of the speed loop.

    Args:
        share: Share of the box that is proven, 1 where all of it is.
        cells: Cells that were looked at.
        leaves: Cells that the proof consists of.
        ratio: Current samples between two of the speed, each with a matrix of its own in the proof.
        box: The drives, as the loop sees them.
        unstable: Deviations of a drive that is unstable, None where none was found.
        tree: The search, with a chain of matrices per proven cell.
        certificate: The same with control and drives in SI units, as it is stored; None where
            nothing is proven.
    """

    share: float
    cells: int
    leaves: int
    ratio: int
    box: SpeedBox
    unstable: Mapping[str, float] | None
    tree: Tree[Chain]
    certificate: Mapping[str, Any] | None = None

    @property
    def complete(self) -> bool:
        """Whether every drive of the box is proven."""
        return self.tree.complete


def _reach(deviations: FloatArray) -> Interval:
    return 1.0 + float(np.min(deviations)), 1.0 + float(np.max(deviations))


def speed_box(box: DriveBox) -> SpeedBox:
    """The drives that the speed loop depends on.

    Args:
        box: The drive with its tolerances.
    """
    points, design = box.speed_points(), box.design
    factors = box.torque_factor(points)
    wider = np.array([1.0 - _ROUNDED, 1.0 + _ROUNDED])
    torque = wider * (float(np.min(factors)), float(np.max(factors)))
    if np.ptp(factors) == 0.0:
        torque = np.full(2, factors[0])
    masses = _reach(points.of("inertia"))
    # What a dead time adds to R/R' per gain of the voltage, in 1/s at first.
    per_gain = design.inverter.lost_per_dead_time / design.machine.r_s
    dead = _extremes(points.of("dead_time"))
    if dead != (0.0, 0.0):
        per_gain /= box.tolerances.low_current
    flux = design.machine.pole_pairs * design.machine.psi_pm
    emf = _extremes(points.of("psi_pm"))
    return SpeedBox(
        resistance=_reach(points.of("r_s")),
        inductance=_reach(points.of("l_q")),
        gain=_reach(points.of("v_dc")),
        dead_time=(dead[0] * per_gain, dead[1] * per_gain),
        torque=(float(torque[0]), float(torque[1])),
        inertia=(1.0 / masses[1], 1.0 / masses[0]),
        back_emf=(flux * emf[0], flux * emf[1]),
    )


def _extremes(deviations: FloatArray) -> Interval:
    return float(np.min(deviations)), float(np.max(deviations))


def speed_numbers(
    box: DriveBox, drives: SpeedBox, gains: LoopGains, current_gains: LoopGains
) -> SpeedLoopNumbers:
    """The loop without unit.

    Args:
        box: The drive with its tolerances.
        drives: The same as the speed loop sees it.
        gains, current_gains: The speed loop, and the current loop of the q axis.
    """
    machine, control = box.design.machine, box.design.control
    settings, inertia, l_q = control.speed_loop, machine.inertia, box.nominal[1]
    assert settings is not None
    assert inertia is not None
    t_s, constant = control.t_s, machine.torque_per_ampere
    h, eta = gains.kp * t_s / inertia, t_s * constant / (l_q * gains.kp)
    emf = max(abs(side) for side in drives.back_emf) / drives.gain[0]
    scale = speed_scale(h, eta * emf)
    return SpeedLoopNumbers(
        rho=machine.r_s * t_s / l_q,
        h=h / scale,
        p=current_gains.kp * t_s / l_q,
        q=current_gains.ki_ts * t_s / l_q,
        eta=eta * scale,
        integral=gains.ki_ts / gains.kp,
        friction=machine.friction * t_s / inertia,
        filter_share=filter_share(settings.filter_time, t_s),
        ratio=settings.ratio,
        uneven=max(abs(1.0 / side - 1.0) for side in drives.torque),
        scale=scale,
    )


def prove_speed_loop(
    box: DriveBox, gains: LoopGains, current_gains: LoopGains, *, thorough: bool = False
) -> SpeedProof:
    """Prove the speed loop for every drive of the box, or as much of it as the effort allows.

    Args:
        box: The drive with its tolerances.
        gains, current_gains: The speed loop on a measured speed, and the current loop of the q
            axis.
        thorough: Whether some fifty times the effort is spent that every run can afford.
    """
    drives = speed_box(box)
    loop = speed_numbers(box, drives, gains, current_gains)
    per_cell = loop.ratio * len(cell_corners(drives.root()))
    cells = _THOROUGH // per_cell if thorough else min(_QUICK // per_cell, _LARGEST)
    tree = SpeedSearch(loop, drives, Effort(cells)).run()
    point = tree.counterexample
    leaves = sum(isinstance(node.verdict, Proven) for node in tree.nodes)
    certificate = None
    if leaves and point is None:
        inputs = _plain_inputs(box, drives, gains, current_gains)
        # its units of flux linkage and speed
        inputs |= {"inductance_scale": box.nominal[1], "speed_scale": loop.scale / gains.kp}
        r_s, inertia = box.design.machine.r_s, box.design.machine.inertia
        assert inertia is not None
        units = np.array([1.0, r_s, 1.0 / inertia, 1.0])
        certificate = plain_certificate(inputs, units, tree)
    return SpeedProof(
        share=_share(drives, tree),
        cells=tree.examined,
        leaves=leaves,
        ratio=loop.ratio,
        box=drives,
        unstable=None if point is None else drives.named(point),
        tree=tree,
        certificate=certificate,
    )


def _plain_inputs(
    box: DriveBox, drives: SpeedBox, gains: LoopGains, current_gains: LoopGains
) -> dict[str, Any]:
    """Control and drives in SI units, a range as its least and largest value.

    ``torque`` is what is made over what is commanded, ``dead_time`` the resistance that it adds at
    a gain of the voltage of 1, ``back_emf`` what the feedforward leaves, in V s/rad.
    """
    machine, settings = box.design.machine, box.design.control.speed_loop
    inertia = machine.inertia
    assert settings is not None
    assert inertia is not None

    def times(factor: float, span: Interval) -> list[float]:
        return [factor * side for side in span]

    return {
        "t_s": box.design.control.t_s,
        "kp": current_gains.kp,
        "ki_ts": current_gains.ki_ts,
        "speed_kp": gains.kp,
        "speed_ki_ts": gains.ki_ts,
        "ratio": settings.ratio,
        "filter_time": settings.filter_time,
        "friction": machine.friction,
        "r_s": times(machine.r_s, drives.resistance),
        "dead_time": times(machine.r_s, drives.dead_time),
        "l_q": times(box.nominal[1], drives.inductance),
        "gain": list(drives.gain),
        "torque": list(drives.torque),
        "inertia": [inertia / drives.inertia[1], inertia / drives.inertia[0]],
        "back_emf": list(drives.back_emf),
    }


def plain_certificate(
    inputs: Mapping[str, Any], units: FloatArray, tree: Tree[Chain]
) -> dict[str, Any]:
    """A tree as JSON has it: a cut is its parameter (b, s, n, e by number) and value, followed by
    all below and all above; a proven cell the upper triangles of its matrices.

    Args:
        inputs: Control and drives in SI units.
        units: Of the parameters b, c, j, e, to have them as b, (R + d g) L'/L, f/J and e, shape
            (4,).
        tree: Its cells, none of them refuted.
    """

    def plain(verdict: Verdict[Chain]) -> Any:
        if isinstance(verdict, Cut):
            return [verdict.axis, float(verdict.value * units[verdict.axis])]
        if isinstance(verdict, Proven):
            return [matrix[np.triu_indices(len(matrix))].tolist() for matrix in verdict.payload]
        return "open" if isinstance(verdict, Open) else "empty"

    return {"inputs": dict(inputs), "tree": [plain(verdict) for verdict in tree.preorder()]}


def _share(drives: SpeedBox, tree: Tree[Chain]) -> float:
    """Share of random drives outside all open cells."""
    cells = tree.open_cells
    if not cells:
        return 1.0
    points = drives.samples(_SAMPLES, np.random.default_rng(_SEED))
    inside = np.zeros(len(points), dtype=np.bool_)
    for cell in cells:
        inside |= np.all((points >= cell.low) & (points <= cell.high), axis=1)
    return 1.0 - float(np.mean(inside))


# A cyclic certificate per cell: P_0 .. P_m, one for each current sample between two of the speed.
#
#     U^T P_1 U < P_0,      A_v^T P_(k+1) A_v < P_k   for k = 1 .. m,   P_(m+1) = P_0
#
# at the corners A_v of the cell and with what they leave out. The power of the inner step is never
# formed, since nothing is multi-affine behind it; what is proven so permits the drive to change
# within a cell at every current sample.

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


# Steps of the speed loop over one current sample, over cells of its box.
#
# In flux linkage over voltage, phi = i L/(g t_s), speed w = omega L' kp_s/(t_s K sigma), torque
# command T L'/(t_s K):
#
#     d phi = -rho' c phi - e eta w + v
#     d w   = h j b phi - (B t_s/J') (J'/J) w
#     w_f+ = w_f + a (w+ - w_f)
#     v+ = I + (p + q) (T - b phi),   I+ = I + q (T - b phi)
#     T+ = S - (1 + r) sigma y,       S+ = S - r sigma y       y = w or w_f
#
# the last line every ratio-th sample only. a = 1 - exp(-t_s/T_f) is the filter's share of a new
# sample, K the torque constant that the controller assumes, and
#
#     rho' = R' t_s/L',  p = kp t_s/L',  q = ki t_s^2/L',  r = ki_s ratio t_s/kp_s
#     h = kp_s t_s/(J' sigma),   eta = t_s K sigma/(L' kp_s)
#
# with a scale sigma of the speed by which h is no smaller than a tenth and no smaller than e eta.
#
# This is affine in each of b, c, j, e alone but for the exponential. Over a cell of width w that
# errs from the interpolation of its corners by at most w^2/8 times its second derivatives,
#
#     2 integral of exp(F t_1) F_i exp(F t_2) F_i exp(F t_3) over t_1 + t_2 + t_3 = 1
#
# entry by entry no larger than the same with |F_i| and with F replaced by what it is at most: its
# diagonal, and the moduli beside it. Where the friction meets J'/J = j/f, f is taken as 1 and the
# rest belongs to the error.

# What the torque moves the speed by in a sample at least, in the scale of the speed: less would
# make the speed matter as much as the currents, whose errors are larger.
_COUPLED = 0.1
_MORE = 1.0 + 1e-12  # Makes up for the rounding of a bound.


@dataclass(frozen=True, slots=True)
class SpeedLoopNumbers:
    """The design's loop without unit, as above.

    ``friction`` is B t_s/J', ``filter_share`` a (1 without a filter), ``integral`` r,
    ``uneven`` the largest |1/f - 1|, ``scale`` sigma.
    """

    rho: float
    h: float
    p: float
    q: float
    eta: float
    integral: float
    friction: float
    filter_share: float
    ratio: int
    uneven: float
    scale: float

    @property
    def moving(self) -> int:
        """States of the drive: phi, w and, with a filter, w_f."""
        return 3 if self.filter_share < 1.0 else 2

    @property
    def size(self) -> int:
        """States in all: those of the drive, v, I, T and S."""
        return self.moving + 4

    def update(self) -> FloatArray:
        """The speed controller, from all states but T to all, shape (n, n - 1)."""
        n, last = self.size, self.moving - 1
        matrix = np.zeros((n, n - 1))
        matrix[: n - 2, : n - 2] = np.eye(n - 2)
        matrix[n - 2, n - 2] = matrix[n - 1, n - 2] = 1.0
        matrix[n - 2, last] = -(1.0 + self.integral) * self.scale
        matrix[n - 1, last] = -self.integral * self.scale
        return matrix

    def flow(self, parameters: FloatArray) -> FloatArray:
        """Phi and w over time in samples, with v as the last column, shape (N, 3, 3)."""
        b, c, j, e = parameters.T
        flow = np.zeros((len(parameters), 3, 3))
        flow[:, 0, 0], flow[:, 0, 1], flow[:, 0, 2] = -c * self.rho, -e * self.eta, 1.0
        flow[:, 1, 0], flow[:, 1, 1] = self.h * j * b, -self.friction * j
        return flow

    def drive(self, parameters: FloatArray) -> FloatArray:
        """phi, w and w_f after a sample, of themselves and v, shape (N, k, k + 1)."""
        from scipy.linalg import expm

        found = self._filtered(expm(self.flow(parameters))[:, :2])
        if self.moving == 3:
            found[:, 2, 2] = 1.0 - self.filter_share
        return found

    def _filtered(self, rows: FloatArray) -> FloatArray:
        """Phi and w of themselves and v, shape (N, 2, 3), with what w makes of w_f where there is a
        filter, shape (N, k, k + 1).
        """
        if self.moving == 2:
            return rows
        found = np.zeros((len(rows), 3, 4))
        found[:, :2, (0, 1, 3)] = rows
        found[:, 2] = self.filter_share * found[:, 1]
        return found

    def steps(self, parameters: FloatArray) -> FloatArray:
        """Steps of one current sample at parameters (b, c, j, e), shape (N, 4) -> (N, n, n)."""
        b, k, n = parameters[:, 0], self.moving, self.size
        matrix = np.zeros((len(parameters), n, n))
        matrix[:, :k, : k + 1] = self.drive(parameters)
        v, i, torque, total = range(k, n)
        matrix[:, v, 0], matrix[:, i, 0] = -(self.p + self.q) * b, -self.q * b
        matrix[:, v, i] = matrix[:, i, i] = 1.0
        matrix[:, v, torque], matrix[:, i, torque] = self.p + self.q, self.q
        matrix[:, torque, torque] = matrix[:, total, total] = 1.0
        return matrix

    def cycle(self, step: FloatArray) -> FloatArray:
        """One sample of the speed controller with one step ``ratio`` times, (n - 1, n - 1)."""
        whole = np.linalg.matrix_power(step, self.ratio) @ self.update()
        return np.asarray(np.delete(whole, self.size - 2, axis=0), dtype=np.float64)

    def left_out(self, cell: Cell) -> FloatArray:
        """Bounds of what the corners of a cell leave out of phi, w, w_f after a step.

        The part of each parameter, entry by entry over phi, w, w_f and v, and that of the friction,
        shape (5, k, k + 1).
        """
        slopes = self._slopes(cell)
        most = self._most(cell)
        found = np.zeros((len(slopes) + 1, 2, 3))
        for part, slope, width in zip(found, slopes, cell.width, strict=False):
            if width > 0.0:
                part[:] = 0.25 * width**2 * _nested(most, slope, 2)[:2]
        if self.friction * self.uneven > 0.0:
            rest = np.zeros_like(most)
            rest[1, 1] = self.friction * self.uneven * float(cell.high[2])
            found[-1] = _nested(most + rest, rest, 1)[:2]
        return self._filtered(found * _MORE)

    def _slopes(self, cell: Cell) -> FloatArray:
        """Largest moduli of the flow's derivatives by b, c, j and e, shape (4, 3, 3)."""
        b, j = float(cell.high[0]), float(cell.high[2])
        slopes = np.zeros((4, 3, 3))
        slopes[0, 1, 0], slopes[1, 0, 0] = self.h * j, self.rho
        slopes[2, 1, 0], slopes[2, 1, 1], slopes[3, 0, 1] = self.h * b, self.friction, self.eta
        return slopes

    def _most(self, cell: Cell) -> FloatArray:
        """What the flow is at most over a cell, moduli beside the diagonal."""
        flows = self.flow(cell_corners(cell))
        diagonal = np.max(np.diagonal(flows, axis1=1, axis2=2), axis=0)
        most: FloatArray = np.max(np.abs(flows), axis=0)
        np.fill_diagonal(most, diagonal)
        return most


def _nested(most: FloatArray, slope: FloatArray, count: int) -> FloatArray:
    """Integral of exp(M t_0) S exp(M t_1) .. S exp(M t_count) over all t that add up to 1."""
    from scipy.linalg import expm

    size = len(most)
    block = np.kron(np.eye(count + 1), most) + np.kron(np.eye(count + 1, k=1), slope)
    return np.asarray(expm(block)[:size, -size:], dtype=np.float64)


def speed_scale(h: float, emf: float) -> float:
    """The scale sigma of the speed, from h and the largest e eta at sigma = 1.

    Args:
        h: kp_s t_s/J'.
        emf: Largest e eta.
    """
    return float(h / max(_COUPLED, np.sqrt(h * emf)))


def cell_corners(cell: Cell) -> FloatArray:
    """Corners of a cell, those of no width once, shape (V, D)."""
    sides = [
        (low,) if low == high else (low, high)
        for low, high in zip(cell.low.tolist(), cell.high.tolist(), strict=True)
    ]
    return np.array(list(itertools.product(*sides)))


# The box of drives as the speed loop sees it: four parameters without unit.
#
# With the design's R', L', J' and the plant's R, L, J, the gain g of the voltage, f torque over
# commanded torque, and what the feedforward leaves of the back-EMF,
#
#     b = g L'/L,    c = (R/R' + dead time times g) L'/L,    j = f J'/J,    e = p psi_pm deviation/g
#
# the same g and L being in several of them: a cell belongs to the box where intervals of both are
# left, and is cut to what those allow. (c in place of c/b, since the loop depends on c alone where
# b is far from its gains: what interpolation over a cell leaves out is a third of it.)

Interval = tuple[float, float]
PARAMETERS = ("b", "c", "j", "e")
_SLACK = 1e-12  # Share by which intervals are widened, far more than what doubles round.


def _divided(above: Interval, below: Interval) -> Interval:
    """Quotients by what is positive."""
    ends = [x / y for x in above for y in below]
    return min(ends), max(ends)


def _quotients(above: Interval, below: Interval) -> Interval:
    """Positive values x/y, where y of either sign may be small."""
    if below[0] > 0.0:
        return _divided(above, below)
    if below[1] < 0.0:
        return _divided(above, below)
    return 0.0, np.inf


def _common(one: Interval, other: Interval) -> Interval:
    """Values of both, the other one widened."""
    return max(one[0], other[0] * (1.0 - _SLACK)), min(one[1], other[1] * (1.0 + _SLACK))


@dataclass(frozen=True, slots=True)
class SpeedBox:
    """Intervals of R/R', L/L', g, what the dead time adds to R/R' per g, f, J'/J and e g.

    The last in V s/rad, all others without unit.
    """

    resistance: Interval
    inductance: Interval
    gain: Interval
    dead_time: Interval
    torque: Interval
    inertia: Interval
    back_emf: Interval

    def root(self) -> Cell:
        """The cell around all drives."""
        return self._reached(self.gain, self.inductance)

    def _reached(self, gain: Interval, inductance: Interval) -> Cell:
        """What drives with some gains of the voltage and inductances reach."""
        ohm = self._resistances(gain)
        ends = [side / g for side in self.back_emf for g in gain]
        sides = np.array(
            [
                _divided(gain, inductance),
                _divided(ohm, inductance),
                (self.torque[0] * self.inertia[0], self.torque[1] * self.inertia[1]),
                (min(ends), max(ends)),
            ]
        )
        moved = sides[:, 1] > sides[:, 0]  # what does not deviate stays one value
        slack = np.where(moved, _SLACK * np.max(np.abs(sides), axis=1), 0.0)
        return Cell(sides[:, 0] - slack, sides[:, 1] + slack)

    def _resistances(self, gain: Interval) -> Interval:
        dead = [side * g for side in self.dead_time for g in gain]
        return self.resistance[0] + min(dead), self.resistance[1] + max(dead)

    def _shares(self, cell: Cell) -> tuple[Interval, Interval] | None:
        """Gains of the voltage and inductances that drives of a cell may have, None without any."""
        (b_low, c_low, _, e_low), (b_high, c_high, _, e_high) = (
            cell.low.tolist(),
            cell.high.tolist(),
        )
        gain, inductance = self.gain, self.inductance
        if e_low > 0.0:  # only a deviation large enough over a gain small enough makes so much
            gain = gain[0], min(gain[1], self.back_emf[1] / e_low)
        if e_high < 0.0:
            gain = gain[0], min(gain[1], self.back_emf[0] / e_high)
        for _ in range(2):
            inductance = _common(inductance, (gain[0] / b_high, gain[1] / b_low))
            inductance = _common(inductance, _quotients(self._resistances(gain), (c_low, c_high)))
            gain = _common(gain, (b_low * inductance[0], b_high * inductance[1]))
            if gain[0] > gain[1] or inductance[0] > inductance[1]:
                return None
        return gain, inductance

    def contracted(self, cell: Cell) -> Cell | None:
        """The cell cut to what drives of the box can reach, None where there is none."""
        shares = self._shares(cell)
        if shares is None:
            return None
        reached = self._reached(*shares)
        low, high = np.maximum(cell.low, reached.low), np.minimum(cell.high, reached.high)
        return Cell(low, high) if bool(np.all(low <= high)) else None

    def drive(self, cell: Cell) -> FloatArray | None:
        """Parameters of a drive near the middle of a cell, None where there is none."""
        shares = self._shares(cell)
        if shares is None:
            return None
        g, inductance = (0.5 * (low + high) for low, high in shares)
        g = min(max(g, self.gain[0]), self.gain[1])
        inductance = min(max(inductance, self.inductance[0]), self.inductance[1])
        reached = self._reached((g, g), (inductance, inductance))
        return np.clip(cell.middle, reached.low, reached.high)

    def named(self, point: FloatArray) -> dict[str, float]:
        """Deviations of a drive with parameters (b, c, j, e), relative, as near as there is one."""
        shares = self._shares(Cell(point * (1.0 - _SLACK), point * (1.0 + _SLACK)))
        gain = self.gain if shares is None else shares[0]
        g = min(max(0.5 * (gain[0] + gain[1]), self.gain[0]), self.gain[1])
        inductance = g / float(point[0])
        ohm = float(point[1]) * inductance - 0.5 * g * (self.dead_time[0] + self.dead_time[1])
        named = {"r_s": ohm, "l_q": inductance, "v_dc": g, "torque over inertia": float(point[2])}
        return {name: value - 1.0 for name, value in named.items()}

    def samples(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Parameters of random drives of the box, shape (count, 4).

        Every share of the box is as likely as it is large in R, L, g, dead time, f, J and psi_pm.
        """
        names = (
            self.resistance,
            self.inductance,
            self.gain,
            self.dead_time,
            self.torque,
            (1.0 / self.inertia[1], 1.0 / self.inertia[0]),
            self.back_emf,
        )
        r, inductance, g, dead, f, mass, emf = (generator.uniform(*of, count) for of in names)
        return np.stack([g / inductance, (r + g * dead) / inductance, f / mass, emf / g], axis=1)


# Whether P falls along a step at the corners of a cell and with what they leave out.
#
# A step of the cell is a convex combination of its corners A_v plus E with |E_rc| <= e_rc in a few
# rows. With M_v = P - A_v^T P' A_v > 0 and X M_v X^T = 1, the step contracts from P to P' if at
# every corner
#
#     2 sum of e_rc |X A_v^T P' u_r| |X_c| + (sum of e_rc sqrt(P'_rr) |X_c|)^2 < 1
#
# u_r being unit vectors and X_c columns of X. Rows keep bounds of their own because they differ by
# orders of magnitude: the speed moves by far less in a sample than the flux linkage.

_CYCLE_CONTRACTION_SLACK = (
    1e-5  # What the left-hand side keeps from 1, so that rounding does not decide.
)


def step_contracts(
    before: FloatArray, after: FloatArray, closed: FloatArray, left_out: FloatArray
) -> Contraction:
    """Whether x^T P x falls over a step.

    Args:
        before, after: P and P', shapes (n, n) and (m, m).
        closed: Corners of the step, shape (V, m, n).
        left_out: Bounds of the entries that the corners leave out: of the first rows and columns.
    """
    fall = before - np.swapaxes(closed, 1, 2) @ after @ closed
    try:
        np.linalg.cholesky(before)
        np.linalg.cholesky(after)
        frame = np.linalg.inv(np.linalg.cholesky(0.5 * (fall + np.swapaxes(fall, 1, 2))))
    except np.linalg.LinAlgError:
        return Contraction(corners=False, whole=False)
    if not np.isfinite(frame).all():
        return Contraction(corners=False, whole=False)
    rows, columns = left_out.shape
    turned = frame @ np.swapaxes(closed, 1, 2) @ after[:, :rows]
    cross = np.sqrt((turned**2).sum(1))
    reach = np.sqrt((frame[:, :, :columns] ** 2).sum(1)) @ left_out.T
    own = reach @ np.sqrt(np.diag(after)[:rows])
    whole = 2.0 * (cross * reach).sum(1) + own**2 < 1.0 - _CYCLE_CONTRACTION_SLACK
    return Contraction(corners=True, whole=bool(whole.all()))
