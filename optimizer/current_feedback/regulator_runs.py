"""A regulator at operating points: switching frequency, error, distortion and every watt.

The bridge of the simulation is ideal: its losses are those of the device at the instants and
currents of the run, and change nothing in it. Dead time is left out. Copper is that of the
simulated currents, so that power in, losses and shaft power are three figures that must agree but
for what the field of the ripple has stored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import DqforgeError
from dqforge.machines.losses.bridge_heat import at_temperature, junction_balance
from dqforge.machines.losses.machine_budget import machine_budget
from dqforge.machines.names import ModulationName
from dqforge.machines.plants.current_feedback import simulate_currents
from dqforge.machines.plants.current_trace import CurrentTrace
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_feedback.regulator_numbers import RegulatorPlan, bridge_of
from dqforge.optimizer.current_feedback.trace_losses import trace_losses
from dqforge.optimizer.losses.drive_budget import (
    BudgetOptions,
    DriveBudget,
    drive_budget,
    known_bridge,
    switched_iron,
)
from dqforge.optimizer.losses.loss_map import budget_options

# Electrical periods that are observed, and those before them: runs start on their references.
PERIODS, SETTLING = 1, 0

_NUMBERS = (
    "frequency",
    "lowest",
    "highest",
    "rms_error",
    "largest_error",
    "distortion",
    "stored",
)


@dataclass(frozen=True, slots=True)
class WorkingPoints:
    """Points at which regulators are run, arrays of the shape (P,).

    Torque asked for in N m, mechanical speed in rad/s, and the currents of the design's strategy in
    A (peak).
    """

    torque: FloatArray
    omega_m: FloatArray
    i_d: FloatArray
    i_q: FloatArray

    def part(self, index: slice) -> WorkingPoints:
        """Some of the points."""
        return WorkingPoints(
            self.torque[index], self.omega_m[index], self.i_d[index], self.i_q[index]
        )

    def and_further(self, others: WorkingPoints) -> WorkingPoints:
        """These points, and others behind them."""
        return WorkingPoints(
            *(
                np.concatenate([getattr(self, name), getattr(others, name)])
                for name in ("torque", "omega_m", "i_d", "i_q")
            )
        )


@dataclass(frozen=True, slots=True)
class RegulatorRun:
    """What a regulator does at P points, arrays of the shape (P,); NaN where it could not be run.

    Args:
        plan: The regulator.
        points: Where it was run.
        frequency, lowest, highest: Switching frequencies in Hz: mean of the legs, and the ends of
            its range.
        rms_error, largest_error: Of a phase current in A.
        distortion: Of the phase currents, over the fundamental.
        stored: Power in W that the field takes up between first and last instant.
        budget: Powers and temperatures.
        obstacles: Why a point could not be run, or empty texts.
    """

    plan: RegulatorPlan
    points: WorkingPoints
    frequency: FloatArray
    lowest: FloatArray
    highest: FloatArray
    rms_error: FloatArray
    largest_error: FloatArray
    distortion: FloatArray
    stored: FloatArray
    budget: DriveBudget
    obstacles: tuple[str, ...]

    def part(self, index: slice) -> RegulatorRun:
        """The run at some of its points."""
        budget: dict[str, Any] = {
            part.name: getattr(self.budget, part.name)[index] for part in fields(DriveBudget)
        }
        columns = {name: getattr(self, name)[index] for name in _NUMBERS}
        return RegulatorRun(
            plan=self.plan,
            points=self.points.part(index),
            **columns,
            budget=DriveBudget(**budget),
            obstacles=self.obstacles[index],
        )


def run_regulator(design: Design, plan: RegulatorPlan, points: WorkingPoints) -> RegulatorRun:
    """Simulate a regulator at points of constant speed, and count what it loses.

    Args:
        design: The drive.
        plan: The regulator.
        points: P points, at least one; speeds other than 0.
    """
    tracks = plan.method == "trajectory"
    parts = [slice(k, k + 1) for k in range(points.torque.size)] if tracks else [slice(None)]
    try:
        return _joined([_run(design, plan, points.part(part)) for part in parts])
    except DqforgeError:
        # Some point cannot be run: each by itself, so that the others are known.
        single = [slice(k, k + 1) for k in range(points.torque.size)]
        return _joined([_run_or_reason(design, plan, points.part(part)) for part in single])


def _run_or_reason(design: Design, plan: RegulatorPlan, points: WorkingPoints) -> RegulatorRun:
    try:
        return _run(design, plan, points)
    except DqforgeError as error:
        nan = np.full(points.torque.shape, math.nan)
        columns: dict[str, Any] = {
            part.name: np.zeros(nan.shape, dtype=np.bool_) if part.type == "BoolArray" else nan
            for part in fields(DriveBudget)
        }
        budget = DriveBudget(**columns)
        return RegulatorRun(plan, points, *(nan,) * 7, budget, (error.message,) * nan.size)


def _joined(runs: Sequence[RegulatorRun]) -> RegulatorRun:
    if len(runs) == 1:
        return runs[0]

    def columns(parts: Sequence[Any], names: Sequence[str]) -> dict[str, Any]:
        return {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}

    budgets = [run.budget for run in runs]
    return RegulatorRun(
        plan=runs[0].plan,
        points=WorkingPoints(
            **columns([run.points for run in runs], ("torque", "omega_m", "i_d", "i_q"))
        ),
        **columns(runs, _NUMBERS),
        budget=DriveBudget(**columns(budgets, [part.name for part in fields(DriveBudget)])),
        obstacles=tuple(text for run in runs for text in run.obstacles),
    )


def _run(design: Design, plan: RegulatorPlan, points: WorkingPoints) -> RegulatorRun:
    electrical = design.machine.pole_pairs * float(np.max(np.abs(points.omega_m))) / (2.0 * math.pi)
    trace = simulate_currents(
        bridge_of(design),
        plan.scheme(electrical),
        points.i_d,
        points.i_q,
        points.omega_m,
        periods=PERIODS,
        settling=SETTLING,
    )
    switching = trace.switching_frequency()
    return RegulatorRun(
        plan,
        points,
        switching.average,
        switching.lowest,
        switching.highest,
        trace.rms_error(),
        trace.largest_error(),
        trace.current_thd(),
        trace.power_balance().stored,
        trace_budget(design, trace, budget_options(design)),
        ("",) * points.torque.size,
    )


def trace_budget(design: Design, trace: CurrentTrace, options: BudgetOptions) -> DriveBudget:
    """Budget of the points of a trace, arrays (P,).

    Args:
        design: Machine, bridge and coolant.
        trace: What the regulator did.
        options: What is counted beside copper, conduction and switching.
    """
    inverter, machine, plant = design.inverter, design.machine, trace.plant
    tables = known_bridge(inverter)
    omega_m = plant.omega_e / machine.pole_pairs
    found = machine_budget(
        machine, plant.i_d, plant.i_q, omega_m, loss=options.machine_loss, heat=options.winding
    )
    lost = trace_losses(tables, trace)
    heat = junction_balance(tables, lost.conduction + lost.switching)
    conduction, switching = (
        3.0 * np.sum(at_temperature(tables.temperatures, part, heat.temperature), axis=(0, 1))
        for part in (lost.conduction, lost.switching)
    )
    power = trace.power_balance()
    warm = found.resistance / machine.r_s if machine.r_s > 0.0 else np.ones(omega_m.shape)
    copper = power.copper * warm
    ripple = 3.0 * found.resistance * lost.ripple_square
    voltage = np.hypot(*machine.voltage(plant.i_d, plant.i_q, plant.omega_e))
    link_square = np.maximum(lost.link_square - (power.dc_link / inverter.v_dc) ** 2, 0.0)
    frequency = trace.switching_frequency().average
    zero, size = np.zeros(omega_m.shape), np.hypot(plant.i_d, plant.i_q)
    losses = {
        "copper": copper - ripple,
        "ripple_copper": ripple,
        "iron": found.iron,
        "ripple_iron": switched_iron(options, voltage, inverter.v_dc, frequency),
        "magnet": found.magnet,
        "conduction": conduction,
        "dead_time": zero,
        "switching": switching,
        "capacitor": options.capacitor_esr * link_square,
    }
    total = sum(losses.values(), zero)
    known = inverter.device is not None
    low, high = tables.temperature_reach
    inside = np.all(
        (heat.temperature >= low - 1e-9) & (heat.temperature <= high + 1e-9), axis=(0, 1)
    )
    return DriveBudget(
        **losses,
        torque=power.shaft / omega_m,
        shaft_power=power.shaft,
        friction=machine.friction * omega_m * omega_m,
        total=total,
        input_power=power.dc_link - power.copper + total,
        junction_temperature=np.max(heat.temperature[:, 0], axis=0) if known else zero + math.nan,
        diode_temperature=np.max(heat.temperature[:, -1], axis=0) if known else zero + math.nan,
        winding_temperature=found.winding_temperature,
        voltage=voltage,
        voltage_error=zero,
        capacitor_current=np.sqrt(link_square),
        ripple_current=np.sqrt(lost.ripple_square),
        thermal_residual=np.max(np.abs(heat.residual), axis=(0, 1)),
        linear=np.ones(omega_m.shape, dtype=np.bool_),
        steady=heat.steady & found.steady,
        cool_enough=np.max(heat.temperature, axis=(0, 1)) <= tables.max_junction_temperature,
        within_tables=(size <= tables.current_reach) & inside,
        known=np.ones(omega_m.shape, dtype=np.bool_),
    )


def modulators_beside(
    design: Design, run: RegulatorRun, modulations: Sequence[ModulationName]
) -> DriveBudget:
    """Budgets (M, P) of modulators at the mean switching frequency of a regulator at each point.

    With the same currents and without dead time, as the regulator. NaN where the regulator could
    not be run.

    Args:
        design: The drive.
        run: The regulator.
        modulations: M modulators.
    """
    inverter = _without_dead_time(design.inverter)
    columns = []
    for p, frequency in enumerate(run.frequency):
        known = bool(np.isfinite(frequency))
        blank = 1.0 if known else math.nan
        columns.append(
            drive_budget(
                design.machine,
                inverter,
                blank * run.points.i_d[p : p + 1],
                blank * run.points.i_q[p : p + 1],
                run.points.omega_m[p : p + 1],
                modulations,
                [frequency if known else inverter.f_sw],
                options=budget_options(design),
            )
        )
    names = [part.name for part in fields(DriveBudget)]
    return DriveBudget(
        **{
            name: np.concatenate([getattr(c, name)[:, 0] for c in columns], axis=1)
            for name in names
        }
    )


def _without_dead_time(inverter: Inverter) -> Inverter:
    return replace(inverter, dead_time=0.0)
