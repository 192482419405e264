"""The section ``fit``: what may be written, what is made of it, and what is checked across it."""

from __future__ import annotations

from pydantic import Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.sections.operation import OperationSection
from dqforge.machines.design.settings import (
    FitBudget,
    FitSettings,
    PerUnitBases,
    settings_from,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, largest_torque_within
from dqforge.machines.entries.former_keys import former
from dqforge.machines.entries.kinds import (
    ByteCount,
    Listing,
    Section,
    SmallShare,
    Torque,
)
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.errors import about
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    BreakpointMode,
    Core,
    FitForm,
    FitMethod,
    NumberFormat,
)
from dqforge.machines.units.quantities import format_quantity

_FIT = FitSettings()


class FitSection(Section):
    """How the current references become code."""

    form: FitForm = Field(default=_FIT.form, description="what is evaluated on the controller")
    method: FitMethod = Field(default=_FIT.method, description="how the coefficients are found")
    format: NumberFormat | None = Field(
        default=None,
        description=(
            "numbers of the evaluator: float32, or q15 and q31 with polynomials over "
            "control.per_unit; default float32, with a budget the cheapest"
        ),
    )
    degree: int = Field(default=_FIT.degree, ge=1, le=6, description="degree of the polynomials")
    segments: int = Field(default=_FIT.segments, ge=1, le=4, description="number of segments")
    breakpoint_mode: BreakpointMode = Field(
        default=_FIT.breakpoint_mode, description="one set of breakpoints, or one per axis"
    )
    exact_at_zero: bool = Field(default=_FIT.exact_at_zero, description="no current at zero torque")
    continuous: bool = Field(default=_FIT.continuous, description="no step at the breakpoints")
    flat_at_zero: bool = Field(
        default=_FIT.flat_at_zero, description="no linear term of i_d at zero torque"
    )
    max_torque: Torque | None = Field(
        default=None,
        json_schema_extra=former("torque_max"),
        description="end of the domain (N m); default the largest torque within the current limit",
    )
    breakpoints: Listing[Torque] | None = Field(
        default=None, description="segments - 1 ascending torques (N m); default: searched for"
    )
    torque_error: SmallShare | None = Field(
        default=None,
        description="budget: largest torque error over the largest torque (write 0.2 %)",
    )
    loss_penalty: SmallShare | None = Field(
        default=None,
        description="budget: largest copper loss above the least, from 5 % torque up (write 0.1 %)",
    )
    core: Core = Field(default=_FIT.core, description="whose cycles the choice by a budget counts")
    flash: ByteCount | None = Field(
        default=None, ge=8, le=100_000, description="budget: bytes of constants (256 B)"
    )


def check_fit(
    fit: FitSection,
    operation: OperationSection,
    machine: Machine,
    i_max: float,
    document: YamlDocument,
) -> None:
    """Check form and domain of the current references; ``i_max`` in A is the current limit.

    Raises `InputError` with a position.
    """
    _check_form(fit, operation, machine, document)
    _check_budget(fit, document)
    largest = largest_torque_within(machine, i_max, operation.strategy)
    end = largest if fit.max_torque is None else fit.max_torque.si
    if fit.breakpoints is not None:
        _check_breakpoints(fit.breakpoints, fit.segments, end, document)


def _check_form(
    fit: FitSection, operation: OperationSection, machine: Machine, document: YamlDocument
) -> None:
    """Check that the machine and the strategy have the form that is asked for."""
    form, path = fit.form, ("fit", "form")
    if fit.torque_error is not None or fit.loss_penalty is not None:
        return  # it is searched for
    if (form == "even-odd" or fit.flat_at_zero) and fit.degree < 2:
        reason = "form: even-odd" if form == "even-odd" else "flat_at_zero"
        raise document.error(
            f"fit.degree: {reason} needs degree 2 or more; write degree: 3", ("fit", "degree")
        )
    if not isinstance(machine, LinearMachine):
        if form != "polynomial" and "form" in fit.model_fields_set:
            message = (
                f"fit.form: {form} needs constant inductances, the machine saturates; write form: "
                "polynomial"
            )
            raise document.error(message, path)
        return
    if operation.strategy == "mtpa" and form == "closed-form" and machine.l_d == machine.l_q:
        message = (
            "fit.form: closed-form needs inductance_d and inductance_q to differ; write form: "
            "torque-exact"
        )
        raise document.error(message, path)
    if form == "even-odd" and machine.psi_pm == 0.0:
        message = (
            "fit.form: even-odd needs currents that are smooth at zero torque; write form: "
            "polynomial"
        )
        raise document.error(message, path)
    if form in ("closed-form", "even-odd") and operation.speed is not None:
        other = "polynomial" if machine.psi_pm == 0.0 else "torque-exact"
        message = (
            f"fit.form: {form} follows the MTPA locus, which operation.speed leaves; write form: "
            f"{other}"
        )
        raise document.error(message, path)
    if form == "torque-exact" and machine.psi_pm == 0.0:
        other = "closed-form" if operation.speed is None else "polynomial"
        message = (
            "fit.form: torque-exact divides by the magnet torque, the machine has none; write "
            f"form: {other}"
        )
        raise document.error(message, path)


def _check_budget(fit: FitSection, document: YamlDocument) -> None:
    """Check that what a budget searches for is not given as well."""
    budget = [
        key for key in ("torque_error", "loss_penalty", "flash") if getattr(fit, key) is not None
    ]
    for key in ("form", "degree", "segments", "breakpoints", "breakpoint_mode"):
        if budget and key in fit.model_fields_set:
            message = f"fit.{key} is chosen by the budget fit.{budget[0]}; remove one of the two"
            raise document.error(message, ("fit", key), key=True)
    if budget == ["flash"]:
        message = (
            "fit.flash alone says nothing about errors; write torque_error: 0.2 % or loss_penalty: "
            "0.1 %, too"
        )
        raise document.error(message, ("fit", "flash"), key=True)


def _check_breakpoints(
    breakpoints: tuple[Quantity, ...], segments: int, end: float, document: YamlDocument
) -> None:
    path = ("fit", "breakpoints")
    if len(breakpoints) != segments - 1:
        raise document.error(
            f"fit.breakpoints lists {len(breakpoints)}, but {segments} segments meet at "
            f"{segments - 1}; write segments: {len(breakpoints) + 1}, or {segments - 1} "
            "breakpoints",
            path,
        )
    for index, point in enumerate(breakpoints):
        before = breakpoints[index - 1].si if index else 0.0
        if point.si <= before:
            message = (
                f"fit.breakpoints: {point.text} does not ascend; write the breakpoints in order"
            )
            raise document.error(message, (*path, index))
        if point.si >= end:
            limit = format_quantity(end, "N m")
            message = (
                f"fit.breakpoints: {point.text} lies beyond the end of the domain, {limit}; write "
                "less"
            )
            raise document.error(message, (*path, index))


def read_budget(section: FitSection) -> FitBudget | None:
    """Limits that a form is chosen by; None where the section names none."""
    found = settings_from(FitBudget, section)
    return None if found == FitBudget() else found


@about("fit")
def read_fit(
    section: FitSection, machine: Machine, bases: PerUnitBases, reading: Reading
) -> FitSettings:
    """Settings of the fit; what the machine or the number format cannot have is no default."""
    form, budget = section.form, read_budget(section)
    open_form = "form" not in section.model_fields_set
    if open_form and not isinstance(machine, LinearMachine):
        form = "polynomial"
        reading.remarks.append(
            "fit.form is polynomial: the machine saturates, so no other form holds"
        )
    elif open_form and section.format in ("q15", "q31"):
        form = "polynomial"
        reading.remarks.append(f"fit.form is polynomial: {section.format} has no other")
    return settings_from(
        FitSettings,
        section,
        form=form,
        budget=budget,
        torque_max=None if section.max_torque is None else section.max_torque.si,
        format="float32" if section.format is None and budget is None else section.format,
        full_scale=(bases.torque, bases.current),
    )
