"""The speed and position observer that a design asks for."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.names import SPEED_OBSERVER
from dqforge.optimizer.observers.conditions import conditions
from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver, reduced_order_observer
from dqforge.optimizer.observers.tuning import PositionObserver, tune_position_observer


def solve_observer(design: Design) -> tuple[ReducedOrderObserver | None, PositionObserver | None]:
    """The observer of the speed, or that of the position, which the design asks for."""
    machine, control = design.machine, design.control
    wanted = control.observer
    if wanted is None:
        return None, None
    if wanted.method == SPEED_OBSERVER and wanted.pole is not None:
        return reduced_order_observer(machine, wanted.pole, control.t_s), None
    omega_m = machine.omega_m_max if machine.omega_m_max is not None else control.bases.speed
    omega_max = omega_m * machine.pole_pairs
    known = conditions(design, omega_max)
    return None, tune_position_observer(
        linearised(machine), wanted, control.t_s, design.inverter.v_dc, omega_max, known
    )
