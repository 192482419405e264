"""The speed and position observer that a design asks for."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.names import SPEED_OBSERVER, TRACKER_NAMES

if TYPE_CHECKING:
    from dqforge.optimizer.observers.reduced_order import ReducedOrderObserver
    from dqforge.optimizer.observers.tuning import PositionObserver


def observed_machine(design: Design) -> LinearMachine:
    """The constants that the observer of the position believes in: those without current; of a
    machine that saturates and starts without encoder those at half the largest torque.

    Without current the inductances are up to half as large again: an observer of them locks falsely
    once the drive runs on it alone.

    Args:
        design: The design.
    """
    plain = linearised(design.machine)
    if design.control.start_up is None or plain is design.machine:
        return plain
    from dqforge.optimizer.observers.conditions import loads_of

    load = loads_of(design)[0]
    return replace(plain, l_d=load.l_d, l_q=load.l_q, psi_pm=max(load.psi_pm, 0.0))


def solve_observer(design: Design) -> tuple[ReducedOrderObserver | None, PositionObserver | None]:
    """The observer of the speed, or that of the position, which the design asks for; of trackers
    (`dqforge.optimizer.estimators`) there is none here.
    """
    machine, control = design.machine, design.control
    wanted = control.observer
    if wanted is None or wanted.method in TRACKER_NAMES:
        return None, None
    if wanted.method == SPEED_OBSERVER and wanted.pole is not None:
        from dqforge.optimizer.observers.reduced_order import reduced_order_observer

        return reduced_order_observer(machine, wanted.pole, control.t_s), None
    from dqforge.optimizer.observers.conditions import conditions, training_box
    from dqforge.optimizer.observers.methods.registry import method_named
    from dqforge.optimizer.observers.tuning import tune_position_observer

    omega_m = machine.omega_m_max if machine.omega_m_max is not None else control.bases.speed
    omega_max = omega_m * machine.pole_pairs
    known = conditions(design, omega_max)
    learns = method_named(wanted.method).train is not None
    box = training_box(design, omega_max) if learns else None
    return None, tune_position_observer(
        observed_machine(design), wanted, control.t_s, design.inverter.v_dc, omega_max, known, box
    )
