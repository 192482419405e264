"""Figure of the page on the measured speed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import CurrentLoopSettings, SpeedMeasurementSettings
from dqforge.machines.names import SpeedMeasurementName
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.reports.pages.figures_style import new_figure, save, style

_LABELS = {"counts": "counts", "capture": "capture", "mixed": "mixed"}


@style()
def delay_and_margin(path: Path) -> None:
    """Delay of the three methods over the speed, and the phase margin of the speed loop."""
    design = catalogue.load("paper001-pmsm-bench")
    loop = design.control.speed_loop
    assert loop is not None
    figure = new_figure(
        "speed-measurement", 2.9, "Delay and phase margin over the speed", arranged=True
    )
    left, right = figure.subplots(1, 2, sharex=True)
    for method in get_args(SpeedMeasurementName):
        edges, clock = (4, 0.0) if method == "counts" else (1, 1.0 / 33.9e-9)
        own = SpeedMeasurementSettings(method, 1024, clock, 16, edges, 52.0)
        settings = replace(loop, method="symmetrical-optimum", kp=None, ki=None, measurement=own)
        control = replace(
            design.control,
            current_loop=CurrentLoopSettings(),
            speed_loop=settings,
            observer=None,
        )
        found = solve_gains(replace(design, control=control)).measured_speed
        assert found is not None
        rpm = found.omega_m * 30.0 / np.pi
        left.loglog(rpm, 1e3 * found.delay, marker="o", markersize=3.5, label=_LABELS[method])
        right.semilogx(rpm, np.degrees(found.phase_margin), marker="o", markersize=3.5)
    left.set(xlabel="Speed in rpm", ylabel="Mean delay in ms")
    right.set(xlabel="Speed in rpm", ylabel="Phase margin in deg")
    left.legend()
    save(figure, path)
