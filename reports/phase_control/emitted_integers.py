"""The emitted control in integers of a design: of its phases where it has them, else that of
rotor coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dqforge.optimizer.fixed_control.step import FixedControl
from dqforge.optimizer.fixed_phase_control.design import FixedPhaseFit
from dqforge.optimizer.fixed_phase_control.integers import FixedPhaseControl
from dqforge.reports.control.fixed_header import (
    control_fixed_files,
    control_fixed_programme,
    plain_fixed_control,
    plain_fixed_evidence,
)
from dqforge.reports.control.fixed_reading import fixed_control_from
from dqforge.reports.control.fixed_tables import control_fixed_html, control_fixed_tables
from dqforge.reports.fixed_reference.mesh_reading import mesh_from
from dqforge.reports.phase_control.fixed_phase_header import (
    phase_fixed_files,
    phase_fixed_programme,
    plain_phase_evidence,
    plain_phase_integers,
)
from dqforge.reports.phase_control.fixed_phase_reading import phase_integers_from
from dqforge.reports.phase_control.fixed_phase_tables import phase_fixed_html, phase_fixed_tables

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.fixed_phase_control.solve import IntegerFit
    from dqforge.reports.c_code.harness import Programme
    from dqforge.reports.pages.html_table import HtmlTable
    from dqforge.reports.pages.table import Table
    from dqforge.reports.plain_data import PlainData

IntegerModel = FixedControl | FixedPhaseControl


def integer_files(design: Design, fit: IntegerFit) -> dict[str, bytes]:
    """Names and bytes of the header in one fixed-point format, and of its test vectors."""
    if isinstance(fit, FixedPhaseFit):
        return phase_fixed_files(design, fit)
    return control_fixed_files(design, fit)


def plain_integers(fit: IntegerFit) -> PlainData:
    """The integers as plain data."""
    if isinstance(fit, FixedPhaseFit):
        return plain_phase_integers(fit.control)
    return plain_fixed_control(fit.control)


def plain_integer_evidence(fit: IntegerFit) -> PlainData:
    """What is proven of the integers, as plain data."""
    return (
        plain_phase_evidence(fit) if isinstance(fit, FixedPhaseFit) else plain_fixed_evidence(fit)
    )


def integers_from(plain: Mapping[str, Any], width: int, result: Mapping[str, Any]) -> IntegerModel:
    """Read the control in words of ``width`` bits back, with the references of the ``result`` that
    it is part of.

    Raises:
        InputError: The data are not what `plain_integers` makes.
    """
    if "shape" in plain:
        return phase_integers_from(plain, width)
    if not plain.get("reference", False):
        return fixed_control_from(plain, width)
    described = result.get(f"reference_q{width - 1}_header")
    return fixed_control_from(plain, width, mesh_from(described or {}, width))


def integer_programme(model: IntegerModel) -> Programme:
    """The harness of the control in integers."""
    if isinstance(model, FixedPhaseControl):
        return phase_fixed_programme(model)
    return control_fixed_programme(model)


def integer_tables(fits: Sequence[IntegerFit]) -> list[Table]:
    """One table per fixed-point format, for the terminal."""
    phases = [fit for fit in fits if isinstance(fit, FixedPhaseFit)]
    others = [fit for fit in fits if not isinstance(fit, FixedPhaseFit)]
    return control_fixed_tables(others) + phase_fixed_tables(phases)


def integer_html(fits: Sequence[IntegerFit]) -> list[HtmlTable]:
    """One table per fixed-point format, for the report."""
    phases = [fit for fit in fits if isinstance(fit, FixedPhaseFit)]
    others = [fit for fit in fits if not isinstance(fit, FixedPhaseFit)]
    return control_fixed_html(others) + phase_fixed_html(phases)
