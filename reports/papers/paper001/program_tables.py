"""What the program of paper 001 does with its own integers, in tables and plain data."""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper001.bench_transients import PRINTED_TIME
from dqforge.reports.papers.paper001.emitted_control import EmittedControl
from dqforge.reports.papers.paper001.program_findings import Program
from dqforge.reports.plain_data import PlainData

_WIDTH = 118


def program_tables(found: Program) -> list[Table]:
    """Start and reversal, and every figure that was recomputed."""
    return [_transients(found), _findings(found)]


def _transients(found: Program) -> Table:
    rows = tuple(
        (
            row.name,
            f"{row.limit:.3g} ({row.origin})",
            f"{PRINTED_TIME:.1f}",
            f"{row.seconds:.3f}",
            f"{100.0 * row.overshoot:.1f}",
            f"{row.peak_current:.2f}",
        )
        for row in found.transients
    )
    notes = (
        "Converter of 10 bits, encoder by counts and line times, products of 32 bits, shifts that "
        f"round down: all as listed. The integral of i_q rests for errors from 0 to "
        f"{found.dead_band:.3f} A (32768/26 codes) and falls by one a period below 0: so i_q stays "
        "that much below its reference, and a small limit slows the start more than the reversal. "
        "The thesis states no limit but 32000; its listing works 26 out to 25."
    )
    return Table(
        "Paper 001, section 8.4 with the program's own integers: until the speed stays within 2 % "
        "of 1200 rpm",
        ("transient", "limit of i_q in A", "printed s", "found s", "overshoot %", "peak current A"),
        rows,
        tuple(textwrap.wrap(notes, _WIDTH, break_on_hyphens=False)),
    )


def _findings(found: Program) -> Table:
    rows = tuple(
        (
            row.numbers,
            row.shows,
            row.stated or "-",
            "; ".join(f"{q.name} {q.value:.4g} {q.unit}" for q in row.found) or "-",
        )
        for row in found.findings
    )
    notes = (
        "The thesis prints curves; what it states of them in words stands beside what is found. "
        f"The code of 1200 rpm is one of {found.held:.1f} rpm, for 2^20/6750 is cut to 155; the "
        "sine has 13 of 32768 a period for 2 Hz, 13.1 exactly. Its captions of 8.18, 8.19 and 8.23 "
        "are not legible in the copy at hand. 2700 rpm cannot be run with 13000 on 214 V."
    )
    return Table(
        "Paper 001, Figures 8.1 to 8.28 with the program's own integers in the loop",
        ("figure", "shows", "stated", "found"),
        rows,
        tuple(textwrap.wrap(notes, _WIDTH, break_on_hyphens=False)),
    )


def emitted_table(found: EmittedControl) -> Table:
    """Start and reversal by the control of the design, in every format."""
    rows = tuple(
        (
            row.name,
            _seconds(row.start),
            _seconds(row.reversal),
            f"{100.0 * row.overshoot:.1f}",
            f"{row.peak_current:.2f}",
            f"{row.error:+.4f}",
        )
        for row in found.runs
    )
    notes = [
        (
            "Both axes controlled and decoupled, current limit of the drive; converter, encoder, "
            "dead time and machine as"
        ),
        (
            "above. The speed controller takes back what the limit cut by 1/8 a sample; the thesis "
            "holds its output, as the"
        ),
        "last line does.",
    ]
    if found.left_out:
        notes.append(f"Without a speed control, so not run: {', '.join(found.left_out)}.")
    return Table(
        "Paper 001, section 8.4 by the control that the design emits: until within 2 % of 1200 rpm",
        (
            "format",
            "start s",
            "reversal s",
            "overshoot %",
            "peak current A",
            "i_q below its reference A",
        ),
        rows,
        tuple(notes),
    )


def _seconds(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else "-"


def plain_emitted(found: EmittedControl) -> PlainData:
    """The same as plain data."""
    return {
        "runs": [asdict(row) for row in found.runs],
        "left_out": list(found.left_out),
    }


def plain_program(found: Program) -> PlainData:
    """The same as plain data."""
    return {
        "dead_band_A": found.dead_band,
        "speed_of_the_code_of_1200_rpm": found.held,
        "transients": [
            {
                "transient": row.name,
                "current_limit_A": row.limit,
                "limit_from": row.origin,
                "printed_s": PRINTED_TIME,
                "found_s": row.seconds,
                "overshoot": row.overshoot,
                "peak_current_A": row.peak_current,
            }
            for row in found.transients
        ],
        "figures": [
            {
                "figures": row.numbers,
                "shows": row.shows,
                "stated": row.stated,
                "found": [asdict(quantity) for quantity in row.found],
            }
            for row in found.findings
        ],
    }
