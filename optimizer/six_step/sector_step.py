"""Position from the phase that floats: zero crossing and integral of the back-EMF, or conduction of
its diode, as the firmware runs it (paper 001, 7.2.1, methods 2 to 4).

Once per period it is told the voltages of the three terminals, sampled in the middle of the
on-time, or whether a diode conducted in the middle of the off-time. Times count in periods, between
samples by a line, of a diode by half a period. After a commutation nothing is seen while the phase
that was switched off frees its current. A crossing that was missed there, or while the drive
accelerates, counts at the first sample that shows its sign.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.six_step.sectors import FED, FLOATING, RETURN
from dqforge.optimizer.steps.step_arithmetic import Abc, Arithmetic, Member, where

_LARGEST = 1e6  # V
SIXTH = 1.0471975511965976  # pi/3
_HALF_TURN, _TURN, _QUARTER = 3.141592653589793, 6.283185307179586, 1.5707963267948966

# Macros of the firmware, and their values: phases by sector.
TABLES = {"SIX_STEP_FED": FED, "SIX_STEP_RETURN": RETURN, "SIX_STEP_FLOATING": FLOATING}
_WHOLE = "int32_t"


@dataclass(frozen=True, slots=True)
class BlockGains:
    """Numbers of the estimator; those with two entries hold forwards and backwards."""

    t_s: Annotated[float, Member("period", "s")]
    by_integral: Annotated[
        int,
        Member(
            "1: commutation by the integral of the voltage, 0: by the time from the crossing",
            kind=_WHOLE,
        ),
    ]
    delay: Annotated[
        tuple[float, float], Member("from the crossing to the commutation over 60 degrees")
    ]
    threshold: Annotated[tuple[float, float], Member("of the integral", "V s")]
    latency: Annotated[
        float, Member("from a sample until what follows from it acts, filter included", "periods")
    ]
    blank_share: Annotated[float, Member("unseen behind a commutation over the time of 60 degrees")]
    blank_least: Annotated[float, Member("and at least", "periods")]
    smooth: Annotated[float, Member("share of a new sample in the filter of the voltage")]
    patience: Annotated[
        float, Member("times of 60 degrees without a crossing, then the position is lost")
    ]
    crossings: Annotated[tuple[float, ...], Member("angles of the crossings forwards", "rad")]
    late: Annotated[
        float | None,
        Member("a diode conducts behind the crossing, over the squared periods of 60 degrees"),
    ] = None


@dataclass(slots=True)
class BlockState:
    """What the estimator keeps from sample to sample."""

    sector: Annotated[Any, Member("0 to 5: fed now", kind=_WHOLE)]
    direction: Annotated[Any, Member("1 or -1", kind=_WHOLE)]
    crossed: Annotated[Any, Member("1: the crossing of the sector is over", kind=_WHOLE)]
    armed: Annotated[Any, Member("1: the voltage before it was seen", kind=_WHOLE)]
    lost: Annotated[Any, Member("1: no crossing has come", kind=_WHOLE)]
    since: Annotated[Reals, Member("the commutation", "periods")]
    elapsed: Annotated[Reals, Member("since the crossing", "periods")]
    interval: Annotated[Reals, Member("between the last two", "periods")]
    mean: Annotated[Reals, Member("of two intervals", "periods")]
    last: Annotated[Reals, Member("voltage", "V")]
    area: Annotated[Reals, Member("its integral", "V s")]
    theta_z: Annotated[Reals, Member("angle of the last crossing", "rad")]
    theta_e: Annotated[Reals, Member("estimated electrical angle, rad, -pi to pi")]
    omega_e: Annotated[Reals, Member("estimated electrical speed, rad/s")]


class SixStepSeen(NamedTuple):
    """What the back-EMF shows while all legs rest."""

    sector: Annotated[Any, Member("whose line has the largest voltage", kind=_WHOLE)]
    beyond: Annotated[Reals, Member("its crossing, to 10 %", "rad")]
    largest: Annotated[Reals, Member("voltage between two terminals", "V")]


def at_rest() -> BlockState:
    """Members of a state before it is started."""
    zero: Any = 0.0
    return BlockState(0, 1, 0, 0, 0, *(zero,) * 9)


def six_step_phase(o: Arithmetic, x: Abc, phase: Any) -> Reals:
    """One of three phases."""
    return o.choose(o.equal(phase, 0), x.a, o.choose(o.equal(phase, 1), x.b, x.c))


def rises(sector: Any, direction: Any) -> Any:
    """Whether the voltage of the floating phase rises through zero in a sector; then the phase that
    carried the current before is the one that is fed, else it is the one that returns it.
    """
    return (2 * (sector % 2) - 1) * direction > 0


def six_step_rising(o: Arithmetic, v: Abc, phase: Any, sector: Any, direction: Any) -> Reals:
    """The voltage of a phase against the mean of all, rising through zero over time where it
    floats.
    """
    u = o.let("u", o.call(six_step_phase, v, phase) - 0.33333334 * ((v.a + v.b) + v.c))
    return o.choose(rises(sector, direction), u, -u)


def _wrapped_once(o: Arithmetic, theta: Reals) -> Reals:
    """An angle within three turns of zero in rad brought into -pi to pi."""
    below = o.let("below", o.choose(theta >= _HALF_TURN, theta - _TURN, theta))
    return o.choose(below < -_HALF_TURN, below + _TURN, below)


def crossing(o: Arithmetic, gains: BlockGains, sector: Any, direction: Any) -> Reals:
    """Angle of the crossing in a sector in rad, backwards that of the opposite sector."""
    place = o.let("place", o.choose(direction > 0, sector, (sector + 3) % 6))
    return o.at(gains.crossings, place)


def block_start(
    o: Arithmetic,
    gains: BlockGains,
    observer: BlockState,
    sector: Any,
    direction: Any,
    omega_e: Reals,
    beyond: Reals,
) -> None:
    """Start while the rotor turns: the sector fed from now on (0 to 5), the direction (1, -1), the
    magnitude of the electrical speed in rad/s, and the angle in rad by which the rotor is beyond
    the crossing of that sector (negative before it).
    """
    way = o.let("way", o.choose(direction > 0, 0, 1))
    x = o.let("x", omega_e * gains.t_s)
    mean = o.let("mean", SIXTH / x)
    elapsed = o.let("elapsed", beyond / x)
    share = o.let("share", elapsed / (o.at(gains.delay, way) * mean))
    zero = o.full(0.0, x)
    observer.sector, observer.direction = sector, direction
    observer.armed, observer.lost = 0, 0
    observer.since, observer.last = zero, zero
    observer.interval, observer.mean = mean, mean

    def after() -> None:
        observer.crossed = 1
        observer.elapsed = elapsed
        observer.area = o.at(gains.threshold, way) * (share * share)
        observer.theta_z = o.call(crossing, gains, sector, direction)

    def before() -> None:
        last = o.let("before", (sector + o.choose(direction > 0, 5, 1)) % 6)
        observer.crossed = 0
        observer.elapsed = elapsed + mean
        observer.area = zero
        observer.theta_z = o.call(crossing, gains, last, direction)

    o.cases("", (beyond >= 0.0, after), otherwise=before, changing=(observer,))
    moved = o.let("moved", x * observer.elapsed)
    z = observer.theta_z
    theta = o.let("theta", o.choose(direction > 0, z + moved, z - moved))
    observer.theta_e = _wrapped_once(o, theta)
    observer.omega_e = o.choose(direction > 0, omega_e, -omega_e)


def see(o: Arithmetic, gains: BlockGains, observer: BlockState, y: Reals) -> None:
    """A voltage behind the unseen time."""

    def integrated() -> None:
        observer.area = observer.area + (0.5 * (observer.last + y)) * gains.t_s

    def crossed() -> None:
        armed = o.negated(o.equal(observer.armed, 0))
        part = o.let("part", o.choose(armed, y / (y - observer.last), o.full(0.0, y)))
        if gains.late is not None:
            part = o.let("ago", part + gains.late * (observer.mean * observer.mean))
        low, high = o.let("low", 0.5 * observer.mean), o.let("high", 2.0 * observer.mean)
        span = o.let("span", observer.elapsed - part)
        above = o.let("above", o.choose(span < low, low, span))
        found = o.let("found", o.choose(above > high, high, above))
        mean = o.let("mean", 0.5 * (observer.interval + found))
        observer.mean = o.choose(mean < 1.0, o.full(1.0, y), mean)
        observer.interval, observer.elapsed = found, part
        observer.area = (0.5 * y) * (part * gains.t_s)
        observer.theta_z = o.call(crossing, gains, observer.sector, observer.direction)
        observer.crossed = 1

    def early() -> None:
        observer.armed = 1

    o.cases(
        "",
        (o.negated(o.equal(observer.crossed, 0)), integrated),
        (y >= 0.0, crossed),
        otherwise=early,
        changing=(observer,),
    )


def due(o: Arithmetic, gains: BlockGains, observer: BlockState) -> Any:
    """Whether the current is to be handed on at the next instant at which a step acts."""
    way = o.let("way", o.choose(observer.direction > 0, 0, 1))
    ahead = o.let("ahead", observer.elapsed + gains.latency)

    def by_time() -> Any:
        return o.at(gains.delay, way) * observer.mean - ahead < 0.5

    def by_integral() -> Any:
        last = (observer.last * gains.t_s) * (gains.latency + 0.5)
        reached = o.let("reached", observer.area + last)
        return (reached >= o.at(gains.threshold, way)) | (ahead > observer.mean)

    return o.cases(
        "ends",
        (o.equal(observer.crossed, 0), lambda: False),
        (o.equal(gains.by_integral, 0), by_time),
        otherwise=by_integral,
    )


def block_step(o: Arithmetic, gains: BlockGains, observer: BlockState, v: Abc) -> None:
    """One period: the voltages of the terminals in V against any potential, sampled in the middle
    of the on-time.
    """
    sector, direction = observer.sector, observer.direction
    floats = o.at(o.constant("SIX_STEP_FLOATING", FLOATING), sector)
    _passed(o, gains, observer, o.let("y", o.call(six_step_rising, v, floats, sector, direction)))


def diode_step(o: Arithmetic, gains: BlockGains, observer: BlockState, diodes: Abc) -> None:
    """One period: 1 of each leg whose switches rest and whose diode conducted in the middle of the
    off-time, at the beginning of the period, else 0.
    """
    floats = o.at(o.constant("SIX_STEP_FLOATING", FLOATING), observer.sector)
    conducts = o.let("conducts", o.call(six_step_phase, diodes, floats) > 0.5)
    one = o.full(1.0, observer.mean)
    _passed(o, gains, observer, o.let("y", o.choose(conducts, one, -one)))


def _passed(o: Arithmetic, gains: BlockGains, observer: BlockState, y: Reals) -> None:
    """A period, with what of the floating phase rises through zero at its crossing."""
    direction = observer.direction
    share = o.let("share", gains.blank_share * observer.mean)
    blank = o.let("blank", o.choose(share < gains.blank_least, gains.blank_least, share))
    observer.since = since = o.let("since", observer.since + 1.0)
    observer.elapsed = o.let("passed", observer.elapsed + 1.0)

    def behind() -> Reals:
        smooth = observer.last + gains.smooth * (y - observer.last)
        seen = o.let("seen", o.choose(since - blank > 1.0, smooth, y))
        o.call(see, gains, observer, seen)
        return seen

    def known() -> None:
        last = o.cases("last", (since > blank, behind), otherwise=lambda: y, changing=(observer,))
        observer.last = last

    o.remark("what is no number is not seen")
    within = (y < _LARGEST) & (y > -_LARGEST)
    where(o, within, known, observer)
    elapsed, mean = o.let("elapsed", observer.elapsed), o.let("mean", observer.mean)
    observer.lost = o.choose(elapsed > gains.patience * mean, 1, observer.lost)
    turn = o.let("turn", SIXTH / o.choose(elapsed > mean, elapsed, mean))
    moved = o.let("moved", turn * (elapsed + gains.latency))
    moved = o.let("angle", o.choose(moved < _QUARTER, moved, o.full(_QUARTER, moved)))
    omega = o.let("omega", turn / gains.t_s)
    z = observer.theta_z
    theta = o.let("theta", o.choose(direction > 0, z + moved, z - moved))
    observer.omega_e = o.choose(direction > 0, omega, -omega)
    observer.theta_e = _wrapped_once(o, theta)

    def handed_on() -> None:
        observer.sector = (observer.sector + o.choose(direction > 0, 1, 5)) % 6
        observer.since = o.full(0.0, y)
        observer.crossed, observer.armed = 0, 0

    over = o.let("over", o.call(due, gains, observer))
    where(o, over, handed_on, observer)


def six_step_seen(o: Arithmetic, v: Abc, direction: Any) -> SixStepSeen:
    """Sector whose line has the largest voltage while all legs rest, angle beyond its crossing in
    rad (to 10 %), and that voltage in V.

    Within 30 degrees tan x = sqrt(3) y/(largest), and x = tan x to 10 %.
    """
    highest = o.choose(v.b >= v.c, 1, 2)
    high = o.let("high", o.choose((v.a >= v.b) & (v.a >= v.c), 0, highest))
    lower = o.choose(v.b < v.c, 1, 2)
    lowest = o.let("lowest", o.choose((v.a < v.b) & (v.a < v.c), 0, lower))
    behind = o.let("behind", (high + 1) % 3)
    low = o.let("low", o.choose(o.equal(high, lowest), behind, lowest))
    sector = o.let("sector", 2 * high + o.choose(o.equal(behind, low), 0, 1))
    size = o.let("size", o.call(six_step_phase, v, high) - o.call(six_step_phase, v, low))

    def turning() -> tuple[Reals, Reals]:
        y = o.call(six_step_rising, v, (3 - high) - low, sector, direction)
        return 1.7320508 * (y / size), size

    def still() -> tuple[Reals, Reals]:
        return o.full(0.0, size), o.full(0.0, size)

    beyond, largest = o.cases(("beyond", "largest"), (size > 0.0, turning), otherwise=still)
    return SixStepSeen(sector, beyond, largest)
