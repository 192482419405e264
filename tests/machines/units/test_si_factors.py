"""The table of units against pint: the same dimensions, and the same float of every factor."""

from __future__ import annotations

import itertools
import random
from functools import cache
from typing import Any

import pint
import pytest

from dqforge.machines.units.quantities import parse_quantity
from dqforge.machines.units.registry import (
    COMPOUNDS,
    DIMENSIONS,
    FORCES,
    SYMBOLS,
    dimension_of,
    factor_between,
    powers_of,
)

NAMES = sorted({*SYMBOLS.values(), *FORCES.values(), *itertools.chain(*COMPOUNDS.values())})
BASES = sorted({dimension.base for dimension in DIMENSIONS.values()} - {"degree_Celsius"})
_DIMENSIONS = ("[mass]", "[length]", "[time]", "[current]", "[temperature]")


@cache
def registry() -> Any:
    known: Any = pint.UnitRegistry()
    known.define("krpm = 1000 * revolutions_per_minute")
    known.define("rps = 60 * revolutions_per_minute")
    return known


def unit(powers: dict[str, int]) -> Any:
    return registry().Unit(registry().UnitsContainer(powers))


def check(powers: dict[str, int]) -> int:
    """How many bases a unit was compared in."""
    powers = dict(sorted((name, power) for name, power in powers.items() if power))
    bases = [base for base in BASES if dimension_of(powers_of(base)) == dimension_of(powers)]
    for base in bases:
        expected = registry().Quantity(1.0, unit(powers)).to(base).magnitude
        assert factor_between(powers, powers_of(base)) == expected, (powers, base)
    return len(bases)


POWERS = (-4, -3, -2, -1, 1, 2, 3, 4)


def no_points() -> list[str]:
    """Names but that of a point on a scale, which takes part in products as kelvin does."""
    return [name for name in NAMES if name != "degree_Celsius"]


@pytest.mark.parametrize("name", [*NAMES, *BASES])
def test_dimensions(name: str) -> None:
    powers = powers_of(name)
    theirs = {} if name == "dimensionless" else unit(powers).dimensionality
    assert dimension_of(powers) == tuple(theirs.get(part, 0) for part in _DIMENSIONS)


def test_powers_of_every_name() -> None:
    compared = sum(check({name: power}) for name in no_points() for power in POWERS)
    assert compared > 200


def test_products_of_two_names() -> None:
    pairs = itertools.combinations(no_points(), 2)
    compared = sum(
        check({first: p, second: q})
        for first, second in pairs
        for p, q in ((1, 1), (1, -1), (1, 2))
    )
    assert compared > 700


@pytest.mark.parametrize("seed", range(3))
def test_products_that_have_the_dimension_of_a_key(seed: int) -> None:
    draw = random.Random(seed)
    names, compared = no_points(), 0
    for _ in range(400):
        base = draw.choice(BASES)
        powers = powers_of(base).copy()
        powers.pop("dimensionless", None)
        for _ in range(draw.randint(1, 3)):  # swap a name for another of its dimension, or cancel
            first = draw.choice(names)
            alike = [name for name in names if dimension_of({name: 1}) == dimension_of({first: 1})]
            power = draw.choice((-2, -1, 1, 2))
            for name, share in ((first, power), (draw.choice(alike), -power)):
                powers[name] = powers.get(name, 0) + share
        compared += check(powers) > 0
    assert compared == 400


@pytest.mark.parametrize("text", ["25 degC", "-40 °C", "298.15 K", "77 K", "300000 mK", "0 K"])
def test_points_on_a_scale_of_temperature(text: str) -> None:
    number, symbol = text.split()
    expected = registry().Quantity(float(number), unit({SYMBOLS[symbol]: 1})).to("degree_Celsius")
    assert parse_quantity(text, "temperature") == expected.magnitude
