"""Figure of the page on references that move: field weakening by voltage feedback where the map is
wrong.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import (
    ReferenceSettings,
    VoltageFeedbackSettings,
    WeakeningSettings,
)
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, constant
from dqforge.optimizer.solution import solve
from dqforge.reports.control.header import gain_bytes, plain_control
from dqforge.reports.pages.figures_style import BLUE, INK, ORANGE, new_figure, save, style
from dqforge.reports.simulation.design_run import controller_files, drive_of
from dqforge.reports.simulation.recorded_run import simulate, simulator

_RPM = math.pi / 30.0
_MOST = 2400.0 * _RPM


@style()
def voltage_feedback(path: Path) -> None:
    """Torque and d current of the IPM of 2.2 kW at 2000 rpm with a magnet 8 % too strong."""
    base = catalogue.load("abb-ipmsm-2k2")
    feedback = VoltageFeedbackSettings(bandwidth=2.0 * math.pi * 20.0, current=3.0)
    control = replace(
        base.control, observer=None, references=ReferenceSettings(voltage_feedback=feedback)
    )
    design = replace(
        base,
        machine=replace(base.machine, omega_m_max=_MOST),
        control=control,
        weakening=WeakeningSettings(omega_m=_MOST),
        losses=None,
    )
    solution = solve(design)
    speed = 2000.0 * _RPM
    scenario = Scenario(
        0.6,
        "torque",
        Profile((0.0, 0.05, 0.3), (0.0, 4.0, -4.0)),
        shaft=constant(speed),
        omega_m=speed,
        errors=PlantErrors(psi_pm=0.08),
        dead_time=0.0,
    )
    plain = plain_control(solution)
    without = gain_bytes({**plain, "references": {**plain["references"], "feedback": 0.0}})
    figure = new_figure(
        "voltage-feedback", 3.8, "Torque and d current with and without feedback", arranged=True
    )
    torque, current = figure.subplots(2, 1, sharex=True)
    with simulator(controller_files(solution), design.export.prefix) as program:
        for gains, colour, label in (
            (without, ORANGE, "map alone"),
            (b"", BLUE, "with voltage feedback"),
        ):
            run = simulate(program, drive_of(design), scenario, gains=gains)
            torque.plot(run.t, run.torque, color=colour, linewidth=1.2, label=label)
            current.plot(run.t, run.i_d, color=colour, linewidth=1.2)
            dashes = (0, (3.0, 2.0))
            current.plot(run.t, run.i_d_reference, color=colour, linewidth=0.8, linestyle=dashes)
        torque.plot(run.t, run.reference, color=INK, linewidth=0.8, label="requested")
    torque.set_ylabel("Torque in N m")
    torque.legend()
    current.set(xlabel="Time in s", ylabel="$i_d$ in A", xlim=(0.0, 0.6))
    save(figure, path)
