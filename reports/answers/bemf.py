"""What `dqforge bemf` answers: what a capture of the back-EMF holds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from dqforge.reports.back_emf import CaptureRequest, capture_tables, plain_capture, read_capture
from dqforge.reports.pages.answer import Answer, shares, stage

if TYPE_CHECKING:
    from matplotlib.figure import Figure


__all__ = ["CaptureRequest", "answer_bemf"]


def answer_bemf(paths: Sequence[Path], request: CaptureRequest) -> Answer:
    """Read and analyse a capture; raises as `read_capture`."""
    stage("reading the capture")
    reading = read_capture(paths, request, shares())

    def figure() -> Figure:
        from dqforge.reports.back_emf import plot_capture

        return plot_capture(reading)

    return Answer(reading.name, capture_tables(reading), {"bemf": plain_capture(reading)}, figure)
