"""Budgets beyond the linear range: the power of the duty cycles, and what the harmonics add."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.modulation.dead_time import low_harmonics
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.modulation.registry import METHODS, SIX_STEP, follows_hexagon
from dqforge.machines.names import OvermodulationName
from dqforge.optimizer.losses.drive_budget import BudgetOptions, drive_budget

DRIVE = catalogue.load("paper000-ipmsm-100kw")
MACHINE: Machine = DRIVE.machine
I_D, I_Q, OMEGA = -120.0, 200.0, 450.0
NAMES = [name for name in MODULATORS if follows_hexagon(name)]
ORDINARY = BudgetOptions()


def at_index(method: OvermodulationName, index: float) -> Inverter:
    """The inverter with the link at which the point needs a share of six-step operation."""
    v_d, v_q = MACHINE.voltage(*(np.array(x) for x in (I_D, I_Q, MACHINE.pole_pairs * OMEGA)))
    v_dc = float(np.hypot(v_d, v_q)) / (index * SIX_STEP)
    return replace(
        DRIVE.inverter, v_dc=v_dc, dead_time=0.0, overmodulation=method, overmodulation_limit=1.0
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("index", [0.92, 0.95, 0.98, 0.9999])
def test_power_is_in_balance_with_every_modulator(method: OvermodulationName, index: float) -> None:
    inverter = at_index(method, index)
    budget = drive_budget(MACHINE, inverter, I_D, I_Q, [OMEGA], NAMES, options=ORDINARY)
    assert np.all(budget.linear)
    assert budget.imbalance == pytest.approx(0.0, abs=2e-4 * float(budget.input_power.max()))
    harmonics = low_harmonics(method, MACHINE, I_D, I_Q, OMEGA, v_dc=inverter.v_dc)
    without = drive_budget(
        MACHINE,
        replace(inverter, overmodulation="none"),
        I_D,
        I_Q,
        [OMEGA],
        NAMES,
        options=ORDINARY,
    )
    assert not np.any(without.linear)
    assert np.all(budget.ripple_copper > harmonics.copper[0])
    assert np.all(budget.ripple_current > harmonics.current[0])
    # carrier ripple shrinks as phases rest: what is left is that of the low harmonics
    rest = np.sqrt(budget.ripple_current**2 - harmonics.current[0] ** 2)
    assert np.all(rest < 1.2 * without.ripple_current)


@pytest.mark.parametrize("method", METHODS)
def test_six_step_operation_does_not_switch(method: OvermodulationName) -> None:
    inverter = at_index(method, 1.0 - 1e-7)
    budget = drive_budget(MACHINE, inverter, I_D, I_Q, [OMEGA], ["svpwm"], options=ORDINARY)
    ordinary = drive_budget(
        MACHINE, at_index("none", 0.9), I_D, I_Q, [OMEGA], ["svpwm"], options=ORDINARY
    )
    assert float(budget.switching[0, 0, 0]) < 0.01 * float(ordinary.switching[0, 0, 0])


def test_ripple_can_be_left_out_and_other_modulators_keep_their_range() -> None:
    inverter = at_index("least-phase-error", 0.95)
    options = BudgetOptions(ripple_resistance=None)
    budget = drive_budget(MACHINE, inverter, I_D, I_Q, [OMEGA], ["svpwm", "spwm"], options=options)
    assert budget.linear[:, 0, 0].tolist() == [True, False]
    assert not np.any(budget.ripple_copper)
