"""Vectors of codes, and what a number of the emitted functions is: a code, an angle, a count."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, NamedTuple

from dqforge.machines.transforms import N, Pair, Triple

# Words of the firmware: a code with its sign, one of twice as many bits, an angle, which turns
# over, a number of 32 bits from 0 on, and one of 8 bits.
CODE, WIDE, TURN, COUNT, FEW = "code", "wide", "turn", "count", "few"

# Numbers by their words; others are wide.
Coded = Annotated[N, CODE]
Turned = Annotated[N, TURN]
Counted = Annotated[N, COUNT]


class Abc(Triple[N]):
    """Codes of the phases a, b, c."""


class AlphaBeta(Pair[N]):
    """Codes in stationary coordinates."""

    AXES: ClassVar[tuple[str, ...]] = ("alpha", "beta")


class Dq(Pair[N]):
    """Codes in rotor coordinates."""

    AXES: ClassVar[tuple[str, ...]] = ("d", "q")


class Rotation(Pair[N]):
    """Codes of cosine and sine."""

    AXES: ClassVar[tuple[str, ...]] = ("cosine", "sine")


class Feedforward(Pair[N]):
    """Wide words in rotor coordinates."""

    AXES: ClassVar[tuple[str, ...]] = ("d", "q")
    WORDS: ClassVar[str] = WIDE


class Duties(Triple[N]):
    """Duty cycles of the upper switches."""

    WORDS: ClassVar[str] = TURN


class Gain(NamedTuple):
    """Numbers of a `FixedGain` in the firmware."""

    mantissa: Any
    shift: Any
    half: Any


WORDS_OF_GAIN = ("mantissa", COUNT, WIDE)


class Filling(NamedTuple):
    """Says of a function that it fills an array of this name in the firmware."""

    name: str
