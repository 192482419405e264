"""What other forms, number formats, methods and side conditions would give beside a fit."""

from __future__ import annotations

from dataclasses import replace

from dqforge.machines.design.settings import FitSettings
from dqforge.machines.names import FitMethod, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.fit import (
    ReferenceFit,
    exact_form,
    fit_reference,
    least_degree,
    possible_forms,
)
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.current_reference.integer_scales import holds
from dqforge.optimizer.operating_points.current_choice import CurrentChoice


@dataclass(frozen=True, slots=True)
class Alternative:
    """One row of the table of alternatives: what was changed, and the errors that result."""

    label: str
    settings: FitSettings
    errors: ReferenceErrors


def _fixed_breakpoints(fit: ReferenceFit) -> FitSettings:
    """The settings of a fit with its breakpoints written in, where it has one set of them."""
    polynomial = fit.d or fit.q
    shared = fit.settings.breakpoint_mode == "shared" or fit.d is None or fit.q is None
    if polynomial is None or not shared:
        return fit.settings
    return replace(fit.settings, breakpoints=tuple(float(edge) for edge in polynomial.breakpoints))


def alternatives(choice: CurrentChoice, fit: ReferenceFit) -> tuple[Alternative, ...]:
    """What other forms, methods and side conditions would give: one change
    at a time against ``fit``.

    Other forms search their own breakpoints; other methods and side conditions keep those of
    ``fit``, so that the price of each option is seen alone. Empty where the reference needs no
    polynomial.

    Args:
        choice: Machine, strategy and limits.
        fit: The fit to vary.
    """
    if fit.d is None and fit.q is None:
        return ()
    fixed = _fixed_breakpoints(fit)
    rows: list[tuple[str, FitSettings]] = []
    rows += [
        (f"form {form}", replace(fit.settings, form=form))
        for form in possible_forms(choice, fit.settings.format or "float32")
        if form != fit.settings.form
        and exact_form(choice, form) is None
        and fit.settings.degree >= least_degree(form, fit.settings)
    ]
    formats: tuple[NumberFormat, ...] = ("float32", "q15", "q31")
    rows += [
        (f"format {other}", replace(fixed, format=other))
        for other in formats
        if other != fit.settings.format
        and fit.settings.form == "polynomial"
        and holds(choice, fit.settings, other, fit.torque_max)
    ]
    methods: tuple[FitMethod, ...] = ("lagrange", "least-squares", "minimax")
    rows += [
        (f"method {method}", replace(fixed, method=method))
        for method in methods
        if method != fixed.method
    ]
    if fit.settings.form != "even-odd":  # which is exact there by its make
        rows.append(
            (
                f"exact at zero: {'off' if fixed.exact_at_zero else 'on'}",
                replace(fixed, exact_at_zero=not fixed.exact_at_zero),
            )
        )
    if fixed.segments > 1:
        rows.append(
            (
                f"continuous: {'off' if fixed.continuous else 'on'}",
                replace(fixed, continuous=not fixed.continuous),
            )
        )
    return tuple(
        Alternative(label, settings, fit_reference(choice, settings).errors)
        for label, settings in rows
    )
