"""From a machine and fit settings to the current reference of the firmware,
with its errors and its alternatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError
from dqforge.machines.names import FitForm, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.cost_model import AXES
from dqforge.optimizer.current_reference.forms import (
    ClosedForm,
    CurrentReference,
    ErrorCurves,
    Form,
    Polynomials,
    Proportional,
    Reference,
    ReferenceErrors,
    ReluctanceClosedForm,
    TorqueExact,
    error_curves,
    reference_errors,
)
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS
from dqforge.optimizer.current_reference.integer_scales import code_scale, in_fixed_point, on_codes
from dqforge.optimizer.curves.breakpoints import search, segment_errors
from dqforge.optimizer.curves.edge_levelling import level_edges
from dqforge.optimizer.curves.fitting import (
    Curve,
    SideConditions,
    fit_curve,
    squared_error_integral,
)
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.curves.segmentations import Segmentations
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.operating_points.current_choice import CurrentChoice, SpeedPoint, domain_end

# Torques at which the errors are kept over the torque, some more where a reference has breakpoints.
_CURVE_SAMPLES = 1600
_LARGEST_BASE = 1e18  # Base current in A whose square single precision holds with room to spare.


@dataclass(frozen=True, slots=True)
class ReferenceFit:
    """A current reference with what led to it.

    ``form`` is the name of the form that is emitted: one of the settings' names, or
    ``proportional`` where the exact reference is a straight line, or ``reluctance`` for the exact
    square root. ``d`` and ``q`` are the polynomials in double, A over N m, where the form has them.
    ``errors`` are the largest ones of the arithmetic of ``reference``, ``curves`` those over the
    torque, without fused multiply-add. ``speed`` is the one speed for which the reference weakens
    the field, and the voltage that it keeps there; None where the voltage limits nothing.
    """

    settings: FitSettings
    form: str
    torque_max: float
    d: PiecewisePolynomial | None
    q: PiecewisePolynomial | None
    reference: Reference
    errors: ReferenceErrors
    curves: ErrorCurves
    speed: SpeedPoint | None


def _cost(curves: list[Curve], settings: FitSettings) -> Callable[[FloatArray], float]:
    """Objective of the edges for interpolation and least squares: the paper's epsilon,
    summed over the curves.
    """
    side = SideConditions(settings.exact_at_zero, settings.continuous)

    def cost(edges: FloatArray) -> float:
        fits = [fit_curve(curve, edges, settings.degree, settings.method, side) for curve in curves]
        return sum(
            squared_error_integral(curve, fit) for curve, fit in zip(curves, fits, strict=True)
        )

    return cost


def _search_edges(curves: list[Curve], settings: FitSettings, end: float) -> FloatArray:
    """Best edges for curves that share them, shape (S + 1,)."""
    side = SideConditions(settings.exact_at_zero, settings.continuous)
    if settings.method == "minimax":
        return level_edges(curves, settings.degree, settings.segments, side, end)
    cost = _cost(curves, settings)
    if settings.segments == 1:
        return search(cost, cost, 1, end)
    errors = segment_errors(curves, settings.degree, side, end)
    candidates = Segmentations(errors, settings.segments, squared=True)
    starts = candidates.starts(lambda edges: np.array([cost(one) for one in edges]))
    return min((search(cost, cost, settings.segments, end, start) for start in starts), key=cost)


def find_edges(
    curves: dict[str, Curve], settings: FitSettings, end: float
) -> dict[str, FloatArray]:
    """Segment edges per axis, each of shape (S + 1,), given or searched for, shared or own.

    Args:
        curves: Currents in A over torque in N m, by axis.
        settings: Degree, number of segments, given edges, breakpoint mode.
        end: End of the domain in N m.
    """
    if settings.breakpoints is not None:
        return dict.fromkeys(curves, np.array([0.0, *settings.breakpoints, end]))
    groups = [[axis] for axis in curves] if settings.breakpoint_mode == "own" else [list(curves)]
    edges: dict[str, FloatArray] = {}
    for group in groups:
        found = _search_edges([curves[axis] for axis in group], settings, end)
        edges.update(dict.fromkeys(group, found))
    return edges


def exact_form(choice: CurrentChoice, form: FitForm) -> tuple[str, Form] | None:
    """The form that needs no polynomial, where the machine and the strategy have one.

    Args:
        choice: Machine, strategy and limits.
        form: The form that is wanted.
    """
    machine = choice.closed_form
    if machine is None:
        return None
    if machine.psi_pm > 0.0 and (choice.strategy == "id0" or machine.saliency == 0.0):
        return "proportional", Proportional(np.float32(1.0 / machine.torque_per_ampere))
    if machine.psi_pm == 0.0 and form == "closed-form":
        gain = 1.0 / (1.5 * machine.pole_pairs * abs(machine.saliency))
        return "reluctance", ReluctanceClosedForm(
            np.float32(gain), 1 if machine.saliency > 0.0 else -1
        )
    return None


def least_degree(form: FitForm, settings: FitSettings) -> int:
    """Least degree of a form: 2 where i_d has no linear term.

    Args:
        form: Form of the reference.
        settings: Whether i_d is to be flat at zero torque.
    """
    return 2 if form == "even-odd" or (settings.flat_at_zero and "d" in AXES[form]) else 1


def possible_forms(
    choice: CurrentChoice, number_format: NumberFormat = "float32"
) -> tuple[FitForm, ...]:
    """Forms that can hold the currents of a choice in a number format.

    ``torque-exact`` needs constant inductances and a magnet, ``closed-form`` and ``even-odd`` the
    MTPA locus that these have. Fixed point has plain polynomials only: it is for cores on which a
    division or a root costs more than all the rest.

    Args:
        choice: Machine, strategy and limits.
        number_format: Format of the numbers.
    """
    machine = choice.machine
    if not isinstance(machine, LinearMachine) or number_format != "float32":
        return ("polynomial",)
    if machine.psi_pm == 0.0:
        return ("polynomial",) if choice.speed is not None else ("polynomial", "closed-form")
    if choice.speed is not None:
        return ("polynomial", "torque-exact")
    return (
        "polynomial",
        "even-odd",
        "torque-exact",
        *(("closed-form",) if _has_closed_form(machine) else ()),
    )


def _has_closed_form(machine: LinearMachine) -> bool:
    """Whether single precision holds the squared base current of the MTPA locus:
    not next to equal inductances.
    """
    return machine.saliency == 0.0 or abs(machine.psi_pm / (2.0 * machine.saliency)) < _LARGEST_BASE


def _require_form(
    choice: CurrentChoice, settings: FitSettings, number_format: NumberFormat
) -> None:
    form = settings.form
    possible = possible_forms(choice, number_format)
    if form in possible:
        if settings.degree < least_degree(form, settings):
            what = "form: even-odd" if form == "even-odd" else "flat_at_zero"
            raise InputError(
                f"fit.degree: {what} needs degree 2 or more, got {settings.degree}; write degree: 3"
            )
        return
    machine = choice.machine
    if number_format != "float32":
        reason = f"divides or takes a root, which {number_format} does not offer"
    elif not isinstance(machine, LinearMachine):
        reason = "needs constant inductances, the machine is a flux map"
    elif form == "even-odd" and machine.psi_pm == 0.0:
        reason = "needs currents that are smooth at zero torque, without a magnet they are not"
    elif form == "closed-form" and choice.speed is None:
        reason = "squares a base current that is no float: l_d and l_q are next to equal"
    elif form == "torque-exact":
        reason = "divides by the magnet torque, which this machine does not have"
    else:
        reason = "follows the MTPA locus, which is left where operation.speed weakens the field"
    raise InputError(f"fit.form: {form} {reason}; write form: {possible[-1]}")


def _assemble(machine: Machine, form: FitForm, fits: dict[str, PiecewisePolynomial]) -> Form:
    """Round the polynomials of a form, and the machine constants beside them, to float."""
    single = {axis: SinglePolynomial.from_double(fit) for axis, fit in fits.items()}
    if form in ("polynomial", "even-odd"):
        return Polynomials(single["d"], single["q"])
    if form == "torque-exact":
        slope = -1.5 * machine.pole_pairs * machine.saliency
        return TorqueExact(single["d"], np.float32(machine.torque_per_ampere), np.float32(slope))
    base = machine.psi_pm / (2.0 * abs(machine.saliency))
    return ClosedForm(single["q"], np.float32(base), 1 if machine.saliency > 0.0 else -1)


def fit_reference(choice: CurrentChoice, settings: FitSettings) -> ReferenceFit:
    """Current reference for the currents of a choice.

    Args:
        choice: What is to be approximated; its limits set the domain where the settings give none.
        settings: Form, method, degree, segments, breakpoints and side conditions.

    Raises:
        InputError: The form does not suit the machine, or a breakpoint lies outside the domain.
        NoSolutionError: The torque domain needs more current or voltage than the limits, or the fit
            failed.
    """
    end = domain_end(choice, settings)
    number_format = settings.format or "float32"
    exact = exact_form(choice, settings.form)
    fits: dict[str, PiecewisePolynomial] = {}
    if exact is None or exact[0] == "reluctance":
        _require_form(choice, settings, number_format)
    if exact is None:
        if (
            settings.breakpoints is not None
            and settings.breakpoints
            and settings.breakpoints[-1] >= end
        ):
            raise InputError(f"fit.breakpoints must lie below the largest torque, {end:.4g} N m")
        fits = _fits(choice, settings, end)
        name: str = settings.form
        form = _assemble(choice.machine, settings.form, fits)
    else:
        name, form = exact
    reference: Reference = CurrentReference(form, np.float32(end))
    if number_format != "float32":
        reference = in_fixed_point(choice, settings, end, fits)
    return ReferenceFit(
        settings=settings,
        form=name,
        torque_max=end,
        d=fits.get("d"),
        q=fits.get("q"),
        reference=reference,
        errors=reference_errors(choice, reference),
        curves=error_curves(choice, reference, reference.samples(_CURVE_SAMPLES)),
        speed=choice.speed,
    )


def _fits(
    choice: CurrentChoice, settings: FitSettings, end: float
) -> dict[str, PiecewisePolynomial]:
    """Polynomials of the axes that the form needs.

    The side condition at zero torque holds a curve at zero there, so that what flows without torque
    (the d current that weakens the field) is taken off before and put back behind.
    """
    all_curves = choice.curves(end)
    curves = {axis: all_curves[axis] for axis in AXES[settings.form]}
    at_rest = {axis: float(curve(np.zeros(1))[0]) for axis, curve in curves.items()}
    shifted = {axis: _less(curve, at_rest[axis]) for axis, curve in curves.items()}
    side = SideConditions(settings.exact_at_zero, settings.continuous)
    edges = find_edges(shifted, settings, end)
    if settings.form == "even-odd":
        return _even_odd_fits(choice.machine, shifted, edges, settings)
    if settings.format in FIXED_WIDTHS:
        scale = code_scale(choice, settings, end)
        edges = {axis: on_codes(found, scale) for axis, found in edges.items()}
    fits = {
        axis: fit_curve(
            curve,
            edges[axis],
            settings.degree,
            settings.method,
            replace(side, absent=_absent(axis, settings)),
        )
        for axis, curve in shifted.items()
    }
    return {axis: _raised(fit, at_rest[axis]) for axis, fit in fits.items()}


def _absent(axis: str, settings: FitSettings) -> tuple[int, ...]:
    return (1,) if settings.flat_at_zero and axis == "d" else ()


def _even_odd_fits(
    machine: Machine, curves: dict[str, Curve], edges: dict[str, FloatArray], settings: FitSettings
) -> dict[str, PiecewisePolynomial]:
    """i_d of degree n without its linear term, then i_q of degree n + 1 without its square.

    At the MTPA i_d is even and i_q odd in the torque, so that the terms are small and their
    coefficients better spent higher up. i_q is fitted to what gives the torque together with the
    i_d that was fitted: an error of i_d then costs no torque, and a loss of second order only.
    """
    slope = -1.5 * machine.pole_pairs * machine.saliency
    d = fit_curve(
        curves["d"],
        edges["d"],
        settings.degree,
        settings.method,
        SideConditions(True, settings.continuous, (1,)),
    )

    def matched(torque: FloatArray) -> FloatArray:
        return torque / (machine.torque_per_ampere + slope * d(torque))

    side = SideConditions(True, settings.continuous, (2,))
    return {"d": d, "q": fit_curve(matched, edges["q"], settings.degree + 1, settings.method, side)}


def _less(curve: Curve, constant: float) -> Curve:
    return curve if constant == 0.0 else lambda argument: curve(argument) - constant


def _raised(fit: PiecewisePolynomial, constant: float) -> PiecewisePolynomial:
    coefficients = fit.coefficients.copy()
    coefficients[:, 0] += constant
    return PiecewisePolynomial(fit.edges, coefficients)
