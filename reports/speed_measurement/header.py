"""The C header of a measured speed, and its harness."""

from __future__ import annotations

from textwrap import wrap
from typing import TYPE_CHECKING

from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.pages.templating import render
from dqforge.reports.speed_measurement.float32_model import (
    EVENTS,
    SAMPLE,
    START,
    EdgeNumbers,
    edge_events,
    edge_numbers,
    edge_rows,
)
from dqforge.reports.speed_measurement.tables import measured_rows

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.measured_speed_loop import MeasuredSpeed
    from dqforge.reports.plain_data import PlainData


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
        "preamble": lines,
        "method": numbers.method,
        "scale": numbers.scale,
        "mask": numbers.mask,
        "patience": numbers.patience,
        "codes": numbers.codes,
        "base": f"{design.control.bases.speed:.6g}",
    }
    text = render("speed_measurement/speed_measurement.h.j2", context)
    return {f"{prefix}_speed_measurement.h": text.encode("ascii")}


def measurement_programme(numbers: EdgeNumbers) -> Programme:
    """The harness of the header, with what its model answers."""
    events = edge_events(numbers, EVENTS, SWEEP_SEED)
    context = {
        "method": numbers.method,
        "widths": [width for width, _ in numbers.codes],
        "sample": SAMPLE,
        "start": START,
    }
    return Programme(
        "speed_measurement/harness.c.j2",
        events,
        edge_rows(numbers, events),
        context,
        name="speed measurement",
    )
