"""The speed as edges per sample: a counter of 32 bits that runs over."""

from __future__ import annotations

from typing import Annotated, Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Reals
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member

_HALF = 1 << 31


@dataclass(frozen=True, slots=True)
class SpeedMeasurementGains:
    """Numbers of the measurement."""

    scale: Annotated[Reals, Member("mechanical speed of one edge per sample, rad/s")]


@dataclass(slots=True)
class SpeedMeasurement:
    """What is kept from sample to sample; its start makes it."""

    stamp: Annotated[Any, Member("last position, counts", whole=True)]
    known: Annotated[Any, Member("whether there is one", kind="int32_t")]
    count: Annotated[
        Any, Member("the speed: so many edges, backward ones negative,", kind="int32_t")
    ]
    span: Annotated[Any, Member("in so many samples; above 0", whole=True)]


def at_rest() -> SpeedMeasurement:
    """Members before the start."""
    return SpeedMeasurement(0, 0, 0, 1)


def start(o: Arithmetic, state: SpeedMeasurement) -> None:  # noqa: ARG001
    """No position and no speed yet."""
    state.stamp, state.known = 0, 0
    state.count, state.span = 0, 1


def sample(o: Arithmetic, state: SpeedMeasurement, position: Any) -> None:
    """Asked by the speed controller, once per speed period: the position in counts, four per line,
    of a counter of 32 bits.
    """
    moved = o.let("moved", position - state.stamp)
    back = o.let("back", state.stamp - position - 1, "one less than it moved backward")

    def unknown() -> None:
        state.count = 0

    def counted() -> None:
        forward = o.converted(moved, "int32")
        state.count = o.choose(moved < _HALF, forward, -o.converted(back, "int32") - 1)

    o.cases("", (o.equal(state.known, 0), unknown), otherwise=counted, changing=(state,))
    state.stamp, state.known = position, 1
