"""The integer control that a design asks for."""

from __future__ import annotations

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.control_design.gain_set import GainSet
from dqforge.optimizer.fixed_control.design import FixedControlFit, fit_controls


@on_design("export.control")
def solve_fixed(design: Design, gains: GainSet) -> tuple[FixedControlFit, ...]:
    """Control functions in the fixed-point formats that the design asks for.

    Errors as `fit_control`.
    """
    return fit_controls(design, (gains.i_d, gains.i_q, gains.speed), gains.observer)
