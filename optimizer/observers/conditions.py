"""What the observer of a design has to live with: its own loads, tolerances and dead time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import Machine, linearised
from dqforge.optimizer.observers.tuning_numbers import Disturbances, Load, usual_disturbances
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

_SHARES = np.array([0.5, 1.0])


_FUNDAMENTAL = 4.0 / np.pi  # of a square wave, over its height


def loads_of(design: Design) -> tuple[Load, ...]:
    """Half and the whole of the largest torque by the currents of the design, motoring,
    then braking.
    """
    machine = design.machine
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)
    points = choice.points(_SHARES * choice.largest_torque())
    pairs = [
        (float(d), sign * float(q))
        for sign in (1.0, -1.0)
        for d, q in zip(points.i_d, points.i_q, strict=True)
    ]
    return tuple(_load(machine, i_d, i_q) for i_d, i_q in pairs)


def _load(machine: Machine, i_d: float, i_q: float) -> Load:
    jet = machine.jet(np.array([i_d]), np.array([i_q]))
    l_d = float(jet.l_dd[0])
    return Load(i_d, i_q, l_d, float(jet.psi_q[0]) / i_q, float(jet.psi_d[0]) - l_d * i_d)


def lost_voltage(design: Design) -> tuple[float, float]:
    """Least and largest amplitude in V of what the dead time takes from the fundamental.

    The emitted control compensates no dead time: the whole of it counts. A design that names
    ``control.tolerances.dead_time`` says from what to what its own compensation is wrong.
    """
    inverter, tolerances = design.inverter, design.control.tolerances
    least, most = (0.0, 0.0) if tolerances is None else tolerances.limits("dead_time")
    if least == most == 0.0:
        least = most = inverter.dead_time
    volts = _FUNDAMENTAL * inverter.f_sw * inverter.v_dc
    return volts * least, volts * most


def conditions(design: Design, omega_max: float) -> Disturbances:
    """Disturbances of a design; ``omega_max`` in rad/s (electrical) is its largest speed.

    Parameters are off by `control.tolerances`, where the design names none by the usual ones; the
    acceleration is that of half the largest torque.
    """
    usual = usual_disturbances(linearised(design.machine), design.inverter.v_dc, omega_max)
    loads, (least, lost) = loads_of(design), lost_voltage(design)
    acceleration, machine = usual.acceleration, design.machine
    if machine.inertia is not None:
        acceleration = machine.pole_pairs * torque_of(machine, loads[0]) / machine.inertia
    found = replace(usual, acceleration=acceleration, lost=lost, lost_least=least, loads=loads)
    tolerances = design.control.tolerances
    if tolerances is None:
        return found
    return replace(
        found, r_s=tolerances.r_s, l_d=tolerances.l_d, l_q=tolerances.l_q, psi_pm=tolerances.psi_pm
    )


def torque_of(machine: Machine, load: Load) -> float:
    """Torque in N m of a load."""
    psi_d, psi_q = load.psi_pm + load.l_d * load.i_d, load.l_q * load.i_q
    return 1.5 * machine.pole_pairs * (psi_d * load.i_q - psi_q * load.i_d)
