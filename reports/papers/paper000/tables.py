"""Paper 000 in tables: printed beside recomputed, with what is wrong in the print."""

from __future__ import annotations

import textwrap

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper000.ipmsm_tables import BreakpointRow, PolynomialRow, Reproduction
from dqforge.reports.papers.paper000.load_test import LoadTest
from dqforge.reports.papers.paper000.loss_columns import LossRow
from dqforge.reports.papers.paper000.method_tables import (
    coefficient_table,
    cost_table,
    error_table,
    header_table,
    heat_table,
)
from dqforge.reports.papers.paper000.whole_paper import WholePaper

_WIDTH = 118


def whole_tables(found: WholePaper) -> list[Table]:
    """Everything for the terminal, in the order of the paper."""
    first, second, *fourth = reproduction_tables(found.tables)
    simulated = (
        [Table("Paper 000, Figure 5", notes=(f"Left out: {found.left_out}",))]
        if found.left_out
        else [load_test_table(found.load_tests), heat_table(found.heat)]
    )
    return [
        first,
        second,
        coefficient_table(found.stated.segments),
        error_table(found.stated.errors),
        header_table(found.header),
        cost_table(found.costs),
        *fourth,
        *simulated,
    ]


def reproduction_tables(reproduction: Reproduction) -> list[Table]:
    """Tables for the terminal, printed values beside the recomputed ones."""
    return [
        _table_1_text(reproduction.breakpoints),
        _table_2_text(reproduction.polynomials),
        *_table_4_text(reproduction.losses),
    ]


def _table_1_text(rows: tuple[BreakpointRow, ...]) -> Table:
    return Table(
        "Paper 000, Table 1: reduction of epsilon by a second segment, Lagrange on Chebyshev nodes "
        "over 0 to 5 p.u.",
        (
            "degree",
            "phi_d, phi_q p.u.",
            "printed %",
            "recomputed there %",
            "best phi_d, phi_q p.u.",
            "reached %",
        ),
        tuple(
            (
                str(row.degree),
                "{:.4f}, {:.4f}".format(*row.printed_breakpoints),
                f"{row.printed_reduction:.4f}",
                f"{row.reduction:.2f}",
                "{:.4g}, {:.4g}".format(*row.best_breakpoints),
                f"{row.best_reduction:.2f}",
            )
            for row in rows
        ),
        (
            (
                "The printed reductions do not follow from the printed breakpoints; the paper "
                "found those by a sweep."
            ),
        ),
    )


def _table_2_text(rows: tuple[PolynomialRow, ...]) -> Table:
    return Table(
        "Paper 000, Table 2: the printed polynomials against the exact MTPA over 0 to 250 N m",
        ("axis", "degree", "breakpoint N m", "r.m.s. error A", "largest error A"),
        tuple(
            (
                row.axis,
                str(row.degree),
                f"{row.breakpoint:.2f}",
                f"{row.rms_error:.4f}",
                f"{row.largest_error:.3f}",
            )
            for row in rows
        ),
        (
            (
                "Read as: columns degree 2, 3, 4 per axis with segments k = 0, 1; row m = 0 is the "
                "highest power."
            ),
            (
                "Machine: psi_pm = 0.1049 Wb, l_q - l_d = 242 uH, p = 4, identified; Table 5 "
                "prints 8 pole pairs, no flux."
            ),
            "The paper's section 7.2 states a largest error of 1.09 A for degree 2.",
            (
                "Degree 3 on the q axis suffers from its printed digits: 1.62 +-0.005 A/(N m) is "
                "+-1.2 A at 250 N m."
            ),
        ),
    )


def _table_4_text(rows: tuple[LossRow, ...]) -> list[Table]:
    """Two tables: losses and temperatures, and torque ripple; with what is wrong in the print."""
    return [_losses_text(rows), _ripple_text(rows)]


def _off(found: float, printed: float) -> str:
    return f"{100.0 * (found / printed - 1.0):+.2f}"


def _losses_text(rows: tuple[LossRow, ...]) -> Table:
    cells = tuple(
        (
            row.strategy,
            row.modulation,
            f"{row.printed_loss:.0f}",
            f"{row.loss:.1f}",
            _off(row.loss, row.printed_loss),
            f"{row.implied_loss:.1f}",
            _off(row.loss, row.implied_loss),
            f"{row.printed_junction:.2f}",
            f"{row.junction:.2f}",
            f"{row.junction - row.printed_junction:+.2f}",
        )
        for row in rows
    )
    second, third = rows[1], rows[2]
    least = second.printed_loss - 0.5 * second.switching
    calibrated = (
        "Calibrated on the total of the first column alone, which gives the switching energy; the "
        "others follow."
    )
    off_print, off_implied = (
        _off(third.loss, third.printed_loss),
        _off(third.loss, third.implied_loss),
    )
    misprint = (
        f"Misprint: the third total, {third.printed_loss:.0f} W, contradicts its own temperature. "
        "The line of temperature over inverter loss through the first two columns passes "
        f"{third.printed_junction:.2f} degC at {third.implied_loss:.0f} W; and clamping saves at "
        f"most half of the {second.switching:.0f} W that SPWM switches: {least:.0f} W is the least "
        f"that can follow {second.printed_loss:.0f} W. The result is off by {off_print} % from the "
        f"printed total, by {off_implied} % from the implied one."
    )
    cooling = (
        "Thermal resistance and coolant temperature are not in the paper; the library drive's suit "
        "all three columns."
    )
    notes = (calibrated, *textwrap.wrap(misprint, _WIDTH, break_on_hyphens=False), cooling)
    return Table(
        "Paper 000, Table 4: 130 N m, 300 rad/s, 500 V, 100 kHz",
        (
            "strategy",
            "modulator",
            "printed W",
            "here W",
            "off %",
            "implied W",
            "off %",
            "junction degC",
            "here degC",
            "off K",
        ),
        cells,
        notes,
    )


def _ripple_text(rows: tuple[LossRow, ...]) -> Table:
    cells = tuple(
        (
            row.strategy,
            row.modulation,
            f"{row.printed_ripple:.2f}",
            f"{row.switching_ripple:.3f}",
            f"{row.printed_ripple - row.switching_ripple:.2f}",
        )
        for row in rows
    )
    here = [row.switching_ripple for row in rows]
    printed = [row.printed_ripple for row in rows]
    notes = (
        f"At equal currents DDT-GDPWM adds {here[2] - here[1]:.2f} N m to the ripple of SPWM; the "
        f"print adds {printed[2] - printed[1]:.2f}. The rest is the paper's finite-element "
        "machine, whose slots are not published. It is larger with MTPA: the switching alone makes "
        f"{here[0] - here[1]:.2f} N m less there than with i_d = 0, the voltage being lower, and "
        f"the print has {printed[1] - printed[0]:.2f} N m more."
    )
    return Table(
        "Paper 000, Table 4: largest torque ripple, peak to peak",
        ("strategy", "modulator", "printed N m", "switching alone, here N m", "rest N m"),
        cells,
        tuple(textwrap.wrap(notes, _WIDTH, break_on_hyphens=False)),
    )


def load_test_table(tests: tuple[LoadTest, ...]) -> Table:
    """Speed and current of each alternative."""
    rows = tuple(
        (
            test.name,
            f"{test.deviation:.2f}",
            f"{test.end_error:.4f}",
            f"{test.torque:.2f}",
            f"{test.current:.2f}",
            f"{test.expected:.2f}",
            f"{100.0 * (test.current / tests[0].current - 1.0):+.1f}",
        )
        for test in tests
    )
    columns = (
        "alternative",
        "largest speed deviation rad/s",
        "at the end rad/s",
        "torque at the end N m",
        "current A (peak)",
        "by equation A",
        "against i_d = 0 %",
    )
    return Table(
        "Paper 000, Figure 5: 300 rad/s under 30 N m, a ramp to 90 N m, a step to 130 N m; emitted "
        "C in the loop",
        columns,
        rows,
        (
            (
                "Deviations after the first second. The paper prints curves: the speed is held, "
                "MTPA needs less current."
            ),
            "Inertia and speed controller are inferred: the paper states neither.",
        ),
    )
