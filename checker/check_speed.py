"""Confirms `<prefix>_speed.json`: the speed loop of `<prefix>.h` over the tolerances.

    python -I -S check_speed.py teknic_m2310p_speed.json

The program imports nothing but the standard library and, beside it, `kit.py` and `cells.py`. It
calculates in integers and fractions alone, and believes nothing in the certificate: gains are read
from the header's text, cells are cut from the box here, and a chain of matrices of the certificate
counts only where it does what it should. Read it from top to bottom: the drives (part 1), the loop
of a drive (part 2), a cell (part 3), the box (part 4), and what is confirmed (part 5).
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


# Part 1. The drives: what the header has, and what may deviate.

# Constants that the loop is made of, by what the certificate calls them.
CONSTANTS = {
    "t_s": "T_S_S",
    "kp": "IQ_KP_V_PER_A",
    "ki_ts": "IQ_KI_TS_V_PER_A",
    "speed_kp": "SPEED_KP_NMS_PER_RAD",
    "speed_ki_ts": "SPEED_KI_TS_NMS_PER_RAD",
    "ratio": "SPEED_RATIO",
}
SPANS = ("r_s", "dead_time", "l_q", "gain", "torque", "inertia", "back_emf")
OTHERS = ("friction", "filter_time", "inductance_scale", "speed_scale")
MOST_SAMPLES = 1000
SPEED = "the speed (its output is torque)"
PROMISED = "peed loop: proven stable for every drive in the box"


class Box:
    """The control of the header, and the drives that the certificate is about."""

    def __init__(self, inputs: dict[str, Any], header: Header, control: str = "") -> None:
        if set(inputs) != {*CONSTANTS, *SPANS, *OTHERS}:
            raise Fault("inputs: they are not those of a box of drives")
        # What runs is what the header has: its constants count, not those of the certificate.
        had = {
            name: header.same(inputs[name], constant, f"inputs, {name}")
            for name, constant in CONSTANTS.items()
        }
        self.t_s, self.kp, self.ki_ts, self.speed_kp, self.speed_ki_ts, ratio = had.values()
        self.ratio = int(ratio)
        if ratio != self.ratio or not 1 <= self.ratio <= MOST_SAMPLES:
            raise Fault("inputs, ratio: it is not a number of current samples")
        self.spans = cells.spans_of(inputs, SPANS)
        friction, self.filter_time, *scales = (Fraction(inputs[name]) for name in OTHERS)
        if min(friction, self.filter_time) < 0:
            raise Fault("inputs: the friction or the filter time is negative")
        self.share = Block([[ONE]])  # of a new speed in the filter, 1 - exp(-t_s/T_f)
        if self.filter_time:
            kept = cells.exponential([[below(-self.t_s / self.filter_time)]])
            self.share = Block([[ONE - kept.rows[0][0]]], kept.r)
        if min(self.t_s, *scales) <= 0:
            raise Fault("inputs: the period or a scale is not positive")
        self.friction, (self.unit, self.scale) = friction, scales
        # Torque per ampere is needed only where the speed acts on the current.
        self.per_ampere = Fraction(0)
        if any(self.spans["back_emf"]):
            pairs, flux = header.constant("POLE_PAIRS"), header.constant("PSI_PM_WB")
            self.per_ampere = Fraction(3, 2) * pairs * flux
        for loop in ("i_q", SPEED):
            cells.check_law(header, loop)
        self.promised = PROMISED in header.said
        if control:
            self._as_run(control)

    def _as_run(self, control: str) -> None:
        """The header of the control, where there is one, runs on the same numbers."""
        for words, values in (
            ("i_q: kp, ki t_s", (self.kp, self.ki_ts)),
            ("speed: kp, ki t_s", (self.speed_kp, self.speed_ki_ts)),
            ("speed_filter, ", (Fraction(self.share.rows[0][0], ONE),)),
            ("current samples per speed sample", (Fraction(self.ratio),)),
        ):
            found = re.findall(rf"^ +([{{}} \w.,+-]+),? /\* {re.escape(words)}", control, re.M)
            if len(found) != 1:
                raise Fault(f"the header of the control has not one line of '{words}'")
            numbers = [Fraction(text.rstrip("FU")) for text in found[0].strip("{} ,").split(", ")]
            for had, value in zip(numbers, values):
                if abs(kit.single(had) - kit.single(value)) * 2**22 > abs(value):
                    raise Fault(f"the header of the control has another number in '{words}'")

    def words(self) -> str:
        """The drives, in words."""
        slow = f", speed filtered with {float(self.filter_time):.6g} s" if self.filter_time else ""
        friction = f"friction {float(self.friction):.6g} N m s/rad"
        return f"{cells.spoken(self.spans)}, {friction}{slow}"


# Part 2. The loop of a drive.
#
# With i, R, L, g the q current, resistance, inductance and gain of the voltage, d what the dead
# time adds to R for each g, J the inertia, f the torque made over that commanded, B the friction,
# e_0 what the feedforward leaves of the back-EMF per speed, and K = 3/2 p psi,
#
#     L di/dt = g v - (R + d g) i - e_0 omega       domega/dt = (f K i - B omega)/J
#
# The control measures at every sample and adds a PI for i to reach T/K; its voltage acts a sample
# later. Every ratio-th sample another PI makes the torque T from the speed, or from the speed
# behind a filter of the time T_f, which moves at every sample by the share a = 1 - exp(-t_s/T_f).
# With two free units, L_0 and m, let
#
#     phi = i L/(g t_s)    w = omega/m L_0/(t_s K)    T and S, I: times L_0/(t_s K), and in V
#     b = g L_0/L          s = (R + d g) L_0/L        n = f/J           e = e_0/g
#
# so that per sample, r = t_s/L_0,
#
#     phi' = -s r phi - (e r K m) w + v     w' = (t_s/m) n b phi - (B t_s n/f) w
#     w_f+ = w_f + a (w+ - w_f)             i r-scaled: i = b phi r
#     v+ = I + (kp + ki) r (T - b phi)      I+ = I + ki r (T - b phi)
#     T+ = S - (kp_s + ki_s) m y            S+ = S - ki_s m y          y = w or w_f
#
# the last line every ratio-th sample, before what stands above it. A step of it is the exponential
# of the first lines (v stands still), beside rows that are straight in b.


class Loop:
    """Matrices of the loop, over the states phi, w, (w_f,) v, I, T, S."""

    def __init__(self, box: Box) -> None:
        self.box, self.moving = box, 3 if box.filter_time else 2
        self.size = self.moving + 4
        self.rate = box.t_s / box.unit
        self.emf = self.rate * box.per_ampere * box.scale
        self.push = box.t_s / box.scale
        self.drag = box.friction * box.t_s

    def flow(self, point: Point) -> list[list[Fraction]]:
        """Rows of phi', w' and v' over the same; f = 1 in the friction."""
        b, s, n, e = point
        rows = [[Fraction(0)] * 3 for _ in range(3)]
        rows[0] = [-s * self.rate, -e * self.emf, Fraction(1)]
        rows[1][:2] = self.push * n * b, -self.drag * n
        return rows

    def step(self, point: Point) -> Block:
        """A current sample, from all states to all."""
        k, box = self.moving, self.box
        held = cells.exponential([[below(x) for x in row] for row in self.flow(point)])
        moved = Block(held.rows[:2], held.r)
        if k == 3:
            ((share,),), r = box.share.rows, box.share.r
            moved = Block([[ONE, 0], [0, ONE], [0, share]], r) * moved
            kept = zip(moved.rows, (0, 0, ONE - share))
            moved = Block([[*row[:2], x, row[2]] for row, x in kept], moved.r + r)
        rows = [[*row, 0, 0, 0] for row in moved.rows]
        both, own = (box.kp + box.ki_ts) * self.rate, box.ki_ts * self.rate
        rows += [[below(-gain * point[0]), *[0] * k, ONE, below(gain), 0] for gain in (both, own)]
        rows += [[0] * (k + 2) + [ONE, 0], [0] * (k + 3) + [ONE]]
        return Block(rows, max(moved.r, 1))

    def update(self) -> Block:
        """The speed controller, from all states but T to all."""
        n, box = self.size, self.box
        rows = cells.unit(n - 1)[:-1]
        for gain in (box.speed_kp + box.speed_ki_ts, box.speed_ki_ts):
            row = [0] * (n - 1)
            row[self.moving - 1], row[n - 2] = below(-gain * box.scale), ONE
            rows.append(row)
        return Block(rows, 1)


# Part 3. A cell: least and largest b, s, n and e.
#
# A function of one parameter differs from the straight line between the ends of an interval of
# width w by at most w^2/8 times its largest second derivative. Taken in one parameter after the
# other, a step over the cell is a mean of those in the corners (weights positive, adding up to one)
# and a rest E in the rows of phi, w, w_f: the others are straight in b. The flow F is straight in
# each parameter, with slope D, and exp(F) has the second derivative
#
#     2 integral of exp(F t_1) D exp(F t_2) D exp(F t_3)        t_1 + t_2 + t_3 = 1
#
# Entry by entry it is at most the same of |D| and of M, which beside the diagonal has the largest
# moduli of F and on it the largest values. That integral is the corner of the exponential of
# [M, D, 0; 0, M, D; 0, 0, M]. Friction with f other than 1 changes F by at most C, and exp(F) by
# the corner of the exponential of [M + C, C; 0, M + C].
#
# A cell is proven by matrices P_0 .. P_m > 0, m the ratio, if x' P x falls along the update from
# P_0 to P_1 and along every step from P_k to P_(k+1), the last one from P_m to P_0 (T is then
# forgotten). So the drive may even change within the cell at every sample. The form is convex in
# the step: a mean of corners falls where the corners do. With a = E x in the rows u_r, any t_r > 0
#
#     |(A + E) x|^2_P <= x' A' (P + sum of t_r P u_r u_r' P) A x + sum of (1/t_r + k P_rr) a_r^2
#     a_r^2 <= (sum of E_rc/h_c) (sum of E_rc h_c x_c^2)          for any h_c > 0
#
# by Cauchy's inequality, k being the number of rows. Best are for 1/h_c the length of x_c, for t_r
# that of a_r over that of u_r' P A x, in the form that falls; `inverse` finds these nearly. What is
# left is decided by minors.


def nested(most: Rows, slope: Rows, count: int) -> Rows:
    """Integral of exp(M t_0) D exp(M t_1) .. D exp(M t_count), entry by entry not below it."""
    size = len(most)
    rows = [[0] * (size * (count + 1)) for _ in range(size * (count + 1))]
    for place in range(count + 1):
        for i, j in itertools.product(range(size), repeat=2):
            rows[place * size + i][place * size + j] = most[i][j]
            if place < count:
                rows[place * size + i][(place + 1) * size + j] = slope[i][j]
    found = cells.exponential(rows, 0)
    return [[max(x, 0) + found.r for x in row[-size:]] for row in found.rows[:size]]


def rests(loop: Loop, low: Point, high: Point) -> Rows:
    """Bounds of the entries of E, in rows of phi, w, w_f over these and v."""
    size = 3
    flows = [loop.flow(corner) for corner in itertools.product(*zip(low, high))]
    most = [[0] * size for _ in range(size)]
    for i, j in itertools.product(range(size), repeat=2):
        values = [flow[i][j] for flow in flows]
        most[i][j] = above(max(values) if i == j else max(map(abs, values)))
    (b, _, n, _), zero = high, [[0] * size for _ in range(size)]
    slopes = [[list(row) for row in zero] for _ in range(4)]  # times the width
    wide = [last - first for first, last in zip(low, high)]
    slopes[0][1][0] = above(loop.push * n * wide[0])
    slopes[1][0][0] = above(loop.rate * wide[1])
    slopes[2][1][0], slopes[2][1][1] = (above(x * wide[2]) for x in (loop.push * b, loop.drag))
    slopes[3][0][1] = above(loop.emf * wide[3])
    total, quarter = zero, ONE >> 2
    parts = [(nested(most, slope, 2), quarter) for slope, width in zip(slopes, wide) if width]
    torque = loop.box.spans["torque"]
    uneven = loop.drag * n * max(abs(1 / f - 1) for f in torque)
    if uneven > 0:
        change = [list(row) for row in zero]
        change[1][1] = above(uneven)
        parts.append((nested(kit.added(most, change), change, 1), ONE))
    for rows, factor in parts:
        total = [[x - (-y * factor >> BITS) for x, y in zip(*pair)] for pair in zip(total, rows)]
    if loop.moving == 2:
        return total[:2]
    share = loop.box.share.rows[0][0] + loop.box.share.r
    behind = [-(-x * share >> BITS) for x in total[1]]
    return [[*row[:2], 0, row[2]] for row in (*total[:2], behind)]


class Chain:
    """The matrices of a cell, and whether they prove it."""

    def __init__(self, loop: Loop, listed: list[Any]) -> None:
        if len(listed) != loop.box.ratio + 1:
            raise Fault("it has not a matrix for every sample")
        self.loop = loop
        sizes = [loop.size - 1, *[loop.size] * loop.box.ratio]
        self.matrices = [cells.symmetric(*pair) for pair in zip(listed, sizes)]

    def proves(self, low: Point, high: Point) -> None:
        """Raises with the step and the corner where it does not."""
        loop, ratio, held = self.loop, self.loop.box.ratio, self.matrices
        if not falls(held[0], held[1], loop.update(), []):
            raise Fault("its matrices do not prove the update of the speed controller")
        rest = rests(loop, low, high)
        for corner in itertools.product(*(sorted({*ends}) for ends in zip(low, high))):
            step = loop.step(corner)
            shorter = Block(step.rows[:-2] + step.rows[-1:], step.r)
            for number in range(1, ratio + 1):
                last = number == ratio
                after, taken = (held[0], shorter) if last else (held[number + 1], step)
                if not falls(held[number], after, taken, rest):
                    place = ", ".join(f"{float(value):.6g}" for value in corner)
                    raise Fault(
                        f"its matrices do not prove sample {number} at b, s, n, e = {place}"
                    )


def inverse(rows: Rows) -> Rows:
    """About the inverse of a positive matrix in units; nothing depends on how good it is."""
    size = len(rows)
    wide = [[*row, *one] for row, one in zip(rows, cells.unit(size))]
    for k in range(size):
        pivot = max(wide[k][k], 1)
        wide[k] = [(x << BITS) // pivot for x in wide[k]]
        for i, row in enumerate(wide):
            if i != k:
                wide[i] = [x - (row[k] * y >> BITS) for x, y in zip(row, wide[k])]
    return [row[size:] for row in wide]


def falls(before: Rows, after: Rows, step: Block, rest: Rows) -> bool:
    """The condition of part 3 at a corner."""
    m, k, lost = len(after), len(rest), [0] * len(before)
    q = [[x + (m * k if i == j else 0) for j, x in enumerate(row)] for i, row in enumerate(after)]
    if rest:
        near_to = inverse(cells.fall(before, after, step))
        roots = [isqrt(max(near_to[c][c], 1) << BITS) + 1 for c in range(k + 1)]  # 1/h_c
    for r, row in enumerate(rest):
        own, total = after[r][r], sum(e * root for e, root in zip(row, roots)) + ONE >> BITS
        seen = [sum(map(int.__mul__, after[r], column)) >> BITS for column in zip(*step.rows)]
        turned = [sum(map(int.__mul__, line, seen)) >> BITS for line in near_to]
        cross = isqrt(max(sum(map(int.__mul__, seen, turned)), 1)) + 1
        for i, j in itertools.product(range(m), repeat=2):  # t_r = total/cross
            q[i][j] += after[i][r] * after[r][j] * total // (cross << BITS)
        factor = own * k + (cross << BITS) // total + 1
        for c, (e, root) in enumerate(zip(row, roots)):
            lost[c] += factor * total * e // (root << BITS) + 1
    return cells.falls(before, q, step, lost)


# Part 4. The box: cut into cells that leave nothing out.
#
# g and L are in several parameters. So a cell can hold drives only where, with lengths in turn,
#
#     L between g L_0/b      L between (R + d g) L_0/s      g between b L/L_0      g at most e_0/e
#
# and is empty where these leave none; with them it can be made smaller before it is looked at or
# cut further. Ends are rounded outward.


def common(one: Span, other: Span) -> Span:
    """What both have; crossed where there is nothing."""
    return max(one[0], other[0]), min(one[1], other[1])


def resistances(box: Box, gain: Span) -> Span:
    """R + d g with gains of a span."""
    ends = [d * g for d in box.spans["dead_time"] for g in gain]
    return box.spans["r_s"][0] + min(ends), box.spans["r_s"][1] + max(ends)


def reach(box: Box, gain: Span, inductance: Span) -> Cell:
    """How far b, s, n and e go with gains and inductances of spans."""
    torque, inertia = box.spans["torque"], box.spans["inertia"]
    ohm, emf = resistances(box, gain), [e / g for e in box.spans["back_emf"] for g in gain]
    by_l = [box.unit / side for side in inductance]
    found = [
        (gain[0] * by_l[1], gain[1] * by_l[0]),
        (min(ohm[0] * x for x in by_l), max(ohm[1] * x for x in by_l)),
        (torque[0] / inertia[1], torque[1] / inertia[0]),
        (min(emf), max(emf)),
    ]
    return tuple(low for low, _ in found), tuple(high for _, high in found)


def shrunk(box: Box, low: Point, high: Point) -> Cell | None:
    """The part of a cell that can hold drives; None where there are none."""
    gain, inductance = box.spans["gain"], box.spans["l_q"]
    (b_low, s_low, _, e_low), (b_high, s_high, _, e_high) = low, high
    emf = box.spans["back_emf"]
    if e_low > 0:
        gain = common(gain, (gain[0], emf[1] / e_low))
    if e_high < 0:
        gain = common(gain, (gain[0], emf[0] / e_high))
    for _ in range(3):
        if b_low > 0:
            inductance = common(
                inductance, (gain[0] * box.unit / b_high, gain[1] * box.unit / b_low)
            )
            gain = common(gain, (b_low * inductance[0] / box.unit, gain[1]))
        gain = common(gain, (gain[0], b_high * inductance[1] / box.unit))
        ohm = resistances(box, gain)
        if s_low > 0 or s_high < 0:  # one sign: quotients are ordered
            ends = [r * box.unit / s for r in ohm for s in (s_low, s_high)]
            inductance = common(inductance, (min(ends), max(ends)))
        if gain[0] > gain[1] or inductance[0] > inductance[1]:
            return None
        gain, inductance = cells.outward(*gain), cells.outward(*inductance)
    first, last = reach(box, gain, inductance)
    found = [common(*pair) for pair in zip(zip(low, high), zip(first, last))]
    if any(a > b for a, b in found):
        return None
    found = [cells.outward(*span) for span in found]
    return tuple(a for a, _ in found), tuple(b for _, b in found)


# Part 5. What is confirmed.


def check_speed(stated: dict[str, Any], header: Header, control: str = "") -> str:
    """What is confirmed of a certificate, in words."""
    box = Box(stated["inputs"], header, control)
    if box.promised:  # where the header names the drives of the current loops: the same
        cells.stated_of(header, box.spans)
    loop = Loop(box)
    left = cells.walk(
        stated["tree"],
        reach(box, box.spans["gain"], box.spans["l_q"]),
        ("b", "s", "n", "e"),
        lambda low, high: shrunk(box, low, high),
        lambda verdict, cell: Chain(loop, verdict).proves(*cell),
        "speed loop",
    )
    if left and box.promised:
        raise Fault(f"speed loop: the header says it of every drive; {left[0]} is left open")
    but = f" but those in {len(left)} cells that are left open ({'; '.join(left)})" if left else ""
    return (
        "the speed loop, with the current loop of the q axis that it runs on, is stable for every "
        f"drive{but} with {box.words()}; within a cell they may change at every current sample"
    )


def claims(stated: dict[str, Any], beside: kit.Beside) -> Iterator[str]:
    """What is not covered, and the claim that is confirmed, in words."""
    yield (
        "limits of torque, voltage and current, rounding of the control, the d axis, "
        "margins over the tolerances, the share of "
        "drives that is stated where cells are left open"
    )
    control = beside.text("_control.h", "")
    yield check_speed(stated, Header(beside.text(".h"), beside.prefix, control), control)


main = kit.program("check_speed", "_speed.json", claims)

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
