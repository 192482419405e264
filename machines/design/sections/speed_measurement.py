"""The section ``control.speed_loop.measurement``: the speed from the edges of an encoder."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from dqforge.machines.design.settings import SpeedMeasurementSettings
from dqforge.machines.entries.kinds import PointSpeed, Section
from dqforge.machines.entries.rules import Quantity, QuantityRule, not_truth, si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import SpeedMeasurementName

_PATH = ("control", "speed_loop", "measurement")


_SHARE = 0.1  # of the largest speed, from which the loop holds where nothing is said


TimerClock = Annotated[Quantity, QuantityRule("frequency", 1e3, 1e9)]


Whole = Annotated[int, BeforeValidator(not_truth)]


class SpeedMeasurementSection(Section):
    """How the speed comes from the edges of an encoder."""

    method: SpeedMeasurementName = Field(
        default="mixed",
        description=(
            "counts: edges in a speed period; capture: time between two edges; mixed: edges over "
            "the time that they took"
        ),
    )
    lines: Whole = Field(ge=1, le=1_000_000, description="of the encoder, per revolution")
    edges: Whole = Field(
        default=1,
        ge=1,
        le=4,
        description="captured of each line: 1, 2 or 4; counts always takes all four",
    )
    clock: TimerClock | None = Field(
        default=None, description="for capture and mixed: frequency of the timer (Hz)"
    )
    counter_bits: Whole = Field(
        default=16, ge=8, le=32, description="for capture and mixed: bits of the timer"
    )
    lowest: PointSpeed | None = Field(
        default=None,
        description=(
            "mechanical speed from which the loop must hold (rad/s; write rpm); default a tenth "
            "of the largest"
        ),
    )


def check_measurement(
    section: SpeedMeasurementSection | None, observed: bool, document: YamlDocument
) -> None:
    """Check what the keys need of each other.

    ``observed`` says that an observer makes the speed. Raises `InputError` with a position.
    """
    if section is None:
        return
    where = ".".join(_PATH)
    if observed:
        message = (
            f"{where} is of an encoder, but control.observer makes the speed; remove one of them"
        )
        raise document.error(message, _PATH, key=True)
    if section.edges == 3:
        raise document.error(f"{where}.edges must be 1, 2 or 4", (*_PATH, "edges"))
    timed = section.method != "counts"
    if timed and section.clock is None:
        message = (
            f"{where}: the method '{section.method}' needs the key 'clock'; write clock: 10 MHz"
        )
        raise document.error(message, _PATH, key=True)
    for key in ("clock", "counter_bits", "edges"):
        if not timed and key in section.model_fields_set:
            message = f"{where}: the method 'counts' does not use '{key}'; remove it"
            raise document.error(message, (*_PATH, key), key=True)
    if section.lowest is not None and section.lowest.si <= 0.0:
        raise document.error(f"{where}.lowest must be above 0 rpm", (*_PATH, "lowest"))


def read_measurement(
    section: SpeedMeasurementSection | None, omega_max: float
) -> SpeedMeasurementSettings | None:
    """What the section asks for, in SI units; ``omega_max`` in rad/s is the largest speed."""
    if section is None:
        return None
    lowest, clock = si_of(section.lowest), si_of(section.clock)
    return SpeedMeasurementSettings(
        section.method,
        section.lines,
        0.0 if clock is None else clock,
        section.counter_bits,
        4 if section.method == "counts" else section.edges,
        _SHARE * omega_max if lowest is None else lowest,
    )
