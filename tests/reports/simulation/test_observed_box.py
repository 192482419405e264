"""Drives on their observer within their tolerances, by the emitted C: what is promised is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from observed_runs import Bench, bench, random_design, swing

from dqforge.machines.design.design import Design
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import ObserverMethodName
from dqforge.machines.plants.scenario import PlantErrors, Profile, Scenario, Sensorless, constant
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.control_design.observed_remedies import require_observed
from dqforge.optimizer.loops.observed_margins import CornerJudgement

_DRIVES, _POINTS = 3, 24


def by_rule(seed: int, method: ObserverMethodName) -> Design:
    """A random drive whose loop is left to the rule; it names no tolerances."""
    design = random_design(np.random.default_rng([29, seed]), method)
    control = design.control
    assert control.speed_loop is not None
    assert control.observer is not None
    loop = replace(control.speed_loop, spread=4.0, counts_observer=True)
    observer = replace(control.observer, speed_gain=0.5 if method == "flux" else None)
    return replace(design, control=replace(control, speed_loop=loop, observer=observer))


def scenario(
    generator: np.random.Generator, found: CornerJudgement, crossover: float, kind: int
) -> tuple[Scenario, float]:
    """A step of the load, one of the speed, or rest under load, at a random point of the box; with
    the mechanical speed in rad/s that it ends at.
    """
    steps, held, pairs = found.steps, found.binding, found.pole_pairs
    assert steps is not None
    errors = PlantErrors(
        **{name: float(generator.uniform(*pair)) for name, pair in found.limits.items()}
    )
    duration = min(max(200.0 / crossover, 1.0), 8.0)
    way, begun = float(generator.choice([-1.0, 1.0])), 0.2 * duration
    load, before = constant(0.0), 0.0
    if kind == 0:
        omega = float(generator.uniform(steps.load_low, steps.load_high))
        load = Profile((0.0, begun), (0.0, way * steps.load))
    elif kind == 1:
        edge = (1.0 + steps.overshoot) * steps.speed
        low, high = held.low + edge, held.high - edge
        omega = float(generator.uniform(low, max(low, high)))
        before = -way * steps.speed
    else:
        omega = float(np.exp(generator.uniform(np.log(held.low), np.log(held.high))))
        load = Profile((0.0, 2.0 * begun), (0.0, way * found.loads[1]), "linear")
    ends = ((omega + before) / pairs, omega / pairs)
    made = Scenario(
        duration, "speed", Profile((0.0, begun), ends), load=load, omega_m=ends[0], errors=errors,
        sensorless=Sensorless(0.0, 0.0),
    )  # fmt: skip
    return made, ends[1]


def kept(program: Bench, design: Design, gains: GainSet, seed: int) -> list[str]:
    """What is not kept at random points of a drive."""
    assert gains.speed is not None
    assert gains.speed.observed is not None
    found = gains.speed.observed.corners
    assert found is not None
    generator, broken = np.random.default_rng([7, seed]), []
    for point in range(_POINTS):
        made, omega_m = scenario(generator, found, gains.speed.crossover, point % 3)
        run = program.run(design, gains, made)
        late = float(np.mean(run.omega_m[run.t > 0.8 * made.duration]))
        wrong = abs(late / omega_m - 1.0)
        if swing(run, 0.2) > 0.01 * omega_m:
            broken.append(f"drive {seed}, point {point}: swings by {swing(run, 0.2) / omega_m:.3g}")
        if np.min(run.omega_m) <= 0.0 or wrong > found.binding.speed_error + 2e-3:
            broken.append(f"drive {seed}, point {point}: lost, or the speed wrong by {wrong:.3g}")
    return broken


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    ["flux", "extended-emf", "smo", "open-loop-flux", "matsui-voltage", "matsui-current", "ekf"],
)
def test_no_point_of_the_box_swings_or_loses_its_rotor(method: ObserverMethodName) -> None:
    broken, held = [], 0
    with bench(method) as program:
        for seed in range(_DRIVES):
            design = by_rule(seed, method)
            try:
                gains = solve_gains(design)
                require_observed(design, gains)
            except NoSolutionError:
                continue  # refused beforehand
            held += 1
            broken += kept(program, design, gains, seed)
    assert broken == []
    assert held
