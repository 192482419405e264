"""The loss comparison at points with every kind of loss: what `drive_budget` counts, in the shape of `compare`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.inverter import Inverter
from dqforge.machines.modulation import modulation_index
from dqforge.machines.settings import LossSettings, Strategy
from dqforge.machines.synchronous import Machine
from dqforge.optimizer.drive_budget import BudgetOptions, DriveBudget, drive_budget
from dqforge.optimizer.loss_budget import LossBudget, LossComparison, ranked, stack_currents

_SAME = (
    "torque",
    "copper",
    "conduction",
    "switching",
    "total",
    "junction_temperature",
    "voltage",
    "linear",
    "cool_enough",
    "thermal_residual",
    "ripple_copper",
    "iron",
    "ripple_iron",
    "magnet",
    "dead_time",
    "capacitor",
)
"""What both budgets call by one name."""


def complete_comparison(
    machine: Machine,
    inverter: Inverter,
    losses: LossSettings,
    currents: Mapping[Strategy, tuple[ArrayLike, ArrayLike]],
    options: BudgetOptions,
) -> LossComparison:
    """Complete budgets of every strategy with every modulator at every point.

    Parameters
    ----------
    machine, inverter, losses, currents:
        As in `dqforge.optimizer.loss_budget.compare`: the currents are taken as they are, without field weakening.
    options:
        What is counted beside copper, conduction and switching loss.

    Returns
    -------
    LossComparison
    """
    i_d, i_q = stack_currents(losses, currents)
    omega_m = np.array([point.omega_m for point in losses.points])
    budgets = [
        drive_budget(machine, inverter, i_d[s], i_q[s], omega_m, losses.modulations, options=options)
        for s in range(len(losses.strategies))
    ]
    return ranked(losses, _joined(budgets, inverter))


def _joined(budgets: list[DriveBudget], inverter: Inverter) -> LossBudget:
    """Budgets (M, 1, P) of S strategies as one with arrays (S, M, P)."""

    def stacked(name: str) -> Any:
        return np.stack([getattr(budget, name)[:, 0] for budget in budgets])

    columns: dict[str, Any] = {name: stacked(name) for name in _SAME}
    return LossBudget(
        inverter=stacked("conduction") + stacked("switching") + stacked("dead_time"),
        modulation_index=modulation_index(stacked("voltage"), inverter.v_dc),
        thermally_stable=stacked("steady"),
        **columns,
    )
