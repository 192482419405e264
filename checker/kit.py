"""What the programs of this folder share; the first thing to read of them.

It imports nothing but the standard library, and calculates in integers and fractions alone. Read it
from top to bottom: numbers (part 1), the header's text (part 2), and what is printed (part 3).
"""

from __future__ import annotations

import ast
import json
import operator
import re
from collections import Counter
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any


class Fault(Exception):
    """What is not confirmed, in words, with its place."""


# Part 1. Numbers: integers in units of 2^-BITS.

BITS = 160
ONE = 1 << BITS
Rows = list[list[int]]


def below(value: Fraction | int) -> int:
    """A rational in units, rounded down; it is off by less than one."""
    return (value.numerator << BITS) // value.denominator


def above(value: Fraction | int) -> int:
    """A rational in units, rounded up."""
    return -((-value.numerator << BITS) // value.denominator)


def times(x: int, y: int) -> int:
    """A product of numbers in units, rounded up."""
    return -(-x * y >> BITS)


def added(one: Rows, other: Rows) -> Rows:
    """A sum of matrices."""
    return [list(map(int.__add__, *pair)) for pair in zip(one, other)]


def single(value: Fraction) -> Fraction:
    """The nearest number of single precision, ties to even."""
    if value == 0:
        return value
    exponent = abs(value.numerator).bit_length() - value.denominator.bit_length()
    if Fraction(2) ** exponent > abs(value):
        exponent -= 1
    step = Fraction(2) ** max(exponent - 23, -149)
    return round(value / step) * step


def half_place(size: int) -> int:
    """What single precision takes off or adds to a result up to a size in units, at most.

    A fused multiply-add rounds once where two are allowed for here.
    """
    if size >= ONE << 127:
        raise Fault("a result may leave the range of single precision")
    return 1 << max(BITS - 150, size.bit_length() - 25)


# Part 2. The header's text: its comments, constants and functions.

NUMBER = re.compile(r"(?<![\w.])((?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)([Ff]?)(?![\w.])")


def number(text: str) -> Fraction:
    """A number of C; with F it is rounded to single precision."""
    found = NUMBER.fullmatch(text)
    if found is None:
        raise Fault(f"the header has '{text}' where a number is expected")
    return single(Fraction(found[1])) if found[2] else Fraction(found[1])


def comments(text: str) -> str:
    """What the comments say, in one line."""
    found = re.findall(r"/\*.*?\*/", text, re.S)
    return " ".join(re.sub(r"\s+\*?\s*", " ", comment) for comment in found)


def uncommented(text: str) -> str:
    """The C without comments, in the same lines."""
    blank = re.compile(r"[^\n]")
    return re.sub(r"/\*.*?\*/|//[^\n]*", lambda x: blank.sub(" ", x[0]), text, flags=re.S)


class Header:
    """Constants and functions of a header, and the words of all that belong to it."""

    def __init__(self, text: str, prefix: str, further: str = "") -> None:
        self.prefix, self.said, self.code = prefix, comments(text + further), uncommented(text)
        self.constants: dict[str, Fraction] = {}
        self.macros = Counter(re.findall(r"#\s*define\s+(\w+)", self.code))
        if re.search(r"#\s*undef", self.code):
            raise Fault("the header takes a macro back")
        pattern = rf"^\s*#\s*define\s+(\w+)\s+\((-?)({NUMBER.pattern})\)\s*$"
        for name, sign, value, *_ in re.findall(pattern, self.code, re.M):
            if self.macros[name] != 1:
                raise Fault(f"{name} is defined twice")
            self.constants[name] = -number(value) if sign else number(value)

    def constant(self, name: str) -> Fraction:
        """A constant by its name without the prefix."""
        full = f"{self.prefix.upper()}_{name}"
        if full not in self.constants:
            raise Fault(f"the header has no {full}")
        return self.constants[full]

    def same(self, stated: Any, name: str, place: str) -> Fraction:
        """A constant, which must be what is stated of it."""
        found = self.constant(name)
        if single(Fraction(stated)) != found:
            raise Fault(f"{place}: the header has another {name}")
        return found

    def function(self, name: str) -> str:
        """The body of a function, between its braces, in one line."""
        found = re.findall(rf"\b{self.prefix}_{name}\([^)]*\)\s*\{{\n(.*?)\n\}}", self.code, re.S)
        if len(found) != 1 or "#" in found[0]:
            raise Fault(f"the header has not one plain function {self.prefix}_{name}")
        if (set(self.macros) - set(self.constants)) & set(re.findall(r"\w+", found[0])):
            raise Fault(f"a macro changes words of {self.prefix}_{name}")
        return " ".join(found[0].split())


# The machine of a certificate, with the constants of the header that are the same.
MACHINE = {
    "pole_pairs": "POLE_PAIRS",
    "r_s_Ohm": "R_S_OHM",
    "l_d_H": "L_D_H",
    "l_q_H": "L_Q_H",
    "psi_pm_Wb": "PSI_PM_WB",
}


def read_machine(stated: dict[str, str], header: Header) -> dict[str, Fraction]:
    """The machine of the certificate, which must be that of the header."""
    for name, constant in MACHINE.items():
        header.same(stated[name], constant, f"machine, {name}")
    machine = {name: Fraction(stated[name]) for name in MACHINE}
    if min(machine[name] for name in MACHINE if name != "psi_pm_Wb") <= 0:
        raise Fault("machine: a parameter is not positive")
    if machine["psi_pm_Wb"] < 0 or machine["pole_pairs"].denominator != 1:
        raise Fault("machine: psi_pm is negative, or pole_pairs not whole")
    return machine


# Sums, products and conditions of C are written as in Python, whose parser takes them apart here.
OPERATORS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
}  # fmt: skip


@cache
def parsed(text: str) -> ast.expr:
    """An expression taken apart; its numbers become number('...')."""
    try:
        return ast.parse(NUMBER.sub(r"number('\1\2')", text.strip()), mode="eval").body
    except SyntaxError:
        raise Fault(f"the header's C is not understood: '{text[:40]}'") from None


def value(
    node: ast.expr,
    known: dict[str, Any],
    literal: Callable[[Fraction], Any],
    rounded: Callable[[Any], Any] = lambda x: x,
) -> Any:
    """An expression in numbers of any kind, by names and functions that are known; ``rounded`` is
    what is made of each sum, product and quotient.
    """
    match node:
        case ast.Name(id=name) if name in known:
            return known[name]
        case ast.Call(func=ast.Name(id="number"), args=[ast.Constant(value=str(text))]):
            return literal(number(text))
        case ast.Call(func=ast.Name(id=name), args=[inner]) if name in known:
            return known[name](value(inner, known, literal, rounded))
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -value(inner, known, literal, rounded)
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in OPERATORS:
            a, b = (value(each, known, literal, rounded) for each in (left, right))
            return rounded(OPERATORS[type(sign)](a, b))
    raise Fault(f"the header's C has what is not understood: {ast.unparse(node)[:60]}")


# Part 3. What is printed.


class Beside:
    """The files of a certificate's folder that begin with the same prefix."""

    def __init__(self, path: Path, suffix: str) -> None:
        self.folder, self.prefix = path.parent, path.name.removesuffix(suffix)

    def text(self, ending: str, missing: str | None = None) -> str:
        """The text of one of them; where there is none, what is taken for it."""
        path = self.folder / f"{self.prefix}{ending}"
        return path.read_text("utf-8") if missing is None or path.exists() else missing


def plain(text: str) -> Any:
    """A certificate: its decimal numbers are exact, and no member stands twice."""

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        if len(dict(pairs)) != len(pairs):
            raise Fault("the certificate has a member twice")
        return dict(pairs)

    return json.loads(text, parse_float=Fraction, object_pairs_hook=once)


def program(
    name: str, suffix: str, claims: Callable[[Any, Beside], Iterator[str]]
) -> Callable[[list[str]], int]:
    """The program that prints what is claimed of a certificate: first what is not covered, then
    each claim that is confirmed. It ends with 0, or 1 where one is not.
    """

    def main(arguments: list[str]) -> int:
        if len(arguments) != 1:
            print(f"write: {name}.py PREFIX{suffix}")
            return 2
        path, word = Path(arguments[0]), "not covered"
        try:
            for words in claims(plain(path.read_text("utf-8")), Beside(path, suffix)):
                print(f"{word}: {words}")
                word = "confirmed"
        except Fault as fault:
            print(f"not confirmed: {fault}")
            return 1
        except (
            LookupError, TypeError, ValueError, ArithmeticError, AttributeError, OSError,
        ) as fault:  # fmt: skip
            print(f"not confirmed: the certificate or the header is damaged ({fault!r})")
            return 1
        return 0

    return main
