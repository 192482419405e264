"""Phase currents in C, written from their step."""

from __future__ import annotations

from collections.abc import Sequence

from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Abc, Arithmetic
from dqforge.optimizer.waveforms.firmware_fit import PhaseReference, PhaseTable
from dqforge.reports.c_code.number_rows import number_rows
from dqforge.reports.c_code.numbers import comment_text, float_literal
from dqforge.reports.steps.step_reader import Block, Functions, StepReader
from dqforge.reports.steps.symbols import Expression


def waveform_text(reference: PhaseReference, lines: Sequence[str], span: str, prefix: str) -> str:
    """Constants and the function of the header.

    Args:
        reference: What is evaluated.
        lines: What is said of it behind its first sentence.
        span: The turn that a table spans, ``electrical`` or ``mechanical``.
        prefix: Before the names of functions, in capitals before those of constants.
    """
    end, form = f"{prefix.upper()}_WAVEFORM_TORQUE_MAX_NM", reference.form
    most = float_literal(float(reference.torque_max))
    parts = [f"#define {end} ({most}) /* end of the torque domain, N m */"]
    name, rows = f"{prefix}_waveform_table", list[tuple[Expression, ...]]()
    angle = ["sine", "cosine"]
    if isinstance(form, PhaseTable):
        angle, (count, width) = ["turn"], form.entries.shape
        rows = [(Expression("", whole=f"{name}[{row}]"),) for row in range(count)]
        said = (
            f"/* Phase currents over the {span} turn, A/(N m); the last entry repeats the first. */"
        )
        head = f"static const float {name}[{count}][{width}] = {{"
        parts.append("\n".join([said, head, *number_rows(form.entries, 8), "};"]))

    def phase_currents(o: Arithmetic, torque: Reals, *turned: Reals) -> Abc:
        return reference.step(o, torque, turned, Expression(end), rows)

    functions = Functions()
    StepReader(prefix, functions, Block("", set())).write(
        "phase_currents",
        phase_currents,
        [Expression("number")] * (1 + len(angle)),
        into=["i_a_A", "i_b_A", "i_c_A"],
        names=["torque_Nm", *angle],
    )
    said_lines = (f" * {comment_text(line)}".rstrip() for line in lines)
    comment = ["/* Phase currents for a torque and an electrical angle.", " *", *said_lines, " */"]
    return "\n\n".join([*parts, "\n".join([*comment, *functions.texts.values()])])
