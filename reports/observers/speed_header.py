"""The C header of the reduced-order speed observer (docs/methods/speed-observer.md)."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from dqforge.reports.c_code.harness import Programme
from dqforge.reports.c_code.header_kind import SWEEP_POINTS, SWEEP_SEED
from dqforge.reports.c_code.title import title
from dqforge.reports.observers.speed_float32_model import (
    ReducedOrderGains,
    speed_observer_gains,
    speed_observer_inputs,
    speed_observer_outputs,
)
from dqforge.reports.pages.templating import render

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.reports.plain_data import PlainData

REDUCED_ORDER = "reduced_order"  # Part of the names of its C functions.


def speed_observer_files(design: Design, observer: ReducedOrderObserver) -> dict[str, bytes]:
    """Name and bytes of the header."""
    prefix = design.export.prefix
    context: PlainData = {
        **title(design),
        "file": "speed_observer",
        "kind": "speed",
        "preamble": [
            (
                f"Method: reduced-order observer, gain {observer.g:.6g} rad/s, sampled every "
                f"{observer.t_s * 1e6:.6g} us."
            ),
            (
                "It needs the angle, from an encoder or an observer of the position; it knows "
                "nothing of the load torque."
            ),
            "",
            (
                f"Call {prefix}_{REDUCED_ORDER}_start() once and {prefix}_{REDUCED_ORDER}_step() "
                "at every sample with the"
            ),
            "voltage that acted over the period that ends there.",
            "Compile with -ffp-contract=off to equal the model bit for bit.",
        ],
        "code": REDUCED_ORDER,
        "gains": asdict(speed_observer_gains(design.machine, observer)),
    }
    return {
        f"{prefix}_speed_observer.h": render("observers/observer.h.j2", context).encode("ascii")
    }


def speed_observer_programme(gains: ReducedOrderGains) -> Programme:
    """The harness of a speed observer, with what its model answers."""
    inputs = speed_observer_inputs(gains, SWEEP_POINTS, SWEEP_SEED)
    outputs = speed_observer_outputs(gains, inputs)
    return Programme(
        "observers/speed_observer_harness.c.j2", inputs, outputs, name="speed observer"
    )
