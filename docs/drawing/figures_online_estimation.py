"""Figure of the page on the on-line estimation."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import OnlineEstimationSettings
from dqforge.machines.plants.scenario import CurrentSensor, Drift, Encoder, Profile, Scenario
from dqforge.reports.pages.figures_style import new_figure, save, style
from dqforge.reports.simulation.design_run import simulate_design

_TIMES = (0.0, 10.0, 20.0, 30.0)
_SLOW, _FAST = (rpm * math.pi / 30.0 for rpm in (300.0, 4500.0))


@style()
def warm_windings(path: Path) -> None:
    """A winding that warms up and magnets that lose flux, as the emitted step follows them."""
    design = catalogue.load("paper001-pmsm-bench")
    control = replace(design.control, online_estimation=OnlineEstimationSettings(time_constant=1.0))
    scenario = Scenario(
        duration=40.0,
        mode="torque",
        reference=Profile(_TIMES, (1.4, 0.1, 1.4, 0.1)),
        shaft=Profile(_TIMES, (_SLOW, _FAST, _SLOW, _FAST)),
        encoder=Encoder(1024),
        sensor=CurrentSensor(bits=12, full_scale=12.8, noise=0.02),
        drift=Drift(2.0, 22.0, r_s=0.3, psi_pm=-0.08),
    )
    found = simulate_design(replace(design, control=control, simulation=scenario)).run
    record = found.estimation
    assert record is not None
    figure = new_figure("online-estimation", 2.9, "Estimates over a run", arranged=True)
    left, right = figure.subplots(1, 2, sharex=True)
    time, some = found.t[::500], slice(None, None, 500)
    for axes, true, own in (
        (left, record.r_s, record.r_s_estimated),
        (right, 1e3 * record.psi_pm, 1e3 * record.psi_pm_estimated),
    ):
        axes.plot(time, true[some], label="of the plant")
        axes.plot(time, own[some], label="estimated")
        axes.set(xlabel="Time in s")
    left.set(ylabel="Resistance in Ohm")
    right.set(ylabel="Flux linkage in mWb")
    left.legend()
    save(figure, path)
