"""The current reference that a design asks for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import FitBudget, FitSettings
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.names import FitForm, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.fit import (
    AXES,
    ReferenceFit,
    constant_bytes,
    estimated_cycles,
    fit_reference,
    holds,
    least_degree,
    possible_forms,
    reference_bytes,
)
from dqforge.optimizer.current_reference.forms import ReferenceErrors
from dqforge.optimizer.curves.breakpoints import SegmentErrors, round_significant, segment_errors
from dqforge.optimizer.curves.fitting import Curve, SideConditions
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, domain_end
from dqforge.optimizer.operating_points.solve import current_choice


@on_design("fit")
def solve_fit(design: Design) -> FitChoice:
    """Current reference of the design: as set, or the cheapest that keeps its budget."""
    choice, budget = current_choice(design), design.fit.budget
    if budget is None:
        found = FitChoice(fit_reference(choice, design.fit), ())
    else:
        found = choose_fit(choice, design.fit, budget)
    return replace(found, data=data_use(choice, found.fit.torque_max))


# Where a current reference depends on the ends of a flux map: held on the edge of its data,
# or beyond them.

_GRID = 801
_NARROWINGS = 3
_ALL_OF_IT = 1e-3  # Share of the domain below which a range is said to begin at zero torque.


@dataclass(frozen=True, slots=True)
class DataUse:
    """Ranges of the torque in N m, from and to; None where there is none.

    ``held``: the data of the flux map hold the currents on their edge, and better ones may lie
    beyond. ``extrapolated``: the currents lie beyond the data, which the design permits.
    """

    held: tuple[float, float] | None = None
    extrapolated: tuple[float, float] | None = None


COVERED = DataUse()  # Of references whose currents all lie well inside the data, or need none.


def data_use(choice: CurrentChoice, end: float) -> DataUse:
    """What the currents of a choice owe to the ends of its data, for torques from 0 to ``end`` N
    m.
    """

    def held(torque: FloatArray) -> NDArray[np.bool_]:
        return choice.held(torque)

    def beyond(torque: FloatArray) -> NDArray[np.bool_]:
        return ~choice.machine.known(*choice.currents(torque))

    if choice.region is not None:
        return DataUse(held=_range(held, end))
    return DataUse(extrapolated=_range(beyond, end))


def _range(
    holds: Callable[[FloatArray], NDArray[np.bool_]], end: float
) -> tuple[float, float] | None:
    """First and last torque in N m at which a property holds, the ends narrowed
    far below what is printed.
    """
    torque = np.linspace(0.0, end, _GRID)
    # At zero torque no current flows, which is not held by anything.
    true = np.flatnonzero(holds(torque[1:])) + 1
    if true.size == 0:
        return None
    low, high = torque[true[0] - 1], torque[true[0]]
    for _ in range(_NARROWINGS):
        finer = np.linspace(low, high, 65)
        first = max(int(np.argmax(holds(finer[1:]))) + 1, 1)
        low, high = finer[first - 1], finer[first]
    last = torque[true[-1]]
    return (0.0 if high < _ALL_OF_IT * end else float(high)), float(last)


# The cheapest current reference that keeps a budget of errors: forms,
# degrees and segments tried in order of cost.

# Errors of the quick fit over the budget from which on the fit by the wanted method is not tried:
# it gains less. The most that tests find is 4.2 for the torque and 10 for the loss, which goes with
# the square of the current error.
_DEGREES = 6
_SEGMENTS = (1, 2, 3, 4)
_HOPELESS_TORQUE, _HOPELESS_LOSS = 5.0, 16.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One form that was tried.

    ``cycles`` are estimated for the core, ``flash`` in bytes counts the constants. ``errors`` are
    those of the arithmetic; ``quick`` says that they belong to a quick fit, which shows that none
    could keep the budget.
    """

    form: FitForm
    format: NumberFormat
    degree: int
    segments: int
    cycles: float
    flash: int
    errors: ReferenceErrors
    quick: bool


@dataclass(frozen=True, slots=True)
class FitChoice:
    """The chosen reference, what was tried on the way to it in order of cost,
    and what it owes to the ends of data.
    """

    fit: ReferenceFit
    trials: tuple[Trial, ...]
    data: DataUse = COVERED


def _keeps(errors: ReferenceErrors, budget: FitBudget) -> bool:
    return _within(errors, budget, 1.0, 1.0)


def is_hopeless(errors: ReferenceErrors, budget: FitBudget) -> bool:
    """Whether errors of a quick fit are so far over the budget that no other fit of
    the same form can keep it.
    """
    return not _within(errors, budget, _HOPELESS_TORQUE, _HOPELESS_LOSS)


def _within(
    errors: ReferenceErrors, budget: FitBudget, torque_factor: float, loss_factor: float
) -> bool:
    torque = (
        budget.torque_error is None or errors.torque_relative <= torque_factor * budget.torque_error
    )
    return torque and (
        budget.loss_penalty is None or errors.loss_relative <= loss_factor * budget.loss_penalty
    )


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
        wanted = replace(wanted, method="least-squares", format="float32")
        if wanted.breakpoint_mode == "shared" or len(AXES[wanted.form]) == 1:
            edges = self.errors(wanted.form, wanted.degree).best_edges(wanted.segments)
            wanted = replace(
                wanted, breakpoints=tuple(round_significant(edge) for edge in edges[1:-1])
            )
        return fit_reference(self.choice, wanted)


def _from_rest(curve: Curve) -> Curve:
    return partial(_difference, curve, float(curve(np.zeros(1))[0]))


def _difference(curve: Curve, constant: float, argument: FloatArray) -> FloatArray:
    return curve(argument) - constant


def _candidates(
    choice: CurrentChoice, settings: FitSettings
) -> Iterator[tuple[float, int, FitForm, NumberFormat, int, int]]:
    """Cycles, bytes, form, format, degree and segments of everything that the machine
    and the full scales permit.
    """
    end = domain_end(choice, settings)
    formats: tuple[NumberFormat, ...] = (
        ("float32", "q15", "q31") if settings.format is None else (settings.format,)
    )
    for number_format in formats:
        if settings.format is None and not holds(choice, settings, number_format, end):
            continue
        for form in possible_forms(choice, number_format):
            for degree, segments in product(
                range(least_degree(form, settings), _DEGREES + 1), _SEGMENTS
            ):
                cycles = estimated_cycles(form, degree, segments, number_format, settings.core)
                yield (
                    cycles,
                    constant_bytes(form, degree, segments, number_format),
                    form,
                    number_format,
                    degree,
                    segments,
                )


def choose_fit(choice: CurrentChoice, settings: FitSettings, budget: FitBudget) -> FitChoice:
    """The cheapest form that keeps a budget.

    Candidates are tried in the order of their estimated cycles. Each is first fitted by least
    squares on segments of a grid, which is quick; where that errs by no more than 5 times the
    permitted torque error and 16 times the permitted loss penalty, it is fitted by the method of
    the settings.

    Args:
        choice: What is to be approximated.
        settings: Method and side conditions; form, degree, segments and breakpoints are searched
            for.
        budget: What must be kept.

    Raises:
        NoSolutionError: No candidate keeps the budget; says which came closest.
    """
    candidates = sorted(_candidates(choice, settings))
    quick_fits = QuickFits(choice, settings)
    trials: list[Trial] = []
    for cycles, flash, form, number_format, degree, segments in candidates:
        if budget.flash is not None and flash > budget.flash:
            continue
        wanted = replace(
            settings,
            form=form,
            format=number_format,
            degree=degree,
            segments=segments,
            breakpoints=None,
        )
        try:
            fit = quick_fits.fit(wanted)
        except NoSolutionError:  # a degree whose powers leave the range of floats
            continue
        if (
            fit.d is None and fit.q is None
        ):  # exact without any polynomial, but for the rounding of fixed point
            fit = fit_reference(choice, wanted)
            size = reference_bytes(fit.reference)
            trials.append(
                Trial(form, number_format, degree, segments, cycles, size, fit.errors, quick=False)
            )
            if number_format == "float32" or _keeps(fit.errors, budget):
                return FitChoice(fit, tuple(trials))
            continue
        quick = is_hopeless(fit.errors, budget)
        if not quick:
            fit = fit_reference(choice, wanted)
        trials.append(
            Trial(form, number_format, degree, segments, cycles, flash, fit.errors, quick=quick)
        )
        if not quick and _keeps(fit.errors, budget):
            return FitChoice(fit, tuple(trials))
    if not trials:
        raise NoSolutionError(
            f"fit.flash: no form has its constants in {budget.flash} bytes; permit more"
        )
    best = min(trials, key=lambda trial: _excess(trial.errors, budget))
    torque, loss = 100.0 * best.errors.torque_relative, 100.0 * best.errors.loss_relative
    raise NoSolutionError(
        f"fit: no form of degree up to {_DEGREES} with up to {_SEGMENTS[-1]} segments keeps the "
        f"budget; {best.form} of degree {best.degree} with {best.segments} segments in "
        f"{best.format} comes closest, with a torque error of {torque:.2g} % and a loss penalty of "
        f"{loss:.2g} %"
    )


def _excess(errors: ReferenceErrors, budget: FitBudget) -> float:
    """Largest error over its budget."""
    pairs = (
        (errors.torque_relative, budget.torque_error),
        (errors.loss_relative, budget.loss_penalty),
    )
    return max((error / limit for error, limit in pairs if limit is not None), default=0.0)
