"""Currents and limit torques of columns against those of each machine alone."""

from __future__ import annotations

import numpy as np
import pytest
from batch_trials import linear_machines

from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Strategy
from dqforge.optimizer.exploration.batch_currents import (
    currents_of_size,
    drives,
    largest_torques,
    strategy_currents,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

SHARES = np.array([-0.7, 0.0, 1e-9, 0.01, 0.3, 0.77, 1.0])


@pytest.mark.parametrize("strategy", ["mtpa", "id0"])
def test_200_random_machines_have_the_currents_of_the_single_path(strategy: Strategy) -> None:
    machines = linear_machines(200)
    batch = MachineBatch.of(machines)
    limit = largest_torques(batch, strategy)
    i_d, i_q = strategy_currents(batch, strategy, SHARES[:, np.newaxis] * limit)
    marked = drives(batch, strategy)
    for row, machine in enumerate(machines):
        if not marked[row]:
            assert strategy == "id0"
            assert machine.psi_pm == 0.0
            assert np.isnan(limit[row])
            assert np.all(np.isnan([i_d[:, row], i_q[:, row]]))
            continue
        choice = CurrentChoice(machine, strategy, machine.i_max)
        assert limit[row] == pytest.approx(choice.largest_torque(), rel=1e-12)
        single = choice.currents(SHARES * choice.largest_torque())
        close = 1e-12 * machine.i_max
        np.testing.assert_allclose(i_d[:, row], single[0], rtol=0.0, atol=close)
        np.testing.assert_allclose(i_q[:, row], single[1], rtol=0.0, atol=close)


@pytest.mark.parametrize("strategy", ["mtpa", "id0"])
def test_the_limit_torque_takes_the_whole_current(strategy: Strategy) -> None:
    batch = MachineBatch.of([one for one in linear_machines(80) if one.psi_pm > 0.0])
    i_d, i_q = currents_of_size(batch, strategy, batch.i_max)
    np.testing.assert_allclose(np.hypot(i_d, i_q), batch.i_max, rtol=1e-14)
    again = strategy_currents(batch, strategy, largest_torques(batch, strategy))
    np.testing.assert_allclose(np.hypot(*again), batch.i_max, rtol=1e-12)


def test_no_other_angle_makes_more_torque() -> None:
    batch = MachineBatch.of(linear_machines(64))
    angle = np.linspace(0.0, np.pi, 2001)[:, np.newaxis]
    tried = batch.torque(batch.i_max * np.cos(angle), batch.i_max * np.sin(angle))
    most = np.max(tried, axis=0)
    limit = largest_torques(batch, "mtpa")
    assert np.all(most <= limit * (1.0 + 1e-12))
    assert np.all(most > limit * (1.0 - 3e-6))  # half a step of the angle beside the best one


def test_a_machine_has_the_same_bytes_in_any_batch() -> None:
    batch = MachineBatch.of(linear_machines(257))
    limit = largest_torques(batch, "mtpa")
    whole = strategy_currents(batch, "mtpa", SHARES[:, np.newaxis] * limit)
    for row in (0, 5, 6, 7, 131, 256):
        one = batch.taken(np.array([row]))
        alone = largest_torques(one, "mtpa")
        assert alone.tobytes() == limit[row : row + 1].tobytes()
        for many, single in zip(
            whole, strategy_currents(one, "mtpa", SHARES[:, np.newaxis] * alone), strict=True
        ):
            assert many[:, row].tobytes() == single[:, 0].tobytes()


def test_a_machine_that_makes_no_torque_is_marked() -> None:
    batch = MachineBatch.of([LinearMachine(2, 1.0, 1e-3, 1e-3, 0.0, 10.0)])
    assert not drives(batch, "mtpa")[0]
    assert np.isnan(largest_torques(batch, "mtpa")[0])
    assert np.all(np.isnan(strategy_currents(batch, "mtpa", np.ones(1))))
