"""Paper 001 in tables and plain data: printed beside found."""

from __future__ import annotations

import math
from dataclasses import asdict

from dqforge.reports.pages.table import Table
from dqforge.reports.papers.paper001.bench_sensorless import PRINTED_ANGLE, PRINTED_SPEED, Estimator
from dqforge.reports.papers.paper001.bench_transients import (
    PRINTED_INTEGERS,
    PRINTED_TIME,
    Reproduction,
)
from dqforge.reports.papers.paper001.estimator_tables import (
    alignment_table,
    methods_table,
    plain_alignment,
    plain_findings,
    plain_methods,
    sensorless_table,
)
from dqforge.reports.papers.paper001.program_tables import (
    emitted_table,
    plain_emitted,
    plain_program,
    program_tables,
)
from dqforge.reports.plain_data import PlainData


def reproduction_tables(found: Reproduction) -> list[Table]:
    """Printed beside found."""
    integers = tuple(
        (name, str(PRINTED_INTEGERS[name]), str(value)) for name, value in found.integers.items()
    )
    transients = tuple(
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
    climbs = tuple(
        (
            f"{row.start:.0f} to {row.target:.0f} rpm",
            f"{100.0 * row.share:.1f} % ({row.origin})",
            f"{row.reached:.0f}",
            f"{row.seconds:.3f}" if math.isfinite(row.seconds) else "-",
        )
        for row in found.climbs
    )
    errors = tuple((name, f"{100.0 * value:+.3f}") for name, value in found.sensorless.items())
    return [
        methods_table(found.methods),
        Table(
            "Paper 001, Table 8.1 as integers of the program",
            ("gain", "printed", "found"),
            integers,
        ),
        alignment_table(found.alignment),
        *program_tables(found.program),
        Table(
            "Paper 001, section 8.4: time until the speed stays within 2 % of 1200 rpm, emitted C "
            "in the loop",
            (
                "transient",
                "limit of i_q in A",
                "printed s",
                "found s",
                "overshoot %",
                "peak current A",
            ),
            transients,
            (
                (
                    "Gains, dead time, encoder and held outputs are those of the program; the d "
                    "axis is not controlled."
                ),
                (
                    "The thesis states no limit of the current in A. At one limit a reversal takes "
                    "about twice a start: it"
                ),
                (
                    "changes the speed by twice as much; so each printed time needs a limit of its "
                    "own."
                ),
            ),
        ),
        emitted_table(found.emitted),
        Table(
            "Paper 001, Figures 8.14 to 8.20: speeds of 2200 and 2700 rpm",
            ("step", "limit of v_q, share of v_dc/sqrt(3)", "reached rpm", "within 2 % after s"),
            climbs,
            (
                (
                    "The thesis shows both speeds. Its program limits v_q to 13000 of 32768, for "
                    "about 2600 rpm as it"
                ),
                (
                    "says; delay and dead time, neither compensated, leave less. 2700 rpm must "
                    "have been run without it."
                ),
            ),
        ),
        Table(
            "Paper 001, Figures 8.27 and 8.28",
            ("reference", "found"),
            (
                (
                    "2 Hz, 200 rpm about 1200 rpm",
                    f"{found.sine_amplitude:.1f} rpm, {found.sine_lag:.1f} deg behind",
                ),
                (
                    "steps of 500 rpm every 0.5 s",
                    f"within 2 % after at most {found.step_time:.3f} s",
                ),
            ),
        ),
        Table(
            "Paper 001, section 8.5: steady error of the corrected observer at 1500 rpm (printed: "
            "about 4 %)",
            ("parameters", "error %"),
            (
                (
                    "exact, emitted C in the loop, simulated",
                    f"{100.0 * found.sensorless_error:+.3f}",
                ),
                *(("by formula: " + name, error) for name, error in errors),
            ),
        ),
        _estimator_table(found.estimator),
        sensorless_table(found.figures),
    ]


def plain_reproduction(found: Reproduction) -> PlainData:
    """Tables as plain data."""
    return {
        "table_8_1": [
            {"gain": name, "printed": PRINTED_INTEGERS[name], "found": value}
            for name, value in found.integers.items()
        ],
        "transients": [
            {
                "transient": row.name,
                "current_limit_A": row.limit,
                "limit_from": row.origin,
                "printed_s": PRINTED_TIME,
                "found_s": row.seconds,
                "overshoot": row.overshoot,
                "peak_current_A": row.peak_current,
                "largest_current_reference_A": row.asked,
                "dead_time_s": row.dead_time,
            }
            for row in found.transients
        ],
        "speeds": [asdict(row) for row in found.climbs],
        "sine": {"amplitude_rpm": found.sine_amplitude, "lag_deg": found.sine_lag},
        "steps": {"settling_s": found.step_time},
        "sensorless_1500_rpm": {
            "printed_error": 0.04,
            "simulated_error_exact_parameters": found.sensorless_error,
            "by_formula": dict(found.sensorless),
        },
        "estimator_1500_rpm": {
            "printed_speed_error": PRINTED_SPEED,
            "printed_angle_error": PRINTED_ANGLE,
            "found": [asdict(row) for row in found.estimator],
        },
        "program": plain_program(found.program),
        "emitted": plain_emitted(found.emitted),
        "methods": plain_methods(found.methods),
        "alignment": plain_alignment(found.alignment),
        "figures_without_encoder": plain_findings(found.figures),
    }


def _estimator_table(rows: tuple[Estimator, ...]) -> Table:
    """Found beside printed."""
    lines = tuple(
        (
            row.name,
            f"{100.0 * row.speed_error:+.2f}",
            f"{360.0 * row.angle_error:.1f}",
            f"{100.0 * row.angle_error:.1f}",
        )
        for row in rows
    )
    switched = next(row.switched for row in rows if row.switched is not None)
    return Table(
        "Paper 001, section 8.5: control without encoder at 1500 rpm (printed: about 4 % in speed, "
        "10 % in position)",
        ("the drive has", "speed error %", "position behind by deg", "in % of a turn"),
        lines,
        (
            (
                "Emitted C in the loop: speed by the reduced-order observer, position by the "
                "voltage model of Matsui."
            ),
            (
                "The dead time of the program, not compensated, and 0.7 % more magnet flux explain "
                "the speed; the position"
            ),
            (
                "is then 3.6 % of a turn off, not 10 %. R off by 30 %, L by 20 %, psi by 4 % or "
                "v_dc by 5 % leave it"
            ),
            (
                "at 4.5 % or less; a dead time that makes 10 % spoils the speed. Reading the "
                "position out every tenth"
            ),
            "sample makes it 10 %; that this was done is a guess, it is not in the thesis.",
            (
                f"With every switching instant: {100.0 * switched[0]:+.2f} % and "
                f"{360.0 * switched[1]:.1f} deg."
            ),
        ),
    )
