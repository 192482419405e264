"""Plain arithmetic of C, evaluated without running anything: numbers, operators, casts, and
functions that the caller names.

Bounded in length and depth; whatever is no arithmetic has no value.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping, Sequence

from dqforge.machines.records import dataclass

Number = float | int
Functions = Mapping[str, Callable[..., float]]

MOST_TOKENS = 2_000


_MOST_DEPTH = 40


_LARGEST_INTEGER = 2**64


TOKEN = re.compile(
    r"""\s*(?:(?P<number>(?:0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[a-zA-Z]*)
        |(?P<name>[A-Za-z_]\w*)
        |(?P<sign><<|>>|<=|>=|==|!=|&&|\|\||[-+*/%()<>!~&|^?:,]))""",
    re.VERBOSE | re.ASCII,
)


_LITERAL = re.compile(
    r"(0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)([uUlLfF]{0,3})", re.ASCII
)


_INTEGER_TYPES = {"int", "long", "short", "char", "unsigned", "signed", "bool", "_Bool"}


_FLOAT_TYPES = {"float", "double", "float_t", "float32_t", "float64_t"}


_SIZED = re.compile(r"u?int(?:8|16|32|64)_t", re.ASCII)


class NotArithmeticError(ValueError):
    """Something in an expression is no arithmetic; the message says what."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """What a name that nothing is known of stands for: itself."""

    name: str


Value = Number | Unknown


def tokens_of(text: str) -> list[str]:
    """Numbers, names and signs of an expression; raises `NotArithmeticError` at anything else."""
    found: list[str] = []
    place, stripped = 0, text.rstrip()
    while place < len(stripped):
        match = TOKEN.match(stripped, place)
        if match is None or len(found) >= MOST_TOKENS:
            raise NotArithmeticError(stripped[place : place + 20])
        found.append(match[0].strip())
        place = match.end()
    return found


def evaluated(tokens: Sequence[str], functions: Functions) -> Value:
    """Value of an expression; raises `NotArithmeticError` where it has none."""
    reader = _Reader(list(tokens), functions)
    value = reader.choice(0)
    if reader.place < len(reader.tokens):
        raise NotArithmeticError(reader.tokens[reader.place])
    return value


def literal(token: str) -> Number:
    """Value of a number with its suffix; raises `NotArithmeticError` of anything else."""
    found = _LITERAL.fullmatch(token)
    if found is None or len(token) > 60:
        raise NotArithmeticError(token[:60])
    digits, suffix = found.groups()
    if digits[:2] in ("0x", "0X"):
        return int(digits, 16)
    if digits.isdigit() and "f" not in suffix.lower():
        octal = digits.startswith("0") and set(digits) <= set("01234567")
        return int(digits, 8) if octal else int(digits)
    return _finite(float(digits))


def _finite(value: Number) -> Number:
    if isinstance(value, int):
        if abs(value) > _LARGEST_INTEGER:
            raise NotArithmeticError("a number beyond 64 bits")
        return value
    if not math.isfinite(value):
        raise NotArithmeticError("a number that is not finite")
    return value


def _divided(a: Number, b: Number) -> Number:
    if b == 0:
        raise NotArithmeticError("a division by zero")
    if isinstance(a, int) and isinstance(b, int):
        size = abs(a) // abs(b)
        return size if (a < 0) == (b < 0) else -size
    return a / b


def _rest(a: Number, b: Number) -> Number:
    return _whole(a) - _whole(b) * _whole(_divided(_whole(a), _whole(b)))


def _whole(value: Number) -> int:
    if not isinstance(value, int):
        raise NotArithmeticError("bits of a number with a point")
    return value


def _shifted(a: Number, b: Number) -> Number:
    by = _whole(b)
    if not 0 <= by < 64:
        raise NotArithmeticError("a shift by 64 or more")
    return _whole(a) << by


def _shifted_down(a: Number, b: Number) -> Number:
    by = _whole(b)
    if not 0 <= by < 64:
        raise NotArithmeticError("a shift by 64 or more")
    return _whole(a) >> by


_LEVELS: tuple[dict[str, Callable[[Number, Number], Number]], ...] = (
    {"||": lambda a, b: int(bool(a) or bool(b))},
    {"&&": lambda a, b: int(bool(a) and bool(b))},
    {"|": lambda a, b: _whole(a) | _whole(b)},
    {"^": lambda a, b: _whole(a) ^ _whole(b)},
    {"&": lambda a, b: _whole(a) & _whole(b)},
    {"==": lambda a, b: int(a == b), "!=": lambda a, b: int(a != b)},
    {
        "<": lambda a, b: int(a < b),
        ">": lambda a, b: int(a > b),
        "<=": lambda a, b: int(a <= b),
        ">=": lambda a, b: int(a >= b),
    },
    {"<<": _shifted, ">>": _shifted_down},
    {"+": operator.add, "-": operator.sub},
    {"*": operator.mul, "/": _divided, "%": _rest},
)


class _Reader:
    """One pass over the tokens of an expression."""

    def __init__(self, tokens: list[str], functions: Functions) -> None:
        self.tokens, self.functions, self.place = tokens, functions, 0

    def next(self) -> str:
        """The token to come, "" at the end."""
        return self.tokens[self.place] if self.place < len(self.tokens) else ""

    def take(self, wanted: str = "") -> str:
        """The token to come, which is left behind."""
        token = self.next()
        if not token or (wanted and token != wanted):
            raise NotArithmeticError(token or "the end")
        self.place += 1
        return token

    def choice(self, depth: int) -> Value:
        """``a ? b : c`` or anything simpler."""
        if depth > _MOST_DEPTH:
            raise NotArithmeticError("brackets nested too deeply")
        condition = self.level(0, depth)
        if self.next() != "?":
            return condition
        self.take()
        first = self.choice(depth + 1)
        self.take(":")
        second = self.choice(depth + 1)
        return first if _number(condition) else second

    def level(self, level: int, depth: int) -> Value:
        """Operands of operators of one level and above."""
        if level == len(_LEVELS):
            return self.signed(depth)
        left = self.level(level + 1, depth)
        while self.next() in _LEVELS[level]:
            sign = self.take()
            right = self.level(level + 1, depth)
            left = _combined(sign, left, right, _LEVELS[level][sign])
        return left

    def signed(self, depth: int) -> Value:
        """An operand behind its signs."""
        if depth > _MOST_DEPTH:
            raise NotArithmeticError("signs nested too deeply")
        sign = self.next()
        if sign in ("-", "+", "!", "~") and sign:
            self.take()
            value = _number(self.signed(depth + 1))
            if sign == "!":
                return int(not value)
            return ~_whole(value) if sign == "~" else -value if sign == "-" else value
        return self.operand(depth)

    def operand(self, depth: int) -> Value:
        """A number, a name, a call, a cast, or something in brackets."""
        token = self.take()
        if token == "(":
            cast = self.cast()
            if cast is not None:
                return _converted(cast, _number(self.signed(depth + 1)))
            value = self.choice(depth + 1)
            self.take(")")
            return value
        if token[0].isdigit() or token[0] == ".":
            return literal(token)
        if not (token[0].isalpha() or token[0] == "_"):
            raise NotArithmeticError(token)
        return self.call(token, depth) if self.next() == "(" else Unknown(token)

    def cast(self) -> str | None:
        """The type of a cast whose opening bracket has been taken, None where it is none."""
        place, words = self.place, []
        while place < len(self.tokens) and _is_type(self.tokens[place]):
            words.append(self.tokens[place])
            place += 1
        if not words or place >= len(self.tokens) or self.tokens[place] != ")":
            return None
        self.place = place + 1
        return words[-1]

    def call(self, name: str, depth: int) -> Value:
        """A call of a function that the caller knows."""
        function = self.functions.get(name)
        if function is None:
            raise NotArithmeticError(f"{name}(...)")
        self.take("(")
        arguments = [_number(self.choice(depth + 1))]
        while self.next() == ",":
            self.take()
            arguments.append(_number(self.choice(depth + 1)))
        self.take(")")
        try:
            return _finite(function(*arguments))
        except (ArithmeticError, TypeError, ValueError) as error:
            raise NotArithmeticError(f"{name}(...)") from error


def _is_type(token: str) -> bool:
    return token in _INTEGER_TYPES or token in _FLOAT_TYPES or bool(_SIZED.fullmatch(token))


def _converted(kind: str, value: Number) -> Number:
    return float(value) if kind in _FLOAT_TYPES else int(value)


def _number(value: Value) -> Number:
    if isinstance(value, Unknown):
        raise NotArithmeticError(value.name)
    return value


def _combined(
    sign: str, left: Value, right: Value, rule: Callable[[Number, Number], Number]
) -> Number:
    """Two operands; unknown names are equal to themselves alone."""
    if isinstance(left, Unknown) and isinstance(right, Unknown) and sign in ("==", "!="):
        return int((left.name == right.name) == (sign == "=="))
    try:
        return _finite(rule(_number(left), _number(right)))
    except ArithmeticError as error:
        raise NotArithmeticError("a number that is too large") from error
