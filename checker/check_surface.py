"""Confirms `<prefix>_surface.json`: bounds of the field-weakening of `<prefix>_weakening.h`.

    python -I -S check_surface.py pump_surface.json

The program imports nothing but the standard library and, beside it, `kit.py` and `polynomials.py`.
It calculates in integers and fractions alone, and believes nothing in the certificate: constants
and polynomials are read from the C, what lies around them must be there word for word, and boxes
are cut here. Read it from top to bottom: the header (part 1), the errors (part 2), the domain
(part 3), and what is confirmed (part 4).
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import kit, polynomials
else:  # run alone: they lie beside this one
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import kit
    import polynomials

BITS, ONE, Fault = kit.BITS, kit.ONE, kit.Fault
above, below, times = kit.above, kit.below, kit.times
T, X = polynomials.T, polynomials.X
Box = polynomials.Box
Poly = polynomials.Poly
Rows = polynomials.Rows
constant, wide, run = polynomials.constant, polynomials.wide, polynomials.run
lacking, horner = polynomials.lacking, polynomials.horner
Wide = polynomials.Wide
turn, fitted, pieces = polynomials.turn, polynomials.fitted, polynomials.pieces
summed = kit.added
Room = tuple[int, int, int, int]


# Part 1. The header: what must be there word for word, and its constants and polynomials.

CODE = {
    "limit": "const float f = flux_Wb - P_FLUX_MIN_WB; {limit} return limit;",
    "flux": (
        "const float top = omega * P_FLUX_MAX_WB; if (squared >= (top * top)) { "
        "flux = P_FLUX_MAX_WB; } else if (squared > 0.0F) { const float found = "
        "sqrtf(squared) / omega; flux = (found < P_FLUX_MAX_WB) ? found : P_FLUX_MAX_WB; } "
        "else { flux = 0.0F; } return flux;"
    ),
    "reference": (
        "const float omega = (omega_e_rad_per_s < 0.0F) ? -omega_e_rad_per_s : omega_e_rad_per_s; "
        "const float volts = (v_max_V > 0.0F) ? v_max_V : 0.0F; const float room = volts * volts; "
        "const float drop = {per_torque} * omega; const float per_torque = ((torque_Nm < 0.0F) != "
        "(omega_e_rad_per_s < 0.0F)) ? -drop : drop; const float size = (torque_Nm < 0.0F) ? "
        "-torque_Nm : torque_Nm; const float some = (size > 0.0F) ? size : 0.0F; const float asked "
        "= (some < {torque_max}) ? some : {torque_max}; t = 0.0F; a = 0.0F; beyond = asked; trial "
        "= asked; for (k = 0U; k < P_TRIALS; k++) { if ((k >= (P_TRIALS - 1U)) && (t <= 0.0F)) { "
        "trial = 0.0F; } const float flux = P_least_flux(room - (per_torque * trial), omega); if "
        "((flux >= P_FLUX_MIN_WB) && (trial <= P_limit(flux))) { t = trial; a = flux; } else { "
        "beyond = trial; } trial = 0.5F * (t + beyond); if (t >= asked) { break; } } const float "
        "a_held = (a > 0.0F) ? a : P_FLUX_MIN_WB; {curves} if (taken > a_held) { {weakened} } else "
        "{ i_d = mtpa_d; i_q = mtpa_q; } *i_d_A = i_d; *i_q_A = (torque_Nm < 0.0F) ? -i_q : i_q;"
    ),
}
LEAST = (
    "return P_flux(squared - {reserve}, omega);",
    (
        "const float flux = P_flux(squared - {reserve}, omega); const float rest = squared - "
        "{near}; if (rest > 0.0F) { const float found = sqrtf(rest / ((omega * omega) + {slope})); "
        "const float held = (found < P_FLUX_MAX_WB) ? found : P_FLUX_MAX_WB; least = (held > flux) "
        "? held : flux; } else { least = flux; } return least;"
    ),
)
ADDED = "i_d = (delta * d) + mtpa_d; i_q = ((delta * t) * q) + mtpa_q;"
WEAKENED = (
    "const float delta = taken - a_held; {surface} " + ADDED,
    (
        "const float left = room - (per_torque * t); weak_d = mtpa_d; weak_q = mtpa_q; flux = "
        "a_held; for (n = 0U; n < 2U; n++) { const float delta = (taken > flux) ? (taken - flux) : "
        "0.0F; {surface} weak_d = (delta * d) + mtpa_d; weak_q = ((delta * t) * q) + mtpa_q; if (n "
        "< 1U) { const float used = (weak_d * weak_d) + (weak_q * weak_q); const float more = "
        "P_flux(left - (used * {square}), omega); flux = (more > flux) ? more : flux; } } i_d = "
        "weak_d; i_q = weak_q;"
    ),
)
PLAIN = {"limit", "curves", "weakened", "surface"}  # text; the others are numbers
SAID = re.compile(
    r"(?P<poles>\d+) pole pairs, (?P<i_max_A>\S+) A \(peak\), up to .*"
    r"Made for (?P<v_max_V>\S+) V up to (?P<omega_e_rad_per_s>\S+) rad/s, and from .*"
    r"The phase resistance is (?P<r_s_Ohm>\S+) Ohm .*Bounds of the errors, proven for every torque "
    r"and speed up to the largest, against the equations of the machine, for voltages from "
    r"(?P<share>\S+) % of (?P<volts>\S+) (?P<unit>m?k?V) up, motoring and generating; rounding "
    r"included, with and without fused multiply-add; in brackets what was found by sampling: the "
    r"phase voltage, resistance drop included, exceeds its limit by "
    r"(?:no proven bound|(?P<voltage_percent>\S+) %) \(\S+ %\), "
    r"the current its limit by (?P<current_percent>\S+) % \(\S+ %\), the torque that is granted "
    r"errs by at most (?P<torque_Nm>\S+) N m, (?P<torque_percent>\S+) % of the largest one, "
    r"(?P<torque_max>\S+) N m"
)
BOUNDS = ("voltage_percent", "current_percent", "torque_Nm", "torque_percent")
LIMITS = ("i_max_A", "v_max_V", "omega_e_rad_per_s")


class Surface:
    """Numbers and polynomials of the header's step."""

    def __init__(self, text: str, prefix: str) -> None:
        macro = f"{prefix.upper()}_WEAKENING_"
        text, trials = re.subn(rf"#define {macro}TRIALS \([1-9]\d*U\)", "", text)
        header = kit.Header(text, f"{prefix}_weakening")
        said = SAID.search(header.said)
        if said is None:
            raise Fault("the header states no bounds that are known here")
        self.said = said
        self.least, self.most = header.constant("FLUX_MIN_WB"), header.constant("FLUX_MAX_WB")
        found: dict[str, str] = {}

        def read(name: str, *templates: str) -> None:
            body = header.function(name).replace(f"{prefix}_weakening_", "P_").replace(macro, "P_")
            fill(name, re.sub(r"(float|unsigned int) \w+; ", "", body), *templates)

        def fill(name: str, body: str, *templates: str) -> None:
            for number, template in enumerate(templates):
                parts = fitted(template, body, PLAIN)
                if parts is not None:
                    found.update(parts)
                    found[f"{name} form"] = str(number)
                    return
            raise Fault(f"the header has another {prefix}_weakening_{name}")

        for name, template in CODE.items():
            read(name, template)
        read("least_flux", *LEAST)
        fill("reference", found["weakened"], *WEAKENED)
        self.numbers = {
            name: kit.number(text)
            for name, text in found.items()
            if name not in PLAIN and not name.endswith("form")
        }
        self.largest, self.reserve = self.numbers["torque_max"], self.numbers["reserve"]
        self.twice = found["reference form"] == "1"
        self.curves, self.surface = pieces(found["curves"], "t"), found["surface"] + ADDED
        self.limit = [
            (start, run(code, {"f": X}, constant)["limit"], code)
            for start, code in pieces(found["limit"], "f")
        ]
        if not 0 < self.least < self.most or self.largest <= 0 or trials != 1:
            raise Fault("the header's range of flux linkage or torque is none, or its trials are")


# Part 2. The errors of a box.
#
# With k = 1/(1.5 p), tau = k times the torque that is made, a the flux linkage that the step has
# found, s = 1 motoring and -1 generating, and u = 1/omega, voltage and limit are
#
#     u^2 |v|^2 = psi^2 + 2 R s tau u + R^2 |i|^2 u^2
#     u^2 V^2 (1 + RHO) >= a^2 + 2 R (s - KAPPA) k t u + R^2 J^2 u^2
#
# where J^2 is what the step takes for |i|^2: the reserve, on the line of MTPV where it has one, or
# what its first pass gives, i_1. RHO and KAPPA are what rounding costs (e = 2^-24): V^2 once, the
# drop 3 times in its factors, the differences twice, root and quotient 4 times in the square (7
# with the line), the squared current 5 times; so that 13 and 12 are enough for 20 and 16 here.
# So |v| <= (1 + B) V holds where, with b = (1 + B)^2/(1 + RHO),
#
#     F(u) = b a^2 - psi^2 + 2 R (s (b k t - tau) - KAPPA b k t) u + R^2 (b J^2 - |i|^2) u^2 >= 0
#
# Speeds at which that keeps V below its least value V_0 need |v| <= V_0 alone; |v|^2 is convex in
# the speed and at standstill R^2 |i|^2, so that the others are enough. They are those with u <= U,
#
#     U = (s R k t + sqrt((R k t)^2 + a^2 M))/M           M = V_0^2 - R^2 J^2
#
# F has in u Bernstein's coefficients F(0), F(0) + F'(0) U/2 and F(U): none may be negative. With
# x = p(t) - a, where p are the header's `taken`, all of this are polynomials of t and x.
# Where the field is not weakened a is p or more: in u/a all terms of F/a^2 rise with a but those
# of the torque, which die away, so that a = p is the worst, with or without them.
# The first pass has less flux linkage, a_1: as a^2 - a_1^2 <= u^2 R^2 (J^2 - i_1^2) and rounding,
# |i|^2 - |i_1|^2 is at most what |i|^2 rises with a, times what a differs by.

E = Fraction(1, 2**24)
RHO, KAPPA = 20 * E, 16 * E
NAMES = {
    "voltage_percent": "the phase voltage, drop included, exceeds its limit by {} %",
    "current_percent": "the current exceeds its limit by {} %",
    "torque_Nm": "the torque that is granted errs by {} N m",
}


class Errors:
    """The errors of a surface on a machine, against bounds that are claimed."""

    def __init__(self, surface: Surface, stated: dict[str, Any]) -> None:
        self.surface = surface
        machine = {name: Fraction(stated["machine"][name]) for name in kit.MACHINE}
        self.r_s, self.psi = machine["r_s_Ohm"], machine["psi_pm_Wb"]
        self.l_d, self.l_q = machine["l_d_H"], machine["l_q_H"]
        self.k = 1 / (Fraction(3, 2) * machine["pole_pairs"])
        self.i_max, v_max, omega = (Fraction(stated[name]) for name in LIMITS)
        bounds = {name: Fraction(text) for name, text in stated["bounds"].items()}
        self.claims = tuple(name for name in NAMES if name in bounds)
        least = (v_max * Fraction(surface.said["share"]) / 100) ** 2
        self.reserve, self.near = surface.reserve, surface.numbers.get("near")
        self.slope = surface.numbers.get("slope", Fraction(0))
        self.check_constants(least, v_max, omega)
        share = {name: bounds.get(name, Fraction(0)) / 100 for name in BOUNDS}
        self.torque = min(surface.largest * share["torque_percent"], 100 * share["torque_Nm"])
        self.current = below((self.i_max * (1 + share["current_percent"])) ** 2)
        self.b = (1 + share["voltage_percent"]) ** 2 / (1 + RHO)
        self.room = least * (1 - 64 * E) - Fraction(102, 100) * self.reserve  # M
        self.rise = self.moved = self.off = 0  # of |i|^2 with a; of it and of a by rounding
        if self.room <= 0:
            raise Fault("the resistance takes all of the voltage")
        r_s = self.r_s
        self.r_2, self.r_squared, self.r_k = map(below, (2 * r_s, r_s**2, r_s * self.k))
        self.units = {
            "b": below(self.b), "more": below(self.b - 1), "bkt": below(self.b * self.k),
            "kappa": above(KAPPA * self.b * self.k), "reserve": below(self.reserve),
            "k": below(self.k), "room": below(self.room),
        }  # fmt: skip

    def check_constants(self, least: Fraction, v_max: Fraction, omega: Fraction) -> None:
        """Constants are those of the machine, and the largest speed keeps the voltage."""
        numbers = self.surface.numbers
        square, drop = self.r_s**2, 2 * self.r_s * self.k
        for said, right in ((numbers["per_torque"], drop), (numbers.get("square", square), square)):
            if abs(said - right) > 2 * E * right:
                raise Fault("the header has another resistance than the machine")
        if self.near is not None and (self.near < 0 or self.slope <= 0):
            raise Fault("the header's line of the squared current falls below zero")
        ends = self.surface.least**2 * omega**2 * least
        if (least - self.reserve) * v_max**2 * (1 - RHO) < ends * (1 + RHO):
            raise Fault("the largest speed leaves less than FLUX_MIN_WB")

    def polynomials(self, code: str) -> tuple[list[Poly], list[Poly]]:
        """Those of a box, without and with weakening."""
        found = []
        for x, text in ((constant(0), code), (X, code + " " + self.surface.surface)):
            names = run(text, {"t": T, "delta": x}, constant)
            d, q = (names["i_d"], names["i_q"]) if x is X else (names["mtpa_d"], names["mtpa_q"])
            a = names["taken"] - x
            psi_d, psi_q = constant(self.l_d) * d + constant(self.psi), constant(self.l_q) * q
            tau = psi_d * q - psi_q * d
            found.append([a * a, psi_d * psi_d + psi_q * psi_q, tau, d * d + q * q, a])
        return found[0], found[1]

    def rounding(self, box: Box, code: str, weakens: bool) -> tuple[int, int, int]:
        """What rounding adds to i_d, i_q and a."""
        text = code + " " + self.surface.surface if weakens else code
        names = run(text, {"t": Wide(*box.t), "delta": Wide(*box.x)}, wide)
        d, q = (names["i_d"], names["i_q"]) if weakens else (names["mtpa_d"], names["mtpa_q"])
        at = max(abs(box.x[0]), abs(box.x[1]))
        return d.err, q.err, names["taken"].err + kit.half_place(at)

    def rooms(self, box: Box, code: str, weakens: bool) -> Room:
        """What rounding adds to a^2, psi^2, tau and |i|^2, and the last bits of the polynomials."""
        by_d, by_q, by_a = self.rounding(box, code, weakens)
        size = isqrt(max(box.ends(3)[1], 0) << BITS) + 1 + by_d + by_q  # of each current
        a = max(map(abs, box.ends(4))) + by_a
        psi = above(self.psi)
        flux = [
            2 * times(times(above(inductance), by), times(above(inductance), size) + more)
            for inductance, by, more in ((self.l_d, by_d, psi), (self.l_q, by_q, 0))
        ]
        apart = times(above(abs(self.l_d - self.l_q)), size)
        last = 40 * box.depth + 8
        return (
            2 * times(a, by_a) + last,
            sum(flux) + last,
            times(psi + apart, by_q) + times(apart, by_d) + last,
            2 * times(size, by_d + by_q) + last,
        )

    def largest_u(self, torque: int, a: int, s: int) -> int:
        """U at a torque (the least for s = -1) and a flux linkage, rounded up."""
        drop = times(self.r_k + 1, torque) if s > 0 else self.r_k * torque >> BITS
        root = isqrt(drop * drop + (a * a * self.units["room"] >> BITS) + ONE) + 1
        return (root + s * drop << BITS) // self.units["room"] + 1

    def failing(self, box: Box, rooms: Room, weakens: bool, claim: str) -> Rows | None:
        """What should be nowhere negative on the box and may be; None where all is proven."""
        n, t = len(box.rows) - 1, box.t
        if claim == "current_percent":
            rows = [[self.current - c for c in row[3::5]] for row in box.rows]
            return rows if lacking(box, rows, rooms[3]) else None
        if claim == "torque_Nm":
            k, off, room = self.units["k"], below(self.torque * self.k), rooms[2] + 2
            for s in (1, -1):
                rows = []
                for i, row in enumerate(box.rows):
                    kt = (t[0] * (n - i) + t[1] * i) // max(n, 1) * k >> BITS
                    rows.append([off - s * (c - kt) for c in row[2::5]])
                if lacking(box, rows, room + t[1] // ONE):
                    return rows
            return None
        return self.failing_voltage(box, rooms, weakens)

    def failing_voltage(self, box: Box, rooms: Room, weakens: bool) -> Rows | None:
        """As `failing`, of F in each direction and after each pass."""
        square = times(self.r_squared + 1, box.ends(3)[1] + rooms[3])
        if 50 * square > 51 * self.units["reserve"]:
            return [[self.current - c for c in row[3::5]] for row in box.rows]
        least = below(self.surface.least)
        a_low, a_high = (max(a, least) for a in box.ends(4))
        drop = times(self.r_k + 1, box.t[1])
        for s in (1, -1):
            torque = box.t[1] if s > 0 else box.t[0] if weakens else 0
            u = self.largest_u(torque, a_high, s)
            taken = self.units["reserve"]  # R^2 J^2, at least
            if self.near is not None:
                line = below(self.near) + (below(self.slope) * (a_low * a_low >> BITS) >> BITS)
                taken = min(taken, line)
                if 8 * times(drop, u) > 3 * (a_low * a_low >> BITS):  # the root of M is too small
                    return [[self.current - c for c in row[3::5]] for row in box.rows]
            uu, ww, moved = times(u, u), times(times(self.r_squared + 1, u), u), 0
            if self.surface.twice:
                rounding = (a_high * a_high >> BITS) + 2 * times(drop, u)
                squares = times(uu, self.units["reserve"])
                squares += times(above(80 * E), rounding + squares)
                apart = (squares << BITS) // (a_low + least) + 2 * self.off
                moved = times(self.rise, apart) + 2 * self.moved
            room = times(self.units["b"] + 1, rooms[0]) + rooms[1] + (ONE >> 100)
            room += times(times(self.r_2 + 1, u), rooms[2]) + times(ww, rooms[3])
            found = self.falling(box, (s, u, taken, moved), room, weakens)
            if found is not None:
                return found
        return None

    def falling(self, box: Box, at: Room, room: int, weakens: bool) -> Rows | None:
        """The coefficients of F in u that may be negative; None if none may be."""
        s, u, taken, moved = at
        b, bkt, kappa = (self.units[name] for name in ("b", "bkt", "kappa"))
        uu, n, w = u * u >> BITS, max(len(box.rows) - 1, 1), self.r_2 * u >> BITS
        ww, constants = self.r_squared * uu >> BITS, [(0, b * (taken * uu >> BITS) >> BITS)]
        if self.surface.twice:
            constants.append((self.units["more"], -(b * (ww * moved >> BITS) >> BITS)))
        least = b * below(self.surface.least**2) >> BITS
        for plain in (False, True):  # FLUX_MIN_WB is available wherever the field is not weakened
            starts, slopes = [], []
            for i, row in enumerate(box.rows):
                t = (box.t[0] * (n - i) + box.t[1] * i) // n
                made, lost, taus = bkt * t >> BITS, kappa * t >> BITS, row[2::5]
                slopes.append([w * (s * (made - tau) - lost) >> BITS for tau in taus])
                squares = [least] * len(taus) if plain else [b * c >> BITS for c in row[0::5]]
                starts.append([c - psi for c, psi in zip(squares, row[1::5])])
            ends = [
                [
                    [ww * ((more * c >> BITS) - (0 if more else c)) + (rest << BITS) >> BITS
                     for c in row[3::5]]
                    for row in box.rows
                ]
                for more, rest in constants
            ]  # fmt: skip
            tried = [starts, summed(starts, [[c >> 1 for c in row] for row in slopes])]
            tried += [summed(summed(starts, slopes), end) for end in ends]
            if not weakens:
                tried += [summed(starts, end) for end in ends]
            found = next((rows for rows in tried if lacking(box, rows, room)), None)
            if found is None or weakens:
                return found
        return found


# Part 3. The domain: 0 <= t <= TORQUE, FLUX_MIN_WB <= a <= FLUX_MAX_WB, t at most the limit at a.

MOST_BOXES, DEEPEST, FIRST = 60_000, 60, 10


class Limit:
    """The largest torque that the step grants within a flux linkage."""

    def __init__(self, surface: Surface) -> None:
        self.least, width = below(surface.least), below(surface.most - surface.least)
        self.step = 1 << max(0, width.bit_length() - 25)  # what the difference may be rounded by
        self.parts: list[tuple[int, int, list[int]]] = []
        self.bends: list[int] = []  # no second derivative is above
        self.lost, err, before = 0, 0, 0  # what a rounded limit may lose as a rises
        ends = [below(start) for start, _, _ in surface.limit[1:]] + [width + self.step]
        for (first, poly, code), end in zip(surface.limit, ends):
            start = below(first)
            if end <= start:
                break
            power = poly.degree(1)
            slopes = Poly({(0, j - 1): j * c for (_, j), c in poly.terms.items() if j})
            found = slopes.on(((0, 0), (start, end)), (0, max(power - 1, 0)))[0]
            self.lost += times(max(-min(found) + 1, 0), end - start)
            bends = Poly({(0, j - 1): j * c for (_, j), c in slopes.terms.items() if j})
            self.bends.append(
                max(0, *bends.on(((0, 0), (start, end)), (0, max(power - 2, 0)))[0]) + 1
            )
            bottom = min(poly.on(((0, 0), (start, end)), (0, power))[0])
            err = max(err, run(code, {"f": Wide(start, end)}, wide)["limit"].err)
            if bottom < 2 * err:
                raise Fault("the largest torque may be below zero")
            self.parts.append(
                (start, end, [below(poly.terms.get((0, j), Fraction(0))) for j in range(power + 1)])
            )
            self.lost += max(before - self.at(start) + 2, 0)
            before = horner(self.parts[-1][2], end)
        self.lost += 2 * err

    def at(self, f: int) -> int:
        """Its polynomial above the least flux linkage."""
        return horner(next(c for s, e, c in reversed(self.parts) if s <= f or s == 0), f)

    def over(self, box: Box, off: int) -> Rows | None:
        """No less than the limit less t on a box that reaches beyond it: its tangent in a, raised
        by how it bends; None where no part of the limit serves alone.
        """
        low, high = box.ends(4)
        low, high = max(low - self.least, 0), min(high - self.least, self.parts[-1][1])
        if low > high or self.at(low) > box.t[1] + (ONE >> 30):
            return None
        n, middle, half = len(box.rows) - 1, low + high >> 1, (high - low >> 1) + 1 + off
        for (start, end, row), bend in zip(self.parts, self.bends):
            if (start <= low - off or start == 0) and (
                high + off + self.step < end or end == self.parts[-1][1]
            ):
                slope = horner([j * c for j, c in enumerate(row)][1:] or [0], middle)
                top = horner(row, middle) + times(times(half, half), bend) + self.lost
                top += times(abs(slope), off + self.step) + (ONE >> 100)
                return [
                    [
                        top + (slope * (a - self.least - middle) >> BITS)
                        - (box.t[0] * (n - i) + box.t[1] * i) // n
                        for a in line[4::5]
                    ]
                    for i, line in enumerate(box.rows)
                ]  # fmt: skip
        return None

    def above(self, a: int) -> int:
        """No torque above it is granted with a flux linkage up to a."""
        end = self.parts[-1][1]
        return self.at(min(max(a - self.least, 0) + self.step, end)) + self.lost + (ONE >> 100)


class Domain:
    """Goes over all boxes of a surface."""

    def __init__(self, errors: Errors) -> None:
        self.errors, self.surface = errors, errors.surface
        self.limit, self.count = Limit(self.surface), 0
        self.least, self.most = below(self.surface.least), below(self.surface.most)

    def first(self) -> list[tuple[Box, str, bool]]:
        """A box per segment and state; sets what rounding moves the flux linkage by."""
        found, curves, errors = [], self.surface.curves, self.errors
        ends = [start for start, _ in curves[1:]] + [self.surface.largest]
        for (start, code), last in zip(curves, ends):
            t = below(start), below(min(last, self.surface.largest))
            if t[1] <= t[0]:
                continue
            plain, weak = errors.polynomials(code)
            top = max(plain[4].on((t, (0, 0)), (plain[4].degree(0), 0)))[0]
            errors.off = max(
                errors.off, errors.rounding(Box(t, (0, top), [], 0, ()), code, weakens=False)[2]
            )
            spans = [((0, 0), plain), ((0, top - self.least + 2 * errors.off), weak)]
            for x, polys in spans:
                if x[1] >= x[0]:
                    degrees = max(p.degree(0) for p in polys), max(p.degree(1) for p in polys)
                    each = [poly.on((t, x), degrees) for poly in polys]
                    rows = [[c for cs in zip(*lines) for c in cs] for lines in zip(*each)]
                    found.append((Box(t, x, rows, 0, errors.claims), code, polys is weak))
        return found

    def outside(self, box: Box, weakens: bool) -> bool:
        """Whether no point of a box is in the domain."""
        low, high = (a + s * self.errors.off for s, a in zip((-1, 1), box.ends(4)))
        if not weakens:
            return low > self.most
        return high < self.least or low > self.most or box.t[0] > self.limit.above(high)

    def moves(self, boxes: list[tuple[Box, str, bool]]) -> None:
        """Bounds how |i|^2 rises with the flux linkage, and by rounding."""
        waiting = [each for each in boxes if each[2]]
        while waiting:
            box, code, weakens = waiting.pop()
            if self.outside(box, weakens):
                continue
            if box.depth < FIRST:
                waiting += [(half, code, weakens) for half in box.cut(box.depth % 2 == 0)]
                continue
            m, errors = len(box.rows[0]) // 5 - 1, self.errors
            falls = [x - y for row in box.rows for x, y in zip(row[3::5], row[8::5])]
            rise = (max([0, *falls]) + 100 * box.depth + 9) * m
            errors.rise = max(errors.rise, (rise << BITS) // (box.x[1] - box.x[0]) + 1)
            errors.moved = max(errors.moved, errors.rooms(box, code, weakens)[3])

    def check(self) -> None:
        """Raises unless all claims hold in all boxes."""
        boxes = self.first()
        if self.surface.twice and "voltage_percent" in self.errors.claims:
            self.moves(boxes)
        while boxes:
            box, code, weakens = boxes.pop()
            if self.outside(box, weakens):
                continue
            self.count += 1
            still: list[str] = []
            failed, rooms = None, self.errors.rooms(box, code, weakens)
            if weakens:
                box.inside = self.limit.over(box, self.errors.off)
            for claim in box.open:
                rows = self.errors.failing(box, rooms, weakens, claim)
                if rows is not None:
                    still.append(claim)
                    failed = failed or rows
            if failed is None:
                continue
            if box.depth >= DEEPEST or self.count > MOST_BOXES:
                ends = ", ".join(
                    " to ".join(f"{end / ONE:.6g}" for end in span) + unit
                    for span, unit in ((box.t, " N m"), (box.x, " Wb too much"))
                )
                raise Fault(f"surface, {still[0]}: not within its bound at {ends}")
            box.open = tuple(still)
            along = not weakens or self.direction(box, failed)
            boxes += [(half, code, weakens) for half in box.cut(along)]

    def direction(self, box: Box, rows: Rows) -> bool:
        """Whether to cut across t: there the function that fails bends more, or runs more where the
        box reaches out of the domain.
        """
        low, high = box.ends(4)
        inside = self.least <= low and high <= self.most and self.limit.above(low) >= box.t[1]
        sizes = []
        for lines in (rows, turn(rows)):
            count = max(len(lines) - 1, 1)
            found = [[y - x for x, y in zip(*pair)] for pair in pairwise(lines)]
            if inside and len(found) > 1:
                found = [[y - x for x, y in zip(*pair)] for pair in pairwise(found)]
                count *= count
            sizes.append(count * max((abs(c) for row in found for c in row), default=0))
        return sizes[0] >= sizes[1]


# Part 4. What is confirmed.


def check_surface(stated: dict[str, Any], text: str, main_text: str, prefix: str) -> str:
    """What is confirmed of a certificate, in words."""
    surface = Surface(text, prefix)
    said = surface.said
    machine = kit.read_machine(stated["machine"], kit.Header(main_text, prefix))
    shown = {name: Fraction(stated[name]) for name in LIMITS}
    shown |= {"poles": machine["pole_pairs"], "r_s_Ohm": machine["r_s_Ohm"]}
    shown["torque_max"] = surface.largest
    for name, number in shown.items():
        if f"{float(number):.6g}" != said[name] or number <= 0:
            raise Fault(f"{name}: the header says {said[name]}")
    volts = Fraction(said["volts"] + {"V": "", "kV": "e3", "mV": "e-3"}[said["unit"]])
    if abs(volts / shown["v_max_V"] - 1) > Fraction(6, 10**4):  # it has four digits
        raise Fault(f"v_max_V: the header has bounds for {said['volts']} {said['unit']}")
    for name, bound in stated["bounds"].items():
        if name not in BOUNDS or said[name] is None or Fraction(said[name]) != Fraction(bound):
            raise Fault(f"{name}: the header states another bound")
    if ("torque_Nm" in stated["bounds"]) != ("torque_percent" in stated["bounds"]):
        raise Fault("torque_Nm: one bound of the torque stands without the other")
    errors = Errors(surface, stated)
    domain = Domain(errors)
    domain.check()
    parts = [NAMES[name].format(stated["bounds"][name]) for name in errors.claims]
    return (
        f"at most, {prefix}_weakening_reference: {'; '.join(parts)}; for every torque of either "
        f"sign, voltages from {said['share']} % of {said['v_max_V']} V up and speeds up to "
        f"{said['omega_e_rad_per_s']} rad/s in proportion, rounding included ({domain.count} boxes)"
    )


def claims(stated: dict[str, Any], beside: kit.Beside) -> Iterator[str]:
    """What is not covered, and the claim that is confirmed, in words."""
    left = ["torque beyond reach against the largest", "copper loss"]
    left += [f"its bound {name}" for name in BOUNDS if name not in stated["bounds"]]
    yield f"of the surface {', '.join(left)}"
    texts = beside.text("_weakening.h"), beside.text(".h")
    yield check_surface(stated, *texts, beside.prefix)


main = kit.program("check_surface", "_surface.json", claims)

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
