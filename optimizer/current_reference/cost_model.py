"""What a current reference costs on a core: cycles to rank candidates by, and bytes of constants.

The cycles are fitted to compiled instances, sign and clamping included, each the middle of its
estimate on the emulated core; tests/benchmarks/test_firmware_cost.py measures them anew.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.names import Core, FitForm, NumberFormat
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import ClosedForm, Emitted, SignedReference
from dqforge.optimizer.current_reference.integer_form import FIXED_WIDTHS, FixedReference
from dqforge.optimizer.curves.single_precision import SinglePolynomial, multiply_add

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
            end = value.evaluate(np.array([reference.torque_max]), multiply_add)
            constants.update(
                float(constant) for constant in (*value.coefficients.flat, *value.starts, *end)
            )
        elif name != "sign":
            constants.add(float(value))
    if isinstance(reference.form, ClosedForm):
        constants.add(float(reference.form.base_squared))
    return _FLOAT_BYTES * len(constants - {0.0})
