"""The comparison at points with every kind of loss: the parts make up the total, as in the budget of the drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, make_design

from dqforge.machines.machine_loss import MachineLoss
from dqforge.machines.settings import LoadPoint, LossSettings
from dqforge.optimizer.drive_budget import PARTS, BudgetOptions, drive_budget
from dqforge.optimizer.mtpa import mtpa_currents
from dqforge.optimizer.solution import solve_losses
from dqforge.reports.figures import to_svg
from dqforge.reports.figures_losses import plot_losses
from dqforge.reports.labels import part_label, shown_parts
from dqforge.reports.tables import losses_tables

IRON = MachineLoss.measured(
    frequency=400.0,
    flux=0.1,
    hysteresis=80.0,
    eddy=120.0,
    resistance_ratio=1.5,
    resistance_frequency=600.0,
    magnet=60.0,
    magnet_frequency=600.0,
    magnet_current=200.0,
)
POINTS = (LoadPoint(130.0, 300.0), LoadPoint(40.0, 500.0))


def test_every_part_is_that_of_the_drive_budget_and_they_make_up_the_total() -> None:
    design = make_design()
    inverter = replace(design.inverter, capacitor_esr=2e-3)
    design = replace(design, machine_loss=IRON, inverter=inverter, losses=LossSettings(POINTS))
    found = solve_losses(design)
    assert found is not None
    budget = found.budget
    parts = sum(getattr(budget, part) for part in PARTS)
    assert budget.total == pytest.approx(parts, rel=1e-12)
    torque = np.array([point.torque for point in POINTS])
    currents = mtpa_currents(IPM, torque)
    omega = np.array([point.omega_m for point in POINTS])
    options = BudgetOptions(IRON, None, 2e-3)
    direct = drive_budget(design.machine, inverter, *currents, omega, found.modulations, options=options)
    for part in PARTS:
        assert getattr(budget, part)[1] == pytest.approx(getattr(direct, part)[:, 0], rel=1e-6), part
    assert set(shown_parts(budget)) >= {"copper", "iron", "magnet", "conduction", "switching", "capacitor"}
    drawn, table = to_svg(plot_losses(design, found)), losses_tables(design, found)[0]
    for part in shown_parts(budget):
        assert part_label(part) in drawn
        assert f"{part_label(part)} W" in table.columns


def test_what_is_nothing_is_not_shown() -> None:
    found = solve_losses(replace(make_design(), losses=LossSettings(POINTS)))
    assert found is not None
    assert shown_parts(found.budget) == ("copper", "conduction", "switching")
