"""Observers beside the control of phase machines: their headers share types with it and read the
voltage that it keeps.
"""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load
from dqforge.machines.names import SPEED_OBSERVER, ObserverMethodName
from dqforge.machines.plants.scenario import Encoder, Scenario, constant
from dqforge.reports.simulation.design_run import simulate_design


@pytest.mark.slow
@pytest.mark.parametrize("method", get_args(ObserverMethodName))
def test_every_observer_sees_the_machine_of_the_new_control(method: ObserverMethodName) -> None:
    """Four legs, table, 2 N m at 1200 rpm: the torque stays, speed and angle are found; what the
    harmonics of the back-EMF leave of an angle's error is within 5 degrees."""
    keys = "pole: 400 rad/s" if method == SPEED_OBSERVER else f"method: {method}"
    design = load("paper002-phase-waveforms", [f"control.observer={{{keys}}}"])
    speed = 1200.0 * np.pi / 30.0
    scenario = Scenario(
        0.3, "torque", constant(2.0), shaft=constant(speed), omega_m=speed,
        encoder=Encoder(speed="observer"),
    )  # fmt: skip
    run = simulate_design(replace(design, simulation=scenario)).run
    assert run.figures.bounded[0]
    tail = slice(run.t.size - 1000, run.t.size)
    assert np.mean(run.torque[tail]) == pytest.approx(2.0, rel=2e-3)
    assert np.ptp(run.torque[tail]) < 0.1
    assert np.max(np.abs(run.omega_m_observed[tail] - speed)) < 0.12 * speed
    if method != SPEED_OBSERVER:
        away = np.angle(np.exp(1j * (run.theta_e_observed[tail] - run.theta_e[tail])))
        assert np.max(np.abs(away)) < np.radians(5.0)
