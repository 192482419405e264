"""Confirms `<prefix>_speed.json`: the speed loop of `<prefix>.h` over the tolerances.

    python -I -S check_speed.py teknic_m2310p_speed.json

The program imports nothing but the standard library and the matrices and the header of
`check_loops.py` beside it (its parts 1 and 2), and calculates in integers and fractions alone. It
believes nothing in the certificate: gains are read from the header's text, cells are cut from the
box here, and a chain of matrices of the certificate counts only where it does what it should. Read
it from top to bottom: the drives (part 1), the loop of a drive (part 2), a cell (part 3), the box
(part 4), and what is printed (part 5). It ends with 0 where all is confirmed, else with 1 and the
place where it is not.
"""

from __future__ import annotations

import itertools
import json
import re
import sys
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import check_loops as base
else:  # run alone: it lies beside this one
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import check_loops as base

BITS, ONE = base.BITS, base.ONE
Block = base.Block
Fault = base.Fault
Header = base.Header
Rows = list[list[int]]
Point = tuple[Fraction, ...]
Span = tuple[Fraction, Fraction]


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
SPANS = {
    "r_s": ("resistance", " Ohm"),
    "dead_time": ("dead time worth", " Ohm"),
    "l_q": ("l_q", " H"),
    "gain": ("voltage gain", ""),
    "torque": ("torque over what is commanded", ""),
    "inertia": ("inertia", " kg m^2"),
    "back_emf": ("back-EMF that the feedforward leaves", " V s/rad"),
}
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
        had = {}
        for name, constant in CONSTANTS.items():
            had[name] = header.constant(constant)
            if base.single(Fraction(inputs[name])) != had[name]:
                raise Fault(f"inputs, {name}: the header has another {constant}")
        self.t_s, self.kp, self.ki_ts = had["t_s"], had["kp"], had["ki_ts"]
        self.speed_kp, self.speed_ki_ts = had["speed_kp"], had["speed_ki_ts"]
        self.ratio = int(had["ratio"])
        if had["ratio"] != self.ratio or not 1 <= self.ratio <= MOST_SAMPLES:
            raise Fault("inputs, ratio: it is no number of current samples")
        self.spans = {name: self._span(name, inputs[name]) for name in SPANS}
        friction, self.filter_time, *scales = (Fraction(inputs[name]) for name in OTHERS)
        if min(self.spans["r_s"][0], friction, self.filter_time) < 0:
            raise Fault("inputs: a resistance, the friction or the filter time is negative")
        self.share = Block([[ONE]])  # of a new speed in the filter, 1 - exp(-t_s/T_f)
        if self.filter_time:
            kept = base.exponential(Block([[base.fixed(-self.t_s / self.filter_time)]], 1))
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
            if not re.search(base.LAW.format(axis=re.escape(loop)), header.said):
                raise Fault(f"the header states another law of {loop}")
        self.promised = PROMISED in header.said
        self._as_said(header)
        if control:
            self._as_run(control)

    @staticmethod
    def _span(name: str, ends: list[Any]) -> Span:
        low, high = (Fraction(end) for end in ends)
        if low > high:
            raise Fault(f"inputs, {name}: it ends before it begins")
        if low <= 0 and name in ("l_q", "gain", "torque", "inertia"):
            raise Fault(f"inputs, {name}: it is not positive")
        return low, high

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
                if abs(base.single(had) - base.single(value)) * 2**22 > abs(value):
                    raise Fault(f"the header of the control has another number in '{words}'")

    def _as_said(self, header: Header) -> None:
        """Where the header names the drives of the current loops, these must be the same."""
        said = base.STATED.search(header.said)
        if said is None or not self.promised:
            return
        for name in ("r_s", "dead_time", "l_q", "gain"):
            words = said[name] or "0"
            shown = words.split(" to ") if " to " in words else [words, words]
            for text, end in zip(shown, self.spans[name]):
                if not base.near(text, end * base.RANGES[name][2]):
                    raise Fault(f"the header states another {name} ({words}) than the certificate")

    def words(self) -> str:
        """The drives, in words."""
        parts = []
        for name, (words, unit) in SPANS.items():
            low, high = (f"{float(end):.6g}" for end in self.spans[name])
            parts.append(f"{words} {low if low == high else f'{low} to {high}'}{unit}")
        slow = f", speed filtered with {float(self.filter_time):.6g} s" if self.filter_time else ""
        return f"{', '.join(parts)}, friction {float(self.friction):.6g} N m s/rad{slow}"


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
        held = base.exponential(
            Block([[base.fixed(x) for x in row] for row in self.flow(point)], 1)
        )
        moved = Block(held.rows[:2], held.r)
        if k == 3:
            ((share,),), r = box.share.rows, box.share.r
            moved = Block([[ONE, 0], [0, ONE], [0, share]], r) * moved
            kept = zip(moved.rows, (0, 0, ONE - share))
            moved = Block([[*row[:2], x, row[2]] for row, x in kept], moved.r + r)
        rows = [[*row, 0, 0, 0] for row in moved.rows]
        both, own = (box.kp + box.ki_ts) * self.rate, box.ki_ts * self.rate
        for gain in (both, own):
            row = [base.fixed(-gain * point[0]), *[0] * k, ONE, base.fixed(gain), 0]
            rows.append(row)
        rows += [[0] * (k + 2) + [ONE, 0], [0] * (k + 3) + [ONE]]
        return Block(rows, max(moved.r, 1))

    def update(self) -> Block:
        """The speed controller, from all states but T to all."""
        n, box = self.size, self.box
        rows = [[ONE if i == j else 0 for j in range(n - 1)] for i in range(n - 2)]
        for gain in (box.speed_kp + box.speed_ki_ts, box.speed_ki_ts):
            row = [0] * (n - 1)
            row[self.moving - 1], row[n - 2] = base.fixed(-gain * box.scale), ONE
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
    found = base.exponential(Block(rows))
    return [[max(x, 0) + found.r for x in row[-size:]] for row in found.rows[:size]]


def rests(loop: Loop, low: Point, high: Point) -> Rows:
    """Bounds of the entries of E, in rows of phi, w, w_f over these and v."""
    size = 3
    flows = [loop.flow(corner) for corner in itertools.product(*zip(low, high))]
    most = [[0] * size for _ in range(size)]
    for i, j in itertools.product(range(size), repeat=2):
        values = [flow[i][j] for flow in flows]
        most[i][j] = base.above(max(values) if i == j else max(map(abs, values)))
    (b, _, n, _), zero = high, [[0] * size for _ in range(size)]
    slopes = [[list(row) for row in zero] for _ in range(4)]  # times the width
    wide = [last - first for first, last in zip(low, high)]
    slopes[0][1][0] = base.above(loop.push * n * wide[0])
    slopes[1][0][0] = base.above(loop.rate * wide[1])
    slopes[2][1][0], slopes[2][1][1] = (base.above(x * wide[2]) for x in (loop.push * b, loop.drag))
    slopes[3][0][1] = base.above(loop.emf * wide[3])
    total, quarter = zero, ONE >> 2
    parts = [(nested(most, slope, 2), quarter) for slope, width in zip(slopes, wide) if width]
    torque = loop.box.spans["torque"]
    uneven = loop.drag * n * max(abs(1 / f - 1) for f in torque)
    if uneven > 0:
        change = [list(row) for row in zero]
        change[1][1] = base.above(uneven)
        sums = [[x + y for x, y in zip(*pair)] for pair in zip(most, change)]
        parts.append((nested(sums, change, 1), ONE))
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
        self.matrices = [symmetric(*pair) for pair in zip(listed, sizes)]
        for number, matrix in enumerate(self.matrices):
            if not base.positive(matrix):
                raise Fault(f"its matrix {number} is not positive definite")

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


def symmetric(entries: list[Any], size: int) -> Rows:
    """A matrix from the rows of its upper triangle."""
    if len(entries) != size * (size + 1) // 2:
        raise Fault("a matrix has not as many entries as it should")
    values = iter(base.fixed(Fraction(entry)) for entry in entries)
    held = [[0] * size for _ in range(size)]
    for i, j in itertools.combinations_with_replacement(range(size), 2):
        held[i][j] = held[j][i] = next(values)
    return held


def form_of(step: Block, q: Rows) -> Rows:
    """A' Q A, in units and rounded down."""
    columns = list(zip(*step.rows))
    turned = [[sum(map(int.__mul__, line, column)) for column in columns] for line in q]
    return [[sum(map(int.__mul__, x, y)) >> 2 * BITS for y in zip(*turned)] for x in columns]


def inverse(rows: Rows) -> Rows:
    """About the inverse of a positive matrix in units; nothing depends on how good it is."""
    size = len(rows)
    wide = [[*row, *(ONE if i == j else 0 for j in range(size))] for i, row in enumerate(rows)]
    for k in range(size):
        pivot = max(wide[k][k], 1)
        wide[k] = [(x << BITS) // pivot for x in wide[k]]
        for i, row in enumerate(wide):
            if i != k:
                wide[i] = [x - (row[k] * y >> BITS) for x, y in zip(row, wide[k])]
    return [row[size:] for row in wide]


def falls(before: Rows, after: Rows, step: Block, rest: Rows) -> bool:
    """The condition of part 3 at a corner."""
    m, n, k = len(after), len(before), len(rest)
    q = [[x + (m * k if i == j else 0) for j, x in enumerate(row)] for i, row in enumerate(after)]
    lost = [0] * n
    if rest:
        form = form_of(step, after)
        near_to = inverse([[x - y for x, y in zip(*pair)] for pair in zip(before, form)])
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
    # What the radius of the step can change in a form, and a unit for each rounding below.
    most, size = max(abs(x) for line in q for x in line), max(m, n)
    change = size**3 * most * (2 * step.largest() + step.r) * step.r
    margin, form = (change >> (2 * BITS)) + 1 + size, form_of(step, q)
    fall = [[x - y for x, y in zip(*pair)] for pair in zip(before, form)]
    for i in range(n):
        fall[i][i] -= margin + lost[i]
    return base.positive(fall)


# Part 4. The box: cut into cells that leave nothing out.
#
# g and L are in several parameters. So a cell can hold drives only where, with lengths in turn,
#
#     L between g L_0/b      L between (R + d g) L_0/s      g between b L/L_0      g at most e_0/e
#
# and is empty where these leave none; with them it can be made smaller before it is looked at or
# cut further. Ends are rounded outward.


def outward(low: Fraction, high: Fraction) -> Span:
    """A span with ends in units, not smaller."""
    return Fraction(base.fixed(low), ONE), Fraction(base.above(high), ONE)


def common(one: Span, other: Span) -> Span:
    """What both have; crossed where there is nothing."""
    return max(one[0], other[0]), min(one[1], other[1])


def resistances(box: Box, gain: Span) -> Span:
    """R + d g with gains of a span."""
    ends = [d * g for d in box.spans["dead_time"] for g in gain]
    return box.spans["r_s"][0] + min(ends), box.spans["r_s"][1] + max(ends)


def reach(box: Box, gain: Span, inductance: Span) -> tuple[Point, Point]:
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


def shrunk(box: Box, low: Point, high: Point) -> tuple[Point, Point] | None:
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
        gain, inductance = outward(*gain), outward(*inductance)
    first, last = reach(box, gain, inductance)
    found = [common(*pair) for pair in zip(zip(low, high), zip(first, last))]
    if any(a > b for a, b in found):
        return None
    found = [span if span[0] == span[1] else outward(*span) for span in found]
    return tuple(a for a, _ in found), tuple(b for _, b in found)


def check_tree(loop: Loop, tree: list[Any]) -> list[str]:
    """Goes over all cells; which are left open, in words."""
    box = loop.box
    waiting, left = [reach(box, box.spans["gain"], box.spans["l_q"])], []
    for row, verdict in enumerate(tree):
        if not waiting:
            raise Fault(f"speed loop, row {row}: all of the box is cut already")
        low, high = waiting.pop()
        spans = zip(("b", "s", "n", "e"), low, high)
        span = ", ".join(f"{what} {float(a):.6g} to {float(b):.6g}" for what, a, b in spans)
        place = f"speed loop, row {row} ({span})"
        cell = shrunk(box, low, high)
        if verdict == "open":
            left.append(span)
        elif verdict == "empty":
            if cell is not None:
                raise Fault(f"{place}: it is called empty and holds drives")
        elif isinstance(verdict, list) and verdict and isinstance(verdict[0], list):
            if cell is None:
                continue
            try:
                Chain(loop, verdict).proves(*cell)
            except Fault as fault:
                raise Fault(f"{place}: {fault}") from None
        elif isinstance(verdict, list) and len(verdict) == 2:
            waiting += base.halves(place, *(cell or (low, high)), verdict)
        else:
            raise Fault(f"{place}: it is neither cut, empty, open, nor proven")
    if waiting:
        raise Fault(f"speed loop: {len(waiting)} cells are left out at its end")
    return left


# Part 5. What is printed.


def check_speed(stated: dict[str, Any], header: Header, control: str = "") -> list[str]:
    """What is confirmed of a certificate, in words."""
    box = Box(stated["inputs"], header, control)
    left = check_tree(Loop(box), stated["tree"])
    if left and box.promised:
        raise Fault(f"speed loop: the header says it of every drive; {left[0]} is left open")
    but = f" but those in {len(left)} cells that are left open ({'; '.join(left)})" if left else ""
    words = (
        "the speed loop, with the current loop of the q axis that it runs on, is stable for every "
        f"drive{but} with {box.words()}; within a cell they may change at every current sample"
    )
    return [words]


def main(arguments: list[str]) -> int:
    """Checks the certificate that is named; the headers lie beside it."""
    if len(arguments) != 1:
        print("write: check_speed.py PREFIX_speed.json")
        return 2
    path = Path(arguments[0])
    try:
        stated = json.loads(path.read_text("utf-8"), parse_float=Fraction)
        prefix = path.name.removesuffix("_speed.json")
        control = path.parent / f"{prefix}_control.h"
        further = control.read_text("utf-8") if control.exists() else ""
        header = Header((path.parent / f"{prefix}.h").read_text("utf-8"), prefix, further)
        print(
            "not covered: limits of torque, voltage and current, rounding of the control, the d "
            "axis, margins of the speed loop, the share "
            "of drives that is stated where cells are left open"
        )
        for words in check_speed(stated, header, further):
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
