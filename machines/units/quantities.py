"""Quantities with units: read strictly at the edge ("1.61 mH"), written for people ("1.61 mH").

Inside the program every number is in SI units; a bare number in an input file is SI. The text must
match a small grammar, and every symbol a fixed vocabulary, so nothing is ever evaluated.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal
from functools import cache, lru_cache

from dqforge.machines.errors import InputError, close_matches, shown
from dqforge.machines.records import dataclass
from dqforge.machines.units.registry import (
    ANGULAR,
    COMPOUNDS,
    CYCLIC,
    DIMENSIONS,
    FORCES,
    ICE_POINT,
    LONG_TIMES,
    SYMBOLS,
    TIMES,
    USUAL_UNITS,
    Dimension,
    KindWords,
    Powers,
    dimension_of,
    factor_between,
    kind_words,
    powers_of,
    without_kind,
)

MAX_LENGTH = 60


_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?")


# 2.1 x 10^-5, 2.1·10⁻⁵; without a sign of power the exponent needs its own: x 10-5.
_TEN = re.compile(
    r"\s*[xX\N{MULTIPLICATION SIGN}*·⋅]\s*10(?:\s*(?:\^|\*\*)\s*[({]?([+-]?[0-9]{1,2})[)}]?"
    r"|([\u207a\u207b]?[\u2070¹²³\u2074-\u2079]{1,2})|([+-][0-9]{1,2}))(?![0-9])"
)


_SUPERSCRIPT = str.maketrans(
    "\u2070¹²³\u2074\u2075\u2076\u2077\u2078\u2079\u207a\u207b", "0123456789+-"
)


_COMMA = re.compile(r"[+-]?[0-9]+(?:[.,][0-9]+)*,[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?")


_DASHES = str.maketrans(
    dict.fromkeys("\N{MINUS SIGN}\N{EN DASH}\N{HYPHEN}\N{NON-BREAKING HYPHEN}", "-")
)


# What a person measures: 12.3 V at 500 rpm, 0.42 N m @ 10 A.
_MEASURED = re.compile(r"(?P<of>.+?)\s*(?:@|\bat\b)\s*(?P<at>[+-]?[.0-9].*)", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Reading:
    """A quantity as it was read: `si` in the dimension's unit, and how it came about.

    `bare` says that the text had no unit, `inverted` that the reciprocal was given ("190 rpm/V"),
    and `remark` what a unit was taken for that leaves it open ("0.04 V/Hz"). `kind` is what the
    text says of its kind ("12 Vrms/krpm"), and `text` then the rest of it.
    """

    si: float
    text: str
    bare: bool = False
    inverted: bool = False
    remark: str = ""
    kind: KindWords | None = None


def parse_quantity(value: str | float, dimension: str) -> float:
    """Value of a quantity in the SI unit of a dimension.

    Args:
        value: A number in SI units, or text such as ``1.61 mH``.
        dimension: A key of `dqforge.machines.units.registry.DIMENSIONS`.

    Raises:
        InputError: Without a position: the number or the unit is not understood, has another
            dimension, or is not finite.
    """
    return read_quantity(value, dimension).si


def parse_option(text: str | None, dimension: str, option: str) -> float | None:
    """SI value of an option of the command line, None where it was not given.

    What has a unit needs it there: what is typed in haste is mH more often than H.

    Raises:
        InputError: The text is no quantity of the dimension, or has no unit; names the option.
    """
    if text is None:
        return None
    try:
        refuse_bare(text, dimension)
        return read_quantity(text, dimension).si
    except InputError as error:
        raise InputError(f"{option}: {error.message}") from None


def refuse_bare(text: str, dimension: str, *, kinds: bool = False) -> None:
    """Refuse a number whose unit is left out, with the usual ones; zero is zero in all but those of
    a temperature.

    Raises:
        InputError: The text has no unit and its dimension has some, or it is no quantity.
    """
    found = read_quantity(text, dimension, kinds=kinds)
    wanted = DIMENSIONS[dimension]
    nothing = found.si == 0.0 and dimension != "temperature"
    if not found.bare or not wanted.unit or nothing:
        return
    behind = f" {found.kind.text}" if found.kind is not None else ""
    written = [f"'{found.text} {unit}{behind}'" for unit in _meant(found.text, dimension)]
    raise InputError(f"{shown(text.strip())} has no unit; write {' or '.join(written)}")


def _meant(number: str, dimension: str) -> list[str]:
    """At most two units with which a number is one of a drive; that of its dimension where it is
    none with any.
    """
    units, low, high = USUAL_UNITS.get(dimension, ((DIMENSIONS[dimension].unit,), 0.0, math.inf))
    sizes = {unit: abs(parse_quantity(f"{number} {unit}", dimension)) for unit in units}
    return [unit for unit, size in sizes.items() if low <= size <= high][:2] or [units[-1]]


def read_quantity(value: str | float, dimension: str, *, kinds: bool = False) -> Reading:
    """Like `parse_quantity`, with the text and how it was read.

    With ``kinds`` the text may say of which kind the value is, ``12 Vrms/krpm line-to-line``.
    """
    wanted = DIMENSIONS[dimension]
    if not isinstance(value, str):
        return Reading(_finite(value, wanted), str(value), bare=True)
    return _read_text(value.strip().translate(_DASHES), dimension, kinds)


def kind_said(text: str) -> str:
    """The words of a quantity that say of which kind it is, whatever its dimension; empty where
    there are none, or where the text is no quantity.
    """
    for name, dimension in DIMENSIONS.items():
        try:
            found = read_quantity(text, name, kinds=True) if dimension.places else None
        except InputError:
            continue
        if found is not None and found.kind is not None and not found.bare:
            return found.kind.text
    return ""


@lru_cache(maxsize=4096)
def _read_text(text: str, dimension: str, kinds: bool) -> Reading:
    """The same for a text; rows of a study say most of theirs again and again."""
    wanted = DIMENSIONS[dimension]
    measured = _MEASURED.fullmatch(text)
    number, plain, unit, words = (
        _number_and_unit(text, wanted)
        if measured is None
        else _quotient(measured["of"], measured["at"], wanted)
    )
    if words and not kinds:
        raise InputError(
            f"{shown(text)}: {shown(words)} states the kind of the value, and this one has no "
            f"kind; write {shown(plain)}"
        )
    plain = plain if words else text
    kind = kind_words(words) if words else None
    if not unit:
        return Reading(number, plain, bare=True, kind=kind)
    unit = wanted.aliases.get(unit) or wanted.aliases.get(unit.casefold(), unit)
    found = convert(number, parse_unit(unit, wanted), wanted, text)
    return Reading(
        _finite(found.si, wanted),
        plain,
        inverted=found.inverted,
        remark=found.remark,
        kind=kind,
    )


def _number_and_unit(text: str, wanted: Dimension) -> tuple[float, str, str, str]:
    """Number, text without the words of kinds, unit, and those words."""
    number, length = _number(text, wanted)
    unit, words = without_kind(text[length:].strip())
    return number, f"{text[:length]} {unit}".strip(), unit, words


def _quotient(of: str, at: str, wanted: Dimension) -> tuple[float, str, str, str]:
    """The same of what was measured at something, as their quotient: 12.3 V at 500 rpm."""
    number, plain, unit, words = _number_and_unit(of, wanted)
    divisor, by, per, more = _number_and_unit(at, wanted)
    if not unit or not per or divisor == 0.0:
        raise InputError(
            f"{shown(f'{of} at {at}')}: both numbers need a unit, and the second is not zero; "
            f"write {wanted.name} such as '{wanted.example}'"
        )
    said = " ".join(filter(None, (words, more)))
    return number / divisor, f"{plain} at {by}", f"{unit}/({per})", said


def _finite(number: float, wanted: Dimension) -> float:
    try:
        converted = float(number)
    except OverflowError:
        converted = math.inf
    if not math.isfinite(converted):
        raise InputError(
            f"the number is not finite; write {wanted.name} such as '{wanted.example}'"
        )
    return converted


def _number(text: str, wanted: Dimension) -> tuple[float, int]:
    """The number that a quantity begins with, and how many characters it has."""
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
    number, end = match.group(), match.end()
    power = _TEN.match(text, end)
    if power is not None and "e" not in number.lower():
        exponent = next(part for part in power.groups() if part)
        number, end = f"{number}e{exponent.translate(_SUPERSCRIPT)}", power.end()
    plain, *tolerance = re.split(r"±|\+/-", text)
    if tolerance:
        raise InputError(
            f"{shown(text)} has a tolerance; write {shown(plain.strip())}, and how far it may be "
            "off under control.tolerances"
        )
    return _finite(float(number), wanted), end


def _refuse_comma(text: str) -> None:
    """Raise with the number written as it must be when it has a comma.

    A comma may separate thousands or decimals, and guessing wrong is a factor of 1000,
    so none is accepted.
    """
    match = _COMMA.match(text)
    if match is None:
        return
    number, rest = match.group(), text[match.end() :]
    if number.rfind(".") > number.rfind(",") or number.count(",") > 1:
        raise InputError(
            f"{shown(text)} has separators of thousands; write {number.replace(',', '')}{rest}"
        )
    decimal = number.replace(".", "").replace(",", ".") + rest
    if re.fullmatch(r"[+-]?[1-9][0-9]{0,2},[0-9]{3}", number):
        plain = number.replace(",", "") + rest
        raise InputError(
            f"{shown(text)} has a comma; write {plain}, or {decimal} if it is a decimal comma"
        )
    raise InputError(f"{shown(text)} has a decimal comma; write {decimal}")


# Units for people that are not the program's own: value in SI times this.
_OUTPUT_SCALE = {"rpm": 30.0 / math.pi, "deg": 180.0 / math.pi, "%": 100.0}


# Written without prefix below 1 by custom: 0.06 Wb, 0.47 N m.
_PLAIN_FROM = {"Wb": 0.01, "N m": 0.01}


_PREFIXED = frozenset({"Ohm", "H", "F", "Wb", "V", "A", "Hz", "s", "W", "J", "N m"})


_OUTPUT_PREFIXES = (
    (1e9, "G"),
    (1e6, "M"),
    (1e3, "k"),
    (1.0, ""),
    (1e-3, "m"),
    (1e-6, "u"),
    (1e-9, "n"),
    (1e-12, "p"),
)


_ROUNDING = 1e-9  # Percent that are nothing but rounding.


def signed_percent(value: float) -> str:
    """A relative change in percent with its sign and three digits; what is rounding alone is 0."""
    percent = 100.0 * value
    return "0 %" if abs(percent) < _ROUNDING else f"{percent:+.3g} %"


def signed_hundredths(percent: float) -> str:
    """A change in percent with its sign and two decimals, 0 where these are noughts."""
    text = f"{percent:+.2f}"
    return "0" if text in {"+0.00", "-0.00"} else text


def half_digit(value: float, digits: int) -> float:
    """Half of the last of the significant digits of a printed number: how far the number before
    rounding may lie from it. Of a printed 0 these are places behind the point.
    """
    if value == 0.0:
        return 0.5 * 10.0**-digits
    return 0.5 * 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)


def format_quantity(value: float, unit: str, digits: int = 5) -> str:
    """Text of an SI value for people, with a prefix where that is customary.

    Args:
        value: In SI units; rad/s for ``rpm``, rad for ``deg``, 1 for ``%``, degree Celsius for
            ``degC``.
        unit: Unit to print; empty for a plain number.
        digits: Significant digits, trailing zeros are not printed.

    Examples:
        >>> format_quantity(0.00161, "H") '1.61 mH'
    """
    scaled = float(f"{value * _OUTPUT_SCALE.get(unit, 1.0):.{digits}g}")
    scale, prefix = _prefix(abs(scaled), unit)
    scaled /= scale
    # Python writes 1e+06 from the digits-th power of ten on; a plain number
    # reads better up to a million.
    text = f"{scaled:.0f}" if 10.0**digits <= abs(scaled) < 1e7 else f"{scaled:.{digits}g}"
    text = "0" if text == "-0" else text
    return f"{text} {prefix}{unit}".rstrip()


def to_digits(value: float, digits: int, *, up: bool) -> float:
    """A positive number to so many digits, not below (``up``) or not above what it was."""
    step = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    whole = math.ceil(value / step - 1e-9) if up else math.floor(value / step + 1e-9)
    return float(f"{whole * step:.{digits}g}")


def _prefix(size: float, unit: str) -> tuple[float, str]:
    """Scale and letter of the prefix for a positive value, (1, "") where none is customary."""
    if (
        unit not in _PREFIXED
        or size == 0.0
        or not math.isfinite(size)
        or _PLAIN_FROM.get(unit, 1.0) <= size < 1e3
    ):
        return 1.0, ""
    # Nobody writes kiloseconds; the smallest prefix also serves whatever is smaller.
    choices = [choice for choice in _OUTPUT_PREFIXES if unit != "s" or choice[0] <= 1.0]
    return next((choice for choice in choices if size >= choice[0] * (1.0 - 1e-12)), choices[-1])


# What a unit means for a dimension: its SI value, the angles that it counts,
# and what it is refused for.
#
# Of its dimension an angle is a number. Whether 3000 1/min are revolutions, radians or cycles is
# therefore decided here: by the angles that the unit names, and where it names none by the
# dimension (`Dimension.unnamed`).

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
    turned = _turned_round(number, reciprocal, wanted)
    raise InputError(got + (turned or _what_it_is(tuple(powers.items()), wanted.name)))


def _turned_round(number: float, reciprocal: Powers, wanted: Dimension) -> str:
    """What to write where the unit stands on its head: V/rpm of a Kv."""
    if wanted.reciprocal or not is_of(reciprocal, wanted):
        return ""
    same = math.isclose(_factor_of(_key(_library(reciprocal)), wanted.base), 1.0)
    return f"; write '{number:g} {wanted.unit}'" if same else ""


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


# The grammar of units: from ``N m/(A s)``, ``min⁻¹`` or ``V per 1000 rpm`` to powers of
# the names in full.
#
# The reciprocal of a time that is written as such (``1/min``, ``min^-1``, ``min⁻¹``, ``per min``)
# keeps a name of its own (``1/minute``): beside V it says "per revolution per minute", where the
# same powers from ``V min`` would not.

_EXPRESSIONS_SUPERSCRIPT = str.maketrans("\u2070¹²³\u2074\u207a\u207b", "01234+-")

_TOKEN = re.compile(
    r"\s*(?:(?P<symbol>°C|[A-Za-zµμΩ\N{OHM SIGN}](?:[A-Za-z_µμΩ\N{OHM SIGN}])*|[°%])"
    r"(?P<glued>(?:-?[1-4](?![0-9]))?)"
    r"|(?P<exponent>(?:\^|\*\*)\s*(?:[+-]?[1-4](?![0-9])|\([+-]?[1-4]\)|\{[+-]?[1-4]\})|[\u207a\u207b]?[¹²³\u2074])"
    r"|(?P<number>10*)(?![0-9])"
    r"|(?P<operator>[*·⋅/()]|-(?=\s*[A-Za-zµμΩ\N{OHM SIGN}])))"
)

_TIMES_SIGNS = ("*", "·", "⋅", "-")

# What data sheets write, and what it is in full.
_ABBREVIATED = (
    (re.compile(r"\br\.\s?p\.\s?m\.?", re.IGNORECASE), "rpm"),
    (re.compile(r"(?<=[A-Za-zµμΩ])\."), " "),  # N.m, oz.-in.
    (re.compile(r"(?<![0-9])1,000(?![0-9,])"), "1000"),
    # What is per rad/s or per 1000 U/min names a speed: per radian and second there is nothing.
    (
        re.compile(
            r"(/|\bper\b)\s*((?:1000\s*)?(?:rad|rev|tr|[Ur])\s*/\s*(?:s|sec|min)"
            r"|1000\s+1\s*/\s*(?:s|sec|min))(?![A-Za-z0-9^*\u207b-])"
        ),
        r"\1(\2)",
    ),
)

Token = tuple[str, str]


def parse_unit(unit: str, wanted: Dimension) -> Powers:
    """Powers of the names in full in a unit expression, reciprocals of times and
    powers of ten named apart.

    Raises:
        InputError: The text is no unit expression, holds an unknown symbol, or can be read in two
            ways.
    """
    return weighed(_Parser(unit, wanted).powers(), wanted)


def _tokens(unit: str, wanted: Dimension) -> list[Token]:
    """Kinds and texts of a unit expression's parts.

    ``per`` divides, and as the first word divides one.
    """
    tokens: list[Token] = []
    for pattern, full in _ABBREVIATED:
        unit = pattern.sub(full, unit)
    unit, position = unit.strip(), 0
    while position < len(unit):
        match = _TOKEN.match(unit, position)
        if match is None or match.lastgroup is None:
            raise InputError(
                f"{shown(unit)} is not a unit ({shown(unit[position:].strip())} is not "
                f"understood); expected {wanted.name} such as '{wanted.example}'"
            )
        if match["symbol"] == "per" and not match["glued"]:
            tokens += [("operator", "/")] if tokens else [("number", "1"), ("operator", "/")]
        elif match["symbol"]:
            tokens.append(("symbol", match["symbol"]))
            if match["glued"]:
                tokens.append(("exponent", match["glued"]))
        else:
            tokens.append((match.lastgroup, match.group().strip()))
        position = match.end()
    return tokens


class _Parser:
    """Recursive descent over the tokens of one unit expression."""

    def __init__(self, unit: str, wanted: Dimension) -> None:
        self.unit, self.wanted = unit, wanted
        self.tokens = _tokens(unit, wanted)
        self.index = 0

    def powers(self) -> Powers:
        """Powers of the whole expression."""
        total = self._product()
        if self.index != len(self.tokens):
            raise InputError(f"the unit {shown(self.unit)} has a ')' without its '('")
        return total

    def _peek(self, ahead: int = 0) -> Token:
        place = self.index + ahead
        return self.tokens[place] if place < len(self.tokens) else ("end", "")

    def _product(self, *, nested: bool = False) -> Powers:
        """Powers of a product of factors, up to the end or a closing parenthesis."""
        total: Powers = {}
        sign, divided, expect_factor = 1, False, True
        scaled = nested  # V/(1000 rpm): a parenthesis may begin with a power of ten
        while self._peek()[1] not in ("", ")"):
            token = self._peek()[1]
            if token == "/" or token in _TIMES_SIGNS:
                if expect_factor or (divided and token != "/"):
                    raise self._trouble(divided=divided and not expect_factor)
                sign, divided, expect_factor = (
                    (-1, True, True) if token == "/" else (1, divided, True)
                )
                self.index += 1
                continue
            if divided and not expect_factor:
                raise self._trouble(divided=True)
            factor, reciprocal = self._term(scaled=scaled or sign < 0)
            scaled = False
            divided |= reciprocal
            for name, power in factor.items():
                total[name] = total.get(name, 0) + sign * power
            sign, expect_factor = 1, False
        if expect_factor:
            raise self._trouble(divided=False)
        return {name: power for name, power in total.items() if power}

    def _term(self, *, scaled: bool) -> tuple[Powers, bool]:
        """A factor, a reciprocal ``1/min``, or where it may be scaled ``1000 rpm``.

        Whether it was a reciprocal.
        """
        group, token = self._peek()
        if group != "number":
            return self._factor(), False
        self.index += 1
        if self._peek()[0] == "exponent":
            raise self._trouble(divided=False)
        if scaled and len(token) > 1:
            inner, _ = self._term(scaled=False)
            inner[TEN] = inner.get(TEN, 0) + len(token) - 1
            return inner, False
        if token != "1" or self._peek()[1] != "/":
            raise self._trouble(divided=False)
        self.index += 1
        if self._peek()[0] not in ("symbol", "operator") or self._peek()[1] in (
            "/",
            ")",
            *_TIMES_SIGNS,
        ):
            raise self._trouble(divided=False)
        return _reciprocal(self._factor()), True

    def _factor(self) -> Powers:
        """Powers of one symbol or parenthesis with its exponent."""
        group, token = self._peek()
        self.index += 1
        if token == "(":
            base = self._product(nested=True)
            if self._peek()[1] != ")":
                raise InputError(f"the unit {shown(self.unit)} has a '(' without its ')'")
            self.index += 1
            last = list(base)
        elif group == "symbol":
            names = _names(token, self.wanted)
            base, last = dict.fromkeys(names, 1), [names[-1]]
        else:
            raise self._trouble(divided=False)
        if self._peek()[0] == "exponent":
            exponent = int(self._peek()[1].strip("^*(){} ").translate(_EXPRESSIONS_SUPERSCRIPT))
            self.index += 1
            if exponent == -1 and last == list(base):
                return _reciprocal(base)
            base |= {name: base[name] * exponent for name in last}
        return base

    def _trouble(self, *, divided: bool) -> InputError:
        if divided:
            head, _, tail = self.unit.partition("/")
            tail = " ".join(re.split(r"[\s*·⋅]+", tail.strip()))
            return InputError(
                f"the unit {shown(self.unit)} can be read in two ways; write {head}/({tail}) with "
                "parentheses"
            )
        return InputError(f"the unit {shown(self.unit)} is not complete; write it like N m/(A s)")


def _reciprocal(powers: Powers) -> Powers:
    """Reciprocal of a factor; that of a lone time has a name of its own, which undoes itself."""
    if len(powers) == 1:
        ((name, power),) = powers.items()
        if power == 1 and name in TIMES:
            return {f"1/{name}": 1}
    return {name: -power for name, power in powers.items()}


def _names(symbol: str, wanted: Dimension) -> tuple[str, ...]:
    if symbol in SYMBOLS:
        return (SYMBOLS[symbol],)
    if symbol in COMPOUNDS:
        return COMPOUNDS[symbol]
    raise InputError(_unknown(symbol, wanted))


def _unknown(symbol: str, wanted: Dimension) -> str:
    # Suggestions that give the wanted dimension come first; MOHM may be milli or mega.
    alike = {
        name: m
        for m, name in reversed(SYMBOLS.items())
        if m.casefold() == symbol.casefold() and len(symbol) > 1
    }
    matches = close_matches(symbol, [*SYMBOLS, *COMPOUNDS], limit=8)
    matches = list(alike.values()) if len(alike) > 1 else matches
    fitting = [m for m in matches if m in SYMBOLS and is_of({SYMBOLS[m]: 1}, wanted)]
    # Of a quantity with one unit what does not fit is no help: LB of a current.
    kept = fitting if wanted.base.isalpha() else fitting or matches
    found = sorted(kept[:2]) if len(alike) > 1 else kept[:2]
    hint = f"; did you mean {' or '.join(repr(m) for m in found)}?" if found else ""
    return f"unknown unit {shown(symbol)}, expected {wanted.name} such as '{wanted.example}'{hint}"
