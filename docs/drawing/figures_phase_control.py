"""Figure of the page on control over the angle: the torque of four controllers in one machine."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.names import CurrentFrame, Feedforward
from dqforge.machines.plants.scenario import Scenario, constant
from dqforge.reports.pages.figures_style import BLUE, MUTED, ORANGE, TEAL, new_figure, save, style
from dqforge.reports.simulation.design_run import simulate_design

_WAYS: tuple[tuple[str, CurrentFrame, Feedforward, bool], ...] = (
    ("dq, references fed forward", "dq", "references", True),
    ("dqy, nothing fed forward", "dqy", "none", False),
    ("dqy, back-EMF fed forward", "dqy", "emf", False),
    ("table, references fed forward, harmonic integrators", "table", "references", True),
)

_COLOURS = (MUTED, ORANGE, TEAL, BLUE)


def controlled(design: Design, frame: CurrentFrame, fed: Feedforward, *, harmonics: bool) -> Design:
    """The design with another current controller."""
    loop = replace(
        design.control.current_loop, frame=frame, feedforward=fed, harmonic_integrators=harmonics
    )
    return replace(design, control=replace(design.control, current_loop=loop))


def torque_over_angle(path: Path) -> None:
    """Torque of paper 002's machine at 1 N m and 750 rpm, mean of each PWM period, switched with
    1 us of dead time, under four current controllers.
    """
    design = catalogue.load("paper002-phase-waveforms")
    speed = 750.0 * np.pi / 30.0
    scenario = Scenario(
        0.6, "torque", constant(1.0), shaft=constant(speed), omega_m=speed, inverter="switched"
    )
    with style():
        figure = new_figure("phase-control", 3.6, "Torque with four current controllers")
        axes = figure.add_axes((0.1, 0.13, 0.86, 0.68))
        for (label, frame, fed, harmonics), colour in zip(_WAYS, _COLOURS, strict=True):
            made = controlled(design, frame, fed, harmonics=harmonics)
            run = simulate_design(replace(made, simulation=scenario)).run
            assert run.phases is not None
            last = slice(run.t.size - 400, run.t.size)  # one electrical period
            order = np.argsort(run.theta_e[last])
            axes.plot(
                np.degrees(run.theta_e[last])[order],
                run.phases.torque_mean[last][order],
                color=colour,
                label=label,
            )
        axes.set(xlabel="Electrical angle in deg", ylabel="Torque in N m", xlim=(-180.0, 180.0))
        axes.set_xticks(range(-180, 181, 60))
        axes.legend(frameon=False, loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.22))
    save(figure, path)
