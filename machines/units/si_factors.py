"""What the names of the vocabulary are in SI: factors, and powers of the base units.

Angles, turns and shares are numbers here. Of mass the gram is the base, whose thousand a newton
brings along: where it stands in both units of a conversion it cancels before anything is
multiplied. Equal factors cancel, the others are multiplied in the order in which they stand, so
that a value is the same float on every machine and in every version.
"""

from __future__ import annotations

import math
import re
from functools import cache

Factors = tuple[tuple[float, int], ...]  # Factors with their powers.
Powers = dict[str, int]

_FACTOR = {
    "pico": 1e-12,
    "nano": 1e-9,
    "micro": 1e-6,
    "milli": 1e-3,
    "centi": 1e-2,
    "kilo": 1e3,
    "mega": 1e6,
    "giga": 1e9,
}
_KILO = ((1e3, 1),)
_TURN = ((2.0, 1), (math.pi, 1))
_RPM = (*_TURN, (60.0, -1))
# A pound has 7000 grains of 64.79891 mg, a yard 0.9144 m.
_POUND = ((7000.0, 1), (64.79891, 1), (1e-3, 1))
_OUNCE = ((0.0625, 1), *_POUND)
_GRAVITY = ((9.80665, 1),)

# Factors; powers of gram, metre, second, ampere, kelvin.
_UNITS: dict[str, tuple[Factors, tuple[int, ...]]] = {
    "dimensionless": ((), (0, 0, 0, 0, 0)),
    "percent": (((1e-2, 1),), (0, 0, 0, 0, 0)),
    "ppm": (((1e-6, 1),), (0, 0, 0, 0, 0)),
    "radian": ((), (0, 0, 0, 0, 0)),
    "degree": (((1.0 / 180.0, 1), (math.pi, 1)), (0, 0, 0, 0, 0)),
    "turn": (_TURN, (0, 0, 0, 0, 0)),
    "second": ((), (0, 0, 1, 0, 0)),
    "minute": (((60.0, 1),), (0, 0, 1, 0, 0)),
    "hour": (((60.0, 2),), (0, 0, 1, 0, 0)),
    "hertz": ((), (0, 0, -1, 0, 0)),
    "revolutions_per_minute": (_RPM, (0, 0, -1, 0, 0)),
    "krpm": ((*_KILO, *_RPM), (0, 0, -1, 0, 0)),
    "rps": (_TURN, (0, 0, -1, 0, 0)),
    "meter": ((), (0, 1, 0, 0, 0)),
    "inch": (((1.0 / 36.0, 1), (0.9144, 1)), (0, 1, 0, 0, 0)),
    "foot": (((1.0 / 3.0, 1), (0.9144, 1)), (0, 1, 0, 0, 0)),
    "gram": ((), (1, 0, 0, 0, 0)),
    "pound": (_POUND, (1, 0, 0, 0, 0)),
    "ounce": (_OUNCE, (1, 0, 0, 0, 0)),
    "newton": (_KILO, (1, 1, -2, 0, 0)),
    "force_gram": (_GRAVITY, (1, 1, -2, 0, 0)),
    "force_kilogram": ((*_GRAVITY, *_KILO), (1, 1, -2, 0, 0)),
    "force_pound": ((*_GRAVITY, *_POUND), (1, 1, -2, 0, 0)),
    "force_ounce": ((*_GRAVITY, *_OUNCE), (1, 1, -2, 0, 0)),
    "joule": (_KILO, (1, 2, -2, 0, 0)),
    "watt": (_KILO, (1, 2, -3, 0, 0)),
    "ampere": ((), (0, 0, 0, 1, 0)),
    "volt": (_KILO, (1, 2, -3, -1, 0)),
    "ohm": (_KILO, (1, 2, -3, -2, 0)),
    "weber": (_KILO, (1, 2, -2, -1, 0)),
    "henry": (_KILO, (1, 2, -2, -2, 0)),
    "farad": (((1e3, -1),), (-1, -2, 4, 2, 0)),
    "kelvin": ((), (0, 0, 0, 0, 1)),
    "degree_Celsius": ((), (0, 0, 0, 0, 1)),
}

ICE_POINT = 273.15  # 0 degC in K.


@cache
def powers_of(base: str) -> Powers:
    """Powers of the names in a product such as ``newton*meter**2/second``."""
    parts = re.findall(r"(/?)([a-zA-Z_]+)(?:\*\*(\d))?", base)
    return {name: (-1 if over else 1) * int(power or 1) for over, name, power in parts}


def dimension_of(powers: Powers) -> tuple[int, ...]:
    """Powers of gram, metre, second, ampere and kelvin."""
    found = [(_unit(name)[1], power) for name, power in powers.items()]
    return tuple(sum(of[k] * power for of, power in found) for k in range(5))


def factor_between(powers: Powers, base: Powers) -> float:
    """How many of ``base`` one of ``powers`` is, where both have one dimension."""
    ratio = dict(powers)
    for name, power in base.items():
        ratio[name] = ratio.get(name, 0) - power
    over: dict[float, int] = {}
    under: dict[float, int] = {}
    for name, power in ratio.items():
        for factor, times in _unit(name)[0]:
            side = under if times * power < 0 else over
            side[factor] = side.get(factor, 0) + abs(times * power)
    product = 1.0
    for side, other, sign in ((over, under, 1), (under, over, -1)):
        for factor, times in side.items():
            product *= factor ** (sign * max(0, times - other.get(factor, 0)))
    return product


@cache
def _unit(name: str) -> tuple[Factors, tuple[int, ...]]:
    if name in _UNITS:
        return _UNITS[name]
    prefix = next(prefix for prefix in _FACTOR if name.startswith(prefix))
    factors, dimension = _UNITS[name.removeprefix(prefix)]
    return ((_FACTOR[prefix], 1), *factors), dimension
