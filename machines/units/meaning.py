"""What a unit means for a dimension: its SI value, the angles that it counts,
and what it is refused for.

Of its dimension an angle is a number. Whether 3000 1/min are revolutions, radians or cycles is
therefore decided here: by the angles that the unit names, and where it names none by the
dimension (`Dimension.unnamed`).
"""

from __future__ import annotations

import math
from decimal import Decimal
from functools import cache

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import (
    ANGULAR,
    CYCLIC,
    DIMENSIONS,
    FORCES,
    LONG_TIMES,
    Dimension,
)
from dqforge.machines.units.si_factors import (
    ICE_POINT,
    Powers,
    dimension_of,
    factor_between,
    powers_of,
)
from dqforge.machines.wording import shown

TEN = "ten"  # Name that a power of ten has among the powers: the 1000 of ``V/1000 rpm``.
_TURN = 2.0 * math.pi
_RECIPROCAL = "1/"


@dataclass(frozen=True, slots=True)
class Converted:
    """Value in the wanted unit, whether the reciprocal was given, and what
    an open unit was taken for.
    """

    si: float
    inverted: bool = False
    remark: str = ""


class _RefusedError(Exception):
    """A unit has the dimension on paper and another meaning; the message says what to write."""


def convert(number: float, powers: Powers, wanted: Dimension, text: str) -> Converted:
    """Value of a number with a unit in the wanted unit.

    Raises:
        InputError: The unit has another dimension, another meaning, or more than one.
    """
    got = f"expected {wanted.name} such as '{wanted.example}', got {shown(text)}"
    try:
        if is_of(powers, wanted):
            factor, remark = _angles(number, powers, wanted)
            return Converted(
                factor * _scaled(number, powers, wanted),
                remark=f"{shown(text)} {remark}" * bool(remark),
            )
        reciprocal = {name: -power for name, power in powers.items()}
        if wanted.reciprocal and number != 0.0 and is_of(reciprocal, wanted):
            factor, remark = _angles(1.0 / number, reciprocal, wanted)
            remark = f"{shown(text)} {remark}" * bool(remark)
            return Converted(
                factor * _scaled(1.0 / number, reciprocal, wanted), inverted=True, remark=remark
            )
    except _RefusedError as refusal:
        raise InputError(f"{got}; {refusal}") from None
    raise InputError(got + _what_it_is(tuple(powers.items()), wanted.name))


def is_of(powers: Powers, dimension: Dimension) -> bool:
    """Whether a unit has the dimension on paper, whatever it means."""
    return dimension_of(_library(powers)) == dimension_of(powers_of(dimension.base))


def weighed(powers: Powers, wanted: Dimension) -> Powers:
    """Powers with masses as weights, where that is what is wanted: oz-in of a torque."""
    if FORCES.keys().isdisjoint(powers) or is_of(powers, wanted):
        return powers
    found = {FORCES.get(name, name): power for name, power in powers.items()}
    return found if is_of(found, wanted) else powers


def _angles(number: float, powers: Powers, wanted: Dimension) -> tuple[float, str]:
    """Factor that the angles of a unit make, and what was taken for granted.

    Raises what does not belong here.
    """
    plain = _library(powers)
    if not wanted.forbidden.isdisjoint(plain):
        raise _RefusedError(wanted.reason)
    angle = sum(power for name, power in plain.items() if name in ANGULAR)
    cycles = sum(power for name, power in plain.items() if name in CYCLIC)
    if wanted.cycles and cycles:
        if angle or abs(cycles) != 1:
            raise _RefusedError(wanted.reason)
        return (
            _TURN**cycles,
            "is taken per electrical hertz: 2 pi times the flux linkage" * wanted.electrical,
        )
    if angle:
        if angle != wanted.angle:
            raise _RefusedError(_NO_ANGLE if wanted.angle == 0 else f"write it like {wanted.unit}")
        return 1.0, "is taken per electrical rad/s" * wanted.electrical
    return (1.0, "") if wanted.angle == 0 else _unnamed(number, powers, wanted)


_NO_ANGLE = "there is no angle in it, so that rad, deg and revolutions do not belong into its unit"


def _unnamed(number: float, powers: Powers, wanted: Dimension) -> tuple[float, str]:
    """The same for a unit without an angle where one belongs: revolutions, or radians."""
    per_time = [
        name.removeprefix(_RECIPROCAL)
        for name, power in powers.items()
        if _counts(name, power, wanted)
    ]
    if wanted.unnamed == "refused":
        raise _RefusedError(wanted.reason)
    if wanted.unnamed == "revolutions" or (per_time and wanted.angle < 0):
        if wanted.electrical:
            raise _RefusedError(wanted.reason)
        times = per_time or [
            name for name in _library(powers) if name.endswith("second") or name in LONG_TIMES
        ]
        unit = times[0] if times else "second"
        return (
            _TURN**wanted.angle,
            f"counts revolutions per {unit}; write it with rad/s if radians are meant",
        )
    if not LONG_TIMES.isdisjoint(_library(powers)):
        if wanted.angle > 0:
            raise _RefusedError(wanted.reason)
        radians = _scaled(number, powers, wanted)
        raise _RefusedError(
            f"it can be taken in two ways; write '{radians:.6g} {wanted.unit}' if it counts "
            f"radians, '{radians / _TURN:.6g} {wanted.unit}' if it counts revolutions"
        )
    open_unit = wanted.told and not _has_radians_by_name(powers)
    other = "Hz" if wanted.cycles else "rpm"
    return 1.0, f"is taken with rad/s; write it with {other} if that is meant" if open_unit else ""


def _counts(name: str, power: int, wanted: Dimension) -> bool:
    """Whether a factor is the reciprocal of a time, and stands where a speed would stand in the
    unit.
    """
    return name.startswith(_RECIPROCAL) and power * wanted.angle > 0


def _has_radians_by_name(powers: Powers) -> bool:
    return not ANGULAR.isdisjoint(powers)


def _library(powers: Powers) -> Powers:
    """Powers of the names of units alone: reciprocals of times undone,
    powers of ten left out.
    """
    plain: Powers = {}
    for name, power in powers.items():
        if name == TEN:
            continue
        known, sign = (
            (name.removeprefix(_RECIPROCAL), -1) if name.startswith(_RECIPROCAL) else (name, 1)
        )
        plain[known] = plain.get(known, 0) + sign * power
    return {name: power for name, power in plain.items() if power}


_Key = tuple[tuple[str, int], ...]


def _key(powers: Powers) -> _Key:
    """Powers with differences of temperature in kelvin (only a lone degC is a point on a scale),
    for a cache.
    """
    if powers != {"degree_Celsius": 1} and "degree_Celsius" in powers:
        rest = {name: power for name, power in powers.items() if name != "degree_Celsius"}
        rest["kelvin"] = powers["degree_Celsius"] + rest.get("kelvin", 0)
        powers = {name: power for name, power in rest.items() if power}
    return tuple(sorted(powers.items()))


@cache
def _factor_of(key: _Key, base: str) -> float:
    return factor_between(dict(key), powers_of(base))


def _scaled(number: float, powers: Powers, wanted: Dimension) -> float:
    """Value in the wanted unit.

    Decimal prefixes give the float that the digits would give ("36 mH" is 0.036).
    """
    plain = _library(powers)
    key = _key(plain)
    factor = _factor_of(key, wanted.base)
    decimals = powers.get(TEN, 0)
    if wanted.base == "degree_Celsius":
        value = number * 10.0**decimals
        return value if plain == {wanted.base: 1} else value * factor - ICE_POINT
    exponent = round(math.log10(factor))
    if math.isclose(factor, 10.0**exponent, rel_tol=1e-12):
        return float(Decimal(repr(number)).scaleb(exponent + decimals))
    return number * factor * 10.0**decimals


@cache
def _what_it_is(key: _Key, wanted: str) -> str:
    """What a unit is that is not wanted, as the end of a sentence.

    Empty where it is nothing that the program knows.
    """
    for dimension in DIMENSIONS.values():
        powers = weighed(dict(key), dimension)
        if dimension.name == wanted or not is_of(powers, dimension):
            continue
        try:
            _angles(1.0, powers, dimension)
        except _RefusedError:
            continue
        return f" which is {dimension.name}"
    return ""
