"""The C header of a tracker of the position, its plain data, and the run that proves it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from textwrap import wrap as folded
from typing import TYPE_CHECKING, Any

from dqforge.machines.errors import InputError
from dqforge.optimizer.estimators.registry import TRACKERS
from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.observers.float32_model import gains_from, plain_gains_of
from dqforge.reports.observers.tracker_float32_model import (
    EmittedTracker,
    tracker_inputs,
    tracker_outputs,
)
from dqforge.reports.observers.tracker_text import (
    added_text,
    heard_text,
    speed_text,
    tuned_text,
)
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.estimators.solve import TunedTracker
    from dqforge.reports.plain_data import PlainData

_FAULT = InputError("observer_header is not what dqforge writes; run the design again")


def plain_tracker_gains(found: EmittedTracker) -> PlainData:
    """Method and gains as plain data; every number is a float32 value."""
    return {"method": found.tracker.name, "gains": plain_gains_of(found.gains)}


def tracker_from(plain: Mapping[str, Any]) -> EmittedTracker:
    """Read a tracker back.

    Raises:
        InputError: The data are not what `plain_tracker_gains` makes.
    """
    tracker = TRACKERS.get(str(plain.get("method")))
    if tracker is None or not isinstance(plain.get("gains"), dict):
        raise _FAULT
    return EmittedTracker(tracker, gains_from(tracker.gains, plain["gains"]))


def _preamble(design: Design, found: TunedTracker) -> list[str]:
    tracker, prefix = found.tracker, design.export.prefix
    call = (
        f"Call {prefix}_{tracker.code}_start() once and {prefix}_{tracker.code}_step() at every "
        f"sample with the voltage that acted over the period that ends there{heard_text(found)}. "
        "Compile with -ffp-contract=off to equal the model bit for bit."
    )
    return [
        f"Method: {tracker.title}, sampled every {found.t_s * 1e6:.6g} us.",
        *folded(f"Tuning: {tuned_text(found)}.", 110),
        *folded(f"Range: {speed_text(found)}.", 110),
        "",
        *folded(call, 110),
        *folded(added_text(found, prefix), 110),
    ]


def tracker_files(design: Design, found: TunedTracker, file: str = "observer") -> dict[str, bytes]:
    """Name and bytes of the header ``<prefix>_<file>.h`` of a tracker."""
    prefix = design.export.prefix
    context: PlainData = {
        **title(design),
        "preamble": _preamble(design, found),
        "file": file,
        "kind": "position",
        "code": found.tracker.code,
        "gains": asdict(found.gains),
    }
    return {f"{prefix}_{file}.h": render("observers/observer.h.j2", context).encode("ascii")}


def tracker_programme(found: EmittedTracker) -> Programme:
    """The harness of a tracker, with what its model answers."""
    inputs = tracker_inputs(found, SWEEP_POINTS, SWEEP_SEED)
    tracker = found.tracker
    return Programme(
        "observers/tracker_harness.c.j2",
        inputs,
        tracker_outputs(found, inputs),
        {"code": tracker.code, "further": len(tracker.hears), "injects": tracker.injects},
        name="position tracker",
    )
