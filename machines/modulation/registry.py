"""All modulators by name: the records of the files in ``families``, in the order of
`dqforge.machines.names.ModulationName`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import BoolArray, FloatArray, IndexArray
from dqforge.machines.modulation import families
from dqforge.machines.modulation.modulator import REACTIVE, SIXTY, THIRTY, Modulator
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import (
    DOUBLES,
    Floats,
    N,
    Numbers,
    Pair,
    Reals,
    Triple,
    clarke,
    clarke_inverse,
    park,
)


def _found() -> dict[ModulationName, Modulator]:
    """The records of all files, in the order of the words; a word without a record is an error."""
    files = (
        import_module(f"{families.__name__}.{file.name}")
        for file in iter_modules(families.__path__)
    )
    records = {record.name: record for file in files for record in file.MODULATORS}
    return {name: records[name] for name in get_args(ModulationName)}


_RECORDS = _found()

# The modulators by name, continuous ones first.
MODULATORS: Mapping[ModulationName, Modulator] = MappingProxyType(_RECORDS)


@contextmanager
def registered(*modulators: Modulator) -> Iterator[None]:
    """Let further modulators count as those of the package, as long as the context lasts.

    Args:
        modulators: Their records, whose names are new.

    Raises:
        ValueError: A name is taken.
    """
    taken = [record.name for record in modulators if record.name in _RECORDS]
    if taken:
        raise ValueError(f"there is a modulator {taken[0]} already")
    try:
        _RECORDS.update((record.name, record) for record in modulators)
        yield
    finally:
        for record in modulators:
            _RECORDS.pop(record.name, None)


# Overmodulation on the voltage hexagon: the vector that the duty cycles make of one beyond it, up
# to six-step operation, with the fundamental that was asked for.
#
# A vector of the amplitude m (over v_dc) is asked for; while it turns, the method is fed a circle
# of another radius, so that the fundamental of what it makes is m. Two methods::
#
#     least phase error      the vector is shortened along its direction onto the hexagon; from
#                            sqrt(3) ln(3) / pi = 0.6057 on its place along the side is stretched
#                            from the middle, and the corners are held
#     least magnitude error  the end of the vector moves to the nearest point of the hexagon; from
#                            1/3 + sqrt(3) / (2 pi) = 0.6090 on that is a corner some of the time
#
# The radius fed, and the reciprocals that rise without bound towards six-step operation, are
# polynomials of a square root: in it they are smooth up to the end, where their slope over m is
# infinite.
#
# References:
#     J. Holtz, W. Lotzkat, A. M. Khambadkone, "On continuous control of PWM inverters in the
#   overmodulation range including the six-step mode", IEEE Transactions on Power Electronics 8(4),
#   1993, doi:10.1109/63.261026 (two ranges, hold of the corners). A. M. Hava, R. J. Kerkman, T. A.
#   Lipo, "Carrier-based PWM-VSI overmodulation strategies: analysis, comparison, and design", IEEE
#     Transactions on Power Electronics 13(4), 1998, doi:10.1109/63.704136 (least magnitude error is
#     what saturated space-vector modulation does). The polynomials and the stretched side are our
#     own.

_Turn = TypeVar("_Turn")

# Radius over v_dc of the circle in the hexagon: the largest fundamental without overmodulation.
INSCRIBED = 1.0 / math.sqrt(3.0)

# Fundamental over v_dc of a vector that follows the hexagon at constant speed, 0.6057.
HEXAGON = math.sqrt(3.0) * math.log(3.0) / math.pi
SIX_STEP = 2.0 / math.pi  # Fundamental over v_dc of six-step operation.

# Least of the reciprocals that go to zero at six-step operation; it leaves a fundamental of 1e-7
# less.
LEAST_HOLD = 1.0e-3


@dataclass(frozen=True, slots=True)
class HexagonMethod:
    """One method of overmodulation.

    Args:
        name: As in a design file.
        text: What it does, in a line.
        radial: Whether the vector is shortened along its direction.
        turning: Fundamental over v_dc from which on corners are held.
        arc_end: Fundamental whose distance from m goes into the root of ``arc``.
        arc: Polynomial of sqrt(arc_end - m), lowest power first: radius over v_dc of the circle
            that the method is fed below ``turning``.
        hold: Polynomial of sqrt(SIX_STEP - m), lowest power first, from ``turning`` on. Least phase
            error: reciprocal of the stretch along the side. Least magnitude error: v_dc over the
            radius of the circle.
    """

    name: OvermodulationName
    text: str
    radial: bool
    turning: float
    arc_end: float
    arc: tuple[float, ...]
    hold: tuple[float, ...]


# Fitted in the largest relative error of the fundamental: 3e-5 (arc) and 3e-6 (hold) with least
# phase error, 2.5e-5 and 4e-7 with least magnitude error; float32 as they are written.
# The methods by name.
METHODS: Mapping[OvermodulationName, HexagonMethod] = MappingProxyType(
    {
        "least-phase-error": HexagonMethod(
            name="least-phase-error",
            text="the vector is shortened along its direction onto the hexagon",
            radial=True,
            turning=HEXAGON,
            arc_end=HEXAGON,
            arc=(0.6677227, -0.7014633, 1.8265866, -10.255876, 30.964746),
            hold=(-0.0006543373, 5.3520765, -0.53342336, 13.968511),
        ),
        "least-magnitude-error": HexagonMethod(
            name="least-magnitude-error",
            text="the end of the vector moves to the nearest point of the hexagon",
            radial=False,
            turning=1.0 / 3.0 + math.sqrt(3.0) / (2.0 * math.pi),
            arc_end=0.6109,
            arc=(0.71753544, -1.4505526, 7.8532286, -35.459316, 71.005295),
            hold=(0.00015003931, 9.201491, 0.13618897, -7.227792),
        ),
    }
)


def follows_hexagon(modulation: ModulationName) -> bool:
    """Whether a modulator's duty cycles make every vector of the hexagon.

    Those that add nothing or a third harmonic do not: at the corners their zero sequence would take
    two phases beyond the rails.

    Args:
        modulation: The modulator.
    """
    return MODULATORS[modulation].kind not in ("sine", "third-harmonic")


def overmodulated(name: OvermodulationName, vector: Pair[Reals], v_dc: Reals) -> Pair[Reals]:
    """What the duty cycles make of voltage vectors: the same within the circle in the hexagon,
    beyond it a vector on the hexagon or within, by the method.

    Args:
        name: The method; ``none`` leaves the vectors as they are.
        vector: Alpha and beta in V, arrays of one floating-point type and shape (...).
        v_dc: DC-link voltage in V, of the same type, shape (...). Without it nothing is changed.
    """
    o = Floats(vector.x.dtype.type)
    if name == "none" or not np.any(_beyond(_square(vector), v_dc)):
        return vector
    return on_hexagon(o, METHODS[name], vector, v_dc, lambda v: clarke_inverse(o, v))


def _square(vector: tuple[Any, Any]) -> Reals:
    found: Reals = (vector[0] * vector[0]) + (vector[1] * vector[1])
    return found


def _beyond(square: Reals, v_dc: Reals) -> Any:
    """Whether voltages, given squared, lie beyond the circle in the hexagon."""
    return (v_dc > 0.0) & (square > (1.0 / 3.0) * (v_dc * v_dc))


_Vector = TypeVar("_Vector", bound=tuple[Any, Any])


def on_hexagon(
    o: Floats,
    method: HexagonMethod,
    vector: _Vector,
    v_dc: Reals,
    phases: Callable[[_Vector], Any],
) -> _Vector:
    """The step of `overmodulated`, which is emitted.

    Args:
        o: The arithmetic.
        method: The method.
        vector: Alpha and beta in V, any shape.
        v_dc: DC-link voltage in V.
        phases: Stationary coordinates to phases.
    """
    square = o.let("square", _square(vector))

    def outer() -> _Vector:
        side = _nearest_side(o, phases(vector))
        index = o.let("index", o.root(square) / v_dc)
        return (_shortened if method.radial else _moved)(o, method, vector, v_dc, index, side)

    return o.cases("made", (_beyond(square, v_dc), outer), otherwise=lambda: vector)


class _Side(NamedTuple):
    """The side of the hexagon that a vector is nearest to.

    Args:
        along: Voltage of the phase between the two others.
        across: Difference of these.
        span: Its magnitude.
        is_a, is_b: Whether that phase is a, and, where it is not, whether it is b.
    """

    along: Reals
    across: Reals
    span: Reals
    is_a: Callable[[], Any]
    is_b: Callable[[], Any]


def _nearest_side(o: Floats, phases: Any) -> _Side:
    v = o.let("v", phases)
    ab, bc, ca = o.let("ab", v[0] - v[1]), o.let("bc", v[1] - v[2]), o.let("ca", v[2] - v[0])
    sizes = [
        o.let(f"{name}_size", o.magnitude(x)) for name, x in (("ab", ab), ("bc", bc), ("ca", ca))
    ]

    def is_a() -> Any:
        return (sizes[1] >= sizes[0]) & (sizes[1] >= sizes[2])

    def is_b() -> Any:
        return sizes[2] >= sizes[0]

    along, across = o.cases(
        ("middle", "side"),
        (is_a(), lambda: (v[0], bc)),
        (is_b(), lambda: (v[1], -ca)),
        otherwise=lambda: (v[2], ab),
    )
    return _Side(along, across, o.let("span", o.magnitude(across)), is_a, is_b)


def _gain(o: Floats, method: HexagonMethod, index: Reals) -> Reals:
    """Radius of the circle that is fed over that of the vector, below the turning."""
    root = o.let("root", o.root(method.arc_end - index))
    return _polynomial(method.arc, root) / index


def _hold(o: Floats, method: HexagonMethod, index: Reals) -> Reals:
    """What the corners are held by, from the turning on."""
    left = o.let("left", SIX_STEP - index)
    root = o.let("root", o.root(o.choose(left > 0.0, left, 0.0)))
    hold = o.let("hold", _polynomial(method.hold, root))
    return o.let("held", o.choose(hold < LEAST_HOLD, LEAST_HOLD, hold))


def _shortened(
    o: Floats, method: HexagonMethod, vector: _Vector, v_dc: Reals, index: Reals, side: _Side
) -> _Vector:
    """The vector shortened along its direction, or its place stretched along the side."""

    def turned() -> _Vector:
        full = o.let("full", _gain(o, method, index))
        gain = o.let("gain", o.choose(full * side.span > v_dc, v_dc / side.span, full))
        return _scaled(vector, gain)

    def held() -> _Vector:
        along = (side.along * v_dc) / (side.span * _hold(o, method, index))
        return _on_side(o, vector, along, v_dc, side)

    return o.cases("limited", (index < method.turning, turned), otherwise=held)


def _moved(
    o: Floats, method: HexagonMethod, vector: _Vector, v_dc: Reals, index: Reals, side: _Side
) -> _Vector:
    """The vector of the circle that is fed, or its nearest point of the hexagon."""

    def turned() -> tuple[Reals, Reals]:
        gain = o.let("grown", _gain(o, method, index))
        return gain, gain * side.along

    def held() -> tuple[Reals, Reals]:
        return o.full(0.0, index), side.along / (index * _hold(o, method, index))

    gain, along = o.cases(("gain", "place"), (index < method.turning, turned), otherwise=held)
    inside = (index < method.turning) & (gain * side.span <= v_dc)
    return o.cases(
        "limited",
        (inside, lambda: _scaled(vector, gain)),
        otherwise=lambda: _on_side(o, vector, along, v_dc, side),
    )


def _like(vector: _Vector, x: Reals, y: Reals) -> _Vector:
    """Components as a vector of the same kind."""
    kind: Any = type(vector)
    return cast("_Vector", kind(x, y))


def _scaled(vector: _Vector, gain: Reals) -> _Vector:
    return _like(vector, gain * vector[0], gain * vector[1])


def _polynomial(coefficients: tuple[float, ...], root: Reals) -> Reals:
    """A polynomial, lowest power first."""
    value: Any = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = coefficient + (value * root)
    found: Reals = value
    return found


def _on_side(o: Floats, vector: _Vector, along: Reals, v_dc: Reals, side: _Side) -> _Vector:
    """The vector of a voltage of the middle phase and the whole voltage between the two others."""
    place, corner = o.let("along", along), o.let("corner", (1.0 / 3.0) * v_dc)
    lower = o.let("lower", o.choose(place < -corner, -corner, place))
    middle = o.let("clamped", o.choose(place > corner, corner, lower))
    whole = o.let("whole", o.choose(side.across < 0.0, -v_dc, v_dc))
    root = 1.0 / math.sqrt(3.0)

    def far(*, is_b: bool) -> _Vector:
        across = o.let("across", ((0.5 * whole) + (1.5 * middle)) * root)
        return _like(vector, 0.5 * (whole - middle), across if is_b else -across)

    return o.cases(
        "on_side",
        (side.is_a(), lambda: _like(vector, middle, root * whole)),
        (side.is_b(), lambda: far(is_b=True)),
        otherwise=lambda: far(is_b=False),
    )


# Zero sequence of all modulators, written once for every kind of number
# (`dqforge.machines.transforms.Numbers`).
#
# ::
#
#     SPWM           V0 = v_dc / 2
#     THIPWM6        V0 = v_dc / 2 - V cos(3 alpha) / 6
#     THIPWM4        V0 = v_dc / 2 - V cos(3 alpha) / 4
#     SVPWM          V0 = (v_dc - V_max - V_min) / 2
#     discontinuous  V0 = v_dc - V_max where the highest phase rests, -V_min where the lowest does
#
# with alpha the angle of the voltage vector from phase a. Paper 000 (14) prints -V_max in the last
# case, which would clamp no phase. Which of the two phases rests:
#
# ::
#
#     DPWMMAX, DPWMMIN    always the highest, always the lowest
#     DPWM1, DPWM3        that with the larger, the smaller reference
#     DPWM0, DPWM2        that with the larger reference 30 degrees ahead, behind
#     GDPWM               that with the larger reference at the load angle, up to 30 degrees
#     DDT-GDPWM           that with the larger current
#
# Of equal references the first is the highest and the last is the lowest, so that the two are never
# the same phase; where both might rest equally well it is the highest.


def zero_sequence_of(
    o: Numbers[N, Any],
    name: ModulationName,
    v: Triple[N],
    i: Triple[N],
    v_dc: N,
    vector: Pair[N] | None = None,
    turn: Pair[N] | None = None,
    seen: Triple[N] | None = None,
) -> N:
    """Zero sequence from the negative rail, in the unit of the references.

    Args:
        o: The arithmetic.
        name: The modulator.
        v, i: References of the phases from the star point, and phase currents, of which DDT-GDPWM
            compares the magnitudes.
        v_dc: DC-link voltage in the unit of the references.
        vector, turn: As of `compared`; with ``vector`` the third harmonic takes its square from
            there too.
        seen: What `compared` would have, where it is known.
    """
    rule = MODULATORS[name]
    if rule.kind == "sine":
        return o.halved(v_dc)
    if rule.kind == "third-harmonic":
        third = third_harmonic(o, v, rule.share, vector)
        return o.total(f"{name}: zero sequence", o.halved(v_dc), o.negative(third))
    if rule.kind == "lowest":
        return o.negative(lowest(o, v)[0])
    looked_at = (seen or compared(o, name, v, i, vector, turn),) if rule.kind == "compared" else ()
    high, *of_high = highest(o, v, *looked_at)
    upper = o.total(f"{name}: zero sequence", v_dc, o.negative(high))
    if rule.kind == "highest":
        return upper
    low, *of_low = lowest(o, v, *looked_at)
    lower = o.negative(low)
    if rule.kind == "centred":
        return o.halved(o.total(f"{name}: zero sequence", upper, lower))
    return o.choose(highest_rests(o, name, of_high[0], of_low[0]), upper, lower)


def third_harmonic(
    o: Numbers[N, Any], v: Triple[N], share: float, vector: Pair[N] | None = None
) -> N:
    """The third harmonic V cos(3 alpha) times a share, from cos(3 alpha) V^3 = 4 a b
    c of balanced references.

    Args:
        o: The arithmetic.
        v: References of the phases in any unit.
        share: Share of the harmonic, 1/4 at the most.
        vector: Alpha and beta of the references, if V^2 is to be theirs; else it is 2/3 of the sum
            of the phases' squares.
    """
    if vector is None:
        squares = [o.product("third harmonic: square", phase, phase) for phase in v]
        total = o.total("third harmonic: V^2", *(o.lowered(square) for square in squares))
        length = o.lowered(o.part("third harmonic: V^2", total, 2.0 / 3.0))
    else:
        name = "third harmonic: V^2"
        length = o.total(
            name, o.product(name, vector.x, vector.x), o.product(name, vector.y, vector.y)
        )
    cube = o.product(
        "third harmonic: a b c", o.lowered(o.product("third harmonic: a b", v.a, v.b)), v.c
    )
    quarter = o.ratio("third harmonic: ratio", cube, o.let("square", length))
    if share == 0.25:
        return quarter
    return o.settled("third harmonic", o.part("third harmonic", quarter, 4.0 * share))


def highest(o: Numbers[N, Any], v: Triple[N], *views: Triple[N]) -> list[N]:
    """The highest of three phases: its value, then what each view has of that phase.

    Args:
        o: The arithmetic.
        v: References of the phases.
        views: Other values of the phases, that of the found phase is returned for each.
    """
    high = [v.a, *(view.a for view in views)]
    for name, k in (("higher", 1), ("high", 2)):
        other = [v[k], *(view[k] for view in views)]
        high = o.where_above(_names(name, other), other[0], high[0], other, high)
    return high


def lowest(o: Numbers[N, Any], v: Triple[N], *views: Triple[N]) -> list[N]:
    """As `highest`, of the lowest phase.

    Args:
        o: The arithmetic.
        v, views: As of `highest`.
    """
    if not o.halves:  # Of integers in the order of `highest`: one comparison serves both.
        low = [v.a, *(view.a for view in views)]
        for name, k in (("lower", 1), ("low", 2)):
            other = [v[k], *(view[k] for view in views)]
            low = o.where_above(_names(name, other), other[0], low[0], low, other)
        return low
    low = [v.c, *(view.c for view in views)]
    for name, k in (("lower", 1), ("low", 0)):
        other = [v[k], *(view[k] for view in views)]
        low = o.where_above(_names(name, other), low[0], other[0], other, low)
    return low


def extremes(
    o: Numbers[N, Any], v: Triple[N], *views: Triple[N]
) -> tuple[tuple[N, ...], tuple[N, ...]]:
    """What `highest` and `lowest` have.

    Args:
        o: The arithmetic.
        v, views: As of `highest`.
    """
    return tuple(highest(o, v, *views)), tuple(lowest(o, v, *views))


def _names(name: str, values: list[N]) -> list[str]:
    return [f"{'of_' * k}{name}" for k in range(len(values))]


def compared(
    o: Numbers[N, Any],
    name: ModulationName,
    v: Triple[N],
    i: Triple[N],
    vector: Pair[N] | None = None,
    turn: Pair[N] | None = None,
) -> Triple[N]:
    """What a discontinuous modulator looks at to choose between the highest and the lowest phase.

    References delayed by 30 degrees are differences of two references, but for a factor that does
    not matter. So DPWM0 and DPWM2 compare these where there is no ``turn``, exactly in integers;
    the emitted floating-point code turns the vector for them as GDPWM must, for which the load
    angle is any.

    Args:
        o: The arithmetic.
        name: A discontinuous modulator that uses both rails.
        v, i: References and currents of the phases.
        vector, turn: Alpha and beta of the references and the delay at which they are compared,
            that of the modulator or `load_turn`, as cosine and sine; GDPWM needs both, DPWM0 and
            DPWM2 take them where they are given, the others have no use for them.
    """
    rule = MODULATORS[name]
    if rule.compared == "currents":
        return i
    if rule.compared == "voltages":
        return v
    if vector is not None and turn is not None:
        seen = park(o, vector, turn)
        phases = clarke_inverse(o, (o.let("seen_alpha", seen.x), o.let("seen_beta", seen.y)))
    else:
        assert rule.delay is not None, f"{name} needs the vectors of voltage and current"
        other = Triple(v.b, v.c, v.a) if rule.delay.y < 0.0 else Triple(v.c, v.a, v.b)
        gaps = (
            o.total(f"{name}: difference", x, o.negative(y)) for x, y in zip(v, other, strict=True)
        )
        phases = Triple(*gaps)
    names = ("seen_a", "seen_b", "seen_c")
    return Triple(*(o.let(own, x) for own, x in zip(names, phases, strict=True)))


def highest_rests(o: Numbers[N, Any], name: ModulationName, of_high: N, of_low: N) -> Any:
    """Condition that of the highest and the lowest phase the highest rests.

    Args:
        o: The arithmetic.
        name: A discontinuous modulator that uses both rails.
        of_high, of_low: What `compared` has of the two phases.
    """
    of_high, of_low = o.magnitude(of_high), o.magnitude(of_low)
    if MODULATORS[name].smaller:
        return o.at_least(of_low, of_high)
    return o.at_least(of_high, of_low)


def load_turn(
    o: Floats,
    kind: Callable[[Reals, Reals], _Turn],
    voltage: tuple[Reals, Reals],
    current: tuple[Reals, Reals],
    reactive: float = 0.0,
) -> _Turn:
    """Cosine and sine of the angle by which the current lags the voltage, held within 30 degrees;
    0 without current.

    Loss depends on the magnitude of the current alone, so that generating counts as motoring
    with the current reversed.

    Args:
        o: The arithmetic.
        kind: Makes the result of both.
        voltage, current: Alpha and beta in any units, any shapes that fit together.
        reactive: Loads whose power is above this share of the apparent power, taken negative, count
            as motoring, so that rounding does not turn the angle to and fro.
    """
    along = o.let("along", voltage[0] * current[0] + voltage[1] * current[1])
    across = o.let("across", voltage[1] * current[0] - voltage[0] * current[1])
    length = o.let("length", o.root(along * along + across * across))
    generating = along < (-reactive * length if reactive else 0.0)
    lag = o.let("lag", o.choose(generating, -across, across))
    size = o.let("size", o.magnitude(along))

    def bound() -> _Turn:
        half = o.choose(lag < 0.0, o.full(-0.5, lag), o.full(0.5, lag))
        return kind(o.full(math.sqrt(0.75), lag), half)

    return o.cases(
        "turn",
        ((length > 0.0) & (o.magnitude(lag) > math.sqrt(1.0 / 3.0) * size), bound),
        (length > 0.0, lambda: kind(size / length, lag / length)),
        otherwise=lambda: kind(o.full(1.0, lag), o.full(0.0, lag)),
    )


# Which phase discontinuous modulators tie to which rail, and what that
# saves of the switching loss.
#
# At every instant the phase with the highest reference can rest at the positive rail, or the one
# with the lowest at the negative. The modulators differ in nothing but this choice: by the sign of
# the rail (DPWMMAX, DPWMMIN), by the magnitudes of the references seen from another angle (DPWM0 to
# DPWM3, GDPWM) or by those of the currents (DDT-GDPWM).
#
# References:
#     A. M. Hava, R. J. Kerkman, T. A. Lipo, "A high-performance generalized discontinuous PWM
#     algorithm", IEEE Transactions on Industry Applications 34(5), 1998, doi:10.1109/28.720446
#   (clamping angle psi, DPWM0 to DPWM3). A. M. Hava, R. J. Kerkman, T. A. Lipo, "Simple analytical
#   and graphical methods for carrier-based PWM-VSI drives", IEEE Transactions on Power Electronics
#     14(1), 1999, doi:10.1109/63.737592 (switching loss function). T. D. Nguyen et al., "A direct
#   digital technique implementation of general discontinuous pulse width modulation strategy", IEEE
#     Transactions on Industrial Electronics 58(9), 2011, doi:10.1109/TIE.2010.2102311 (DDT-GDPWM).

# Those of the package's modulators that keep one phase at a rail at every instant.
DISCONTINUOUS: frozenset[ModulationName] = frozenset(
    name for name, modulator in MODULATORS.items() if modulator.rests
)

# Eight Gauss points integrate products of three sines over at most 60 degrees to rounding.
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(8)


def compared_at(
    name: ModulationName, voltage: FloatArray, current: FloatArray
) -> tuple[Triple[Reals], Triple[Reals], Pair[Reals] | None, Pair[Reals] | None]:
    """References and currents of the phases, and for GDPWM the references' vector and
    the turn of the load angle.

    Args:
        name: The modulator.
        voltage, current: Phase references in V and phase currents in A, shape (..., 3).
    """
    v, i = (Triple(*np.moveaxis(phases, -1, 0)) for phases in (voltage, current))
    if MODULATORS[name].compared != "load angle":
        return v, i, None, None
    vector = clarke(DOUBLES, v)
    return v, i, vector, load_turn(DOUBLES, Pair[Reals], vector, clarke(DOUBLES, i), REACTIVE)


def resting_phase(
    name: ModulationName, voltage: FloatArray, current: FloatArray
) -> tuple[IndexArray, BoolArray]:
    """Index (...) of the phase that a discontinuous modulator clamps, and True (...)
    where to the positive rail.

    Of equal references the first is the highest and the last is the lowest, so that the two are
    never the same phase; where both might rest equally well it is the highest.

    Args:
        name: A modulator that rests a phase.
        voltage, current: Phase references in V and phase currents in A, shape (..., 3). GDPWM takes
            the load angle from the space vectors of both, DDT-GDPWM compares currents, the others
            look at the references alone.
    """
    v, i, vector, turn = compared_at(name, voltage, current)
    number = Triple(*np.arange(3))
    if MODULATORS[name].one_rail:
        (_, highest), (_, lowest) = extremes(DOUBLES, v, number)
        upper = np.full(v.a.shape, MODULATORS[name].kind == "highest")
    else:
        seen = compared(DOUBLES, name, v, i, vector, turn)
        (_, of_high, highest), (_, of_low, lowest) = extremes(DOUBLES, v, seen, number)
        upper = np.asarray(highest_rests(DOUBLES, name, of_high, of_low))
    return np.where(upper, highest, lowest), upper


def hand_over(name: ModulationName, load_angle: FloatArray) -> FloatArray:
    """Angle (...) in rad within the first 60 degrees after a positive peak where
    the resting phase changes.

    0 or 60 degrees where it changes between the sectors only, and for continuous modulators. With
    DDT-GDPWM it is where the magnitudes of the two currents cross, with the others at the clamping
    angle.

    Args:
        name: The modulator.
        load_angle: Angle in rad by which the current lags the voltage, shape (...).
    """
    return MODULATORS[name].hand_over(load_angle)


def sector_rule(
    name: ModulationName, lag: FloatArray, parts: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Angles (..., n) of the voltage vector in its first sector, in rad, and their weights (...,
    n) of sum 1.

    `lag` (...) in rad is the angle by which the current lags the voltage. The sector, 0 to 60
    degrees, keeps the order V_a > V_b > V_c. It is split where a phase current is zero and where
    the resting phase changes, and each part gets its own Gauss rule: 24 angles. With modulators of
    one rail the next sector follows with the same 24.

    Args:
        name: The modulator.
        lag: Angle in rad by which the current lags the voltage, shape (...).
        parts: Equal parts of the sector that get a rule of their own besides, even for waveforms
            that change at its middle.
    """
    current_zero = np.mod(lag + THIRTY, SIXTY)
    change = hand_over(name, lag)
    even = [np.full_like(lag, SIXTY * k / parts) for k in range(1, parts)]
    edges = np.sort(
        np.stack(
            [np.zeros_like(lag), current_zero, change, *even, np.full_like(lag, SIXTY)], axis=-1
        )
    )
    half = 0.5 * np.diff(edges, axis=-1)[..., None]
    middle = 0.5 * (edges[..., 1:] + edges[..., :-1])[..., None]
    shape = (*lag.shape, (2 + parts) * _GAUSS_NODES.size)
    angle, weight = (
        (middle + half * _GAUSS_NODES).reshape(shape),
        (half * _GAUSS_WEIGHTS / SIXTY).reshape(shape),
    )
    if not MODULATORS[name].one_rail:
        return angle, weight
    return np.concatenate([angle, angle + SIXTY], axis=-1), np.concatenate(
        [weight, weight], axis=-1
    ) / 2.0


def switching_loss_factor(name: ModulationName, load_angle: ArrayLike) -> FloatArray:
    """Switching loss relative to continuous modulators at the same carrier frequency (Hava 1999,
    SLF).

    ::

        SLF(phi) = 1 - 1/2 sum over the intervals where a phase rests in a half wave of
            int |cos(x - phi)| dx

    for losses proportional to the current; x from the peak of the phase's reference. The intervals
    in degrees are -60 to 0 (DPWM0), -30 to 30 (DPWM1), 0 to 60 (DPWM2), -60 to -30 and 30 to 60
    (DPWM3), psi - 60 to psi (GDPWM), and -60 to 60 in every other half wave (DPWMMIN, DPWMMAX).
    DDT-GDPWM: see docs/methods/loss-budget.md.

    Args:
        name: The modulator; 1 for continuous ones.
        load_angle: Angle phi in rad by which the current lags the voltage, any shape.

    Returns:
        Of the shape of `load_angle`.
    """
    return MODULATORS[name].loss_factor(np.asarray(load_angle, dtype=np.float64))
