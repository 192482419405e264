"""Trackers as columns of a drive's state, against the same loop with angles of the stator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.estimators import (
    TRACKERS,
    TrackerEstimator,
    TrackerLoop,
    solve_tracker,
    tune_tracker,
)

T_S = 1e-4
NONE = np.zeros(1, dtype=np.complex128)


@pytest.mark.parametrize(
    ("seen", "ahead"),
    [
        (((0, 1.0),), 0.0),
        (((0, 0.5), (1, 0.3), (3, 0.2)), 0.0),
        (((2, 1.0),), 1.5),
        (((2, 0.6), (4, 0.4)), 1.5),
    ],
)
@pytest.mark.parametrize("omega", [0.0, 150.0, -400.0])
def test_columns_are_the_loop_with_angles_of_the_stator(
    seen: tuple[tuple[int, float], ...], ahead: float, omega: float
) -> None:
    loop = TrackerLoop(T_S, 0.08, 20.0, seen, ahead)
    assert loop.lag == pytest.approx(0.004)
    estimator, oldest = TrackerEstimator(loop), max(age for age, _ in seen)
    columns, size = estimator.start(NONE, NONE, np.array([omega]))
    assert size[0, :-1] == pytest.approx(1.0)
    assert size[0, -1] == max(abs(omega), 1.0)
    # Angles that were predicted, or asked for as directions, by the sample at which they were.
    angle, speed = -omega * T_S, omega
    told = {k: omega * T_S * (k + ahead) for k in range(-oldest, 0)}
    columns[0, -2] += 0.02
    columns[0, -1] += 3.0
    angle, speed = angle + 0.02, speed + 3.0
    for k in range(200):
        predicted = angle + T_S * speed
        if ahead == 0.0:
            told[k] = predicted
        error = sum(
            share * (omega * T_S * (k - age + ahead) - told[k - age]) for age, share in seen
        )
        angle, speed = predicted + 0.08 * error, speed + 20.0 * error
        if ahead > 0.0:
            told[k] = angle + ahead * T_S * speed
        columns, delta, found = estimator.step(columns, NONE, NONE)
        assert delta[0] == pytest.approx(angle - omega * T_S * k, abs=1e-12)
        assert found[0] == pytest.approx(speed, abs=1e-9)
        columns = estimator.turned(columns, np.array([omega * T_S]))
    assert abs(speed - omega) < 3.0


def test_a_tracker_serves_between_its_speeds() -> None:
    design = catalogue.load("abb-ipmsm-2k2")
    design = replace(design, export=replace(design.export, control=("float32",)))
    wanted = ObserverSettings(method="injection")
    found = tune_tracker(design, wanted)
    low, high = TRACKERS["injection"].speeds(design, found.gains)
    most = design.machine.omega_m_max
    fastest = design.control.bases.speed if most is None else most
    assert (found.omega_low, found.omega_high, found.t_s) == (low, high, design.control.t_s)
    assert found.omega_max == pytest.approx(fastest * design.machine.pole_pairs)
    assert found.loop is not None
    machine = design.machine
    assert isinstance(machine, LinearMachine)
    slower = replace(design, machine=replace(machine, omega_m_max=50.0))
    assert tune_tracker(slower, wanted).omega_max == pytest.approx(50.0 * design.machine.pole_pairs)
    assert solve_tracker(replace(design, control=replace(design.control, observer=None))) is None
    assert math.isfinite(found.loop.lag)
    crowded = replace(design, inverter=replace(design.inverter, v_dc=160.0))
    with pytest.raises(NoSolutionError, match=r"serves at no speed|wander by|largest pole"):
        tune_tracker(crowded, wanted)
