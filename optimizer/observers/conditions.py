"""What the observer of a design has to live with: its own loads, tolerances and dead time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import Machine, linearised, torque_from_flux
from dqforge.optimizer.observers.parts import Disturbances, Load, usual_disturbances
from dqforge.optimizer.observers.reduced_order import TrainingBox, usual_training_box
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

_SHARES = (0.5, 1.0, -0.5, -1.0)


def loads_of(design: Design) -> tuple[Load, ...]:
    """Half and the whole of the largest torque by the currents of the design, motoring,
    then braking.
    """
    return loads_at(design, _SHARES)


def loads_at(design: Design, shares: Sequence[float]) -> tuple[Load, ...]:
    """Loads by the currents of the design.

    Args:
        design: The drive.
        shares: Torques over the largest one, at most 1; negative ones brake.
    """
    machine = design.machine
    choice = CurrentChoice(machine, design.operation.strategy, design.i_max)
    sizes = np.unique(np.abs(shares))
    points = choice.points(sizes * choice.largest_torque())
    found = dict(zip(sizes.tolist(), zip(points.i_d, points.i_q, strict=True), strict=True))
    pairs = [(found[abs(share)], -1.0 if share < 0.0 else 1.0) for share in shares]
    return tuple(_load(machine, float(d), sign * float(q)) for (d, q), sign in pairs)


def _load(machine: Machine, i_d: float, i_q: float) -> Load:
    jet = machine.jet(np.array([i_d]), np.array([i_q]))
    l_d = float(jet.l_dd[0])
    l_q = float(jet.l_qq[0] if i_q == 0.0 else jet.psi_q[0] / i_q)
    return Load(i_d, i_q, l_d, l_q, float(jet.psi_d[0]) - l_d * i_d)


def lost_voltage(design: Design) -> tuple[float, float]:
    """Least and largest amplitude in V of what the dead time takes from the fundamental.

    The emitted control compensates no dead time: the whole of it counts. A design that names
    ``control.tolerances.dead_time`` says from what to what its own compensation is wrong.
    """
    inverter, tolerances = design.inverter, design.control.tolerances
    least, most = (0.0, 0.0) if tolerances is None else tolerances.limits("dead_time")
    if least == most == 0.0:
        least = most = inverter.dead_time
    volts = inverter.lost_per_dead_time
    return volts * least, volts * most


def training_box(design: Design, omega_max: float) -> TrainingBox:
    """What an observer that learns is trained on; ``omega_max`` in rad/s (electrical).

    The tolerances of the design where it names them; of the dead time none to all of it, or what
    its compensation is named to miss.
    """
    tolerances = design.control.tolerances
    least, most = lost_voltage(design)
    i_d = min(load.i_d for load in loads_of(design))
    box = usual_training_box(most, design.i_max, omega_max, i_d)
    if least != most:
        box = replace(box, lost=(least, most))
    if tolerances is None:
        return box
    return replace(
        box,
        r_s=tolerances.limits("r_s"),
        l_d=tolerances.limits("l_d"),
        l_q=tolerances.limits("l_q"),
        psi_pm=tolerances.limits("psi_pm"),
    )


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
    values = (np.asarray(x) for x in (psi_d, psi_q, load.i_d, load.i_q))
    return float(torque_from_flux(machine.pole_pairs, *values))
