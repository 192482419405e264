"""Shape, references and frames of the control of phase machines on numpy arrays of float32: as
``references.j2``, ``frame.j2`` and ``coupling.j2``, same bits.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.machines.transforms import Pair, Triple, clarke, clarke_inverse
from dqforge.optimizer.curves.single_precision import SINGLE, SingleArray

if TYPE_CHECKING:
    from dqforge.machines.names import CurrentFrame, Feedforward, ModulationName, Topology


Turn = tuple[SingleArray, SingleArray]
Gains = Mapping[str, Any]

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_FAR = np.float32(65536.0)
_LEAST_SQUARE, _LEAST = np.float32(1.0e-18), np.float32(1.0e-9)
_ROOT_2, _HALF_ROOT_2 = np.float32(1.4142135), np.float32(0.70710677)
_THIRD = np.float32(0.33333334)


def mean_of_phases(x: Triple[SingleArray]) -> SingleArray:
    """The zero sequence."""
    return _THIRD * ((x.a + x.b) + x.c)


def shape_at(
    shape: SingleArray, place: SingleArray, opened: NDArray[np.uint32] | None
) -> Stationary:
    """Back-EMF over electrical speed in Wb.

    Args:
        shape: Table, shape (1 or 3, N + 1), the last column as the first.
        place: Where to read, in lengths of the table, shape (M,).
        opened: Phase without current, 1 to 3, 0 for none; None where no phase can be open.
    """
    k, share = node_of(shape.shape[1] - 1, place)
    rows = rows_of(shape, k)
    return _seen([here + (share * (there - here)) for here, there in rows], opened)


def slope_at(
    shape: SingleArray, place: SingleArray, opened: NDArray[np.uint32] | None, turns: int
) -> Stationary:
    """Derivative of `shape_at` by the electrical angle in Wb/rad; arguments as there.

    ``turns`` are the electrical periods of the table.
    """
    k, _ = node_of(shape.shape[1] - 1, place)
    steps = steps_per_rad(shape.shape[1] - 1, turns)
    return _seen([steps * (there - here) for here, there in rows_of(shape, k)], opened)


def turns_per_rad(turns: int) -> np.float32:
    """What turns an angle in rad into lengths of a table over electrical turns."""
    return np.float32(1.0 / (2.0 * np.pi * turns))


def steps_per_rad(nodes: int, turns: int) -> np.float32:
    """Intervals of a table of ``nodes`` intervals over electrical turns per rad."""
    return np.float32(nodes / (2.0 * np.pi * turns))


def node_of(nodes: int, place: SingleArray) -> tuple[NDArray[np.int64], SingleArray]:
    """Interval of a table of ``nodes`` intervals at places in lengths of it, shape (N,), and the
    share of it that is passed.
    """
    known = (place < _FAR) & (place > -_FAR)
    x = np.where(known, place, _ZERO)
    x = x - x.astype(np.int64).astype(np.float32)
    x = np.where(x < _ZERO, x + _ONE, x) * np.float32(nodes)
    k = np.minimum(x.astype(np.int64), nodes - 1)
    return k, x - k.astype(np.float32)


def rows_of(table: SingleArray, k: NDArray[np.int64]) -> list[tuple[SingleArray, SingleArray]]:
    """Both ends of an interval for the phases a, b, c.

    Args:
        table: Shape (1 or 3, nodes + 1), or (1 or 3, N, nodes + 1) with a table for each place.
        k: Intervals, shape (N,).
    """
    nodes, equal = table.shape[-1] - 1, table.shape[0] == 1
    found = []
    for phase in range(3):
        row = table[0 if equal else phase]
        here = (k + (nodes - nodes * phase // 3)) % nodes if equal else k
        ends = (
            (row[here], row[here + 1])
            if row.ndim == 1
            else (row[np.arange(k.size), here], row[np.arange(k.size), here + 1])
        )
        found.append(ends)
    return found


def _seen(values: list[SingleArray], opened: NDArray[np.uint32] | None) -> Stationary:
    """Stationary coordinates of phase values, of which that of an open phase counts as none."""
    f = Triple(
        *(
            value if opened is None else np.where(opened == phase, _ZERO, value)
            for phase, value in enumerate(values, start=1)
        )
    )
    plane = clarke(SINGLE, f)
    return Stationary(plane.x, plane.y, mean_of_phases(f))


def reference_at(
    gains: Gains,
    f: Stationary,
    turn: Turn,
    torque: SingleArray,
    d: SingleArray,
    fade: SingleArray,
    zero: SingleArray,
) -> Stationary:
    """Currents in A that make a torque.

    Args:
        gains: With ``pole_pairs`` and ``psi_pm``.
        f: Shape in Wb.
        turn: Cosine and sine of the angle.
        torque: In N m.
        d: Constant current of the d axis in A.
        fade, zero: Shares of the shape beside its fundamental, and of its zero sequence.
    """
    fading, rest = fade < _ONE, (_ONE - fade) * gains["psi_pm"]
    alpha = np.where(fading, (fade * f.alpha) - (rest * turn[1]), f.alpha)
    beta = np.where(fading, (fade * f.beta) + (rest * turn[0]), f.beta)
    common = np.where(fading, fade * f.zero, f.zero)
    square = gains["pole_pairs"] * (
        (np.float32(1.5) * ((alpha * alpha) + (beta * beta)))
        + ((np.float32(3.0) * zero) * (common * common))
    )
    there = square > _LEAST_SQUARE
    scale = np.where(there, torque / np.where(there, square, _ONE), _ZERO)
    return Stationary(
        (scale * alpha) + (d * turn[0]), (scale * beta) + (d * turn[1]), scale * (zero * common)
    )


def balanced(
    i: Stationary, f: Stationary, balance: SingleArray, opened: NDArray[np.uint32]
) -> Stationary:
    """Currents less a zero sequence that balances the midpoint, at the same torque.

    Args:
        i: Currents in A.
        f: Shape in Wb.
        balance: What the zero sequence is lowered by, in A.
        opened: Phase without current, 1 to 3, 0 for none; two phases take the balance where one is
            open.
    """
    plane, triple = np.float32(1.5), np.float32(3.0)
    square = (plane * ((f.alpha * f.alpha) + (f.beta * f.beta))) + (triple * (f.zero * f.zero))
    x = np.where(opened == 1, _ONE, np.float32(-0.5))
    y = np.where(opened == 2, np.float32(0.8660254), np.float32(-0.8660254))
    y = np.where(opened == 1, _ZERO, y)
    alpha, beta = (np.where(opened > 0, balance * part, _ZERO) for part in (x, y))
    scale = (plane * ((f.alpha * alpha) + (f.beta * beta))) - (triple * (f.zero * balance))
    there = square > _LEAST_SQUARE
    scale = np.where(there, scale / np.where(there, square, _ONE), _ZERO)
    found = (
        i.alpha + (alpha - (scale * f.alpha)),
        i.beta + (beta - (scale * f.beta)),
        i.zero - (balance + (scale * f.zero)),
    )
    return Stationary(*(np.asarray(part, dtype=np.float32) for part in found))


def largest_torque(
    nodes: tuple[SingleArray, SingleArray], torque: SingleArray, omega_e: SingleArray,
    v_dc: SingleArray,
) -> SingleArray:  # fmt: skip
    """Largest torque in N m between the nodes of a table.

    Args:
        nodes: Electrical speeds in rad/s and DC-link voltages in V, at least two each.
        torque: In N m, shape (speeds, voltages).
        omega_e, v_dc: Where, shape (N,).
    """
    places = []
    for axis, value in zip(nodes, (omega_e, v_dc), strict=True):
        k = np.zeros(value.shape, dtype=np.int64)
        for inner in axis[1:-1]:
            k = k + (value > inner)
        share = (value - axis[k]) / (axis[k + 1] - axis[k])
        places.append((k, np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))))
    (j, x), (k, y) = places
    low = torque[j, k] + (y * (torque[j, k + 1] - torque[j, k]))
    high = torque[j + 1, k] + (y * (torque[j + 1, k + 1] - torque[j + 1, k]))
    return np.asarray(low + (x * (high - low)), dtype=np.float32)


def equal_load(
    omega_e: SingleArray, v_dc: SingleArray, v_nominal: np.float32, last: np.float32
) -> SingleArray:
    """Electrical speeds in rad/s that load the nominal link as much as these do the link there is,
    shape (N,).

    Args:
        omega_e, v_dc: Speeds in rad/s, positive, and voltages in V.
        v_nominal: Nominal link voltage in V.
        last: The speed in rad/s where there is no link.
    """
    there = v_dc > _ZERO
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = omega_e * (v_nominal / np.where(there, v_dc, _ONE))
    return np.asarray(np.where(there, scaled, last), dtype=np.float32)


def to_frame(frame: str, f: Stationary, x: Stationary, psi_pm: Any) -> Stationary:
    """Coordinates d, q and 0 of dqx or dqy, over its amplitude factor.

    Args:
        frame: ``dqx`` or ``dqy``.
        f: Shape in Wb.
        x: What is seen, in any unit.
        psi_pm: Flux of the fundamental in Wb.
    """
    scale = _ONE / psi_pm
    along = (f.alpha * x.alpha) + (f.beta * x.beta)
    across = (f.beta * x.alpha) - (f.alpha * x.beta)
    if frame == "dqx":
        return Stationary(scale * across, scale * along, x.zero)
    square, side, inverse = _side(f)
    length = np.sqrt(square + (np.float32(2.0) * (f.zero * f.zero)))
    return Stationary(
        scale * ((length * inverse) * across),
        scale * (along + (np.float32(2.0) * (f.zero * x.zero))),
        scale * (_ROOT_2 * (((f.zero * inverse) * along) - (side * x.zero))),
    )


def _side(f: Stationary) -> tuple[SingleArray, SingleArray, SingleArray]:
    """Square, length and its inverse of the shape in the plane."""
    square = (f.alpha * f.alpha) + (f.beta * f.beta)
    side = np.sqrt(square)
    there = side > _LEAST
    return square, side, np.where(there, _ONE / np.where(there, side, _ONE), _ZERO)


def from_frame(frame: str, f: Stationary, x: Stationary, psi_pm: Any) -> Stationary:
    """Stationary coordinates of what `to_frame` makes; arguments as there."""
    square, side, inverse = _side(f)
    whole = square if frame == "dqx" else square + (np.float32(2.0) * (f.zero * f.zero))
    there = whole > _LEAST_SQUARE
    scale = np.where(there, psi_pm / np.where(there, whole, _ONE), _ZERO)
    if frame == "dqx":
        return Stationary(
            scale * ((x.beta * f.alpha) + (x.alpha * f.beta)),
            scale * ((x.beta * f.beta) - (x.alpha * f.alpha)),
            x.zero,
        )
    across = (np.sqrt(whole) * inverse) * x.alpha
    along = x.beta + ((_ROOT_2 * (f.zero * inverse)) * x.zero)
    return Stationary(
        scale * ((along * f.alpha) + (across * f.beta)),
        scale * ((along * f.beta) - (across * f.alpha)),
        scale * ((x.beta * f.zero) - (_HALF_ROOT_2 * (side * x.zero))),
    )


def coupling(
    frame: str, gains: Gains, f: Stationary, slope: Stationary, x: Stationary, omega_e: SingleArray
) -> Stationary:
    """Voltage in V of currents that are constant in dqx or dqy, as these turn and change.

    Args:
        frame: ``dqx`` or ``dqy``.
        gains: With ``psi_pm``, ``l_q`` and ``l_0``.
        f, slope: Shape in Wb and its derivative by the angle.
        x: Currents d, q and 0 over the amplitude factor, in A.
        omega_e: Electrical speed in rad/s.
    """
    two, half = np.float32(2.0), np.float32(0.5)
    square, side, inverse = _side(f)
    along = (f.alpha * slope.alpha) + (f.beta * slope.beta)
    planar = frame == "dqx"
    whole = square if planar else square + (two * (f.zero * f.zero))
    there = whole > _LEAST_SQUARE
    per_whole = np.where(there, _ONE / np.where(there, whole, _ONE), _ZERO)
    scale = (omega_e * gains["psi_pm"]) * per_whole
    if planar:
        growth = (two * along) * per_whole
        q, d = x.beta, x.alpha
        q_rate, d_rate = -q * growth, -d * growth
        zero = np.zeros_like(q)
    else:
        growth = (two * (along + (two * (f.zero * slope.zero)))) * per_whole
        side_growth = (along * inverse) * inverse
        common = _ROOT_2 * (inverse * x.zero)
        q = x.beta + (common * f.zero)
        q_rate = (common * (slope.zero - (f.zero * side_growth))) - (q * growth)
        d = (np.sqrt(whole) * inverse) * x.alpha
        d_rate = -d * ((half * growth) + side_growth)
        apart = _HALF_ROOT_2 * (side * x.zero)
        zero = (gains["l_0"] * scale) * (
            ((x.beta * slope.zero) - (apart * side_growth)) - (((x.beta * f.zero) - apart) * growth)
        )
    plane = gains["l_q"] * scale
    return Stationary(
        plane * (((q * slope.alpha) + (q_rate * f.alpha)) + ((d * slope.beta) + (d_rate * f.beta))),
        plane * (((q * slope.beta) + (q_rate * f.beta)) - ((d * slope.alpha) + (d_rate * f.alpha))),
        zero,
    )


# Voltage region and duty cycles of the topologies with a neutral of their own or with six legs,
# on numpy arrays of float32: as ``duties.j2``, same operations, same bits.

_HALF = np.float32(0.5)


class Stationary(NamedTuple):
    """Alpha, beta and the zero sequence (mean of the phases), arrays of shape (N,)."""

    alpha: SingleArray
    beta: SingleArray
    zero: SingleArray


def phases(x: Stationary) -> Triple[SingleArray]:
    """Phase quantities of stationary coordinates."""
    y = clarke_inverse(SINGLE, Pair(x.alpha, x.beta))
    return Triple(y.a + x.zero, y.b + x.zero, y.c + x.zero)


def _larger(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.where(a > b, a, b)


def _smaller(a: SingleArray, b: SingleArray) -> SingleArray:
    return np.where(a < b, a, b)


def _extremes(v: Triple[SingleArray], topology: Topology) -> tuple[SingleArray, SingleArray]:
    high, low = _larger(v.c, _larger(v.b, v.a)), _smaller(v.c, _smaller(v.b, v.a))
    if topology == "four-leg":
        high = np.where(high > _ZERO, high, _ZERO)
        low = np.where(low < _ZERO, low, _ZERO)
    return high, low


def _three_leg_need(voltage: Stationary, modulation: ModulationName) -> SingleArray:
    plane = Pair(voltage.alpha, voltage.beta)
    v = clarke_inverse(SINGLE, plane)
    high, low = _extremes(v, "three-wire")
    rule = MODULATORS[modulation]
    if rule.kind not in ("sine", "third-harmonic"):
        return high - low
    zero = np.zeros_like(v.a)
    if rule.kind == "third-harmonic":
        square = (plane.x * plane.x) + (plane.y * plane.y)
        there = square > _ZERO
        third = np.float32(4.0 * rule.share) * (((v.a * v.b) * v.c) / np.where(there, square, _ONE))
        zero = np.where(there, third, zero)
    high, low = high - zero, zero - low
    return np.float32(2.0) * _larger(high, low)


def _need(voltage: Stationary, topology: Topology, modulation: ModulationName) -> SingleArray:
    """DC-link voltage in V that phase voltages need."""
    if topology in ("three-wire", "diode-neutral"):
        return _three_leg_need(voltage, modulation)
    high, low = _extremes(phases(voltage), topology)
    if topology == "six-leg":
        return _larger(high, -low)
    return _HALF * (high - low) if topology == "six-leg-isolated" else high - low


def voltage_share(
    voltage: Stationary,
    part: SingleArray,
    v_dc: SingleArray,
    v_m: SingleArray | None,
    topology: Topology,
    modulation: ModulationName,
) -> SingleArray:
    """Share of a voltage that the DC link can make, up to 1; -1 where its samples make no sense.

    Args:
        voltage: In V.
        part: Share of the link that may be used.
        v_dc, v_m: DC-link voltage and midpoint above the negative rail in V, shape (N,).
        topology, modulation: How the phases are fed.
    """
    if v_m is None:
        most, need = part * v_dc, _need(voltage, topology, modulation)
        over = need > most
        share = np.where(over, most / np.where(over, need, _ONE), _ONE)
        return np.where(most >= _ZERO, share, -_ONE)
    above, below = part * (v_dc - v_m), part * v_m
    high, low = _extremes(phases(voltage), topology)
    over = high > above
    share = np.where(over, above / np.where(over, high, _ONE), _ONE)
    under = (-low * share) > below
    share = np.where(under, below / np.where(under, -low, _ONE), share)
    return np.where((above >= _ZERO) & (below >= _ZERO), share, -_ONE)


def _duty(x: SingleArray) -> SingleArray:
    within = np.where(x >= _ZERO, x, np.where(x < _ZERO, _ZERO, _HALF))
    return np.where(x > _ONE, _ONE, within)


def topology_duties(
    voltage: Stationary, v_dc: SingleArray, v_m: SingleArray | None, topology: Topology
) -> tuple[SingleArray, ...]:
    """Duty cycles of all legs in the order of their topology.

    Args:
        voltage: In V.
        v_dc, v_m: DC-link voltage and midpoint above the negative rail in V, shape (N,).
        topology: One with a neutral of its own, or with six legs.
    """
    v = phases(voltage)
    powered = v_dc > _ZERO
    scale = np.where(powered, _ONE / np.where(powered, v_dc, _ONE), _ZERO)
    if v_m is not None:
        return tuple(np.where(powered, _duty((phase + v_m) * scale), _HALF) for phase in v)
    half = _HALF * scale
    if topology == "six-leg":
        return (
            *(_duty(_HALF + (phase * half)) for phase in v),
            *(_duty(_HALF - (phase * half)) for phase in v),
        )
    high, low = _extremes(v, topology)
    offset = -_HALF * (high + low)
    if topology == "six-leg-isolated":
        return (
            *(_duty(_HALF + ((phase + offset) * half)) for phase in v),
            *(_duty(_HALF - ((phase + offset) * half)) for phase in v),
        )
    return (
        *(_duty(_HALF + ((phase + offset) * scale)) for phase in v),
        _duty(_HALF + (offset * scale)),
    )


# What the emitted control of a phase machine is made of: the words that choose its code.


@dataclass(frozen=True, slots=True)
class Structure:
    """What stands in the code, beside the numbers that can be changed at run time.

    Args:
        frame, feedforward, topology, modulation: As their words say; only topologies with three
            legs and no neutral use the modulator.
        turns: Electrical periods in the table of the back-EMF.
        ratio: Current samples per speed sample.
        plane, zero: Orders of the harmonic integrators in alpha and beta, signed, and of the zero
            sequence.
        torque_limit: Whether the torque is limited by a table.
        salient: Whether the inductances of d and q differ.
        by_waveform: Whether the references are those of the header of phase currents, over torque
            and angle.
        start_up: Whether a start without encoder adds currents to the references of a torque.
    """

    frame: CurrentFrame
    feedforward: Feedforward
    topology: Topology
    modulation: ModulationName
    turns: int
    ratio: int
    plane: tuple[int, ...] = ()
    zero: tuple[int, ...] = ()
    torque_limit: bool = False
    salient: bool = False
    by_waveform: bool = False
    start_up: bool = False

    @property
    def neutral(self) -> bool:
        """Whether the legs drive a zero sequence."""
        return TOPOLOGIES[self.topology].neutral

    @property
    def midpoint(self) -> bool:
        """Whether the neutral lies on the midpoint of the link."""
        return TOPOLOGIES[self.topology].midpoint

    @property
    def legs(self) -> tuple[str, ...]:
        """Names of the duty cycles."""
        return TOPOLOGIES[self.topology].legs

    @property
    def modulated(self) -> bool:
        """Whether duty cycles come from one of the modulators of three legs."""
        return self.topology in ("three-wire", "diode-neutral")

    @property
    def by_torque(self) -> bool:
        """Whether the references follow the back-EMF."""
        return self.frame != "dq"

    @property
    def proportional(self) -> bool:
        """Whether the references are the back-EMF times what makes the torque."""
        return self.by_torque and not self.by_waveform

    @property
    def follows(self) -> bool:
        """Whether the integrators live in a frame that follows the back-EMF."""
        return self.frame in ("dqx", "dqy")

    @property
    def slopes(self) -> bool:
        """Whether the slope of the back-EMF is read."""
        return self.follows and self.feedforward == "measured"

    @property
    def multiples(self) -> tuple[int, ...]:
        """Multiples of the angle that the harmonic integrators need, ascending."""
        return tuple(sorted({abs(order) for order in (*self.plane, *self.zero)}))

    @property
    def has_balance_share(self) -> bool:
        """Whether the share of the zero sequence in the references changes in the running drive."""
        return self.by_torque and (self.midpoint or (self.neutral and self.frame == "dqx"))
