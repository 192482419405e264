"""Tables of the frames dqx and dqy: as C, plain data, tables and words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, make_dataclass
from typing import Any

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray
from dqforge.optimizer.frame_tables import (
    COLUMNS,
    DENSE,
    FrameCandidate,
    Frames,
    FrameTable,
    FrameTables,
    decoupling,
)
from dqforge.optimizer.steps.step_arithmetic import Arithmetic
from dqforge.reports.c_code.harness import (
    SWEEP_POINTS,
    SWEEP_SEED,
    Harness,
    HeaderKind,
    Programme,
    singles_from,
    title,
)
from dqforge.reports.c_code.numbers import float_literal, number_rows, rounded_up
from dqforge.reports.capability import Capability, Passage, Quantity
from dqforge.reports.pages.answer import Table
from dqforge.reports.pages.html_text import HtmlTable, Row, ceiling, share
from dqforge.reports.pages.templating import WAVEFORMS as CHAPTER
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest
from dqforge.reports.steps.blocks import Block, Functions
from dqforge.reports.steps.record_text import vector_struct
from dqforge.reports.steps.step_reader import StepReader
from dqforge.reports.steps.symbols import Expression

_MOST_ROWS = 1 << 17
_INPUTS = 5  # Turn, electrical speed, and currents of dqy.


@dataclass(frozen=True, slots=True, eq=False)
class FrameModel:
    """The header in numpy: its table."""

    table: FrameTable

    def evaluate(self, inputs: SingleArray) -> SingleArray:
        """Quantities of `COLUMNS`, and decoupling voltages of dqy in V, shape (M, 21).

        ``inputs`` are the turn, the electrical speed in rad/s and the currents d, q, 0 of dqy in A,
        shape (M, 5).
        """
        turn, omega, i_d, i_q, i_0 = inputs.T
        with np.errstate(invalid="ignore", over="ignore", under="ignore"):
            found = self.table.step(SINGLE, np.ascontiguousarray(turn), self.table.entries)
            volts = decoupling(SINGLE, found, omega, i_d, i_q, i_0)
        return np.ascontiguousarray(np.stack([*found, *volts]).T, dtype=np.float32)


def plain_frame_model(table: FrameTable) -> PlainData:
    """The table as plain data; every number is a float32 value."""
    return {
        "parts": table.parts,
        "columns": list(COLUMNS),
        "table": [[shortest(value) for value in row] for row in table.entries],
    }


def frame_model_from(plain: Mapping[str, Any]) -> FrameModel:
    """Read a table back.

    Raises:
        InputError: The data are not what `plain_frame_model` makes.
    """
    fault = InputError("frames_header is not what dqforge writes; run the design again")
    try:
        rows, parts = plain["table"], plain["parts"]
        known = list(plain["columns"]) == list(COLUMNS) and parts in (1, 3)
        if not known or not 2 < len(rows) <= _MOST_ROWS:
            raise fault
        entries = np.stack([singles_from(row, len(COLUMNS)) for row in rows])
        if entries.shape[1] != len(COLUMNS):
            raise fault
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise fault from error
    return FrameModel(FrameTable(entries, int(parts)))


def frame_inputs(count: int, seed: int) -> SingleArray:
    """Inputs of the functions, special turns first, shape (count, 5)."""
    generator = np.random.default_rng(seed)
    inputs = generator.uniform(-1.0, 1.0, (count, _INPUTS)) * [1.0, 2000.0, 20.0, 20.0, 20.0]
    inputs[:, 0] = generator.uniform(0.0, 1.0, count)
    below_one = float(np.nextafter(np.float32(1.0), np.float32(0.0)))
    special = [0.0, -0.0, below_one, 1.0, -0.25, np.nan, 1e30, 1.0 / 3.0, 2.0 / 3.0, 0.5, 1e-40]
    inputs[: len(special), 0] = special
    return np.ascontiguousarray(inputs, dtype=np.float32)


def model_results(model: FrameModel, count: int = SWEEP_POINTS) -> tuple[SingleArray, SingleArray]:
    """Inputs and what the compiled functions must return."""
    inputs = frame_inputs(count, SWEEP_SEED)
    return inputs, model.evaluate(inputs)


# What is said of frame tables: summary, terminal, report, plain data.

_COLUMNS = ("intervals", "bytes", "torque dqx %", "torque dqy %", "coupling %", "back-EMF %")


def _candidates(found: FrameTables) -> tuple[FrameCandidate, ...]:
    """The emitted one first."""
    return (found.chosen, *reversed(found.coarser))


def _shares(entry: FrameCandidate) -> tuple[float, ...]:
    errors = entry.errors
    return (errors.torque_x, errors.torque_y, errors.coupling, errors.emf)


def _size(entry: FrameCandidate) -> tuple[str, str]:
    return f"{entry.table.size * entry.table.parts}", f"{entry.table.flash}"


def frame_rows(found: FrameTables) -> list[tuple[str, str]]:
    """The summary of a run."""
    intervals, flash = _size(found.chosen)
    worst = 100.0 * found.chosen.errors.torque
    return [("frame tables", f"{intervals} intervals, {flash} B, torque within {worst:.2g} %")]


def frame_table(found: FrameTables) -> Table:
    """Sizes with their largest errors, the emitted one first."""
    rows = tuple(
        (*_size(entry), *(f"{100.0 * value:.2g}" for value in _shares(entry)))
        for entry in _candidates(found)
    )
    return Table("Frame tables dqx and dqy: largest errors found", _COLUMNS, rows)


def frame_passage(found: FrameTables, prefix: str) -> Passage:
    """The part of the report."""
    rows = tuple(
        Row(
            (*_size(entry), *(share(ceiling(value), 3) for value in _shares(entry))),
            "chosen" if entry is found.chosen else "muted",
        )
        for entry in _candidates(found)
    )
    columns = tuple(name.removesuffix(" %") for name in _COLUMNS)
    text = (
        f"{prefix}_frames.h holds factors, angles, their derivatives and the coupling of dqy over "
        "the angle, for those who implement the frames of paper 002 themselves."
    )
    table = HtmlTable("Tables by size, the emitted one first: largest errors", columns, rows)
    return Passage(title="Frames dqx and dqy", text=[text], tables=[table])


def plain_frames(found: FrameTables) -> PlainData:
    """Sizes and errors as fractions."""
    return {
        "phi_m_Wb": found.scale,
        "turns": found.turns,
        "tolerance": found.tolerance,
        "candidates": [
            {
                "intervals": entry.table.size * entry.table.parts,
                "constants_B": entry.table.flash,
                "errors": asdict(entry.errors),
            }
            for entry in _candidates(found)
        ],
    }


# The C header of the frames dqx and dqy, as text.


def _error_lines(found: FrameTables) -> list[str]:
    table, errors = found.chosen.table, found.chosen.errors
    torque_x, torque_y, coupling, emf = (
        rounded_up(100.0 * value)
        for value in (errors.torque_x, errors.torque_y, errors.coupling, errors.emf)
    )
    held = f"{table.size * table.parts} intervals of the turn, {table.size} of which are held"
    rates = rounded_up(errors.rates)
    return [
        f"{held}; {table.flash} bytes.",
        f"The torque of constant currents in dqx errs by up to {torque_x} %, in dqy {torque_y} %,",
        f"coupling terms by {coupling} % of the largest, the back-EMF by {emf} % of its largest,",
        f"speeds of the frames and a'/a by {rates} ({2 * DENSE} evaluations of each electrical",
        "period, with and without fused multiply-add; sampled, not proven).",
    ]


_PREAMBLE = [
    (
        "C. C. Lemes Filho, UFG 2025 (paper 002), chapters 2 to 4, with its misprints corrected. "
        "Power-invariant: the"
    ),
    (
        "matrices are orthogonal, currents and voltages of dqx are divided by a_x, those of dqy by "
        "a_y. The back-EMF is"
    ),
    (
        "omega_e phi_m F(theta); 1 N m takes i_qy = 1 / (pole pairs * phi_m * sqrt(3/2)), and "
        "i_dy = i_0y = 0."
    ),
    "",
]


# The frames where a function takes them by their address.
_BY_ADDRESS: Any = make_dataclass("Frames", [(n, float) for n in Frames._fields], frozen=True)
_NUMBER: Any = 0.0


def frames_text(table: FrameTable, scale: float, span: str, prefix: str) -> str:
    """Constants, types and functions of the header.

    Args:
        table: What is read.
        scale: Largest back-EMF of a phase over the electrical speed, in Wb.
        span: The turn that the angle is of, ``electrical`` or ``mechanical``.
        prefix: Before the names of functions, in capitals before those of constants.
    """
    functions, count, width = Functions(), table.size + 1, len(Frames._fields)
    reader, number = StepReader(prefix, functions, Block("", set())), Expression("number")
    rows = [Expression("", whole=f"{prefix}_frames_table")]

    def frames(o: Arithmetic, turn: Reals) -> Frames:
        return table.step(o, turn, rows)

    said = (
        f"The frames by linear interpolation. turn: {span} angle of the d axis from phase a over "
        "2 pi, 0 to below 1; others count as 0."
    )
    reader.write("frames", frames, [number], said)
    record = _BY_ADDRESS(*[_NUMBER] * width)
    reader.write("decoupling", decoupling, [record, *[number] * 4], into=["v_d", "v_q", "v_0"])
    phi_m, macro = float_literal(scale), prefix.upper()
    what = "largest back-EMF of a phase over the electrical speed"
    part = " of a third of the turn, with which all of it repeats" if table.parts == 3 else ""
    held = part or " of the turn"
    parts = [
        f"#define {macro}_FRAMES_PHI_M_WB ({phi_m}) /* {what} */",
        "\n".join(vector_struct(Frames, prefix)),
        "\n".join(
            [
                f"/* {table.size} intervals{held}; the last row repeats the first. */",
                f"static const float {prefix}_frames_table[{count}][{width}] = {{",
                *number_rows(table.entries, 9),
                "};",
            ]
        ),
        *functions.texts.values(),
    ]
    return "\n\n".join(parts)


def frame_files(design: Design, found: FrameTables) -> dict[str, bytes]:
    """Name and bytes of the header."""
    span, prefix = "electrical" if found.turns == 1 else "mechanical", design.export.prefix
    compiling = "Compile with -ffp-contract=off to equal the model bit for bit; the stated errors"
    context = {
        "part": "frames",
        "subject": "frames dqx and dqy",
        "preamble": [*_PREAMBLE, *_error_lines(found), f"{compiling} hold either way."],
        "includes": [],
        "body": frames_text(found.chosen.table, found.scale, span, prefix),
        "vectors": False,
    }
    text = render("c_code/header.h.j2", title(design) | context)
    return {f"{prefix}_frames.h": text.encode("ascii")}


def frame_programme(model: FrameModel) -> Programme:
    """The harness of the frames, with what their model answers."""
    inputs, results = model_results(model)
    count = len(COLUMNS)
    voltages = ", ".join(f"&out[{k}]" for k in range(count, count + 3))
    rows = Harness(
        "frames",
        "angle, currents and speed; frames and decoupling voltages",
        (5, count + 3),
        (
            "const @_frames_t frames = @_frames(in[0]);",
            "",
            *(f"out[{k}] = frames.{name};" for k, name in enumerate(COLUMNS)),
            f"@_decoupling(&frames, in[1], in[2], in[3], in[4], {voltages});",
        ),
        vectors=False,
    )
    return Programme(rows, inputs, results, "frames")


# Tables of the frames dqx and dqy, as a record.

_HEADER: HeaderKind[FrameTables, FrameModel] = HeaderKind(
    name="frames",
    files=lambda solution, found: frame_files(solution.design, found),
    plain=lambda _, found: plain_frame_model(found.chosen.table),
    read=lambda own, _: frame_model_from(own),
    programme=frame_programme,
    vectors=False,
)

FRAME_TABLES = Capability(
    name="frame_tables",
    title="frames dqx and dqy in the firmware",
    of=lambda outcome: outcome.solution.frame_tables,
    plain=lambda _, found: plain_frames(found),
    always=False,
    summary=lambda _, found: frame_rows(found),
    tables=lambda _, found: [frame_table(found)],
    parts=lambda solution, found: [
        frame_passage(found, solution.design.export.prefix).of(CHAPTER),
    ],
    headers=(_HEADER,),
    quantities=(Quantity("phase currents", "phi_m", "Wb", ("frame_tables", "phi_m_Wb")),),
)
