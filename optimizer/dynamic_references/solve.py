"""References that move, for a design: what they permit, and the feedback judged."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import ReferenceSettings
from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.optimizer.dynamic_references.voltage_feedback import VoltageFeedback
    from dqforge.optimizer.loops.loop_gains import LoopGains
    from dqforge.optimizer.loops.robustness import DriveBox


@dataclass(frozen=True, slots=True)
class DynamicReferences:
    """What a design asks of the motion of its references.

    Args:
        settings: The slopes, in N m/s and A/s.
        torque_step, current_step: Largest changes per sample in N m and A; infinity without a
            slope.
        torque_time: Time in s from no torque to the largest; 0 without a slope.
        slope_at_rest: What the voltage lets the q current rise by at rest, in A/s.
        speed_step: Largest step of the speed in rad/s that the speed loop answers with the torque
            slope; nan without either.
        feedback: The voltage feedback, None where none is asked for.
    """

    settings: ReferenceSettings
    torque_step: float
    current_step: float
    torque_time: float
    slope_at_rest: float
    speed_step: float
    feedback: VoltageFeedback | None


def dynamic_references(
    design: Design, box: DriveBox, loops: tuple[LoopGains, LoopGains], speed: LoopGains | None
) -> DynamicReferences | None:
    """Slopes and feedback of a design, None where it asks for none.

    ``loops`` are those of i_d and i_q. Errors as `voltage_feedback`.
    """
    wanted, t_s = design.control.references, design.control.t_s
    if not wanted.any:
        return None
    slope, current_slope = wanted.torque_slope, wanted.current_slope
    from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

    most = float(mtpa_locus(design.machine, design.i_max).torque[-1])
    from dqforge.optimizer.dynamic_references.voltage_feedback import (
        answered_step,
        voltage_feedback,
    )

    return DynamicReferences(
        settings=wanted,
        torque_step=math.inf if slope is None else slope * t_s,
        current_step=math.inf if current_slope is None else current_slope * t_s,
        torque_time=0.0 if slope is None else most / slope,
        slope_at_rest=float(design.v_max / np.max(box.nominal[1])),
        speed_step=math.nan
        if slope is None or speed is None
        else answered_step(design, speed, most, slope),
        feedback=None
        if wanted.voltage_feedback is None
        else voltage_feedback(design, box, loops, design.v_max),
    )
