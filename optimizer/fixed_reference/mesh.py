"""Current references in integers on a mesh of exact operating points, as the emitted C has them.

The mesh lies in the plane of the currents. Its rows are torques, its columns lead from the least
current for a torque (column 0) to the least flux linkage for it (the last one). Between four nodes
the currents are bilinear. The squared phase voltage of the currents i at the electrical speed w is

    |v|^2 = w^2 |psi(i)|^2 + R^2 |i|^2 + 2 R w T/(3/2 p)

so that two numbers per node tell it for every speed. It is a convex function of the currents where
inductances are constant, and taken as linear between the nodes: what is taken lies above what is.
No root is drawn, and speed is nowhere divided by.

All functions take their operations from an `Arithmetic`: numbers make them the model, ranges
their proof. Clamps that change no number are for the ranges, and the C leaves them out.
"""

from __future__ import annotations

from typing import Any, Generic

from dqforge.machines.names import NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, magnitude
from dqforge.optimizer.loops.integer_gains import FixedGain


@dataclass(frozen=True, slots=True)
class VoltageScale:
    """How the voltage limit is told in integers.

    Args:
        limit: Largest phase amplitude over the dc link, between their codes.
        dc_least: Code below which the dc link is taken as this.
        shift: Bits by which squared voltages are shifted right, so that every sum holds.
        heat: Bits by which the entries ``heat`` of the mesh are shifted left to become squared
            voltages.
        drop: From the product of torque and speed, a code, to the squared voltage that it takes.
    """

    limit: FixedGain
    dc_least: int
    shift: int
    heat: int
    drop: FixedGain


@dataclass(frozen=True, slots=True)
class CurrentMesh:
    """Everything that ``<prefix>_reference_q15.h`` holds.

    Args:
        width: Bits of a code, 16 or 32.
        bases: Full scales of current in A, voltage in V, mechanical speed in rad/s, torque in N m.
        torque: Codes of the torque of each row, rising from 0; one more than a power of two.
        d, q: Codes of the currents of the nodes, row by row.
        flux, heat: Squared flux linkages and squared currents of the nodes as squared voltages (see
            `VoltageScale`), row by row; empty where the voltage limits nothing.
        voltage: Scales of the voltage limit, None where the voltage limits nothing: one column.
    """

    width: int
    bases: tuple[float, float, float, float]
    torque: tuple[int, ...]
    d: tuple[int, ...]
    q: tuple[int, ...]
    flux: tuple[int, ...] = ()
    heat: tuple[int, ...] = ()
    voltage: VoltageScale | None = None

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return "q15" if self.width == 16 else "q31"

    @property
    def top(self) -> int:
        """The largest code."""
        return int(2 ** (self.width - 1) - 1)

    @property
    def rows(self) -> int:
        """Cells along the torque, a power of two."""
        return len(self.torque) - 1

    @property
    def columns(self) -> int:
        """Nodes of a row: one more than a power of two, or one."""
        return len(self.d) // len(self.torque)

    @property
    def end(self) -> int:
        """Code at which the magnitude of the torque is clamped."""
        return self.torque[-1]

    @property
    def end_torque(self) -> float:
        """Torque in N m at which the magnitude is clamped."""
        return float(self.end * self.bases[3] / 2 ** (self.width - 1))

    @property
    def fraction(self) -> int:
        """Bits of a position within a cell."""
        return self.width - 2

    @property
    def table_bytes(self) -> int:
        """Bytes of the tables."""
        entries = len(self.torque) + 2 * len(self.d) + 2 * len(self.flux)
        return entries * self.width // 8

    def currents(self, o: Arithmetic[N, Any], torque: N, v_dc: N, omega: N) -> Pair[N]:
        """Codes of (i_d, i_q) for codes of torque, dc link and mechanical speed."""
        size = o.clamp(magnitude(o, o.clamp(torque, -self.end, self.end)), 0, self.end)
        positive = o.at_least(torque, o.const(0))
        place = _row_of(o, self, size)
        if self.voltage is None:
            found = _on_column(o, self, place, o.const(0))
        else:
            # At this speed a torque of the other sign motors: the mirror image.
            along = o.clamp(omega, -self.top, self.top)
            along = o.choose(positive, along, o.negative(along))
            found = _weakened(o, self, self.voltage, size, place, v_dc, along)
        i_d, i_q = (o.clamp(part, -self.top, self.top) for part in (found.x, found.y))
        return Pair(i_d, o.choose(positive, i_q, o.negative(i_q)))


@dataclass(frozen=True, slots=True)
class _Place(Generic[N]):
    """A torque between two rows: the lower one, and its share of the way to the upper one."""

    row: N
    share: N


def _halves(cells: int) -> list[int]:
    """Steps of a search among so many cells, a power of two."""
    return [1 << bit for bit in range(cells.bit_length() - 2, -1, -1)]


def _row_of(o: Arithmetic[N, Any], mesh: CurrentMesh, size: N) -> _Place[N]:
    row = o.const(0)
    for step in _halves(mesh.rows):
        trial = o.total("row", row, o.const(step))
        row = o.choose(o.at_least(size, o.entry(mesh.torque, trial)), trial, row)
    return _Place(row, _share_of_row(o, mesh, row, size))


def _share_of_row(o: Arithmetic[N, Any], mesh: CurrentMesh, row: N, size: N) -> N:
    one = 1 << mesh.fraction
    start = o.entry(mesh.torque, row)
    beyond = o.entry(mesh.torque, o.total("row", row, o.const(1)))
    done = o.clamp(o.total("torque in its row", size, o.negative(start)), 0, mesh.end)
    whole = o.clamp(o.total("torque of a row", beyond, o.negative(start)), 1, mesh.end)
    scaled = o.product("torque in its row", done, o.const(one))
    return o.clamp(o.quotient("share of a row", scaled, whole), 0, one)


def _between(
    o: Arithmetic[N, Any], name: str, a: N, b: N, share: N, bits: int, *, upwards: bool = False
) -> N:
    """From a to b by a share of ``bits`` bits, to the nearest or to the next larger integer."""
    one = 1 << bits
    way = o.product(name, o.total(name, b, o.negative(a)), share)
    part = o.shifted(o.total(name, way, o.const(one - 1 if upwards else one >> 1)), bits)
    return o.total(name, a, part)


def _node(o: Arithmetic[N, Any], mesh: CurrentMesh, row: N, column: N) -> N:
    first = o.product("node", row, o.const(mesh.columns))
    return o.total("node", first, column)


def _along(
    o: Arithmetic[N, Any],
    mesh: CurrentMesh,
    table: tuple[int, ...],
    place: _Place[N],
    column: N,
    *,
    upwards: bool = False,
) -> N:
    """Entry of a table on a column, between the rows of a place."""
    node = _node(o, mesh, place.row, column)
    beyond = o.total("node", node, o.const(mesh.columns))
    ends = o.entry(table, node), o.entry(table, beyond)
    found = _between(o, "between rows", *ends, place.share, mesh.fraction, upwards=upwards)
    return o.clamp(found, min(table), max(table))


def _on_column(o: Arithmetic[N, Any], mesh: CurrentMesh, place: _Place[N], column: N) -> Pair[N]:
    return Pair(*(_along(o, mesh, table, place, column) for table in (mesh.d, mesh.q)))


@dataclass(frozen=True, slots=True)
class _Voltage(Generic[N]):
    """What there is of the squared voltage, the squared speed, and the speed along the torque."""

    room: N
    square: N
    along: N


def _voltage(
    o: Arithmetic[N, Any], mesh: CurrentMesh, scale: VoltageScale, v_dc: N, along: N
) -> _Voltage[N]:
    top = mesh.top
    link = o.clamp(v_dc, scale.dc_least, top)
    product = o.product("voltage limit", o.const(scale.limit.mantissa), link)
    limit = o.clamp(o.shifted(product, scale.limit.shift), 0, top)
    room = o.shifted(o.product("squared limit", limit, limit), scale.shift)
    # A square is not negative, which a range does not know.
    square = o.clamp(o.product("squared speed", along, along), 0, top * top)
    above = o.shifted(o.total("squared speed", square, o.const(top)), mesh.width - 1)
    return _Voltage(room, above, along)


def _drop(o: Arithmetic[N, Any], mesh: CurrentMesh, scale: VoltageScale, size: N, along: N) -> N:
    """What torque and speed take of the squared voltage; negative where the machine brakes."""
    power = o.shifted(o.product("torque times speed", size, along), mesh.width - 1)
    above = o.total("torque times speed", power, o.const(1))
    product = o.product("drop", o.const(scale.drop.mantissa), above)
    up = o.const((1 << scale.drop.shift) - 1)
    return o.shifted(o.total("drop", product, up), scale.drop.shift)


def _taken(o: Arithmetic[N, Any], scale: VoltageScale, u: _Voltage[N], flux: N, heat: N) -> N:
    """Squared voltage of a squared flux linkage and a squared current, without the drop."""
    induced = o.product("induced", u.square, flux)
    return o.total("voltage", induced, o.product("heat", heat, o.const(1 << scale.heat)))


def _weakened(
    o: Arithmetic[N, Any],
    mesh: CurrentMesh,
    scale: VoltageScale,
    size: N,
    place: _Place[N],
    v_dc: N,
    along: N,
) -> Pair[N]:
    u = _voltage(o, mesh, scale, v_dc, along)
    place, size = _granted(o, mesh, scale, u, size, place)
    drop = _drop(o, mesh, scale, size, along)

    def voltage(column: N) -> N:
        return _on_row(o, mesh, scale, u, place, column, drop)

    column = o.const(0)
    for step in _halves(mesh.columns - 1):
        trial = o.total("column", column, o.const(step))
        column = o.choose(o.at_least(u.room, voltage(trial)), column, trial)
    free = o.at_least(u.room, voltage(o.const(0)))
    column = o.choose(free, o.const(0), column)
    beyond = o.total("column", column, o.const(1))
    share = _crossing(o, mesh, voltage(column), voltage(beyond), u.room)
    share = o.choose(free, o.const(0), share)
    ends = _on_column(o, mesh, place, column), _on_column(o, mesh, place, beyond)
    pairs = zip((ends[0].x, ends[0].y), (ends[1].x, ends[1].y), strict=True)
    return Pair(*(_between(o, "between columns", *pair, share, mesh.fraction) for pair in pairs))


def _on_row(
    o: Arithmetic[N, Any],
    mesh: CurrentMesh,
    scale: VoltageScale,
    u: _Voltage[N],
    place: _Place[N],
    column: N,
    drop: N,
) -> N:
    """Squared voltage on a column, between the rows of a place."""
    flux, heat = (
        _along(o, mesh, table, place, column, upwards=True) for table in (mesh.flux, mesh.heat)
    )
    return o.total("voltage", _taken(o, scale, u, flux, heat), drop)


def _crossing(o: Arithmetic[N, Any], mesh: CurrentMesh, much: N, little: N, room: N) -> N:
    """Share of the way from ``much`` down to ``little`` at which it is ``room``; at least that."""
    one = 1 << mesh.fraction
    excess = o.total("excess", much, o.negative(room))
    span = o.shifted(o.total("span", much, o.negative(little)), mesh.fraction)
    return o.clamp(o.quotient("share of a column", excess, o.clamp(span, 1, 8 * one)), 0, one)


def _torque_at(o: Arithmetic[N, Any], mesh: CurrentMesh, place: _Place[N]) -> N:
    start = o.entry(mesh.torque, place.row)
    beyond = o.entry(mesh.torque, o.total("row", place.row, o.const(1)))
    found = _between(o, "torque", start, beyond, place.share, mesh.fraction, upwards=True)
    return o.clamp(found, 0, mesh.end)


def _granted(
    o: Arithmetic[N, Any],
    mesh: CurrentMesh,
    scale: VoltageScale,
    u: _Voltage[N],
    size: N,
    place: _Place[N],
) -> tuple[_Place[N], N]:
    """The torque itself where some currents of its row keep the voltage, else the largest that
    can be had: where the voltage of the last column crosses its limit.
    """
    drop, last = _drop(o, mesh, scale, size, u.along), o.const(mesh.columns - 1)

    def at_row(row: N) -> N:
        node = _node(o, mesh, row, last)
        flux, heat = o.entry(mesh.flux, node), o.entry(mesh.heat, node)
        taken = _drop(o, mesh, scale, o.entry(mesh.torque, row), u.along)
        return o.total("voltage", _taken(o, scale, u, flux, heat), taken)

    row = o.const(0)
    for step in _halves(mesh.rows):
        trial = o.total("row", row, o.const(step))
        kept = o.choose(o.at_least(u.room, at_row(trial)), trial, row)
        row = o.choose(o.at_least(place.row, trial), kept, row)
    low, high = at_row(row), at_row(o.total("row", row, o.const(1)))
    less = _Place(row, _rising(o, mesh, low, high, u.room))

    def either(mine: N, other: N) -> N:
        needed = (_on_row(o, mesh, scale, u, place, end, drop) for end in (last, o.const(0)))
        found = other
        for voltage in needed:
            found = o.choose(o.at_least(u.room, voltage), mine, found)
        return found

    granted = _Place(either(place.row, less.row), either(place.share, less.share))
    return granted, either(size, _torque_at(o, mesh, less))


def _rising(o: Arithmetic[N, Any], mesh: CurrentMesh, low: N, high: N, room: N) -> N:
    """Share of the way from ``low`` up to ``high`` at which it is ``room``; at most that."""
    one = 1 << mesh.fraction
    left = o.clamp(o.total("left", room, o.negative(low)), 0, 8 * one * one - 1)
    span = o.shifted(o.total("span", high, o.negative(low)), mesh.fraction)
    above = o.clamp(o.total("span", span, o.const(1)), 1, 8 * one)
    return o.clamp(o.quotient("share of a row", left, above), 0, one)
