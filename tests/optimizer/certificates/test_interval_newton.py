"""Bounds interval by interval: each holds for the torques of its own interval,
whatever the rest of the domain does.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from drives import IPM, RELUCTANCE, in_floats
from exact_currents import found_errors
from flint import arb, ctx

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.optimizer.certificates.ball import ORDER, Task, pieces
from dqforge.optimizer.certificates.current_reference import (
    UNKNOWN,
    Bounds,
    Interval,
    bounds_near_zero_torque,
    errors_without_currents,
    newton,
)
from dqforge.optimizer.current_reference.fit import fit_reference
from dqforge.optimizer.current_reference.forms import CurrentReference
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint


@pytest.fixture(autouse=True)
def ball_context() -> Iterator[None]:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 80, ORDER + 1
    yield
    ctx.prec, ctx.cap = before


def task_of(choice: CurrentChoice, settings: FitSettings) -> Task:
    return Task.of(choice, in_floats(fit_reference(choice, settings)))


def baldor() -> CurrentChoice:
    design = catalogue.load("baldor-pmsyrm-5k6")
    return CurrentChoice(design.machine, "mtpa", design.i_max)


TASKS = {
    "polynomial": lambda: task_of(
        CurrentChoice(IPM, "mtpa", IPM.i_max), FitSettings(form="polynomial", degree=2)
    ),
    "torque-exact": lambda: task_of(CurrentChoice(IPM, "mtpa", IPM.i_max), FitSettings(degree=6)),
    "closed-form": lambda: task_of(
        CurrentChoice(IPM, "mtpa", IPM.i_max), FitSettings(form="closed-form", degree=2)
    ),
    "flux map": lambda: task_of(baldor(), FitSettings(form="polynomial", degree=3)),
    "fast": lambda: task_of(
        CurrentChoice(IPM, "mtpa", IPM.i_max, SpeedPoint(500.0, 240.0)),
        FitSettings(form="polynomial", degree=3),
    ),
    "reluctance": lambda: task_of(
        CurrentChoice(RELUCTANCE, "mtpa", RELUCTANCE.i_max),
        FitSettings(form="polynomial", degree=3),
    ),
}


def random_intervals(
    task: Task, count: int
) -> Iterator[tuple[Interval, np.ndarray[tuple[int], np.dtype[np.float32]]]]:
    """Intervals of all widths with torques inside, their ends included."""
    generator = np.random.default_rng(8)
    for _ in range(count):
        piece = pieces(task.reference)[int(generator.integers(len(pieces(task.reference))))]
        width = (piece.high - piece.low) * float(10.0 ** generator.uniform(-5.0, -1.0))
        low = float(np.float32(generator.uniform(piece.low, piece.high - width)))
        high = float(np.float32(low + width))
        inside = np.unique(np.linspace(low, high, 41).astype(np.float32))
        inside = inside[inside < np.float32(piece.high)]
        if inside.size:
            yield Interval(piece, low, high, 0, UNKNOWN.values()), inside


def holds(task: Task, bounds: Bounds, torque: np.ndarray[tuple[int], np.dtype[np.float32]]) -> None:
    assert isinstance(task.reference, CurrentReference)
    found = found_errors(task.choice, task.reference, torque)
    noise = 1e-17 if isinstance(task.choice.machine, LinearMachine) else 1e-12
    scale = task.choice.i_max * max(1.0, 1.5 * task.choice.machine.r_s * task.choice.i_max)
    for name, value in vars_of(bounds).items():
        assert value >= getattr(found, name) - noise * scale, name


def vars_of(bounds: Bounds) -> dict[str, float]:
    return dict(zip(Bounds.__dataclass_fields__, bounds.values().tolist(), strict=True))


@pytest.mark.thinned
@pytest.mark.parametrize("name", TASKS)
def test_every_interval_keeps_its_own_bounds(name: str) -> None:
    task = TASKS[name]()
    proven = 0
    for interval, torque in random_intervals(task, 60):
        for condition in task.conditions(interval.low, interval.high)[:1]:
            if len(task.conditions(interval.low, interval.high)) > 1:
                continue  # both conditions are asked there, and the worse one is taken
            try:
                bounds = newton(task, interval, condition)
            except ZeroDivisionError:
                continue
            proven += 1
            holds(task, bounds, torque)
    assert proven >= 30


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["polynomial", "flux map", "reluctance"])
def test_bounds_beside_exact_currents_hold_as_well(name: str) -> None:
    task = TASKS[name]()
    proven = 0
    for interval, torque in random_intervals(task, 40):
        try:
            bounds = bounds_near_zero_torque(task, interval)
        except ZeroDivisionError:
            continue
        proven += 1
        holds(task, bounds, torque)
    assert proven >= 20


@pytest.mark.parametrize("name", ["polynomial", "flux map", "reluctance"])
def test_interval_from_rest_on(name: str) -> None:
    task = TASKS[name]()
    piece = pieces(task.reference)[0]
    for share in (1e-12, 1e-6, 1e-3, 0.02):
        high = float(np.float32(share * piece.high))
        bounds = bounds_near_zero_torque(task, Interval(piece, 0.0, high, 0, UNKNOWN.values()))
        holds(task, bounds, np.linspace(0.0, high, 200).astype(np.float32))
        assert bounds.i_d < 3.0 * task.choice.i_max * np.sqrt(share)


def test_torque_and_voltage_need_no_exact_currents() -> None:
    task = TASKS["fast"]()
    for interval, torque in random_intervals(task, 30):
        values = errors_without_currents(task, interval)
        assert np.isinf(values[[0, 1, 3, 4]]).all()
        assert isinstance(task.reference, CurrentReference)
        found = found_errors(task.choice, task.reference, torque)
        assert values[2] >= found.torque
        assert values[5] >= found.voltage_excess


def test_wrong_condition_is_far_from_the_currents() -> None:
    """i_d = 0 asked of MTPA currents: the bound is the whole of i_d."""
    task = TASKS["torque-exact"]()
    piece = pieces(task.reference)[0]
    interval = Interval(piece, 20.0, 20.001, 0, UNKNOWN.values())
    i_d = abs(float(piece.currents(arb(20.0))[0]))
    assert 1.5 * i_d > newton(task, interval, "no i_d").i_d >= i_d > 1.0
    assert newton(task, interval, "loss").i_d < 1e-3
