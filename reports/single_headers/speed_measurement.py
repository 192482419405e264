"""The emitted measurement of the speed: header, model, tables, JSON and words."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import in_rpm
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.curves.single_precision import SINGLE
from dqforge.optimizer.speed_measurement import counted, timed
from dqforge.optimizer.steps.step_arithmetic import Arithmetic
from dqforge.reports.c_code.harness import (
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    single_from,
    title,
)
from dqforge.reports.capability import Capability, Outcome, Passage, ReportPart
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, significant, symbols
from dqforge.reports.pages.templating import LOOPS, render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import record_structs, record_values
from dqforge.reports.steps.symbols import Expression
from dqforge.reports.steps.word_reader import WordReader

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.machines.names import SpeedMeasurementName
    from dqforge.optimizer.control_design.measured_speed_loop import MeasuredSpeed
    from dqforge.optimizer.solution import Solution


TITLE = "Speed loop on the measured speed"


_COLUMNS = ("speed", "delay ms", "one count or tick rpm", "phase margin deg")


_METHODS = {
    "counts": "edges counted over a speed period",
    "capture": "time between the last two edges",
    "mixed": "edges over the time that they took",
}


def measured_rows(found: MeasuredSpeed) -> list[tuple[str, str]]:
    """Label and text of what holds at every speed."""
    own = found.settings
    encoder = f"{own.lines} lines, {own.edges} of 4 edges"
    rows = [("speed measured by", f"{_METHODS[own.method]}; {encoder}")]
    if own.method != "counts":
        clock = format_quantity(own.clock, "Hz", 4)
        rows.append(("timer", f"{clock}, {own.counter_bits} bits"))
        least = format_quantity(found.edges.least, "rpm", 3)
        most = format_quantity(found.edges.largest, "rpm", 3)
        rows.append(("range", f"{least} (below: at rest) to {most} (one tick)"))
    required = f"{math.degrees(found.required):.3g} deg"
    lowest = format_quantity(found.lowest, "rpm", 3)
    rows.append(("speed loop", f"{required} of phase margin or more from {lowest} on"))
    return rows


def speed_rows(found: MeasuredSpeed) -> list[tuple[str, ...]]:
    """A row per speed: delay, resolution, margin."""
    return [
        (
            format_quantity(float(omega), "rpm", 4),
            significant(1e3 * float(delay), 3),
            significant(in_rpm(float(step)), 3),
            f"{math.degrees(margin):.1f}",
        )
        for omega, delay, step, margin in zip(
            found.omega_m, found.delay, found.resolution, found.phase_margin, strict=True
        )
    ]


def measured_tables(found: MeasuredSpeed) -> list[Table]:
    """For the terminal."""
    notes = tuple(f"{label}: {text}" for label, text in measured_rows(found))
    return [Table(TITLE, _COLUMNS, tuple(speed_rows(found)), notes)]


def measured_html(found: MeasuredSpeed) -> list[HtmlTable]:
    """For the report."""
    rows = tuple(Row(tuple(symbols(cell) for cell in row)) for row in speed_rows(found))
    notes = tuple(symbols(f"{label}: {text}") for label, text in measured_rows(found))
    return [HtmlTable(TITLE, _COLUMNS, rows, notes=notes)]


def plain_measured(found: MeasuredSpeed) -> PlainData:
    """As plain data, in SI units."""
    own = found.settings
    return {
        "method": own.method,
        "lines": own.lines,
        "edges_per_line": own.edges,
        "clock_Hz": own.clock if own.clock > 0.0 else None,
        "counter_bits": own.counter_bits if own.clock > 0.0 else None,
        "period_s": found.edges.period,
        "omega_m_rad_per_s": found.omega_m,
        "delay_s": found.delay,
        "resolution_rad_per_s": found.resolution,
        "phase_margin_rad": found.phase_margin,
        "least_rad_per_s": found.edges.least,
        "largest_rad_per_s": found.edges.largest if math.isfinite(found.edges.largest) else None,
        "lowest_rad_per_s": found.lowest,
        "required_phase_margin_rad": found.required,
    }


# The emitted measurement of the speed: its numbers as plain data, its model, and events to try it.
#
# The model is integers throughout: a number of edges over a number of ticks. Float32 and fixed
# point are made of these in the end. It is the text of `dqforge.optimizer.speed_measurement`.

METHODS: tuple[SpeedMeasurementName, ...] = ("counts", "capture", "mixed")
EDGE, SAMPLE, START = 0, 1, 2  # Events of the harness.
_WORD = 1 << 32
EVENTS = 20_000


@dataclass(frozen=True, slots=True)
class EdgeNumbers:
    """Numbers of the C structure.

    ``scale`` is the mechanical speed in rad/s of one edge per tick (of counts: per sample),
    ``mask`` the largest number of the timer, ``patience`` samples without an edge after which the
    speed is nought. ``codes`` are per width in bits the speed of one edge per tick as a per-unit
    number of that width, rounded.
    """

    method: SpeedMeasurementName
    scale: np.float32
    mask: int
    patience: int
    codes: tuple[tuple[int, int], ...]


def edge_numbers(found: MeasuredSpeed, base: float, formats: tuple[str, ...]) -> EdgeNumbers:
    """Numbers for the firmware.

    Args:
        found: The measurement.
        base: Mechanical speed in rad/s that is one per unit.
        formats: Fixed-point formats of the control functions.
    """
    own = found.settings
    rate = 1.0 / found.edges.period if own.method == "counts" else own.clock
    scale = 2.0 * np.pi * rate / found.edges.per_turn
    widths = sorted({FIXED_WIDTHS[name] for name in formats if name in FIXED_WIDTHS})
    codes = tuple((width, round(scale / base * 2.0 ** (width - 1))) for width in widths)
    return EdgeNumbers(
        own.method, np.float32(scale), 2**own.counter_bits - 1, found.edges.patience, codes
    )


def plain_numbers(numbers: EdgeNumbers) -> PlainData:
    """As plain data; ``scale`` is a float32 value."""
    return {
        "method": numbers.method,
        "scale": shortest(numbers.scale),
        "mask": numbers.mask,
        "patience": numbers.patience,
        "codes": [list(pair) for pair in numbers.codes],
    }


def numbers_from(plain: Mapping[str, Any]) -> EdgeNumbers:
    """Read numbers back.

    Raises:
        InputError: They are not what `plain_numbers` makes.
    """
    fault = InputError("speed_measurement_header is not what dqforge writes; run the design again")
    try:
        method, mask, patience = plain["method"], plain["mask"], plain["patience"]
        codes = tuple((width, code) for width, code in plain["codes"])
        found = EdgeNumbers(method, single_from(plain["scale"]), mask, patience, codes)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise fault from error
    counted = (mask, patience, *(part for pair in codes for part in pair))
    if method not in METHODS or not all(type(part) is int and part >= 0 for part in counted):
        raise fault
    if not (mask < _WORD and patience < _WORD and all(width in (16, 32) for width, _ in codes)):
        raise fault
    return found


class EdgeState:
    """The measurement as the C has it, in words of 32 bits.

    Args:
        numbers: Of the C structure.
    """

    def __init__(self, numbers: EdgeNumbers) -> None:
        self.numbers, self.state = numbers, _at_rest(numbers)
        self._gains: Any = _gains(numbers)

    @property
    def span(self) -> int:
        """What the edges took, in ticks (of counts: in samples)."""
        return int(self.state.span)

    def start(self) -> None:
        """No edge and no speed yet."""
        own: Any = counted if self.numbers.method == "counts" else timed
        own.start(SINGLE, self.state)

    def edge(self, stamp: int, sense: int) -> None:
        """An edge at a time of the timer, forward (1) or backward (-1)."""
        assert isinstance(self.state, timed.SpeedMeasurement)
        with np.errstate(over="ignore"):
            timed.edge(SINGLE, self._gains, self.state, np.uint32(stamp), np.int32(sense))

    def sample(self, now: int) -> None:
        """The speed controller asks, at a time of the timer (of counts: a position)."""
        with np.errstate(over="ignore"):
            if isinstance(self.state, counted.SpeedMeasurement):
                counted.sample(SINGLE, self.state, np.uint32(now))
            else:
                own = timed.captured if self.numbers.method == "capture" else timed.mixed
                own(SINGLE, self._gains, self.state, np.uint32(now))

    def row(self) -> tuple[int, ...]:
        """Bits of the speed in rad/s, and the per-unit codes of every width."""
        speed = timed.rad_per_s(SINGLE, self._gains, self.state)
        with np.errstate(over="ignore"):
            codes = [
                int(timed.per_unit(SINGLE, width, code, self.state)) % _WORD
                for width, code in self.numbers.codes
            ]
        return (int(np.float32(speed).view(np.uint32)), *codes)


def _at_rest(numbers: EdgeNumbers) -> timed.State:
    return counted.at_rest() if numbers.method == "counts" else timed.at_rest()


def _gains(numbers: EdgeNumbers) -> timed.Gains:
    scale: Any = numbers.scale
    if numbers.method == "counts":
        return counted.SpeedMeasurementGains(scale)
    return timed.SpeedMeasurementGains(scale, numbers.mask, numbers.patience)


def _positions(generator: np.random.Generator, count: int) -> NDArray[np.uint32]:
    """Samples of a counter that runs over, forward, at rest and backward."""
    size = 10.0 ** generator.uniform(-1.0, 9.0, count)
    moved = np.round(size * generator.choice([1.0, -1.0], count)).astype(np.int64)
    rows = np.zeros((count, 3), dtype=np.uint32)
    rows[:, 0] = np.where(np.arange(count) % 500 == 0, START, SAMPLE)
    rows[:, 1] = (np.cumsum(moved) % _WORD).astype(np.uint32)
    return rows


def edge_events(numbers: EdgeNumbers, count: int, seed: int) -> NDArray[np.uint32]:
    """Rows (event, time of the timer or position, 1 forward or 0 backward), shape (M, 3).

    Speeds of any size, both directions, turns, rests longer than the timer runs, and single edges.
    """
    generator = np.random.default_rng(seed)
    if numbers.method == "counts":
        return _positions(generator, count)
    rows: list[tuple[int, int, int]] = [(START, 0, 0)]
    period = max(min(numbers.mask, 1 << 20) * 3 // 4, 2)
    time, sense = int(generator.integers(0, _WORD)), 1
    while len(rows) < count:
        pace = period * 10.0 ** generator.uniform(-1.5, 1.2)
        if generator.random() < 0.3:
            sense = 1 - sense
        for _ in range(int(generator.integers(1, 9))):
            end, edge = time + period, float(time)
            while (edge := edge + pace * generator.uniform(0.8, 1.2)) < end and len(rows) < count:
                rows.append((EDGE, int(edge) % _WORD, sense))
            time = end
            rows.append((SAMPLE, time % _WORD, 0))
        if generator.random() < 0.02:
            rows.append((START, 0, 0))
    return np.array(rows, dtype=np.uint32)


def edge_rows(numbers: EdgeNumbers, events: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """What the compiled functions must return after each event, shape (M, 1 + widths)."""
    state, found = EdgeState(numbers), []
    for event, time, forward in events.tolist():
        if event == START:
            state.start()
        elif event == EDGE and numbers.method != "counts":
            state.edge(time, 1 if forward else -1)
        elif event == SAMPLE:
            state.sample(time)
        found.append(state.row())
    return np.array(found, dtype=np.uint32)


# The C header of a measured speed, and its harness.


def numbers_of(design: Design, found: MeasuredSpeed) -> EdgeNumbers:
    """Numbers of the header of a design."""
    return edge_numbers(found, design.control.bases.speed, design.export.control)


def measurement_files(design: Design, found: MeasuredSpeed) -> dict[str, bytes]:
    """Name and bytes of the header."""
    numbers, prefix = numbers_of(design, found), design.export.prefix
    lines = [
        line
        for label, text in measured_rows(found)
        for line in wrap(f"{label[0].upper()}{label[1:]}: {text}.", 110)
    ]
    context: PlainData = {
        **title(design),
        "part": "speed_measurement",
        "subject": "speed from the edges of an encoder",
        "preamble": lines,
        "includes": ["<stdint.h>"],
        "vectors": False,
        "body": measurement_text(numbers, prefix, design.control.bases.speed),
    }
    text = render("c_code/header.h.j2", context)
    return {f"{prefix}_speed_measurement.h": text.encode("ascii")}


def measurement_text(numbers: EdgeNumbers, prefix: str, base: float) -> str:
    """Types, numbers and functions of the header.

    Args:
        numbers: Of the C structure.
        prefix: Before all names.
        base: Mechanical speed in rad/s that is one per unit.
    """
    gains, state, name = _gains(numbers), _at_rest(numbers), "speed_measurement"
    reader = WordReader(prefix, Functions(), Block("", set()))
    time, sense = Expression("now", kind="uint32_t"), Expression("sense", kind="int32_t")
    if numbers.method == "counts":
        reader.write(f"{name}_start", counted.start, [state])
        reader.write(f"{name}_sample", counted.sample, [state, time])
    else:
        sample = timed.captured if numbers.method == "capture" else timed.mixed
        reader.write(f"{name}_start", timed.start, [state])
        reader.write(f"{name}_edge", timed.edge, [gains, state, time, sense])
        reader.write(f"{name}_sample", sample, [gains, state, time])
    reader.write(f"{name}_rad_per_s", timed.rad_per_s, [gains, state])
    for width, code in numbers.codes:
        said = f"Mechanical speed over {base:.6g} rad/s, {width - 1} fractional bits."
        own = partial(_code, width, code)
        reader.write(f"{name}_q{width - 1}", own, [state], said, names=["state"])
    constant = f"{prefix.upper()}_SPEED_MEASUREMENT_GAINS"
    parts = [
        *record_structs(gains, prefix),
        [
            f"static const {prefix}_{name}_gains_t {constant} = {{",
            *record_values(gains, None),
            "};",
        ],
        *record_structs(state, prefix),
        *([text] for text in reader.functions.texts.values()),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def _code(width: int, code: int, o: Arithmetic, state: timed.State) -> Any:
    return timed.per_unit(o, width, code, state)


def measurement_programme(numbers: EdgeNumbers) -> Programme:
    """The harness of the header, with what its model answers."""
    events = edge_events(numbers, EVENTS, SWEEP_SEED)
    return Programme(_harness(numbers), events, edge_rows(numbers, events), "speed measurement")


def _harness(numbers: EdgeNumbers) -> Harness:
    name, gains = "@_speed_measurement", "&@@_SPEED_MEASUREMENT_GAINS"
    widths = [width for width, _ in numbers.codes]
    counts = numbers.method == "counts"
    edge = [
        "} else {",
        f"    {name}_edge({gains}, &state, in[1], (in[2] > 0U) ? 1 : -1);",
    ]
    return Harness(
        "speed_measurement",
        "kind of the event and two words; bits of the speed in rad/s, and its codes",
        (3, 1 + len(widths)),
        (
            "float speed;",
            "",
            f"if (in[0] == {START}U) {{",
            f"    {name}_start(&state);",
            f"}} else if (in[0] == {SAMPLE}U) {{",
            f"    {name}_sample({'' if counts else f'{gains}, '}&state, in[1]);",
            *([] if counts else edge),
            "}",
            f"speed = {name}_rad_per_s({gains}, &state);",
            "memcpy(&out[0], &speed, sizeof speed);",
            *(
                f"out[{k}] = (uint32_t)(int32_t){name}_q{width - 1}(&state);"
                for k, width in enumerate(widths, 1)
            ),
        ),
        number="uint32_t",
        vectors=False,
        states=(f"{name}_t state;",),
        starts=(f"{name}_start(&state);",),
    )


# The measured speed, as a record.


def _of(outcome: Outcome) -> MeasuredSpeed | None:
    gains = outcome.solution.loops
    return None if gains is None else gains.measured_speed


def _parts(_: Solution, found: MeasuredSpeed) -> list[ReportPart]:
    return [Passage(tables=measured_html(found), kind="loops").of(LOOPS)]


_HEADER: HeaderKind[MeasuredSpeed, EdgeNumbers] = HeaderKind(
    name="speed_measurement",
    files=lambda solution, found: measurement_files(solution.design, found),
    plain=lambda solution, found: plain_numbers(numbers_of(solution.design, found)),
    read=lambda own, _: numbers_from(own),
    programme=measurement_programme,
    vectors=False,
)

SPEED_MEASUREMENT = Capability(
    name="speed_measurement",
    title="speed from the edges of an encoder",
    of=_of,
    plain=lambda _, found: plain_measured(found),
    always=False,
    summary=lambda _, found: measured_rows(found),
    tables=lambda _, found: measured_tables(found),
    parts=_parts,
    headers=(_HEADER,),
)
