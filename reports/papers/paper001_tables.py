"""Paper 001 in tables and plain data: printed beside found."""

from __future__ import annotations

import math
import textwrap
from dataclasses import asdict
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, style
from dqforge.reports.papers.explanations import explanation_table, plain_explanation
from dqforge.reports.papers.paper001_bench_sensorless import (
    CAUSES,
    PRINTED_ANGLE,
    PRINTED_SPEED,
    SHARES,
    Estimator,
    MethodFound,
)
from dqforge.reports.papers.paper001_bench_transients import (
    PRINTED_INTEGERS,
    PRINTED_TIME,
    Finding,
    Program,
    Reproduction,
    Runs,
)
from dqforge.reports.papers.paper001_emitted_control import (
    SECONDS,
    START_ANGLES,
    Alignment,
    EmittedControl,
)
from dqforge.reports.papers.transients import RPM
from dqforge.reports.plain_data import PlainData

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
        explanation_table(found.start),
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
        "figure_8_29_explanation": plain_explanation(found.start),
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


# Chapter 7, the start of section 8.3 and Figures 8.29 to 8.33 of paper 001, in tables and plain
# data.

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
            "8.29 with exact data in float32; what its numbers follow from is below. 8.31 to 8.33 "
            "in the program's integers, its estimator in the same words (the thesis prints the "
            "equations alone), with its dead time and 0.7 % more magnet flux: the speed is as "
            "printed, the position is not; the table above has what would make it so."
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


# What the program of paper 001 does with its own integers, in tables and plain data.


def program_tables(found: Program) -> list[Table]:
    """Start and reversal, and every figure that was recomputed."""
    return [_transients(found), explanation_table(found.explanation), _findings(found)]


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
        "explanation": plain_explanation(found.explanation),
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


# Figures 8.3 to 8.32 of paper 001: transients of the bench.


def _speed(
    axes: Axes, title: str, run_t: FloatArray, reference: FloatArray, omega: FloatArray
) -> None:
    axes.plot(run_t, reference, color=MUTED, linewidth=0.9, label="reference")
    axes.plot(run_t, omega, color=BLUE, label="speed")
    axes.set(title=title, ylabel="rpm", xlabel="Time in s")


def plot_bench(runs: Runs) -> Figure:
    """Start and reversal, sine and step references, and the starts without sensor."""
    with style():
        figure = new_figure(
            "paper-001-chapter-8", 8.4, "Transients of the bench with the emitted controller"
        )
        places = tuple((x, y) for y in (0.785, 0.54, 0.295, 0.05) for x in (0.1, 0.6))
        first, second, third, fourth, fifth, sixth, seventh, eighth = (
            figure.add_axes((x, y, 0.38, 0.17)) for x, y in places
        )
        run = runs.reversal
        _speed(
            first,
            "Figures 8.3, 8.21: start, reversal",
            run.t,
            run.reference / RPM,
            run.omega_m / RPM,
        )
        second.plot(run.t, run.i_q_reference, color=MUTED, linewidth=0.9, label="reference")
        second.plot(run.t, run.i_q, color=ORANGE, label="$i_q$")
        second.plot(run.t, run.i_d, color=BLUE, linewidth=0.8, label="$i_d$, not controlled")
        second.set(
            title="Figure 8.24: currents of it",
            ylabel="A (peak)",
            xlabel="Time in s",
            ylim=(-1.2, 1.2),
        )
        run = runs.sine
        _speed(third, "Figure 8.27: sine reference", run.t, run.reference / RPM, run.omega_m / RPM)
        run = runs.steps
        _speed(
            fourth, "Figure 8.28: steps of 500 rpm", run.t, run.reference / RPM, run.omega_m / RPM
        )
        run = runs.sensorless
        _speed(
            fifth,
            "Figure 8.31: speed from the observer",
            run.t,
            run.reference / RPM,
            run.omega_m / RPM,
        )
        fifth.plot(
            run.t,
            run.omega_m_measured / RPM,
            color=TEAL,
            linewidth=0.8,
            linestyle="dashed",
            label="estimate",
        )
        sixth.plot(run.t, (run.omega_m_measured - run.omega_m) / RPM, color=TEAL)
        sixth.set(title="Its error", ylabel="rpm", xlabel="Time in s")
        run = runs.estimator
        _speed(
            seventh,
            "Speed, dead time and $\\psi$ + 0.7 %",
            run.t,
            run.reference / RPM,
            run.omega_m / RPM,
        )
        seventh.plot(
            run.t,
            run.omega_m_observed / RPM,
            color=TEAL,
            linewidth=0.8,
            linestyle="dashed",
            label="estimate",
        )
        late = run.t >= run.t[-1] - 0.03
        time = (run.t[late] - run.t[-1]) * 1e3
        for angle, colour, label in (
            (run.theta_e, BLUE, "rotor"),
            (run.theta_e_observed, TEAL, "estimate"),
        ):
            eighth.plot(time, np.degrees(angle[late]), color=colour, linewidth=0.9, label=label)
        eighth.set(
            title="Figure 8.32: position, the last 30 ms",
            ylabel="deg (electrical)",
            xlabel="Time in ms",
        )
        third.set(xlim=(0.9, 3.0), ylim=(900.0, 1500.0))
        fourth.set(xlim=(0.9, 3.0), ylim=(900.0, 2100.0))
        for axes in (first, second, fifth, seventh, eighth):
            axes.legend(frameon=False, loc="best", fontsize=6.5)
    return figure


def plot_without_encoder(runs: Runs) -> Figure:
    """Figures 8.29, 8.31 to 8.33: simulated with and without estimator, and the bench on it."""
    with style():
        figure = new_figure("paper-001-without-encoder", 4.6, "With and without estimator")
        places = tuple((x, y) for y in (0.57, 0.09) for x in (0.1, 0.6))
        first, second, third, fourth = (figure.add_axes((x, y, 0.38, 0.32)) for x, y in places)
        for run, colour, label in (
            (runs.encoder, MUTED, "without estimator"),
            (runs.sensorless, BLUE, "with it"),
        ):
            first.plot(run.t, run.omega_m / RPM, color=colour, label=label)
        estimate = runs.sensorless.omega_m_measured / RPM
        first.plot(runs.sensorless.t, estimate, color=TEAL, linewidth=0.8, label="estimate")
        first.set(title="Figure 8.29: simulated start", ylabel="rpm", xlabel="Time in s")
        run = runs.estimator
        late = run.t >= run.t[-1] - 0.03
        time = (run.t[late] - run.t[-1]) * 1e3
        second.plot(time, run.omega_m[late] / RPM, color=BLUE, label="measured")
        second.plot(time, run.omega_m_observed[late] / RPM, color=TEAL, label="estimated")
        second.set(title="Figure 8.31: speed", ylabel="rpm", xlabel="Time in ms")
        for angle, colour, label in (
            (run.theta_e, BLUE, "measured"),
            (run.theta_e_observed, TEAL, "estimated"),
        ):
            third.plot(time, np.degrees(angle[late]), color=colour, linewidth=0.9, label=label)
        third.set(title="Figure 8.32: position", ylabel="deg (electrical)", xlabel="Time in ms")
        gap = np.angle(np.exp(1j * (run.theta_e - run.theta_e_observed)[late]))
        fourth.plot(time, 100.0 * gap / (2.0 * np.pi), color=ORANGE)
        fourth.set(
            title="Figure 8.33: error of the position",
            ylabel="% of an electrical turn",
            xlabel="Time in ms",
        )
        for axes in (first, second, third):
            axes.legend(frameon=False, loc="best", fontsize=6.5)
    return figure
