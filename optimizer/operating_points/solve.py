"""The strategy's currents over torque, as a design asks for them."""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.flux_map import TorqueRipple, torque_ripple
from dqforge.machines.records import dataclass
from dqforge.optimizer.operating_points.current_choice import (
    CurrentChoice,
    OperatingPoints,
    SpeedPoint,
    domain_end,
)
from dqforge.optimizer.operating_points.mtpa_locus import PerUnitBase, per_unit_base

_CURVE_POINTS = 201


@dataclass(frozen=True, slots=True)
class CopperSaving:
    """Copper loss in W of the chosen strategy and of i_d = 0 at the largest torque
    in N m that both can make.
    """

    torque: float
    chosen: float
    id0: float

    @property
    def relative(self) -> float:
        """What is saved, as a share of the loss at i_d = 0."""
        return 1.0 - self.chosen / self.id0


@dataclass(frozen=True, slots=True)
class Curves:
    """Operating points from zero to the end of the torque domain, for the design's
    strategy and for i_d = 0.

    ``id0`` is None for a machine without magnet and at a speed; ``base`` is None where the MTPA
    curve has no scale of its own. ``speed`` is the one speed for which the field is weakened, with
    the voltage limit there, None without. ``saving`` is None where the strategy is i_d = 0 or
    nothing else than it. ``turning`` is the torque over the rotor angle at the chosen currents,
    None where the machine's data know none.
    """

    chosen: OperatingPoints
    id0: OperatingPoints | None
    base: PerUnitBase | None
    speed: SpeedPoint | None
    saving: CopperSaving | None
    turning: TorqueRipple | None = None


def current_choice(design: Design) -> CurrentChoice:
    """What the design's currents are chosen by."""
    operation = design.operation
    if operation.omega_m is None:
        return CurrentChoice(design.machine, operation.strategy, design.i_max)
    point = SpeedPoint(operation.omega_m, design.v_max)
    return CurrentChoice(design.machine, operation.strategy, design.i_max, point)


@on_design("operation")
def solve_curves(design: Design, torque_max: float | None = None) -> Curves:
    """Operating points on an even grid of torques up to ``torque_max`` N m,
    or to the end of the fit's domain.

    Args:
        design: The design.
        torque_max: Largest torque in N m, None for the end of the fit's domain.
    """
    choice, machine = current_choice(design), design.machine
    end = torque_max if torque_max is not None else domain_end(choice, design.fit)
    torque = np.linspace(0.0, end, _CURVE_POINTS)
    compared = (
        machine.psi_pm > 0.0 and choice.speed is None
    )  # at a speed i_d = 0 may not keep the voltage limit
    id0 = CurrentChoice(machine, "id0", design.i_max).points(torque) if compared else None
    linear = choice.closed_form
    has_base = linear is not None and linear.psi_pm > 0.0 and linear.saliency != 0.0
    base = per_unit_base(linear) if linear is not None and has_base else None
    chosen = choice.points(torque)
    differs = design.strategy != "id0" and machine.saliency != 0.0
    saving = _copper_saving(chosen, id0) if id0 is not None and differs else None
    turning = torque_ripple(machine, chosen.i_d, chosen.i_q)
    return Curves(chosen, id0, base, choice.speed, saving, turning)


def _copper_saving(chosen: OperatingPoints, id0: OperatingPoints) -> CopperSaving | None:
    """What currents save against those of i_d = 0 for the same torques.

    None where those lose nothing, or make no torque within the current limit.
    """
    made = np.flatnonzero(~id0.limited & ~chosen.limited)
    if made.size == 0:
        return None
    last = int(made[-1])
    found = CopperSaving(
        float(chosen.torque[last]), float(chosen.copper[last]), float(id0.copper[last])
    )
    return found if found.id0 > 0.0 else None
