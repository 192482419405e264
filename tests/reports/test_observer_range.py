"""The stated range of a position observer: its loads, tolerances and dead time, against the drive as it is simulated."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines import catalogue
from dqforge.machines.design import Design
from dqforge.machines.scenario import PlantErrors, Scenario, constant
from dqforge.machines.settings import ObserverMethodName, ObserverSettings, Tolerances
from dqforge.machines.synchronous import LinearMachine
from dqforge.optimizer.observer_conditions import conditions, lost_voltage
from dqforge.optimizer.observer_judgement import ANGLE_LIMIT, SPEED_LIMIT
from dqforge.optimizer.observer_settings import Disturbances
from dqforge.optimizer.observer_tuning import PositionObserver
from dqforge.optimizer.position_observers import METHODS
from dqforge.optimizer.solution import Solution, solve, solve_gains
from dqforge.optimizer.steady_observer import steady_observer
from dqforge.machines.drive_motion import plants
from dqforge.reports.drive_simulation import angle_error, controller_files, drive_of, observers_of
from dqforge.reports.observer_header import observer_files, speed_range_text
from dqforge.reports.observer_text import plain_position, position_parts
from dqforge.reports.result_json import to_text
from dqforge.reports.simulation import simulate, simulator

DRIVES = ("paper001-pmsm-bench", "abb-ipmsm-2k2", "template")
EVERY = pytest.mark.parametrize("name", list(METHODS))


def observed_design(drive: str, method: ObserverMethodName, tolerances: Tolerances | None = None) -> Design:
    if drive == "template":
        from dqforge.machines.loader import load_text

        design = load_text(catalogue.template(), "template.yaml")
    else:
        design = catalogue.load(drive)
    control = replace(design.control, observer=ObserverSettings(method=method), tolerances=tolerances)
    return replace(design, control=control, losses=None, simulation=None)


def position(design: Design) -> PositionObserver:
    found = solve_gains(design).position
    assert found is not None
    return found


CASES = [(drive, method) for drive in DRIVES for method in METHODS]
QUICK = {("template", "flux"), ("paper001-pmsm-bench", "matsui-current")}


def measured(solution: Solution, share: float, torque_share: float, r_s: float) -> tuple[list[float], list[float]]:
    """(angle error in rad, speed error in rad/s) in the simulation with emitted C, and by the steady state."""
    design, observer = solution.design, solution.gains.position
    assert observer is not None
    machine = design.machine
    omega = share * observer.omega_max
    torque = torque_share * solution.fit.torque_max
    shaft = constant(omega / machine.pole_pairs)
    with simulator(controller_files(solution), design.export.prefix, observers_of(solution)[1]) as program:
        found = simulate(
            program,
            drive_of(design),
            Scenario(
                1.0, "torque", constant(torque), shaft=shaft, omega_m=shaft.values[0], errors=PlantErrors(r_s=r_s)
            ),
        )
    last = found.t > 0.7
    gap = float(np.angle(np.mean(np.exp(1j * angle_error(found)[last]))))
    slip = machine.pole_pairs * float(np.mean((found.omega_m_observed - found.omega_m)[last]))
    lost = lost_voltage(design)[0]
    i_dq = np.array([complex(np.mean(found.i_d[last]), np.mean(found.i_q[last]))])
    assert isinstance(machine, LinearMachine)
    steady = steady_observer(
        observer.method, observer.gains, observer.t_s, plants(machine, {"r_s": r_s}), i_dq, np.array([omega]), 0.0, lost
    )
    assert steady.found[0]
    return [gap, slip], [float(steady.theta_error[0]), float(steady.omega_error[0])]


@pytest.mark.parametrize(
    ("drive", "method"), [case if case in QUICK else pytest.param(*case, marks=pytest.mark.slow) for case in CASES]
)
def test_a_warm_machine_with_its_dead_time_errs_as_is_judged(drive: str, method: ObserverMethodName) -> None:
    """R + 30 %, dead time of the design, half torque on the locus, half speed: angle and speed in the simulated drive.

    The averaged dead time of the simulation is a little less than the square wave's fundamental.
    """
    solution = solve(observed_design(drive, method))
    seen, judged = measured(solution, 0.5, 0.5, 0.3)
    assert solution.gains.position is not None
    assert seen[0] == pytest.approx(judged[0], rel=0.15, abs=np.radians(0.5))
    assert seen[1] == pytest.approx(judged[1], rel=0.15, abs=2e-3 * solution.gains.position.omega_max)
