"""The cheapest current reference that keeps a budget of errors: forms, degrees and segments tried in order of cost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.settings import FitBudget, FitForm, FitSettings
from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.breakpoints import SegmentErrors, round_significant, segment_errors
from dqforge.optimizer.current_choice import CurrentChoice
from dqforge.optimizer.current_reference import ClosedForm, Reference, ReferenceErrors
from dqforge.optimizer.fitting import Curve, SideConditions
from dqforge.optimizer.fixed_reference import FixedReference
from dqforge.optimizer.reference_fit import (
    AXES,
    ReferenceFit,
    domain_end,
    fit_reference,
    least_degree,
    possible_forms,
)
from dqforge.optimizer.single_precision import SinglePolynomial, multiply_add

_DEGREES = (1, 2, 3, 4, 5, 6)
_SEGMENTS = (1, 2, 3, 4)
_HOPELESS_TORQUE, _HOPELESS_LOSS = 5.0, 16.0
"""Errors of the quick fit over the budget from which on the fit by the wanted method is not tried: it gains less. The
most that tests find is 4.2 for the torque and 10 for the loss, which goes with the square of the current error."""

_FLOAT_BYTES = 4

_CYCLES: dict[FitForm, tuple[float, float, float]] = {
    "polynomial": (22.3, 6.7, -9.6),
    "even-odd": (25.4, 6.2, -12.2),
    "torque-exact": (39.2, 4.65, -6.5),
    "closed-form": (44.7, 4.0, -6.5),
}
"""Cycles of two segments at degree 0, per degree, and what a single segment saves."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One form that was tried.

    ``cycles`` are estimated for a Cortex-M4F, ``flash`` in bytes counts the constants. ``errors`` are those of the
    float32 arithmetic; ``quick`` says that they belong to a quick fit, which shows that none could keep the budget.
    """

    form: FitForm
    degree: int
    segments: int
    cycles: float
    flash: int
    errors: ReferenceErrors
    quick: bool


@dataclass(frozen=True, slots=True)
class FitChoice:
    """The chosen reference, and what was tried on the way to it, in order of cost."""

    fit: ReferenceFit
    trials: tuple[Trial, ...]


def estimated_cycles(form: FitForm, degree: int, segments: int) -> float:
    """Cycles of both currents on a Cortex-M4F, an estimate to rank forms by.

    Fitted to compiled instances, sign and clamping included, each the middle of its estimate on the emulated core
    (tests/benchmarks/test_firmware_cost.py).
    """
    base, per_degree, single = _CYCLES[form]
    return base + per_degree * degree + (single if segments == 1 else 6.0 * (segments - 2))


def constant_bytes(form: FitForm, degree: int, segments: int) -> int:
    """Bytes of the constants of a form whose axes share their breakpoints."""
    polynomials = len(AXES[form])
    extra = {"polynomial": 0, "even-odd": segments - 2, "torque-exact": 2, "closed-form": 2}[form]
    # The first segment of each polynomial has no constant, the first start is zero; each has its value at the end.
    floats = polynomials * (segments * (degree + 1)) + (segments - 1) + extra
    return _FLOAT_BYTES * (floats + 1)


def _fixed_bytes(reference: FixedReference) -> int:
    """Bytes of the different integers of a reference in fixed point; constants are as wide as the products."""
    segments = [s for polynomial in (reference.d, reference.q) if polynomial is not None for s in polynomial.segments]
    words = {reference.end, *(segment.start for segment in segments), *(segment.leading for segment in segments)}
    constants = {constant for segment in segments for constant in segment.constants}
    return 4 * len(words - {0}) + reference.width // 4 * len(constants)


def reference_bytes(reference: Reference) -> int:
    """Bytes of the different constants of a reference that is emitted, the end of its domain included."""
    if isinstance(reference, FixedReference):
        return _fixed_bytes(reference)
    constants = {float(reference.torque_max)}
    for name in reference.form.__dataclass_fields__:
        value = getattr(reference.form, name)
        if isinstance(value, SinglePolynomial):
            end = value.evaluate(np.array([reference.torque_max]), multiply_add)
            constants.update(float(constant) for constant in (*value.coefficients.flat, *value.starts, *end))
        elif name != "sign":
            constants.add(float(value))
    if isinstance(reference.form, ClosedForm):
        constants.add(float(reference.form.base_squared))
    return _FLOAT_BYTES * len(constants - {0.0})


def _keeps(errors: ReferenceErrors, budget: FitBudget) -> bool:
    return _within(errors, budget, 1.0, 1.0)


def is_hopeless(errors: ReferenceErrors, budget: FitBudget) -> bool:
    """Whether errors of a quick fit are so far over the budget that no other fit of the same form can keep it."""
    return not _within(errors, budget, _HOPELESS_TORQUE, _HOPELESS_LOSS)


def _within(errors: ReferenceErrors, budget: FitBudget, torque_factor: float, loss_factor: float) -> bool:
    torque = budget.torque_error is None or errors.torque_relative <= torque_factor * budget.torque_error
    return torque and (budget.loss_penalty is None or errors.loss_relative <= loss_factor * budget.loss_penalty)


class QuickFits:
    """Least-squares fits on edges from a grid, to see which candidates can keep a budget."""

    def __init__(self, choice: CurrentChoice, settings: FitSettings) -> None:
        self.choice = choice
        self.settings = settings
        self.end = domain_end(choice, settings)
        self.curves = {axis: _from_rest(curve) for axis, curve in choice.curves(self.end).items()}
        self.errors = cache(self._errors)

    def _errors(self, form: FitForm, degree: int) -> SegmentErrors:
        side = SideConditions(self.settings.exact_at_zero, self.settings.continuous)
        return segment_errors([self.curves[axis] for axis in AXES[form]], degree, side, self.end)

    def fit(self, wanted: FitSettings) -> ReferenceFit:
        """Quick fit by the form, degree and number of segments that are wanted."""
        wanted = replace(wanted, method="least-squares")
        if wanted.breakpoint_mode == "shared" or len(AXES[wanted.form]) == 1:
            edges = self.errors(wanted.form, wanted.degree).best_edges(wanted.segments)
            wanted = replace(wanted, breakpoints=tuple(round_significant(edge) for edge in edges[1:-1]))
        return fit_reference(self.choice, wanted)


def _from_rest(curve: Curve) -> Curve:
    return partial(_difference, curve, float(curve(np.zeros(1))[0]))


def _difference(curve: Curve, constant: float, argument: FloatArray) -> FloatArray:
    return curve(argument) - constant


def choose_fit(choice: CurrentChoice, settings: FitSettings, budget: FitBudget) -> FitChoice:
    """The cheapest form that keeps a budget.

    Candidates are tried in the order of their estimated cycles. Each is first fitted by least squares on segments of a
    grid, which is quick; where that errs by no more than 5 times the permitted torque error and 16 times the permitted
    loss penalty, it is fitted by the method of the settings.

    Parameters
    ----------
    choice:
        What is to be approximated.
    settings:
        Method and side conditions; form, degree, segments and breakpoints are searched for.
    budget:
        What must be kept.

    Raises
    ------
    NoSolutionError
        No candidate keeps the budget; says which came closest.
    """
    candidates = sorted(
        (estimated_cycles(form, degree, segments), constant_bytes(form, degree, segments), form, degree, segments)
        for form in possible_forms(choice)
        for degree in _DEGREES
        for segments in _SEGMENTS
        if degree >= least_degree(form, settings)
    )
    quick_fits = QuickFits(choice, settings)
    trials: list[Trial] = []
    for cycles, flash, form, degree, segments in candidates:
        if budget.flash is not None and flash > budget.flash:
            continue
        wanted = replace(settings, form=form, degree=degree, segments=segments, breakpoints=None)
        fit = quick_fits.fit(wanted)
        if fit.d is None and fit.q is None:
            trials.append(
                Trial(form, degree, segments, cycles, reference_bytes(fit.reference), fit.errors, quick=False)
            )
            return FitChoice(fit, tuple(trials))  # exact without any polynomial
        quick = is_hopeless(fit.errors, budget)
        if not quick:
            fit = fit_reference(choice, wanted)
        trials.append(Trial(form, degree, segments, cycles, flash, fit.errors, quick=quick))
        if not quick and _keeps(fit.errors, budget):
            return FitChoice(fit, tuple(trials))
    if not trials:
        raise NoSolutionError(f"fit.flash: no form has its constants in {budget.flash} bytes; permit more")
    best = min(trials, key=lambda trial: _excess(trial.errors, budget))
    raise NoSolutionError(
        f"fit: no form of degree up to {_DEGREES[-1]} with up to {_SEGMENTS[-1]} segments keeps the budget;"
        f" {best.form} of degree {best.degree} with {best.segments} segments comes closest, with a torque error of"
        f" {100.0 * best.errors.torque_relative:.2g} % and a loss penalty of {100.0 * best.errors.loss_relative:.2g} %"
    )


def _excess(errors: ReferenceErrors, budget: FitBudget) -> float:
    """Largest error over its budget."""
    pairs = ((errors.torque_relative, budget.torque_error), (errors.loss_relative, budget.loss_penalty))
    return max((error / limit for error, limit in pairs if limit is not None), default=0.0)
