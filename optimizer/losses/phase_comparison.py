"""Rules for the currents of a phase machine compared by their losses, at any number of points.

What `compare_drives` is for dq machines: the strategies of the design give sinusoidal currents
(one row ``dq`` where the machine has no saliency), and dqx, dqy (with a neutral) and ``limited``,
the least copper loss within voltage and current, follow. The bridge is that of the topology, each
leg by its own duty cycle and current.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design.settings import AnyStrategy
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.modulation.dead_time import dead_time_factor
from dqforge.machines.names import ModulationName, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.phase_machines.salient_phase_machine import AnyPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import sine_share
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.losses.drive_budget import BudgetOptions
from dqforge.optimizer.losses.drive_comparison import (
    Alternatives,
    DriveComparison,
    least,
    strategy_currents,
)
from dqforge.optimizer.losses.leg_budgets import (
    PhaseBudget,
    joined_phase_budgets,
    stacked_phase_budgets,
)
from dqforge.optimizer.losses.phase_budget import CENTRED, phase_budget
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits
from dqforge.optimizer.waveforms.phase_currents import dq_waveform, unit_currents
from dqforge.optimizer.waveforms.pointwise_currents import pointwise_currents
from dqforge.optimizer.waveforms.solver import solve_waveforms

_EXCESS = 1e-6


_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class PhaseComparison:
    """Budgets of a phase machine with the legs behind them.

    ``legs`` has the axes (S, M) of strategies and modulators before those of `PhaseBudget`.
    """

    drives: DriveComparison
    legs: PhaseBudget


@dataclass(frozen=True, slots=True)
class PhaseDrive:
    """A phase machine and what feeds it.

    ``fundamental`` is the machine in dq coordinates, with the mean of any saliency.
    """

    machine: AnyPhaseMachine
    fundamental: Machine
    inverter: Inverter
    i_max: float
    options: BudgetOptions
    margin: float

    def usable_link(self, frequency: float) -> float:
        """Volts of the link in V that are left by dead time and margin at a carrier in Hz."""
        left = float(dead_time_factor(CENTRED, self.inverter.dead_time, frequency))
        return self.inverter.v_dc * left * (1.0 - self.margin)


def phase_rows(drive: PhaseDrive, strategies: tuple[AnyStrategy, ...]) -> tuple[AnyStrategy, ...]:
    """Rows of the comparison for the strategies that a design names.

    Args:
        drive: Machine and inverter.
        strategies: Those of dq machines that the design names.
    """
    plain = isinstance(drive.machine, PhaseMachine)
    rows: list[AnyStrategy] = ["dq"] if plain else list(strategies)
    rows.append("dqx")
    if TOPOLOGIES[drive.inverter.topology].neutral:
        rows.append("dqy")
    return (*rows, "limited") if plain else tuple(rows)


def compare_phases(
    drive: PhaseDrive, torque: FloatArray, omega_m: FloatArray, alternatives: Alternatives
) -> PhaseComparison:
    """Budgets of every rule with every modulator at every frequency, at P points.

    Args:
        drive: Machine, inverter and limits.
        torque, omega_m: In N m and rad/s, shape (P,).
        alternatives: What a design names: its strategies become rows by `phase_rows`; modulators
            matter on three legs without a neutral, elsewhere the extremes are centred.
    """
    names = (
        alternatives.modulations if TOPOLOGIES[drive.inverter.topology].modulated else (CENTRED,)
    )
    labels = Alternatives(
        phase_rows(drive, alternatives.strategies), names, alternatives.frequencies
    )
    found, reached = [], []
    for strategy in labels.strategies:
        rows, made = [], []
        for frequency in labels.frequencies:
            currents, kept = rule_currents(drive, strategy, torque, omega_m, frequency)
            rows.append([_budget(drive, currents, omega_m, name, frequency) for name in names])
            made.append(kept)
        by_name = [joined_phase_budgets([row[m] for row in rows]) for m in range(len(names))]
        found.append(stacked_phase_budgets(by_name))
        reached.append(np.broadcast_to(np.stack(made), (len(names), len(made), torque.size)))
    legs, kept_all = stacked_phase_budgets(found), np.stack(reached)
    total = np.where(kept_all & legs.budget.feasible, legs.budget.total, np.inf)
    drives = DriveComparison(labels, torque, omega_m, legs.budget, kept_all, least(total))
    return PhaseComparison(drives, legs)


def _budget(
    drive: PhaseDrive,
    currents: FloatArray,
    omega_m: FloatArray,
    name: ModulationName,
    frequency: float,
) -> PhaseBudget:
    return phase_budget(
        drive.machine,
        drive.inverter,
        currents,
        omega_m,
        modulation=name,
        frequencies=np.array([frequency]),
        options=drive.options,
        friction=drive.fundamental.friction,
    )


def rule_currents(
    drive: PhaseDrive,
    strategy: AnyStrategy,
    torque: FloatArray,
    omega_m: FloatArray,
    frequency: float,
) -> tuple[FloatArray, BoolArray]:
    """Phase currents (P, 3, N) in A of one row, NaN where there are none, and whether they make
    the torque.

    Args:
        drive: Machine, inverter and limits.
        strategy: The row.
        torque, omega_m: In N m and rad/s, shape (P,).
        frequency: Carrier in Hz, whose dead time the link pays.
    """
    if strategy == "limited":
        return _limited(drive, torque, omega_m, frequency)
    if strategy not in ("dqx", "dqy"):
        return _sinusoids(drive, strategy, torque, omega_m, frequency)
    try:
        if isinstance(drive.machine, PhaseMachine):
            wanted = torque[:, None, None] * unit_currents(drive.machine, strategy)
        else:
            way: Topology = "three-wire" if strategy == "dqx" else "six-leg"
            wanted = pointwise_currents(drive.machine, torque, way)
    except NoSolutionError:
        missing = np.full((torque.size, 3, drive.machine.angles), np.nan)
        return missing, np.zeros(torque.size, dtype=np.bool_)
    peak = np.max(np.abs(wanted), axis=(1, 2))
    share = np.minimum(1.0, drive.i_max / np.where(peak > 0.0, peak, 1.0))
    return share[:, None, None] * wanted, np.asarray(share >= 1.0 - _EXCESS)


def _sinusoids(
    drive: PhaseDrive,
    strategy: AnyStrategy,
    torque: FloatArray,
    omega_m: FloatArray,
    frequency: float,
) -> tuple[FloatArray, BoolArray]:
    """Currents that are constant in dq, the field weakened within the topology's voltage."""
    i_d, i_q, reached = strategy_currents(
        drive.fundamental,
        "mtpa" if strategy == "dq" else strategy,
        torque,
        omega_m,
        v_max=drive.usable_link(frequency) * sine_share(drive.inverter.topology),
        i_max=drive.i_max,
        options=drive.options,
    )
    angles, turns = drive.machine.angles, drive.machine.turns
    pairs = zip(i_d.tolist(), i_q.tolist(), strict=True)
    return np.stack([dq_waveform(d, q, angles, turns) for d, q in pairs]), reached


def _limited(
    drive: PhaseDrive, torque: FloatArray, omega_m: FloatArray, frequency: float
) -> tuple[FloatArray, BoolArray]:
    """Least copper loss within all limits; the link is taken shorter where what the programmes do
    not know (iron, a warm winding) needs more of it.
    """
    assert isinstance(drive.machine, PhaseMachine)
    link = np.full(torque.shape, drive.usable_link(frequency))
    currents = np.full((torque.size, 3, drive.machine.angles), np.nan)
    todo = np.arange(torque.size)
    for _ in range(_ROUNDS):
        for volts in np.unique(link[todo]):
            places = todo[link[todo] == volts]
            limits = WaveformLimits(float(volts), drive.inverter.topology, drive.i_max)
            try:
                solved = solve_waveforms(drive.machine, torque[places], omega_m[places], limits)
            except NoSolutionError:
                continue
            currents[places] = solved.currents
        found = _budget(drive, currents[todo], omega_m[todo], CENTRED, frequency)
        over = found.budget.known[0] & ~found.budget.linear[0]
        todo = todo[over]
        if not todo.size:
            break
        excess = found.link_demand[0, over] / drive.usable_link(frequency)
        link[todo] /= excess * (1.0 + _EXCESS)
    return currents, np.all(np.isfinite(currents), axis=(1, 2))
