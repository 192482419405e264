"""The loss comparison at the operating points that a design names: every
strategy with every modulator.

The currents and budgets are those of loss maps (`compare_drives`): the field is weakened within the
linear range of each modulator. A strategy that cannot make a point has no losses there and takes no
part in the choice of the best.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import AnyStrategy, LoadPoint, LossSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.names import ModulationName
from dqforge.machines.phase_machines.phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_drives, least
from dqforge.optimizer.losses.phase_comparison import PhaseBudget, PhaseDrive, compare_phases

# What the total counts; the bridge is left out where nothing is known of its switch.
LossScope = Literal["drive", "without-bridge"]


@dataclass(frozen=True, slots=True)
class LossComparison:
    """Losses of S strategies with M modulators at P operating points.

    Args:
        strategies, modulations, points: Labels of the three axes.
        budget: Losses, arrays of the shape (S, M, P); NaN where the torque is out of reach.
        reached: Whether the strategy makes the torque within its limits, shape (S, M, P).
        most: Torque in N m that is made there, shape (S, M, P): what is asked for, or as near as
            the limits allow.
        saving: Total loss saved, in percent of that of the first strategy with the first modulator,
            shape (S, M, P); NaN where either of the two is not feasible or the first has no loss.
        best_strategy, best_modulation: Indices of the feasible alternative with the least total
            loss, shape (P,), or -1 where none is feasible. Of equally good alternatives the first,
            in the order of the labels.
        scope: What the total counts.
        legs: Half bridges and neutral of a machine with any back-EMF, arrays (S, M, P) and (S, M,
            P, L) as in `PhaseBudget`; None for others.
    """

    strategies: tuple[AnyStrategy, ...]
    modulations: tuple[ModulationName, ...]
    points: tuple[LoadPoint, ...]
    budget: DriveBudget
    reached: BoolArray
    most: FloatArray
    saving: FloatArray
    best_strategy: NDArray[np.intp]
    best_modulation: NDArray[np.intp]
    scope: LossScope = "drive"
    legs: PhaseBudget | None = None

    @property
    def usable(self) -> BoolArray:
        """True where the torque is made, the voltage can be, and every temperature is steady and
        permitted.
        """
        return self.reached & self.budget.feasible

    @property
    def best_labels(self) -> tuple[tuple[AnyStrategy, ModulationName] | None, ...]:
        """Strategy and modulator with the least total loss at each point, or
        None where none is feasible.
        """
        indices = zip(self.best_strategy.tolist(), self.best_modulation.tolist(), strict=True)
        return tuple(
            (self.strategies[s], self.modulations[m]) if s >= 0 else None for s, m in indices
        )


def compare_points(
    machine: Machine,
    inverter: Inverter,
    losses: LossSettings,
    *,
    i_max: float,
    options: BudgetOptions | None = None,
    margin: float = 0.0,
    phases: AnyPhaseMachine | None = None,
) -> LossComparison:
    """Complete budgets of every strategy with every modulator at every point.

    Args:
        machine, inverter: The drive; without a device the bridge is left out of the total.
        losses: Operating points, strategies and modulators.
        i_max: Current limit in A (peak).
        options: What is counted beside copper, conduction and switching loss.
        margin: Share of the voltage that is kept free for control.
        phases: The machine in phase quantities where its back-EMF has any shape: its rules take the
            place of strategies, its topology that of three legs.
    """
    torque = np.array([point.torque for point in losses.points])
    omega_m = np.array([point.omega_m for point in losses.points])
    alternatives = Alternatives(losses.strategies, losses.modulations, (inverter.f_sw,))
    legs: PhaseBudget | None = None
    if phases is None:
        found = compare_drives(
            machine,
            inverter,
            torque,
            omega_m,
            alternatives,
            i_max=i_max,
            options=options,
            margin=margin,
        )
    else:
        chosen = BudgetOptions() if options is None else options
        drive = PhaseDrive(phases, machine, inverter, i_max, chosen, margin)
        both = compare_phases(drive, torque, omega_m, alternatives)
        found, legs = both.drives, both.legs
    labels = found.alternatives
    reached = found.reached[:, :, 0]
    made = found.budget.torque[:, :, 0]
    budget = _blanked(found.budget, reached)
    total = np.where(reached & budget.feasible, budget.total, np.inf)
    best = least(total[:, :, None])
    count = len(labels.modulations)
    return LossComparison(
        strategies=labels.strategies,
        modulations=labels.modulations,
        points=losses.points,
        budget=budget,
        reached=reached,
        most=made,
        saving=_saving(total),
        best_strategy=np.where(best >= 0, best // count, -1),
        best_modulation=np.where(best >= 0, best % count, -1),
        scope="drive" if inverter.device is not None else "without-bridge",
        legs=None if legs is None else _of_one_frequency(legs, budget, reached),
    )


def _of_one_frequency(legs: PhaseBudget, budget: DriveBudget, reached: BoolArray) -> PhaseBudget:
    """Legs (S, M, 1, P, ...) as (S, M, P, ...), NaN where the torque is out of reach."""

    def kept(values: FloatArray) -> FloatArray:
        one = values[:, :, 0]
        mark = reached if one.ndim == reached.ndim else reached[..., None]
        return np.where(mark, one, np.nan)

    return PhaseBudget(
        budget=budget,
        legs=legs.legs,
        leg_loss=kept(legs.leg_loss),
        leg_temperature=kept(legs.leg_temperature),
        neutral_current=kept(legs.neutral_current),
        neutral_ripple=kept(legs.neutral_ripple),
        link_demand=kept(legs.link_demand),
    )


def _blanked(budget: DriveBudget, reached: BoolArray) -> DriveBudget:
    """Budgets (S, M, 1, P) as (S, M, P), with NaN for the numbers of points that are out of
    reach.
    """
    columns: dict[str, Any] = {}
    for part in fields(DriveBudget):
        values = getattr(budget, part.name)[:, :, 0]
        columns[part.name] = (
            values if values.dtype == np.bool_ else np.where(reached, values, np.nan)
        )
    return DriveBudget(**columns)


def _saving(total: FloatArray) -> FloatArray:
    """Compute the saving in percent of the first alternative.

    Total loss (S, M, P), infinite where not feasible.
    """
    first = np.broadcast_to(total[:1, :1], total.shape)
    valid = np.isfinite(total) & np.isfinite(first) & (first > 0.0)
    return np.where(
        valid, 100.0 * (1.0 - np.where(valid, total, 0.0) / np.where(valid, first, 1.0)), np.nan
    )
