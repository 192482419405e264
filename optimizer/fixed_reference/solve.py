"""The integer references that a design asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS

if TYPE_CHECKING:
    from dqforge.optimizer.current_reference.fit import ReferenceFit
    from dqforge.optimizer.field_weakening.fit import WeakeningFit
    from dqforge.optimizer.fixed_reference.fit import FixedReferenceFit


@on_design("export.control")
def solve_fixed_references(
    design: Design, fit: ReferenceFit, weakening: WeakeningFit | None
) -> tuple[FixedReferenceFit, ...]:
    """Integer references for the fixed-point formats of the control functions; none where each
    sign of the torque has a reference of its own (the halves of a flux map).

    Args:
        design: The design.
        fit: Its current reference over torque: strategy, speed and end of the domain.
        weakening: Its reference over torque, voltage and speed, None where it asks for none.

    Raises:
        NoSolutionError: As `fit_line` and `fit_mesh`.
    """
    if design.halves is not None:
        return ()
    widths = [FIXED_WIDTHS[name] for name in design.export.control if name in FIXED_WIDTHS]
    return tuple(_solve(design, fit, weakening, width) for width in widths)


def _solve(
    design: Design, fit: ReferenceFit, weakening: WeakeningFit | None, width: int
) -> FixedReferenceFit:
    if weakening is not None:
        from dqforge.optimizer.fixed_control.design import dc_link
        from dqforge.optimizer.fixed_reference.fit import fit_mesh

        return fit_mesh(design, weakening.domain, fit.torque_max, width, dc_link(design, width))
    permitted = fit.errors.torque_relative
    from dqforge.optimizer.fixed_reference.fit import fit_line
    from dqforge.optimizer.operating_points.solve import current_choice

    return fit_line(design, current_choice(design), fit.torque_max, permitted, width)
