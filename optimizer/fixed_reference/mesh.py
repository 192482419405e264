"""Current references in integers on a mesh of exact operating points, as the emitted C has them.

The mesh lies in the plane of the currents. Its rows are torques, its columns lead from the least
current for a torque (column 0) to the least flux linkage for it (the last one). Between four nodes
the currents are bilinear. The squared phase voltage of the currents i at the electrical speed w is

    |v|^2 = w^2 |psi(i)|^2 + R^2 |i|^2 + 2 R w T/(3/2 p)

so that two numbers per node tell it for every speed. It is a convex function of the currents where
inductances are constant, and taken as linear between the nodes: what is taken lies above what is.
No root is drawn, and speed is nowhere divided by.

All functions take their operations from an `Arithmetic`: numbers make them the model, ranges
their proof, expressions their text in C. What is ``known`` is for the ranges: the C leaves it out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic

from dqforge.machines.names import NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.steps.code_vectors import Coded, Counted, Dq
from dqforge.optimizer.steps.integer_arithmetic import Arithmetic


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
class _Voltage(Generic[N]):
    """What there is of the squared voltage, the squared speed, and the speed along the torque."""

    room: N
    square: N
    along: N


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

    def currents(
        self, o: Arithmetic[N, Any], torque: Coded[N], v_dc: Coded[N], omega_m: Coded[N]
    ) -> Dq[N]:
        """Codes of (i_d, i_q) for codes of torque, dc link and mechanical speed."""
        asked, end = o.let("asked", o.widened(torque)), o.const(self.end)
        backwards = o.above(o.const(0), asked)
        size = o.choose(o.above(asked, end), end, asked)
        size = o.choose(backwards, o.negative(asked), size)
        size = o.choose(o.above(o.const(-self.end), asked), end, size)
        size = o.let("size", o.known(size, 0, self.end))
        if self.voltage is None:
            row, share = self._row_of(o, size)
            share = o.let("share", share)
            tables = self.d, self.q
            low = [o.entry(table, row) for table in tables]
            high = [o.entry(table, o.total("node", row, o.const(1))) for table in tables]
            i_d, i_q = self._along(o, tables, low, high, share)
            i_d, i_q = o.let("i_d", i_d), o.let("i_q", i_q)
        else:
            # At this speed a torque of the other sign motors: the mirror image.
            turning = o.let("turning", o.clamp(omega_m, -self.top, None))
            along = o.choose(backwards, o.negative(turning), turning)
            voltage = self._voltage(o, v_dc, o.let("along", along))
            i_d, i_q = self._weakened(o, voltage, size, *self._row_of(o, size))
        i_d, i_q = (o.known(part, -self.top, self.top) for part in (i_d, i_q))
        return Dq(i_d, o.choose(backwards, o.negative(i_q), i_q))

    def reference_between(self, o: Arithmetic[N, Any], name: str, a: N, b: N, share: N) -> N:
        """From a to b by a share, to the nearest integer."""
        return self._part_of_way(o, name, a, b, share, 1 << (self.fraction - 1))

    def reference_above(self, o: Arithmetic[N, Any], name: str, a: N, b: N, share: N) -> N:
        """The same, to the next larger integer."""
        return self._part_of_way(o, name, a, b, share, (1 << self.fraction) - 1)

    def reference_drop(self, o: Arithmetic[N, Any], torque: N, along: N) -> N:
        """Squared voltage that torque and speed take through the resistance; negative while
        braking.
        """
        gain = self._scale.drop
        power = o.shifted(o.product("torque times speed", torque, along), self.width - 1)
        power = o.let("power", o.total("torque times speed", power, o.const(1)))
        product = o.product("drop", o.const(gain.mantissa), power)
        up = o.const((1 << gain.shift) - 1)
        return o.shifted(o.total("drop", product, up), gain.shift)

    def reference_voltage(self, o: Arithmetic[N, Any], node: Counted[N], share: N, square: N) -> N:
        """Squared voltage of a column between two rows, without that; square is the squared
        speed.
        """
        tables = self.flux, self.heat
        a, b = o.entries(("a", "b"), tables, node, (0, self.columns))
        flux, heat = self._along(o, tables, a, b, share, upwards=True)
        return self._taken(o, square, o.let("flux", flux), o.let("heat", heat))

    def reference_end(self, o: Arithmetic[N, Any], row: Counted[N], square: N, along: N) -> N:
        """The same on a node of the last column, with that."""
        first = o.multiple("node", row, self.columns)
        node = o.total("node", first, o.const(self.columns - 1))
        (own,) = o.entries(("a",), (self.flux, self.heat), node, (0,))
        taken = self._taken(o, square, *own)
        drop = o.call(self.reference_drop, o.entry(self.torque, row), along)
        return o.total("voltage", taken, drop)

    @property
    def _scale(self) -> VoltageScale:
        assert self.voltage is not None
        return self.voltage

    def _part_of_way(
        self, o: Arithmetic[N, Any], name: str, a: N, b: N, share: N, addend: int
    ) -> N:
        way = o.product(name, o.total(name, b, o.negative(a)), share)
        part = o.shifted(o.total(name, way, o.const(addend)), self.fraction)
        return o.total(name, a, part)

    def _taken(self, o: Arithmetic[N, Any], square: N, flux: N, heat: N) -> N:
        """Squared voltage of a squared flux linkage and a squared current."""
        induced = o.product("induced", square, flux)
        return o.total("voltage", induced, o.product("heat", heat, o.const(1 << self._scale.heat)))

    def _along(
        self,
        o: Arithmetic[N, Any],
        tables: Sequence[tuple[int, ...]],
        low: Sequence[N],
        high: Sequence[N],
        share: N,
        *,
        upwards: bool = False,
    ) -> tuple[N, N]:
        """Between entries of two tables on a node and on that of the next row."""
        way = self.reference_above if upwards else self.reference_between
        x, y = (
            o.known(o.call(way, "between rows", a, b, share), min(table), max(table))
            for table, a, b in zip(tables, low, high, strict=True)
        )
        return x, y

    def _row_of(self, o: Arithmetic[N, Any], size: N) -> tuple[N, N]:
        """The row below a torque, and its share of the way to the next one."""

        def reached(row: N) -> Any:
            return o.at_least(size, o.entry(self.torque, row))

        row = o.search("row", self.rows, reached)
        start = o.let("start", o.entry(self.torque, row))
        beyond = o.entry(self.torque, o.total("row", row, o.const(1)))
        done = o.known(o.total("torque in its row", size, o.negative(start)), 0, self.end)
        whole = o.known(o.total("torque of a row", beyond, o.negative(start)), 1, self.end)
        scaled = o.product("torque in its row", done, o.const(1 << self.fraction))
        share = o.quotient("share of a row", scaled, whole)
        return row, o.known(share, 0, 1 << self.fraction)

    def _voltage(self, o: Arithmetic[N, Any], v_dc: N, along: N) -> _Voltage[N]:
        scale, top = self._scale, self.top
        link = o.let("link", o.clamp(v_dc, scale.dc_least, None))
        product = o.product("voltage limit", o.const(scale.limit.mantissa), link)
        scaled = o.let("scaled", o.shifted(product, scale.limit.shift))
        limit = o.let("limit", o.known(o.clamp(scaled, None, top), 0, top))
        room = o.shifted(o.product("squared limit", limit, limit), scale.shift)
        # A square is not negative, which a range does not know.
        square = o.known(o.product("squared speed", along, along), 0, top * top)
        above = o.shifted(o.total("squared speed", square, o.const(top)), self.width - 1)
        return _Voltage(o.let("room", room), o.let("square", above), along)

    def _weakened(
        self, o: Arithmetic[N, Any], u: _Voltage[N], size: N, row: N, share: N
    ) -> tuple[N, N]:
        """Currents within the voltage, for a torque that may be less than the one asked for."""
        node, share, left = self._granted(o, u, size, row, share)

        def voltage(place: N) -> N:
            return o.call(self.reference_voltage, place, share, u.square)

        def crossing() -> tuple[N, N]:
            return self._crossing(o, voltage, node, left)

        corner, across = o.cases(
            ("corner", "across"),
            (o.above(voltage(node), left), crossing),
            otherwise=lambda: (node, o.const(0)),
        )
        tables, places = (self.d, self.q), (0, self.columns, 1, self.columns + 1)
        a, b, c, d = o.entries(("a", "b", "c", "d"), tables, corner, places)
        near_d, near_q = self._along(o, tables, a, b, share)
        near_d, near_q = o.let("near_d", near_d), o.let("near_q", near_q)

        def between_columns() -> tuple[N, N]:
            far_d, far_q = self._along(o, tables, c, d, share)
            far_d, far_q = o.let("far_d", far_d), o.let("far_q", far_q)
            name, way = "between columns", self.reference_between
            i_d = o.call(way, name, near_d, far_d, across)
            return i_d, o.call(way, name, near_q, far_q, across)

        return o.cases(
            ("i_d", "i_q"),
            (o.above(across, o.const(0)), between_columns),
            otherwise=lambda: (near_d, near_q),
        )

    def _granted(
        self, o: Arithmetic[N, Any], u: _Voltage[N], size: N, row: N, share: N
    ) -> tuple[N, N, N]:
        """First node, share of the row, and the squared voltage that the drop leaves: of the
        torque itself where some currents of its row keep that, else of the largest that can be
        had, where the voltage of the last column crosses it.
        """
        first = o.let("first", o.multiple("node", row, self.columns))
        last = o.total("node", first, o.const(self.columns - 1))
        within = o.let("within", share)

        def left_by(torque: N) -> N:
            drop = o.call(self.reference_drop, torque, u.along)
            return o.total("left by the drop", u.room, o.negative(drop))

        whole = o.let("whole", left_by(size), "what the drop leaves of the squared voltage")

        def lost(node: N) -> Any:
            return o.above(o.call(self.reference_voltage, node, within, u.square), whole)

        def less() -> tuple[N, N, N]:
            o.remark("Not to be had: the torque at which the last column takes all that there is.")
            low, part = self._largest(o, u, row)
            start = o.entry(self.torque, low)
            beyond = o.entry(self.torque, o.total("row", low, o.const(1)))
            held = o.call(self.reference_above, "torque", start, beyond, part)
            held = o.known(held, 0, self.end)
            return o.multiple("node", low, self.columns), part, left_by(held)

        return o.cases(
            ("node", "share", "left"),
            (o.every(lost(first), lost(last)), less),
            otherwise=lambda: (first, within, whole),
        )

    def _largest(self, o: Arithmetic[N, Any], u: _Voltage[N], row: N) -> tuple[N, N]:
        """The row below the largest torque that can be had, and its share of the way to the next
        one.
        """

        def at_row(place: N) -> N:
            return o.call(self.reference_end, place, u.square, u.along)

        def kept(place: N) -> Any:
            return o.every(o.at_least(row, place), o.at_least(u.room, at_row(place)))

        low, one = o.search("low", self.rows, kept), 1 << self.fraction
        below = o.let("below", at_row(low))
        rise = o.total("span", at_row(o.total("row", low, o.const(1))), o.negative(below))
        span = o.let("rise", o.total("span", o.shifted(rise, self.fraction), o.const(1)))
        spare = o.total("left", u.room, o.negative(below))
        spare = o.let("spare", o.choose(o.above(u.room, below), spare, o.const(0)))
        spare = o.known(spare, 0, 8 * one * one - 1)
        part = o.quotient("share of a row", spare, o.known(o.clamp(span, 1, None), 1, 8 * one))
        return low, o.let("part", o.clamp(o.let("met", part), None, one))

    def _crossing(
        self, o: Arithmetic[N, Any], voltage: Callable[[N], N], node: N, left: N
    ) -> tuple[N, N]:
        """The node before which the voltage of the columns falls to what is left, and the share of
        the way to the next one.
        """

        def over(column: N) -> Any:
            return o.above(voltage(o.total("node", node, column)), left)

        column, one = o.search("column", self.columns - 1, over), 1 << self.fraction
        place = o.let("place", o.total("node", node, column))
        much = o.let("much", voltage(place))
        little = voltage(o.total("node", place, o.const(1)))
        fall = o.shifted(o.total("span", much, o.negative(little)), self.fraction)
        span = o.known(o.clamp(o.let("fall", fall), 1, None), 1, 8 * one)
        excess = o.total("excess", much, o.negative(left))
        excess = o.let("excess", o.choose(o.above(much, left), excess, o.const(0)))
        excess = o.known(excess, 0, 8 * one * one - 1)
        share = o.let("met", o.quotient("share of a column", excess, span))
        return place, o.clamp(share, None, one)
