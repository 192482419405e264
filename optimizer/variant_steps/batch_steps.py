"""Steps of many machines at once: largest torque, fit, loops, losses; of machines that saturate the
largest torque.

Each takes what varies as columns and says which rows it answers; the others, whose message or field
weakening only the single path knows, are left to that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ControlSettings, LossSettings
from dqforge.machines.dq_machines.machine_batch import MachineBatch, faults
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.scaled_machines import ScaledMachines
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Strategy
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.closed_margins import CurrentMargins
from dqforge.optimizer.loops.loop_axes.current_loop_axis import (
    BY_SEARCH,
    CurrentLoopAxis,
    tuned_current_loops,
)
from dqforge.optimizer.loops.loop_axes.speed_loop_axis import tuned_speed_loops
from dqforge.optimizer.loops.loop_batch import BatchMargins
from dqforge.optimizer.loops.vendor_methods import is_vendor
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.losses.machine_axis import (
    STRATEGIES,
    AxisBudgets,
    budgets_over_machines,
    drive_axis,
)
from dqforge.optimizer.machine_batch.batch_currents import (
    currents_of_size,
    largest_torques,
)
from dqforge.optimizer.machine_batch.fit_batch import fit_references, why_not_in_batch
from dqforge.optimizer.machine_batch.scaled_loci import scaled_loci
from dqforge.optimizer.variant_steps.asked_steps import Asked
from dqforge.optimizer.variant_steps.loss_columns import LossRows, loss_columns, mapped
from dqforge.optimizer.variant_steps.loss_rows import point_weights
from dqforge.optimizer.variant_steps.map_scales import SCALED_FIELDS
from dqforge.optimizer.variant_steps.outputs import FIT_PATHS, LOOP_QUANTITIES, Step

# Errors of a fit that columns have; what a form costs in copper only the single path knows.
BATCH_ERRORS = ("i_d", "i_q", "torque", "torque_relative")
Column = FloatArray | NDArray[np.int32]  # Numbers, or places in the words of a choice, of N rows.


@dataclass(frozen=True, slots=True, eq=False)
class BatchRows:
    """N variants of a drive with constant inductances, or with factors of one flux map.

    Args:
        base: The design, for everything that does not vary.
        columns: What varies by the names ``machine.<field>`` and ``inverter.<field>``, arrays of
            shape (N,).
        asked: What the study asks for.
    """

    base: Design
    columns: Mapping[str, FloatArray]
    asked: Asked

    @property
    def count(self) -> int:
        """Number of rows N."""
        return int(next(iter(self.columns.values())).size)

    def of(self, section: str) -> dict[str, FloatArray]:
        """Columns of machine or inverter by the names of their fields."""
        start = f"{section}."
        return {
            name.removeprefix(start): values
            for name, values in self.columns.items()
            if name.startswith(start)
        }

    @property
    def sound(self) -> BoolArray:
        """Rows whose values a machine may have, (N,)."""
        wrong = faults(self.of("machine")).values()
        return np.asarray(~np.any([*wrong, np.zeros(self.count, np.bool_)], axis=0))

    @property
    def saturates(self) -> bool:
        """Whether the machine has a flux map."""
        return isinstance(self.base.machine, SaturatedMachine)

    def scaled_machines(self, fine: BoolArray) -> ScaledMachines:
        """The machines of some rows over the flux map of the base, with the current limit of drive
        and inverter together.

        Args:
            fine: Which rows, (N,).
        """
        machine = self.base.machine
        assert isinstance(machine, SaturatedMachine)
        columns = {
            name: values[fine]
            for name, values in self.of("machine").items()
            if name in SCALED_FIELDS
        }
        limit = self.of("inverter").get("i_max", self.base.inverter.i_max)
        if limit is not None:
            own = columns.get("i_max", np.full(int(np.sum(fine)), machine.i_max))
            limits = np.broadcast_to(limit, (self.count,))[fine]
            columns["i_max"] = np.minimum(own, limits)
        return ScaledMachines.varied(machine, int(np.sum(fine)), columns)

    def _linear(self) -> LinearMachine:
        assert isinstance(self.base.machine, LinearMachine)
        return self.base.machine

    def drawn_machines(self) -> tuple[MachineBatch | ScaledMachines, BoolArray]:
        """The machines of the rows that are machines at all, and which rows these are, (N,)."""
        fine = self.sound
        if self.saturates:
            return self.scaled_machines(fine), fine
        columns = {name: values[fine] for name, values in self.of("machine").items()}
        return MachineBatch.varied(self._linear(), int(np.sum(fine)), columns), fine

    def machines(self) -> tuple[MachineBatch, BoolArray]:
        """The machines with the current limit of drive and inverter together, and which of them
        are machines at all, (N,): the others stand there as the base.
        """
        machine, fine = self._linear(), self.sound
        sound = {
            name: np.where(fine, values, getattr(machine, name))
            for name, values in self.of("machine").items()
        }
        sound["i_max"] = (
            np.full(self.count, machine.i_max) if "i_max" not in sound else sound["i_max"]
        )
        limit = self.of("inverter").get("i_max", self.base.inverter.i_max)
        if limit is not None:
            sound["i_max"] = np.minimum(sound["i_max"], limit)
        return MachineBatch.varied(machine, self.count, sound), fine


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """What a step found.

    Args:
        columns: By name of the output, shape (N,).
        done: Rows that are answered, (N,).
        obstacles: Of rows that break a limit of the drive: which one.
    """

    columns: Mapping[str, Column]
    done: BoolArray
    obstacles: Mapping[int, str] = field(default_factory=dict)

    def taken(self) -> dict[str, Column]:
        """The columns of the rows that are answered."""
        return {name: values[self.done] for name, values in self.columns.items()}


def batch_limits(rows: BatchRows) -> Filled | None:
    """Largest torque and its currents; None where a voltage limits them.

    Args:
        rows: The variants.
    """
    if rows.base.operation.omega_m is not None:
        return None
    if rows.saturates:
        return _scaled_limits(rows)
    machines, fine = rows.machines()
    strategy = rows.base.operation.strategy
    most = largest_torques(machines, strategy)
    i_d, i_q = currents_of_size(machines, strategy, machines.i_max)
    columns: dict[str, Column] = {
        "reference.torque_max": most,
        "reference.i_d": i_d,
        "reference.i_q": i_q,
    }
    return Filled(columns, fine & np.isfinite(most))


def _scaled_limits(rows: BatchRows) -> Filled | None:
    """The ends of the loci of machines over one flux map; None where these are no optima."""
    if rows.base.operation.strategy != "mtpa":
        return None
    fine = rows.sound
    loci = scaled_loci(rows.scaled_machines(fine))
    names = ("reference.torque_max", "reference.i_d", "reference.i_q")
    columns: dict[str, Column] = {}
    for name, values in zip(names, (loci.torque, loci.i_d, loci.i_q), strict=True):
        whole = np.full(rows.count, np.nan)
        whole[fine] = values[-1]
        columns[name] = whole
    done = fine.copy()
    done[fine] = loci.solved
    return Filled(columns, done)


def batch_fits(rows: BatchRows) -> Filled | None:
    """Errors of the current references; None where columns do not have the form or method.

    Args:
        rows: The variants.
    """
    base = rows.base
    asked = {output.quantity for output in rows.asked.of_step("fit")}
    if (
        rows.saturates
        or base.operation.omega_m is not None
        or why_not_in_batch(base.fit) is not None
    ):
        return None
    if not asked <= {*BATCH_ERRORS, "path"}:
        return None
    machines, fine = rows.machines()
    found = fit_references(machines, base.fit, base.operation.strategy)
    columns: dict[str, Column] = {
        f"fit.error.{name}": getattr(found.errors, name) for name in BATCH_ERRORS
    }
    columns["fit.path"] = np.full(rows.count, FIT_PATHS.index("batch"), dtype=np.int32)
    return Filled(columns, fine & found.solved)


def batch_current_loops(rows: BatchRows) -> Filled | None:
    """Gains and margins of both current loops; None where these are searched for, or judged over
    tolerances.

    Args:
        rows: The variants.
    """
    control = rows.base.control
    method = control.current_loop.method
    if rows.saturates or method == BY_SEARCH or is_vendor(method) or control.tolerances is not None:
        return None
    machines, fine = rows.machines()
    found = _current_loops(machines, control)
    columns: dict[str, Column] = {}
    for name, loop in found.items():
        columns |= _loop_columns(name, loop.kp, loop.ki, loop.margins, loop.margins.stable)
    return Filled(_with_least(columns), fine & found["i_d"].holds & found["i_q"].holds)


def batch_all_loops(rows: BatchRows) -> Filled | None:
    """Gains and margins of all loops; None where the speed loop runs on an observer or on edges of
    an encoder, or where more is asked of the loops than these.

    Args:
        rows: The variants.
    """
    control = rows.base.control
    settings = control.speed_loop
    more = (control.observer, control.start_up, control.firmware, control.tolerances)
    if any(each is not None for each in more) or control.references.any:
        return None
    currents = batch_current_loops(rows)
    if settings is None or currents is None or control.current_loop.schedule:
        return currents if not control.current_loop.schedule else None
    if settings.method == BY_SEARCH or settings.measurement is not None:
        return None
    machines, _ = rows.machines()
    q_axis = _current_loops(machines, control)["i_q"]
    found = tuned_speed_loops(q_axis, machines.inertia, machines.friction, settings)
    own = _loop_columns("speed", found.kp, found.ki, found.margins, found.stable)
    return Filled(_with_least({**currents.columns, **own}), currents.done & found.holds)


def _current_loops(machines: MachineBatch, control: ControlSettings) -> dict[str, CurrentLoopAxis]:
    return {
        "i_d": tuned_current_loops(machines.r_s, machines.l_d, control.t_s, control.current_loop),
        "i_q": tuned_current_loops(machines.r_s, machines.l_q, control.t_s, control.current_loop),
    }


def _loop_columns(
    name: str,
    kp: FloatArray,
    ki: FloatArray,
    margins: CurrentMargins | BatchMargins,
    stable: BoolArray,
) -> dict[str, Column]:
    """Columns of one loop."""
    own: dict[str, FloatArray] = {"kp": kp, "ki": ki, "stable": stable.astype(np.float64)}
    return {
        f"gains.{name}.{quantity}": own[quantity] if quantity in own else getattr(margins, quantity)
        for quantity in LOOP_QUANTITIES
    }


def _with_least(columns: dict[str, Column]) -> dict[str, Column]:
    """The same with the least phase margin of all loops."""
    margins = [values for name, values in columns.items() if name.endswith(".phase_margin")]
    return columns | {"gains.phase_margin": np.min(margins, axis=0)}


def batch_losses(rows: BatchRows) -> Filled | None:
    """Losses at the points; None where their currents are solved for one machine at a time.

    Args:
        rows: The variants.
    """
    base, losses = rows.base, rows.base.losses
    if rows.saturates or losses is None or not losses.points:
        return None
    strategies = [name for name in STRATEGIES if name in losses.strategies]
    if len(strategies) != len(losses.strategies):
        return None
    machines, fine = rows.machines()
    varied = rows.of("inverter")
    found = budgets_over_machines(
        drive_axis(machines, base.inverter, v_dc=varied.get("v_dc"), f_sw=varied.get("f_sw")),
        np.array([point.torque for point in losses.points]),
        np.array([point.omega_m for point in losses.points]),
        strategies,
        losses.modulations,
        options=budget_options(base),
        margin=base.operation.voltage_margin,
    )
    columns = loss_columns(_loss_rows(losses, strategies, found), rows.asked.of_step("losses"))
    done = fine & found.exact & ~columns.missing
    return Filled(
        columns.columns, done, {at: words for at, words in columns.obstacles.items() if done[at]}
    )


def _loss_rows(
    losses: LossSettings, strategies: Sequence[Strategy], found: AxisBudgets
) -> LossRows:
    """Budgets (N, S, M, 1, P) as rows, in the design's order of strategies."""
    order = [strategies.index(name) for name in losses.strategies if name in STRATEGIES]

    def by_row(values: NDArray[Any]) -> NDArray[Any]:
        return np.moveaxis(values[:, :, :, 0][:, order], 0, -1)

    return LossRows(
        losses.strategies,
        losses.modulations,
        losses.points,
        mapped(found.budget, by_row),
        by_row(found.reached),
        point_weights(losses.points),
    )


# What can be computed for many machines at once.
BATCH_STEPS: Mapping[Step, Callable[[BatchRows], Filled | None]] = {
    "limit": batch_limits,
    "fit": batch_fits,
    "current-loops": batch_current_loops,
    "speed-loop": batch_all_loops,
    "losses": batch_losses,
}
