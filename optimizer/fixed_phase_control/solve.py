"""The integer control that a design asks for: of its phases, or in rotor coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.control_design.gain_set import GainSet
    from dqforge.optimizer.fixed_control.design import FixedControlFit
    from dqforge.optimizer.fixed_control.transforms import FixedReferences
    from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit

IntegerFit: TypeAlias = "FixedControlFit | FixedPhaseFit"


@on_design("export.control")
def solve_integers(
    design: Design,
    gains: GainSet,
    torque_max: float | None = None,
    references: Mapping[int, FixedReferences] | None = None,
) -> tuple[IntegerFit, ...]:
    """Control functions in the fixed-point formats that the design asks for.

    ``torque_max`` in N m limits the speed loop, ``references`` are current references by the bits
    of their codes. Errors as `fit_control` and `fit_phase_control`.
    """
    widths = [FIXED_WIDTHS[name] for name in design.export.control if name in FIXED_WIDTHS]
    if not widths:
        return ()
    if gains.phases is None:
        from dqforge.optimizer.fixed_control.design import solve_fixed

        return solve_fixed(design, gains, torque_max, references)
    from dqforge.optimizer.fixed_phase_control.design import fit_phase_control

    speed = None if gains.speed is None else (gains.speed, gains.i_q)
    return tuple(fit_phase_control(design, gains.phases.control, width, speed) for width in widths)
