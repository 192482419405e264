"""The C header of the frames dqx and dqy, as text."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.optimizer.frame_tables.exact_frames import COLUMNS, DENSE
from dqforge.optimizer.frame_tables.fit import FrameTables
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.numbers import rounded_up
from dqforge.reports.c_code.title import title
from dqforge.reports.frame_tables.float32_model import FrameModel, model_results
from dqforge.reports.pages.templating import render
from dqforge.reports.plain_data import PlainData, shortest

# What the members of the structure are, in the order of `COLUMNS`.
MEANINGS = {
    "a_x": "sqrt(3/2) over the length of the alpha-beta vector of the shape: dqx is divided by it",
    "a_y": "sqrt(3/2) over the length of its alpha-beta-0 vector: dqy is divided by it",
    "theta_x": "angle from dq to dqx, rad",
    "theta_y": "angle from dqx to dqy, rad",
    "turn_x": "1 + d theta_x / d theta: speed of dqx over the electrical speed",
    "rate_y": "d theta_y / d theta",
    "growth_x": "(d a_x / d theta) / a_x, 1/rad",
    "growth_y": "(d a_y / d theta) / a_y, 1/rad",
    "emf": "back-EMF of the q axis of dqy over the electrical speed, Wb",
    **{
        f"c_{row}{column}": f"coupling of the {row} axis with the current of the {column} axis, H"
        for row in "dq0"
        for column in "dq0"
    },
}


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


def _context(design: Design, found: FrameTables) -> PlainData:
    table, span = found.chosen.table, "electrical" if found.turns == 1 else "mechanical"
    return {
        **title(design),
        "span": span,
        "members": [{"name": name, "meaning": MEANINGS[name]} for name in COLUMNS],
        "rows": [[shortest(value) for value in row] for row in table.entries],
        "size": table.size,
        "parts": table.parts,
        "phi_m": shortest(np.float32(found.scale)),
        "lines": _error_lines(found),
    }


def frame_files(design: Design, found: FrameTables) -> dict[str, bytes]:
    """Name and bytes of the header."""
    text = render("frame_tables/frames.h.j2", _context(design, found))
    return {f"{design.export.prefix}_frames.h": text.encode("ascii")}


def frame_programme(model: FrameModel) -> Programme:
    """The harness of the frames, with what their model answers."""
    inputs, results = model_results(model)
    context = {"members": list(COLUMNS)}
    return Programme("frame_tables/harness.c.j2", inputs, results, context, name="frames")
