"""The current reference in fixed point: a code of the torque in, codes of (i_d, i_q) out, a step
that is model and C.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import copper_loss
from dqforge.machines.names import NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Reals
from dqforge.optimizer.curves.integer_polynomial import (
    CodeScale,
    FixedPolynomial,
    in_code_segments,
)
from dqforge.optimizer.curves.single_precision import (
    SingleArray,
    SinglePolynomial,
    compiled,
    in_segments,
)
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Dq

if TYPE_CHECKING:
    from dqforge.optimizer.steps.integer_arithmetic import Arithmetic as Codes
    from dqforge.optimizer.steps.integer_arithmetic import CodeArray

# Bits of the numbers of each fixed-point format.
FIXED_WIDTHS: dict[NumberFormat, int] = {"q15": 16, "q31": 32}


@dataclass(frozen=True, slots=True)
class FixedReference:
    """Polynomials in integers with their full scales.

    Args:
        d, q: Codes of i_d and i_q over the code of the torque; ``d`` is None where i_d = 0.
        torque_base, current_base: What 2^(width - 1) codes stand for, in N m and A.
    """

    d: FixedPolynomial | None
    q: FixedPolynomial
    torque_base: float
    current_base: float

    @property
    def width(self) -> int:
        """Bits of the numbers, 16 or 32."""
        return self.q.width

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return next(name for name, width in FIXED_WIDTHS.items() if width == self.width)

    @property
    def end(self) -> int:
        """Code at which the magnitude of the torque is clamped."""
        return self.q.end

    @property
    def scale(self) -> CodeScale:
        """Full scales of torque and current."""
        return CodeScale(self.torque_base, self.current_base, self.width)

    @property
    def torque_max(self) -> float:
        """End of the domain in N m."""
        return float(self.scale.arguments(np.array(self.end)))

    def codes(self, torque: CodeArray) -> tuple[CodeArray, CodeArray]:
        """Codes of (i_d, i_q) as the emitted C returns them, for any code of the torque,
        shape (N,).
        """
        from dqforge.optimizer.steps.integer_arithmetic import Integers

        i_d, i_q = self.step(Integers(), torque, np.array(self.end))
        return np.broadcast_to(i_d, torque.shape), np.broadcast_to(i_q, torque.shape)

    def step(self, o: Codes[N, Any], torque: N, end: N) -> tuple[N, N]:
        """Codes of (i_d, i_q) for any code of the torque.

        Args:
            o: The arithmetic.
            torque: A code.
            end: What stands for ``end``.
        """
        asked = o.let("asked", o.narrowed("asked", torque))
        o.remark("Compared before the sign is turned: the least number has no opposite.")
        least = o.narrowed("asked", o.negative(end))
        turned = o.narrowed("asked", o.negative(o.known(asked, -self.end, 0)))
        below = o.let("below", o.choose(o.above(least, asked), end, turned))
        above = o.let("above", o.choose(o.above(asked, end), end, asked))
        backwards, none = o.above(o.const(0), asked), o.const(0)
        size = o.let("x", o.known(o.choose(backwards, below, above), 0, self.end))
        if self.d is None:
            (q,), d = in_code_segments(o, {"q": self.q}, size), none
        elif self.d.starts == self.q.starts:
            d, q = in_code_segments(o, {"d": self.d, "q": self.q}, size)
        else:
            ((d,), (q,)) = (
                in_code_segments(o, {name: own}, size)
                for name, own in (("d", self.d), ("q", self.q))
            )
        return d, o.choose(backwards, o.narrowed("q", o.negative(q)), q)

    def nearest(self, torque: NDArray[Any]) -> CodeArray:
        """Codes of torques in N m, shape (N,), saturated; not-a-number becomes 0."""
        share = np.clip(
            np.nan_to_num(np.asarray(torque, dtype=np.float64) / self.torque_base), -1.0, 1.0
        )
        return np.minimum(np.rint(share * self.scale.one), self.scale.one - 1.0).astype(np.int64)

    def currents(
        self,
        torque: NDArray[Any],
        *,
        fused: bool = False,  # noqa: ARG002
    ) -> tuple[FloatArray, FloatArray]:
        """(i_d, i_q) in A at the codes nearest to torques in N m, shape (N,).

        Integers know no contraction.
        """
        unit = self.current_base / self.scale.one
        i_d, i_q = self.codes(self.nearest(torque))
        return np.multiply(i_d, unit, dtype=np.float64), np.multiply(i_q, unit, dtype=np.float64)

    def samples(self, count: int) -> FloatArray:
        """Torques in N m that have codes: all of them for 16 bits, else some ``count``,
        breakpoints included.
        """
        if self.width <= 16:
            return self.scale.arguments(np.arange(self.end + 1))
        even = np.linspace(0.0, self.end, count)
        low = np.geomspace(1.0, self.end, count // 4)
        starts = np.array(self.starts)
        every = np.unique(
            np.concatenate([np.rint(even), np.rint(low), starts, np.maximum(starts - 1, 0)])
        )
        return self.scale.arguments(every.astype(np.int64))

    @property
    def starts(self) -> tuple[int, ...]:
        """Codes at which segments of either current begin, ascending."""
        polynomials = [polynomial for polynomial in (self.d, self.q) if polynomial is not None]
        return tuple(sorted({start for polynomial in polynomials for start in polynomial.starts}))


# The current references that the firmware evaluates: torque in, (i_d, i_q) out,
# in a handful of forms.
#
# Each form is the list of float32 operations that the header spells out, so that the errors stated
# for it are those of the very arithmetic that runs.

CurrentStep = Callable[[Arithmetic, Reals], Dq]  # From a torque in N m to currents in A.

# Share of the largest torque from which the relative loss penalty is stated; below it both losses
# vanish.
PENALTY_FROM = 0.05


class Asked(NamedTuple):
    """A torque that is asked for: ``torque`` in N m, its magnitude ``t``, and where the domain
    ends, as the firmware has it and as a number.
    """

    torque: Reals
    t: Reals
    end: Any
    last: np.float32


def _asked(o: Arithmetic, torque: Reals, end: Any, last: np.float32) -> Asked:
    return Asked(torque, o.let("t", o.magnitude(torque)), end, last)


def _beyond(o: Arithmetic, torque: Reals, end: Any) -> Reals:
    """The end of the domain next to a torque, 0 for not-a-number."""
    above = o.let("above", o.choose(torque > 0.0, end, 0.0), "0 for not-a-number")
    return o.choose(torque < 0.0, -end, above)


def _ladder(
    o: Arithmetic, asked: Asked, *, clamps: bool = False, **polynomials: SinglePolynomial
) -> tuple[Reals, ...]:
    """Currents by polynomials on the same segments, that of the q axis odd in the torque.

    Args:
        o: The arithmetic.
        asked: The torque.
        clamps: Whether the torque within its domain stands behind the currents.
        polynomials: By names of the currents.
    """
    torque, t, end, last = asked
    ends = np.array([last, 0.0], dtype=np.float32)
    values = {name: polynomial.evaluate(ends) for name, polynomial in polynomials.items()}

    def within(number: int, x: Reals) -> tuple[Any, ...]:
        found = [
            polynomial.odd_within(o, number, x, torque)
            if name == "i_q"
            else polynomial.within(o, number, x)
            for name, polynomial in polynomials.items()
        ]
        return (*found, torque) if clamps else tuple(found)

    def beyond() -> tuple[Any, ...]:
        o.remark("the result at the end of the domain")
        found = [
            o.choose(torque < 0.0, float(-most), float(most)) if name == "i_q" else float(most)
            for name, (most, _) in values.items()
        ]
        return (*found, o.choose(torque < 0.0, -end, end)) if clamps else tuple(found)

    def rest() -> tuple[Any, ...]:
        o.remark("not-a-number: the result without torque")
        found = [float(least) for _, least in values.values()]
        return (*found, 0.0) if clamps else tuple(found)

    names = (*polynomials, "torque") if clamps else tuple(polynomials)
    starts = next(iter(polynomials.values())).starts
    return in_segments(o, names, starts, t, within, (t <= end, (t > end, beyond), rest))


@dataclass(frozen=True, slots=True)
class Proportional:
    """i_d = 0, i_q = gain T: surface machines, and i_d = 0 control of any machine.
    ``gain`` in A/(N m).
    """

    gain: np.float32

    def step(self, o: Arithmetic, torque: Reals, end: Any, _last: np.float32) -> Dq:
        """Currents in A for a torque in N m, shape (N,), and its largest magnitude."""
        held = o.cases(
            "torque",
            (o.magnitude(torque) <= end, lambda: torque),
            otherwise=lambda: _beyond(o, torque, end),
        )
        return Dq(o.full(0.0, torque), float(self.gain) * held)


@dataclass(frozen=True, slots=True)
class Polynomials:
    """i_d(T) and i_q(T) as piecewise polynomials in A over N m (paper 000, (31) and (34))."""

    d: SinglePolynomial
    q: SinglePolynomial

    def step(self, o: Arithmetic, torque: Reals, end: Any, last: np.float32) -> Dq:
        """As of `Proportional`; one ladder of segments where both currents share theirs."""
        asked = _asked(o, torque, end, last)
        if np.array_equal(self.d.starts, self.q.starts):
            return Dq(*_ladder(o, asked, i_d=self.d, i_q=self.q))
        return Dq(*_ladder(o, asked, i_d=self.d), *_ladder(o, asked, i_q=self.q))


@dataclass(frozen=True, slots=True)
class TorqueExact:
    """i_d(T) as a piecewise polynomial and i_q = T / (magnet + slope i_d):
    no torque error by construction.

    ``magnet`` = 3/2 p psi_pm in N m/A, ``slope`` = 3/2 p (l_d - l_q) in N m/A^2.
    """

    d: SinglePolynomial
    magnet: np.float32
    slope: np.float32

    def step(self, o: Arithmetic, torque: Reals, end: Any, last: np.float32) -> Dq:
        """As of `Proportional`."""
        i_d, held = _ladder(o, _asked(o, torque, end, last), i_d=self.d, clamps=True)
        return Dq(i_d, held / o.multiply_add(float(self.slope), i_d, float(self.magnet)))


@dataclass(frozen=True, slots=True)
class ClosedForm:
    """i_q(T) as a piecewise polynomial and i_d from it by the MTPA locus, with one square root.

    i_d = sign (base - sqrt(base^2 + i_q^2)), ``base`` = psi_pm / (2 |l_q - l_d|) in A, ``sign``
    that of l_q - l_d (paper 000, (15)). The current lies on the optimum locus, whatever the error
    of i_q. sqrtf of the stored square gives back ``base`` exactly, so that i_d(0) = 0.
    """

    q: SinglePolynomial
    base: np.float32
    sign: int

    @property
    def base_squared(self) -> np.float32:
        """Square of ``base`` in A^2, rounded to float."""
        return self.base * self.base

    def step(self, o: Arithmetic, torque: Reals, end: Any, last: np.float32) -> Dq:
        """As of `Proportional`."""
        (i_q,) = _ladder(o, _asked(o, torque, end, last), i_q=self.q)
        root, base = o.root(o.multiply_add(i_q, i_q, float(self.base_squared))), float(self.base)
        return Dq(base - root if self.sign > 0 else root - base, i_q)


@dataclass(frozen=True, slots=True)
class ReluctanceClosedForm:
    """i_q = sqrt(gain T), i_d = +-i_q: the exact optimum of a machine without magnet.
    ``gain`` in A^2/(N m).
    """

    gain: np.float32
    sign: int

    def step(self, o: Arithmetic, torque: Reals, end: Any, _last: np.float32) -> Dq:
        """As of `Proportional`."""
        size_asked = o.let("t_asked", o.magnitude(torque))

        def beyond() -> tuple[Reals, Reals]:
            found = o.let("held", _beyond(o, torque, end))
            return found, o.magnitude(found)

        inside = size_asked <= end, lambda: (torque, size_asked)
        held, t = o.cases(("torque", "t"), inside, otherwise=beyond)
        size = o.let("size", o.root(float(self.gain) * t))
        return Dq(-size if self.sign > 0 else size, o.choose(held < 0.0, -size, size))


Form = Proportional | Polynomials | TorqueExact | ClosedForm | ReluctanceClosedForm


@dataclass(frozen=True, slots=True)
class CurrentReference:
    """A form with its domain: i_d is even and i_q odd in the torque, which is
    clamped to +-``torque_max`` N m.
    """

    form: Form
    torque_max: np.float32

    def step(self, o: Arithmetic, torque: Reals, end: Any) -> Dq:
        """Currents in A for any torque in N m, shape (N,); not-a-number gives those of none.

        Args:
            o: The arithmetic.
            torque: In N m.
            end: What stands for ``torque_max``.
        """
        return self.form.step(o, torque, end, self.torque_max)

    def currents(
        self, torque: NDArray[Any], *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        """(i_d, i_q) in A as the emitted C returns them, bit for bit, for any float32
        torque in N m, shape (N,).

        NaN gives the reference of zero torque. ``fused`` models a compiler that
        contracts products and sums.
        """
        asked = np.asarray(torque, dtype=np.float32)
        with np.errstate(invalid="ignore", under="ignore"):
            i_d, i_q = self.step(compiled(fused=fused), asked, self.torque_max)
        return i_d, i_q

    def samples(self, count: int) -> SingleArray:
        """Torques in [0, torque_max]: evenly and logarithmically spaced, and both
        neighbours of each breakpoint.
        """
        end = self.torque_max
        parts: list[NDArray[Any]] = [
            np.linspace(0.0, float(end), count),
            np.geomspace(1e-6, 1.0, count // 4) * float(end),
        ]
        for polynomial in (getattr(self.form, name, None) for name in ("d", "q")):
            if isinstance(polynomial, SinglePolynomial):
                edges = polynomial.starts[1:]
                parts += [edges, np.nextafter(edges, np.float32(0.0))]
        return np.unique(np.minimum(np.concatenate(parts).astype(np.float32), end))


@dataclass(frozen=True, slots=True)
class SignedReference:
    """Two references, of a machine whose halves differ: one for torques >= 0, one for those below.

    ``negative`` is that of the mirrored machine, whose torque and i_q count the other way.
    """

    positive: CurrentReference
    negative: CurrentReference

    @property
    def torque_max(self) -> np.float32:
        """Torque in N m that both signs have."""
        return min(self.positive.torque_max, self.negative.torque_max)

    def currents(
        self, torque: NDArray[Any], *, fused: bool = False
    ) -> tuple[SingleArray, SingleArray]:
        """(i_d, i_q) in A as `CurrentReference.currents`; not-a-number is no negative torque."""
        asked, o = np.asarray(torque, dtype=np.float32), compiled(fused=fused)
        parts = self.steps(self.positive.torque_max, self.negative.torque_max)
        with np.errstate(invalid="ignore", under="ignore"):
            i_d, i_q = self.by_sign(o, asked, *parts)
        return i_d, i_q

    def steps(self, end: Any, end_negative: Any) -> tuple[CurrentStep, CurrentStep]:
        """The steps of either sign, from what stands for the ends of their domains."""

        def current_reference_positive(o: Arithmetic, torque: Reals) -> Dq:
            """Current references of torques from 0 on."""
            return self.positive.step(o, torque, end)

        def current_reference_negative(o: Arithmetic, torque: Reals) -> Dq:
            """Current references of torques below 0."""
            return self.negative.step(o, torque, end_negative)

        return current_reference_positive, current_reference_negative

    def by_sign(
        self, o: Arithmetic, torque: Reals, positive: CurrentStep, negative: CurrentStep
    ) -> Dq:
        """Currents in A for any torque in N m, shape (N,), by one of two steps."""
        i_d, i_q = o.cases(
            ("i_d", "i_q"),
            (torque < 0.0, lambda: tuple(o.call(negative, torque))),
            otherwise=lambda: tuple(o.call(positive, torque)),
        )
        return Dq(i_d, i_q)

    def samples(self, count: int) -> SingleArray:
        """Magnitudes of torques in both domains, as `CurrentReference.samples`."""
        return np.union1d(self.positive.samples(count), self.negative.samples(count))


# One reference of the firmware, even and odd in the torque: in floats, in N m and A, or in fixed
# point.
FloatReference = CurrentReference | SignedReference
Reference = CurrentReference | FixedReference
Emitted = Reference | SignedReference  # What the firmware evaluates.


@dataclass(frozen=True, slots=True)
class ReferenceErrors:
    """Largest errors found over a dense set of torques, with and without fused multiply-add.

    ``i_d``, ``i_q`` in A against the exact strategy; ``torque`` in N m against the request;
    ``torque_relative`` is that over the largest torque; ``loss`` in W is the copper loss above the
    least for the torque that is produced; ``loss_relative`` the same over that least loss, from 5 %
    of the largest torque upwards; ``step_at_zero`` in A is the error of the current at zero torque;
    ``voltage_excess`` is the largest phase voltage at the reference's speed above the limit,
    relative to it, None where there is no speed. Found by sampling: not bounds.
    """

    i_d: float
    i_q: float
    torque: float
    torque_relative: float
    loss: float
    loss_relative: float
    step_at_zero: float
    voltage_excess: float | None
    samples: int


@dataclass(frozen=True, slots=True)
class ErrorCurves:
    """Errors over the torque axis, arrays of shape (N,).

    Torque in N m, errors of i_d and i_q in A and of the torque in N m, excess copper loss in W and
    relative to the least loss, and the phase voltage in V at the speed of the choice (at rest where
    it has none).
    """

    torque: FloatArray
    i_d: FloatArray
    i_q: FloatArray
    torque_error: FloatArray
    loss: FloatArray
    loss_relative: FloatArray
    voltage: FloatArray


def error_curves(
    choice: CurrentChoice, reference: Reference, torque: NDArray[Any], *, fused: bool = False
) -> ErrorCurves:
    """Compare the arithmetic of a reference with the exact strategy in double at torques
    >= 0 that it knows, (N,).

    Args:
        choice: Machine, strategy and limits: the exact currents.
        reference: What the emitted C computes.
        torque: Torques in N m, or codes of them, shape (N,).
        fused: Whether products and sums are contracted.
    """
    machine = choice.machine
    i_d, i_q = (
        np.asarray(current, dtype=np.float64) for current in reference.currents(torque, fused=fused)
    )
    request = np.asarray(torque, dtype=np.float64)
    exact_d, exact_q = choice.currents(request)
    produced = machine.torque(i_d, i_q)
    # The loss that an exact strategy would need for the torque that is really produced.
    least_d, least_q = choice.currents(produced)
    least = copper_loss(machine.r_s, least_d, least_q)
    excess = copper_loss(machine.r_s, i_d, i_q) - least
    relative = np.divide(excess, least, out=np.zeros_like(excess), where=least > 0.0)
    omega_m = 0.0 if choice.speed is None else choice.speed.omega_m
    voltage = np.hypot(*machine.voltage(i_d, i_q, np.full_like(i_d, machine.pole_pairs * omega_m)))
    return ErrorCurves(
        request, i_d - exact_d, i_q - exact_q, produced - request, excess, relative, voltage
    )


def reference_errors(
    choice: CurrentChoice, reference: Reference, samples: int = 4000
) -> ReferenceErrors:
    """Largest errors of the reference over its domain, in the arithmetic of the
    emitted C (both contractions).

    Args:
        choice: Machine, strategy and limits: the exact currents.
        reference: What the emitted C computes.
        samples: Number of torques.
    """
    torque = reference.samples(samples)
    contractions = (False,) if isinstance(reference, FixedReference) else (False, True)
    curves = [error_curves(choice, reference, torque, fused=fused) for fused in contractions]
    loaded = torque >= PENALTY_FROM * float(reference.torque_max)

    def worst(name: str) -> float:
        return max(float(np.max(np.abs(getattr(curve, name)))) for curve in curves)

    rest_d, rest_q = (curves[0].i_d[:1], curves[0].i_q[:1])  # the samples begin at zero torque
    taken = max(float(np.max(curve.voltage)) for curve in curves)
    return ReferenceErrors(
        i_d=worst("i_d"),
        i_q=worst("i_q"),
        torque=worst("torque_error"),
        torque_relative=worst("torque_error") / float(reference.torque_max),
        loss=worst("loss"),
        loss_relative=max(float(np.max(curve.loss_relative[loaded])) for curve in curves),
        step_at_zero=float(np.hypot(rest_d[0], rest_q[0])),
        voltage_excess=None if choice.speed is None else max(taken / choice.speed.v_max - 1.0, 0.0),
        samples=len(curves) * torque.size,
    )
