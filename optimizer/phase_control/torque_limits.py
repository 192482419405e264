"""What limits the torque, and the currents beyond those in proportion to it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.phase_control.phase_records import Alphabetazero, ControlGains, TorqueLimit
from dqforge.optimizer.phase_control.shape_references import mean_of_phases, place_in_table
from dqforge.optimizer.steps.step_arithmetic import Abc, Arithmetic, Member


@dataclass(frozen=True, slots=True)
class Limited:
    """Currents in A beyond those in proportion to the torque, over electrical speed in rad/s at the
    nominal link, torque and angle.

    ``omega_e``, ``plain`` and ``most`` have shape (W,), each of ``current`` (W, S, nodes + 1).
    """

    omega_e: Any
    plain: Any
    most: Any
    current: tuple[Any, ...]


class LimitedLoad(NamedTuple):
    """Where a speed lies among those of the currents beyond the proportional ones."""

    row: Annotated[Any, Member("interval of the speed, and the share of it", whole=True)]
    above: Reals
    plain: Annotated[Reals, Member("plain and largest torque there", "N m")]
    most: Reals
    reach: Annotated[Reals, Member("1 where the table reaches, else 0")]


class LimitedPlace(NamedTuple):
    """Where an operating point lies among the currents beyond the proportional ones."""

    row: Annotated[Any, Member("interval of the speed, and the share of it", whole=True)]
    above: Reals
    column: Annotated[Any, Member("interval of the torque, and the share of it", whole=True)]
    beside: Reals
    sign: Annotated[
        Reals, Member("1 for motoring forwards, -1 backwards, 0 where nothing is added")
    ]


def _within(o: Arithmetic, x: Reals) -> Reals:
    none, one = o.full(0.0, x), o.full(1.0, x)
    return o.choose(x > 1.0, one, o.choose(x > 0.0, x, none))


def _between(o: Arithmetic, name: str, axis: Any, place: Any, value: Reals) -> Reals:
    """Share of an interval of an axis that a value has passed."""
    low, high = o.at(axis, place), o.at(axis, place + 1)
    part = o.let(f"{name}_part", (value - low) / (high - low))
    return o.let(name, _within(o, part))


@dataclass(frozen=True, slots=True)
class LimitSteps:
    """The limit of the torque by a table.

    Args:
        v_nominal: Link voltage in V at which the speeds of the table are the drive's; None where
            they are at any.
    """

    v_nominal: float | None

    def largest_torque(
        self, o: Arithmetic, limit: TorqueLimit, omega_e: Reals, v_dc: Reals
    ) -> Reals:
        """Largest torque in N m at an electrical speed in rad/s and a DC-link voltage in V."""
        speed = omega_e
        if self.v_nominal is not None:
            o.remark("The speed that would load the nominal link as much.")
            last = o.at(limit.omega_e, len(limit.omega_e) - 1)
            equal = o.choose(v_dc > 0.0, omega_e * (self.v_nominal / v_dc), last)
            speed = o.let("speed", equal)
        j = o.interval("j", limit.omega_e, speed)
        k = o.interval("k", limit.v_dc, v_dc)
        x, y = _between(o, "x", limit.omega_e, j, speed), _between(o, "y", limit.v_dc, k, v_dc)

        def at(row: Callable[[], Any]) -> Reals:
            first = o.at(limit.torque, row(), k)
            found: Reals = first + (y * (o.at(limit.torque, row(), k + 1) - first))
            return found

        low, high = o.let("low", at(lambda: j)), o.let("high", at(lambda: j + 1))
        torque: Reals = low + (x * (high - low))
        return torque


@dataclass(slots=True)
class _Total:
    """Phase currents in A, to which those of the corners are added one after the other."""

    a: Reals
    b: Reals
    c: Reals


@dataclass(frozen=True, slots=True, eq=False)
class LimitedSteps:
    """Currents beyond those in proportion to the torque.

    Args:
        table: The table.
        v_nominal: Link voltage in V at which its speeds are the drive's.
        mirrored: Whether it is for both directions.
        neutral: Whether the legs drive a zero sequence.
    """

    table: Limited
    v_nominal: float
    mirrored: bool
    neutral: bool

    def limited_load(
        self, o: Arithmetic, table: Limited, omega_e: Reals, v_dc: Reals
    ) -> LimitedLoad:
        """Interval of the speed at the nominal link that loads it as much."""
        last = o.at(table.omega_e, len(table.omega_e) - 1)
        equal = o.choose(v_dc > 0.0, o.magnitude(omega_e) * (self.v_nominal / v_dc), last)
        load = o.let("load", equal)
        j = o.interval("j", table.omega_e, load)
        x = _between(o, "x", table.omega_e, j, load)

        def at(values: Any) -> Reals:
            low = o.at(values, j)
            found: Reals = low + (x * (o.at(values, j + 1) - low))
            return found

        inside = load >= o.at(table.omega_e, 0)
        if not self.mirrored:
            inside = inside & (omega_e >= 0.0)
        reach = o.choose(inside, o.full(1.0, load), o.full(0.0, load))
        return LimitedLoad(j, x, at(table.plain), at(table.most), reach)

    def limited_place(
        self, o: Arithmetic, torque: Reals, omega_e: Reals, v_dc: Reals, opened: Reals | None = None
    ) -> LimitedPlace:
        """Where an operating point lies."""
        load = o.let("load", o.call(self.limited_load, self.table, omega_e, v_dc))
        span = o.let("span", load.most - load.plain)
        none, one = o.full(0.0, span), o.full(1.0, span)
        part = o.choose(span > 0.0, (o.magnitude(torque) - load.plain) / span, none)
        steps = self.table.current[0].shape[1] - 1
        share = o.let("share", _within(o, o.let("part", part)) * float(steps))
        column = o.placed("column", share, steps - 1)
        motors = (load.reach > 0.0) & (torque * omega_e > 0.0)
        if opened is not None:
            motors = motors & (opened < 1)
        sign = o.choose(motors, o.choose(omega_e < 0.0, o.full(-1.0, span), one), none)
        return LimitedPlace(load.row, load.above, column, share - o.real(column), sign)

    def deviated(
        self,
        o: Arithmetic,
        table: Limited,
        i: Alphabetazero,
        at: LimitedPlace,
        place: Reals,
    ) -> Alphabetazero:
        """Currents in A to add to those in proportion to the torque; they make no torque."""
        nodes, rows = self.table.current[0].shape[2] - 1, len(self.table.current)
        where = place_in_table(o, o.let("mirrored", at.sign * place), nodes, rows)
        share = where.share
        tables = table.current * (3 if rows == 1 else 1)
        none = o.full(0.0, share)
        total = _Total(none, none, none)

        def add(corner: Any) -> None:
            i_up, j_up = o.let("i_up", corner // 2), o.let("j_up", corner % 2)
            above = o.choose(o.equal(i_up, 1), at.above, 1.0 - at.above)
            beside = o.choose(o.equal(j_up, 1), at.beside, 1.0 - at.beside)
            weight = o.let("weight", above * beside)

            def added(rows_of: Any, k: Any) -> Reals:
                here = o.at(rows_of, at.row + i_up, at.column + j_up, k)
                there = o.at(rows_of, at.row + i_up, at.column + j_up, k + 1)
                found: Reals = weight * (here + (share * (there - here)))
                return found

            a, b, c = map(added, tables, where.places)
            total.a, total.b, total.c = total.a + a, total.b + b, total.c + c

        o.repeated(total, 4, add)
        d = o.let("d", Abc(total.a, total.b, total.c))
        plane = o.let("plane", o.clarke(d))
        size = o.let("size", o.magnitude(at.sign))
        zero = i.zero + (size * mean_of_phases(d)) if self.neutral else i.zero
        return Alphabetazero(i.alpha + (size * plane.alpha), i.beta + (at.sign * plane.beta), zero)


@dataclass(frozen=True, slots=True)
class TorqueSteps:
    """The torque within its limits.

    Args:
        limit: By a table, None without.
        limited: Currents beyond the proportional ones, which make more; None without.
    """

    limit: LimitSteps | None = None
    limited: LimitedSteps | None = None

    def limited_torque(
        self, o: Arithmetic, gains: ControlGains, torque: Reals, omega_e: Reals, v_dc: Reals
    ) -> Reals:
        """A torque in N m within the limits; 0 for not-a-number."""
        most = o.let("torque_max", gains.torque_max)
        if self.limit is not None:
            assert gains.torque_limit is not None
            speed = o.let("speed", o.magnitude(omega_e))
            found = o.call(self.limit.largest_torque, gains.torque_limit, speed, v_dc)
            permitted = o.let("permitted", found)
            most = o.let("most", o.choose(permitted < most, permitted, most))
        if self.limited is not None:
            table = self.limited.table
            load = o.let("load", o.call(self.limited.limited_load, table, omega_e, v_dc))
            motors = (load.reach > 0.0) & (torque * omega_e > 0.0) & (load.most > most)
            most = o.let("beyond", o.choose(motors, load.most, most))
        low = o.choose(torque < -most, -most, o.full(0.0, torque))
        return o.choose(torque > most, most, o.choose(torque >= -most, torque, low))
