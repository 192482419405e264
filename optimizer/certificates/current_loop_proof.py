"""What is proven of both current loops together over a box of drives: searched, confirmed in balls,
and where it ends.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from fractions import Fraction
from functools import lru_cache
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.both_axes_sensitivity import MOST_WORK, bound_sensitivity
from dqforge.optimizer.certificates.cell_queue import (
    CELLS,
    WORK,
    BoxDrive,
    Cell,
    CurrentLoopBox,
    Cut,
    Open,
    Proven,
    Tree,
    Verdict,
    find_certificate,
    gain_interval,
)
from dqforge.optimizer.certificates.matrix_inequalities import Budget

if TYPE_CHECKING:
    from flint import arb, arb_mat


_SAMPLES = 20_000

_SEED = 20_261_122


@dataclass(frozen=True, slots=True)
class DriveRange:
    """Least and largest values between which drives lie: Ohm (dead time included), H, the gain of
    the voltage, and rad/s.
    """

    r_s: tuple[float, float]
    l_d: tuple[float, float]
    l_q: tuple[float, float]
    gain: tuple[float, float]
    omega_e: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class ProvenSensitivity:
    """Sensitivity of both axes together over a box: the largest value ``found``, the drive ``at``
    which it is, and the ``bound`` that none exceeds, confirmed with ``certificate``; both None
    where the search ended before.
    """

    found: float
    at: BoxDrive
    bound: float | None
    certificate: PlainCertificate | None


@dataclass(frozen=True, slots=True, eq=False)
class CurrentLoopProof:
    """What is known of both current loops together over a box of drives.

    Args:
        box: Control and drives.
        confirmation: What the checker said of the certificate; None with a counterexample.
        certificate: What it was made of, as it is stored; None with a counterexample.
        share: Share of the drives that is proven, of uniform random ones where it is not all.
        still_open: Between which values the drives lie of which nothing is proven; None where all
            are.
        counterexample: A drive of the box whose loops are unstable; None where none was met.
        sensitivity: That of both axes together, where it was asked for.
        left: Work that the search left.
    """

    box: CurrentLoopBox
    confirmation: Confirmation | None
    certificate: PlainCertificate | None
    share: float
    still_open: DriveRange | None = None
    counterexample: BoxDrive | None = None
    sensitivity: ProvenSensitivity | None = None
    left: int = 0

    @property
    def proven(self) -> bool:
        """Whether every drive of the box is proven stable."""
        return self.confirmation is not None and self.confirmation.proven


@lru_cache(maxsize=64)
def prove_current_loops(
    box: CurrentLoopBox, largest: int = CELLS, work: int = WORK
) -> CurrentLoopProof:
    """Prove both current loops together stable for every drive of a box at every constant speed.

    Args:
        box: Control and drives.
        largest: How many cells are looked at before the rest is left open.
        work: Work that may be done before it is.
    """
    budget = Budget(work)
    found = find_certificate(box, largest, budget)
    if found.counterexample is not None:
        return CurrentLoopProof(box, None, None, 0.0, counterexample=found.counterexample)
    certificate = plain_certificate(box, found.tree)
    confirmation = confirm(certificate, plain_inputs(box))
    if confirmation.fault:  # nothing is stated that doubles alone have seen
        return CurrentLoopProof(box, confirmation, None, 0.0, _ranges(box, [found.root]))
    left = found.tree.open_cells
    if not left:
        return CurrentLoopProof(box, confirmation, certificate, 1.0, left=budget.left)
    return CurrentLoopProof(
        box, confirmation, certificate, _proven_share(box, left), _ranges(box, left)
    )


@lru_cache(maxsize=64)
def prove_sensitivity(box: CurrentLoopBox, work: int = MOST_WORK) -> ProvenSensitivity:
    """The largest sensitivity of both axes together that is found in a box, with a proven bound.

    Args:
        box: Control and drives, all of them proven stable.
        work: Work that is left; `MOST_WORK` of it at most is done.
    """
    searched = bound_sensitivity(box, work=min(work, MOST_WORK))
    if np.isfinite(searched.bound):
        certificate = plain_certificate(box, searched.tree)
        if confirm_sensitivity(certificate, plain_inputs(box), searched.bound).proven:
            return ProvenSensitivity(searched.found, searched.at, searched.bound, certificate)
    return ProvenSensitivity(searched.found, searched.at, None, None)


def _proven_share(box: CurrentLoopBox, left: list[Cell]) -> float:
    """Share of uniform random drives that lie in no open cell."""
    points = random_parameters(box, _SAMPLES)
    inside: BoolArray = np.zeros(len(points), dtype=np.bool_)
    for cell in left:
        inside |= ((points >= cell.low) & (points <= cell.high)).all(axis=1)
    return float(1.0 - inside.mean())


def random_parameters(box: CurrentLoopBox, count: int, seed: int = _SEED) -> FloatArray:
    """b_d, b_q, s and x of random drives, uniform in everything that may vary, shape (count, 4)."""
    ends = np.array(
        [box.r_s, box.dead_time, box.l_d, box.l_q, box.gain, (0.0, box.omega_e)], dtype=np.float64
    )
    drives = np.random.default_rng(seed).uniform(ends[:, 0], ends[:, 1], (count, len(ends)))
    r_s, dead_time, l_d, l_q, gain, omega_e = drives.T
    return np.column_stack(
        [
            gain * box.decoupling[0] / l_d,
            gain * box.decoupling[1] / l_q,
            r_s / gain + dead_time,
            omega_e * box.t_s,
        ]
    )


def _ranges(box: CurrentLoopBox, cells: list[Cell]) -> DriveRange:
    """Between which values the drives of some cells lie."""
    each = [_range(box, cell) for cell in cells]
    rows = np.array([[part.r_s, part.l_d, part.l_q, part.gain, part.omega_e] for part in each])
    pairs = zip(rows[:, :, 0].min(axis=0), rows[:, :, 1].max(axis=0), strict=True)
    return DriveRange(*((float(low), float(high)) for low, high in pairs))


def _range(box: CurrentLoopBox, cell: Cell) -> DriveRange:
    low, high = gain_interval(box, cell)
    reach = [
        (
            max(limits[0], low * reference / float(cell.high[axis])),
            min(limits[1], high * reference / float(cell.low[axis])),
        )
        for axis, (limits, reference) in enumerate(
            zip((box.l_d, box.l_q), box.decoupling, strict=True)
        )
    ]
    resistances = [float(s) * gain for s in (cell.low[2], cell.high[2]) for gain in (low, high)]
    least, most = (
        (r + min(c * low, c * high), r + max(c * low, c * high))
        for r, c in zip(box.r_s, box.dead_time, strict=True)
    )
    return DriveRange(
        (max(least[0], min(resistances)), min(most[1], max(resistances))),
        reach[0],
        reach[1],
        (low, high),
        (float(cell.low[3]) / box.t_s, float(cell.high[3]) / box.t_s),
    )


# Confirms a certificate of both current loops in ball arithmetic, and believes nothing in it.
#
# Written apart from the search, from the statement alone: for every drive of the box (R, what the
# dead time adds, L_d, L_q, voltage gain) at every constant speed up to the largest, both current
# loops together are stable (or, of another certificate, have a sensitivity below a bound). Cells
# are rebuilt from the box by the stored cuts, in rationals, so that they cover it; that no drive
# lies in a cell is computed here; and each cell's matrix P is checked at the corners with the bound
# of what they leave out (`current_loop_model` derives both).

BITS = 80

_PAIRS = ("kp", "ki_ts", "decoupling", "r_s", "dead_time", "l_d", "l_q", "gain")
_SINGLE = ("t_s", "omega_e")

Side = tuple[Fraction, ...]


@dataclass(frozen=True, slots=True)
class _Cell:
    """Least and largest b_d, b_q, s and x."""

    low: Side
    high: Side


@dataclass(frozen=True, slots=True)
class Confirmation:
    """What the checker found: ``fault`` is empty where all is true that the certificate claims.

    ``matrices`` counts the cells that a matrix proves, ``empty`` those without a drive, and
    ``left_open`` those of which the certificate itself claims nothing.
    """

    fault: str
    matrices: int = 0
    empty: int = 0
    left_open: int = 0

    @property
    def proven(self) -> bool:
        """Whether every drive of the box is proven stable."""
        return not self.fault and self.left_open == 0


class _CertificateError(Exception):
    """What is wrong with a certificate, in words."""


@dataclass(frozen=True, slots=True)
class _Box:
    """The inputs as rationals; pairs are (d, q) or (least, largest)."""

    t_s: Fraction
    omega_e: Fraction
    kp: tuple[Fraction, Fraction]
    ki_ts: tuple[Fraction, Fraction]
    decoupling: tuple[Fraction, Fraction]
    r_s: tuple[Fraction, Fraction]
    dead_time: tuple[Fraction, Fraction]
    l_d: tuple[Fraction, Fraction]
    l_q: tuple[Fraction, Fraction]
    gain: tuple[Fraction, Fraction]


def confirm(certificate: Mapping[str, Any], inputs: Mapping[str, Any]) -> Confirmation:
    """Whether a certificate proves that both current loops of given inputs are stable.

    Args:
        certificate: As it is stored: ``inputs`` and ``tree``, the verdicts of its cells, cut before
            what is below and above it.
        inputs: What it must be about, in the same keys.
    """
    return _in_balls(certificate, inputs, None)


def confirm_sensitivity(
    certificate: Mapping[str, Any], inputs: Mapping[str, Any], bound: float
) -> Confirmation:
    """Whether a certificate proves a bound of the sensitivity of both axes together.

    Args:
        certificate, inputs: As of `confirm`.
        bound: What the largest singular value may not reach at any frequency.
    """
    return _in_balls(certificate, inputs, bound)


def _in_balls(
    certificate: Mapping[str, Any], inputs: Mapping[str, Any], bound: float | None
) -> Confirmation:
    from flint import ctx

    before = ctx.prec
    ctx.prec = BITS
    try:
        return _confirmed(certificate, inputs, None if bound is None else _number(bound))
    except _CertificateError as fault:
        return Confirmation(str(fault))
    finally:
        ctx.prec = before


def _confirmed(
    certificate: Mapping[str, Any], inputs: Mapping[str, Any], bound: Fraction | None
) -> Confirmation:
    stated = certificate.get("inputs")
    if not isinstance(stated, Mapping):
        raise _CertificateError("it has no inputs")
    _same(stated, inputs)
    box, tree = _read(inputs), certificate.get("tree")
    if not isinstance(tree, list):
        raise _CertificateError("it has no tree of cells")
    counts = {"matrix": 0, "empty": 0, "open": 0, "cut": 0}
    waiting: list[_Cell | None] = [_root(box)]
    for verdict in tree:
        if not waiting:
            raise _CertificateError("its tree continues after its last cell")
        cell = waiting.pop()
        inside = None if cell is None else _shrunk(box, cell)
        kind = _kind(verdict)
        counts[kind] += 1
        if kind == "cut":  # of an empty cell: both halves are
            waiting += [None, None] if inside is None else reversed(_halves(inside, verdict))
        elif kind == "empty" and inside is not None:
            raise _CertificateError("a cell that it calls empty holds drives")
        elif kind == "matrix" and not (
            inside is None or _contracts(box, inside, _matrix(verdict), bound)
        ):
            raise _CertificateError(f"the matrix of cell {counts['matrix']} does not prove it")
    if waiting:
        raise _CertificateError(f"its tree ends with {len(waiting)} cells left")
    return Confirmation("", counts["matrix"], counts["empty"], counts["open"])


def _kind(verdict: Any) -> str:
    if verdict in ("empty", "open"):
        return str(verdict)
    if isinstance(verdict, list) and len(verdict) in (2, 21):
        return "cut" if len(verdict) == 2 else "matrix"
    raise _CertificateError("a cell is neither cut, empty, open, nor proven by a matrix")


def _same(stated: Mapping[str, Any], inputs: Mapping[str, Any]) -> None:
    """Raises unless both name the same inputs, to the bit."""
    if set(stated) != set(inputs):
        raise _CertificateError("its inputs are not those that a proof needs")
    for name in inputs:
        both = [
            np.ravel(np.asarray(side[name], dtype=object)).tolist() for side in (stated, inputs)
        ]
        if both[0] != both[1]:
            raise _CertificateError(f"it was made for another {name}")


def _number(value: Any) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise _CertificateError("a number of it is none")
    return Fraction(value)


def _pair(values: Sequence[Any]) -> tuple[Fraction, Fraction]:
    low, high = (_number(value) for value in values)
    return low, high


def _read(inputs: Mapping[str, Any]) -> _Box:
    if set(inputs) != {*_PAIRS, *_SINGLE}:
        raise _CertificateError("its inputs are not those that a proof needs")
    box = _Box(
        _number(inputs["t_s"]),
        _number(inputs["omega_e"]),
        *(_pair(inputs[name]) for name in _PAIRS),
    )
    ranges = (box.r_s, box.dead_time, box.l_d, box.l_q, box.gain)
    positive = (box.t_s, *box.decoupling, box.l_d[0], box.l_q[0], box.gain[0])
    if min(positive) <= 0 or box.r_s[0] < 0 or box.omega_e < 0:
        raise _CertificateError("its box holds what is no drive")
    if any(low > high for low, high in ranges):
        raise _CertificateError("its box ends before it begins")
    return box


def _root(box: _Box) -> _Cell:
    ends = [*_reduced(box, *box.gain), (Fraction(0), box.omega_e * box.t_s)]
    return _Cell(tuple(low for low, _ in ends), tuple(high for _, high in ends))


def _reduced(box: _Box, least: Fraction, most: Fraction) -> list[tuple[Fraction, Fraction]]:
    """How far b_d, b_q and s reach with voltage gains between two."""
    d, q = box.decoupling
    return [
        (least * d / box.l_d[1], most * d / box.l_d[0]),
        (least * q / box.l_q[1], most * q / box.l_q[0]),
        (box.r_s[0] / most + box.dead_time[0], box.r_s[1] / least + box.dead_time[1]),
    ]


def _shrunk(box: _Box, cell: _Cell) -> _Cell | None:
    """The cell as far as the voltage gains reach with which it can hold drives; None without."""
    (d, q), (least, most), low, high = box.decoupling, box.gain, cell.low, cell.high
    least = max(least, low[0] * box.l_d[0] / d, low[1] * box.l_q[0] / q)
    most = min(most, high[0] * box.l_d[1] / d, high[1] * box.l_q[1] / q)
    above, below = high[2] - box.dead_time[0], low[2] - box.dead_time[1]
    if above < 0 or (above == 0 and box.r_s[0] > 0):
        return None
    if box.r_s[0] > 0:
        least = max(least, box.r_s[0] / above)
    if below > 0:
        most = min(most, box.r_s[1] / below)
    if least > most:
        return None
    reduced = [*_reduced(box, least, most), (low[3], high[3])]
    return _Cell(
        tuple(max(own, other[0]) for own, other in zip(low, reduced, strict=True)),
        tuple(min(own, other[1]) for own, other in zip(high, reduced, strict=True)),
    )


def _halves(cell: _Cell, cut: Sequence[Any]) -> list[_Cell]:
    """Both sides of a cut, which must run through the cell."""
    axis, value = cut[0], _number(cut[1])
    if isinstance(axis, bool) or axis not in (0, 1, 2, 3):
        raise _CertificateError("it cuts a parameter that there is not")
    if not cell.low[axis] < value < cell.high[axis]:
        raise _CertificateError("a cut lies outside its cell")
    upper = tuple(value if k == axis else end for k, end in enumerate(cell.high))
    lower = tuple(value if k == axis else end for k, end in enumerate(cell.low))
    return [_Cell(cell.low, upper), _Cell(lower, cell.high)]


def _matrix(entries: Sequence[Any]) -> list[list[float]]:
    """P from its upper triangle, row by row."""
    values = iter([float(_number(value)) for value in entries])
    matrix = [[0.0] * 6 for _ in range(6)]
    for row in range(6):
        for column in range(row, 6):
            matrix[row][column] = matrix[column][row] = next(values)
    return matrix


def _ball(value: Fraction) -> arb:
    from flint import arb, fmpq

    return arb(fmpq(value.numerator, value.denominator))


def _contracts(box: _Box, cell: _Cell, matrix: list[list[float]], bound: Fraction | None) -> bool:
    """Whether x^T P x falls along every loop of a cell; with a bound of the sensitivity, by so
    much that it holds.
    """
    from flint import arb_mat

    held = arb_mat(matrix)
    if not _positive(held):
        return False
    before = held if bound is None else _bordered(held, _ball(bound**2))
    after = held if bound is None else _bordered(held, _ball(Fraction(1)))
    rests = _rests(box, cell)
    ends = zip(cell.low, cell.high, strict=True)
    for corner in itertools.product(*(sorted({low, high}) for low, high in ends)):
        loop = _loop(box, corner)
        if not _falls(before, after, loop if bound is None else _disturbed(loop), rests):
            return False
    return True


def _bordered(matrix: arb_mat, value: arb) -> arb_mat:
    """diag(P, value, value)."""
    return _with_two_more(matrix, {(6, 6): value, (7, 7): value})


def _disturbed(loop: arb_mat) -> arb_mat:
    """[A B; C 1], the loop with a disturbance of both voltages and what they become."""
    from flint import arb

    one = arb(1)
    units = dict.fromkeys(((2, 6), (3, 7), (6, 6), (7, 7)), one)
    rows = {(6 + k, j): loop[2 + k, j] for k in range(2) for j in range(6)}
    return _with_two_more(loop, units | rows)


def _with_two_more(matrix: arb_mat, entries: Mapping[tuple[int, int], arb]) -> arb_mat:
    from flint import arb, arb_mat

    zero = arb(0)
    return arb_mat(
        [
            [matrix[i, j] if i < 6 and j < 6 else entries.get((i, j), zero) for j in range(8)]
            for i in range(8)
        ]
    )


def _rests(box: _Box, cell: _Cell) -> tuple[arb, arb]:
    """Bounds of what the corners leave out of Phi and of Gam."""
    low, high = cell.low, cell.high
    rho_d, rho_q = box.t_s / box.decoupling[0], box.t_s / box.decoupling[1]
    steepest = max(rho_d * high[0], rho_q * high[1])
    s = max(abs(low[2]), abs(high[2]))
    slopes = (s * rho_d, s * rho_q, steepest, Fraction(1))
    steps = [((high[axis] - low[axis]) * slopes[axis]) ** 2 for axis in range(4)]
    growth = _ball(max(Fraction(0), -low[2]) * steepest).exp()
    slow = steps[0] + steps[1] + steps[2]
    return growth * _ball((slow + steps[3]) / 8), growth * _ball(slow / 24 + steps[3] / 12)


def _loop(box: _Box, corner: Sequence[Fraction]) -> arb_mat:
    """The closed loop of (phi_d, phi_q, v_d, v_q, I_d, I_q), states by states."""
    from flint import arb, arb_mat

    b_d, b_q, s, x = (_ball(value) for value in corner)
    rho_d, rho_q = (_ball(box.t_s / inductance) for inductance in box.decoupling)
    zero, one = arb(0), arb(1)
    held = arb_mat(
        [
            [-s * rho_d * b_d, x, one, zero],
            [-x, -s * rho_q * b_q, zero, one],
            [zero, zero, zero, x],
            [zero, zero, -x, zero],
        ]
    ).exp()
    cosine, sine = (x / 2).cos(), (x / 2).sin()
    turn = arb_mat([[cosine, -sine], [sine, cosine]])
    acting = arb_mat([[held[i, 2], held[i, 3]] for i in range(2)]) * turn
    p_d, p_q = (_ball(k) * rho for k, rho in zip(box.kp, (rho_d, rho_q), strict=True))
    q_d, q_q = (_ball(k) * rho for k, rho in zip(box.ki_ts, (rho_d, rho_q), strict=True))
    return arb_mat(
        [
            [held[0, 0], held[0, 1], acting[0, 0], acting[0, 1], zero, zero],
            [held[1, 0], held[1, 1], acting[1, 0], acting[1, 1], zero, zero],
            [-(p_d + q_d) * b_d, -x * b_q, zero, zero, one, zero],
            [x * b_d, -(p_q + q_q) * b_q, zero, zero, zero, one],
            [-q_d * b_d, zero, zero, zero, one, zero],
            [zero, -q_q * b_q, zero, zero, zero, one],
        ]
    )


def _frame(matrix: arb_mat) -> arb_mat | None:
    """Doubles X with X M X^T near 1; any X serves, so that nothing here must be exact."""
    from flint import arb_mat

    size = matrix.nrows()
    middle = [[float(matrix[i, j].mid()) for j in range(size)] for i in range(size)]
    try:
        found = np.linalg.inv(np.linalg.cholesky(np.array(middle)))
    except np.linalg.LinAlgError:
        return None
    return arb_mat(found.tolist()) if np.isfinite(found).all() else None


def _size(matrix: arb_mat) -> arb:
    """Frobenius norm."""
    from flint import arb

    total = sum((entry * entry for entry in matrix.entries()), arb(0))
    return total.sqrt() if total != 0 else arb(0)


def _away_from_unit(matrix: arb_mat, frame: arb_mat) -> arb:
    """Size of X M X^T - 1."""
    from flint import arb_mat

    size = matrix.nrows()
    unit = arb_mat([[int(i == j) for j in range(size)] for i in range(size)])
    return _size(frame * matrix * frame.transpose() - unit)


def _positive(matrix: arb_mat) -> bool:
    frame = _frame(matrix)
    return frame is not None and bool(_away_from_unit(matrix, frame) < 1)


def _falls(before: arb_mat, after: arb_mat, loop: arb_mat, rests: tuple[arb, arb]) -> bool:
    """Whether before - (A + U E)^T after (A + U E) > 0 at a corner for every E in its bounds."""
    from flint import arb_mat

    turned = loop.transpose() * after
    fall = before - turned * loop
    frame = _frame(fall)
    if frame is None:
        return False
    size = frame.nrows()
    columns = [
        arb_mat([[frame[i, j] for j in pair] for i in range(size)]) for pair in ((0, 1), (2, 3))
    ]
    reach = rests[0] * _size(columns[0]) + rests[1] * _size(columns[1])
    cross = frame * arb_mat([[turned[i, j] for j in range(2)] for i in range(size)])
    own = arb_mat([[after[i, j] for j in range(2)] for i in range(2)])
    lost = 2 * _size(cross) * reach + _size(own) * reach**2
    return bool(_away_from_unit(fall, frame) + lost < 1)


# What is stored of a proof: the inputs, the cuts, and a matrix for every cell.

PlainCertificate = dict[str, Any]


def plain_inputs(box: CurrentLoopBox) -> dict[str, Any]:
    """The inputs of a proof as JSON has them."""
    return {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(box).items()
    }


def plain_certificate(box: CurrentLoopBox, tree: Tree[FloatArray]) -> PlainCertificate:
    """A tree as JSON has it: a cut is its parameter (b_d, b_q, s, x by number) and value,
    followed by all below and all above; a proven cell the upper triangle of its matrix.

    Args:
        box: Control and drives.
        tree: Its cells, none of them refuted.
    """
    return {"inputs": plain_inputs(box), "tree": [_plain(verdict) for verdict in tree.preorder()]}


def _plain(verdict: Verdict[FloatArray]) -> Any:
    if isinstance(verdict, Cut):
        return [verdict.axis, verdict.value]
    if isinstance(verdict, Proven):
        return [float(entry) for entry in verdict.payload[np.triu_indices(6)]]
    return "open" if isinstance(verdict, Open) else "empty"
