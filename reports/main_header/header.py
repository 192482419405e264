"""The main header and its test vectors: from a solution to text,
through plain data only (docs/reference/header.md).
"""

from __future__ import annotations

from typing import Any

from dqforge.machines.design.design import Design
from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.title import title
from dqforge.reports.current_reference.evaluator import (
    reference_context,
    vectors_context,
    vectors_template,
)
from dqforge.reports.current_reference.plain import to_plain
from dqforge.reports.main_header.dialect import Dialect, entries_of, names_of
from dqforge.reports.main_header.dialects.neutral.names import NEUTRAL
from dqforge.reports.main_header.groups import constant_groups
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData

_COMPILING = {
    "float32": (
        (
            "Compile with -ffp-contract=off to equal the test vectors bit for bit; the stated "
            "errors hold either way."
        ),
        "Plain C99 and C++11; fabsf and sqrtf are the only library functions that may be used.",
    ),
    "fixed": (
        (
            "Plain C99 and C++11 in integers, no library function; right shifts must keep the sign "
            "(checked below)."
        ),
        "No overflow for any torque: proven by interval analysis of every product, sum and result.",
    ),
}


def _drive_text(design: Design) -> str:
    return (
        f"{design.machine.pole_pairs} pole pairs, {design.inverter.v_dc:.6g} V dc link, "
        f"{design.i_max:.6g} A (peak), control sampled every {design.control.t_s * 1e6:.6g} us."
    )


def header_context(solution: Solution, dialect: Dialect = NEUTRAL) -> PlainData:
    """Everything that the header prints, as plain data.

    The `reference` entry alone rebuilds the evaluator's float32 model (`from_plain`).
    """
    design = solution.design
    plain, groups = to_plain(solution.reference), constant_groups(solution)
    return {
        **title(design),
        "preamble": [
            _drive_text(design),
            "Units stand in the names and comments; angles in rad, dq quantities as peak of phase.",
            *_COMPILING["float32" if plain["format"] == "float32" else "fixed"],
            *(line for evidence in design.flux_evidence for line in evidence.short()),
        ],
        "groups": entries_of(dialect, groups),
        "names": names_of(dialect, groups),
        "reference": reference_context(solution, plain),
    }


def header_files(solution: Solution, dialect: Dialect = NEUTRAL) -> dict[str, bytes]:
    """Names and bytes of the emitted C files: the header and its test vectors.

    Args:
        solution: What was solved.
        dialect: Whose names the header takes.
    """
    prefix = solution.design.export.prefix
    contents: dict[str, Any] = {
        f"{prefix}.h": render(dialect.template, header_context(solution, dialect)),
        f"{prefix}_vectors.h": render(
            vectors_template(solution.reference), vectors_context(solution)
        ),
    }
    return {name: text.encode("ascii") for name, text in contents.items()}
