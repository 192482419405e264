"""The back-EMF from its table, and the currents that belong to it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.phase_control.phase_records import Alphabetazero, ControlGains, Shape
from dqforge.optimizer.phase_control.shape_frame import LEAST_SQUARE
from dqforge.optimizer.steps.step_arithmetic import Abc, AlphaBeta, Arithmetic, Dq, Rotation

_THIRD, _HALF_ROOT_3 = 0.33333334, 0.8660254
_FAR = 65536.0  # Lengths of a table; beyond them a place counts as its begin.


def mean_of_phases(x: Abc) -> Reals:
    """The zero sequence."""
    return _THIRD * ((x.a + x.b) + x.c)


@dataclass(frozen=True, slots=True)
class PlaceInTable:
    """Where a place lies among the nodes of a table of the angle.

    Args:
        places: Nodes of the phases a, b, c.
        share: What is passed of the interval behind them; 0 where it is not asked for.
    """

    places: tuple[Any, ...]
    share: Reals


def place_in_table(
    o: Arithmetic, place: Reals, nodes: int, rows: int, *, shared: bool = True
) -> PlaceInTable:
    """Nodes of the phases at a place in lengths of a table of one row, where b and c lag by 120 and
    240 degrees, or of three; ``shared`` asks for the share of the interval, too.
    """

    def within() -> Reals:
        part = o.let("part", place - o.real(o.whole(place)))
        return o.choose(part < 0.0, part + 1.0, part)

    known = (place < _FAR) & (place > -_FAR)
    passed = o.cases("passed", (known, within), otherwise=lambda: o.full(0.0, place))
    x = o.let("x", passed * float(nodes))
    k = o.placed("k", x, nodes - 1)
    share = o.let("share", x - o.real(k)) if shared else o.full(0.0, x)
    if rows == 3:
        return PlaceInTable((k, k, k), share)
    third = nodes // 3
    k_b = o.let("k_b", o.choose(k < third, k + 2 * third, k - third))
    k_c = o.let("k_c", o.choose(k < 2 * third, k + third, k - 2 * third))
    return PlaceInTable((k, k_b, k_c), share)


@dataclass(frozen=True, slots=True)
class ShapeSteps:
    """Reading of the back-EMF.

    Args:
        nodes, rows: Intervals of the table, and its rows: 1, or 3 for the phases.
        per_rad: Intervals per rad.
    """

    nodes: int
    rows: int
    per_rad: float

    def _ends(self, o: Arithmetic, shape: Shape, at: PlaceInTable) -> list[tuple[Reals, Reals]]:
        rows = shape.flux if self.rows == 3 else (o.let("row", shape.flux[0]),) * 3
        return [(o.at(row, k), o.at(row, k + 1)) for row, k in zip(rows, at.places, strict=True)]

    def shape_at(
        self, o: Arithmetic, shape: Shape, place: Reals, opened: Reals | None = None
    ) -> Alphabetazero:
        """Back-EMF over electrical speed in Wb at a place in lengths of its table; the first entry
        beyond 65536 and for not-a-number. opened: phase without current, 1 to 3.
        """
        at = place_in_table(o, place, self.nodes, self.rows)
        share = at.share
        ends = self._ends(o, shape, at)
        return _seen(o, [here + (share * (there - here)) for here, there in ends], opened)

    def slope_at(
        self, o: Arithmetic, shape: Shape, place: Reals, opened: Reals | None = None
    ) -> Alphabetazero:
        """Derivative by the angle of the back-EMF over electrical speed in Wb/rad at a place in
        lengths of its table; the first entry beyond 65536 and for not-a-number. opened: phase
        without current, 1 to 3.
        """
        at = place_in_table(o, place, self.nodes, self.rows, shared=False)
        ends = self._ends(o, shape, at)
        return _seen(o, [self.per_rad * (there - here) for here, there in ends], opened)


def _seen(o: Arithmetic, values: list[Reals], opened: Reals | None) -> Alphabetazero:
    """Stationary coordinates of phase values, of which that of an open phase counts as none."""
    f = o.let("whole" if opened is not None else "f", Abc(*values))
    if opened is not None:
        kept = (o.choose(o.equal(opened, n), o.full(0.0, x), x) for n, x in enumerate(f, 1))
        f = o.let("f", Abc(*kept))
    plane = o.let("plane", o.clarke(f))
    return Alphabetazero(plane.alpha, plane.beta, mean_of_phases(f))


def reference_at(
    o: Arithmetic,
    gains: ControlGains,
    f: Alphabetazero,
    turn: Rotation,
    torque: Reals,
    d: Reals,
    fade: Reals,
    zero: Reals,
) -> Alphabetazero:
    """Currents in A that make a torque of the shape f, and a constant current of the d axis. fade:
    share of the shape beside its fundamental. zero: share of its zero sequence that flows; the
    torque stays.
    """

    def faded() -> Alphabetazero:
        rest = o.let("rest", (1.0 - fade) * gains.psi_pm)
        return Alphabetazero(
            (fade * f.alpha) - (rest * turn.sine),
            (fade * f.beta) + (rest * turn.cosine),
            fade * f.zero,
        )

    seen = o.cases("seen", (fade < 1.0, faded), otherwise=lambda: f)
    plane = 1.5 * ((seen.alpha * seen.alpha) + (seen.beta * seen.beta))
    both = plane + ((3.0 * zero) * (seen.zero * seen.zero))
    square = o.let("square", gains.pole_pairs * both)
    scale = o.let("scale", o.choose(square > LEAST_SQUARE, torque / square, o.full(0.0, square)))
    return Alphabetazero(
        (scale * seen.alpha) + (d * turn.cosine),
        (scale * seen.beta) + (d * turn.sine),
        scale * (zero * seen.zero),
    )


@dataclass(frozen=True, slots=True)
class WaveformSteps:
    """References from the header of phase currents.

    Args:
        currents: Phase currents in A of a torque in N m and the sine and cosine of the angle.
    """

    currents: Callable[..., Iterable[Any]]

    def waveform_reference(
        self, o: Arithmetic, turn: Rotation, torque: Reals, d: Reals, zero: Reals
    ) -> Alphabetazero:
        """Currents in A of the header of phase currents for a torque, and a constant current of the
        d axis; zero: share of their zero sequence.
        """
        arguments = (torque, turn.sine, turn.cosine)
        phase = o.outside(Abc, "phase_currents", self.currents, *arguments, filled="phase")
        plane = o.let("plane", o.clarke(phase))
        return Alphabetazero(
            plane.alpha + (d * turn.cosine),
            plane.beta + (d * turn.sine),
            zero * mean_of_phases(phase),
        )


def turning_reference(o: Arithmetic, reference: Dq, turn: Rotation) -> Alphabetazero:
    """Constant currents of the d and q axes in A."""
    plane = o.let("plane", o.park_inverse(reference, turn))
    return Alphabetazero(plane.alpha, plane.beta, o.full(0.0, plane.alpha))


def balanced(
    o: Arithmetic, i: Alphabetazero, f: Alphabetazero, balance: Reals, opened: Reals
) -> Alphabetazero:
    """Currents in A less a zero sequence that balances the midpoint, of which two phases take it
    where one is open; without the part that would make torque.
    """
    plane = 1.5 * ((f.alpha * f.alpha) + (f.beta * f.beta))
    square = o.let("square", plane + (3.0 * (f.zero * f.zero)))
    none, one = o.full(0.0, square), o.full(1.0, square)

    def two() -> tuple[Reals, Reals]:
        side = o.full(_HALF_ROOT_3, square), o.full(-_HALF_ROOT_3, square)
        across = o.choose(o.equal(opened, 2), *side)
        return (
            balance * o.choose(o.equal(opened, 1), one, o.full(-0.5, square)),
            balance * o.choose(o.equal(opened, 1), none, across),
        )

    alpha, beta = o.cases(("alpha", "beta"), (opened > 0, two), otherwise=lambda: (none, none))
    along = 1.5 * ((f.alpha * alpha) + (f.beta * beta))
    part = o.let("part", along - (3.0 * (f.zero * balance)))
    scale = o.let("scale", o.choose(square > LEAST_SQUARE, part / square, none))
    return Alphabetazero(
        i.alpha + (alpha - (scale * f.alpha)),
        i.beta + (beta - (scale * f.beta)),
        i.zero - (balance + (scale * f.zero)),
    )


def linkage(o: Arithmetic, gains: ControlGains, i: Alphabetazero, turn: Rotation) -> AlphaBeta:
    """Flux linkage in Wb of currents in A, by the inductances of d and q."""
    plane = o.let("plane", AlphaBeta(i.alpha, i.beta))
    turned = o.let("inside", o.park(plane, turn))
    linked = o.let("linked", Dq(gains.l_d * turned.d, gains.l_q * turned.q))
    return o.park_inverse(linked, turn)
