"""Losses of a fixed header on other machines, against the budget of one machine at a time."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from drawn_machines import drawn_machines

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.exploration.yields import FixedDrive, header_budget, nominal_header
from dqforge.optimizer.losses.drive_budget import drive_budget
from dqforge.optimizer.losses.loss_map import budget_options

TORQUE, OMEGA = np.array([130.0, 40.0]), np.array([300.0, 450.0])


@cache
def paper000() -> tuple[Design, FixedDrive]:
    design = catalogue.load("paper000-ipmsm-100kw")
    return design, FixedDrive(nominal_header(design), design.inverter, budget_options(design))


def test_every_machine_has_the_losses_of_its_own_budget() -> None:
    design, drive = paper000()
    assert isinstance(design.machine, LinearMachine)
    drawn = drawn_machines(design.machine, 5, 2)
    found = header_budget(drive, drawn, TORQUE, OMEGA, ("svpwm", "ddt-gdpwm"))
    i_d, i_q = (np.asarray(c, dtype=float) for c in drive.header.reference.currents(TORQUE))
    for row in range(drawn.count):
        single = drive_budget(
            drawn.machine(row),
            design.inverter,
            i_d,
            i_q,
            OMEGA,
            ("svpwm", "ddt-gdpwm"),
            options=drive.options,
        )
        here = slice(2 * row, 2 * row + 2)
        assert np.array_equal(found.total[:, :, here], single.total)
        assert np.array_equal(found.junction_temperature[:, :, here], single.junction_temperature)
        assert np.array_equal(found.torque[:, :, here], single.torque)


def test_the_same_currents_flow_in_every_machine() -> None:
    design, drive = paper000()
    assert isinstance(design.machine, LinearMachine)
    drawn = drawn_machines(design.machine, 3, 2)
    found = header_budget(drive, drawn, TORQUE[:1], OMEGA[:1], ("svpwm",))
    square = found.copper[0, 0] / (1.5 * drawn.r_s)
    assert square == pytest.approx(np.full(3, square[0]), rel=1e-12)
    assert np.ptp(found.torque[0, 0]) > 1.0


def test_losses_keep_within_what_was_found_of_ten_thousand_machines() -> None:
    """Of 1e5 machines of such a production 764.6 to 798.3 W were found at this point."""
    design, drive = paper000()
    assert isinstance(design.machine, LinearMachine)
    drawn = drawn_machines(design.machine, 10_000, 20261122)
    total = header_budget(drive, drawn, TORQUE[:1], OMEGA[:1], ("ddt-gdpwm",)).total[0, 0]
    assert 764.0 < np.min(total) < 766.0
    assert 796.0 < np.max(total) < 799.0
    nominal = replace(design.machine, r_s=2e-3)
    i_d, i_q = (np.asarray(c, dtype=float) for c in drive.header.reference.currents(TORQUE[:1]))
    own = drive_budget(
        nominal, design.inverter, i_d, i_q, OMEGA[:1], ("ddt-gdpwm",), options=drive.options
    )
    assert np.mean(total) == pytest.approx(own.total[0, 0, 0], rel=1e-3)


def test_a_point_beyond_the_end_of_the_header_is_refused() -> None:
    design, drive = paper000()
    assert isinstance(design.machine, LinearMachine)
    drawn = drawn_machines(design.machine, 1, 0)
    with pytest.raises(InputError, match=r"losses\.points\.1: 230 N m is beyond the 200 N m"):
        header_budget(drive, drawn, np.array([130.0, 230.0]), OMEGA, ("svpwm",))
