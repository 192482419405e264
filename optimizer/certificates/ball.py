"""Balls and Taylor polynomials, of numbers and of whole arrays, and what of machines and of the
firmware's arithmetic is stated in them: the little that the certificates need beyond the
library for ball arithmetic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import field
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.flux_map import FluxMap, SaturatedMachine
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.machines.records import dataclass
from dqforge.optimizer.current_reference.forms import (
    ClosedForm,
    FixedReference,
    Polynomials,
    Proportional,
    Reference,
    ReluctanceClosedForm,
    TorqueExact,
)
from dqforge.optimizer.curves.integer_polynomial import FixedPolynomial
from dqforge.optimizer.curves.single_precision import SinglePolynomial
from dqforge.optimizer.operating_points.current_choice import CurrentChoice

if TYPE_CHECKING:
    from flint import arb


Value = Any  # A ball, or a power series with balls as coefficients.
ORDER = 5  # Power of the remainder of the Taylor polynomials.
_TINY = 1e-300  # Least bound that is stated: smaller doubles have fewer digits.


def upper(value: Any) -> float:
    """A double not below a ball's magnitude; inf where it is not finite,
    and 0 only for what is exactly zero.
    """
    if value == 0:
        return 0.0
    size = float(value.abs_upper())
    return max(math.nextafter(size, math.inf), _TINY) if math.isfinite(size) else math.inf


@lru_cache(maxsize=4096)
def exactly(value: float) -> arb:
    """A double as a ball without radius."""
    from flint import arb

    return arb(value)


def as_ball(value: Any) -> arb:
    """A ball, from a ball or an integer."""
    return exactly(value) if isinstance(value, int) else value


def widened(ball: arb, radius: arb) -> arb:
    """A ball with a larger radius."""
    from flint import arb

    return ball + arb(0, radius)


def hull(balls: Sequence[arb]) -> arb:
    """The ball around several."""
    total = balls[0]
    for ball in balls[1:]:
        total = total.union(ball)
    return total


class Expansion:
    """Taylor polynomials of functions of the torque about the middle of an interval, with
    remainders over all of it.
    """

    def __init__(self, low: float, high: float) -> None:
        from flint import arb

        middle = 0.5 * (low + high)
        self.middle = arb(middle)
        # The middle is rounded, and so are ends that come from codes:
        # a narrow ball must not lose them.
        radius = math.nextafter(0.5 * (high - low) * (1.0 + 1e-15) + 1e-15 * abs(middle), math.inf)
        self.radius = arb(radius)
        self.step = arb(0, radius)
        self.ball = arb(middle, radius)

    def enclose(self, function: Callable[[Value], Sequence[Value]]) -> list[arb]:
        """Balls that hold everything that functions of the torque take on the interval.

        Raises:
            ZeroDivisionError: One of them is not finite.
        """
        from flint import arb_series

        try:
            at_middle = function(arb_series([self.middle, 1]))
            over_all = function(arb_series([self.ball, 1]))
        except ValueError as error:  # how a series says that it divides by what may vanish
            raise ZeroDivisionError from error
        found = []
        for here, everywhere in zip(at_middle, over_all, strict=True):
            value = everywhere[ORDER]
            for power in range(ORDER - 1, -1, -1):
                value = value * self.step + here[power]
            if not value.is_finite():
                raise ZeroDivisionError
            found.append(value)
        return found


# What the firmware's arithmetic may add to a current reference: bounds operation by operation,
# in balls.
#
# Each form is described twice on an interval of torques: in exact real arithmetic with the emitted
# constants, over power series, and as a bound on how far the rounded operations may leave that.
# Single precision follows the standard model fl(x op y) = (x op y)(1 + delta) + eta with |delta| <=
# 2^-24 and |eta| <= 2^-150 (N. J. Higham, "Accuracy and Stability of Numerical Algorithms", 2nd
# edition, 2002, chapter 2); a fused multiply-add rounds once where the model rounds twice, so that
# its error is covered. In fixed point every shift rounds to nearest: half a unit of what it leaves.

_LARGEST = 2.0**127  # Half of the range of floats: results below overflow nowhere.


@dataclass(frozen=True, slots=True)
class Rounded:
    """An intermediate result on an interval: a ball that holds its exact values,
    and a bound of its rounding error.

    Either balls of python-flint or `dqforge.optimizer.certificates.ball.Balls`,
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
                return (i_d if sign > 0 else -i_d), i_q
            case ReluctanceClosedForm(gain, sign):
                i_q = (torque * arb(float(gain))).sqrt()
                return (-i_q if sign > 0 else i_q), i_q

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


# What the exact currents of a choice solve: torque and a second condition, with derivatives,
# in ball arithmetic.

Condition = Literal["loss", "no i_d", "voltage"]  # What fixes the exact currents beside the torque.
_GRID = 1001
_KINK_MARGIN = 1e-7  # Share of the domain around a kink on which both conditions are allowed for.


@dataclass(frozen=True, slots=True)
class Local:
    """Torque, its gradient and Hessian; the second condition and the voltage excess with theirs;
    balls or series.
    """

    torque: Value
    t_d: Value
    t_q: Value
    t_dd: Value
    t_dq: Value
    t_qq: Value
    condition: Value
    c_d: Value
    c_q: Value
    excess: Value
    e_d: Value
    e_q: Value


def _voltage_kinks(choice: CurrentChoice, end: float) -> tuple[list[float], bool]:
    """Torques at which the voltage begins or ceases to limit, and whether it does at zero
    torque.
    """
    speed = choice.speed
    assert speed is not None

    def limited(torque: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
        i_d, i_q = choice.currents(torque)
        omega_e = np.full_like(torque, choice.machine.pole_pairs * speed.omega_m)
        taken = np.hypot(*choice.machine.voltage(i_d, i_q, omega_e))
        return np.asarray(taken > speed.v_max * (1.0 - 1e-9))

    torque = np.linspace(0.0, end, _GRID)
    states = limited(torque)
    kinks = []
    for place in np.flatnonzero(states[1:] != states[:-1]):
        low, high = float(torque[place]), float(torque[place + 1])
        for _ in range(2):
            finer = np.linspace(low, high, _GRID)
            inside = limited(finer)
            at = int(np.argmax(inside != inside[0]))
            low, high = float(finer[at - 1]), float(finer[at])
        kinks.append(high)
    return kinks, bool(states[0])


def torque_parts(jet: Jet, i_d: Value, i_q: Value, k: Value) -> tuple[Value, ...]:
    """Torque in N m, its gradient and its Hessian (dd, dq, qq) by the currents.

    ``k`` is 1.5 times the pole pairs.
    """
    return (
        (jet.psi_d * i_q - jet.psi_q * i_d) * k,
        (jet.l_dd * i_q - jet.l_qd * i_d - jet.psi_q) * k,
        (jet.psi_d + jet.l_dq * i_q - jet.l_qq * i_d) * k,
        (jet.d_dd * i_q - jet.q_dd * i_d - jet.l_qd * 2) * k,
        (jet.l_dd + jet.d_dq * i_q - jet.l_qq - jet.q_dq * i_d) * k,
        (jet.l_dq * 2 + jet.d_qq * i_q - jet.q_qq * i_d) * k,
    )


@dataclass(frozen=True, slots=True)
class Task:
    """What is certified: the machine with its conditions, and where each holds."""

    choice: CurrentChoice
    reference: Reference
    kinks: tuple[float, ...]
    starts_limited: bool
    curves: dict[str, Callable[[FloatArray], FloatArray]] = field(repr=False)

    @classmethod
    def of(cls, choice: CurrentChoice, reference: Reference) -> Task:
        """What a choice asks for.

        Torques at which the voltage begins or ceases to limit are found by sampling.
        """
        end = float(reference.torque_max)
        kinks, limited = ([], False) if choice.speed is None else _voltage_kinks(choice, end)
        return cls(choice, reference, tuple(kinks), limited, choice.curves(end))

    def exact(self, torque: float) -> tuple[float, float]:
        """Close to the exact currents in A at a torque in N m."""
        at = np.array([torque])
        return float(self.curves["d"](at)[0]), float(self.curves["q"](at)[0])

    def conditions(self, low: float, high: float) -> list[Condition]:
        """Conditions that may hold between two torques."""
        if self.choice.strategy == "id0":
            return ["no i_d"]
        margin = _KINK_MARGIN * float(self.reference.torque_max)
        before = sum(1 for kink in self.kinks if kink < low - margin)
        after = sum(1 for kink in self.kinks if kink <= high + margin)
        if after > before:
            return ["loss", "voltage"]
        return ["voltage" if self.starts_limited ^ (before % 2 == 1) else "loss"]

    def local(
        self, jet: Jet, i_d: Value, i_q: Value, condition: Condition, *, gradient: bool = True
    ) -> Local:
        """Torque and condition with their derivatives; zeros as the gradient of the voltage excess
        where that is no condition and without ``gradient``.
        """
        machine = self.choice.machine
        torque, t_d, t_q, t_dd, t_dq, t_qq = torque_parts(
            jet, i_d, i_q, exactly(1.5 * machine.pole_pairs)
        )
        voltage = self._voltage(machine, jet, i_d, i_q, gradient or condition == "voltage")
        if condition == "loss":
            second = (
                t_q * i_d - t_d * i_q,
                t_q + t_dq * i_d - t_dd * i_q,
                t_qq * i_d - t_d - t_dq * i_q,
            )
        elif condition == "voltage":
            second = voltage
        else:
            second = (i_d, exactly(1.0) + i_d * 0, i_d * 0)
        return Local(torque, t_d, t_q, t_dd, t_dq, t_qq, *second, *voltage)

    def torque_and_excess(self, jet: Jet, i_d: Value, i_q: Value) -> tuple[Value, Value]:
        """Torque in N m and (|v| / v_max)^2 - 1, of the flux linkages alone."""
        machine = self.choice.machine
        torque = (jet.psi_d * i_q - jet.psi_q * i_d) * exactly(1.5 * machine.pole_pairs)
        return torque, self._voltage(machine, jet, i_d, i_q, gradient=False)[0]

    def _voltage(
        self, machine: Machine, jet: Jet, i_d: Value, i_q: Value, gradient: bool
    ) -> tuple[Value, Value, Value]:
        """(|v| / v_max)^2 - 1 and its gradient; zeros where there is no speed."""
        speed = self.choice.speed
        if speed is None:
            return i_d * 0, i_d * 0, i_d * 0
        omega, r_s = exactly(speed.omega_m) * machine.pole_pairs, exactly(machine.r_s)
        scale = 1 / (exactly(speed.v_max) * exactly(speed.v_max))
        v_d, v_q = i_d * r_s - jet.psi_q * omega, i_q * r_s + jet.psi_d * omega
        excess = (v_d * v_d + v_q * v_q) * scale - 1
        if not gradient:
            return excess, exactly(0.0), exactly(0.0)
        by_d = (v_d * (r_s - jet.l_qd * omega) + v_q * (jet.l_dd * omega)) * (2 * scale)
        by_q = (v_q * (r_s + jet.l_dq * omega) - v_d * (jet.l_qq * omega)) * (2 * scale)
        return excess, by_d, by_q


def conditions_over_box(task: Task, box: tuple[arb, arb], condition: Condition) -> Local:
    """Torque and condition over a box of currents, whatever cells it touches."""
    found = [task.local(jet(*box), *box, condition) for jet in jets(task.choice.machine, *box)]
    return Local(
        *(
            hull([as_ball(getattr(part, name)) for part in found])
            for name in Local.__dataclass_fields__
        )
    )


# Machines in ball arithmetic: flux linkages with their derivatives at balls or
# power series of the currents.
#
# Constant inductances are one formula. A flux map is one bicubic polynomial per cell of its grid:
# where an interval of currents lies in several cells, each of their polynomials is followed over
# the whole interval, and the true flux linkage is one of them everywhere.

_MOST_CELLS = 9


@dataclass(frozen=True, slots=True)
class Jet:
    """Flux linkages in Wb and their derivatives by the currents, as `FluxJet` has them."""

    psi_d: Value
    psi_q: Value
    l_dd: Value
    l_dq: Value
    l_qd: Value
    l_qq: Value
    d_dd: Value
    d_dq: Value
    d_qq: Value
    q_dd: Value
    q_dq: Value
    q_qq: Value


JetFunction = Callable[[Value, Value], Jet]


def _linear(machine: LinearMachine) -> JetFunction:
    from flint import arb

    l_d, l_q, psi_pm, zero = arb(machine.l_d), arb(machine.l_q), arb(machine.psi_pm), arb(0)

    def jet(i_d: Value, i_q: Value) -> Jet:
        return Jet(
            i_d * l_d + psi_pm, i_q * l_q, l_d, zero, zero, l_q, zero, zero, zero, zero, zero, zero
        )

    return jet


def _cubic(row: list[Value], x: Value, order: int) -> list[Value]:
    """Value and derivatives up to an order of a cubic, by repeated synthetic division."""
    c0, c1, c2, c3 = row
    first = c3 * x
    sums = first + c2
    second = sums * x + c1
    found = [second * x + c0]
    if order > 0:
        once = first + sums
        found.append(once * x + second)
        if order > 1:
            found.append((first + once) * 2)
    return found


def bicubic(table: Any, i_d: Value, i_q: Value) -> list[Value]:
    """Value and derivatives by d, q, dd, dq, qq of a bicubic, rows by powers of q,
    columns by powers of d.
    """
    along_d = [_cubic(row, i_d, 2) for row in table]
    value, by_q, by_qq = _cubic([row[0] for row in along_d], i_q, 2)
    by_d, by_dq = _cubic([row[1] for row in along_d], i_q, 1)
    (by_dd,) = _cubic([row[2] for row in along_d], i_q, 0)
    return [value, by_d, by_q, by_dd, by_dq, by_qq]


@lru_cache(maxsize=1024)
def _cell(flux_map: FluxMap, row: int, column: int, *, slopes: bool) -> JetFunction:
    from flint import arb

    coefficients, corner_d, corner_q = flux_map.cell(row, column)
    at_d, at_q = arb(corner_d), arb(corner_q)
    tables = [
        [[arb(float(c)) for c in row] for row in coefficients[:, :, flux]] for flux in range(2)
    ]

    def jet(i_d: Value, i_q: Value) -> Jet:
        d, q = (bicubic(table, i_d - at_d, i_q - at_q) for table in tables)
        return Jet(d[0], q[0], d[1], d[2], q[1], q[2], d[3], d[4], d[5], q[3], q[4], q[5])

    def linkages(i_d: Value, i_q: Value) -> Jet:
        x, y = i_d - at_d, i_q - at_q
        psi_d, psi_q = (
            _cubic([_cubic(row, x, 0)[0] for row in table], y, 0)[0] for table in tables
        )
        return Jet(psi_d, psi_q, *[0] * 10)

    return jet if slopes else linkages


def jets(machine: Machine, i_d: arb, i_q: arb, *, slopes: bool = True) -> list[JetFunction]:
    """Formulas of which one holds at every point of a box of currents in A.

    Without ``slopes`` they may leave the derivatives of a flux map at zero.

    Raises:
        TypeError: The machine is neither linear nor a flux map.
        ZeroDivisionError: The box touches so many cells that nothing sharp can come of it.
    """
    if isinstance(machine, LinearMachine):
        return [_linear(machine)]
    if not isinstance(machine, SaturatedMachine):
        raise TypeError(type(machine).__name__)
    found = machine.flux_map
    spans = []
    for ball, cells in ((i_d, found.rows), (i_q, found.columns)):
        ends = np.array([float(ball.lower()), float(ball.upper())])
        first, last = cells(np.nextafter(ends, [-np.inf, np.inf]))
        spans.append(range(int(first), int(last) + 1))
    if len(spans[0]) * len(spans[1]) > _MOST_CELLS:
        raise ZeroDivisionError
    return [_cell(found, row, column, slopes=slopes) for row in spans[0] for column in spans[1]]


# Ball arithmetic over whole arrays: midpoints and radii in doubles, with every rounding error put
# into the radius.
#
# Each operation is done on the midpoints, rounded to nearest: its error is at most 2^-53 of the
# result (and far less than `_LEAST` where it underflows). Radii are sums and products of a few
# non-negative numbers, so that what their own rounding takes away is at most some 2^-50 of them,
# which a factor makes up for. S. M. Rump, "Fast and parallel interval arithmetic", BIT 39 (1999).

_UNIT = 2.0**-52  # Twice the rounding error of one operation.
_MORE = 1.0 + 2.0**-47  # Makes up for the rounding of a radius, which some ten operations make.
_LEAST = 1e-290  # Above what underflow may take from a result.


@dataclass(frozen=True, slots=True, eq=False)
class Balls:
    """Arrays of real numbers of which each is known to lie within ``rad`` of ``mid``.

    Any broadcastable shapes.

    Sums and products take other balls, arrays and numbers (which are exact) and balls of
    python-flint. The number 0 is an exact zero, which products keep: derivatives that vanish then
    cost nothing.
    """

    mid: FloatArray
    rad: FloatArray

    __array_ufunc__: ClassVar[None] = None  # arrays leave operators to this class

    @classmethod
    def exact(cls, values: Any) -> Balls:
        """Doubles as they are."""
        mid = np.asarray(values, dtype=np.float64)
        return cls(mid, np.zeros_like(mid))

    @classmethod
    def between(cls, low: Any, high: Any) -> Balls:
        """Balls that hold everything from ``low`` to ``high``."""
        low, high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        mid = 0.5 * low + 0.5 * high
        return cls(mid, np.maximum(high - mid, mid - low) * _MORE + _LEAST)

    @classmethod
    def of(cls, value: Any) -> Balls:
        """Whatever operators take."""
        if isinstance(value, cls):
            return value
        if hasattr(
            value, "abs_upper"
        ):  # a ball of python-flint: what its midpoint rounds to, and a wider radius
            mid = float(value.mid())
            inside = value.rad() == 0 and value == mid
            return cls(
                np.asarray(mid),
                np.asarray(0.0 if inside else float(value.rad()) * _MORE + abs(mid) * _UNIT),
            )
        return cls.exact(value)

    def __add__(self, other: Any) -> Balls:
        """Sum."""
        if isinstance(other, int | float) and other == 0:
            return self
        right = Balls.of(other)
        mid = self.mid + right.mid
        return Balls(mid, (self.rad + right.rad + np.abs(mid) * _UNIT) * _MORE)

    __radd__ = __add__

    def __neg__(self) -> Balls:
        """Exact."""
        return Balls(-self.mid, self.rad)

    def __sub__(self, other: Any) -> Balls:
        """Difference."""
        return self + (-Balls.of(other))

    def __rsub__(self, other: Any) -> Balls:
        """Difference."""
        return (-self).__add__(other)

    def __mul__(self, other: Any) -> Any:
        """Product; the number 0 stays an exact zero."""
        if isinstance(other, int | float) and other == 0:
            return 0
        right = Balls.of(other)
        mid = self.mid * right.mid
        spread = (np.abs(self.mid) + self.rad) * right.rad + self.rad * np.abs(right.mid)
        return Balls(mid, (spread + np.abs(mid) * _UNIT) * _MORE + _LEAST)

    __rmul__ = __mul__

    def __lt__(self, limit: float) -> bool:
        """Whether everything in all of the balls lies below a number."""
        return bool(np.all(self.upper() < limit))

    def squared(self) -> Balls:
        """Square, which is not negative."""
        low, high = self.abs_lower().mid, self.abs_upper().mid
        return Balls.between(low * low / _MORE, high * high * _MORE + _LEAST)

    def reciprocal(self) -> Balls:
        """One over balls that do not hold zero (elsewhere the result means nothing)."""
        low, high = self.lower(), self.upper()
        return Balls.between(
            1.0 / high - np.abs(1.0 / high) * _UNIT, 1.0 / low + np.abs(1.0 / low) * _UNIT
        )

    def upper(self) -> FloatArray:
        """Doubles not below anything in the balls."""
        high = self.mid + self.rad
        return np.asarray(high + np.abs(high) * _UNIT + _LEAST)

    def lower(self) -> FloatArray:
        """Doubles not above anything in the balls."""
        return -(-self).upper()

    def abs_upper(self) -> Balls:
        """Largest magnitudes, rounded up."""
        return Balls.exact((np.abs(self.mid) + self.rad) * _MORE + _LEAST)

    def abs_lower(self) -> Balls:
        """Least magnitudes, rounded down."""
        least = np.abs(self.mid) - self.rad
        return Balls.exact(np.maximum(least - np.abs(least) * _UNIT - _LEAST, 0.0))

    def widened(self, radius: FloatArray) -> Balls:
        """Balls with larger radii."""
        return Balls(self.mid, (self.rad + radius) * _MORE)

    def at(self, places: Any) -> Balls:
        """Some of the balls, or all of them broadcast."""
        return Balls(self.mid[places], self.rad[places])


def magnitude(value: Any) -> Any:
    """Largest magnitudes as doubles; 0 for the exact zero."""
    return value.abs_upper().mid if isinstance(value, Balls) else abs(value)


def most(value: Any) -> Any:
    """Largest values as doubles, 0 for the exact zero."""
    return value.upper() if isinstance(value, Balls) else value
