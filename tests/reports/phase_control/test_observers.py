"""Observers beside the control of phase machines: their headers share types with it and read the
voltage that it keeps.
"""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from dqforge.machines.design.catalogue import load
from dqforge.machines.errors import InputError
from dqforge.machines.names import (
    SIX_STEP_METHODS,
    SPEED_OBSERVER,
    TRACKER_NAMES,
    ObserverMethodName,
)
from dqforge.machines.plants.scenario import Encoder, Scenario, constant
from dqforge.reports.simulation.design_run import simulate_design

# Those that see voltage and current alone; methods of six-step drives commutate, others inject.
METHODS = [
    name for name in get_args(ObserverMethodName) if name not in (*TRACKER_NAMES, *SIX_STEP_METHODS)
]


@pytest.mark.parametrize("method", SIX_STEP_METHODS)
def test_methods_of_six_step_drives_are_refused_of_phase_machines(method: str) -> None:
    with pytest.raises(InputError, match=f"a six-step drive .control.observer: {method}"):
        load("paper002-phase-waveforms", [f"control.observer={{method: {method}}}"])


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
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
