"""What the firmware's arithmetic may add to a current reference: bounds operation by operation,
in balls.

Each form is described twice on an interval of torques: in exact real arithmetic with the emitted
constants, over power series, and as a bound on how far the rounded operations may leave that.
Single precision follows the standard model fl(x op y) = (x op y)(1 + delta) + eta with |delta| <=
2^-24 and |eta| <= 2^-150 (N. J. Higham, "Accuracy and Stability of Numerical Algorithms", 2nd
edition, 2002, chapter 2); a fused multiply-add rounds once where the model rounds twice, so that
its error is covered. In fixed point every shift rounds to nearest: half a unit of what it leaves.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

from dqforge.machines.records import dataclass
from dqforge.optimizer.certificates.ball import Value
from dqforge.optimizer.current_reference.forms import (
    ClosedForm,
    Polynomials,
    Proportional,
    Reference,
    ReluctanceClosedForm,
    TorqueExact,
)
from dqforge.optimizer.current_reference.integer_form import FixedReference
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial
from dqforge.optimizer.curves.single_precision import SinglePolynomial

if TYPE_CHECKING:
    from flint import arb


_LARGEST = 2.0**127  # Half of the range of floats: results below overflow nowhere.


@dataclass(frozen=True, slots=True)
class Rounded:
    """An intermediate result on an interval: a ball that holds its exact values,
    and a bound of its rounding error.

    Either balls of python-flint or `dqforge.optimizer.certificates.ball_arrays.Balls`,
    of which one is many intervals.
    """

    value: Value
    error: Value

    def size(self) -> Value:
        """Upper bound of the rounded result's magnitude."""
        return self.value.abs_upper() + self.error


@cache
def _constants() -> tuple[arb, arb]:
    from flint import arb

    return arb(2.0**-24), arb(2) ** -149


def rounded(value: Value, carried: Value) -> Rounded:
    """Result of one operation whose operands' errors move it by ``carried``.

    Raises `ZeroDivisionError` where it may exceed the largest float: the model knows no overflow.
    """
    unit, least = _constants()
    if not value.abs_upper() + carried < _LARGEST:
        raise ZeroDivisionError
    return Rounded(value, carried + unit * (value.abs_upper() + carried) + least)


def product(left: Rounded, right: Rounded) -> Rounded:
    """Rounded product of two intermediate results."""
    carried = left.value.abs_upper() * right.error + right.size() * left.error
    return rounded(left.value * right.value, carried)


def rounded_sum(left: Rounded, right: Rounded) -> Rounded:
    """Rounded sum of two intermediate results."""
    return rounded(left.value + right.value, left.error + right.error)


def exact(value: float) -> Rounded:
    """A constant, which has no rounding error."""
    from flint import arb

    return Rounded(arb(float(value)), arb(0))


def _quotient(top: Rounded, bottom: Rounded) -> Rounded:
    """Raises `ZeroDivisionError` where the divisor may vanish."""
    least = bottom.value.abs_lower() - bottom.error
    if not least > 0:
        raise ZeroDivisionError
    value = top.value / bottom.value
    return rounded(value, (top.error + value.abs_upper() * bottom.error) / least)


def _root(square: Rounded) -> Rounded:
    """Square root of what is positive.

    The difference of two roots is that of the squares over their sum.
    """
    least = square.value.abs_lower() - square.error
    carried = square.error / least.sqrt() if least > 0 else square.error.sqrt()
    return rounded(square.value.sqrt(), carried)


def horner(starts: Any, coefficients: Any, index: int, torque: Rounded) -> Rounded:
    """Rounded Horner steps of one segment, as `SinglePolynomial.evaluate` has them."""
    x = torque if index == 0 else rounded_sum(torque, exact(-float(starts[index])))
    row = [float(c) for c in coefficients[index]]
    value = exact(row[-1])
    for power in range(len(row) - 2, -1, -1):
        value = product(value, x)
        if row[power] != 0.0:
            value = rounded_sum(value, exact(row[power]))
    return value


def _polynomial(row: list[Any], x: Value) -> Value:
    value = row[-1] + 0 * x
    for coefficient in row[-2::-1]:
        value = value * x + coefficient
    return value


@dataclass(frozen=True, slots=True)
class Piece:
    """A part of the torque domain on which a reference is one analytic expression:
    ``low`` to ``high`` in N m.
    """

    reference: Reference
    low: float
    high: float

    def _index(self, starts: list[float]) -> int:
        return sum(1 for start in starts[1:] if start <= self.low)

    def _single(self, polynomial: SinglePolynomial, torque: Value) -> Value:
        from flint import arb

        index = self._index([float(start) for start in polynomial.starts])
        start = arb(float(polynomial.starts[index]))
        return _polynomial([arb(float(c)) for c in polynomial.coefficients[index]], torque - start)

    def _fixed(self, polynomial: FixedPolynomial | None, torque: Value) -> Value:
        """Exact polynomial of the integers in A over N m."""
        from flint import arb

        if polynomial is None:
            return 0 * torque
        scale = self._fixed_reference().scale
        starts = [float(scale.arguments(start)) for start in polynomial.starts]  # type: ignore[arg-type]
        segment = polynomial.segments[self._index(starts)]
        # Shifts count from the lowest power: a value of power k is scaled by two to their sum.
        total, coefficients = 0, []
        for constant, shift in zip(segment.constants[::-1], segment.shifts[::-1], strict=True):
            total += shift
            half = (1 << shift) >> 1
            coefficients.append(arb(constant - half) * arb(2) ** -total)
        coefficients.append(arb(segment.leading) * arb(2) ** -total)
        x = torque * (arb(int(scale.one)) / arb(scale.argument)) - segment.start
        return _polynomial(coefficients, x) * (arb(scale.result) / arb(int(scale.one)))

    def _fixed_reference(self) -> FixedReference:
        assert isinstance(self.reference, FixedReference)
        return self.reference

    def currents(self, torque: Value) -> tuple[Value, Value]:
        """(i_d, i_q) in A of the emitted constants in exact arithmetic, for a torque in N m,
        a ball or a series.
        """
        from flint import arb

        if isinstance(self.reference, FixedReference):
            return self._fixed(self.reference.d, torque), self._fixed(self.reference.q, torque)
        match self.reference.form:
            case Proportional(gain):
                return 0 * torque, torque * arb(float(gain))
            case Polynomials(d, q):
                return self._single(d, torque), self._single(q, torque)
            case TorqueExact(d, magnet, slope):
                i_d = self._single(d, torque)
                return i_d, torque / (i_d * arb(float(slope)) + arb(float(magnet)))
            case ClosedForm(q, base, sign) as form:
                i_q = self._single(q, torque)
                i_d = arb(float(base)) - (i_q * i_q + arb(float(form.base_squared))).sqrt()
                return i_d * sign, i_q
            case ReluctanceClosedForm(gain, sign):
                i_q = (torque * arb(float(gain))).sqrt()
                return i_q * -sign, i_q

    def rounding(self, torque: arb) -> tuple[arb, arb]:
        """Bounds in A of what rounding adds to i_d and i_q for torques in N m inside a ball.

        Raises:
            ZeroDivisionError: The ball is so wide that a divisor may vanish, or a result may leave
                the range of floats.
        """
        from flint import arb

        if isinstance(self.reference, FixedReference):
            return self._fixed_rounding(self.reference.d, torque), self._fixed_rounding(
                self.reference.q, torque
            )
        given = Rounded(torque, arb(0))
        match self.reference.form:
            case Proportional(gain):
                return arb(0), product(exact(float(gain)), given).error
            case Polynomials(d, q):
                return self._steps(d, given).error, self._steps(q, given).error
            case TorqueExact(d, magnet, slope):
                i_d = self._steps(d, given)
                divisor = rounded_sum(product(exact(float(slope)), i_d), exact(float(magnet)))
                return i_d.error, _quotient(given, divisor).error
            case ClosedForm(q, base, _) as form:
                i_q = self._steps(q, given)
                root = _root(rounded_sum(product(i_q, i_q), exact(float(form.base_squared))))
                return rounded_sum(
                    exact(float(base)), Rounded(-root.value, root.error)
                ).error, i_q.error
            case ReluctanceClosedForm(gain, _):
                error = _root(product(exact(float(gain)), given)).error
                return error, error

    def _steps(self, polynomial: SinglePolynomial, torque: Rounded) -> Rounded:
        index = self._index([float(start) for start in polynomial.starts])
        return horner(polynomial.starts, polynomial.coefficients, index, torque)

    def _fixed_rounding(self, polynomial: FixedPolynomial | None, torque: arb) -> arb:
        from flint import arb

        if polynomial is None:
            return arb(0)
        scale = self._fixed_reference().scale
        starts = [float(scale.arguments(start)) for start in polynomial.starts]  # type: ignore[arg-type]
        segment = polynomial.segments[self._index(starts)]
        x = (torque * (arb(int(scale.one)) / arb(scale.argument)) - segment.start).abs_upper()
        error, total = arb(0), sum(segment.shifts)
        for shift in segment.shifts:
            total -= shift
            error = error * x + (arb(2) ** -(total + 1) if shift > 0 else 0)
        unit = arb(scale.result) / arb(int(scale.one))
        value = self._fixed(polynomial, torque).abs_upper() / unit + error
        beyond = value - polynomial.largest
        return (error + (beyond if beyond > 0 else 0)) * unit


def pieces(reference: Reference) -> list[Piece]:
    """Parts of the domain between the breakpoints of either current."""
    if isinstance(reference, FixedReference):
        edges = [float(reference.scale.arguments(start)) for start in reference.starts]  # type: ignore[arg-type]
    else:
        parts = [getattr(reference.form, name, None) for name in ("d", "q")]
        found = {
            float(start)
            for part in parts
            if isinstance(part, SinglePolynomial)
            for start in part.starts
        }
        edges = sorted(found | {0.0})
    ends = [*edges[1:], float(reference.torque_max)]
    return [Piece(reference, low, high) for low, high in zip(edges, ends, strict=True)]
