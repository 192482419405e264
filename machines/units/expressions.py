"""The grammar of units: from ``N m/(A s)``, ``min⁻¹`` or ``V per 1000 rpm`` to powers of
the names in full.

The reciprocal of a time that is written as such (``1/min``, ``min^-1``, ``min⁻¹``, ``per min``)
keeps a name of its own (``1/minute``): beside V it says "per revolution per minute", where the same
powers from ``V min`` would not.
"""

from __future__ import annotations

import re

from dqforge.machines.errors import InputError
from dqforge.machines.units.meaning import TEN, is_of, weighed
from dqforge.machines.units.registry import COMPOUNDS, SYMBOLS, TIMES, Dimension
from dqforge.machines.units.si_factors import Powers
from dqforge.machines.wording import close_matches, shown

_SUPERSCRIPT = str.maketrans("\u2070¹²³\u2074\u207a\u207b", "01234+-")

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
            exponent = int(self._peek()[1].strip("^*(){} ").translate(_SUPERSCRIPT))
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
    found = sorted((fitting or matches)[:2]) if len(alike) > 1 else (fitting or matches)[:2]
    hint = (
        f"did you mean {' or '.join(repr(m) for m in found)}?"
        if found
        else f"write e.g. '{wanted.example}'"
    )
    return (
        f"unknown unit {shown(symbol)}, expected {wanted.name} such as '{wanted.example}'; {hint}"
    )
