"""Losses of one drive with all modulators and carrier frequencies that the rows of a study have."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import LossSettings
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.names import ModulationName
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.losses.drive_budget import BudgetOptions, DriveBudget
from dqforge.optimizer.losses.drive_comparison import Alternatives, compare_drives
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.losses.machine_axis import STRATEGIES, budgets_over_machines, drive_axis
from dqforge.optimizer.variant_steps.loss_columns import mapped

_MOST_ALTERNATIVES = 20_000  # Points times modulators times frequencies of one table of losses.


@dataclass(frozen=True, slots=True)
class LossGrid:
    """Modulators and carrier frequencies in Hz that the rows of a study have: what is computed
    together for all rows whose drives are otherwise the same.
    """

    modulations: tuple[ModulationName, ...] = ()
    frequencies: tuple[float, ...] = ()

    def holds(self, design: Design) -> bool:
        """Whether a design's alternatives are among them, and few enough for one table."""
        losses = design.losses
        if losses is None or design.phase_machine is not None:
            return False
        size = len(self.modulations) * len(self.frequencies) * len(losses.points)
        return (
            size <= _MOST_ALTERNATIVES
            and set(losses.modulations) <= set(self.modulations)
            and design.inverter.f_sw in self.frequencies
        )


@dataclass(frozen=True, slots=True, eq=False)
class LossTable:
    """Losses of one drive with every modulator and carrier frequency of a study.

    Args:
        modulations: M modulators.
        budget: Arrays of the shape (S, M, F, P), in the order of strategies, frequencies and
            points.
        reached: Whether the currents make the torque, of the same shape.
    """

    modulations: tuple[ModulationName, ...]
    budget: DriveBudget
    reached: BoolArray


@dataclass(frozen=True, slots=True)
class LossDrive:
    """What the losses of a design depend on, beside the points and what is compared there."""

    machine: Machine
    inverter: Inverter
    i_max: float
    options: BudgetOptions
    margin: float
    phases: AnyPhaseMachine | None


def loss_drive(design: Design, f_sw: float | None = None) -> LossDrive:
    """What the losses of a design depend on.

    Args:
        design: The design.
        f_sw: Carrier frequency in Hz that stands for all; None for the design's own.
    """
    inverter = replace(design.inverter, current_sensing=None)
    return LossDrive(
        design.machine,
        inverter if f_sw is None else replace(inverter, f_sw=f_sw),
        design.i_max,
        budget_options(design),
        design.operation.voltage_margin,
        design.phase_machine,
    )


def drive_table(drive: LossDrive, losses: LossSettings, grid: LossGrid) -> LossTable:
    """Losses with every modulator and frequency of a study.

    Args:
        drive: The drive.
        losses: Points and strategies.
        grid: Modulators and frequencies.

    Raises:
        DqforgeError: One of the alternatives is refused.
    """
    return _linear_table(drive, losses, grid) or _any_table(drive, losses, grid)


def _points(losses: LossSettings) -> tuple[FloatArray, FloatArray]:
    """Torques in N m and speeds in rad/s, shape (P,)."""
    return (
        np.array([point.torque for point in losses.points]),
        np.array([point.omega_m for point in losses.points]),
    )


def _linear_table(drive: LossDrive, losses: LossSettings, grid: LossGrid) -> LossTable | None:
    """Losses of a linear machine, its frequencies as so many drives; None where one of them
    belongs on the single path.
    """
    strategies = [name for name in STRATEGIES if name in losses.strategies]
    if not isinstance(drive.machine, LinearMachine) or len(strategies) < len(losses.strategies):
        return None
    machine = replace(drive.machine, i_max=drive.i_max)
    found = budgets_over_machines(
        drive_axis(
            MachineBatch.of([machine] * len(grid.frequencies)),
            drive.inverter,
            f_sw=np.array(grid.frequencies),
        ),
        *_points(losses),
        strategies,
        grid.modulations,
        options=drive.options,
        margin=drive.margin,
    )
    if not np.all(found.exact):
        return None
    order = [strategies.index(name) for name in losses.strategies if name in STRATEGIES]

    def by_frequency(values: NDArray[Any]) -> NDArray[Any]:
        return np.moveaxis(values[:, :, :, 0][:, order], 0, 2)

    budget = mapped(found.budget, by_frequency)
    return LossTable(grid.modulations, budget, by_frequency(found.reached))


def _any_table(drive: LossDrive, losses: LossSettings, grid: LossGrid) -> LossTable:
    """Losses of any machine."""
    torque, omega_m = _points(losses)
    found = compare_drives(
        drive.machine,
        drive.inverter,
        torque,
        omega_m,
        Alternatives(losses.strategies, grid.modulations, grid.frequencies),
        i_max=drive.i_max,
        options=drive.options,
        margin=drive.margin,
    )
    return LossTable(grid.modulations, found.budget, found.reached)
