"""Settings of the program around the emitted functions (paper 001, appendix D).

The program removes the offsets of the current sensors before the first start, brings an encoder to
the rotor or lets the start-up do without one, runs, stops on a slope and ends in named faults.
"""

from __future__ import annotations

import math
from typing import Literal

from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.records import dataclass

# What leads the rotor: the start-up without an encoder, or an encoder whose edges are captured, or
# counted, or whose angle the speed observer sees.
Kind = Literal["start-up", "edges", "counts", "observer"]
_OFFSET_TIME, _OFFSET_LIMIT = 0.1, 0.05  # in s; of the current limit
_TRIP = 1.5  # over the current limit
_LOW_LINK, _HIGH_LINK = 0.5, 1.3  # over the dc link's voltage
_ALIGN_SHARE, _DAMPING = 0.5, 0.4  # of the current limit; ratio of the swing
_STOP_TIME = 1.0  # from the largest speed to rest, in s
_REST = 0.01  # of the largest speed: slower counts as at rest


@dataclass(frozen=True, slots=True)
class ApplicationPlan:
    """Settings of the program.

    Args:
        kind: What leads the rotor.
        ratio: Current samples per sample of the speed controller.
        offset_samples, offset_limit: Samples of which the mean is the offset of a sensor, and the
            largest one in A.
        trip_current, v_dc_min, v_dc_max: Limits in A and V.
        align_current, align_samples, align_damping: Current in A and samples of the alignment of an
            encoder, per step, and the current against the turning rotor in A per rad/s
            (mechanical).
        counts, pole_pairs: Counts per revolution (0 without an encoder), and electrical turns in
            it.
        stop_step, rest: Change of the speed reference per current sample while it stops, and the
            speed below which the drive counts as at rest, both mechanical in rad/s.
    """

    kind: Kind
    ratio: int
    offset_samples: int
    offset_limit: float
    trip_current: float
    v_dc_min: float
    v_dc_max: float
    align_current: float
    align_samples: int
    align_damping: float
    counts: int
    pole_pairs: int
    stop_step: float
    rest: float


def _led_by(design: Design) -> tuple[Kind, int]:
    """What leads the rotor, and lines of its encoder per revolution, 0 without one."""
    if design.control.start_up is not None:
        return "start-up", 0
    assert design.control.speed_loop is not None
    measurement = design.control.speed_loop.measurement
    if measurement is not None:
        return "counts" if measurement.method == "counts" else "edges", measurement.lines
    assert design.simulation is not None
    return "observer", design.simulation.encoder.lines


def application_plan(design: Design) -> ApplicationPlan | None:
    """Settings of the program that a design asks for, None where it asks for none.

    Args:
        design: With ``export.application``, for which it has a speed loop, and a start-up or an
            encoder.
    """
    control, machine = design.control, design.machine
    if design.export.application is None:
        return None
    assert control.speed_loop is not None
    (kind, lines), linear = _led_by(design), linearised(machine)
    largest = control.bases.speed if machine.omega_m_max is None else machine.omega_m_max
    align = _ALIGN_SHARE * design.i_max
    time = alignment_time(linear, align)
    return ApplicationPlan(
        kind=kind,
        ratio=control.speed_loop.ratio,
        offset_samples=max(int(_OFFSET_TIME / control.t_s), 16),
        offset_limit=_OFFSET_LIMIT * design.i_max,
        trip_current=_TRIP * design.i_max,
        v_dc_min=_LOW_LINK * design.inverter.v_dc,
        v_dc_max=_HIGH_LINK * design.inverter.v_dc,
        align_current=align,
        align_samples=math.ceil(time / control.t_s),
        align_damping=machine.pole_pairs * alignment_damping(linear, align, _DAMPING),
        counts=4 * lines,
        pole_pairs=machine.pole_pairs,
        stop_step=largest * control.t_s / _STOP_TIME,
        rest=_REST * largest,
    )


# How long a rotor swings about a current that holds it: theta'' = -(p K_T I/J) sin theta.

_LEAST, _SWINGS = 0.3, 3.0  # in s; swings about the current


def swing_time(machine: LinearMachine, current: float) -> float:
    """Time of a small swing in s.

    Args:
        machine: With an inertia.
        current: That holds the rotor, in A.
    """
    torque = machine.torque_per_ampere * current
    return 2.0 * math.pi / math.sqrt(machine.pole_pairs * torque / (machine.inertia or 0.0))


def alignment_time(machine: LinearMachine, current: float) -> float:
    """Time in s that an alignment is given, per step.

    Args:
        machine: With an inertia.
        current: That holds the rotor, in A.
    """
    return max(_LEAST, _SWINGS * swing_time(machine, current))


def alignment_damping(machine: LinearMachine, current: float, damping: float) -> float:
    """Current across in A per rad/s (electrical) against the turning rotor, for a damping ratio.

    Args:
        machine: With an inertia.
        current: That holds the rotor, in A.
        damping: Ratio of the swing.
    """
    return 2.0 * damping * current * swing_time(machine, current) / (2.0 * math.pi)
