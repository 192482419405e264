"""Margins of each loop alone, and the speed observer, for `check_certificate.py`.

It imports nothing but the standard library and, beside it, `kit.py`, `cells.py`, `polynomials.py`,
and of `check_speed.py` the loop of a drive (its parts 1 and 2). Gains, machine and period are read
from the header's text, and no frequency is sought. Read it from top to bottom: polynomials on the
unit circle (part 1), the loops (part 2), the observer of the speed (part 3), and what is confirmed
(part 4).
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import cells, check_speed, kit, polynomials
else:  # run alone: they lie beside this one
    import cells
    import check_speed
    import kit
    import polynomials

BITS, ONE, Fault, below = kit.BITS, kit.ONE, kit.Fault, kit.below
Poly = list[Fraction]  # coefficients, rising


# Part 1. Polynomials on the unit circle.
#
# A loop opened at its controller is L = N/D; closed, with its gain times k and turned by an angle
# p, its poles are the zeros of D + k exp(-jp) N. None leaves the circle as k or p change while that
# vanishes nowhere on it. There, with c the cosine of the angle w and Chebyshev's polynomials,
#
#     A conj(B) = sum of a_i b_j T_|i-j|(c)  + j sin(w) sum of sgn(i-j) a_i b_j U_(|i-j|-1)(c)
#
# With R + j sin(w) Q = D conj(N), |D|^2, |N|^2 and |D + N|^2 polynomials of c, it is enough that
# for all c from -1 to 1
#
#     M^2 |D + N|^2 > |D|^2                                          for a sensitivity below M
#     |N|^2 is not |D|^2, or R + cos(p) |N|^2 > 0                    for angles up to p
#     Q is not 0, or R + |N|^2 > 0, or R + G |N|^2 < 0               for gains from 1 to G
#
# and, for gains, at c = 1 and -1 as well, whatever Q is. All are decided on parts of the range by
# coefficients in Bernstein's basis.

SLACK = ONE >> 70  # More than what the last bits of D and N change in these polynomials.
DEEPEST = 60


def on_circle(a: Poly, b: Poly) -> tuple[Poly, Poly]:
    """R and Q of A conj(B), in powers of c."""
    size = max(len(a), len(b))
    first, second = [[Fraction(1)], [Fraction(0), Fraction(1)]], [[Fraction(1)]]  # T and U
    second.append([Fraction(0), Fraction(2)])
    for each in (first, second):
        while len(each) < size:
            last, before = [Fraction(0), *(2 * x for x in each[-1])], each[-2]
            each.append([x - (before[i] if i < len(before) else 0) for i, x in enumerate(last)])
    real, imaginary = [Fraction(0)] * size, [Fraction(0)] * size
    for lag in range(size):
        ahead = sum(map(Fraction.__mul__, a[lag:], b), Fraction(0))
        behind = sum(map(Fraction.__mul__, a, b[lag:]), Fraction(0)) if lag else Fraction(0)
        for power, c in enumerate(first[lag]):
            real[power] += (ahead + behind) * c
        for power, c in enumerate(second[lag - 1] if lag else ()):
            imaginary[power] += (ahead - behind) * c
    return real, imaginary


def mixed(*parts: tuple[Fraction | int, Poly]) -> Poly:
    """A sum of polynomials of one length, each times a number."""
    return [sum((k * x for (k, _), x in zip(parts, column)), Fraction(0))
            for column in zip(*(poly for _, poly in parts))]  # fmt: skip


def check_everywhere(what: str, zero: Poly, *positive: Poly) -> None:
    """For all c from -1 to 1 the first is not zero, or one of the others is positive."""
    columns = [
        [below(x) for x in polynomials.based(list(poly), (-ONE, ONE))] for poly in (zero, *positive)
    ]
    waiting = [([list(row) for row in zip(*columns)], 0)]
    while waiting:
        rows, depth = waiting.pop()
        slack = SLACK + 40 * depth
        first, *others = zip(*rows)
        if min(first) > slack or max(first) < -slack or any(min(x) > slack for x in others):
            continue
        if depth > DEEPEST:
            raise Fault(f"{what} is not as it is stated")
        waiting += [(half, depth + 1) for half in polynomials.halves(rows)]


def inside(poly: Poly) -> bool:
    """Whether all zeros lie inside the unit circle, after Jury: one by one is taken off."""
    while len(poly) > 1:
        first, last = poly[0], poly[-1]
        if abs(first) >= abs(last):
            return False
        poly = [last * x - first * y for x, y in zip(poly[1:], poly[-2::-1])]
    return True


class Loop:
    """A loop by D and N, with what the header states of it."""

    def __init__(self, name: str, open_loop: Poly, acting: Poly, header: kit.Header) -> None:
        self.name, self.d = name, open_loop
        self.n = [*acting, *[Fraction(0)] * (len(open_loop) - len(acting))]
        self.closed = mixed((1, self.d), (1, self.n))
        said = re.search(SAID.format(loop=re.escape(name)), header.said)
        if said is None:
            raise Fault(f"{name}: the header states no margins that are known here")
        self.said = said.groupdict()

    def bound(self, name: str, sign: int) -> Fraction:
        """A number of the header, and half a unit of its last digit to one side."""
        text = self.said[name]
        digits = len(text.partition(".")[2])
        return Fraction(text) + Fraction(sign * 51, 100 * 10**digits)

    def check(self) -> str:
        """All that is stated, in words."""
        name, (r, q) = self.name, on_circle(self.d, self.n)
        (dd, _), (nn, _) = (on_circle(poly, poly) for poly in (self.d, self.n))
        nothing = [Fraction(0)] * len(dd)
        pole, most = self.bound("pole", 1), self.bound("sensitivity", 1)
        if max(map(abs, (*self.d, *self.n))) > 2**12 or most > 16 or not Fraction(1, 4) < pole < 1:
            raise Fault(f"{name}: it is none that can be confirmed here")
        shrunk = [x * pole**i for i, x in enumerate(self.closed)]
        size = 1 / abs(shrunk[-1])
        shrunk = [x * size for x in shrunk]
        check_everywhere(f"{name}: the largest pole", nothing, on_circle(shrunk, shrunk)[0])
        if not inside(shrunk):
            raise Fault(f"{name}: a pole is larger than it is stated")
        ee, _ = on_circle(self.closed, self.closed)
        check_everywhere(f"{name}: M_s", nothing, mixed((most**2, ee), (-1, dd)))
        angle = self.bound("phase", -1) / 180 * Fraction("3.14159265358979323846")
        if not 0 < angle < 3:
            raise Fault(f"{name}: its phase margin is none")
        turn = below(angle)
        turned = cells.exponential([[0, -turn], [turn, 0]])
        cosine = Fraction(turned.rows[0][0] - turned.r - (ONE >> 60), ONE)
        apart = mixed((1, nn), (-1, dd))
        check_everywhere(f"{name}: the phase margin", apart, mixed((1, r), (cosine, nn)))
        decibels = self.bound("gain", -1)
        if not 0 < decibels < 60:
            raise Fault(f"{name}: its gain margin is none")
        grown = cells.exponential([[below(decibels / 20 * Fraction("2.30258509299404568402"))]])
        most = Fraction(grown.largest(), ONE) * (1 + Fraction(1, 2**60))
        stays, turns = mixed((1, r), (1, nn)), mixed((-1, r), (-most, nn))
        check_everywhere(f"{name}: the gain margin", q, stays, turns)
        for c in (1, -1):
            ends = (sum(x * c**i for i, x in enumerate(poly)) * ONE for poly in (stays, turns))
            if not any(end > SLACK for end in ends):
                raise Fault(f"{name}: the gain margin is not as it is stated")
        words = {key: text.rstrip(".") for key, text in self.said.items()}
        return (
            f"{name}: no pole is larger than {words['pole']}, the phase margin is at least "
            f"{words['phase']} deg, the gain margin {words['gain']} dB, and M_s at most "
            f"{words['sensitivity']}, within half a unit of the last digit"
        )


# Part 2. The loops: of i_d and i_q on the winding alone, of the speed on that of i_q.
#
# With a and b what a sample leaves of a current, and makes of a voltage, which acts one later,
#
#     D = z (z - 1) (z - a)        N = b ((kp + ki_ts) z - kp)
#
# The speed loop, opened where the speed is measured, is a product of matrices over a sample of the
# speed: they are those of `check_speed.py`, D and D + N their characteristic polynomials.

SAID = (
    r"PI controller of {loop}: [^/]*?, phase margin (?P<phase>[\d.]+) deg, gain margin "
    r"(?P<gain>[\d.]+) dB, delay margin \S+ samples, largest pole (?P<pole>[\d.]+), "
    r"M_s (?P<sensitivity>\d+\.\d+)"
)


def current_loop(header: kit.Header, axis: str) -> Loop:
    """The loop of i_d or i_q."""
    cells.check_law(header, f"i_{axis}")
    kp, ki_ts = (header.constant(f"I{axis.upper()}_{x}_V_PER_A") for x in ("KP", "KI_TS"))
    rate = header.constant("T_S_S") / header.constant(f"L_{axis.upper()}_H")
    held = cells.exponential([[below(-rate * header.constant("R_S_OHM")), below(rate)], [0, 0]])
    a, b = (Fraction(x, ONE) for x in held.rows[0])
    if max(kp, ki_ts) > 2**10:
        raise Fault(f"i_{axis}: its gains are too large to be confirmed here")
    one = Fraction(1)
    return Loop(f"i_{axis}", [0 * a, a, -one - a, one], [-b * kp, b * (kp + ki_ts)], header)


def characteristic(block: cells.Block) -> Poly:
    """The polynomial whose zeros are the eigenvalues, after Faddeev and Leverrier: of a matrix of
    integers it has integers, and the divisions leave no rest.
    """
    size, found = len(block.rows), [1]
    held = [[0] * size for _ in range(size)]
    for n in range(1, size + 1):
        for i in range(size):
            held[i][i] += found[0]
        columns = list(zip(*held))
        held = [[sum(map(int.__mul__, row, x)) for x in columns] for row in block.rows]
        found.insert(0, -sum(held[i][i] for i in range(size)) // n)
    return [Fraction(x, ONE ** (size - i)) for i, x in enumerate(found)]


def speed_loop(header: kit.Header, inputs: dict[str, Any], control: str) -> tuple[Loop, str]:
    """The loop of the speed on the machine of the header; and its shaft, in words."""
    for name, constant in (("r_s", "R_S_OHM"), ("l_q", "L_Q_H")):
        header.same(inputs[name][0], constant, f"inputs, {name}")
    box = check_speed.Box(inputs, header, control)
    if any(low != high for low, high in box.spans.values()) or any(
        box.spans[name][0] != right
        for name, right in (("dead_time", 0), ("gain", 1), ("torque", 1), ("back_emf", 0))
    ):
        raise Fault("inputs: they are not those of one drive without deviations")
    loop = check_speed.Loop(box)
    (point, _), n = check_speed.reach(box, box.spans["gain"], box.spans["l_q"]), loop.size
    step, update = loop.step(point), loop.update()
    still = [[0 if j == loop.moving - 1 and i >= n - 2 else x for j, x in enumerate(row)]
             for i, row in enumerate(update.rows)]  # fmt: skip
    polys = []
    for rows in (still, update.rows):
        made, power = cells.Block(rows, update.r), step
        for bit in f"{box.ratio:b}"[::-1]:
            made, power = (power * made if bit == "1" else made), power * power
        made = cells.Block(made.rows[:-2] + made.rows[-1:], made.r)
        if made.r > 1 << 26 or made.largest() > ONE << 3:
            raise Fault("speed: its units are too far from those of its motion")
        polys.append(characteristic(made))
    acting = mixed((1, polys[1]), (-1, polys[0]))
    return Loop(check_speed.SPEED, polys[0], acting, header), box.words()


# Part 3. The observer of the speed.
#
# Winding and shaft, L di/dt = u - R i - p psi omega and J domega/dt = 3/2 p psi i - B omega, go
# over a sample with u held to F (i, omega) + g u. The observer's state stands for omega + C i. On
# the machine that it knows its error is multiplied by A in each sample if, for all i, omega and u,
#
#     omega+ + C i+ = A (omega + C i) + B_U u + B_I i
#
# which are three numbers, of omega, i and u.

OBSERVED = "omega_hat[k] = zeta[k] - C i_q[k]; zeta[k+1] = A zeta[k] + B_U u_q[k] + B_I i_q[k]"
NEAR = Fraction(1, 2**20)  # What numbers in single precision may be off, over the largest term.


def check_observer(header: kit.Header, stated: dict[str, Any]) -> str:
    """What is confirmed of the speed observer, in words."""
    if OBSERVED not in header.said:
        raise Fault("speed observer: the header states another law")
    names = ("A", "C_RAD_PER_AS", "B_I_RAD_PER_AS", "B_U_RAD_PER_VS")
    a, c, b_i, b_u = (header.constant(f"OBSERVER_{name}") for name in names)
    machine = ("T_S_S", "R_S_OHM", "L_Q_H", "POLE_PAIRS", "PSI_PM_WB")
    t_s, r_s, l_q, pairs, psi = (header.constant(name) for name in machine)
    inertia, friction = (Fraction(stated[name]) for name in ("inertia", "friction"))
    if not 0 <= a < 1 or min(inertia, c) <= 0 or friction < 0:
        raise Fault("speed observer: its pole is not within the circle, or its inertia is none")
    rate, push = t_s / l_q, t_s * c / inertia  # the speed in units of C: it is near a current
    flow = [
        [-rate * r_s, -rate * pairs * psi * c, rate],
        [push * pairs * psi * Fraction(3, 2) / c**2, -t_s * friction / inertia, Fraction(0)],
        [Fraction(0)] * 3,
    ]
    held = cells.exponential([[below(x) for x in row] for row in flow])
    summed = [Fraction(x + y, ONE) for x, y in zip(*held.rows[:2])]
    for what, found, right, size in (
        ("A", summed[1], a, 1),
        ("B_I", summed[0], a + b_i / c, 1),
        ("B_U", summed[2], b_u / c, abs(b_u / c)),
    ):
        if abs(found - right) > NEAR * size - Fraction(2 * held.r, ONE):
            raise Fault(f"speed observer: {what} is not that of the machine")
    return (
        f"errors of the speed observer shrink to {float(a):.6g} of themselves in every sample, "
        f"apart from rounding, on the machine that it knows, with {float(inertia):.6g} kg m^2, "
        f"friction {float(friction):.6g} N m s/rad, at i_d = 0 and no load"
    )


# Part 4. What is confirmed.


def check_margins(claim: dict[str, Any], header: kit.Header, control: str) -> Iterator[str]:
    """What is confirmed of the loops that a claim names, in words."""
    for axis in claim["axes"]:
        r_s, inductance = (header.constant(x) for x in ("R_S_OHM", f"L_{axis.upper()}_H"))
        on = f"on {float(r_s):.6g} Ohm and {float(inductance):.6g} H"
        yield f"{current_loop(header, axis).check()}, {on}"
    if "speed" in claim:
        loop, words = speed_loop(header, claim["speed"], control)
        yield f"{loop.check()}, on a drive with {words}"
    if "observer" in claim:
        yield check_observer(header, claim["observer"])
