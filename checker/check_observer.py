"""Confirms `<prefix>_observer.json`: errors of the flux observer of `<prefix>_observer.h` die away.

    python -I -S check_observer.py pump_observer.json

The program imports nothing but the standard library and, beside it, `kit.py` and `cells.py`. It
calculates in integers and fractions alone, and believes nothing in the certificate: the numbers of
the observer and its C are read from the header's text, speeds are cut into cells here, and the
matrix of the certificate counts only where it does what it should. Read it from top to bottom: the
header (part 1), the error (part 2), the range (part 3), and what is confirmed (part 4).
"""

from __future__ import annotations

import itertools
import re
import sys
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import cells, kit
else:  # run alone: they lie beside this one
    sys.path.insert(0, str(Path(__file__).resolve().parent))
    import cells
    import kit

ONE, Fault, below = kit.ONE, kit.Fault, kit.below
Rows = cells.Rows
Span = cells.Span
Matrix = list[list[Fraction]]


# Part 1. The header: numbers of the observer, and the C that part 2 is about.

# Members in the order in which the header has them; the same stands in its types.
MEMBERS = {
    "flux_path": ("t_s", "drop", "half_drop", "end", "l_q"),
    "pll_gains": ("t_s", "l_1", "l_2"),
    "flux_gains": ("path", "l_d", "l_q", "psi_pm", "alpha_0", "alpha_1", "floor", "pll"),
}
CODE = {
    "flux_of_current": (
        "const P_dq_t current = P_park(i, turn); "
        "const P_dq_t psi = { (l_d * current.d) + psi_pm, l_q * current.q }; "
        "return P_park_inverse(psi, turn);"
    ),
    "flux_of_voltage": (
        "P_alphabeta_t result; const P_alphabeta_t first = { "
        "(path->t_s * v.alpha) - (path->half_drop * (last.alpha + i.alpha)), "
        "(path->t_s * v.beta) - (path->half_drop * (last.beta + i.beta)) }; "
        "const P_alphabeta_t change = { i.alpha - last.alpha, i.beta - last.beta }; "
        "const P_alphabeta_t turning = { first.alpha - (path->l_q * change.alpha), "
        "first.beta - (path->l_q * change.beta) }; result.alpha = psi.alpha + (first.alpha - "
        "(path->end * ((path->drop * change.alpha) - (x * turning.beta)))); result.beta = psi.beta "
        "+ (first.beta - (path->end * ((path->drop * change.beta) + (x * turning.alpha)))); "
        "return result;"
    ),
    "flux_error": (
        "const P_alphabeta_t active = { psi.alpha - (l_q * i.alpha), psi.beta - (l_q * i.beta) }; "
        "const float size = sqrtf((active.alpha * active.alpha) + (active.beta * active.beta)); "
        "return P_park(active, turn).q / ((size > least) ? size : least);"
    ),
    "park": (
        "P_dq_t result; result.d = (x.alpha * turn.cosine) + (x.beta * turn.sine); "
        "result.q = (x.beta * turn.cosine) - (x.alpha * turn.sine); return result;"
    ),
    "park_inverse": (
        "P_alphabeta_t result; result.alpha = (x.d * turn.cosine) - (x.q * turn.sine); "
        "result.beta = (x.q * turn.cosine) + (x.d * turn.sine); return result;"
    ),
    "flux_step": (
        "if (observer->started == 0) { observer->psi = P_flux_of_current(gains->l_d, gains->l_q, "
        "gains->psi_pm, i, P_rotation(observer->theta_e)); observer->started = 1; } else { "
        "const float x = gains->pll.t_s * observer->omega_e; "
        "const float theta = P_wrap(observer->theta_e + x); "
        "const P_rotation_t turn = P_rotation(theta); const P_alphabeta_t drawn = "
        "P_flux_of_voltage(&gains->path, observer->psi, v, observer->i, i, x); "
        "const P_alphabeta_t known = P_flux_of_current(gains->l_d, gains->l_q, gains->psi_pm, i, "
        "turn); const float share = (gains->alpha_1 * fabsf(x)) + gains->alpha_0; "
        "const float alpha = (share < 1.0F) ? share : 1.0F; const P_alphabeta_t psi = { "
        "drawn.alpha + (alpha * (known.alpha - drawn.alpha)), "
        "drawn.beta + (alpha * (known.beta - drawn.beta)) }; const float error = "
        "P_flux_error(psi, gains->l_q, i, turn, gains->floor); observer->psi = psi; "
        "observer->theta_e = P_wrap(theta + (gains->pll.l_1 * error)); "
        "observer->omega_e = observer->omega_e + (gains->pll.l_2 * error); } observer->i = i;"
    ),
}


class Observer:
    """Numbers of the header's observer."""

    def __init__(self, text: str, prefix: str) -> None:
        code = " ".join(kit.uncommented(text).split())
        code = code.replace(f"{prefix}_", "P_").replace(f"{prefix.upper()}_", "P_")
        for name, body in CODE.items():
            found = re.findall(rf"\bP_{name}\([^)]*\) {{ (.*?) }} (?:static|#|typedef)", code)
            if found != [body]:
                raise Fault(f"the header has another {prefix}_{name}")
        for name, members in MEMBERS.items():
            found = re.findall(rf"{{ ([^{{}}]*) }} P_{name}_t;", code)
            if len(found) != 1 or tuple(re.findall(r"(\w+);", found[0])) != members:
                raise Fault(f"the header has another {prefix}_{name}_t")
        found = re.findall(r"const P_flux_gains_t P_FLUX_GAINS = {([^;]*)};", code)
        if len(found) != 1:
            raise Fault(f"the header has not one {prefix.upper()}_FLUX_GAINS")
        listed = [kit.single(Fraction(each)) for each in re.findall(r"[-\d.e+]+(?=F)", found[0])]
        if len(listed) != 14 or "{" not in found[0]:
            raise Fault(f"{prefix.upper()}_FLUX_GAINS has not 14 numbers")
        self.t_s, drop, half_drop, self.end, l_q_path = listed[:5]
        self.l_d, self.l_q, self.psi_pm, self.alpha_0, self.alpha_1, self.floor = listed[5:11]
        t_s, self.l_1, self.l_2 = listed[11:]
        if t_s != self.t_s or l_q_path != self.l_q or 2 * half_drop != drop:
            raise Fault("the numbers of the observer contradict each other")
        if min(self.t_s, self.l_q, self.psi_pm, self.floor) <= 0 or self.floor >= self.psi_pm:
            raise Fault("the period, inductance or flux linkage of the observer is not positive")


# Part 2. The error.
#
# All in rotor coordinates and over the active flux a = psi_pm + (L_d - L_q) i_d = psi_pm, i_d = 0.
# With d (complex) the error of the flux linkage, theta that of the angle, w = t_s times that of the
# speed, x = omega t_s, m = (L_d - L_q) i_q/a, and machine, currents and voltages as they are known,
# a step leads, but for terms of second order, to
#
#     p = theta + w                    the angle ahead, wrong by p
#     drawn: exp(-j x) d - j e (1 - exp(-j x)) w     (e: `end`; `turning` is what a turned by)
#     known: (m + j) p                 by Park with a wrong angle: L_d i_q p on d, -L_q i_d p on q
#     d+ = (1 - alpha) drawn + alpha known           alpha = alpha_0 + alpha_1 x
#     r = Im d+ - p                    the sine of the angle from the estimated axis to a
#     theta+ = p + l_1 r               w+ = w + t_s l_2 r
#
# The matrix is straight in each of cos x, sin x, alpha and m: over a box of these it is a mean of
# those in the corners, and z' P z falls from step to step by l^2 at least, whatever x and m are
# each time, if l^2 P - A' P A > 0 in all corners of boxes that hold them.


def error_matrix(observer: Observer, corner: tuple[Fraction, ...]) -> Matrix:
    """The error after a step over that before: d along d and q, theta, w."""
    cosine, sine, alpha, m = corner
    keep, end = 1 - alpha, observer.end
    along = [keep * cosine, keep * sine, alpha * m, alpha * m + keep * end * sine]
    across = [-keep * sine, keep * cosine, alpha, alpha - keep * end * (1 - cosine)]
    ahead = [Fraction(0), Fraction(0), Fraction(1), Fraction(1)]
    rest = [x - y for x, y in zip(across, ahead)]
    angle = [x + observer.l_1 * y for x, y in zip(ahead, rest)]
    speed = [observer.t_s * observer.l_2 * y for y in rest]
    speed[3] += 1
    return [along, across, angle, speed]


def falls(matrix: Rows, square: int, after: Matrix) -> bool:
    """Whether l^2 P - A' P A is positive definite; P and l^2 in units, l^2 rounded down."""
    before = [[square * x >> kit.BITS for x in row] for row in matrix]
    step = cells.Block([[below(x) for x in row] for row in after], 1)
    return cells.falls(before, matrix, step, [0] * len(matrix))


# Part 3. The range of speeds: cut into cells until all are proven.

NARROWEST = Fraction(1, 2**10)  # Of the range: a cell that is not proven there is a fault.


def turned_by(x: Fraction) -> tuple[Span, Span]:
    """Enclosures of cos x and sin x."""
    turn = below(x)
    found = cells.exponential([[0, -turn], [turn, 0]])
    cosine, sine = found.rows[0][0], found.rows[1][0]
    ends = [(Fraction(y - found.r, ONE), Fraction(y + found.r, ONE)) for y in (cosine, sine)]
    return ends[0], ends[1]


def check_range(observer: Observer, matrix: Rows, square: int, omega: Span, i_q: Fraction) -> int:
    """Goes over all speeds; in how many cells."""
    m = abs(observer.l_d - observer.l_q) * i_q / observer.psi_pm
    waiting, done = [(omega[0] * observer.t_s, omega[1] * observer.t_s)], 0
    while waiting:
        low, high = waiting.pop()
        (_, most), (least_sine, _) = turned_by(low)
        (least, _), (_, most_sine) = turned_by(high)
        alphas = [observer.alpha_0 + observer.alpha_1 * x for x in (low, high)]
        box = ((least, most), (least_sine, most_sine), alphas, sorted({-m, m}))
        corners = itertools.product(*box)
        if all(falls(matrix, square, error_matrix(observer, corner)) for corner in corners):
            done += 1
            continue
        middle = Fraction(below((low + high) / 2), ONE)
        if high - low < (omega[1] - omega[0]) * observer.t_s * NARROWEST or low == high:
            ends = " to ".join(f"{float(x / observer.t_s):.6g}" for x in (low, high))
            raise Fault(f"observer, {ends} rad/s: its matrix does not prove it")
        waiting += [(middle, high), (low, middle)]
    return done


# Part 4. What is confirmed.


def check_observer(stated: dict[str, Any], text: str, prefix: str) -> str:
    """What is confirmed of a certificate, in words."""
    observer = Observer(text, prefix)
    low, high = (Fraction(end) for end in stated["omega_e"])
    i_q, factor = Fraction(stated["i_q"]), Fraction(stated["contraction"])
    if not 0 < low <= high or high * observer.t_s > Fraction(3, 2) or i_q < 0:
        raise Fault("observer: its range is none, or beyond 1.5 rad per sample")
    if not 0 < factor < 1 or observer.alpha_0 + observer.alpha_1 * high * observer.t_s >= 1:
        raise Fault("observer: its errors do not shrink, or nothing of the voltage model is left")
    matrix = cells.symmetric(stated["matrix"], 4)
    check_range(observer, matrix, below(factor * factor), (low, high), i_q)
    return (
        f"small errors of {prefix}_flux_step on the machine that it knows shrink by "
        f"{float(factor):g} per sample or faster, in one norm, while the electrical speed varies "
        f"in any way from {float(low):.6g} to {float(high):.6g} rad/s, either way round, and the q "
        f"current up to {float(i_q):.6g} A at i_d = 0"
    )


def claims(stated: dict[str, Any], beside: kit.Beside) -> Iterator[str]:
    """What is not covered, and the claim that is confirmed, in words."""
    yield (
        "rounding of the observer and of its cosine, a machine other than it "
        "knows, large errors, standstill, what the voltage model leaves of changing currents"
    )
    yield check_observer(stated, beside.text("_observer.h"), beside.prefix)


main = kit.program("check_observer", "_observer.json", claims)

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
