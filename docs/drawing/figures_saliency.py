"""Figure of the page on the saliency: a drive from standstill on injection, and the saliency along
the load.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.optimizer.saliency.injection import along_locus
from dqforge.reports.pages.figures_style import new_figure, save, style
from dqforge.reports.simulation.design_run import simulate_design

_DRIVES = ("abb-ipmsm-2k2", "baldor-pmsyrm-5k6", "thor-pmsyrm-5k", "abb-syrm-6k7-saturated")
_RUN = (
    "simulation={duration: 1.2 s, sensorless: {above: 0 rpm, below: 0 rpm}, speed: {shape: linear, "
    "points: [{time: 0 s, speed: 0 rpm}, {time: 0.2 s, speed: 0 rpm}, {time: 0.6 s, speed: 60 rpm}"
    "]}, load: {points: [{time: 0 s, torque: 5 N m}, {time: 0.8 s, torque: 15 N m}]}}"
)


@style()
def saliency(path: Path) -> None:
    """Speed and angle error of baldor-pmsyrm-5k6 from standstill; ratio and axis along the load."""
    figure = new_figure(
        "saliency", 4.8, "A start on the saliency; ratio and axis along the load", arranged=True
    )
    upper, lower = figure.subplots(2, 2)
    settings = ["control.speed_loop.spread=17", "export.control=float32", _RUN]
    for wave in ("square", "sine"):
        keys = f"control.observer={{method: injection, wave: {wave}}}"
        found = simulate_design(catalogue.load("baldor-pmsyrm-5k6", [keys, *settings]))
        run = found.run
        upper[0].plot(run.t, run.omega_m * 30.0 / np.pi, label=wave, linewidth=0.9)
        upper[1].plot(run.t, np.degrees(found.angle_error), label=wave, linewidth=0.6)
    upper[0].set(xlabel="Time in s", ylabel="Speed in rpm", title="From standstill, 5 and 15 N m")
    upper[1].set(xlabel="Time in s", ylabel="Angle error in deg", title="Electrical angle")
    for name in _DRIVES:
        loaded = along_locus(catalogue.load(name), 33)
        share = loaded.torque / loaded.torque[-1]
        lower[0].plot(share, loaded.ratio, label=name)
        lower[1].plot(share, np.degrees(loaded.axis), label=name)
    lower[0].set(
        xlabel="Torque over the largest",
        ylabel="Ratio",
        title="Incremental inductances",
        ylim=(0.0, 9.5),
    )
    lower[1].set(
        xlabel="Torque over the largest", ylabel="Angle in deg", title="Axis of the saliency off d"
    )
    for axes in (upper[0], lower[0]):
        axes.legend()
    save(figure, path)
