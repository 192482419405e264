"""What is proven of the margins of a design's current loops, axis by axis."""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.loop_gains import LoopGains, LoopName
from dqforge.optimizer.loops.robustness import BoxPoints, DriveBox, LoopRobustness

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from flint import fmpq, fmpq_mat


# Most cells per claim, of some 0.3 ms each. A loop whose gain stays near 1 over decades would take
# far more for its phase margin, and is left without a bound of it.
_BITS = 80
_SENSITIVITY_CELLS, _PHASE_CELLS = 1500, 600
_SENSITIVITY = (1.005, 1.02, 1.1)

# What is claimed: the largest M_s found times these, the least phase margin less these.
_PHASE = tuple(math.radians(value) for value in (0.25, 1.0, 3.0))


@dataclass(frozen=True, slots=True)
class ProvenMargins:
    """What holds for every drive of the box and every frequency.

    Args:
        stable: Whether all drives are proven stable.
        max_sensitivity: Bound of M_s, None where none was proven.
        phase_margin: Bound of the phase margin in rad, None where none was proven.
        cells: Cells that all of it took.
    """

    stable: bool
    max_sensitivity: float | None
    phase_margin: float | None
    cells: int


def _reach(deviations: FloatArray) -> tuple[float, float]:
    return float(np.min(deviations)), float(np.max(deviations))


def _factors(deviations: FloatArray) -> tuple[fmpq, fmpq]:
    low, high = _reach(deviations)
    return 1 + rational(low), 1 + rational(high)


def axis_box(box: DriveBox, gains: LoopGains) -> AxisBox:
    """The drives that the loop of one axis depends on.

    Args:
        box: The drive with its tolerances.
        gains: A current loop, with the inductance that it is meant for.
    """
    from flint import arb, fmpq

    design, points, name = box.design, *_points(box, gains.loop)
    r_s, t_s = rational(design.machine.r_s), rational(design.control.t_s)
    dead, sides = (fmpq(0), fmpq(0)), _reach(points.of("dead_time"))
    if sides != (0.0, 0.0):
        ohm = rational(design.inverter.f_sw) * rational(design.inverter.v_dc)
        ohm *= 4 / (rational(box.tolerances.low_current) * r_s)
        balls = [arb(ohm * rational(side)) / arb.pi() for side in sides]
        dead = balls[0].lower().fmpq(), balls[1].upper().fmpq()
    return AxisBox(
        rho=r_s * t_s / rational(_inductance(gains)),
        resistance=_factors(points.of("r_s")),
        inductance=_factors(points.of(name)),
        gain=_factors(points.of("v_dc")),
        dead_time=dead,
    )


def _points(box: DriveBox, loop: LoopName) -> tuple[BoxPoints, str]:
    """Corners of what a loop depends on, and the name of its inductance among them."""
    if loop == "i_0":
        return box.zero_points(), "l_0"
    return (
        (box.current_points("i_d"), "l_d") if loop == "i_d" else (box.current_points("i_q"), "l_q")
    )


def _inductance(gains: LoopGains) -> float:
    assert gains.inductance is not None
    return gains.inductance


def axis_gains(gains: LoopGains) -> AxisGains:
    """The gains of an axis's loop without unit.

    Args:
        gains: A current loop, with the inductance that it is meant for.
    """
    scale = rational(gains.t_s) / rational(_inductance(gains))
    return AxisGains(scale * rational(gains.kp), scale * rational(gains.ki_ts))


def nominal_is_stable(box: AxisBox, gains: AxisGains) -> bool:
    """Whether the drive of the data is stable, by Jury's conditions of its three poles.

    Args:
        box: The drives.
        gains: The loop's gains.
    """
    from flint import fmpq

    one = fmpq(1), fmpq(1)
    (a_low, a_high), (gamma_low, gamma_high) = box.sampled(one, one)
    a, gamma = _ball(a_low, a_high), _ball(gamma_low, gamma_high)
    first, second = -(1 + a), a + gamma * (gains.p + gains.q)
    last = -gamma * gains.p
    at_one, at_minus_one = 1 + first + second + last, -1 + first - second + last
    inner = (1 - last * last) - abs(second - first * last)
    return bool(at_one > 0 and at_minus_one < 0 and inner > 0 and abs(last) < 1)


def _ball(low: fmpq, high: fmpq) -> Any:
    from flint import arb

    return arb(low).union(arb(high))


def prove_margins(box: DriveBox, gains: LoopGains, found: LoopRobustness) -> ProvenMargins:
    """Bounds of M_s and phase margin of a current loop over the box, near what was found.

    M_s that is finite everywhere leaves no pole on the unit circle; the box is connected, and one
    of its drives is stable: so all are.

    Args:
        box: The drive with its tolerances.
        gains: A current loop, with the inductance that it is meant for.
        found: What corners and samples found.
    """
    from flint import ctx

    before = ctx.prec
    ctx.prec = _BITS
    try:
        drives, of_loop = axis_box(box, gains), axis_gains(gains)
        sensitivities = [_raised(found.max_sensitivity.value * more) for more in _SENSITIVITY]
        phases = [found.phase_margin.value - less for less in _PHASE]
        bound, cells = _first(
            drives,
            _SENSITIVITY_CELLS,
            sensitivities,
            lambda value: sensitivity_claim(of_loop, value),
        )
        stable = bound is not None and nominal_is_stable(drives, of_loop)
        if not stable:
            return ProvenMargins(False, None, None, cells)
        margin, more = _first(
            drives,
            _PHASE_CELLS,
            [value for value in phases if value > 0.0],
            lambda value: phase_claim(of_loop, value),
        )
    finally:
        ctx.prec = before
    return ProvenMargins(True, bound, margin, cells + more)


def _raised(value: float) -> float:
    """A bound of M_s with three decimals, none smaller."""
    return math.ceil(1e3 * value) / 1e3


def _first(
    box: AxisBox, most: int, values: Sequence[float], claim: Callable[[float], Claim]
) -> tuple[float | None, int]:
    """The first of some bounds that is proven, and the cells that it took."""
    cells = 0
    for value in values:
        decision = decide(claim(value), box, most)
        cells += decision.cells
        if decision.outcome == "proven":
            return value, cells
    return None, cells


# Bounds of M_s and of the phase margin, each proven over the cells of a box or refuted at a drive.
#
#     M_s <= M             where  M^2 |D_cl|^2 - |D_ol|^2 >= 0 everywhere
#   phase margin >= m    where nowhere |D_cl - D_ol| = |D_ol| with |D_cl|^2 < 4 sin^2(m/2) |D_ol|^2
#
# A cell that the Bernstein coefficients do not decide is halved. The arithmetic is rational but for
# the exponential of the winding, which is enclosed; nothing is rounded to nearest.

Outcome = Literal["proven", "refuted", "open"]
_FREQUENCIES = np.linspace(0.0, 1.0, 5)

# Shares of a cell's sides at which a drive may refute a claim.
_DRIVES = ((0.5, 0.5), (0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))


@dataclass(frozen=True, slots=True)
class Decision:
    """What became of a claim, and how many cells that took."""

    outcome: Outcome
    cells: int


@dataclass(frozen=True, slots=True)
class Claim:
    """A cell is decided where one of these polynomials is never negative on it.

    A point where all are negative refutes the claim.
    """

    alternatives: tuple[Terms, ...]


def sensitivity_claim(gains: AxisGains, bound: float) -> Claim:
    """M_s is at most a bound."""
    square = rational(bound) ** 2
    return Claim((weighted((square, gains.closed_squared()), (-1, gains.open_squared())),))


def phase_claim(gains: AxisGains, margin: float) -> Claim:
    """The phase margin is at least ``margin`` in rad.

    Where |L| < 1 or |L| > 1 all over a cell there is no crossover; elsewhere |1 + L| must be large.
    """
    from flint import arb

    share = (4 * (arb(margin) / 2).sin() ** 2).upper().fmpq()
    opened, control = gains.open_squared(), gains.control_squared()
    far = weighted((1, gains.closed_squared()), (-share, opened))
    below, above = weighted((1, opened), (-1, control)), weighted((1, control), (-1, opened))
    return Claim((far, below, above))


def decide(claim: Claim, box: AxisBox, most: int) -> Decision:
    """Halve cells until each is decided, a drive refutes the claim, or there are too many.

    Args:
        claim: What is claimed of every drive at every frequency.
        box: The drives.
        most: Most cells that are looked at.
    """
    tables = [tabled(terms) for terms in claim.alternatives]
    queue: list[tuple[float, int, Cell]] = [(0.0, 0, box.root())]
    for count in range(most):
        if not queue:
            return Decision("proven", count)
        cell = heapq.heappop(queue)[-1]
        kept = box.contracted(cell)
        if kept is None:
            continue
        found = _examined(tables, box, kept)
        if found.worst >= 0.0:
            continue
        if len(tables) == 1 and _refuted(tables[0], box, kept):
            return Decision("refuted", count + 1)
        for side, half in enumerate(kept.halves(found.widest)):
            heapq.heappush(queue, (found.worst, 2 * count + side, half))
    return Decision("open", most)


@dataclass(frozen=True, slots=True)
class _Examined:
    """Least coefficient over their spread (0 where the cell is decided), and where to cut."""

    worst: float
    widest: str


def _examined(tables: list[fmpq_mat], box: AxisBox, cell: Cell) -> _Examined:
    a, gamma = box.sampled(cell.b, cell.s)
    left, right = bases(cell.c, a, gamma)
    best: tuple[float, fmpq_mat] | None = None
    for table in tables:
        coefficients = left * table * right
        entries = coefficients.entries()
        least = min(entries)
        if least >= 0:
            return _Examined(0.0, "")
        share = float(least / (max(entries) - least)) if max(entries) > least else -math.inf
        if best is None or share > best[0]:
            best = share, coefficients
    assert best is not None
    return _Examined(best[0], _widest(best[1], box, cell))


def _widest(coefficients: fmpq_mat, box: AxisBox, cell: Cell) -> str:
    """The parameter along which the coefficients change most; a and gamma change with b and s."""
    block = np.array([float(value) for value in coefficients.entries()]).reshape(POWERS)
    steps = [float(np.max(np.abs(np.diff(block, axis=axis)))) for axis in range(3)]
    (b_low, b_high), (s_low, s_high) = ((float(x), float(y)) for x, y in (cell.b, cell.s))
    b, s, rho = 0.5 * (b_low + b_high), 0.5 * (s_low + s_high), float(box.rho)
    turn = (b_high - b_low) * abs(s), (s_high - s_low) * b
    fall = math.exp(-rho * b * s)
    grow = (b_high - b_low) * fall, (s_high - s_low) * 0.5 * rho * b * b * fall
    of_b = steps[1] * _share(*turn) + steps[2] * _share(*grow)
    of_s = steps[1] * _share(turn[1], turn[0]) + steps[2] * _share(grow[1], grow[0])
    sizes = {"c": steps[0], "b": of_b, "s": of_s}
    return max(sizes, key=lambda name: sizes[name])


def _share(part: float, rest: float) -> float:
    return part / (part + rest) if part + rest > 0.0 else 0.0


def _refuted(table: fmpq_mat, box: AxisBox, cell: Cell) -> bool:
    """Whether a drive of the cell makes the polynomial negative, in rational numbers."""
    block = np.array([float(value) for value in table.entries()]).reshape(POWERS)
    c = np.array([float(end) for end in cell.c]) @ np.stack([1.0 - _FREQUENCIES, _FREQUENCIES])
    for share in _DRIVES:
        drive = box.drive(cell, share)
        if drive is None:
            continue
        a, gamma = box.sampled((drive[0], drive[0]), (drive[1], drive[1]))
        along_c = block @ float(gamma[0]) ** np.arange(3) @ float(a[0]) ** np.arange(3)
        values = np.polynomial.polynomial.polyval(c, along_c)
        if np.min(values) >= 0.0:
            continue
        at = rational(float(c[np.argmin(values)]))
        left, right = bases((at, at), a, gamma)
        if max((left * table * right).entries()) < 0:
            return True
    return False


# The box of one axis in two parameters, and how it is cut into cells, in rational numbers.
#
# The sampled loop of one axis knows its drive by two numbers without unit,
#
#   b = g L'/L,        s = (R/R' + dead time)/g,        rho = s rho' b = R t_s/L,   rho' = R' t_s/L'
#
# with the design's R' and L', the plant's R and L and the gain g of its voltage. A dead time t_e
# adds a resistance in proportion to g, which stays in s as a constant. The same g is in both: a
# cell of (b, s) belongs to the box where an interval of g is left, and is cut to what that interval
# allows.

Interval = tuple["fmpq", "fmpq"]

# Ends of cells are rounded outwards to multiples of its inverse, so that they stay short.
_FRACTION = 2**56


def rational(value: float) -> fmpq:
    """A double as the rational number that it is."""
    from flint import fmpq

    return fmpq(*value.as_integer_ratio())


def _down(value: fmpq) -> fmpq:
    from flint import fmpq

    return fmpq((value * _FRACTION).floor(), _FRACTION)


def _outwards(low: fmpq, high: fmpq) -> Interval:
    return _down(low), -_down(-high)


def _both(one: Interval, other: Interval) -> Interval:
    return max(one[0], other[0]), min(one[1], other[1])


@dataclass(frozen=True, slots=True)
class Cell:
    """Intervals of c = cos(omega t_s), b and s."""

    c: Interval
    b: Interval
    s: Interval

    def halves(self, name: str) -> tuple[Cell, Cell]:
        """Cut in the middle of one of its intervals."""
        low, high = getattr(self, name)
        middle = (low + high) / 2
        ends = {key: getattr(self, key) for key in ("c", "b", "s")}
        return Cell(**ends | {name: (low, middle)}), Cell(**ends | {name: (middle, high)})


@dataclass(frozen=True, slots=True)
class AxisBox:
    """All drives of one axis.

    Args:
        rho: R' t_s/L' of the design.
        resistance, inductance, gain: Intervals of R/R' without dead time, of L/L' and of g.
        dead_time: Interval of what the dead time adds to s.
    """

    rho: fmpq
    resistance: Interval
    inductance: Interval
    gain: Interval
    dead_time: Interval

    def root(self) -> Cell:
        """The cell around all drives and frequencies."""
        from flint import fmpq

        b = self.gain[0] / self.inductance[1], self.gain[1] / self.inductance[0]
        s = (
            self.resistance[0] / self.gain[1] + self.dead_time[0],
            self.resistance[1] / self.gain[0] + self.dead_time[1],
        )
        return Cell((fmpq(-1), fmpq(1)), _outwards(*b), _outwards(*s))

    def _gains(self, cell: Cell) -> Interval | None:
        """The gains g that drives of a cell may have, None where there are none."""
        by_b = cell.b[0] * self.inductance[0], cell.b[1] * self.inductance[1]
        low, high = _both(self.gain, by_b)
        least, most = cell.s[0] - self.dead_time[1], cell.s[1] - self.dead_time[0]
        if most <= 0:
            return None
        low = max(low, self.resistance[0] / most)
        high = min(high, self.resistance[1] / least) if least > 0 else high
        return (low, high) if low <= high else None

    def contracted(self, cell: Cell) -> Cell | None:
        """The cell cut to what drives of the box can reach, None where there is no drive."""
        gain = self._gains(cell)
        if gain is None:
            return None
        b = _both(cell.b, _outwards(gain[0] / self.inductance[1], gain[1] / self.inductance[0]))
        low = self.resistance[0] / gain[1] + self.dead_time[0]
        high = self.resistance[1] / gain[0] + self.dead_time[1]
        s = _both(cell.s, _outwards(low, high))
        return Cell(cell.c, b, s) if b[0] <= b[1] and s[0] <= s[1] else None

    def drive(self, cell: Cell, share: tuple[float, float]) -> tuple[fmpq, fmpq] | None:
        """(b, s) of a drive of the box at shares of a cell's sides, or as near as there is one."""
        gain = self._gains(cell)
        if gain is None:
            return None
        of_b, of_s = (rational(value) for value in share)
        g = (gain[0] + gain[1]) / 2
        b = cell.b[0] + of_b * (cell.b[1] - cell.b[0])
        s = cell.s[0] + of_s * (cell.s[1] - cell.s[0])
        b = min(max(b, g / self.inductance[1]), g / self.inductance[0])
        low, high = (self.resistance[side] / g + self.dead_time[side] for side in (0, 1))
        return b, min(max(s, low), high)

    def sampled(self, b: Interval, s: Interval) -> tuple[Interval, Interval]:
        """Intervals of a = exp(-rho) and gamma = b (1 - a)/rho, rounded outwards.

        gamma is the integral of exp(-s rho' b') over b' from 0 to b: it rises in b and falls in s,
        for either sign of s.
        """
        products = [x * y for x in b for y in s]
        a = _exponential(-self.rho * max(products))[0], _exponential(-self.rho * min(products))[1]
        return a, (self._share(b[0], s[1])[0], self._share(b[1], s[0])[1])

    def _share(self, b: fmpq, s: fmpq) -> Interval:
        from flint import arb

        rho = self.rho * b * s
        return _ends(arb(b) if rho == 0 else -arb(b) * (-arb(rho)).expm1() / arb(rho))


def _exponential(value: fmpq) -> Interval:
    from flint import arb

    return _ends(arb(value).exp())


def _ends(ball: object) -> Interval:
    return ball.lower().fmpq(), ball.upper().fmpq()  # type: ignore[attr-defined]


# What a bound of a margin says, as a polynomial that must not be negative.
#
# With a = exp(-rho), gamma = b (1 - a)/rho and c = cos(omega t_s) the loop of one axis is
#
#     D_ol = z (z - 1) (z - a),      D_cl = D_ol + gamma ((p + q) z - p),      z = exp(j omega t_s)
#
# p = kp t_s/L', q = ki t_s^2/L'; sensitivity D_ol/D_cl, open loop (D_cl - D_ol)/D_ol. Squares of
# the moduli are polynomials in c (degree 3), a (2) and gamma (2). Those have their values between
# the least and the largest of their 36 Bernstein coefficients over a cell.

POWERS = (4, 3, 3)  # Coefficients along c, a and gamma.
Terms = dict[tuple[int, int, int], "fmpq"]


@dataclass(frozen=True, slots=True)
class AxisGains:
    """p = kp t_s/L' and q = ki t_s^2/L', without unit."""

    p: fmpq
    q: fmpq

    def open_squared(self) -> Terms:
        """|D_ol|^2 = (2 - 2 c) (1 + a^2 - 2 a c)."""
        from flint import fmpq

        numbers = {(0, 0): 2, (0, 2): 2, (1, 0): -2, (1, 1): -4, (1, 2): -2, (2, 1): 4}
        return {(i, j, 0): fmpq(value) for (i, j), value in numbers.items()}

    def cross(self) -> Terms:
        """Real part of gamma conj(D_ol) ((p + q) z - p), as cos 3x = 4 c^3 - 3 c."""
        p, q = self.p, self.q
        numbers = {
            (0, 0): -(2 * p + q),
            (0, 1): q,
            (1, 0): 2 * p - q,
            (1, 1): -(2 * p + q),
            (2, 0): 2 * (2 * p + q),
            (2, 1): 2 * p,
            (3, 0): -4 * p,
        }
        return {(i, j, 1): value for (i, j), value in numbers.items()}

    def control_squared(self) -> Terms:
        """Square of gamma |(p + q) z - p|."""
        p, total = self.p, self.p + self.q
        return {(0, 0, 2): total * total + p * p, (1, 0, 2): -2 * total * p}

    def closed_squared(self) -> Terms:
        """|D_cl|^2."""
        return weighted((1, self.open_squared()), (2, self.cross()), (1, self.control_squared()))


def weighted(*parts: tuple[fmpq | int, Terms]) -> Terms:
    """Sum of polynomials, each times a number."""
    total: Terms = {}
    for factor, terms in parts:
        for powers, value in terms.items():
            total[powers] = total.get(powers, 0) + factor * value
    return total


def tabled(terms: Terms) -> fmpq_mat:
    """Coefficients as a matrix: a row per power of c, a column per power of a and gamma."""
    from flint import fmpq, fmpq_mat

    rows, columns = POWERS[0], POWERS[1] * POWERS[2]
    entries = [fmpq(0)] * (rows * columns)
    for (i, j, k), value in terms.items():
        entries[i * columns + j * POWERS[2] + k] = value
    return fmpq_mat(rows, columns, entries)


def _of_two(low: fmpq, high: fmpq) -> list[list[fmpq]]:
    """Bernstein coefficients of 1, t, t^2 over an interval, a row each per coefficient."""
    return [
        [1, low, low * low],
        [1, (low + high) / 2, low * high],
        [1, high, high * high],
    ]


def _of_three(low: fmpq, high: fmpq) -> list[list[fmpq]]:
    """The same of 1, t, t^2, t^3."""
    return [
        [1, low, low**2, low**3],
        [1, (2 * low + high) / 3, (low * low + 2 * low * high) / 3, low * low * high],
        [1, (low + 2 * high) / 3, (2 * low * high + high * high) / 3, low * high * high],
        [1, high, high**2, high**3],
    ]


def bases(c: Interval, a: Interval, gamma: Interval) -> tuple[fmpq_mat, fmpq_mat]:
    """What turns `tabled` coefficients into those of Bernstein over a cell, from left and right."""
    from flint import fmpq_mat

    of_a, of_gamma = _of_two(*a), _of_two(*gamma)
    right = [
        [of_a[i][j] * of_gamma[k][n] for i in range(3) for k in range(3)]
        for j in range(3)
        for n in range(3)
    ]
    left = _of_three(*c)
    return (
        fmpq_mat(4, 4, [value for row in left for value in row]),
        fmpq_mat(9, 9, [value for row in right for value in row]),
    )
