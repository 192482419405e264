"""The emitted float32 control of a design: that of phase machines where the design has one, else
that of rotor coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dqforge.reports.control.float32_model import ControlModel
from dqforge.reports.control.header import (
    control_files,
    control_from,
    control_programme,
    plain_control,
)
from dqforge.reports.phase_control.control_vectors import phase_control_programme
from dqforge.reports.phase_control.float32_model import PhaseControlModel
from dqforge.reports.phase_control.header import phase_control_files, plain_solution_control
from dqforge.reports.phase_control.plain import phase_control_from

if TYPE_CHECKING:
    from dqforge.optimizer.phase_control.phase_controller import PhaseControl
    from dqforge.optimizer.solution import Solution
    from dqforge.reports.c_code.harness import Programme
    from dqforge.reports.plain_data import PlainData

EmittedModel = ControlModel | PhaseControlModel


def phase_control_of(solution: Solution) -> PhaseControl | None:
    """The current control over the angle, None for machines with a sinusoidal back-EMF."""
    loops = solution.gains.phases
    return None if loops is None else loops.control


def emitted_control_files(solution: Solution) -> dict[str, bytes]:
    """Name and bytes of ``<prefix>_control.h``; raises as `emitted_control_plain`."""
    control = phase_control_of(solution)
    return control_files(solution) if control is None else phase_control_files(solution, control)


def emitted_control_plain(solution: Solution) -> PlainData:
    """What ``result.json`` says of the emitted control.

    Raises:
        InputError: It cannot be emitted; the message says what is instead.
    """
    control = phase_control_of(solution)
    if control is None:
        return plain_control(solution)
    return plain_solution_control(solution, control)


def emitted_control_from(described: Mapping[str, Any], whole: Mapping[str, Any]) -> EmittedModel:
    """Read the control functions back from a result and its part that describes them.

    Raises:
        InputError: The data are not what `emitted_control_plain` makes.
    """
    read = phase_control_from if "frame" in described else control_from
    return read(described, whole)


def emitted_control_programme(model: EmittedModel) -> Programme:
    """The harness of the control functions."""
    if isinstance(model, PhaseControlModel):
        return phase_control_programme(model)
    return control_programme(model)
