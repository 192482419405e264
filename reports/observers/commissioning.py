"""The emitted tests of a drive on its own machine: header, model, tables, JSON and words."""

from __future__ import annotations

from collections.abc import Mapping
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from dqforge.machines.errors import InputError
from dqforge.machines.units.quantities import format_quantity
from dqforge.optimizer.commissioning import (
    STATES,
    TESTS,
    CommissioningFit,
    CommissioningGains,
    CommissioningState,
    CommissioningTest,
    at_rest,
    single,
    start,
    step,
)
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.steps.step_arithmetic import Dq
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    title,
)
from dqforge.reports.capability import Capability, Passage, ReportPart
from dqforge.reports.observers.float32_model import gains_from, plain_gains_of
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, symbols
from dqforge.reports.pages.templating import LOOPS, render
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.control_types import control_types
from dqforge.reports.steps.record_text import enumeration, record_structs, record_values
from dqforge.reports.steps.state_text import vector
from dqforge.reports.steps.symbols import Expression
from dqforge.reports.steps.word_reader import WordReader

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.plain_data import PlainData

TITLE = "Tests of the drive on its own machine"
_NAME = "commissioning"
_COLUMNS = ("test", "what is done")
_LENGTH = 200  # Samples of a sequence.
_COLUMNS_IN, _OUT = 4, ("state", "u_d", "u_q", "i_q", "take", "place", "logged", "coast")


def rows_of_tests(found: CommissioningFit) -> list[tuple[str, str]]:
    """Label and text of each test."""
    gains = found.gains
    current, speed = (
        format_quantity(gains.current, "A", 3),
        format_quantity(gains.omega_most, "rpm", 3),
    )
    held = format_quantity(gains.hold * found.t_s, "s", 3)
    every, slowly = (
        format_quantity(count * found.t_s, "s", 3) for count in (gains.every, gains.slowly)
    )
    return [
        (
            "axes",
            f"voltage up to {current}, then 8 steps of {held}, a row each {every}; q: shaft locked",
        ),
        (
            "shaft",
            f"{current} to {speed}, coasting; {found.shaft:.3g} s at most, a row each {slowly}",
        ),
        ("log", f"{gains.rows} rows, {20 * gains.rows} bytes"),
    ]


def _tables(found: CommissioningFit) -> list[Table]:
    return [Table(TITLE, _COLUMNS, tuple(rows_of_tests(found)))]


def _parts(_: Solution, found: CommissioningFit) -> list[ReportPart]:
    rows = tuple(Row(tuple(symbols(cell) for cell in row)) for row in rows_of_tests(found))
    return [Passage(tables=[HtmlTable(TITLE, _COLUMNS, rows)], kind="loops").of(LOOPS)]


def plain_tests(found: CommissioningFit) -> PlainData:
    """As plain data, in SI units."""
    gains = found.gains
    return {
        "current_A": gains.current,
        "omega_m_rad_per_s": gains.omega_most,
        "step_s": gains.hold * found.t_s,
        "axes_s": found.locked,
        "shaft_s": found.shaft,
        "row_s": {"axes": gains.every * found.t_s, "shaft": gains.slowly * found.t_s},
        "rows": gains.rows,
    }


# The model of the header: the step in single precision.


def gains_read(plain: Mapping[str, Any]) -> CommissioningGains:
    """Read numbers of the header back.

    Raises:
        InputError: The data are not what the header's numbers are.
    """
    try:
        found: CommissioningGains = gains_from(CommissioningGains, plain)
    except InputError as error:
        raise InputError(
            "commissioning_header is not what dqforge writes; run the design again"
        ) from error
    return found


def samples_of_tests(gains: CommissioningGains, count: int, seed: int) -> SingleArray:
    """Rows (1 + a test to start, or 0; i_d, i_q, speed), shape (rows, 4), in sequences: currents on
    both sides of what is asked and of the trip, speeds that rise and fall, and what is no number.
    """
    generator = np.random.default_rng(seed)
    sequences = max(1, count // _LENGTH)
    shape = (sequences, _LENGTH)
    rows = np.zeros((*shape, _COLUMNS_IN))
    rows[:, 0, 0] = 1.0 + np.arange(sequences) % len(CommissioningTest)
    size = gains.current * generator.choice([0.2, 0.9, 1.0, 1.2, 1.45, 1.6], (sequences, 1))
    ramp = np.linspace(0.0, 1.0, _LENGTH) ** generator.uniform(0.2, 4.0, (sequences, 1))
    angle = generator.uniform(-np.pi, np.pi, (sequences, 1))
    rows[:, :, 1], rows[:, :, 2] = size * ramp * np.cos(angle), size * ramp * np.sin(angle)
    turn = generator.uniform(0.2, 2.0, (sequences, 1)) * gains.omega_most
    rows[:, :, 3] = turn * np.sin(np.pi * ramp)
    special = [np.nan, np.inf, -np.inf, -0.0, 1e-40, 3e38]
    chosen = np.arange(sequences) % 5 == 1
    place, column = generator.integers(1, _LENGTH, sequences), generator.integers(1, 4, sequences)
    rows[chosen, place[chosen], column[chosen]] = generator.choice(special, np.sum(chosen))
    return np.ascontiguousarray(rows.reshape(-1, _COLUMNS_IN).astype(np.float32))


def answers_of_tests(numbers: CommissioningGains, inputs: SingleArray) -> SingleArray:
    """What the compiled functions must return, shape (rows, 8)."""
    gains, rows = single(numbers), inputs.reshape(-1, _LENGTH, _COLUMNS_IN)
    found = np.empty((*rows.shape[:2], len(_OUT)), dtype=np.float32)
    state = at_rest()
    with np.errstate(all="ignore"):
        start(SINGLE, gains, state, rows[:, 0, 0].astype(np.uint32) - 1)
        for k in range(_LENGTH):
            i = Dq(rows[:, k, 1].copy(), rows[:, k, 2].copy())
            step(SINGLE, gains, state, i, rows[:, k, 3].copy())
            for column, name in enumerate(_OUT):
                found[:, k, column] = getattr(state, name)
    return found.reshape(-1, len(_OUT))


# The C header, and its harness.


def commissioning_files(design: Design, found: CommissioningFit) -> dict[str, bytes]:
    """Name and bytes of the header."""
    prefix = design.export.prefix
    call = (
        f"Call {prefix}_{_NAME}_start() with a test, then {prefix}_{_NAME}_step() at every sample "
        f"until the state is DONE or FAULT. Apply u_d and u_q at an electrical angle of 0 while it "
        f"is RISE or STEPS, the reference i_q by the current control while it is ACCELERATE, and "
        f"no gate pulses otherwise; then {prefix}_{_NAME}_keep() writes the row of the sample. "
        "The log begins at its place 0, and at next once it is full; rows of coasting begin at "
        "coast. Write each test as a table for dqforge identify: i_d, i_q in A, u_d, u_q in V "
        "(references), the mechanical speed in rad/s, and a time from the samples of a row."
    )
    lines = [
        line
        for label, text in rows_of_tests(found)
        for line in wrap(f"{label[0].upper()}{label[1:]}: {text}.", 110)
    ]
    context: PlainData = {
        **title(design),
        "part": _NAME,
        "subject": "tests of the drive on its own machine",
        "preamble": [*lines, "", *wrap(call, 110)],
        "includes": ["<math.h>", "<stdbool.h>", "<stdint.h>"],
        "vectors": False,
        "body": commissioning_text(found.gains, prefix),
    }
    text = render("c_code/header.h.j2", context)
    return {f"{prefix}_{_NAME}.h": text.encode("ascii")}


def commissioning_text(gains: CommissioningGains, prefix: str) -> str:
    """Types, numbers and functions of the header."""
    macro, functions, state = prefix.upper(), Functions(), at_rest()
    reader = WordReader(prefix, functions, Block("", set()))
    test = Expression("test", kind=f"{prefix}_{_NAME}_test_t")
    reader.write(f"{_NAME}_start", start, [gains, state, test])
    said = (
        "One sample: i in A at the sampling instant, of the frame of the test; omega_m in rad/s "
        "(mechanical), 0 where the shaft does not turn."
    )
    reader.write(
        f"{_NAME}_step", step, [gains, state, vector(Dq, "i"), Expression("omega_m")], said
    )
    name = f"{prefix}_{_NAME}"
    rows = f"{macro}_{_NAME.upper()}_ROWS"
    parts = [
        [control_types(prefix, macro)],
        enumeration(CommissioningTest, TESTS, prefix),
        enumeration(CommissioningState, STATES, prefix),
        *record_structs(gains, prefix, functions.members),
        *record_structs(state, prefix),
        *([text] for text in functions.texts.values()),
        [
            f"static const {name}_gains_t {macro}_{_NAME.upper()}_GAINS = {{",
            *record_values(gains, functions.members),
            "};",
        ],
        [f"#define {rows} ({gains.rows}U) /* of the log */"],
        [
            "/* One row of the log. */",
            "typedef struct {",
            "    float i_d; /* A */",
            "    float i_q; /* A */",
            "    float u_d; /* reference, V */",
            "    float u_q; /* reference, V */",
            "    float omega_m; /* mechanical, rad/s */",
            f"}} {name}_row_t;",
        ],
        [
            "/* Writes the row of this sample where it belongs into the log; u is the reference of",
            " * the period that begins here. */",
            f"static inline void {name}_keep(const {name}_t *state,",
            f"    {name}_row_t log[{rows}], {prefix}_dq_t i, {prefix}_dq_t u, float omega_m)",
            "{",
            "    if (state->take != 0U) {",
            f"        {name}_row_t *const row = &log[state->place];",
            "        row->i_d = i.d;",
            "        row->i_q = i.q;",
            "        row->u_d = u.d;",
            "        row->u_q = u.q;",
            "        row->omega_m = omega_m;",
            "    }",
            "}",
        ],
    ]
    return "\n\n".join("\n".join(lines) for lines in parts)


def commissioning_programme(gains: CommissioningGains) -> Programme:
    """The harness of the header, with what its model answers."""
    inputs = samples_of_tests(gains, SWEEP_POINTS, SWEEP_SEED)
    return Programme(_HARNESS, inputs, answers_of_tests(gains, inputs), _NAME)


_GAINS = f"&@@_{_NAME.upper()}_GAINS"
_HARNESS = Harness(
    _NAME,
    "a test to start, i, speed; state, voltages, reference, row of the log",
    (_COLUMNS_IN, len(_OUT)),
    (
        "const @_dq_t i = { in[1], in[2] };",
        "",
        "if (in[0] > 0.0F) {",
        f"    @_{_NAME}_start({_GAINS}, &state, (@_{_NAME}_test_t)((int)in[0] - 1));",
        "}",
        f"@_{_NAME}_step({_GAINS}, &state, i, in[3]);",
        *(f"out[{k}] = (float)state.{name};" for k, name in enumerate(_OUT)),
    ),
    vectors=False,
    states=(f"@_{_NAME}_t state;",),
    starts=(f"@_{_NAME}_start({_GAINS}, &state, @@_COMMISSIONING_D_AXIS);",),
)


_HEADER: HeaderKind[CommissioningFit, CommissioningGains] = HeaderKind(
    name=_NAME,
    files=lambda solution, found: commissioning_files(solution.design, found),
    plain=lambda _, found: plain_gains_of(found.gains),
    read=lambda own, _: gains_read(own),
    programme=commissioning_programme,
    vectors=False,
)

COMMISSIONING = Capability(
    name=_NAME,
    title=TITLE.lower(),
    of=lambda outcome: outcome.solution.commissioning,
    plain=lambda _, found: plain_tests(found),
    always=False,
    summary=lambda _, found: rows_of_tests(found),
    tables=lambda _, found: _tables(found),
    parts=_parts,
    headers=(_HEADER,),
)
