"""What paper 000's method gives, costs and heats, in tables: printed beside recomputed."""

from __future__ import annotations

import textwrap

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper000.core_costs import (
    CLOCK_MHZ,
    CORES,
    PRINTED_MICROSECONDS,
    CoreCosts,
    Cost,
)
from dqforge.reports.papers.paper000.heat import SLOWEST, TIME_CONSTANT, HeatCurve
from dqforge.reports.papers.paper000.printed_polynomial import PrintedPolynomial
from dqforge.reports.papers.paper000.stated_method import (
    DIFFERS,
    STATED_LARGEST,
    STATED_SHARE,
    ErrorCurve,
    Segment,
)

_WIDTH = 118


_METHODS = {
    "direct": "i_d = 0",
    "morimoto": "Morimoto",
    "horner_2": "degree 2, Horner",
    "horner_3": "degree 3, Horner",
    "horner_4": "degree 4, Horner",
    "powers_2": "degree 2, powers",
    "powers_3": "degree 3, powers",
    "powers_4": "degree 4, powers",
    "emitted": "degree 4, emitted",
    "emitted_q15": "degree 4, emitted in Q15",
}


_CORE_NAMES = {
    "cortex-m4": "M4F",
    "cortex-m33": "M33",
    "cortex-m7": "M7",
    "cortex-m0plus": "M0+",
}


def _wrapped(*texts: str) -> tuple[str, ...]:
    return tuple(
        line for text in texts for line in textwrap.wrap(text, _WIDTH, break_on_hyphens=False)
    )


def _coefficient(value: float) -> str:
    return f"{value:.3g}"


def coefficient_table(segments: tuple[Segment, ...]) -> Table:
    """Printed coefficients beside those of the stated method."""
    rows = tuple(
        (
            row.axis,
            str(row.degree),
            str(row.segment),
            " ".join(
                f"{_coefficient(value)}{'*' if marked else ''}"
                for value, marked in zip(row.printed, row.marked, strict=True)
            ),
            " ".join(_coefficient(value) for value in row.stated),
            f"{row.largest:.3f}",
        )
        for row in segments
    )
    notes = _wrapped(
        f"Highest power first, A/(N m)^k; * marks what is off by more than {100.0 * DIFFERS:.0f} "
        "%. The constants of all first segments are printed as 0, where interpolation on Chebyshev "
        "nodes does not pass through 0; degree 4 follows from the stated method elsewhere, degrees "
        "2 and 3 only in part: their breakpoints or nodes must have been others than those printed."
    )
    return Table(
        "Paper 000, Table 2: printed coefficients beside Lagrange on Chebyshev nodes of each "
        "segment, (20) to (29)",
        ("axis", "degree", "segment", "printed", "by the stated method", "apart by at most A"),
        rows,
        notes,
    )


def error_table(curves: tuple[ErrorCurve, ...]) -> Table:
    """Largest errors of Figure 4."""
    rows = tuple(
        (
            str(curve.degree),
            f"{STATED_LARGEST:.2f} ({100.0 * STATED_SHARE:.2f} %)" if curve.degree == 2 else "-",
            f"{curve.largest:.3f}",
            f"i_{curve.axis} at {curve.place:.0f} N m",
            f"{100.0 * curve.share:.2f}",
        )
        for curve in curves
    )
    return Table(
        "Paper 000, Figure 4: largest error of the printed polynomials up to 250 N m",
        ("degree", "printed A", "here A", "where", "of the reference there %"),
        rows,
        _wrapped(
            "1.09 A are 1.53 % of a current of 71 A, where the printed coefficients err by 0.75 A "
            "at most: the two printed figures are not of one point. Degree 3 on i_q has too few "
            "printed digits."
        ),
    )


def header_table(found: PrintedPolynomial) -> Table:
    """The printed polynomials as emitted C."""
    rows = tuple(
        (
            row.axis,
            f"{limit:.2f}",
            f"{row.rms:.4f}",
            f"{row.largest:.4f}",
            f"{row.largest_in_domain:.4f}",
        )
        for row, limit in zip(found.errors, found.breakpoints, strict=True)
    )
    proof = (
        f"{found.compared} results of the compiled header equal its model bit for bit."
        if found.compared
        else f"Not run: {found.missing}"
    )
    return Table(
        f"Paper 000: its own polynomials of degree {found.degree} as a header, 0 to 5 p.u. "
        f"({found.torque_max:.1f} N m)",
        ("axis", "breakpoint N m", "r.m.s. to 250 N m A", "largest A", "largest to 5 p.u. A"),
        rows,
        _wrapped(
            f"{proof} Breakpoints per axis as printed; float32 against the exact MTPA. With "
            "--figures the header is written beside them."
        ),
    )


def _cost(cost: Cost | None, clock: bool) -> tuple[str, str, str]:
    if cost is None:
        return "-", "-", "-"
    low, high = cost.cycles
    time = f"{low / CLOCK_MHZ:.2f}-{high / CLOCK_MHZ:.2f}" if clock else "-"
    return f"{cost.instructions:.0f}", f"{low:.0f}-{high:.0f}", time


def cost_table(found: CoreCosts) -> Table:
    """Table 3 on every core."""
    rows: list[tuple[str, ...]] = []
    for row in found.rows:
        clock = row.core == CORES[0]
        printed = PRINTED_MICROSECONDS.get(row.method) if clock else None
        plain, optimised, single = (
            _cost(cost, clock) for cost in (row.plain, row.optimised, row.single)
        )
        rows.append(
            (
                _CORE_NAMES[row.core],
                _METHODS[row.method],
                "-" if printed is None else f"{printed:.3g}",
                *plain,
                optimised[1],
                single[0],
                single[1],
            )
        )
    rows += [
        (_CORE_NAMES[core], reason, *["-"] * 7) for core, reason in sorted(found.left_out.items())
    ]
    columns = (
        "core",
        "method",
        "printed us",
        "-O0 instr.",
        "-O0 cycles",
        "-O0 us",
        "-O2 cycles",
        "float32 instr.",
        "float32 cycles",
    )
    return Table(
        "Paper 000, Table 3: from a torque to both currents, a called function; M4F at 84 MHz as "
        "in the paper",
        columns,
        tuple(rows),
        _wrapped(*_cost_notes(found)),
    )


def _cost_notes(found: CoreCosts) -> list[str]:
    text = [
        (
            "Instructions are counted on the emulated core, cycles estimated (lo to hi, no wait "
            "states). -O0 and -O2: the root and the powers of the library in double precision, in "
            "software; float32: -O2, sqrtf, products for powers, integers in the last line of each."
        )
    ]
    if CORES[0] in found.left_out:
        return text
    ratios = [
        printed / found.microseconds(method, "plain")[1]
        for method, printed in PRINTED_MICROSECONDS.items()
    ]
    root = found.microseconds("morimoto", "single")
    text.append(
        f"The printed times are {min(ratios):.2f} to {max(ratios):.2f} times the upper estimates "
        "of the build without optimisation: that and double precision in software explain them. "
        f"With sqrtf and -O2 Morimoto takes {root[0]:.2f} to {root[1]:.2f} us, less than any of "
        "the polynomials. It goes from i_q to i_d; what polynomials replace is the quartic from "
        "the torque to both, machines without a formula, and floats on cores that have none."
    )
    return text


def heat_table(curves: tuple[HeatCurve, ...]) -> Table:
    """Losses and temperatures at the end of Figure 5."""
    rows = tuple(
        (
            curve.name,
            f"{curve.printed_total:.0f}",
            f"{curve.total:.1f}",
            f"{curve.printed_junction:.2f}",
            f"{curve.junction:.2f}",
            f"{curve.slow_junction:.2f}",
            f"{float(curve.loss.max()):.0f}",
        )
        for curve in curves
    )
    return Table(
        "Paper 000, Figure 5(e): losses and junction temperature between 5.9 and 6 s, from the "
        "simulated currents",
        (
            "alternative",
            "printed W",
            "here W",
            "printed degC",
            "here degC",
            f"with {SLOWEST:g} s",
            "largest W",
        ),
        rows,
        _wrapped(
            "The paper gives the on-resistance (9.5 mOhm) and three temperatures; 0.051 K per watt "
            "of inverter loss over 64 degC follow from them. A time constant it does not give: "
            f"{TIME_CONSTANT:g} s is assumed, and up to {SLOWEST:g} s the end is the same within "
            "0.2 K. Losses do not depend on temperature, for the paper gives no such data; the "
            "ripple of the temperature within a turn is left out. The switching energy is that of "
            "Table 4's first column."
        ),
    )
