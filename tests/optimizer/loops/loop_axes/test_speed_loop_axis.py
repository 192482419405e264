"""Speed loops of many machines, each with its own sampling, against each by itself."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    PerUnitBases,
    SpeedLoopSettings,
)
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.loops.loop_axes import (
    drives_of_one_controller,
    given_speed_loops,
    nominal_drives,
    tuned_current_loops,
    tuned_speed_loops,
)
from dqforge.optimizer.loops.loop_gains import tune_current_loop, tune_speed_loop
from dqforge.optimizer.loops.pi_methods import (
    DriveVariants,
    batch_margins,
    close_loops,
    speed_plants,
)

COUNT = 12
NUMBERS = ("crossover", "phase_margin", "gain_margin", "delay_margin", "max_sensitivity")
CURRENT = CurrentLoopSettings()


def drawn(seed: int) -> tuple[FloatArray, ...]:
    """R, L, t_s, J and B of machines of all sizes."""
    g = np.random.default_rng(seed)
    r_s = 10.0 ** g.uniform(-2.5, 0.7, COUNT)
    return (
        r_s,
        r_s * 10.0 ** g.uniform(-3.3, -1.5, COUNT),
        10.0 ** g.uniform(-4.6, -3.6, COUNT),
        10.0 ** g.uniform(-4.0, -2.0, COUNT),
        10.0 ** g.uniform(-6.0, -3.0, COUNT),
    )


def settings(row: int, *, filtered: bool) -> SpeedLoopSettings:
    """Settings that change from row to row."""
    return SpeedLoopSettings(
        method=("symmetrical-optimum", "bandwidth", "damping", "ti")[row % 4],
        ratio=(5, 10)[row % 2],
        bandwidth=40.0,
        spread=3.0,
        filter_time=1e-4 * (1 + row % 3) if filtered else 0.0,
    )


@pytest.mark.parametrize("filtered", [False, True])
def test_gains_and_margins_are_those_of_single_loops(filtered: bool) -> None:
    r_s, inductance, t_s, inertia, friction = drawn(3)
    rules = [settings(row, filtered=filtered) for row in range(COUNT)]
    q_axis = tuned_current_loops(r_s, inductance, t_s, CURRENT)
    found = tuned_speed_loops(q_axis, inertia, friction, rules)
    accepted = 0
    for k in range(COUNT):
        machine = LinearMachine(
            2, r_s[k], inductance[k], inductance[k], 0.1, 10.0, inertia[k], friction[k]
        )
        control = ControlSettings(t_s[k], CURRENT, rules[k], None, PerUnitBases(1, 1, 1, 1))
        try:
            inner = tune_current_loop(r_s[k], inductance[k], t_s[k], CURRENT)
            single = tune_speed_loop(machine, inner, control)
        except NoSolutionError:
            assert not found.holds[k]
            continue
        assert found.holds[k]
        assert (found.kp[k], found.ki[k]) == (single.kp, single.ki)
        for name in NUMBERS:
            wanted = getattr(single, name)
            assert getattr(found.margins, name)[k] == pytest.approx(wanted, rel=1e-9), name
        accepted += 1
    assert accepted >= COUNT // 2


def test_taking_the_period_as_unit_of_time_changes_nothing() -> None:
    r_s, inductance, _, inertia, friction = drawn(5)
    rule = SpeedLoopSettings(ratio=8)
    q_axis = tuned_current_loops(r_s, inductance, 1e-4, CURRENT)
    found = tuned_speed_loops(q_axis, inertia, friction[0], rule)
    one = np.ones(COUNT)
    for k in range(COUNT):
        drive = DriveVariants(
            *(value[k : k + 1] for value in (r_s, inductance, inertia, one, one, 0.0 * one))
        )
        gains = (float(q_axis.kp[k]), float(q_axis.ki[k]))
        plants = speed_plants(drive, friction[0], 1e-4, gains, 8)
        wanted = batch_margins(close_loops(plants, found.kp[k], found.ki[k]))
        for name in (*NUMBERS, "radius"):
            np.testing.assert_allclose(
                getattr(found.margins, name)[k], getattr(wanted, name)[0], rtol=1e-10, err_msg=name
            )


def test_rows_without_current_loop_have_no_speed_loop() -> None:
    wild = CurrentLoopSettings(method="bandwidth", bandwidth=2e4)
    q_axis = tuned_current_loops(0.4, 2e-3, 1e-4, [CURRENT, wild])
    found = tuned_speed_loops(q_axis, 1e-3, 1e-4, SpeedLoopSettings())
    np.testing.assert_array_equal(found.holds, [True, False])
    np.testing.assert_array_equal(np.isnan(found.kp), [False, True])
    np.testing.assert_array_equal(np.isnan(found.margins.crossover), [False, True])


def test_one_controller_on_machines_that_are_not_its_own() -> None:
    """Magnets 10 % strong make 10 % more torque per ampere, inertia slows down; the nominal machine
    has the margins of its own tuning.
    """
    nominal = LinearMachine(3, 2.35, 1.61e-3, 1.74e-3, 0.06, 12.8, inertia=2e-4, friction=4e-5)
    rule = SpeedLoopSettings()
    q_axis = tuned_current_loops(nominal.r_s, nominal.l_q, 2e-4, CURRENT)
    tuned = tuned_speed_loops(q_axis, 2e-4, nominal.friction, rule)
    psi, inertia = np.array([0.06, 0.066, 0.06]), np.array([2e-4, 2e-4, 4e-4])
    machines = MachineBatch.varied(nominal, 3, {"psi_pm": psi, "inertia": inertia})
    current = (float(q_axis.kp[0]), float(q_axis.ki[0]))
    drives = drives_of_one_controller(machines, nominal, 2e-4, current)
    found = given_speed_loops(drives, tuned.kp, tuned.ki, rule)
    assert found.holds.all()
    assert found.margins.crossover[0] == pytest.approx(tuned.margins.crossover[0], rel=1e-12)
    assert found.margins.crossover[1] == pytest.approx(1.1 * found.margins.crossover[0], rel=0.02)
    assert found.margins.crossover[2] < 0.6 * found.margins.crossover[0]


def test_gains_that_make_a_loop_unstable_are_told() -> None:
    q_axis = tuned_current_loops(0.4, 2e-3, 1e-4, CURRENT)
    drives = nominal_drives(q_axis, 1e-3, 1e-4)
    found = given_speed_loops(drives, 50.0, 1.0, SpeedLoopSettings())
    assert not found.stable[0]
    assert not found.holds[0]
    assert found.margins.radius[0] > 1.0


def test_a_reluctance_machine_makes_torque_by_its_saliency() -> None:
    nominal = LinearMachine(2, 0.6, 10e-3, 40e-3, 0.0, 20.0, inertia=5e-3)
    machines = MachineBatch.varied(nominal, 2, {"l_d": np.array([10e-3, 16e-3])})
    drives = drives_of_one_controller(machines, nominal, 1e-4, (40.0, 600.0))
    np.testing.assert_allclose(drives.drive.torque_factor, [1.0, 0.8], rtol=1e-15)
    np.testing.assert_array_equal(drives.drive.back_emf, 0.0)


def test_a_machine_without_known_inertia_has_no_speed_loop() -> None:
    q_axis = tuned_current_loops([0.4, 0.4], 2e-3, 1e-4, CURRENT)
    found = tuned_speed_loops(q_axis, [1e-3, np.nan], 1e-4, SpeedLoopSettings())
    np.testing.assert_array_equal(found.holds, [True, False])
    assert np.isnan(found.margins.phase_margin[1])
