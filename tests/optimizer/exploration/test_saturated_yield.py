"""A fixed header on machines over one flux map, against one machine at a time."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from drawn_machines import factors

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, ScaledMachines
from dqforge.machines.dq_machines.synchronous import copper_loss
from dqforge.optimizer.exploration.yields import (
    LEAST_MARGIN,
    LOSS_PENALTY,
    TORQUE_ERROR,
    TORQUE_MADE,
    FixedHeader,
    fixed_loop,
    nominal_header,
    reference_points,
    yield_outputs,
)
from dqforge.optimizer.loops.loop_gains import analyse_current_loop
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

NAMES = (TORQUE_ERROR, TORQUE_MADE, LOSS_PENALTY, LEAST_MARGIN, "gains.i_d.phase_margin")


@cache
def drive() -> tuple[SaturatedMachine, FixedHeader]:
    design = catalogue.load("baldor-pmsyrm-5k6")
    assert isinstance(design.machine, SaturatedMachine)
    return design.machine, nominal_header(design)


def drawn(count: int) -> ScaledMachines:
    machine, _ = drive()
    random = np.random.default_rng(5)
    names = {"magnet": 0.02, "inductance_d": 0.05, "inductance_q": 0.05, "current": 0.03}
    columns = {name: factors(count, sigma, random) for name, sigma in names.items()}
    return ScaledMachines.varied(machine, count, columns)


def test_outputs_are_those_of_each_machine_alone() -> None:
    _, header = drive()
    machines = drawn(5)
    found = yield_outputs(header, machines, NAMES)
    points = reference_points(header)
    for row in range(machines.count):
        single = machines.machine(row)
        made = single.torque(points.i_d, points.i_q)
        error = np.max(np.abs(made - points.torque)) / header.torque_max
        assert found[TORQUE_ERROR][row] == pytest.approx(error, rel=1e-9)
        assert found[TORQUE_MADE][row] == pytest.approx(made[-1], rel=1e-12)
        own = CurrentChoice(single, "mtpa", 1.05 * single.i_max)
        least = copper_loss(single.r_s, *own.currents(made))
        penalty = np.max(copper_loss(single.r_s, points.i_d, points.i_q) / least - 1.0)
        assert found[LOSS_PENALTY][row] == pytest.approx(penalty, rel=1e-5, abs=1e-8)
        jet = single.jet(np.append(0.0, points.i_d), np.append(0.0, points.i_q))
        loop = fixed_loop(header, "i_d")
        alone = analyse_current_loop(
            single.r_s, float(np.min(jet.l_dd)), loop.t_s, loop.kp, loop.ki, respond=False
        )
        assert found["gains.i_d.phase_margin"][row] == pytest.approx(alone.phase_margin, rel=1e-9)


def test_the_machine_that_the_header_is_for_has_next_to_no_error() -> None:
    machine, header = drive()
    found = yield_outputs(header, ScaledMachines.varied(machine, 1, {}), NAMES)
    spread = yield_outputs(header, drawn(200), NAMES)
    assert found[TORQUE_ERROR][0] < 0.003
    assert -1e-9 < found[LOSS_PENALTY][0] < 1e-3
    assert found[TORQUE_ERROR][0] < 0.2 * np.median(spread[TORQUE_ERROR])
    assert np.all(np.isfinite(spread[LOSS_PENALTY]))
    assert np.min(spread[LOSS_PENALTY]) > -1e-9
