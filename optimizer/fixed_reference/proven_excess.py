"""What integer references can at most exceed their limits by, proven for every code.

The integers put the currents between four nodes, within one code of the convex combination that
they mean. The magnitude of a current is convex, and so is the squared voltage where inductances are
constant: on a combination both lie at most as high as the combination of what they are at the
nodes. Those are known exactly, rounded to the safe side, and it is their combination that the
integers hold to the limit. What is left are the code of the currents, and what the positions within
a cell are rounded by.
"""

from __future__ import annotations

import math

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.field_weakening.voltage_region import LEAST_VOLTAGE
from dqforge.optimizer.fixed_reference.mesh import CurrentMesh

_SLACK = 1e-9  # Share of the limit that stands for what doubles round when nodes are made.


@dataclass(frozen=True, slots=True)
class ProvenExcess:
    """Bounds beyond the limits, relative to them.

    ``current`` holds for all codes. ``voltage`` is that of the phase voltage, resistance drop
    included, from `LEAST_VOLTAGE` of the design's up and for speeds up to the largest in proportion
    to the voltage; None where the voltage limits nothing, and for flux maps, whose squared voltage
    need not be convex.
    """

    current: float
    voltage: float | None


def proven_excess(design: Design, mesh: CurrentMesh, speed: float | None) -> ProvenExcess:
    """Bounds for a mesh.

    Args:
        design: Machine and limits.
        mesh: The integers.
        speed: Largest mechanical speed in rad/s at the design's voltage, None where that limits
            nothing.
    """
    unit = mesh.bases[0] / 2.0 ** (mesh.width - 1)
    currents = _nodes(mesh, mesh.d) * unit, _nodes(mesh, mesh.q) * unit
    away = math.sqrt(2.0) * unit
    most = float(np.max(np.hypot(*currents))) + away
    voltage = None
    if speed is not None and isinstance(design.machine, LinearMachine):
        voltage = _voltage(design, design.machine, mesh, currents, speed)
    return ProvenExcess(most / design.i_max - 1.0 + _SLACK, voltage)


def _nodes(mesh: CurrentMesh, values: tuple[int, ...]) -> FloatArray:
    return np.array(values, dtype=np.float64).reshape(-1, mesh.columns)


def _voltage(
    design: Design,
    machine: LinearMachine,
    mesh: CurrentMesh,
    currents: tuple[FloatArray, FloatArray],
    speed: float,
) -> float | None:
    """Bound of |v|/V - 1; None where even without torque the voltage cannot be kept."""
    assert mesh.voltage is not None
    volts = LEAST_VOLTAGE * design.v_max
    omega = machine.pole_pairs * speed * LEAST_VOLTAGE  # at that voltage
    psi = np.hypot(*machine.flux(*currents))
    size = np.hypot(*currents)
    if (omega * psi[0, -1]) ** 2 + (machine.r_s * size[0, -1]) ** 2 > volts**2 * (1.0 - _SLACK):
        return None
    part = 2.0**-mesh.fraction
    rows = np.array(mesh.torque) * (mesh.bases[3] / 2.0 ** (mesh.width - 1))
    missed = float(np.max(np.abs(machine.torque(*currents) - rows[:, np.newaxis])))
    drop = mesh.voltage.drop
    rounded = abs(drop.error) if drop.mantissa else 1.0
    torque = missed + (rounded + part) * float(rows[-1])
    # All over the squared voltage, where the speed goes with the voltage: largest at the least one.
    share = 2.0 * machine.r_s * omega * torque / (1.5 * machine.pole_pairs) / volts**2
    share += part * (omega / volts) ** 2 * float(np.max(psi[:, :-1] ** 2 - psi[:, 1:] ** 2))
    unit = mesh.bases[0] / 2.0 ** (mesh.width - 1)
    inductance = max(abs(machine.l_d), abs(machine.l_q))
    moved = math.sqrt(2.0) * unit * (machine.r_s + omega * inductance) / volts
    return float(math.sqrt(1.0 + share) - 1.0 + moved + _SLACK)
