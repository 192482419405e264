"""The speed from the times of edges, which a timer takes that runs over.

Times are 32 bits wide: those of the timer go on from that of the last sample.
"""

from __future__ import annotations

from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.speed_measurement import counted
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member, where

_SIGNED = "int32_t"


@dataclass(frozen=True, slots=True)
class SpeedMeasurementGains:
    """Numbers of the measurement."""

    scale: Annotated[Reals, Member("mechanical speed of one edge per tick, rad/s")]
    mask: Annotated[Any, Member("largest number of the timer", whole=True)]
    patience: Annotated[
        Any, Member("samples without an edge after which the shaft counts as at rest", whole=True)
    ]


@dataclass(slots=True)
class SpeedMeasurement:
    """What is kept from edge to edge and from sample to sample; its start makes it."""

    now: Annotated[Any, Member("of the timer, at the last sample", whole=True)]
    time: Annotated[Any, Member("the same, 32 bits wide, ticks", whole=True)]
    stamp: Annotated[Any, Member("time of the last edge, 32 bits wide, ticks", whole=True)]
    begun: Annotated[
        Any, Member("time of the edge from which edges are counted, ticks", whole=True)
    ]
    ticks: Annotated[Any, Member("between the last two edges; 0: not known", whole=True)]
    edges: Annotated[Any, Member("since then, backward ones negative", kind=_SIGNED)]
    sense: Annotated[
        Any, Member("of the last edge: 1 forward, -1 backward, 0 none so far", kind=_SIGNED)
    ]
    idle: Annotated[Any, Member("samples since the last edge", whole=True)]
    count: Annotated[Any, Member("the speed: so many edges, backward ones negative,", kind=_SIGNED)]
    span: Annotated[Any, Member("in so many ticks; above 0", whole=True)]


def at_rest() -> SpeedMeasurement:
    """Members before the start."""
    return SpeedMeasurement(0, 0, 0, 0, 0, 0, 0, 0, 0, 1)


def start(o: Arithmetic, state: SpeedMeasurement) -> None:  # noqa: ARG001
    """No edge and no speed yet."""
    state.now, state.time, state.stamp, state.begun, state.ticks = 0, 0, 0, 0, 0
    state.edges, state.sense, state.idle = 0, 0, 0
    state.count, state.span = 0, 1


def edge(
    o: Arithmetic, gains: SpeedMeasurementGains, state: SpeedMeasurement, stamp: Any, sense: Any
) -> None:
    """In the interrupt of the capture unit: an edge at the time stamp of the timer, forward (1) or
    backward (-1). The first edge, and the first one after a turn or a rest, tells no time between
    edges.
    """
    at = o.let("at", state.time + o.masked(stamp - state.now, gains.mask))

    def first() -> None:
        state.begun, state.edges, state.ticks = at, 0, 0

    def further() -> None:
        ticks = o.let("ticks", at - state.stamp)
        state.edges = state.edges + sense
        state.ticks = o.choose(ticks > 0, ticks, 1)

    turned = o.negated(o.equal(state.sense, sense)) | (state.idle >= gains.patience)
    o.cases("", (turned, first), otherwise=further, changing=(state,))
    state.stamp, state.sense, state.idle = at, sense, 0


def captured(
    o: Arithmetic, gains: SpeedMeasurementGains, state: SpeedMeasurement, now: Any
) -> None:
    """Asked by the speed controller, once per speed period, at the time now of the timer; read it
    with the interrupt of the capture unit held off, so that no edge is later than it. Without an
    edge for longer than between the last two the speed is at most that of an edge just now.
    """
    elapsed = _passed(o, gains, state, now)

    def between() -> None:
        state.count = state.sense
        state.span = o.choose(elapsed > state.ticks, elapsed, state.ticks)

    unknown = _unknown(o, gains, state)
    o.cases("", (unknown, lambda: _rests(state)), otherwise=between, changing=(state,))
    _waited(o, gains, state)


def mixed(o: Arithmetic, gains: SpeedMeasurementGains, state: SpeedMeasurement, now: Any) -> None:
    """Asked by the speed controller, once per speed period, at the time now of the timer; read it
    with the interrupt of the capture unit held off, so that no edge is later than it. Without an
    edge for longer than between the last two the speed is at most that of an edge just now.
    """
    elapsed = _passed(o, gains, state, now)

    def counted() -> None:
        span = o.let("span", state.stamp - state.begun)
        forward, backward = (o.converted(x, "uint32") for x in (state.edges, -state.edges))
        edges = o.let("edges", o.choose(state.edges > 0, forward, backward))
        least = o.let("least", o.choose(span > 0, span, 1))
        state.count, state.span = state.edges, least
        o.write_state()
        state.ticks = o.choose(least >= edges, least // edges, 1)
        state.begun, state.edges = state.stamp, 0

    def slower() -> None:
        state.count, state.span = state.sense, elapsed

    o.cases(
        "",
        (_unknown(o, gains, state), lambda: _rests(state)),
        (o.negated(o.equal(state.edges, 0)), counted),
        (elapsed > state.ticks, slower),
        otherwise=lambda: o.remark("the last speed holds"),
        changing=(state,),
    )
    _waited(o, gains, state)


def _passed(o: Arithmetic, gains: SpeedMeasurementGains, state: SpeedMeasurement, now: Any) -> Any:
    """Ticks since the last edge."""
    time = o.let("time", state.time + o.masked(now - state.now, gains.mask))
    elapsed = o.let("elapsed", time - state.stamp)
    state.now, state.time = now, time
    return elapsed


def _unknown(o: Arithmetic, gains: SpeedMeasurementGains, state: SpeedMeasurement) -> Any:
    return o.equal(state.ticks, 0) | (state.idle >= gains.patience)


def _rests(state: SpeedMeasurement) -> None:
    state.count, state.span = 0, 1


def _waited(o: Arithmetic, gains: SpeedMeasurementGains, state: SpeedMeasurement) -> None:
    def longer() -> None:
        state.idle = state.idle + 1

    short = state.idle < gains.patience
    where(o, short, longer, state)


# Speeds of edges and what they took, which both measurements keep.

Gains = SpeedMeasurementGains | counted.SpeedMeasurementGains
State = SpeedMeasurement | counted.SpeedMeasurement


def rad_per_s(o: Arithmetic, gains: Gains, state: State) -> Reals:
    """Mechanical speed in rad/s."""
    return (gains.scale * o.real(state.count)) / o.real(state.span)


def per_unit(o: Arithmetic, width: int, code: int, state: State) -> Any:
    """Mechanical speed as a code.

    Args:
        o: The arithmetic.
        width: Bits of the code.
        code: Speed of one edge per tick (of counts: per sample).
        state: Of the measurement.
    """
    # Of the least count there is no opposite with a sign.
    backward = 0 - o.converted(state.count, "uint32")
    forward = o.converted(state.count, "uint32")
    edges = o.let("edges", o.choose(state.count < 0, backward, forward))
    moved = code * o.converted(edges, "uint64")
    size = o.let("size", moved // o.converted(state.span, "uint64"))
    top = (1 << (width - 1)) - 1
    limited = o.let("code", o.choose(size < top, o.converted(size, "int32"), top))
    signed = o.choose(state.count < 0, -limited, limited)
    return signed if width == 32 else o.converted(signed, "int16")
