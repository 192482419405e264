"""Everything of paper 000 that can be computed: Tables 1 to 4, Figures 2 to 5, and the printed
polynomials as a header.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, VerificationError
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import drive_budget
from dqforge.reports.pages.answer import Table
from dqforge.reports.papers.explanations import (
    Explanation,
    explain_coefficients,
    explain_largest_error,
    explanation_table,
)
from dqforge.reports.papers.paper000_load_test import (
    ALTERNATIVES,
    CLOCK_MHZ,
    CORES,
    PRINTED_MICROSECONDS,
    CoreCosts,
    Cost,
    LoadTest,
    core_costs,
    load_tests,
)
from dqforge.reports.papers.paper000_stated_method import (
    DESIGN_NAME,
    DIFFERS,
    FIXED_PREFIX,
    PREFIX,
    PRINTED_TABLE_1,
    PRINTED_TABLE_2,
    PRINTED_TABLE_4,
    STATED_LARGEST,
    STATED_SHARE,
    BreakpointRow,
    ErrorCurve,
    LossRow,
    PolynomialRow,
    PrintedPolynomial,
    Reproduction,
    Segment,
    StatedMethod,
    by_stated_method,
    calibrated_inverter,
    printed_header,
    reproduce_paper,
    ripple_explained,
)


@dataclass(frozen=True, slots=True, eq=False)
class WholePaper:
    """All of it; ``load_tests`` and ``heat`` are empty where there is no compiler, which
    ``left_out`` says.
    """

    tables: Reproduction
    stated: StatedMethod
    coefficients: Explanation
    largest_error: Explanation
    ripple: Explanation
    header: PrintedPolynomial
    costs: CoreCosts
    load_tests: tuple[LoadTest, ...]
    heat: tuple[HeatCurve, ...]
    left_out: str


def reproduce_whole() -> WholePaper:
    """Recompute the paper from the library drive."""
    design = catalogue.load(DESIGN_NAME)
    machine, header = linearised(design.machine), printed_header(design)
    breakpoints = {degree: row[:2] for degree, row in PRINTED_TABLE_1.items()}
    tests: tuple[LoadTest, ...] = ()
    left_out = ""
    try:
        tests = load_tests()
    except VerificationError as error:
        left_out = str(error)
    return WholePaper(
        tables=reproduce_paper(),
        stated=by_stated_method(machine),
        coefficients=explain_coefficients(machine, PRINTED_TABLE_2, breakpoints),
        largest_error=explain_largest_error(machine, PRINTED_TABLE_2, breakpoints),
        ripple=ripple_explained(design),
        header=header,
        costs=core_costs(machine, header.files | header.fixed, PREFIX, FIXED_PREFIX),
        load_tests=tests,
        heat=heat_curves(design, tests),
        left_out=left_out,
    )


# What paper 000's method gives, costs and heats, in tables: printed beside recomputed.

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
        "nodes does not pass through 0; what other nodes and breakpoints make of it follows."
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


# Paper 000 in tables: printed beside recomputed, with what is wrong in the print.


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
        explanation_table(found.coefficients),
        error_table(found.stated.errors),
        explanation_table(found.largest_error),
        header_table(found.header),
        cost_table(found.costs),
        *fourth,
        explanation_table(found.ripple),
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


# Losses and junction temperature over the time of Figure 5 of paper 000.
#
# Losses follow the currents and the speed of the simulated runs, with the switching energy that
# Table 4's first column gives. The paper states neither thermal resistance nor coolant nor a time
# constant. The first two follow from its three temperatures (0.306 K/W a switch over 64 degC); the
# time constant is assumed, and how far Table 4's instant depends on it is told.

TIME_CONSTANT = 0.1  # Of junction against coolant in s: assumed.

# The largest time constant in s with which the last 0.1 s still are Table 4's steady state.
SLOWEST = 0.4
SWITCHES = 6
_POINTS = 1200


@dataclass(frozen=True, slots=True, eq=False)
class HeatCurve:
    """One alternative over time, arrays of shape (N,): losses in W, temperature in degC.

    ``total``, ``junction`` and ``slow_junction`` are the means of the loss and the largest
    temperatures between 5.9 and 6 s, the last with the slowest time constant; beside the printed
    ones.
    """

    name: str
    t: FloatArray
    machine_loss: FloatArray
    inverter_loss: FloatArray
    junction_temperature: FloatArray
    total: float
    junction: float
    slow_junction: float
    printed_total: float
    printed_junction: float

    @property
    def loss(self) -> FloatArray:
        """Whole loss in W."""
        return self.machine_loss + self.inverter_loss


def warmed(
    time: FloatArray, loss: FloatArray, resistance: float, ambient: float, constant: float
) -> FloatArray:
    """Temperature in degC behind one resistance and one capacity, from the ambient one on.

    Args:
        time, loss: Instants in s, evenly spaced, and the loss in W that flows from each to the
            next, shape (N,).
        resistance, ambient, constant: Thermal resistance in K/W, temperature in degC, time constant
            in s.
    """
    left = np.exp(-np.diff(time) / constant)
    rise = np.zeros_like(loss)
    for k, (share, watts) in enumerate(zip(left, loss[:-1], strict=True)):
        rise[k + 1] = share * rise[k] + (1.0 - share) * resistance * watts
    return ambient + rise


def _curve(design: Design, inverter: Inverter, test: LoadTest, alternative: int) -> HeatCurve:
    run, column = test.run, PRINTED_TABLE_4[alternative]
    few = slice(None, None, max(1, run.t.size // _POINTS))
    modulation = ALTERNATIVES[alternative][2]
    found = drive_budget(
        design.machine, inverter, run.i_d[few], run.i_q[few], run.omega_m[few], (modulation,)
    )
    heat = (found.conduction + found.dead_time + found.switching)[0, 0]
    whole = found.total[0, 0]
    device = inverter.device
    if device is None:
        raise InputError(f"{design.name}: its inverter has no device")
    time, resistance = run.t[few], device.thermal_resistance / SWITCHES
    fast, slow = (
        warmed(time, heat, resistance, inverter.coolant_temperature, constant)
        for constant in (TIME_CONSTANT, SLOWEST)
    )
    last = time >= 5.9
    return HeatCurve(
        name=test.name,
        t=time,
        machine_loss=whole - heat,
        inverter_loss=heat,
        junction_temperature=fast,
        total=float(np.mean(whole[last])),
        junction=float(np.max(fast[last])),
        slow_junction=float(np.max(slow[last])),
        printed_total=column[2],
        printed_junction=column[3],
    )


def heat_curves(design: Design, tests: Sequence[LoadTest]) -> tuple[HeatCurve, ...]:
    """Losses and temperatures of all alternatives.

    Args:
        design: The drive.
        tests: Its runs, in the order of `ALTERNATIVES`.
    """
    inverter = calibrated_inverter(design)
    return tuple(_curve(design, inverter, test, k) for k, test in enumerate(tests))
