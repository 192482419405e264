"""Columns of machines against the machines themselves, one by one."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.machine_batch import MachineBatch, faults
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.machines.losses.machine_budget import MachineLoss, WindingHeat
from dqforge.machines.names import OvermodulationName
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget, drive_budget

MACHINE = LinearMachine(
    4, r_s=2e-3, l_d=350e-6, l_q=592e-6, psi_pm=0.1049, i_max=283.0, friction=1e-3
)


def drawn(count: int) -> list[LinearMachine]:
    """Machines of every kind with different constants, inertia and speed known of some."""
    rng = np.random.default_rng(7)
    found = []
    for row in range(count):
        l_d, l_q, r_s, psi_pm = rng.uniform(0.5, 2.0, 4) * [1e-3, 1e-3, 0.5, 0.1]
        known = {"inertia": 1e-3 * (row + 1), "omega_m_max": 500.0} if row % 2 else {}
        found.append(
            LinearMachine(
                int(rng.integers(1, 9)), r_s, l_d, l_q, psi_pm * (row % 5 != 0), 50.0, **known
            )
        )
    return found


def test_machines_come_back_as_they_went_in() -> None:
    machines = drawn(12)
    batch = MachineBatch.of(machines)
    assert batch.count == 12
    assert [batch.machine(row) for row in range(12)] == machines
    assert batch.taken(np.array([3, 1])).machine(0) == machines[3]
    twice = batch.taken(np.arange(12) < 2).repeated(3)
    assert [twice.machine(row) for row in range(6)] == [machines[0]] * 3 + [machines[1]] * 3


def test_every_formula_is_that_of_the_single_machine_bit_for_bit() -> None:
    machines = drawn(20)
    batch = MachineBatch.of(machines)
    i_d, i_q, omega = np.random.default_rng(1).uniform(-40.0, 40.0, (3, 7, 20))
    jet, flux = batch.jet(i_d, i_q), batch.flux(i_d, i_q)
    torque, voltage = batch.torque(i_d, i_q), batch.voltage(i_d, i_q, omega)
    for row, machine in enumerate(machines):
        at = i_d[:, row], i_q[:, row]
        one = machine.jet(*at)
        for part in fields(one):
            whole = getattr(jet, part.name)[:, row]
            assert whole.tobytes() == np.asarray(getattr(one, part.name)).tobytes(), part.name
        for many, single in (
            *zip(flux, machine.flux(*at), strict=True),
            (torque, machine.torque(*at)),
            *zip(voltage, machine.voltage(*at, omega[:, row]), strict=True),
        ):
            assert many[:, row].tobytes() == single.tobytes()
        assert batch.saliency[row] == machine.saliency
        assert batch.torque_per_ampere[row] == machine.torque_per_ampere


@pytest.mark.parametrize("overmodulation", ["none", "least-phase-error"])
def test_budgets_of_many_machines_are_those_of_each(overmodulation: OvermodulationName) -> None:
    """The whole chain of losses with winding heat, iron loss and, beyond the linear range,
    harmonics, whose transforms and solutions round with the number of points.
    """
    rng = np.random.default_rng(3)
    scales = rng.uniform(0.8, 1.2, (6, 4))
    columns = {
        name: getattr(MACHINE, name) * scales[:, place]
        for place, name in enumerate(("r_s", "l_d", "l_q", "psi_pm"))
    }
    batch = MachineBatch.varied(MACHINE, 6, columns | {"pole_pairs": [3, 4, 5, 4, 4, 4]})
    design = catalogue.load("paper000-ipmsm-100kw")
    inverter = replace(design.inverter, overmodulation=overmodulation)
    options = BudgetOptions(MachineLoss(1e-8, 0.2, 1e-4, 1e-9), WindingHeat(0.05, 65.0, 20.0), 2e-3)
    i_d, i_q, omega_m = np.array([[-80.0, -20.0], [120.0, 60.0], [430.0, 560.0]])
    all_d, all_q, all_speeds = (np.tile(values, 6)[np.newaxis] for values in (i_d, i_q, omega_m))
    whole = drive_budget(
        batch.repeated(2), inverter, all_d, all_q, all_speeds, ("svpwm",), options=options
    )
    single = [
        drive_budget(
            batch.machine(row), inverter, i_d, i_q, omega_m[np.newaxis], ("svpwm",), options=options
        )
        for row in range(6)
    ]
    assert np.any(whole.linear)
    assert not np.all(whole.linear)
    for part in fields(DriveBudget):
        parts = np.concatenate([getattr(one, part.name) for one in single], axis=-1)
        tolerance = 0.0 if overmodulation == "none" else 1e-12
        least = tolerance if part.name == "thermal_residual" else 0.0
        np.testing.assert_allclose(
            getattr(whole, part.name), parts, tolerance, least, err_msg=part.name
        )


def test_what_no_machine_has_is_refused_with_column_and_row() -> None:
    with pytest.raises(InputError, match=r"l_q of machine 1 is -0.001; expected a positive"):
        MachineBatch.varied(MACHINE, 3, {"l_q": [1e-3, -1e-3, 1e-3]})
    with pytest.raises(InputError, match=r"pole_pairs of machine 0 is 2.5; expected a whole"):
        MachineBatch.varied(MACHINE, 1, {"pole_pairs": [2.5]})
    with pytest.raises(InputError, match=r"r_s has the shape \(2,\), pole_pairs \(3,\)"):
        MachineBatch.varied(MACHINE, 3, {"r_s": [1.0, 2.0]})
    with pytest.raises(InputError, match="no column resistance"):
        MachineBatch.varied(MACHINE, 3, {"resistance": [1.0, 2.0, 1.0]})


def test_faulty_rows_are_told_before_machines_are_made() -> None:
    wrong = faults(
        {
            "psi_pm": [0.0, -1.0, np.nan],
            "inertia": [np.nan, 0.0, 1.0],
            "pole_pairs": [1, 0, 2],
            "i_max": [np.inf, 1.0, 0.0],
        }
    )
    assert {name: mark.tolist() for name, mark in wrong.items()} == {
        "psi_pm": [False, True, True],
        "inertia": [False, True, False],
        "pole_pairs": [False, True, False],
        "i_max": [True, False, True],
    }


def test_columns_belong_to_the_batch_alone() -> None:
    column = np.array([1e-3, 2e-3])
    batch = MachineBatch.varied(MACHINE, 2, {"l_q": column})
    column[0] = 5.0
    assert batch.l_q[0] == 1e-3
    with pytest.raises(ValueError, match="read-only"):
        batch.l_q[0] = 1.0


@pytest.mark.parametrize(
    ("name", "fine", "wrong"),
    [
        ("pole_pairs", [1.0, 2.0, 2.0**31 - 1.0], [0.0, 1.5, -1.0, 2.0**31, np.inf, np.nan]),
        ("l_d", [1e-9, 0.5, 2.0], [0.0, -1e-3, np.inf, np.nan]),
        ("l_q", [1e-9, 0.5, 2.0], [0.0, -1e-3, np.inf, np.nan]),
        ("i_max", [1e-9, 0.5, 2.0], [0.0, -1e-3, np.inf, np.nan]),
        ("r_s", [0.0, 0.5, 2.0], [-1e-9, np.inf, np.nan]),
        ("psi_pm", [0.0, 0.5, 2.0], [-1e-9, np.inf, np.nan]),
        ("friction", [0.0, 0.5, 2.0], [-1e-9, np.inf, np.nan]),
        ("inertia", [np.nan, 1e-9, 0.5, 2.0], [0.0, -1.0, np.inf]),
        ("omega_m_max", [np.nan, 1e-9, 0.5, 2.0], [0.0, -1.0, np.inf]),
    ],
)
def test_values_that_no_machine_has_are_faults(
    name: str, fine: list[float], wrong: list[float]
) -> None:
    found = faults({name: np.array([*fine, *wrong])})[name]
    np.testing.assert_array_equal(found, [False] * len(fine) + [True] * len(wrong))
