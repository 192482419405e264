"""Confirms `<prefix>_stability.json`: both current loops of `<prefix>.h` over the tolerances.

    python -I -S check_loops.py abb2k2_stability.json

The program imports nothing but the standard library and, beside it, `kit.py` and `cells.py`. It
calculates in integers and fractions alone, and believes nothing in the certificate: the gains are
read from the header's text, cells are cut from the box here, and a matrix of the certificate counts
only where it does what it should. Read it from top to bottom: the header (part 1), the loop of a
drive (part 2), a cell (part 3), the box (part 4), and what is confirmed (part 5).
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import cells, kit
else:  # run alone: they lie beside this one
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import cells
    import kit

BITS, ONE, above, below = kit.BITS, kit.ONE, kit.above, kit.below
Fault = kit.Fault
Block = cells.Block
Header = kit.Header
Cell = cells.Cell
Point = cells.Point
Rows = cells.Rows
Span = cells.Span


# Part 1. The header: its constants and what its comments say.

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
RANGES = ("r_s", "dead_time", "l_d", "l_q", "gain")
BOUNDED = re.compile(
    r"Sensitivity of both axes together up to [^;]*; proven below (\S+), so that voltages"
)


class Box:
    """The control of the header, and the drives that the certificate is about."""

    def __init__(self, inputs: dict[str, Any], header: Header) -> None:
        if set(inputs) != {*(name for name, _, _ in CONSTANTS), *RANGES, "omega_e"}:
            raise Fault("inputs: they are not those of a box of drives")
        found: dict[str, list[Fraction]] = {"t_s": [], "kp": [], "ki_ts": [], "decoupling": []}
        for name, place, constant in CONSTANTS:
            stated = inputs[name] if place is None else inputs[name][place]
            found[name].append(header.same(stated, constant, f"inputs, {name}"))
        # What runs is what the header has: its constants count, not those of the certificate.
        (self.t_s,), self.kp, self.ki_ts, self.decoupling = found.values()
        self.ranges = cells.spans_of(inputs, RANGES)
        self.omega_e = Fraction(inputs["omega_e"])
        self.pole_pairs = header.constant("POLE_PAIRS")
        if min(self.t_s, *self.decoupling, self.pole_pairs) <= 0 or self.omega_e < 0:
            raise Fault("inputs: a period, inductance or speed is not positive")
        self.rho = [self.t_s / inductance for inductance in self.decoupling]
        for axis in ("i_d", "i_q"):
            cells.check_law(header, axis)
        for words in ("v_q += omega_e (L_D i_d + PSI_PM)", "v_d -= omega_e L_Q i_q"):
            if words not in header.said:
                raise Fault(f"the header does not decouple by {words}")
        # Whether the header says of every drive of this box that it is stable.
        said = cells.stated_of(header, self.ranges)
        self.promised = said is not None
        rpm = self.omega_e / self.pole_pairs * 30 / Fraction("3.14159265358979323846")
        if said is not None and not cells.near(said["rpm"], rpm):
            raise Fault(f"the header states {said['rpm']} rpm, the certificate {float(rpm):.6g}")

    def words(self) -> str:
        """The drives, in words."""
        return (
            f"{cells.spoken(self.ranges)}, each constant, at every constant speed up to "
            f"{float(self.omega_e):.6g} rad/s electrical ({float(self.pole_pairs):g} pole pairs), "
            "either way"
        )


# Part 2. The loop of a drive.
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


def loop_of(box: Box, point: Point) -> Block:
    """The loop of the drive b_d, b_q, s, x: phi+, v+, I+ of phi, v, I, each of (d, q)."""
    b_d, b_q, s, x = point
    turn, decay = below(x), [below(-s * rho * b) for rho, b in zip(box.rho, (b_d, b_q))]
    held = cells.exponential(
        [
            [decay[0], turn, ONE, 0],
            [-turn, decay[1], 0, ONE],
            [0, 0, 0, turn],
            [0, 0, -turn, 0],
        ]
    )
    half = below(-x / 2)
    integral = Block([row[2:] for row in held.rows[:2]], held.r)
    gamma = integral * cells.exponential([[0, half], [-half, 0]], 2)
    both = [(kp + ki) * rho for kp, ki, rho in zip(box.kp, box.ki_ts, box.rho)]
    own = [ki * rho for ki, rho in zip(box.ki_ts, box.rho)]
    rows = [
        [*held.rows[0][:2], *gamma.rows[0], 0, 0],
        [*held.rows[1][:2], *gamma.rows[1], 0, 0],
        [below(-both[0] * b_d), below(-x * b_q), 0, 0, ONE, 0],
        [below(x * b_d), below(-both[1] * b_q), 0, 0, 0, ONE],
        [below(-own[0] * b_d), 0, 0, 0, ONE, 0],
        [0, below(-own[1] * b_q), 0, 0, 0, ONE],
    ]
    return Block(rows, max(held.r, gamma.r, 1))


def disturbed(loop: Block) -> Block:
    """[A, B; C, 1]: a disturbance w of v, and the voltage v + w that then results."""
    rows = [[*row, 0, 0] for row in loop.rows]
    rows[2][6] = rows[3][7] = ONE
    rows += [[*loop.rows[2], ONE, 0], [*loop.rows[3], 0, ONE]]
    return Block(rows, loop.r)


# Part 3. A cell: least and largest b_d, b_q, s and x.
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
        held = cells.symmetric(entries, 6)
        self.bound = bound
        self.before = held if bound is None else bordered(held, below(bound * bound))
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
        p, size, shift = self.after, len(loop.rows), BITS - power
        if shift < 0:
            return False
        q = [
            [
                p[i][j] + ((p[i][0] * p[0][j] + p[i][1] * p[1][j]) >> shift) + int(i == j) * size
                for j in range(size)
            ]
            for i in range(size)
        ]  # not below P + t P U U' P: what is rounded down, the diagonal makes good
        divisor = (ONE >> power if power >= 0 else ONE << -power) + 1 + self.largest
        lost = [-(-weight * divisor >> BITS) for weight in weights]
        return cells.falls(self.before, q, loop, [lost[0]] * 2 + [lost[1]] * 2 + [0] * (size - 4))


def bordered(held: Rows, value: int) -> Rows:
    """diag(P, value, value)."""
    size = len(held)
    return [*([*row, 0, 0] for row in held), [0] * size + [value, 0], [0] * size + [0, value]]


# Part 4. The box: cut into cells that leave nothing out.
#
# A drive has b_a = g L'_a/L_a and s = R/g + c. So a cell can hold drives only with gains
#
#     g >= b_a(low) L_a(low)/L'_a        g <= b_a(high) L_a(high)/L'_a
#     g >= R(low)/(s(high) - c(low))     g <= R(high)/(s(low) - c(high))
#
# and is empty where these leave none; with them it can be made smaller before it is looked at or
# cut further. Its ends are rounded outward.


def reach(box: Box, least: Fraction, most: Fraction) -> list[Span]:
    """How far b_d, b_q and s go with voltage gains between two."""
    (r_low, r_high), (c_low, c_high) = box.ranges["r_s"], box.ranges["dead_time"]
    (d_low, d_high), (q_low, q_high) = box.ranges["l_d"], box.ranges["l_q"]
    d, q = box.decoupling
    return [
        (least * d / d_high, most * d / d_low),
        (least * q / q_high, most * q / q_low),
        (r_low / most + c_low, r_high / least + c_high),
    ]


def shrunk(box: Box, low: Point, high: Point) -> Cell | None:
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
    ends = [*reach(box, least, most), (low[3], high[3])]
    found = [
        cells.outward(max(a, first), min(b, last)) for a, b, (first, last) in zip(low, high, ends)
    ]
    return tuple(a for a, _ in found), tuple(b for _, b in found)


def check_tree(box: Box, tree: list[Any], bound: Fraction | None, name: str) -> int:
    """Goes over all cells; how many are left open."""
    ends = [*reach(box, *box.ranges["gain"]), (Fraction(0), box.omega_e * box.t_s)]
    start = tuple(low for low, _ in ends), tuple(high for _, high in ends)
    left = cells.walk(
        tree,
        start,
        ("b_d", "b_q", "s", "x"),
        lambda low, high: shrunk(box, low, high),
        lambda verdict, cell: Witness(verdict, bound).proves(box, *cell),
        name,
    )
    return len(left)


# Part 5. What is confirmed.


def claims(stated: dict[str, Any], beside: kit.Beside) -> Iterator[str]:
    """What is not covered, and each claim that is confirmed, in words."""
    yield (
        "limits of the voltage, rounding of the control, drives that change, "
        "inductances that depend on the current"
    )
    header = Header(beside.text(".h"), beside.prefix, beside.text("_control.h", ""))
    box = Box(stated["inputs"], header)
    left = check_tree(box, stated["tree"], None, "stability")
    if left and box.promised:
        raise Fault(f"stability: the header says it of every drive; {left} cells are left open")
    but = f" but those in {left} cells that are left open" if left else ""
    yield f"both current loops together are stable for every drive{but} with {box.words()}"
    bound = BOUNDED.search(header.said)
    sensitivity = stated.get("sensitivity")
    if sensitivity is None:
        if bound is not None:
            raise Fault(f"sensitivity: the header states {bound[1]}, the certificate nothing")
        return
    most = Fraction(sensitivity["bound"])
    if bound is not None and Fraction(bound[1]) < most and not cells.near(bound[1], most):
        raise Fault(f"sensitivity: the header states {bound[1]}, not {float(most):g}")
    left = check_tree(box, sensitivity["tree"], most, "sensitivity")
    if left:
        raise Fault(f"sensitivity: {left} cells are left open")
    yield f"the sensitivity of both axes together is below {float(most):g} for all of them"


main = kit.program("check_loops", "_stability.json", claims)

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
