"""Rows of a study whose header is fixed: what it makes of every machine."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray, IndexArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.machine_batch import MachineBatch
from dqforge.machines.dq_machines.saturated_machine import SaturatedMachine
from dqforge.machines.dq_machines.scaled_machines import ScaledMachines
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import DqforgeError, InputError
from dqforge.machines.names import ModulationName
from dqforge.machines.records import dataclass
from dqforge.optimizer.exploration.block_rows import BlockRows
from dqforge.optimizer.exploration.exact_rows import put_losses
from dqforge.optimizer.exploration.group_rows import Group
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.variant_steps.asked_steps import Asked
from dqforge.optimizer.variant_steps.batch_steps import BatchRows
from dqforge.optimizer.variant_steps.loss_columns import (
    LossColumns,
    LossRows,
    loss_columns,
    mapped,
)
from dqforge.optimizer.variant_steps.loss_rows import point_weights
from dqforge.optimizer.variant_steps.outputs import Output
from dqforge.optimizer.yields.fixed_header import FixedHeader
from dqforge.optimizer.yields.loss_yield import FixedDrive, header_budget
from dqforge.optimizer.yields.reference_yield import Machines
from dqforge.optimizer.yields.yield_outputs import yield_outputs


@dataclass(frozen=True, slots=True)
class YieldStudy:
    """A header and what is asked of it.

    Args:
        header: What is flashed to every drive.
        asked: What the study asks for.
        nominal: Fields of the inverter that are drawn, with their values in the design itself:
            losses are those at its link and carrier.
    """

    header: FixedHeader
    asked: Asked
    nominal: Mapping[str, float]

    def point_drive(self, design: Design) -> Design:
        """A design with the link and the carrier at which losses are stated."""
        nominal: dict[str, Any] = dict(self.nominal)
        return replace(design, inverter=replace(design.inverter, **nominal))


_DRAWN_FIELDS = {
    "inverter.v_dc": "v_dc",
    "inverter.switching_frequency": "f_sw",
    "inverter.max_current": "i_max",
}


def nominal_inverter(base: Design, drawn: Collection[str]) -> dict[str, float]:
    """Fields of the inverter that are drawn, with their values in the design itself.

    Args:
        base: The design that the study starts from.
        drawn: Keys that are drawn.
    """
    found = {
        name: getattr(base.inverter, name) for key, name in _DRAWN_FIELDS.items() if key in drawn
    }
    return {name: value for name, value in found.items() if value is not None}


def fill_yields(study: YieldStudy, block: BlockRows, group: Group) -> None:
    """Compute all outputs of the machines of a group.

    Args:
        study: Header and outputs.
        block: Filled; rows whose design is refused end there.
        group: The rows.
    """
    if group.variation is not None:
        rows = BatchRows(group.variation.base, group.variation.columns(group.numbers), study.asked)
        machines, fine = rows.drawn_machines()
        voltage = rows.of("inverter").get("v_dc", np.array(rows.base.inverter.v_dc))
        voltage = np.broadcast_to(voltage, (rows.count,))[fine]
        drive = study.point_drive(rows.base)
        _fill(study, block, group.rows[fine], (machines, voltage), drive)
        left = np.flatnonzero(~fine)
    else:
        left = np.arange(group.rows.size)
    for place in left.tolist():
        row = group.rows[place : place + 1]
        try:
            design = group.design(place)
            machines = _one_machine(design)
            voltage = np.array([design.inverter.v_dc])
            _fill(study, block, row, (machines, voltage), study.point_drive(design))
        except DqforgeError as error:
            block.refuse(row, error)


def _one_machine(design: Design) -> Machines:
    """The machine of a design as a batch of one, with its own map where it has one."""
    machine = design.machine
    if design.phase_machine is None and isinstance(machine, LinearMachine):
        return MachineBatch.of([machine])
    if design.phase_machine is None and isinstance(machine, SaturatedMachine):
        return ScaledMachines.varied(machine, 1, {})
    raise InputError("header: a fixed header is tried on machines with sinusoidal back-EMF alone")


def _fill(
    study: YieldStudy,
    block: BlockRows,
    rows: IndexArray,
    drives: tuple[Machines, FloatArray],
    design: Design,
) -> None:
    """Fill in all outputs of machines with their link voltages in V."""
    machines, v_dc = drives
    names = [output.name for output in study.asked.outputs if output.step != "losses"]
    block.put(rows, yield_outputs(study.header, machines, names, v_dc))
    if study.asked.of_step("losses"):
        put_losses(block, rows, _losses(study, machines, design))


def _losses(study: YieldStudy, machines: Machines, design: Design) -> LossColumns:
    """Columns of losses, with the currents of the header, by the inverter of a design."""
    losses, outputs = design.losses, study.asked.of_step("losses")
    if losses is None or not losses.points:
        raise InputError("losses: this variant names no operating points")
    modulations = _modulations(outputs, losses.modulations)
    found = header_budget(
        FixedDrive(study.header, design.inverter, budget_options(design)),
        machines,
        np.array([point.torque for point in losses.points]),
        np.array([point.omega_m for point in losses.points]),
        modulations,
    )
    count = len(losses.points)

    def by_point(values: NDArray[Any]) -> NDArray[Any]:
        return np.swapaxes(values[:, 0].reshape(-1, machines.count, count), -1, -2)[None]

    budget = mapped(found, by_point)
    rows = LossRows(
        ("mtpa",),
        modulations,
        losses.points,
        budget,
        np.ones(budget.total.shape, dtype=np.bool_),
        point_weights(losses.points),
    )
    return loss_columns(rows, outputs)


def _modulations(
    outputs: tuple[Output, ...], listed: tuple[ModulationName, ...]
) -> tuple[ModulationName, ...]:
    """Modulators of the design that the outputs look at: all, unless each names its own."""
    named = {"" if output.point is None else output.point.modulation for output in outputs}
    return listed if "" in named else tuple(name for name in listed if name in named)
