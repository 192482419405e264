"""The integer control that a design asks for."""

from __future__ import annotations

from collections.abc import Mapping

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_controls
from dqforge.optimizer.fixed_control.step import FixedReferences


@on_design("export.control")
def solve_fixed(
    design: Design,
    gains: GainSet,
    torque_max: float | None = None,
    references: Mapping[int, FixedReferences] | None = None,
) -> tuple[FixedControlFit, ...]:
    """Control functions in the fixed-point formats that the design asks for.

    Arguments and errors as `fit_controls`.
    """
    loops = (gains.i_d, gains.i_q, gains.speed)
    return fit_controls(design, loops, gains.observer, torque_max, references)
