"""Machines over one flux map against machines with maps of their own."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.flux_map import SaturatedMachine, ScaledMachines
from dqforge.machines.errors import InputError
from dqforge.optimizer.losses.drive_budget import DriveBudget, drive_budget

NAME = "baldor-pmsyrm-5k6"


def nominal() -> SaturatedMachine:
    machine = catalogue.load(NAME).machine
    assert isinstance(machine, SaturatedMachine)
    return machine


def drawn(count: int) -> ScaledMachines:
    rng = np.random.default_rng(2)
    names = ("magnet", "inductance_d", "inductance_q", "current")
    columns = {name: rng.uniform(0.85, 1.15, count) for name in names}
    return ScaledMachines.varied(nominal(), count, columns | {"r_s": rng.uniform(0.5, 0.8, count)})


def test_flux_and_its_derivatives_are_those_of_a_map_of_its_own() -> None:
    machines = drawn(4)
    i_d, i_q = np.random.default_rng(1).uniform(-20.0, 20.0, (2, 50, 4))
    jet, torque = machines.jet(i_d, i_q), machines.torque(i_d, i_q)
    flux, known = machines.flux(i_d, i_q), machines.known(i_d, i_q)
    voltage = machines.voltage(i_d, i_q, np.full(4, 300.0))
    for row in range(4):
        own = machines.machine(row)
        at = i_d[:, row], i_q[:, row]
        one = own.jet(*at)
        for part in fields(one):
            alone = getattr(one, part.name)
            error = np.max(np.abs(getattr(jet, part.name)[:, row] - alone))
            assert error < 1e-10 * np.max(np.abs(alone)), part.name
        np.testing.assert_allclose(flux[0][:, row], own.flux(*at)[0], atol=1e-13)
        np.testing.assert_allclose(flux[1][:, row], own.flux(*at)[1], atol=1e-13)
        np.testing.assert_allclose(torque[:, row], own.torque(*at), atol=1e-11)
        single = own.voltage(*at, np.full(50, 300.0))
        np.testing.assert_allclose(np.array(voltage)[..., row], single, atol=1e-10)
        np.testing.assert_array_equal(known[:, row], own.known(*at))
    plain = ScaledMachines.varied(nominal(), 1, {}).machine(0)
    np.testing.assert_array_equal(plain.flux_map.psi_d, nominal().flux_map.psi_d)


def test_each_scale_moves_what_it_is_named_for() -> None:
    base = nominal()
    for name, moved in (
        ("magnet", (1.1, 1.0, 1.0)),
        ("inductance_d", (1.0, 1.1, 1.0)),
        ("inductance_q", (1.0, 1.0, 1.1)),
        ("current", (1.1, 1.0, 1.0)),  # the magnet's flux scales with what saturates it
    ):
        one = ScaledMachines.varied(base, 1, {name: [1.1]}).machine(0)
        found = one.psi_pm / base.psi_pm, one.l_d / base.l_d, one.l_q / base.l_q
        assert found == pytest.approx(moved, rel=1e-9), name


def test_budgets_are_those_of_machines_with_maps_of_their_own() -> None:
    machines, design = drawn(3), catalogue.load(NAME)
    i_d, i_q, speed = np.array([[-6.0, -3.0], [9.0, 5.0], [90.0, 150.0]])
    whole = drive_budget(
        machines.repeated(2),
        design.inverter,
        np.tile(i_d, 3)[np.newaxis],
        np.tile(i_q, 3)[np.newaxis],
        np.tile(speed, 3)[np.newaxis],
        ("svpwm",),
    )
    single = [
        drive_budget(
            machines.machine(row), design.inverter, i_d, i_q, speed[np.newaxis], ("svpwm",)
        )
        for row in range(3)
    ]
    for part in fields(DriveBudget):
        parts = np.concatenate([getattr(one, part.name) for one in single], axis=-1)
        np.testing.assert_allclose(getattr(whole, part.name), parts, 1e-9, 1e-12)


def test_wrong_columns_are_refused() -> None:
    with pytest.raises(InputError, match="inductance_q of machine 1 is 0; expected a positive"):
        ScaledMachines.varied(nominal(), 2, {"inductance_q": [1.0, 0.0]})
    with pytest.raises(InputError, match="no column l_d; there are magnet"):
        ScaledMachines.varied(nominal(), 2, {"l_d": [1.0, 1.0]})
    with pytest.raises(InputError, match=r"r_s has the shape \(1,\)"):
        ScaledMachines.varied(nominal(), 2, {"r_s": [1.0]})
