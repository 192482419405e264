"""Full scales of fixed-point references, checked against what they must hold,
and integers on them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import FitSettings
from dqforge.machines.errors import InputError
from dqforge.machines.names import NumberFormat
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS, FixedReference
from dqforge.optimizer.curves.integer_fit import CodeScale, fit_fixed
from dqforge.optimizer.curves.piecewise import PiecewisePolynomial
from dqforge.optimizer.operating_points.current_choice import CurrentChoice


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
            f"but the references go up to {end:.4g} N m; write torque: {_rounded_up(end)} N m, or "
            "a smaller fit.max_torque"
        )
    largest = float(np.max(np.abs(choice.currents(np.linspace(0.0, end, 101)))))
    if largest > current_base * (1.0 + 1e-9):
        raise InputError(
            f"control.per_unit.current: {current_base:.4g} A is full scale in {settings.format}, "
            f"but the references go up to {largest:.4g} A; write current: {_rounded_up(largest)} "
            "A, or a smaller fit.max_torque"
        )
    return CodeScale(torque_base, current_base, FIXED_WIDTHS[settings.format])


def _rounded_up(value: float) -> str:
    """Two significant digits, not below the value."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 1.0)
    return f"{np.ceil(value / unit * (1.0 - 1e-12)) * unit:.6g}"


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
