"""Quantities with units: read strictly at the edge ("1.61 mH"), written for people ("1.61 mH").

Inside the program every number is in SI units; a bare number in an input file is SI. The text must match a small
grammar, and every symbol a fixed vocabulary, before the unit library sees any of it, so nothing is ever evaluated.
"""

from __future__ import annotations

import difflib
import importlib
import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from typing import TYPE_CHECKING

from dqforge.machines.errors import InputError
from dqforge.machines.units import COMPOUNDS, DIMENSIONS, SYMBOLS, Dimension

if TYPE_CHECKING:
    from pint import UnitRegistry

    Registry = UnitRegistry[float]

MAX_LENGTH = 60
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")
_COMMA = re.compile(r"[+-]?[0-9]+(?:[.,][0-9]+)*,[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?")
_TOKEN = re.compile(
    r"\s*(?:(?P<symbol>°C|[A-Za-zµμΩ\N{OHM SIGN}]+|[°%])(?P<glued>[2-4]?(?![0-9]))"
    r"|(?P<exponent>(?:\^|\*\*)\s*[+-]?[1-4](?![0-9])|[²³])"
    r"|(?P<one>1)(?![0-9])"
    r"|(?P<operator>[*·⋅/()]))"
)
_SUPERSCRIPTS = {"²": 2, "³": 3}

Powers = dict[str, int]


@dataclass(frozen=True, slots=True)
class Reading:
    """A quantity as it was read: `si` in the dimension's unit, and how it came about.

    `bare` says that the text had no unit, `inverted` that the reciprocal was given ("190 rpm/V").
    """

    si: float
    text: str
    bare: bool = False
    inverted: bool = False


def shown(value: object) -> str:
    """Text of an input value for an error message: quoted, one line, printable, at most 40 characters."""
    text = str(value)
    text = text if len(text) <= 40 else text[:37] + "..."
    return "'" + "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text) + "'"


def close_matches(word: str, candidates: Iterable[str], limit: int = 2) -> list[str]:
    """Candidates that `word` may have been meant to be, best first.

    A candidate that differs in upper and lower case alone leaves no doubt, and is then the only one.
    """
    known = list(candidates)
    folded = [c for c in known if c.casefold() == word.casefold()]
    if folded:
        return [max(folded, key=lambda c: sum(a == b for a, b in zip(c, word, strict=False)))]
    return difflib.get_close_matches(word, known, n=limit, cutoff=0.6)


def parse_quantity(value: str | float, dimension: str) -> float:
    """Value of a quantity in the SI unit of a dimension.

    Parameters
    ----------
    value:
        A number in SI units, or text such as ``1.61 mH``.
    dimension:
        A key of `dqforge.machines.units.DIMENSIONS`.

    Raises
    ------
    InputError
        Without a position: the number or the unit is not understood, has another dimension, or is not finite.
    """
    return read_quantity(value, dimension).si


def parse_option(text: str | None, dimension: str, option: str) -> float | None:
    """SI value of an option of the command line, None where it was not given.

    Raises
    ------
    InputError
        The text is no quantity of the dimension; names the option.
    """
    if text is None:
        return None
    try:
        return parse_quantity(text, dimension)
    except InputError as error:
        raise InputError(f"{option}: {error.message}") from None


def read_quantity(value: str | float, dimension: str) -> Reading:
    """Like `parse_quantity`, with the text and how it was read."""
    wanted = DIMENSIONS[dimension]
    if not isinstance(value, str):
        return Reading(_finite(value, wanted), str(value), bare=True)
    text = value.strip().replace("\N{MINUS SIGN}", "-")
    number, unit = _split(text, wanted)
    if not unit:
        return Reading(number, text, bare=True)
    powers = _parse_unit(unit, wanted)
    si, inverted = _convert(number, powers, wanted, text)
    return Reading(_finite(si, wanted), text, inverted=inverted)


def _finite(number: float, wanted: Dimension) -> float:
    try:
        converted = float(number)
    except OverflowError:
        converted = math.inf
    if not math.isfinite(converted):
        raise InputError(f"the number is not finite; write {wanted.name} such as '{wanted.example}'")
    return converted


def _split(text: str, wanted: Dimension) -> tuple[float, str]:
    """Number and unit text of a quantity; the unit is empty for a bare number."""
    example = f"write {wanted.name} such as '{wanted.example}'"
    if len(text) > MAX_LENGTH:
        raise InputError(f"{shown(text)} is too long for a quantity; {example}")
    _refuse_comma(text)
    match = _NUMBER.match(text)
    if match is None:
        if re.match(r"[+-]?\.?(inf|nan)", text, re.IGNORECASE):
            raise InputError(f"{shown(text)} is not a finite number; {example}")
        if text.partition(" ")[0] in SYMBOLS | COMPOUNDS:
            raise InputError(f"{shown(text)} has a unit but no number; {example}")
        raise InputError(f"{shown(text)} is not a number with a unit; {example}")
    return _finite(float(match.group()), wanted), text[match.end() :].strip()


def _refuse_comma(text: str) -> None:
    """Raise with the number written as it must be when it has a comma.

    A comma may separate thousands or decimals, and guessing wrong is a factor of 1000, so none is accepted.
    """
    match = _COMMA.match(text)
    if match is None:
        return
    number, rest = match.group(), text[match.end() :]
    if number.rfind(".") > number.rfind(",") or number.count(",") > 1:
        raise InputError(f"{shown(text)} has separators of thousands; write {number.replace(',', '')}{rest}")
    decimal = number.replace(".", "").replace(",", ".") + rest
    if re.fullmatch(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}", number):
        plain = number.replace(",", "") + rest
        raise InputError(f"{shown(text)} has a comma; write {plain}, or {decimal} if it is a decimal comma")
    raise InputError(f"{shown(text)} has a decimal comma; write {decimal}")


def _parse_unit(unit: str, wanted: Dimension) -> Powers:
    """Powers of the unit library's names in a unit expression such as ``N m/(A s)``."""
    tokens: list[tuple[str, str]] = []
    position = 0
    while position < len(unit):
        match = _TOKEN.match(unit, position)
        if match is None or match.lastgroup is None:
            raise InputError(
                f"{shown(unit)} is not a unit ({shown(unit[position:].strip())} is not understood); "
                f"expected {wanted.name} such as '{wanted.example}'"
            )
        if match["symbol"]:
            tokens.append(("symbol", match["symbol"]))
            if match["glued"]:
                tokens.append(("exponent", match["glued"]))
        else:
            tokens.append((match.lastgroup, match.group().strip()))
        position = match.end()
    powers, used = _product(tokens, 0, unit, wanted)
    if used != len(tokens):
        raise InputError(f"the unit {shown(unit)} has a ')' without its '('")
    return powers


def _product(tokens: list[tuple[str, str]], start: int, unit: str, wanted: Dimension) -> tuple[Powers, int]:
    """Powers of a product of factors from token `start` on, and the index of the first token behind it."""
    total: Powers = {}
    index, sign, divided = start, 1, False
    expect_factor = True
    while index < len(tokens) and tokens[index][1] != ")":
        token = tokens[index][1]
        if token in ("*", "·", "⋅", "/"):
            if expect_factor or (divided and token != "/"):
                raise InputError(_unit_trouble(unit, divided=divided and not expect_factor))
            sign, divided, expect_factor = (-1, True, True) if token == "/" else (1, divided, True)
            index += 1
            continue
        if divided and not expect_factor:
            raise InputError(_unit_trouble(unit, divided=True))
        factor, index = _factor(tokens, index, unit, wanted)
        for name, power in factor.items():
            total[name] = total.get(name, 0) + sign * power
        sign, expect_factor = 1, False
    if expect_factor:
        raise InputError(_unit_trouble(unit, divided=False))
    return {name: power for name, power in total.items() if power}, index


def _unit_trouble(unit: str, *, divided: bool) -> str:
    if divided:
        head, _, tail = unit.partition("/")
        tail = " ".join(re.split(r"[\s*·⋅]+", tail.strip()))
        return f"the unit {shown(unit)} can be read in two ways; write {head}/({tail}) with parentheses"
    return f"the unit {shown(unit)} is not complete; write it like N m/(A s)"


def _factor(tokens: list[tuple[str, str]], index: int, unit: str, wanted: Dimension) -> tuple[Powers, int]:
    """Powers of one symbol or parenthesis with its exponent, and the index of the first token behind it."""
    group, token = tokens[index]
    index += 1
    if token == "(":
        base, index = _product(tokens, index, unit, wanted)
        if index == len(tokens):
            raise InputError(f"the unit {shown(unit)} has a '(' without its ')'")
        index += 1
        last = list(base)
    elif group == "symbol":
        names = _names(token, wanted)
        base, last = dict.fromkeys(names, 1), [names[-1]]
    elif group == "one":
        base, last = {}, []
    else:
        raise InputError(_unit_trouble(unit, divided=False))
    if index < len(tokens) and tokens[index][0] == "exponent":
        text = tokens[index][1]
        exponent = _SUPERSCRIPTS.get(text) or int(text.lstrip("^*"))
        base |= {name: base[name] * exponent for name in last}
        index += 1
    return base, index


def _names(symbol: str, wanted: Dimension) -> tuple[str, ...]:
    if symbol in SYMBOLS:
        return (SYMBOLS[symbol],)
    if symbol in COMPOUNDS:
        return COMPOUNDS[symbol]
    # Suggestions that give the wanted dimension come first.
    matches = close_matches(symbol, [*SYMBOLS, *COMPOUNDS], limit=8)
    fitting = [m for m in matches if m in SYMBOLS and _has_dimension({SYMBOLS[m]: 1}, wanted)]
    found = (fitting or matches)[:2]
    hint = f"did you mean {' or '.join(repr(m) for m in found)}?" if found else f"write e.g. '{wanted.example}'"
    raise InputError(f"unknown unit {shown(symbol)}, expected {wanted.name} such as '{wanted.example}'; {hint}")


@cache
def _registry() -> Registry:
    """Build the unit library's registry on first use, because that takes a third of a second."""
    registry: Registry = importlib.import_module("pint").UnitRegistry()
    registry.define("krpm = 1000 * revolutions_per_minute")
    return registry


def _in_library(powers: Powers) -> Powers:
    """Powers with differences of temperature in kelvin: only a lone degC is a point on a scale."""
    if powers == {"degree_Celsius": 1} or "degree_Celsius" not in powers:
        return powers
    rest = {name: power for name, power in powers.items() if name != "degree_Celsius"}
    power = powers["degree_Celsius"] + rest.pop("kelvin", 0)
    return rest | ({"kelvin": power} if power else {})


def _has_dimension(powers: Powers, dimension: Dimension) -> bool:
    registry = _registry()
    unit = registry.Unit(registry.UnitsContainer(_in_library(powers)))
    return bool(unit.dimensionality == registry.Unit(dimension.base).dimensionality)


def _convert(number: float, powers: Powers, wanted: Dimension, text: str) -> tuple[float, bool]:
    """Value in the wanted unit, and whether the reciprocal was given."""
    if _has_dimension(powers, wanted):
        if not wanted.forbidden.isdisjoint(powers):
            raise InputError(f"expected {wanted.name} such as '{wanted.example}', got {shown(text)}; {wanted.reason}")
        # "hertz" alone counts cycles, "1/s" does not: the unit library takes both for the same.
        cycles = 2.0 * math.pi if wanted.cycles and any("hertz" in name for name in powers) else 1.0
        return cycles * _scaled(number, powers, wanted), False
    reciprocal = {name: -power for name, power in powers.items()}
    if wanted.reciprocal and number != 0.0 and _has_dimension(reciprocal, wanted):
        return _convert(1.0 / number, reciprocal, wanted, text)[0], True
    raise InputError(
        f"expected {wanted.name} such as '{wanted.example}', got {shown(text)}{_what_it_is(powers, wanted)}"
    )


def _scaled(number: float, powers: Powers, wanted: Dimension) -> float:
    """Value in the wanted unit; decimal prefixes give the float that the digits would give ("36 mH" is 0.036)."""
    registry = _registry()
    unit = registry.Unit(registry.UnitsContainer(_in_library(powers)))
    if powers != {"degree_Celsius": 1} and wanted.base != "degree_Celsius":
        factor = float(registry.Quantity(1.0, unit).to(wanted.base).magnitude)
        exponent = round(math.log10(factor))
        if math.isclose(factor, 10.0**exponent, rel_tol=1e-12):
            return float(Decimal(repr(number)).scaleb(exponent))
    return float(registry.Quantity(number, unit).to(wanted.base).magnitude)


def _what_it_is(powers: Powers, wanted: Dimension) -> str:
    for dimension in DIMENSIONS.values():
        if dimension is not wanted and dimension.forbidden.isdisjoint(powers) and _has_dimension(powers, dimension):
            return f" which is {dimension.name}"
    return ""


# Units for people that are not the program's own: value in SI times this.
_OUTPUT_SCALE = {"rpm": 30.0 / math.pi, "deg": 180.0 / math.pi, "%": 100.0}
# Written without prefix below 1 by custom: 0.06 Wb, 0.47 N m.
_PLAIN_FROM = {"Wb": 0.01, "N m": 0.01}
_PREFIXED = frozenset({"Ohm", "H", "Wb", "V", "A", "Hz", "s", "W", "J", "N m"})
_OUTPUT_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "u"), (1e-9, "n"), (1e-12, "p"))


def format_quantity(value: float, unit: str, digits: int = 5) -> str:
    """Text of an SI value for people, with a prefix where that is customary.

    Parameters
    ----------
    value:
        In SI units; rad/s for ``rpm``, rad for ``deg``, 1 for ``%``, degree Celsius for ``degC``.
    unit:
        Unit to print; empty for a plain number.
    digits:
        Significant digits, trailing zeros are not printed.

    Examples
    --------
    >>> format_quantity(0.00161, "H")
    '1.61 mH'
    """
    scaled = float(f"{value * _OUTPUT_SCALE.get(unit, 1.0):.{digits}g}")
    scale, prefix = _prefix(abs(scaled), unit)
    scaled /= scale
    # Python writes 1e+06 from the digits-th power of ten on; a plain number reads better up to a million.
    text = f"{scaled:.0f}" if 10.0**digits <= abs(scaled) < 1e7 else f"{scaled:.{digits}g}"
    text = "0" if text == "-0" else text
    return f"{text} {prefix}{unit}".rstrip()


def _prefix(size: float, unit: str) -> tuple[float, str]:
    """Scale and letter of the prefix for a positive value, (1, "") where none is customary."""
    if unit not in _PREFIXED or size == 0.0 or not math.isfinite(size) or _PLAIN_FROM.get(unit, 1.0) <= size < 1e3:
        return 1.0, ""
    # Nobody writes kiloseconds; the smallest prefix also serves whatever is smaller.
    choices = [choice for choice in _OUTPUT_PREFIXES if unit != "s" or choice[0] <= 1.0]
    return next((choice for choice in choices if size >= choice[0] * (1.0 - 1e-12)), choices[-1])
