"""Figure of the page on the program around the functions."""

from __future__ import annotations

import re
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.reports.pages.figures_style import BLUE, INK, TEAL, new_figure, save, style
from dqforge.reports.simulation.design_run import simulate_design

_STATES = ("OFFSETS", "READY", "ALIGN", "RUN", "STOP", "FAULT")


_LOOP = (
    "control.speed_loop={method: symmetrical-optimum, ratio: 10, measurement: {method: mixed, "
    "lines: 1024, clock: 10 MHz}}"
)


_RUN = (
    "simulation={duration: 2.4 s, speed: {points: [{time: 0 s, speed: 1200 rpm}]}, stop: 1.6 s, "
    "current_sensor: {offset: [100 mA, -50 mA, 20 mA]}, initial: {angle: 100 deg}}"
)


_SETTINGS = (
    _LOOP,
    "control.current_loop={method: magnitude-optimum}",
    "export.control=float32",
    "export.application=skeleton",
    _RUN,
)


@style()
def from_power_up_to_stop(path: Path) -> None:
    """States, speed and the measured current of phase a over time."""
    text = catalogue.read_text("paper001-pmsm-bench").decode()
    text = re.sub(r"  observer:\n    pole:[^\n]*\n", "", text)
    run = simulate_design(load_text(text.encode(), "bench.yaml", settings=_SETTINGS)).run
    assert run.application is not None
    figure = new_figure(
        "application", 5.0, "States, speed and measured current of phase a over time", arranged=True
    )
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    top.step(run.t, run.application.application_state, where="post", color=INK)
    top.set(ylabel="State", yticks=range(len(_STATES)), yticklabels=_STATES)
    middle.plot(run.t, run.omega_m * 9.549296585513721, color=TEAL)
    middle.set(ylabel="Speed in rpm")
    bottom.plot(run.t, run.i_measured[:, 0], color=BLUE, linewidth=0.5)
    bottom.set(xlabel="Time in s", ylabel="$i_a$ measured in A")
    save(figure, path)
