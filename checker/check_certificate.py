"""Confirms the claims of `<prefix>_certificate.json` about `<prefix>.h`, in integers and fractions.

    python -I -S check_certificate.py abb2k2_certificate.json

The program imports nothing but the standard library and, beside it, `kit.py`, and `margins.py` for
the margins of the loops. It believes nothing in the certificate: what the C does is read from the
header's text, and every bound is computed here. Read it from top to bottom: numbers (part 1), the
header's C (part 2), the reference over torque (part 3), and what is confirmed (part 4).
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from fractions import Fraction
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import kit, margins
else:  # run alone: they lie beside this one
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import kit
    import margins

BITS, ONE, Fault = kit.BITS, kit.ONE, kit.Fault
Header = kit.Header


# Part 1. Numbers: polynomials with a bound of what they leave out.
#
# A Model encloses a function of u, -1 <= u <= 1 (the place within a box of torques):
# |f(u) - sum of c[k] u^k| <= r. All numbers are integers in units of 2^-BITS. What an operation
# rounds or leaves out goes to r, so that the enclosure holds always. With one coefficient it is an
# interval.

DEGREE = 6


class Model:
    """Coefficients ``c`` and radius ``r`` in units of 2^-BITS."""

    __slots__ = ("c", "plus", "r", "root")

    def __init__(self, c: list[int], r: int = 0, plus: bool = False) -> None:
        self.c, self.r = c, r
        self.plus = plus  # known to be not negative, whatever the enclosure says
        self.root = self  # what it is the same as, but for its sign

    def __neg__(self) -> Model:
        found = Model([-x for x in self.c], self.r)
        found.root = self.root
        return found

    def __add__(self, other: Model) -> Model:
        long, short = (self.c, other.c) if len(self.c) >= len(other.c) else (other.c, self.c)
        c = [x + y for x, y in zip(long, short)] + long[len(short) :]
        return Model(c, self.r + other.r)

    def __sub__(self, other: Model) -> Model:
        return self + Model([-x for x in other.c], other.r)

    def __mul__(self, other: Model) -> Model:
        if not (any(self.c) or self.r) or not (any(other.c) or other.r):
            return Model([0])
        long, short = (self.c, other.c) if len(self.c) >= len(other.c) else (other.c, self.c)
        raw = [x * short[0] for x in long] + [0] * (len(short) - 1)
        for j, y in enumerate(short[1:], 1):
            for i, x in enumerate(long, j):
                raw[i] += x * y
        cross = 0
        if self.r or other.r:
            mine, theirs = sum(map(abs, self.c)), sum(map(abs, other.c))
            cross = mine * other.r + theirs * self.r + self.r * other.r
        left = sum(map(abs, raw[DEGREE + 1 :])) + cross
        c = [x >> BITS for x in raw[: DEGREE + 1]]
        plus = self.c[0] >= 0 <= other.c[0] and self.low() >= 0 <= other.low()
        return Model(c, len(c) + (left >> BITS) + 1, plus)

    def __truediv__(self, other: Model) -> Model:
        return self * other.inverse()

    def spread(self) -> int:
        """How far it may be from its first coefficient."""
        return sum(map(abs, self.c[1:])) + self.r

    def low(self) -> int:
        """No value is below."""
        found = self.c[0] - self.spread()
        return max(found, 0) if self.plus else found

    def high(self) -> int:
        """No value is above."""
        return self.c[0] + self.spread()

    def size(self) -> int:
        """No value has a larger magnitude."""
        return abs(self.c[0]) + self.spread()

    def inverse(self) -> Model:
        """1/f: by Newton's steps h, then bounded from 1 - f h, whatever they found."""
        if self.low() <= 0 <= self.high():
            raise Fault("a divisor may vanish")
        middle, h, two = Model(self.c), Model([(ONE << BITS) // self.c[0]]), Model([2 * ONE])
        for _ in range(4 if len(self.c) > 1 else 1):
            h = Model((h * (two - middle * h)).c)
        rest = (Model([ONE]) - self * h).size()
        if rest >= ONE:
            raise Fault("a quotient is too wide")
        return Model(h.c, h.size() * rest // (ONE - rest) + 1)

    def sqrt(self) -> Model:
        """The square root: s by Newton's steps, then bounded from f - s^2."""
        low, high = self.low(), self.high()
        if low < 0 or high == 0:
            raise Fault("a square root may be of a negative number")
        if 4 * low < high:  # near zero it is no polynomial
            least, most = isqrt(low << BITS), isqrt(high << BITS) + 1
            return Model([(least + most) // 2], (most - least) // 2 + 1, plus=True)
        middle, three = Model(self.c), Model([3 * ONE])
        y = Model([(ONE << BITS) // isqrt(self.c[0] << BITS)])
        for _ in range(5):
            y = Model([x >> 1 for x in (y * (three - middle * y * y)).c])
        s = Model((middle * y).c)
        if s.low() <= 0:
            raise Fault("a square root is too wide")
        rest = (self - s * s).size()
        return Model(s.c, (rest << BITS) // s.low() + 1, plus=True)


def rounded(exactly: Model) -> Model:
    """What single precision makes of a result: half a unit of its last place is added."""
    return Model(exactly.c, exactly.r + kit.half_place(exactly.size()), exactly.plus)


def root(x: Model) -> Model:
    """What single precision makes of a square root."""
    return rounded(x.sqrt())


def magnitude(x: Model) -> Model:
    """A magnitude, of numbers of one sign."""
    if x.low() < 0 < x.high():
        raise Fault("the box lies on both sides of zero")
    return -x if x.high() <= 0 else x


def exact(value: Fraction | int) -> Model:
    """A rational; what its last bit leaves goes to the radius."""
    whole = kit.below(value)
    return Model([whole], kit.above(value) - whole)


# Part 2. The C of one function, run over a box.

_STATEMENT = re.compile(
    r" ?(?:(?P<branch>if \((?P<condition>[^{}?;]+)\)|else if \((?P<other>[^{}?;]+)\)|else) \{"
    r"|(?P<declared>float \w+);"
    r"|(?:const float |\*)?(?P<name>\w+) = (?P<value>[^;{}=]+);)"
)
_CHOICE = re.compile(r"\((?P<condition>[^?:]+)\) \? (?P<first>[^?:]+) : (?P<second>[^?:]+)")


class Run:
    """Runs the statements of a function for a whole box of arguments at once.

    A condition must come out alike in all of the box (its ends count to either side).
    """

    def __init__(self, known: dict[str, Any], given: Model) -> None:
        self.known = known | {"torque_Nm": given}

    def statements(self, code: str) -> None:
        """Runs a block: declarations, assignments, and chains of conditions."""
        place, taken = 0, False
        while place < len(code.rstrip()):
            found = _STATEMENT.match(code, place)
            if found is None:
                raise Fault(f"the header's C is not understood at '{code[place : place + 30]}'")
            place = found.end()
            if found["name"]:
                self.known[found["name"]] = self.chosen(found["value"])
            if not found["branch"]:
                continue
            taken = taken and found["condition"] is None  # a chain begins with its first if
            condition = found["condition"] or found["other"]
            start, place = place, end_of_block(code, place)
            if not taken and (condition is None or self.holds(kit.parsed(condition))):
                taken = True
                self.statements(code[start : place - 1])

    def chosen(self, text: str) -> Model:
        """A value, which may be one of two."""
        choice = _CHOICE.fullmatch(text)
        if choice is None:
            return self.value(kit.parsed(text))
        first = self.holds(kit.parsed(choice["condition"]))
        return self.value(kit.parsed(choice["first" if first else "second"]))

    def holds(self, node: ast.expr) -> bool:
        """Whether a comparison holds in all of the box; else it must hold nowhere."""
        if not isinstance(node, ast.Compare) or len(node.ops) != 1:
            raise Fault("the header's C has a condition that is no comparison")
        left, right, sign = self.value(node.left), self.value(node.comparators[0]), node.ops[0]
        if isinstance(sign, ast.Gt | ast.GtE):
            left, right = right, left
        less, not_less = left.high() <= right.low(), left.low() >= right.high()
        if less and not_less:
            return isinstance(sign, ast.LtE | ast.GtE)
        if not (less or not_less) or isinstance(sign, ast.Eq | ast.NotEq):
            raise Fault("the box lies on both sides of a breakpoint")
        return less

    def value(self, node: ast.expr) -> Model:
        """What single precision makes of an expression."""
        found: Model = kit.value(node, self.known, exact, rounded)
        return found


def end_of_block(code: str, place: int) -> int:
    """The place behind the brace that ends a block."""
    depth = 1
    while depth and place < len(code):
        depth += (code[place] == "{") - (code[place] == "}")
        place += 1
    return place


# Part 3. The reference over torque.
#
# With D = L_d - L_q, M = psi + D i_d and t = |D| T/(1.5 p), a current makes the torque 1.5 p M i_q.
# In y = D i_d and z = |D| i_q the least current for a torque solves
#
#     y (psi + y)^3 = t^2        and        z (psi + sqrt(psi^2 + 4 z^2))/2 = t
#
# with y >= 0: with the other sign of y the magnet's torque is lessened, and the same torque takes
# more i_q. Both left sides rise, so that |i_d - exact| <= B holds where the left side at
# y + |D| B is not below the right one, and at y - |D| B not above it: no equation is solved.
# And by duality: |x|^2 - 2 k (M(x) x_q - M i_q) over all currents x has, where |k D| < 1, a least
# value, which no x with the torque of i can go below. Worked out, with M = M(i): no current that
# makes the same torque has a smaller |x|^2 than
#
#     |i|^2 - (i_q - k M)^2 - (i_d - k^2 D M)^2/(1 - k^2 D^2)
#
# With r = i_d - D i_q^2/M, which vanishes at the optimum, and k = i_q/M + m r, what is taken
# off is r^2 ((m M)^2 + (1 - 2 D m i_q - D M m^2 r)^2/(1 - k^2 D^2)), whatever m is.
# Without a magnet the least |i|^2 is 2 |i_d i_q|.

STATED = re.compile(
    r"proven for every torque, rounding included, against the equations of the machine: "
    r"i_d (?P<i_d_A>\S+) A, i_q (?P<i_q_A>\S+) A against the exact (?P<strategy>\w+) currents; "
    r"torque (?P<torque_Nm>\S+) N m \((?P<torque_percent>\S+) % of the largest torque\); "
    r"copper loss (?P<loss_W>\S+) W above the least \((?P<loss_percent>\S+) % from 5 % torque up\)"
)
BOUNDS = ("i_d_A", "i_q_A", "torque_Nm", "torque_percent", "loss_W", "loss_percent")


class Reference:
    """The current reference of a header with the bounds that are claimed of it."""

    def __init__(
        self, header: Header, machine: dict[str, Fraction], strategy: str, bounds: dict[str, str]
    ) -> None:
        self.header, self.body = header, header.function("current_reference")
        self.known: dict[str, Any] = {
            name: exact(value) for name, value in header.constants.items()
        }
        self.known |= {"sqrtf": root, "fabsf": magnitude}
        self.largest = header.constant("TORQUE_MAX_NM")
        self.bounds = {name: Fraction(bounds[name]) for name in BOUNDS}
        self.factor = Fraction(3, 2) * machine["pole_pairs"]
        self.psi, self.r_s = machine["psi_pm_Wb"], machine["r_s_Ohm"]
        self.saliency = machine["l_d_H"] - machine["l_q_H"]
        self.straight = strategy == "id0" or self.saliency == 0  # exact currents are (0, T/psi)
        if strategy not in ("mtpa", "id0"):
            raise Fault(f"reference: strategy {strategy} is not known here")
        if self.straight and self.psi == 0:
            raise Fault("reference: the machine makes no torque so")

    def statement(self, strategy: str) -> str:
        """What is claimed, in words."""
        i_d, i_q, torque, share, loss, loss_share = (self.text(name) for name in BOUNDS)
        return (
            f"for every torque from 0 to {float(self.largest):.6g} N m, either sign, rounding "
            f"included, {self.header.prefix}_current_reference returns i_d within {i_d} A and i_q "
            f"within {i_q} A of the {strategy} currents; the torque is within {torque} N m "
            f"({share} % of the largest), the copper loss within {loss} W of the least "
            f"({loss_share} % from 5 % torque up)"
        )

    def currents(self, torque: Model) -> tuple[Model, Model, bool]:
        """i_d and i_q that the C returns for a box of torques and, mirrored, for the negative
        ones; and whether both are the same number but for the sign.
        """
        runs = []
        for given in (torque, -torque):
            run = Run(self.known, given)
            run.statements(self.body)
            runs.append(run.known)
        if not all("i_d_A" in run and "i_q_A" in run for run in runs):
            raise Fault("the function sets no i_d_A or i_q_A")
        (d, q), (other_d, other_q) = ((run["i_d_A"], run["i_q_A"]) for run in runs)
        same = d.root is q.root and other_d.root is other_q.root
        around = []
        for one, other in ((d, other_d), (q, -other_q)):
            apart = sum(map(abs, (one - other).c))  # but for last bits: else bounds are exceeded
            around.append(Model(one.c, max(one.r, other.r) + apart))
        return around[0], around[1], same

    def check(self, low: Fraction, high: Fraction) -> None:
        """All bounds on a box of torques, of both signs."""
        middle, half = exact((low + high) / 2), exact((high - low) / 2)
        if middle.r or half.r:
            raise Fault("its ends have too many digits")
        torque = Model([middle.c[0], half.c[0]])
        self.bounded(torque, *self.currents(torque))

    def check_beyond(self) -> None:
        """Beyond the largest torque the currents are those for the largest, whatever is asked."""
        last = Fraction(2) ** 128  # no number of single precision is larger
        ends = [exact((last + self.largest) / 2).c[0], exact((last - self.largest) / 2).c[0]]
        self.bounded(exact(self.largest), *self.currents(Model(ends)))

    def within(self, size: int, name: str) -> None:
        if size > self.bounds[name] * ONE:
            raise Fault(f"{name} exceeds {self.text(name)}")

    def text(self, name: str) -> str:
        return f"{float(self.bounds[name]):g}"

    def bounded(self, torque: Model, i_d: Model, i_q: Model, same: bool) -> None:
        """All bounds, of the currents for positive torques."""
        flux = exact(self.psi) + exact(self.saliency) * i_d
        off = exact(self.factor) * flux * i_q - torque
        self.within(off.size(), "torque_Nm")
        share = Fraction(off.size(), ONE) / self.largest
        if share * 100 > self.bounds["torque_percent"]:
            raise Fault(f"torque_percent exceeds {self.text('torque_percent')}")
        if self.straight:
            exact_q = torque * exact(1 / (self.factor * self.psi))
            self.within(i_d.size(), "i_d_A")
            self.within((i_q - exact_q).size(), "i_q_A")
        else:
            self.near_optimum(torque, i_d, i_q)
        self.loss(torque, flux, i_d, i_q, same)

    def near_optimum(self, torque: Model, i_d: Model, i_q: Model) -> None:
        d = abs(self.saliency)
        psi, t = exact(self.psi), torque * exact(d / self.factor)
        two = exact(Fraction(1, 2))

        def of_d(y: Model) -> Model:
            if self.psi == 0:  # its root
                return y * y - t
            cube = (psi + y) * (psi + y) * (psi + y)
            return y * cube - t * t

        def of_q(z: Model) -> Model:
            if self.psi == 0:
                return z * z - t
            squares = psi * psi + exact(4) * z * z
            return z * (psi + squares.sqrt()) * two - t

        for name, current, rising in (
            ("i_d_A", exact(self.saliency) * i_d, of_d),
            ("i_q_A", exact(d) * i_q, of_q),
        ):
            reach = exact(d * self.bounds[name])
            more, less = current + reach, current - reach
            if more.low() < 0 or rising(more).low() < 0:
                raise Fault(f"{name} may lie below the exact one by more than {self.text(name)}")
            if less.high() > 0 and rising(less).high() > 0:
                raise Fault(f"{name} may lie above the exact one by more than {self.text(name)}")

    def loss(self, torque: Model, flux: Model, i_d: Model, i_q: Model, same: bool) -> None:
        squares = i_d * i_d + i_q * i_q
        if self.straight:  # |i|^2 - (M i_q/psi)^2
            ratio = flux * exact(1 / self.psi) if self.saliency else exact(1)
            lost = i_d * i_d + i_q * i_q * (exact(1) - ratio * ratio)
            more = Fraction(max(0, lost.high()), ONE)
        elif self.psi == 0:
            apart = i_q + i_d if i_d.high() <= 0 else i_q - i_d
            more = Fraction(0 if same else apart.size(), ONE) ** 2
        else:
            d, one, two, q = exact(self.saliency), exact(1), exact(2), i_q * flux.inverse()
            r = i_d - d * i_q * q
            m = two * q * d * (flux * (one + exact(3) * q * q * d * d)).inverse()  # the best one
            m = Model(m.c)
            kd = (q + m * r) * d
            room = one - kd * kd
            if room.low() <= 0:
                raise Fault("loss: too far from the optimum for a bound")
            first, second = m * flux, one - d * m * (two * i_q + flux * m * r)
            more = Fraction((r * r * (first * first * room + second * second)).high(), room.low())
        if more * self.r_s * 3 / 2 > self.bounds["loss_W"]:
            raise Fault(f"loss_W exceeds {self.text('loss_W')}")
        if torque.high() >= self.largest * ONE / 20:
            left = Fraction(squares.low(), ONE) - more
            if left <= 0 or more * 100 > left * self.bounds["loss_percent"]:
                raise Fault(f"loss_percent exceeds {self.text('loss_percent')}")


def check_reference(claim: dict[str, object], machine: dict[str, Fraction], header: Header) -> str:
    """The claim of the reference over torque; boxes must cover the domain without a gap."""
    stated = STATED.search(header.said)
    bounds = claim["bounds"]
    if stated is None or not isinstance(bounds, dict) or set(bounds) != set(BOUNDS):
        raise Fault("reference: the header states no bounds of these kinds")
    for name in BOUNDS:
        if Fraction(stated[name]) != Fraction(bounds[name]):
            raise Fault(f"reference, {name}: the header states {stated[name]}, not {bounds[name]}")
    if stated["strategy"] != claim["strategy"]:
        raise Fault("reference: the header has another strategy")
    reference = Reference(header, machine, stated["strategy"], bounds)
    if claim["code"] != reference.body:
        raise Fault("reference: the function is another than that of the certificate")
    if claim["statement"] != reference.statement(stated["strategy"]):
        raise Fault("reference: its words do not say what its numbers do")
    boxes, end = claim["boxes"], Fraction(0)
    if not isinstance(boxes, list):
        raise Fault("reference: it has no boxes")
    for number, (first, last) in enumerate(boxes):
        low, high = Fraction(first), Fraction(last)
        place = f"reference, box {number} ({float(low):.9g} to {float(high):.9g} N m)"
        if low != end or high <= low:
            raise Fault(f"{place}: it does not begin where the one before ends ({float(end):.9g})")
        try:
            reference.check(low, high)
        except Fault as fault:
            raise Fault(f"{place}: {fault}") from None
        end = high
    if end != reference.largest:
        raise Fault(f"reference: boxes end at {float(end):.9g} N m, not at the largest torque")
    try:
        reference.check_beyond()
    except Fault as fault:
        raise Fault(f"reference, beyond the largest torque: {fault}") from None
    return reference.statement(stated["strategy"])


# Part 4. What is confirmed.


def claims(stated: dict[str, Any], beside: kit.Beside) -> Iterator[str]:
    """What is not covered, and each claim that is confirmed, in words."""
    yield "; ".join(stated["not_covered"]) or "nothing else is stated as proven"
    header = Header(beside.text(".h"), beside.prefix)
    machine = kit.read_machine(stated["machine"], header)
    for claim in stated["claims"]:
        match claim["name"]:
            case "reference":
                yield check_reference(claim, machine, header)
            case "margins":
                yield from margins.check_margins(claim, header, beside.text("_control.h", ""))
            case name:
                raise Fault(f"a claim '{name}' is not known here")


main = kit.program("check_certificate", "_certificate.json", claims)

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
