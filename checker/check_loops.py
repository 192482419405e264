"""Confirms `<prefix>_stability.json`: both current loops of `<prefix>.h` over the tolerances.

    python -I -S check_loops.py abb2k2_stability.json

The program imports nothing but the standard library, calculates in integers and fractions alone,
and believes nothing in the certificate: the gains are read from the header's text, cells are cut
from the box here, and a matrix of the certificate counts only where it does what it should. Read it
from top to bottom: matrices (part 1), the header (part 2), the loop of a drive (part 3), a cell
(part 4), the box (part 5), and what is printed (part 6). It ends with 0 where all is confirmed,
else with 1 and the place where it is not.
"""

from __future__ import annotations

import itertools
import json
import re
import sys
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import Any


class Fault(Exception):
    """What is not confirmed, in words, with its place."""


# Part 1. Matrices of integers in units of 2^-BITS.
#
# A Block encloses a matrix: every entry of it lies within r units of that of rows.

BITS = 160
ONE = 1 << BITS
Rows = list[list[int]]


class Block:
    """Entries ``rows`` and their common radius ``r``, in units of 2^-BITS."""

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


def unit(size: int) -> Block:
    """The unit matrix."""
    return Block([[ONE if i == j else 0 for j in range(size)] for i in range(size)])


def exponential(block: Block) -> Block:
    """The exponential: its series, until all that follows is below two units.

    Term n is at most h^n/n! with h the norm; from n = 2 h on each is at most half the one before.
    """
    size, h = len(block.rows), block.norm()
    if h > 16 * ONE:
        raise Fault("a loop turns or decays too much in one sample")
    total, term, bound, n = unit(size), unit(size), ONE, 0
    while bound > 2 or n * ONE < 2 * h:
        n += 1
        term = term * block
        term = Block([[x // n for x in row] for row in term.rows], term.r // n + 2)
        bound = (bound * h >> BITS) // n + 2 if bound > 2 else bound
        rows = [[x + y for x, y in zip(*pair)] for pair in zip(total.rows, term.rows)]
        total = Block(rows, total.r + term.r)
    return Block(total.rows, total.r + bound)


def fixed(value: Fraction) -> int:
    """A rational in units, rounded down; it is off by less than one."""
    return (value.numerator << BITS) // value.denominator


def above(value: Fraction) -> int:
    """A rational in units, rounded up."""
    return -((-value.numerator << BITS) // value.denominator)


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


# Part 2. The header: its constants and what its comments say.


def single(value: Fraction) -> Fraction:
    """The nearest number of single precision, ties to even."""
    if value == 0:
        return value
    exponent = abs(value.numerator).bit_length() - value.denominator.bit_length()
    if Fraction(2) ** exponent > abs(value):
        exponent -= 1
    step = Fraction(2) ** max(exponent - 23, -149)
    return round(value / step) * step


class Header:
    """Constants of a header, and the words of the comments of all that belong to it."""

    def __init__(self, text: str, prefix: str, further: str = "") -> None:
        self.prefix = prefix
        comments = re.findall(r"/\*.*?\*/", text + further, re.S)
        self.said = " ".join(re.sub(r"\s+\*?\s*", " ", comment) for comment in comments)
        code = re.sub(r"/\*.*?\*/|//[^\n]*", " ", text, flags=re.S)
        self.constants: dict[str, Fraction] = {}
        if re.search(r"^\s*#\s*undef", code, re.M):
            raise Fault("the header takes a constant back")
        for name, value in re.findall(
            r"^\s*#\s*define\s+(\w+)\s+\((-?[\d.]+(?:[eE][-+]?\d+)?[Ff]?)\)\s*$", code, re.M
        ):
            if len(re.findall(rf"#\s*define\s+{name}\b", code)) != 1:
                raise Fault(f"{name} is defined twice")
            digits = value.rstrip("Ff")
            number = Fraction(digits)
            self.constants[name] = number if digits == value else single(number)

    def constant(self, name: str) -> Fraction:
        """A constant by its name without the prefix."""
        full = f"{self.prefix.upper()}_{name}"
        if full not in self.constants:
            raise Fault(f"the header has no {full}")
        return self.constants[full]


# Constants that the loop is made of, with the inputs of the certificate that must be the same.
CONSTANTS = (
    ("t_s", None, "T_S_S"),
    ("kp", 0, "ID_KP_V_PER_A"),
    ("kp", 1, "IQ_KP_V_PER_A"),
    ("ki_ts", 0, "ID_KI_TS_V_PER_A"),
    ("ki_ts", 1, "IQ_KI_TS_V_PER_A"),
    ("decoupling", 0, "L_D_H"),
    ("decoupling", 1, "L_Q_H"),
)
PAIRS = ("kp", "ki_ts", "decoupling", "r_s", "dead_time", "l_d", "l_q", "gain")
LAW = (
    r"PI controller of {axis}: [^/]*?d\[k\] = d\[k-1\] \+ kp \(e\[k\] - e\[k-1\]\) \+ ki_ts e\[k\]"
)
STATED = re.compile(
    r"Both current loops together: proven stable for every drive in the box at every constant "
    r"speed up to (?P<rpm>\S+) rpm either way \([^)]*\): resistance (?P<r_s>.+?) Ohm, (?:dead time "
    r"worth (?P<dead_time>.+?) Ohm, )?l_d (?P<l_d>.+?) mH, l_q (?P<l_q>.+?) mH, voltage gain "
    r"(?P<gain>.+?), each constant;"
)
BOUNDED = re.compile(
    r"Sensitivity of both axes together up to [^;]*; proven below (\S+), so that voltages"
)
# Ranges of the drives, with how they are called, their unit, and how often it is in the header's.
RANGES = {
    "r_s": ("resistance", " Ohm", 1),
    "dead_time": ("dead time worth", " Ohm", 1),
    "l_d": ("l_d", " H", 1000),
    "l_q": ("l_q", " H", 1000),
    "gain": ("voltage gain", "", 1),
}


def near(text: str, value: Fraction) -> bool:
    """Whether a number of four digits is this one, rounded."""
    shown = Fraction(text)
    return abs(shown - value) * 1999 <= abs(value)


class Box:
    """The control of the header, and the drives that the certificate is about."""

    def __init__(self, inputs: dict[str, Any], header: Header) -> None:
        if set(inputs) != {*PAIRS, "t_s", "omega_e"}:
            raise Fault("inputs: they are not those of a box of drives")
        for name in PAIRS:
            if len(inputs[name]) != 2:
                raise Fault(f"inputs, {name}: it is no pair")
        found: dict[str, list[Fraction]] = {"t_s": [], "kp": [], "ki_ts": [], "decoupling": []}
        for name, place, constant in CONSTANTS:
            stated = inputs[name] if place is None else inputs[name][place]
            found[name].append(header.constant(constant))
            if single(Fraction(stated)) != found[name][-1]:
                raise Fault(f"inputs, {name}: the header has another {constant}")
        # What runs is what the header has: its constants count, not those of the certificate.
        self.t_s, self.kp, self.ki_ts = found["t_s"][0], found["kp"], found["ki_ts"]
        self.decoupling = found["decoupling"]
        self.ranges = {name: [Fraction(end) for end in inputs[name]] for name in RANGES}
        self.omega_e = Fraction(inputs["omega_e"])
        self.pole_pairs = header.constant("POLE_PAIRS")
        for name, (low, high) in self.ranges.items():
            if low > high or (name != "dead_time" and low < 0):
                raise Fault(f"inputs, {name}: it ends before it begins, or is negative")
        if min(self.ranges[name][0] for name in ("l_d", "l_q", "gain")) <= 0:
            raise Fault("inputs: an inductance or the gain is not positive")
        if min(self.t_s, *self.decoupling, self.pole_pairs) <= 0 or self.omega_e < 0:
            raise Fault("inputs: a period, inductance or speed is not positive")
        self.rho = [self.t_s / inductance for inductance in self.decoupling]
        self._law(header)
        self.promised = self._promised(header)

    def _law(self, header: Header) -> None:
        """The control must be the one that part 3 has."""
        for axis in ("i_d", "i_q"):
            if not re.search(LAW.format(axis=axis), header.said):
                raise Fault(f"the header states another law of {axis}")
        for words in ("v_q += omega_e (L_D i_d + PSI_PM)", "v_d -= omega_e L_Q i_q"):
            if words not in header.said:
                raise Fault(f"the header does not decouple by {words}")

    def _promised(self, header: Header) -> bool:
        """Whether the header says of every drive of this box that it is stable."""
        said = STATED.search(header.said)
        if said is None:
            return False
        rpm = self.omega_e / self.pole_pairs * 30 / Fraction("3.14159265358979323846")
        if not near(said["rpm"], rpm):
            raise Fault(f"the header states {said['rpm']} rpm, the certificate {float(rpm):.6g}")
        for name, (_, _, scale) in RANGES.items():
            words = said[name] or "0"
            shown = words.split(" to ") if " to " in words else [words, words]
            for text, end in zip(shown, self.ranges[name]):
                if not near(text, end * scale):
                    raise Fault(f"the header states another {name} ({words}) than the certificate")
        return True

    def words(self) -> str:
        """The drives, in words."""
        parts = []
        for name, words in RANGES.items():
            low, high = (f"{float(end):.6g}" for end in self.ranges[name])
            parts.append(f"{words[0]} {low} to {high}{words[1]}")
        return (
            f"{', '.join(parts)}, each constant, at every constant speed up to "
            f"{float(self.omega_e):.6g} rad/s electrical ({float(self.pole_pairs):g} pole pairs), "
            "either way"
        )


# Part 3. The loop of a drive.
#
# With psi the flux linkages of the currents, v the voltage, g its gain and phi = psi/(g t_s), of
# both axes in rotor coordinates, dphi/dt t_s = F phi + v' with
#
#     F = [-s rho_d b_d, x; -x, -s rho_q b_q]     s = R/g + c    b_a = g L'_a/L_a    x = omega t_s
#     rho_a = t_s/L'_a                            (R t_s/L_a = s rho_a b_a; c: dead time at gain 1)
#
# and currents i_a = b_a rho_a phi_a. A voltage v, turned ahead by 1.5 samples, stands still in the
# stator from k to k+1 while the rotor turns by x: seen from the rotor at u samples after k, it is
# exp(W (u - 1/2)) v, W = x [0, 1; -1, 0]. So phi+ = Phi phi + Gam v with
#
#     Phi = exp(F)        Gam = integral of exp(F (1-u)) exp(W u) du exp(-W/2)
#
# The control measures i, decouples with L' and adds a PI, whose voltage acts a sample later:
#
#     v+ = K phi + I      K = [-(kp_d + ki_d) rho_d b_d, -x b_q; x b_d, -(kp_q + ki_q) rho_q b_q]
#     I+ = I - [ki_d rho_d b_d, 0; 0, ki_q rho_q b_q] phi           (ki times t_s)
#
# Magnet, references and disturbances move no pole. Mirrored in d the loop is that of -x: x >= 0 is
# enough. In the exponential of [F, 1; 0, W] Phi is at the upper left, the integral beside it.

Point = tuple[Fraction, ...]


def loop_of(box: Box, point: Point) -> Block:
    """The loop of the drive b_d, b_q, s, x: phi+, v+, I+ of phi, v, I, each of (d, q)."""
    b_d, b_q, s, x = point
    turn, decay = fixed(x), [fixed(-s * rho * b) for rho, b in zip(box.rho, (b_d, b_q))]
    held = exponential(
        Block(
            [
                [decay[0], turn, ONE, 0],
                [-turn, decay[1], 0, ONE],
                [0, 0, 0, turn],
                [0, 0, -turn, 0],
            ],
            1,
        )
    )
    half = fixed(-x / 2)
    integral = Block([row[2:] for row in held.rows[:2]], held.r)
    gamma = integral * exponential(Block([[0, half], [-half, 0]], 2))
    both = [(kp + ki) * rho for kp, ki, rho in zip(box.kp, box.ki_ts, box.rho)]
    own = [ki * rho for ki, rho in zip(box.ki_ts, box.rho)]
    rows = [
        [*held.rows[0][:2], *gamma.rows[0], 0, 0],
        [*held.rows[1][:2], *gamma.rows[1], 0, 0],
        [fixed(-both[0] * b_d), fixed(-x * b_q), 0, 0, ONE, 0],
        [fixed(x * b_d), fixed(-both[1] * b_q), 0, 0, 0, ONE],
        [fixed(-own[0] * b_d), 0, 0, 0, ONE, 0],
        [0, fixed(-own[1] * b_q), 0, 0, 0, ONE],
    ]
    return Block(rows, max(held.r, gamma.r, 1))


def disturbed(loop: Block) -> Block:
    """[A, B; C, 1]: a disturbance w of v, and the voltage v + w that then results."""
    rows = [[*row, 0, 0] for row in loop.rows]
    rows[2][6] = rows[3][7] = ONE
    rows += [[*loop.rows[2], ONE, 0], [*loop.rows[3], 0, ONE]]
    return Block(rows, loop.r)


# Part 4. A cell: least and largest b_d, b_q, s and x.
#
# A function f of one parameter differs from the straight line between the ends of an interval of
# width w by at most w^2/8 times its largest second derivative. Taken in one parameter after the
# other (the weights in between are positive and add up to one): a matrix over the cell is a mean of
# those in the corners, and a rest of at most the sum over parameters. K and the rows of I have no
# rest, being straight in each. F is straight in each parameter, with slope D of norm n at most,
#
#     n = s rho_d,  s rho_q,  max(rho b),  1          of b_d, b_q, s, x
#
# so that exp(F) has second derivative 2 exp(F ..) D exp(F ..) D exp(F ..), integrated over half a
# square: n^2 at most where exp(F u) does not grow, which it does by exp(r), r = -s max(rho b), with
# a negative resistance (F + F' is diagonal). In Gam it is the mean of (1-u)^2 n^2, a third; for x,
# where W turns as well, that of (1 - u + |u - 1/2|)^2, two thirds. Hence, times exp(r),
#
#     |rest of Phi| <= a = sum (w n)^2/8      |rest of Gam| <= c = sum of b_d, b_q, s (w n)^2/24
#                                                                  + (w of x)^2/12
#
# Now P > 0 proves the cell if P - (A + U E)' P (A + U E) > 0 in all corners A, with U E the rest in
# the rows of phi: the mean of the corners then falls too, as the form is convex in A. With e = E z:
# |e|^2 <= (a |phi| + c |v|)^2 <= (a + c)(a |phi|^2 + c |v|^2) = z' N z, and for any t > 0
#
#     2 e' U' P A z <= t |U' P A z|^2 + |e|^2/t,      e' U' P U e <= l |e|^2
#
# with l the larger eigenvalue of U' P U. So it is enough that
#
#     P - A' (P + t P U U' P) A - (1/t + l) N > 0
#
# which is decided by its minors. For a sensitivity below M the same with [A, B; C, 1] for A,
# diag(P, M^2) for the first P and diag(P, 1) for the others: summed over time, the energy of v + w
# stays below M^2 times that of w.


def rests(box: Box, low: Point, high: Point) -> tuple[Fraction, Fraction]:
    """Bounds a and c of the rests of a cell."""
    steepest = max(box.rho[0] * high[0], box.rho[1] * high[1])
    size = max(abs(low[2]), abs(high[2]))
    slopes = (size * box.rho[0], size * box.rho[1], steepest, Fraction(1))
    squares = [((last - first) * n) ** 2 for first, last, n in zip(low, high, slopes)]
    r = max(Fraction(0), -low[2]) * steepest
    if r >= 1:
        raise Fault("a resistance is too negative")
    slow = sum(squares[:3], Fraction(0))
    growth = 1 / (1 - r)  # not below exp(r)
    return growth * (slow + squares[3]) / 8, growth * (slow / 24 + squares[3] / 12)


class Witness:
    """A matrix P, and whether it proves a cell."""

    def __init__(self, entries: list[Any], bound: Fraction | None) -> None:
        values = iter(fixed(Fraction(entry)) for entry in entries)
        held = [[0] * 6 for _ in range(6)]
        for i, j in itertools.combinations_with_replacement(range(6), 2):
            held[i][j] = held[j][i] = next(values)
        if not positive(held):
            raise Fault("its matrix is not positive definite")
        self.bound = bound
        self.before = held if bound is None else bordered(held, fixed(bound * bound))
        self.after = held if bound is None else bordered(held, ONE)
        p, q, cross = held[0][0], held[1][1], held[0][1]
        self.largest = (p + q + isqrt((p - q) ** 2 + 4 * cross**2) + 2) // 2  # l, rounded up
        self.power = BITS - self.largest.bit_length() - 8  # t = 2^power; what served last

    def proves(self, box: Box, low: Point, high: Point) -> None:
        """Raises with the corner where it does not."""
        a, c = rests(box, low, high)
        weights = (above((a + c) * a), above((a + c) * c))
        for corner in itertools.product(*(sorted({*ends}) for ends in zip(low, high))):
            loop = loop_of(box, corner)
            if self.bound is not None:
                loop = disturbed(loop)
            for step in sorted(range(-24, 25), key=abs):
                if self.falls(loop, weights, self.power + step):
                    self.power += step
                    break
            else:
                place = ", ".join(f"{float(value):.6g}" for value in corner)
                raise Fault(f"its matrix does not prove it at b_d, b_q, s, x = {place}")

    def falls(self, loop: Block, weights: tuple[int, int], power: int) -> bool:
        """The condition at a corner, with t = 2^power."""
        p, rows, size = self.after, loop.rows, len(loop.rows)
        shift = BITS - power
        if shift < 0:
            return False
        q = [
            [
                p[i][j] + ((p[i][0] * p[0][j] + p[i][1] * p[1][j]) >> shift) + int(i == j) * size
                for j in range(size)
            ]
            for i in range(size)
        ]  # not below P + t P U U' P: what is rounded down, the diagonal makes good
        turned = [[sum(map(int.__mul__, line, column)) for column in zip(*rows)] for line in q]
        form = [
            [sum(map(int.__mul__, column, other)) for other in zip(*turned)]
            for column in zip(*rows)
        ]
        # What the radius of the loop can change in a form, and a unit for each rounding below.
        most = max(abs(x) for line in q for x in line)
        change = size**3 * most * (2 * loop.largest() + loop.r) * loop.r
        margin = (change >> (2 * BITS)) + 1 + size
        divisor = (ONE >> power if power >= 0 else ONE << -power) + 1 + self.largest
        lost = [-(-weight * divisor >> BITS) for weight in weights]
        fall = [
            [self.before[i][j] - (form[i][j] >> (2 * BITS)) for j in range(size)]
            for i in range(size)
        ]
        for i in range(size):
            fall[i][i] -= margin + (lost[i // 2] if i < 4 else 0)
        return positive(fall)


def bordered(held: Rows, value: int) -> Rows:
    """diag(P, value, value)."""
    size = len(held)
    return [*([*row, 0, 0] for row in held), [0] * size + [value, 0], [0] * size + [0, value]]


# Part 5. The box: cut into cells that leave nothing out.
#
# A drive has b_a = g L'_a/L_a and s = R/g + c. So a cell can hold drives only with gains
#
#     g >= b_a(low) L_a(low)/L'_a        g <= b_a(high) L_a(high)/L'_a
#     g >= R(low)/(s(high) - c(low))     g <= R(high)/(s(low) - c(high))
#
# and is empty where these leave none; with them it can be made smaller before it is looked at or
# cut further. Its ends are rounded outward.


def reach(box: Box, least: Fraction, most: Fraction) -> list[tuple[Fraction, Fraction]]:
    """How far b_d, b_q and s go with voltage gains between two."""
    (r_low, r_high), (c_low, c_high) = box.ranges["r_s"], box.ranges["dead_time"]
    (d_low, d_high), (q_low, q_high) = box.ranges["l_d"], box.ranges["l_q"]
    d, q = box.decoupling
    return [
        (least * d / d_high, most * d / d_low),
        (least * q / q_high, most * q / q_low),
        (r_low / most + c_low, r_high / least + c_high),
    ]


def shrunk(box: Box, low: Point, high: Point) -> tuple[Point, Point] | None:
    """The part of a cell that can hold drives; None where there are none."""
    least, most = box.ranges["gain"]
    for axis, name in enumerate(("l_d", "l_q")):
        least = max(least, low[axis] * box.ranges[name][0] / box.decoupling[axis])
        most = min(most, high[axis] * box.ranges[name][1] / box.decoupling[axis])
    (r_low, r_high), (c_low, c_high) = box.ranges["r_s"], box.ranges["dead_time"]
    over, under = high[2] - c_low, low[2] - c_high
    if over < 0 or (over == 0 and r_low > 0):
        return None
    if r_low > 0:
        least = max(least, r_low / over)
    if under > 0:
        most = min(most, r_high / under)
    if least > most:
        return None
    ends = reach(box, least, most)
    first = [max(own, other) for own, (other, _) in zip(low, ends)]
    last = [min(own, other) for own, (_, other) in zip(high, ends)]
    return (
        tuple(Fraction(fixed(value), ONE) for value in (*first, low[3])),
        tuple(Fraction(above(value), ONE) for value in (*last, high[3])),
    )


def halves(place: str, low: Point, high: Point, cut: list[Any]) -> list[tuple[Point, Point]]:
    """Both sides of a cut, that below last."""
    axis, value = cut[0], Fraction(cut[1])
    if isinstance(axis, bool) or axis not in (0, 1, 2, 3):
        raise Fault(f"{place}: it is cut in a parameter that there is not")
    if not low[axis] < value < high[axis]:
        raise Fault(f"{place}: its cut lies outside")
    upper = tuple(value if k == axis else end for k, end in enumerate(high))
    lower = tuple(value if k == axis else end for k, end in enumerate(low))
    return [(lower, high), (low, upper)]


def check_tree(box: Box, tree: list[Any], bound: Fraction | None, name: str) -> int:
    """Goes over all cells; how many are left open."""
    ends = [*reach(box, *box.ranges["gain"]), (Fraction(0), box.omega_e * box.t_s)]
    waiting = [(tuple(low for low, _ in ends), tuple(high for _, high in ends))]
    left = 0
    for row, verdict in enumerate(tree):
        if not waiting:
            raise Fault(f"{name}, row {row}: all of the box is cut already")
        low, high = waiting.pop()
        spans = zip(("b_d", "b_q", "s", "x"), low, high)
        span = ", ".join(f"{what} {float(a):.6g} to {float(b):.6g}" for what, a, b in spans)
        place = f"{name}, row {row} ({span})"
        cell = shrunk(box, low, high)
        if verdict == "open":
            left += 1
        elif verdict == "empty":
            if cell is not None:
                raise Fault(f"{place}: it is called empty and holds drives")
        elif isinstance(verdict, list) and len(verdict) == 2:
            waiting += halves(place, *(cell or (low, high)), verdict)
        elif isinstance(verdict, list) and len(verdict) == 21:
            if cell is None:
                continue
            try:
                Witness(verdict, bound).proves(box, *cell)
            except Fault as fault:
                raise Fault(f"{place}: {fault}") from None
        else:
            raise Fault(f"{place}: it is neither cut, empty, open, nor proven")
    if waiting:
        raise Fault(f"{name}: {len(waiting)} cells are left out at its end")
    return left


# Part 6. What is printed.


def check_stability(stated: dict[str, Any], header: Header) -> list[str]:
    """What is confirmed of a certificate, in words."""
    box = Box(stated["inputs"], header)
    left = check_tree(box, stated["tree"], None, "stability")
    if left and box.promised:
        raise Fault(f"stability: the header says it of every drive; {left} cells are left open")
    but = f" but those in {left} cells that are left open" if left else ""
    said = [f"both current loops together are stable for every drive{but} with {box.words()}"]
    bound = BOUNDED.search(header.said)
    sensitivity = stated.get("sensitivity")
    if sensitivity is None:
        if bound is not None:
            raise Fault(f"sensitivity: the header states {bound[1]}, the certificate nothing")
        return said
    most = Fraction(sensitivity["bound"])
    if bound is not None and Fraction(bound[1]) < most and not near(bound[1], most):
        raise Fault(f"sensitivity: the header states {bound[1]}, not {float(most):g}")
    left = check_tree(box, sensitivity["tree"], most, "sensitivity")
    if left:
        raise Fault(f"sensitivity: {left} cells are left open")
    return [
        *said,
        f"the sensitivity of both axes together is below {float(most):g} for all of them",
    ]


def main(arguments: list[str]) -> int:
    """Checks the certificate that is named; the headers lie beside it."""
    if len(arguments) != 1:
        print("write: check_loops.py PREFIX_stability.json")
        return 2
    path = Path(arguments[0])
    try:
        stated = json.loads(path.read_text("utf-8"), parse_float=Fraction)
        prefix = path.name.removesuffix("_stability.json")
        control = path.parent / f"{prefix}_control.h"
        further = control.read_text("utf-8") if control.exists() else ""
        header = Header((path.parent / f"{prefix}.h").read_text("utf-8"), prefix, further)
        print(
            "not covered: limits of the voltage, rounding of the control, drives that change, "
            "inductances that depend on the current, margins of each loop, the speed loop"
        )
        for words in check_stability(stated, header):
            print(f"confirmed: {words}")
    except Fault as fault:
        print(f"not confirmed: {fault}")
        return 1
    except (KeyError, TypeError, ValueError, ArithmeticError, OSError) as fault:
        print(f"not confirmed: the certificate or the header is damaged ({fault!r})")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
