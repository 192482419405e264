"""Loops of drives for the programs that confirm them: matrices (part 1), boxes of drives that are
cut into cells (part 2), and what the header says of drives (part 3). It imports nothing but the
standard library and the kit beside it.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable
from fractions import Fraction
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import kit
else:  # run alone: it lies beside this one
    import kit

BITS, ONE, Fault, above, below = kit.BITS, kit.ONE, kit.Fault, kit.above, kit.below
Rows = kit.Rows


# Part 1. Matrices of integers in units of 2^-BITS.
#
# A Block encloses a matrix: every entry of it lies within r units of that of rows.


class Block:
    """Entries ``rows`` and their common radius ``r``, in units."""

    __slots__ = ("r", "rows")

    def __init__(self, rows: Rows, r: int = 0) -> None:
        self.rows, self.r = rows, r

    def largest(self) -> int:
        """No entry has a larger magnitude."""
        return max(abs(x) for row in self.rows for x in row) + self.r

    def norm(self) -> int:
        """No row has a larger sum of magnitudes."""
        return max(sum(abs(x) + self.r for x in row) for row in self.rows)

    def __mul__(self, other: Block) -> Block:
        columns = list(zip(*other.rows))
        rows = [[sum(map(int.__mul__, x, y)) >> BITS for y in columns] for x in self.rows]
        cross = self.largest() * other.r + other.largest() * self.r  # a little more than needed
        return Block(rows, (len(columns) * cross >> BITS) + 2)


def unit(size: int) -> Rows:
    """The unit matrix."""
    return [[ONE if i == j else 0 for j in range(size)] for i in range(size)]


def exponential(rows: Rows, r: int = 1) -> Block:
    """The exponential: its series, until all that follows is below two units.

    Term n is at most h^n/n! with h the norm; from n = 2 h on each is at most half the one before.
    """
    block = Block(rows, r)
    h, bound, n = block.norm(), ONE, 0
    if h > 16 * ONE:
        raise Fault("a loop turns or decays too much in one sample")
    total, term = Block(unit(len(rows))), Block(unit(len(rows)))
    while bound > 2 or n * ONE < 2 * h:
        n += 1
        term = term * block
        term = Block([[x // n for x in row] for row in term.rows], term.r // n + 2)
        bound = (bound * h >> BITS) // n + 2 if bound > 2 else bound
        total = Block(kit.added(total.rows, term.rows), total.r + term.r)
    return Block(total.rows, total.r + bound)


def symmetric(entries: list[Any], size: int) -> Rows:
    """A positive matrix from the rows of its upper triangle."""
    if len(entries) != size * (size + 1) // 2:
        raise Fault("a matrix has not as many entries as it should")
    values = iter(below(Fraction(entry)) for entry in entries)
    held = [[0] * size for _ in range(size)]
    for i, j in itertools.combinations_with_replacement(range(size), 2):
        held[i][j] = held[j][i] = next(values)
    if not positive(held):
        raise Fault("its matrix is not positive definite")
    return held


def positive(rows: Rows) -> bool:
    """Whether a symmetric matrix of integers is positive definite: all leading minors are.

    Elimination without fractions; after each step the pivot is the next minor, exactly.
    """
    rows, before = [list(row) for row in rows], 1
    for k in range(len(rows)):
        pivot = rows[k][k]
        if pivot <= 0:
            return False
        for i in range(k + 1, len(rows)):
            for j in range(i, len(rows)):
                made = (rows[i][j] * pivot - rows[k][i] * rows[k][j]) // before
                rows[i][j] = rows[j][i] = made
        before = pivot
    return True


def fall(before: Rows, after: Rows, step: Block) -> Rows:
    """P - A' Q A, each entry rounded down."""
    columns = list(zip(*step.rows))
    turned = [[sum(map(int.__mul__, line, column)) for column in columns] for line in after]
    return [
        [x + (-sum(map(int.__mul__, column, y)) >> 2 * BITS) for x, y in zip(row, zip(*turned))]
        for row, column in zip(before, columns)
    ]


def falls(before: Rows, after: Rows, step: Block, lost: list[int]) -> bool:
    """Whether P - A' Q A - diag(lost) is positive definite for all A of a block.

    Taken off as well is what the radius of the block can change in the form, and one for each entry
    of P, and of the form, that is rounded by as much.
    """
    size, most = max(len(before), len(after)), max(abs(x) for line in after for x in line)
    change = size**3 * most * (2 * step.largest() + step.r) * step.r
    rows, margin = fall(before, after, step), (change >> 2 * BITS) + 1 + 2 * size
    for i, less in enumerate(lost):
        rows[i][i] -= margin + less
    return positive(rows)


# Part 2. Cells: a box of parameters, cut so that nothing is left out.

Span = tuple[Fraction, Fraction]
Point = tuple[Fraction, ...]
Cell = tuple[Point, Point]  # the least and the largest parameters


def outward(low: Fraction, high: Fraction) -> Span:
    """A span with ends in units, not smaller; a single number stays."""
    return (low, high) if low == high else (Fraction(below(low), ONE), Fraction(above(high), ONE))


def walk(
    tree: list[Any],
    box: Cell,
    names: tuple[str, ...],
    shrunk: Callable[[Point, Point], Cell | None],
    proves: Callable[[list[Any], Cell], None],
    what: str,
) -> list[str]:
    """Goes over the verdicts of all cells; those that are left open, in words.

    A verdict is a cut (parameter and place; the part below comes last), "empty", "open", or what
    proves the cell. Each cell is made smaller first; one that then is nothing holds no drives.
    """
    waiting, left = [box], []
    for row, verdict in enumerate(tree):
        if not waiting:
            raise Fault(f"{what}, row {row}: all of the box is cut already")
        low, high = waiting.pop()
        spans = zip(names, low, high)
        span = ", ".join(f"{name} {float(a):.6g} to {float(b):.6g}" for name, a, b in spans)
        place, cell = f"{what}, row {row} ({span})", shrunk(low, high)
        match verdict:
            case "open":
                left.append(span)
            case "empty":
                if cell is not None:
                    raise Fault(f"{place}: it is called empty and holds drives")
            case [int(axis), (int() | Fraction()) as end]:
                low, high = cell or (low, high)
                if isinstance(axis, bool) or not 0 <= axis < len(names):
                    raise Fault(f"{place}: it is cut in a parameter that there is not")
                if not low[axis] < end < high[axis]:
                    raise Fault(f"{place}: its cut lies outside")
                middle = Fraction(end)
                waiting.append(((*low[:axis], middle, *low[axis + 1 :]), high))
                waiting.append((low, (*high[:axis], middle, *high[axis + 1 :])))
            case [_, *_]:
                try:
                    if cell is not None:
                        proves(verdict, cell)
                except Fault as fault:
                    raise Fault(f"{place}: {fault}") from None
            case _:
                raise Fault(f"{place}: it is neither cut, empty, open, nor proven")
    if waiting:
        raise Fault(f"{what}: {len(waiting)} cells are left out at its end")
    return left


# Part 3. Drives: their ranges, and what the header says of them.

LAW = (
    r"PI controller of {loop}: [^/]*?d\[k\] = d\[k-1\] \+ kp \(e\[k\] - e\[k-1\]\) \+ ki_ts e\[k\]"
)
STATED = re.compile(
    r"Both current loops together: proven stable for every drive in the box at every constant "
    r"speed up to (?P<rpm>\S+) rpm either way \([^)]*\): resistance (?P<r_s>.+?) Ohm, (?:dead time "
    r"worth (?P<dead_time>.+?) Ohm, )?l_d (?P<l_d>.+?) mH, l_q (?P<l_q>.+?) mH, voltage gain "
    r"(?P<gain>.+?), each constant;"
)
# How ranges are called, their unit, and how often it is in the header's; whether above zero.
RANGES = {
    "r_s": ("resistance", " Ohm", 1, False),
    "dead_time": ("dead time worth", " Ohm", 1, False),
    "l_d": ("l_d", " H", 1000, True),
    "l_q": ("l_q", " H", 1000, True),
    "gain": ("voltage gain", "", 1, True),
    "torque": ("torque over what is commanded", "", 1, True),
    "inertia": ("inertia", " kg m^2", 1, True),
    "back_emf": ("back-EMF that the feedforward leaves", " V s/rad", 1, False),
}


def check_law(header: kit.Header, loop: str) -> None:
    """The control of a loop must be the PI controller that is known here."""
    if not re.search(LAW.format(loop=re.escape(loop)), header.said):
        raise Fault(f"the header states another law of {loop}")


def spans_of(inputs: dict[str, Any], names: Iterable[str]) -> dict[str, Span]:
    """The ranges of the drives of a certificate."""
    found = {}
    for name in names:
        low, high = (Fraction(end) for end in inputs[name])
        if low > high:
            raise Fault(f"inputs, {name}: it ends before it begins")
        if (low <= 0 and RANGES[name][3]) or (low < 0 and name == "r_s"):
            raise Fault(f"inputs, {name}: it is not positive")
        found[name] = low, high
    return found


def spoken(spans: dict[str, Span]) -> str:
    """Ranges of drives, in words."""
    parts = []
    for name, ends in spans.items():
        low, high = (f"{float(end):.6g}" for end in ends)
        words, unit, *_ = RANGES[name]
        parts.append(f"{words} {low if low == high else f'{low} to {high}'}{unit}")
    return ", ".join(parts)


def near(text: str, value: Fraction) -> bool:
    """Whether a number of four digits is this one, rounded."""
    shown = Fraction(text)
    return abs(shown - value) * 1999 <= abs(value)


def stated_of(header: kit.Header, spans: dict[str, Span]) -> dict[str, str] | None:
    """What the header says of the drives of both current loops, which must be these; None where it
    says nothing.
    """
    said = STATED.search(header.said)
    for name, words in said.groupdict("0").items() if said else ():
        shown = words.split(" to ") if " to " in words else [words, words]
        if name in spans and not all(
            near(text, end * RANGES[name][2]) for text, end in zip(shown, spans[name])
        ):
            raise Fault(f"the header states another {name} ({words}) than the certificate")
    return said.groupdict("0") if said else None
