"""From a machine and fit settings to the current reference of the firmware,
with its errors and its alternatives.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.errors import InputError
from dqforge.machines.names import Core, FitForm, FitMethod, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.units.quantities import to_digits
from dqforge.optimizer.current_reference.forms import (
    FIXED_WIDTHS,
    ClosedForm,
    CurrentReference,
    Emitted,
    ErrorCurves,
    FixedReference,
    Form,
    Polynomials,
    Proportional,
    Reference,
    ReferenceErrors,
    ReluctanceClosedForm,
    SignedReference,
    TorqueExact,
    error_curves,
    reference_errors,
)
from dqforge.optimizer.curves.breakpoints import (
    Segmentations,
    level_edges,
    rounded_edges,
    search,
    segment_errors,
)
from dqforge.optimizer.curves.fitting import (
    Curve,
    SideConditions,
    fit_curve,
    squared_error_integral,
)
from dqforge.optimizer.curves.integer_polynomial import CodeScale, fit_fixed
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial, SinglePolynomial
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
    found = [search(cost, cost, settings.segments, end, start) for start in starts]
    # a local search may end above its start, whose segments near zero may be narrower than its own
    return min([*found, *map(rounded_edges, starts)], key=cost)


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


# What a current reference costs on a core: cycles to rank candidates by, and bytes of constants.
#
# The cycles are fitted to compiled instances, sign and clamping included, each the middle of its
# estimate on the emulated core; tests/benchmarks/test_firmware_cost.py measures them anew.

# The axes that each form holds as polynomials.
AXES: dict[FitForm, tuple[str, ...]] = {
    "polynomial": ("d", "q"),
    "even-odd": ("d", "q"),
    "torque-exact": ("d",),
    "closed-form": ("q",),
}

_FLOAT_BYTES = 4


@dataclass(frozen=True, slots=True)
class _Line:
    """Cycles of two segments at degree 0, per degree, what a single segment saves,
    and what each further one costs.
    """

    base: float
    per_degree: float
    single: float
    further: float

    def cycles(self, degree: int, segments: int) -> float:
        return (
            self.base
            + self.per_degree * degree
            - (self.single if segments == 1 else self.further * (2 - segments))
        )


_M4: dict[str, _Line] = {
    "polynomial": _Line(22.3, 6.7, 9.6, 6.0),
    "even-odd": _Line(25.4, 6.2, 12.2, 6.0),
    "torque-exact": _Line(39.2, 4.65, 6.5, 6.0),
    "closed-form": _Line(44.7, 4.0, 6.5, 6.0),
    "q15": _Line(36.6, 6.55, 9.5, 5.3),
    "q31": _Line(30.4, 20.4, 16.0, 5.0),
}

# Rows for the forms in single precision, and for polynomials in fixed point.
_CYCLES: dict[Core, dict[str, _Line]] = {
    "cortex-m4": _M4,
    "cortex-m33": _M4,
    "cortex-m7": {
        "polynomial": _Line(16.5, 4.85, 7.7, 5.3),
        "even-odd": _Line(18.8, 4.75, 9.8, 5.6),
        "torque-exact": _Line(32.1, 3.75, 5.4, 5.3),
        "closed-form": _Line(33.5, 4.1, 4.7, 3.8),
        "q15": _Line(26.6, 4.65, 9.0, 5.5),
        "q31": _Line(24.0, 15.0, 12.0, 5.5),
    },
    "cortex-m3": {
        "polynomial": _Line(171.9, 171.9, 168.0, 73.0),
        "even-odd": _Line(219.0, 171.0, 233.0, 89.0),
        "torque-exact": _Line(377.6, 85.5, 104.0, 57.0),
        "closed-form": _Line(670.0, 87.0, 127.0, 69.0),
        "q15": _Line(36.3, 8.25, 10.3, 6.1),
        "q31": _Line(29.0, 29.0, 18.0, 7.6),
    },
    "cortex-m0plus": {
        "polynomial": _Line(186.6, 446.7, 246.0, 114.0),
        "even-odd": _Line(356.0, 444.0, 367.0, 131.0),
        "torque-exact": _Line(823.4, 223.9, 163.0, 83.0),
        "closed-form": _Line(889.5, 225.0, 176.0, 104.0),
        "q15": _Line(58.6, 9.85, 16.0, 4.0),
        "q31": _Line(85.2, 132.0, 25.0, 16.0),
    },
}


def estimated_cycles(
    form: FitForm,
    degree: int,
    segments: int,
    number_format: NumberFormat = "float32",
    core: Core = "cortex-m4",
) -> float:
    """Cycles of both currents on a core, an estimate to rank candidates by.

    Args:
        form: Form of the reference.
        degree: Degree of its polynomials.
        segments: Number of their segments.
        number_format: Format of its numbers.
        core: The processor core.
    """
    return _CYCLES[core][form if number_format == "float32" else number_format].cycles(
        degree, segments
    )


def constant_bytes(
    form: FitForm, degree: int, segments: int, number_format: NumberFormat = "float32"
) -> int:
    """Bytes of the constants of a form whose axes share their breakpoints.

    Args:
        form: Form of the reference.
        degree: Degree of its polynomials.
        segments: Number of their segments.
        number_format: Format of its numbers.
    """
    polynomials = len(AXES[form])
    if number_format != "float32":
        word = FIXED_WIDTHS[number_format] // 4
        return polynomials * segments * (4 + word * degree) + 4 * segments
    extra = {"polynomial": 0, "even-odd": segments - 2, "torque-exact": 2, "closed-form": 2}[form]
    # The first segment of each polynomial has no constant, the first start is zero;
    # each has its value at the end.
    floats = polynomials * (segments * (degree + 1)) + (segments - 1) + extra
    return _FLOAT_BYTES * (floats + 1)


def _fixed_bytes(reference: FixedReference) -> int:
    """Bytes of the different integers of a reference in fixed point.

    Constants are as wide as the products.
    """
    segments = [
        s
        for polynomial in (reference.d, reference.q)
        if polynomial is not None
        for s in polynomial.segments
    ]
    words = {
        reference.end,
        *(segment.start for segment in segments),
        *(segment.leading for segment in segments),
    }
    constants = {constant for segment in segments for constant in segment.constants}
    return 4 * len(words - {0}) + reference.width // 4 * len(constants - {0})


def reference_bytes(reference: Emitted) -> int:
    """Bytes of the different constants of a reference that is emitted, the
    end of its domain included.
    """
    if isinstance(reference, FixedReference):
        return _fixed_bytes(reference)
    if isinstance(reference, SignedReference):
        return reference_bytes(reference.positive) + reference_bytes(reference.negative)
    constants = {float(reference.torque_max)}
    for name in reference.form.__dataclass_fields__:
        value = getattr(reference.form, name)
        if isinstance(value, SinglePolynomial):
            end = value.evaluate(np.array([reference.torque_max]))
            constants.update(
                float(constant) for constant in (*value.coefficients.flat, *value.starts, *end)
            )
        elif name != "sign":
            constants.add(float(value))
    if isinstance(reference.form, ClosedForm):
        constants.add(float(reference.form.base_squared))
    return _FLOAT_BYTES * len(constants - {0.0})


# Full scales of fixed-point references, checked against what they must hold,
# and integers on them.


def code_scale(choice: CurrentChoice, settings: FitSettings, end: float) -> CodeScale:
    """Full scales of a fixed-point format, checked against what it must hold.

    Args:
        choice: Machine, strategy and limits.
        settings: Format and full scales as far as they are given.
        end: End of the domain in N m.
    """
    if settings.full_scale is None or settings.format is None:
        raise InputError(
            f"fit.format: {settings.format} needs the bases of torque and current; give full_scale"
        )
    torque_base, current_base = settings.full_scale
    if end > torque_base * (1.0 + 1e-9):
        raise InputError(
            f"control.per_unit.torque: {torque_base:.4g} N m is full scale in {settings.format}, "
            f"but the references go up to {end:.4g} N m; write torque: "
            f"{to_digits(end, 2, up=True):g} N m, or a smaller fit.max_torque"
        )
    largest = float(np.max(np.abs(choice.currents(np.linspace(0.0, end, 101)))))
    if largest > current_base * (1.0 + 1e-9):
        raise InputError(
            f"control.per_unit.current: {current_base:.4g} A is full scale in {settings.format}, "
            f"but the references go up to {largest:.4g} A; write current: "
            f"{to_digits(largest, 2, up=True):g} A, or a smaller fit.max_torque"
        )
    return CodeScale(torque_base, current_base, FIXED_WIDTHS[settings.format])


def on_codes(edges: FloatArray, scale: CodeScale) -> FloatArray:
    """Segment edges whose inner ones are whole codes.

    Args:
        edges: Edges in N m, shape (S + 1,).
        scale: Full scales of torque and current.
    """
    inner = [float(scale.arguments(np.array(scale.code(edge)))) for edge in edges[1:-1]]
    return np.array([0.0, *inner, edges[-1]])


def in_fixed_point(
    choice: CurrentChoice, settings: FitSettings, end: float, fits: dict[str, PiecewisePolynomial]
) -> FixedReference:
    """Integers of polynomials, or of the straight line where the exact reference is one.

    Args:
        choice: Machine, strategy and limits.
        settings: Format and full scales as far as they are given.
        end: End of the domain in N m.
        fits: Polynomials of the currents in A over torque in N m, by axis.
    """
    scale, curves = code_scale(choice, settings, end), choice.curves(end)
    machine = choice.machine
    if not fits:
        line = np.array([[0.0, 1.0 / machine.torque_per_ampere]])
        fits = {"q": PiecewisePolynomial(np.array([0.0, end]), line)}
    found = {
        axis: fit_fixed(
            fit,
            curves[axis],
            scale,
            exact_at_zero=settings.exact_at_zero,
            continuous=settings.continuous,
        )
        for axis, fit in fits.items()
    }
    return FixedReference(found.get("d"), found["q"], scale.argument, scale.result)


def holds(
    choice: CurrentChoice, settings: FitSettings, number_format: NumberFormat, end: float
) -> bool:
    """Whether the full scales hold torques and currents up to the end of the domain in N m.

    Floats hold everything.

    Args:
        choice: Machine, strategy and limits.
        settings: Full scales as far as they are given.
        number_format: Format of the numbers.
        end: End of the domain in N m.
    """
    if number_format == "float32":
        return True
    if settings.full_scale is None:
        return False
    try:
        code_scale(choice, replace(settings, format=number_format), end)
    except InputError:
        return False
    return True


# What other forms, number formats, methods and side conditions would give beside a fit.


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


# Current references of positive and negative torques, where these differ.


def signed_reference(positive: ReferenceFit, negative: ReferenceFit) -> SignedReference:
    """The references of both signs of the torque as one.

    Args:
        positive, negative: Fits of positive torques, and of those of the mirrored machine.

    Raises:
        InputError: One of them is in fixed point.
    """
    if isinstance(positive.reference, FixedReference) or isinstance(
        negative.reference, FixedReference
    ):
        raise InputError(
            "machine.flux_map.symmetry: keep needs references in float32; write fit: format: "
            "float32"
        )
    return SignedReference(positive.reference, negative.reference)


def signed_designs(design: Design) -> tuple[Design, Design | None]:
    """The design as positive torques see it, and its mirror image as negative ones do.

    None where that is the same.
    """
    if design.halves is None:
        return design, None
    positive, negative = (replace(design, machine=half) for half in design.halves)
    return positive, negative
