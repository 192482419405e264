"""The C header of current-loop gains over the current and its test vectors,
as plain data and as text.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.optimizer.loops.gain_schedule import GAIN_NAMES, GainEvaluator
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    single_from,
    singles_from,
    title,
)
from dqforge.reports.capability import (
    Capability,
    Draw,
    Flashed,
    Outcome,
    Passage,
    Quantity,
    ReportPart,
    Rows,
    Tile,
)
from dqforge.reports.loops.firmware_text import (
    CERTIFICATE,
    FIRMWARE_COLUMNS,
    ROBUST_COLUMNS,
    SCHEDULE_COLUMNS,
    certificate_bytes,
    firmware_name,
    firmware_notes,
    firmware_rows,
    firmware_title,
    firmware_words,
    proof_summary,
    robust_notes,
    robust_rows,
    rotating_words,
    schedule_lines,
    schedule_notes,
    schedule_rows,
    stability_notes,
    worst_words,
)
from dqforge.reports.loops.proven_text import (
    JUDGED_TITLE,
    box_notes,
    changing_lines,
    changing_notes,
    gains_tables,
    judged_columns,
    judged_notes,
    judged_rows,
    judged_sentence,
    judged_words,
    plain_gains,
)
from dqforge.reports.observers.speed_loop_text import (
    corner_words,
    left_words,
    loop_words,
    observed_notes,
)
from dqforge.reports.pages.html_text import (
    NARROW,
    HtmlTable,
    Row,
    decibel,
    degrees,
    heading_cells,
    number,
    quantity,
    symbols,
)
from dqforge.reports.pages.templating import LOOPS as CHAPTER
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.transforms import Reals
    from dqforge.optimizer.certificates.current_loop_proof import CurrentLoopProof
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.curves.single_precision import SingleArray
    from dqforge.optimizer.loops.gain_schedule import Gains, GainSchedule
    from dqforge.optimizer.loops.integer_gains import PerUnitGains
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.solution import Solution
    from dqforge.optimizer.steps.step_arithmetic import Arithmetic


_SEED = 20_261_121


_MOST_VALUES = 256


_FAULT = InputError("gains_header is not what dqforge writes; run the design again")


def _list(values: SingleArray) -> list[float]:
    return [shortest(value) for value in values]


def plain_evaluator(evaluator: GainEvaluator) -> PlainData:
    """The evaluator as plain data; every number is a float32 value."""
    return {
        "end": shortest(evaluator.end),
        "fallback": {name: shortest(value) for name, value in evaluator.fallback.items()},
        "constants": {name: shortest(value) for name, value in evaluator.constants.items()},
        "starts": _list(evaluator.starts),
        "polynomials": {
            name: [_list(row) for row in rows] for name, rows in evaluator.polynomials.items()
        },
        "inverse_step": shortest(evaluator.inverse_step),
        "tables": {name: _list(values) for name, values in evaluator.tables.items()},
    }


def evaluator_from(plain: Mapping[str, Any]) -> GainEvaluator:
    """Read an evaluator back.

    Raises:
        InputError: The data are not what `plain_evaluator` makes.
    """
    try:
        found = GainEvaluator(
            end=single_from(plain["end"]),
            fallback={name: single_from(plain["fallback"][name]) for name in GAIN_NAMES},
            constants={name: single_from(value) for name, value in plain["constants"].items()},
            starts=singles_from(plain["starts"], _MOST_VALUES),
            polynomials={
                name: np.stack([singles_from(row, _MOST_VALUES) for row in rows])
                for name, rows in plain["polynomials"].items()
            },
            inverse_step=single_from(plain["inverse_step"]),
            tables={
                name: singles_from(values, _MOST_VALUES) for name, values in plain["tables"].items()
            },
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise _FAULT from error
    names = sorted([*found.constants, *found.polynomials, *found.tables])
    sizes = {table.size for table in found.tables.values()}
    rows = {rows.shape[0] for rows in found.polynomials.values()}
    reach = float(found.end) * float(found.inverse_step)
    sound = (
        names == sorted(GAIN_NAMES)
        and found.end > 0.0
        and not (found.tables and found.polynomials)
        and (not found.tables or (len(sizes) == 1 and min(sizes) > 1 and 0.0 < reach < min(sizes)))
        and (not found.polynomials or rows == {found.starts.size})
        and found.starts[0] == 0.0
        and bool(np.all(np.diff(found.starts) > 0.0))
    )
    if not sound:
        raise _FAULT
    return found


def schedule_inputs(
    evaluator: GainEvaluator, count: int, seed: int, patterns: int = 0
) -> SingleArray:
    """Currents i_q in A, shape (count + patterns + 20,): all over the domain and beyond it,
    special ones, any bits.
    """
    generator = np.random.default_rng(seed)
    end = float(evaluator.end)
    across = (generator.uniform(-1.2, 1.2, count) * end).astype(np.float32)
    beside = [
        np.nextafter(np.float32(v), np.float32(s))
        for v in (end, *evaluator.starts[1:])
        for s in (0.0, np.inf)
    ]
    special = [
        0.0,
        -0.0,
        np.nan,
        -np.nan,
        np.inf,
        -np.inf,
        1e-45,
        -1e-45,
        end,
        -end,
        *evaluator.starts.tolist(),
        *beside,
    ]
    bits = generator.integers(0, 2**32, patterns, dtype=np.uint32).view(np.float32)
    return np.concatenate([np.array(special, dtype=np.float32), across, bits])


def _body(design: Design, evaluator: GainEvaluator, lines: Sequence[str]) -> str:
    """What stands between the guards of the header; ``lines`` of the function's comment."""
    # Nothing else of this room writes C.
    from dqforge.reports.c_code.numbers import comment_text, float_literal
    from dqforge.reports.steps.blocks import Block, Functions
    from dqforge.reports.steps.counted_loops import Table
    from dqforge.reports.steps.record_text import comment
    from dqforge.reports.steps.step_reader import StepReader
    from dqforge.reports.steps.symbols import Expression

    prefix, tables = design.export.prefix, evaluator.tables
    end = f"{title(design)['macro']}_SCHEDULE_END_A"
    value = float_literal(float(evaluator.end))
    parts = [f"#define {end} ({value}) /* largest |i_q| that the gains follow, A (peak) */"]
    rows = None
    if tables:
        values = np.stack([*tables.values()], axis=1)
        rows = Table(f"{prefix}_gains_table", values.shape)
        said = (
            f"Gains at {len(values)} currents, even steps from 0 to the end, V/A: "
            f"{', '.join(tables)}."
        )
        table = [f"    {{ {', '.join(float_literal(float(x)) for x in row)} }}," for row in values]
        begin = f"static const float {rows.text}[{len(values)}][{len(tables)}] = {{"
        parts.append("\n".join([*comment(said), begin, *table, "};"]))
    reader = StepReader(prefix, Functions(), Block("", set()))

    def current_gains(o: Arithmetic, i_q: Reals) -> Gains:
        return evaluator.step(o, i_q, Expression(end), rows)

    argument = [Expression("i_q")]
    reader.write("current_gains", current_gains, argument, into=GAIN_NAMES, names=["i_q_A"])
    meaning = ["/* Gains of both current controllers for a q-axis current.", " *"]
    meaning += [f" * {comment_text(line)}".rstrip() for line in lines] + [" */"]
    parts.append("\n".join([*meaning, *reader.functions.texts.values()]))
    return "\n\n".join(parts)


def _context(design: Design, gains: GainSet, schedule: GainSchedule) -> PlainData:
    lines = [
        (
            "i_q_A: q-axis current in A as it is measured, either sign; beyond SCHEDULE_END the "
            "gains stay as they are there."
        ),
        (
            "kp_d, kp_q: proportional gains, V/A; ki_ts_d, ki_ts_q: integral gains times the "
            "sampling period, V/A."
        ),
        (
            "Parallel form: I[k] = I[k-1] + ki_ts[k] e[k], d[k] = kp[k] e[k] + I[k]; or as "
            "differences d[k] = d[k-1] + kp[k] e[k] - kp[k-1] e[k-1] + ki_ts[k] e[k]."
        ),
        (
            "Not d[k-1] + kp[k] (e[k] - e[k-1]) + ki_ts[k] e[k]: what kp changes by would stay "
            "in d for good, and the loop can grow though it is stable at every current."
        ),
        "Not-a-number gives the constant gains, those for the least inductance.",
        "",
        *schedule_lines(schedule),
        *changing_lines(gains),
        "Margins are those of frozen currents along the current reference.",
    ]
    return {
        **title(design),
        "part": "gains",
        "subject": "current-loop gains over the current",
        "includes": [],
        "body": _body(design, schedule.fit.evaluator, lines),
        "vectors": True,
        "preamble": [
            (
                f"Method {design.control.current_loop.method}, sampled every "
                f"{design.control.t_s * 1e6:.6g} us."
            ),
            (
                "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
                "errors hold either way."
            ),
        ],
    }


GAIN_HARNESS = Harness(
    "gains",
    "i_q in A; kp_d, ki_ts_d, kp_q, ki_ts_q in V/A",
    (1, 4),
    ("@_current_gains(in[0], &out[0], &out[1], &out[2], &out[3]);",),
)


def gains_files(design: Design, gains: GainSet, schedule: GainSchedule) -> dict[str, bytes]:
    """Names and bytes of the header of gains over the current and of its test vectors."""
    context, evaluator = _context(design, gains, schedule), schedule.fit.evaluator
    inputs = schedule_inputs(evaluator, design.export.vectors, _SEED)
    vectors = np.concatenate([inputs[:, np.newaxis], evaluator.gains(inputs)], axis=1)
    text = render("c_code/header.h.j2", context)
    return GAIN_HARNESS.files(design, text, vectors)


def gains_programme(evaluator: GainEvaluator) -> Programme:
    """The harness of scheduled gains, with what their model answers."""
    half = SWEEP_POINTS // 2
    currents = schedule_inputs(evaluator, half, SWEEP_SEED, patterns=half)
    return Programme(GAIN_HARNESS, currents, evaluator.gains(currents), "gains over the current")


# Loops in the report.

LOOP_TEXT = {"i_d": "i_d", "i_q": "i_q", "i_0": "i_0", "speed": "speed"}


_KP_UNITS = {"i_d": "V/A", "i_q": "V/A", "i_0": "V/A", "speed": f"N{NARROW}m{NARROW}s/rad"}


_KI_UNITS = {"i_d": "V/(A s)", "i_q": "V/(A s)", "i_0": "V/(A s)", "speed": f"N{NARROW}m/rad"}


def _loop_cells(gains: LoopGains, scaled: PerUnitGains) -> tuple[str, ...]:
    per_unit_text = f"{number(scaled.kp, 5)}, {number(scaled.ki_ts, 5)}"
    if scaled.integers is not None:
        per_unit_text += " = " + ", ".join(
            f"{found.mantissa} in Q{found.shift}" for found in scaled.integers
        )
    poles = ", ".join(_pole_text(complex(pole)) for pole in gains.poles)
    delay = (
        f"{quantity(gains.delay_margin, 's', 3)} ({number(gains.delay_margin_samples, 3)} samples)"
    )
    return (
        gains.method,
        quantity(gains.t_s, "s"),
        f"{number(gains.kp, 6)}{NARROW}{_KP_UNITS[gains.loop]}",
        f"{number(gains.ki, 6)}{NARROW}{_KI_UNITS[gains.loop]}",
        quantity(gains.t_i, "s", 5),
        ", ".join(number(value, 6) for value in gains.velocity),
        per_unit_text,
        quantity(gains.crossover / (2.0 * math.pi), "Hz"),
        degrees(gains.phase_margin)
        if gains.stable
        else f"{degrees(gains.phase_margin)} (unstable)",
        decibel(gains.gain_margin),
        delay,
        number(gains.max_sensitivity, 3),
        _disturbance_text(gains),
        poles,
        symbols("; ".join(observed_notes(gains))),
    )


def _pole_text(pole: complex) -> str:
    if abs(pole.imag) < 1e-9:
        return number(pole.real, 5)
    sign = "+" if pole.imag > 0.0 else "\u2212"
    return f"{number(pole.real, 4)}{NARROW}{sign}{NARROW}j{number(abs(pole.imag), 4)}"


def _disturbance_text(gains: LoopGains) -> str:
    response = gains.disturbance
    if gains.observed is not None:
        return "not computed with the observer"
    unit = "A per V" if gains.loop != "speed" else "rad/s per N m"
    finite = math.isfinite(response.settling_time)
    settled = (
        f"settled in {quantity(response.settling_time, 's', 3)}"
        if finite
        else "settles later than was computed"
    )
    return f"{number(response.peak, 3)} {unit}, {settled}"


def loop_table(gains: GainSet) -> HtmlTable:
    """Gains, margins and poles, one column per loop."""
    columns = [_loop_cells(loop, gains.per_unit[loop.loop]) for loop in gains.loops]
    names = [f"{loop.loop} loop" for loop in gains.loops]
    labels = heading_cells(
        "method",
        "sampled every",
        "proportional gain k_p",
        "integral gain k_i",
        "integral time T_i of the series form",
        "velocity form: q_0, q_1",
        "per unit: k_p, k_i T_s",
        "crossover",
        "phase margin",
        "gain margin",
        "delay margin",
        "largest sensitivity M_s",
        "largest deviation after a unit disturbance",
        "closed-loop poles in z",
        "speed from",
    )
    rows = tuple(
        Row((label, *cells)) for label, *cells in zip(labels, *columns, strict=True) if any(cells)
    )
    caption = "Gains and margins of the sampled loops"
    if gains.schedule is None:
        caption = "; ".join((caption, *changing_notes(gains)))
    return HtmlTable(symbols(caption), ("", *heading_cells(*names)), rows)


def _table(
    caption: str, columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...], text_columns: int
) -> HtmlTable:
    cells = tuple(Row(tuple(symbols(cell) for cell in row)) for row in rows)
    return HtmlTable(
        symbols(caption), tuple(symbols(column) for column in columns), cells, text_columns
    )


def firmware_tables(gains: GainSet) -> list[HtmlTable]:
    """The loops as the firmware that the design names runs them; none without one."""
    if gains.firmware is None:
        return []
    table = _table(
        firmware_title(gains.firmware), FIRMWARE_COLUMNS, firmware_rows(gains.firmware), 2
    )
    return [replace(table, notes=tuple(map(symbols, firmware_notes(gains.firmware))))]


def judged_tables(gains: GainSet) -> list[HtmlTable]:
    """How fast the currents of a phase machine forget; none of all others."""
    if gains.phases is None or gains.phases.judged is None:
        return []
    caption = f"{JUDGED_TITLE}; {'; '.join(judged_notes(gains.phases))}"
    judged = gains.phases.judged
    return [_table(caption, judged_columns(judged), judged_rows(judged), 1)]


def tolerance_tables(gains: GainSet, pole_pairs: int) -> list[HtmlTable]:
    """Worst margins within the tolerances, and scheduled beside constant gains.

    None where none are asked for.
    """
    tables = []
    if gains.robust is not None:
        notes = (
            *robust_notes(gains.robust),
            *box_notes(gains),
            *stability_notes(gains, pole_pairs),
        )
        caption = f"Worst within control.tolerances; {'; '.join(notes)}"
        tables.append(
            _table(caption, ROBUST_COLUMNS, robust_rows(gains.robust), len(ROBUST_COLUMNS))
        )
    if gains.schedule is not None:
        caption = (
            "Scheduled gains along the current reference. "
            f"{'; '.join((*schedule_notes(gains.schedule), *changing_notes(gains)))}"
        )
        tables.append(_table(caption, SCHEDULE_COLUMNS, schedule_rows(gains.schedule), 1))
    return tables


# Gains of the control loops and their schedule, as records.


def _summary(_: Solution, gains: GainSet) -> Rows:
    rows = [("speed loop at all corners", words) for words in corner_words(gains.speed)]
    if gains.phases is not None and gains.phases.judged is not None:
        rows.append(("both axes", judged_words(gains.phases.judged)))
    if gains.firmware is not None:
        rows.append((f"as {gains.firmware.name} runs them", firmware_words(gains.firmware)))
    return rows


def _flashed(_: Solution, gains: GainSet) -> list[Flashed]:
    return [
        Flashed(
            f"{loop.loop} loop",
            ", ".join(
                f"{name} {value:.5g} {unit}"
                for name, value, unit in zip(
                    ("kp", "ki"), (loop.kp, loop.ki), _GAIN_UNITS[loop.loop], strict=True
                )
            ),
            loop_words(loop),
        )
        for loop in gains.loops
    ]


def _watched(_: Solution, gains: GainSet) -> list[str]:
    """Loops that swing, and what the observer leaves of the speed loop."""
    texts = [f"the {loop.loop} loop is unstable" for loop in gains.loops if not loop.stable]
    texts += rotating_words(gains.rotating)
    speed = gains.speed
    if speed is not None and speed.observed is not None and not speed.observed.holds:
        texts.append(left_words(speed))
    return texts if gains.robust is None else [*texts, worst_words(gains.robust)]


def _margin(loop: LoopGains) -> str:
    """Phase margin, or that the loop has none."""
    return degrees(loop.phase_margin) if loop.stable else "unstable"


def _sentences(_: Solution, gains: GainSet) -> list[str]:
    margins = ", ".join(f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in gains.loops)
    sentences = [f"The phase margins of the sampled loops are {margins}."]
    speed = gains.speed
    if speed is not None and speed.observed is not None:
        sentences.append(
            f"The speed loop is evaluated with the lag of its observer; {left_words(speed)}."
        )
    if gains.phases is not None and gains.phases.judged is not None:
        sentences.append(judged_sentence(gains.phases.judged))
    if gains.firmware is not None:
        margins = firmware_words(gains.firmware)
        sentences.append(f"As {firmware_name(gains.firmware)} runs them they are {margins}.")
    return sentences


def _tiles(_: Solution, gains: GainSet) -> list[Tile]:
    loops = gains.loops
    worst = min(loops, key=lambda loop: (loop.stable, abs(loop.phase_margin)))
    others = [f"{LOOP_TEXT[loop.loop]} {_margin(loop)}" for loop in loops if loop is not worst]
    detail = symbols(f"{LOOP_TEXT[worst.loop]} loop; {', '.join(others)}")
    return [Tile("Smallest phase margin", _margin(worst), detail)]


def _figures(_: Solution, gains: GainSet) -> Mapping[str, Draw]:
    from dqforge.reports.loops.figures import plot_gains

    return {"loops": lambda: plot_gains(gains)}


def _plain(solution: Solution, gains: GainSet) -> PlainData:
    return plain_gains(solution.design, gains, solution.observer_errors)


def _parts(solution: Solution, gains: GainSet) -> list[ReportPart]:
    pole_pairs = solution.design.machine.pole_pairs
    tables = [
        loop_table(gains),
        *firmware_tables(gains),
        *judged_tables(gains),
        *tolerance_tables(gains, pole_pairs),
    ]
    key = f"smallest phase margin {_tiles(solution, gains)[0].value}"
    caption = (
        "Left: response to a unit step of the reference. Right: open loops up to half their "
        "sampling frequency; dots mark the crossovers, thick lines the phase margins."
    )
    return [Passage(drawings=[("loops", caption)], tables=tables, kind="loops").of(CHAPTER, key)]


def _hertz(omega: float) -> float:
    return omega / (2.0 * math.pi)


_GAIN_UNITS = {
    "i_d": ("V/A", "V/(A s)"),
    "i_q": ("V/A", "V/(A s)"),
    "i_0": ("V/A", "V/(A s)"),
    "speed": ("N m s/rad", "N m/rad"),
}

_OBSERVER = (
    ("A", "a", ""),
    ("B_U", "b_u", "rad/(s V)"),
    ("B_I", "b_i", "rad/(s A)"),
    ("C", "c", "rad/(s A)"),
)


def _loop_quantities(loop: str, kp: str, ki: str) -> tuple[Quantity, ...]:
    section, path = f"{loop} loop", ("gains", loop)
    return (
        Quantity(section, "method", "", (*path, "method")),
        Quantity(section, "kp", kp, (*path, "kp")),
        Quantity(section, "ki", ki, (*path, "ki")),
        Quantity(section, "sampled every", "s", (*path, "t_s")),
        Quantity(section, "bandwidth (crossover)", "Hz", (*path, "crossover_rad_per_s"), _hertz),
        Quantity(section, "phase margin", "deg", (*path, "phase_margin_rad")),
        Quantity(section, "gain margin (factor)", "", (*path, "gain_margin")),
        Quantity(section, "delay margin", "s", (*path, "delay_margin_s")),
        Quantity(section, "M_s", "", (*path, "max_sensitivity")),
    )


def _firmware_quantities(loop: str, kp: str, ki: str) -> tuple[Quantity, ...]:
    section, path = f"{loop} loop as its firmware runs it", ("gains", "firmware", loop)
    return (
        Quantity(section, "kp", kp, (*path, "kp")),
        Quantity(section, "ki", ki, (*path, "ki")),
        Quantity(section, "bandwidth (crossover)", "Hz", (*path, "crossover_rad_per_s"), _hertz),
        Quantity(section, "phase margin", "deg", (*path, "phase_margin_rad")),
        Quantity(section, "gain margin (factor)", "", (*path, "gain_margin")),
        Quantity(section, "M_s", "", (*path, "max_sensitivity")),
        Quantity(section, "damping", "", (*path, "damping")),
    )


_FIRMWARE_UNITS = {
    "i_d": ("V/A", "V/(A s)"),
    "i_q": ("V/A", "V/(A s)"),
    "speed": ("A s/rad", "A/rad"),
}

LOOPS = Capability(
    name="gains",
    title="control loops",
    of=lambda outcome: outcome.solution.loops,
    plain=_plain,
    flashed=_flashed,
    watched=_watched,
    summary=_summary,
    tables=lambda solution, gains: gains_tables(solution.design, gains),
    sentences=_sentences,
    tiles=_tiles,
    figures=_figures,
    parts=_parts,
    quantities=(
        *(row for loop, units in _GAIN_UNITS.items() for row in _loop_quantities(loop, *units)),
        *(
            row
            for loop, units in _FIRMWARE_UNITS.items()
            for row in _firmware_quantities(loop, *units)
        ),
        Quantity("both axes", "radius per sample", "", ("gains", "currents", "radius")),
        *(
            Quantity("observer", label, unit, ("gains", "observer", key))
            for label, key, unit in _OBSERVER
        ),
    ),
)


def _certified(outcome: Outcome) -> CurrentLoopProof | None:
    loops = outcome.solution.loops
    proof = None if loops is None or loops.robust is None else loops.robust.proof
    return None if proof is None or proof.certificate is None else proof


# Its words and its JSON stand with those of the loops; its certificate lies beside the headers.
STABILITY = Capability(
    name="stability",
    title="proof of the current loops",
    of=_certified,
    summary=lambda _, proof: [("current loops", proof_summary(proof))],
    emitted=lambda solution, proof: {
        f"{solution.design.export.prefix}{CERTIFICATE}": certificate_bytes(proof)
    },
)


def _left_out(outcome: Outcome) -> str | None:
    return outcome.solution.gains_left_out if outcome.solution.loops is None else None


NO_LOOPS = Capability(
    name="gains_left_out",
    title="why there are no control loops",
    of=_left_out,
    plain=lambda _, why: why,
    always=False,
    watched=lambda _, why: [f"there are no control loops: {why}"],
    sentences=lambda _, why: [f"There are no control loops: {why}."],
)


def _gains_files(solution: Solution, schedule: GainSchedule) -> dict[str, bytes]:
    assert solution.loops is not None
    return gains_files(solution.design, solution.loops, schedule)


# Its table and its JSON stand with those of the loops.
GAIN_SCHEDULE = Capability(
    name="gain_schedule",
    title="gains over the current",
    of=lambda outcome: None if outcome.solution.loops is None else outcome.solution.loops.schedule,
    headers=(
        HeaderKind(
            name="gains",
            files=_gains_files,
            plain=lambda _, schedule: plain_evaluator(schedule.fit.evaluator),
            read=lambda own, _: evaluator_from(own),
            programme=gains_programme,
        ),
    ),
)
