"""The simulated drive, margins and modulator against motulator, a program that others wrote."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import motulator_drive
import numpy as np
import pytest
from motulator.common.control import PWM

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import ModulationName
from dqforge.machines.plants.scenario import Profile, Scenario, constant
from dqforge.machines.transforms import Pair
from dqforge.optimizer.solution import Solution, solve_control
from dqforge.reports.control.header import (
    ControlModel,
    control_from,
    plain_control,
    three_leg_duties,
)
from dqforge.reports.run import plain_solution
from dqforge.reports.simulation.design_run import simulate_design

ABB = ("abb-ipmsm-2k2", 0.05, 50.0, 5.0)
BENCH = ("paper001-pmsm-bench", 0.2, 120.0, 0.3)


def solved(name: str) -> Solution:
    """A drive of the library whose loops take the speed of the encoder."""
    loop = "control.speed_loop={method: symmetrical-optimum}"
    design = catalogue.load(name, ["export.control=float32", loop])
    return solve_control(replace(design, control=replace(design.control, observer=None)))


def model_of(solution: Solution) -> ControlModel:
    return control_from(plain_control(solution), plain_solution(solution))


class Speed:
    """Speed control of a model to a reference in rad/s."""

    def __init__(self, model: ControlModel, reference: float) -> None:
        self.model, self.state = model, model.at_rest(1)
        self.reference = np.array([reference], dtype=np.float32)

    def __call__(self, samples: Any) -> Any:
        with np.errstate(all="ignore"):
            return self.model.speed_control(self.state, samples, self.reference)


@pytest.mark.parametrize(
    ("name", "duration", "speed", "load", "switched"),
    [
        (*ABB, False),
        pytest.param(*ABB, True, marks=pytest.mark.slow),
        pytest.param(*BENCH, False, marks=pytest.mark.slow),
        pytest.param(*BENCH, True, marks=pytest.mark.slow),
    ],
)
def test_a_start_and_a_load_step(
    name: str, duration: float, speed: float, load: float, switched: bool
) -> None:
    """Every sample of speed and currents, within a thousandth of the largest."""
    solution, at = solved(name), 0.5 * duration

    def torque(time: Any) -> Any:
        return np.where(np.asarray(time) >= at, load, 0.0)

    design = solution.design
    control = Speed(model_of(solution), speed)
    theirs = motulator_drive.run(design, control, duration, torque, switched=switched)
    scenario = Scenario(
        duration,
        "speed",
        constant(speed),
        load=Profile((0.0, at), (0.0, load)),
        dead_time=0.0,
        inverter="switched" if switched else "averaged",
    )
    run = simulate_design(replace(design, simulation=scenario), solution=solution).run
    ours = np.stack([run.omega_m, run.i_d, run.i_q])[:, : len(theirs)]
    size = np.array([speed, *2 * [float(np.max(np.abs(ours[1:])))]])
    np.testing.assert_allclose(ours / size[:, None], theirs.T / size[:, None], atol=1e-3)


def _growth(design: Design, model: ControlModel) -> float:
    """By how much a small speed's oscillation is larger in the last third than in the second."""
    seen = motulator_drive.run(design, Speed(model, 1e-2), 0.15)[:, 0] - 1e-2
    parts = np.array_split(seen - np.mean(seen[-len(seen) // 3 :]), 3)
    return float(np.std(parts[2]) / np.std(parts[1]))


@pytest.mark.slow
def test_a_speed_loop_swings_up_from_its_gain_margin_on() -> None:
    """The predicted limit of the gain within 4 %, as the drive of motulator begins to swing."""
    solution = solved(ABB[0])
    speed = solution.gains.speed
    assert speed is not None
    model = model_of(solution)
    for share, swings in ((0.96, False), (1.04, True)):
        factor = np.float32(share * speed.margins.gain_margin)
        raised = tuple(factor * np.float32(each) for each in model.gains["speed"])
        changed = replace(model, gains={**model.gains, "speed": raised})
        assert (_growth(solution.design, changed) > 1.0) == swings


def _current(model: ControlModel, state: Any, wanted: Any, samples: Any) -> Any:
    return model.current_control(state, samples, wanted)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_current_loop_swings_up_from_its_gain_margin_on(axis: int) -> None:
    """On a shaft that does not move; both gains of an axis within 4 % of the predicted limit."""
    solution = solved(ABB[0])
    loop = (solution.gains.i_d, solution.gains.i_q)[axis]
    model, machine = model_of(solution), solution.design.machine
    assert isinstance(machine, LinearMachine)
    held = replace(solution.design, machine=replace(machine, inertia=1e9))
    for share, swings in ((0.96, False), (1.04, True)):
        factor, name = np.float32(share * loop.margins.gain_margin), "dq"[axis]
        raised = tuple(factor * np.float32(each) for each in model.gains[name])
        changed = replace(model, gains={**model.gains, name: raised})
        state = changed.at_rest(1)
        wanted = tuple(np.array([0.01 * (axis == k)], dtype=np.float32) for k in range(2))

        control = partial(_current, changed, state, wanted)
        seen = motulator_drive.run(held, control, 0.015)[:, 1 + axis]
        parts: list[FloatArray] = np.array_split(seen - 0.01, 3)
        assert (np.std(parts[2]) > np.std(parts[1])) == swings


@pytest.mark.parametrize("name", ["svpwm"])
def test_duty_cycles_of_space_vectors(name: ModulationName) -> None:
    generator = np.random.default_rng(4)
    size, angle = generator.uniform(0.0, 1.0 / np.sqrt(3.0), 500), generator.uniform(0, 7, 500)
    v_dc = generator.uniform(10.0, 800.0, 500)
    voltage = size * v_dc * np.exp(1j * angle)
    theirs = np.array([PWM().duty_ratios(*each) for each in zip(voltage, v_dc, strict=True)]).T
    alpha, beta, link = (part.astype(np.float32) for part in (voltage.real, voltage.imag, v_dc))
    still = Pair(*2 * [np.zeros(500, dtype=np.float32)])
    ours = three_leg_duties(name, Pair(alpha, beta), link, still)
    np.testing.assert_allclose(np.stack(ours), theirs, atol=3e-7)
