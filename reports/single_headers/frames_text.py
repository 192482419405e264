"""The frames dqx and dqy in C, written from their steps."""

from __future__ import annotations

from dataclasses import make_dataclass
from typing import Any

from dqforge.machines.transforms import Reals
from dqforge.optimizer.frame_tables import Frames, FrameTable, decoupling
from dqforge.optimizer.steps.step_arithmetic import Arithmetic
from dqforge.reports.c_code.number_rows import number_rows
from dqforge.reports.c_code.numbers import float_literal
from dqforge.reports.steps.record_text import vector_struct
from dqforge.reports.steps.step_reader import Block, Functions, StepReader
from dqforge.reports.steps.symbols import Expression

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
