"""Corners of the box within which a drive on its observer must hold: tolerances, loads,
dead time.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.settings import SPEED_ERROR
from dqforge.machines.dq_machines.synchronous import LinearMachine, linearised
from dqforge.machines.records import dataclass
from dqforge.optimizer.loops.observed_margins import Corner
from dqforge.optimizer.observed_drive.drive_cases import RELATIVE, DriveCases, drive_cases
from dqforge.optimizer.observers.conditions import lost_voltage
from dqforge.optimizer.observers.tuning_numbers import usual_disturbances
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

if TYPE_CHECKING:
    from dqforge.machines.arrays import FloatArray
    from dqforge.machines.design.design import Design

LOAD_SHARE = 0.3  # Load of the corners beside none, over the largest torque.


@dataclass(frozen=True, slots=True)
class CornerBox:
    """All corners of a design.

    ``named`` says whether the design names tolerances; else the box is the usual one of the
    observers' conditions. ``limits`` are the least and largest relative errors by name, exact
    values left out; ``loads`` in N m; ``lost`` the voltages in V that the dead time may cost,
    empty where it costs none. ``v_max`` in V is the phase amplitude that the link has,
    ``most_error`` the largest error of the speed that counts as holding, relative.
    """

    named: bool
    limits: dict[str, tuple[float, float]]
    loads: tuple[float, ...]
    lost: tuple[float, ...]
    v_max: float = np.inf
    most_error: float = np.inf

    def corners(self, *, dead_time: bool, braking: bool = False) -> tuple[Corner, ...]:
        """Every combination of the limits with every load, and with the dead time or without;
        ``braking`` with the loads that drive the shaft instead.
        """
        errors = [
            dict(zip(self.limits, values, strict=True)) for values in product(*self.limits.values())
        ]
        lost = self.lost if dead_time else (0.0,)
        loads = tuple(-load for load in self.loads if load) if braking else self.loads
        return tuple(Corner(*parts) for parts in product(errors, loads, lost))


def corner_box(design: Design) -> CornerBox:
    """Corners of `control.tolerances`; where a design names none, of the usual errors of R, L and
    psi.

    Dead time counts as for the observer alone: the whole of it, or what `control.tolerances` says
    that its compensation leaves.
    """
    machine, tolerances = design.machine, design.control.tolerances
    if tolerances is None:
        usual = usual_disturbances(linearised(machine), design.inverter.v_dc, 1.0)
        limits = {name: usual.limits(name) for name in ("r_s", "l_d", "l_q", "psi_pm")}
    else:
        limits = {
            name: tolerances.limits(name)  # type: ignore[arg-type]
            for name in RELATIVE
        }
    choice = CurrentChoice(linearised(machine), design.operation.strategy, design.i_max)
    observer = design.control.observer
    lost = tuple(dict.fromkeys(value for value in lost_voltage(design) if value != 0.0))
    return CornerBox(
        tolerances is not None,
        {name: pair for name, pair in limits.items() if pair != (0.0, 0.0)},
        (0.0, LOAD_SHARE * choice.largest_torque()),
        lost,
        # a weakened field needs less voltage than the currents that are followed here
        np.inf if design.weakening is not None else design.v_max,
        SPEED_ERROR if observer is None else observer.max_speed_error,
    )


# Errors within which a drive on a tracker is judged: the others change what it measures as well,
# which its loop does not know.
TRACKED = ("r_s", "psi_pm", "inertia")


def tracked_box(design: Design) -> CornerBox:
    """Corners of a drive on a tracker: those of `corner_box` in R, psi and J, without dead time."""
    box = corner_box(design)
    limits = {name: pair for name, pair in box.limits.items() if name in TRACKED}
    return replace(box, limits=limits, lost=())


def cases_of(machine: LinearMachine, corners: tuple[Corner, ...], omega: float) -> DriveCases:
    """The drives of all corners at an electrical speed in rad/s, shape (corners,)."""
    names = dict.fromkeys(name for corner in corners for name in corner.errors)

    def column(name: str) -> FloatArray:
        return np.array([corner.errors.get(name, 0.0) for corner in corners])

    return drive_cases(
        machine,
        np.full(len(corners), omega),
        np.array([corner.load for corner in corners]),
        {name: column(name) for name in names},
        np.array([corner.lost for corner in corners]),
    )
