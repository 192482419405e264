"""Takes the C of headers apart, as far as it is emitted in integers, for `check_ranges.py`.

It imports nothing but the standard library and `kit.py` beside it. Names, signs and numbers
(`TOKEN`) become tuples: types with their members, constants, and functions with the statements of
their body. What it does not know it refuses, so that nothing is passed over.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or __package__:
    from . import kit
else:  # run alone: it lies beside this one
    import kit

Fault = kit.Fault
LIMITS = {
    f"{sign}int{bits}_t": (-(1 << bits - 1), (1 << bits - 1) - 1)
    if not sign
    else (0, (1 << bits) - 1)
    for sign in ("", "u")
    for bits in (8, 16, 32, 64)
}
TOKEN = re.compile(r"\w+|<<=|>>=|\+\+|--|->|<<|>>|[<>=!]=|&&|\|\||[-+*/%&|^]=|\S")
STRENGTH = {
    "||": 1, "&&": 2, "|": 3, "^": 4, "&": 5, "==": 6, "!=": 6, "<": 7, ">": 7, "<=": 7, ">=": 7,
    "<<": 8, ">>": 8, "+": 9, "-": 9, "*": 10, "/": 10, "%": 10,
}  # fmt: skip
SHIFT = "#if ((-1) >> 1) != (-1)\n#error "
Tree = tuple[Any, ...]


class Code:
    """Types, constants and functions of headers."""

    def __init__(self) -> None:
        # Members: type, name, and how many of each dimension of an array.
        self.types: dict[str, list[tuple[str, str, tuple[int, ...]]]] = {}
        self.constants: dict[str, Tree] = {}
        self.functions: dict[str, Tree] = {}  # type, parameters, body, line, header
        self.defined: set[str] = set()
        self.said: dict[str, str] = {}  # comments of each header
        self.tokens: list[tuple[str, int]] = []
        self.at, self.where = 0, ""

    def read(self, folder: Path, name: str) -> None:
        """Reads a header, those that it includes first."""
        if name in self.said:
            return
        text = (folder / name).read_text("utf-8")
        self.said[name], code = kit.comments(text), kit.uncommented(text)
        if SHIFT not in code:
            raise Fault(f"{name}: it does not check that right shifts keep the sign")
        kept, taken = [], [True]
        for line in code.split("\n"):
            match line.split() if line.lstrip().startswith("#") else []:
                case []:
                    kept.append(line if all(taken) else "")
                    continue
                case ["#ifndef", macro]:
                    taken.append(macro not in self.defined)
                case ["#ifdef", "__cplusplus"] | ["#if", "((-1)", ">>", "1)", "!=", "(-1)"]:
                    taken.append(False)
                case ["#endif"]:
                    taken.pop()
                case ["#error", *_] | ["#include", "<stdint.h>"]:
                    pass
                case ["#include", other]:
                    self.read(folder, other.strip('"'))
                case ["#define", macro, *_] if "(" not in macro:
                    self.defined |= {macro} if all(taken) else set()
                case _:
                    raise Fault(f"{name}: this program does not read '{line.strip()[:40]}'")
            kept.append("")
        self.where, self.at = name, 0
        lines = (x.replace("unsigned int ", "uint32_t ") for x in kept)  # int has 32 bits here
        self.tokens = [(x, row) for row, line in enumerate(lines, 1) for x in TOKEN.findall(line)]
        for text, row in self.tokens:
            if text in self.defined or not TOKEN.fullmatch(text) or text in "'\"\\#@`$":
                raise Fault(f"{name}, line {row}: '{text}' is not understood")
        self.tokens.append(("", len(kept)))
        while self.next():
            self.declared()

    # What comes next, and what must come next.

    def next(self, ahead: int = 0) -> str:
        return self.tokens[min(self.at + ahead, len(self.tokens) - 1)][0]

    def take(self, wanted: str = "") -> str:
        text, row = self.tokens[self.at]
        if not text or (wanted and text != wanted):
            raise Fault(f"{self.where}, line {row}: '{text}' is not understood")
        self.at += 1
        return text

    def skip(self, *words: str) -> bool:
        found = self.next() in words
        self.at += found
        return found

    def until(self, end: str, item: Callable[[], Any]) -> list[Any]:
        """Items up to a sign, with or without commas between them."""
        found = []
        while not self.skip(end):
            found.append(item())
            self.skip(",")
        return found

    def size(self) -> tuple[int, ...]:
        """How many entries an array has in each dimension; none of what is no array."""
        found: list[int] = []
        while self.skip("["):
            found.append(int(self.take().rstrip("U")))
            self.take("]")
        return tuple(found)

    def is_type(self, ahead: int = 0) -> bool:
        return self.next(ahead) in LIMITS or self.next(ahead) in self.types

    def declared(self) -> None:
        """A type, a constant or a function."""
        row = self.tokens[self.at][1]
        table: dict[str, Any]
        value: Any
        if self.skip("typedef"):
            self.take("struct")
            self.take("{")
            value = self.until("}", self.member)
            table, name = self.types, self.take()
            self.take(";")
        else:
            self.take("static")
            self.skip("inline")
            self.skip("const")
            start, kind, name = self.at, self.take(), self.take()
            if self.skip("("):
                self.own: set[str] = set()
                parameters = self.until(")", self.parameter)
                table, value = self.functions, (kind, parameters, self.block(), row, self.where)
            else:
                self.at, self.own = start, set()
                table, value = self.constants, self.local(row)
        if name in table:
            raise Fault(f"{self.where}, line {row}: {name} is declared twice")
        table[name] = value

    def member(self) -> tuple[str, str, tuple[int, ...]]:
        self.skip("const")
        if not self.is_type():
            self.take("a type")
        kind, pointer = self.take(), self.skip("*")
        if pointer and kind in LIMITS:
            self.take("a record")
        found = kind, self.take(), self.size()
        self.take(";")
        return found

    def parameter(self) -> tuple[str, str, bool]:
        self.skip("const")
        kind, pointer = self.take(), self.skip("*")
        self.own.add(self.next())
        name, array = self.take(), bool(self.size())
        return kind, name, pointer or array

    def local(self, row: int) -> Tree:
        """A declaration: type, name, size of an array, value, whether a pointer, and a constant."""
        constant = self.skip("static")
        self.skip("const")
        kind, pointer, name, many = self.take(), self.skip("*"), self.take(), self.size()
        if name in self.own:
            raise Fault(f"{self.where}, line {row}: {name} is declared twice")
        self.own.add(name)
        value = self.listed() if self.skip("=") else None
        self.take(";")
        return ("local", row, kind, name, many, value, pointer, constant)

    def listed(self) -> Tree:
        """A value, or a list of them in braces."""
        return ("list", self.until("}", self.listed)) if self.skip("{") else self.expression()

    def block(self) -> Tree:
        before = set(self.own)  # a name may stand again in another block, not within one
        self.take("{")
        found = ("block", self.until("}", self.statement))
        self.own = before
        return found

    def statement(self) -> Tree:
        row = self.tokens[self.at][1]
        if self.next() in ("static", "const") or self.is_type():
            return self.local(row)
        if self.skip("for"):
            self.take("(")
            first, condition = self.statement(), self.expression()
            self.take(";")
            after = self.changed(row)
            self.take(")")
            return ("block", [first, ("while", row, condition, ("block", [self.block(), after]))])
        if self.next() in ("if", "while"):
            word, condition, body = self.take(), self.expression(), self.block()
            if word == "while" or not self.skip("else"):
                return (word, row, condition, body, ("block", []))
            return (
                word,
                row,
                condition,
                body,
                self.statement() if self.next() == "if" else self.block(),
            )
        found = ("return", row, self.expression()) if self.skip("return") else self.changed(row)
        self.take(";")
        return found

    def changed(self, row: int) -> Tree:
        """An assignment, a count up or down, or a call."""
        if self.next() == "(":  # that a value is not used
            for word in ("(", "void", ")"):
                self.take(word)
            return ("do", row, self.expression())
        ahead = self.take() if self.next() in ("++", "--") else ""
        place = self.expression()
        sign = ahead or self.next()
        if sign in ("++", "--"):
            self.at += not ahead
            return ("set", row, place, ("two", sign[0], place, ("number", 1, "int32_t")))
        if self.skip("="):
            return ("set", row, place, self.expression())
        if sign[:-1] in STRENGTH and sign not in STRENGTH:
            self.at += 1
            return ("set", row, place, ("two", sign[:-1], place, self.expression()))
        return ("do", row, place)

    def expression(self, least: int = 0) -> Tree:
        found = self.unary()
        while STRENGTH.get(self.next(), 0) > least:
            sign = self.take()
            found = ("two", sign, found, self.expression(STRENGTH[sign]))
        if least == 0 and self.skip("?"):
            first = self.expression()
            self.take(":")
            return ("choice", found, first, self.expression())
        return found

    def unary(self) -> Tree:
        text = self.take()
        found: Tree
        if text in ("-", "!", "&"):
            return ("one", text, self.unary())
        if text == "(" and self.is_type():
            kind = self.take()
            self.take(")")
            return ("cast", kind, self.unary())
        if text == "(":
            found = self.expression()
            self.take(")")
        elif text == "INT64_C":
            self.take("(")
            value = int(("-" if self.skip("-") else "") + self.take())
            self.take(")")
            return ("number", value, "int64_t")
        elif text[0].isdigit():
            sign = "u" if text.endswith("U") else ""
            value = int(text.rstrip("U"))
            fits = value <= LIMITS[f"{sign}int32_t"][1]
            return ("number", value, f"{sign}int{32 if fits else 64}_t")
        else:
            found = ("name", text)
        while self.next() in ("(", "[", ".", "->"):
            sign = self.take()
            if sign == "(":
                found = ("call", found[1], self.until(")", self.expression))
            elif sign == "[":
                found = ("index", found, self.expression())
                self.take("]")
            else:
                found = ("member", found, self.take())
        return found


@cache
def common(*kinds: str) -> str:
    """The type in which C calculates with types: of 32 bits or more, the widest, unsigned first."""
    sizes = {kind: int(kind.strip("uint_")) for kind in kinds}
    wide = {kind if size >= 32 else "int32_t": max(size, 32) for kind, size in sizes.items()}
    return max(wide, key=lambda kind: (wide[kind], kind[0] == "u"))
