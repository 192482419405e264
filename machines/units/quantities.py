"""Quantities with units: read strictly at the edge ("1.61 mH"), written for people ("1.61 mH").

Inside the program every number is in SI units; a bare number in an input file is SI. The text must
match a small grammar, and every symbol a fixed vocabulary, so nothing is ever evaluated.
"""

from __future__ import annotations

import math
import re
from functools import lru_cache

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.units.expressions import parse_unit
from dqforge.machines.units.kind_words import KindWords, kind_words, without_kind
from dqforge.machines.units.meaning import convert
from dqforge.machines.units.registry import COMPOUNDS, DIMENSIONS, SYMBOLS, Dimension
from dqforge.machines.wording import close_matches, shown

__all__ = [
    "Reading",
    "close_matches",
    "format_quantity",
    "kind_said",
    "parse_option",
    "parse_quantity",
    "read_quantity",
    "shown",
]


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

    A speed needs its unit there: what is typed in haste is rpm more often than rad/s.

    Raises:
        InputError: The text is no quantity of the dimension, or a speed without a unit; names the
            option.
    """
    if text is None:
        return None
    try:
        found = read_quantity(text, dimension)
    except InputError as error:
        raise InputError(f"{option}: {error.message}") from None
    if dimension == "speed" and found.bare:
        raise InputError(
            f"{option}: {shown(text)} has no unit; write '{found.text} rpm', or '{found.text} "
            f"rad/s' ({format_quantity(found.si, 'rpm')})"
        )
    return found.si


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
            f"{shown(text)}: {shown(words)} says of which kind the value is, and this one has no "
            f"kind; write {shown(plain)}"
        )
    plain = plain if words else text
    kind = kind_words(words) if words else None
    if not unit:
        return Reading(number, plain, bare=True, kind=kind)
    unit = wanted.aliases.get(unit.casefold(), unit)
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
