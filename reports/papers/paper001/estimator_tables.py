"""Chapter 7, the start of section 8.3 and Figures 8.29 to 8.33 of paper 001, in tables and plain
data.
"""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper001.alignment import SECONDS, START_ANGLES, Alignment
from dqforge.reports.papers.paper001.estimator_methods import CAUSES, SHARES, MethodFound
from dqforge.reports.papers.paper001.program_findings import Finding
from dqforge.reports.plain_data import PlainData

_WIDTH = 118


def _notes(text: str) -> tuple[str, ...]:
    return tuple(textwrap.wrap(text, _WIDTH, break_on_hyphens=False))


def _number(value: float, form: str = ".3g", missing: str = "-") -> str:
    return format(value, form) if math.isfinite(value) else missing


def methods_table(rows: tuple[MethodFound, ...]) -> Table:
    """Every method of chapter 7.

    Args:
        rows: What was found.
    """
    lines: list[tuple[str, ...]] = []
    for row in rows:
        first = (row.stated.section, row.stated.name or "-", row.stated.says)
        if row.refusal:
            reason = row.refusal.split("; ")[0].replace(f"{row.stated.name} needs", "needs")
            lines.append((*first, f"no: {reason}", "", "", "", ""))
            continue
        held = "none at every load"
        if math.isfinite(row.low_hz):
            held = f"{row.low_hz:.3g} to {row.high_hz:.3g} Hz"
        lines.append(
            (
                *first,
                held,
                *(_number(value, ".3g", "lost") for value in row.angle_deg),
                _number(row.noise_deg),
                ", ".join(_number(value, "+.2g") for value in row.slopes_deg),
            )
        )
    return Table(
        "Paper 001, chapter 7: methods of estimation, as the thesis has them and on its bench",
        (
            "section",
            "method",
            "the thesis says",
            "holds",
            *(f"deg at {100.0 * share:.0f} %" for share in SHARES),
            "noise deg",
            "R, L_q, psi +10 %, 1 V: deg",
        ),
        tuple(lines),
        _notes(
            "Electrical degrees and hertz; 5420 rpm are 271 Hz. Holds: within 10 deg and 5 % of "
            "the speed at every load with R 30 %, L and psi 10 % wrong and the whole dead time; "
            "degrees at the worst load; last column at half the speed and half the torque, a "
            "volt being what the dead time takes. The six-step methods commute a sinusoidal EMF "
            "all the same. Of Matsui's two models that of the current, said to mind the dead "
            "time little, is the one that errs by it: its speed is (v - R i)/psi. Reduced order: "
            "section 8.5 below."
        ),
    )


def alignment_table(rows: tuple[Alignment, ...]) -> Table:
    """The start of section 8.3.

    Args:
        rows: What was found, by friction.
    """
    lines = tuple(
        (
            f"{row.friction:g}",
            f"{row.current:.2f}",
            f"{row.error_deg:.2f}",
            f"{row.formula_deg:.2f}",
            ", ".join(str(angle) for angle in row.stuck_deg) or "-",
            _number(row.seconds, ".3f"),
            _number(row.reached_rpm, ".0f"),
            _number(row.backwards_rpm, ".0f"),
        )
        for row in rows
    )
    return Table(
        "Paper 001, section 8.3: alignment with phase a, then the start to 1200 rpm",
        (
            "friction N m",
            "i_a A",
            "off by deg",
            "asin, deg",
            "stays at deg",
            "within 2 % after s",
            "reached rpm",
            "from there rpm",
        ),
        lines,
        _notes(
            f"Integers as listed: CMPR1 at three quarters, the others at half for {SECONDS:g} s "
            "(800000 turns of an empty loop; how long they take is not stated), then the encoder's "
            f"count is zero. The rotor lay at {len(START_ANGLES)} angles, every "
            f"{START_ANGLES[1]} deg. The current is twice the range of the sensors, 6.4 A, which "
            'nothing reads then; so the error is as "negligible" as the thesis says. A rotor half '
            "a turn off stays there without a torque, and the program, whose torque then has the "
            "other sign, runs away backwards to the limit of its voltage."
        ),
    )


def sensorless_table(rows: tuple[Finding, ...]) -> Table:
    """Figures 8.29 to 8.33.

    Args:
        rows: What was found.
    """
    lines = tuple(
        (
            row.numbers,
            row.shows,
            row.stated or "-",
            "; ".join(f"{q.name} {q.value:.4g} {q.unit}" for q in row.found) or "-",
        )
        for row in rows
    )
    return Table(
        "Paper 001, Figures 8.29 to 8.33: with and without estimator",
        ("figure", "shows", "stated", "found"),
        lines,
        _notes(
            "In float32: the thesis prints no integers of its estimator. 8.29 with exact data; its "
            "1 % is not explained, the simplified model is not given. 8.31 to 8.33 with the dead "
            "time of the program and 0.7 % more magnet flux: the speed is as printed, the position "
            "is not; the table above has what would make it so."
        ),
    )


def plain_methods(rows: tuple[MethodFound, ...]) -> list[PlainData]:
    """Chapter 7 as plain data.

    Args:
        rows: What was found.
    """
    return [
        {
            "section": row.stated.section,
            "method": row.stated.name,
            "stated": row.stated.says,
            "refusal": row.refusal,
            "holds_Hz": [row.low_hz, row.high_hz],
            "angle_deg": dict(zip(map(str, SHARES), row.angle_deg, strict=False)),
            "noise_deg": row.noise_deg,
            "slopes_deg": dict(zip(CAUSES, row.slopes_deg, strict=False)),
        }
        for row in rows
    ]


def plain_alignment(rows: tuple[Alignment, ...]) -> list[PlainData]:
    """The start of section 8.3 as plain data.

    Args:
        rows: What was found.
    """
    return [
        {
            "friction_Nm": row.friction,
            "current_A": row.current,
            "error_deg": row.error_deg,
            "formula_deg": row.formula_deg,
            "stuck_deg": list(row.stuck_deg),
            "found_s": row.seconds,
            "reached_rpm": row.reached_rpm,
            "backwards_rpm": row.backwards_rpm,
        }
        for row in rows
    ]


def plain_findings(rows: tuple[Finding, ...]) -> list[PlainData]:
    """Figures as plain data.

    Args:
        rows: What was found.
    """
    return [
        {
            "figures": row.numbers,
            "shows": row.shows,
            "stated": row.stated,
            "found": [asdict(quantity) for quantity in row.found],
        }
        for row in rows
    ]
