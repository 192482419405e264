"""One design, solved: the current reference, the gains and the loss comparison, each with its evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.settings import Strategy
from dqforge.optimizer.gains import LoopGains, tune_current_loop, tune_speed_loop
from dqforge.optimizer.loss_budget import LossComparison, compare
from dqforge.optimizer.mtpa import OperatingPoints, PerUnitBase, operating_points, per_unit_base, require_torque
from dqforge.optimizer.observer import ReducedOrderObserver, reduced_order_observer
from dqforge.optimizer.reference_fit import Alternative, ReferenceFit, alternatives, domain_end, fit_reference

_CURVE_POINTS = 201


@dataclass(frozen=True, slots=True)
class Curves:
    """Operating points from zero to the end of the torque domain, for the design's strategy and for i_d = 0.

    ``id0`` is None for a machine without magnet; ``base`` is None where the MTPA curve has no scale of its own.
    """

    chosen: OperatingPoints
    id0: OperatingPoints | None
    base: PerUnitBase | None


@dataclass(frozen=True, slots=True)
class GainSet:
    """Gains of both current loops and, where the design asks for them, of the speed loop and the observer."""

    i_d: LoopGains
    i_q: LoopGains
    speed: LoopGains | None
    observer: ReducedOrderObserver | None


@dataclass(frozen=True, slots=True)
class Solution:
    """Everything that a design asks for; ``losses`` is None where it asks for no comparison."""

    design: Design
    curves: Curves
    fit: ReferenceFit
    alternatives: tuple[Alternative, ...]
    gains: GainSet
    losses: LossComparison | None


def solve_curves(design: Design, torque_max: float | None = None) -> Curves:
    """Operating points on an even grid of torques up to ``torque_max`` N m, or to the end of the fit's domain."""
    end = (
        torque_max if torque_max is not None else domain_end(design.machine, design.strategy, design.i_max, design.fit)
    )
    torque = np.linspace(0.0, end, _CURVE_POINTS)
    chosen = operating_points(design.machine, torque, strategy=design.strategy, i_max=design.i_max)
    has_magnet, has_saliency = design.machine.psi_pm > 0.0, design.machine.saliency != 0.0
    id0 = operating_points(design.machine, torque, strategy="id0", i_max=design.i_max) if has_magnet else None
    return Curves(chosen, id0, per_unit_base(design.machine) if has_magnet and has_saliency else None)


def solve_fit(design: Design) -> ReferenceFit:
    """Current reference of the design."""
    return fit_reference(design.machine, design.strategy, design.i_max, design.fit)


def solve_gains(design: Design) -> GainSet:
    """Gains of the design, every loop checked as it is sampled."""
    machine, control = design.machine, design.control
    i_d = tune_current_loop(machine.r_s, machine.l_d, control.t_s, control.current_loop, "i_d")
    i_q = tune_current_loop(machine.r_s, machine.l_q, control.t_s, control.current_loop, "i_q")
    speed = tune_speed_loop(machine, i_q, control) if control.speed_loop is not None else None
    observer = (
        reduced_order_observer(machine, control.observer.pole, control.t_s) if control.observer is not None else None
    )
    return GainSet(i_d, i_q, speed, observer)


def solve_losses(design: Design) -> LossComparison | None:
    """Loss comparison of the design, or None where it asks for none.

    Raises
    ------
    NoSolutionError
        A strategy cannot make a torque of the comparison within the current limit, or a junction runs away.
    """
    losses = design.losses
    if losses is None:
        return None
    torque = np.array([point.torque for point in losses.points])
    currents: dict[Strategy, tuple[np.ndarray, np.ndarray]] = {}
    for strategy in losses.strategies:
        require_torque(design.machine, strategy, design.i_max, float(np.max(np.abs(torque))), "losses.points")
        points = operating_points(design.machine, torque, strategy=strategy, i_max=design.i_max)
        currents[strategy] = (points.i_d, points.i_q)
    return compare(design.machine, design.inverter, losses, currents)


def solve(design: Design) -> Solution:
    """Solve everything that the design asks for.

    Raises
    ------
    InputError, NoSolutionError
        As the single steps do; the message names the section of the design.
    """
    fit = solve_fit(design)
    return Solution(
        design=design,
        curves=solve_curves(design),
        fit=fit,
        alternatives=alternatives(design.machine, design.strategy, design.i_max, fit),
        gains=solve_gains(design),
        losses=solve_losses(design),
    )
