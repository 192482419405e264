"""Expressions of C: the numbers on which a step is run where its text is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.reports.c_code.numbers import float_literal

Origin = tuple[str, str]  # Names of a record and of its member.


class Expression:
    """A number of a step, as text.

    Args:
        text: In C.
        atom: Whether it needs no parentheses: a name, a literal, a call.
        reads: Members of the state that it takes.
        members: Members of other records that it takes.
        whole: The vector or array that it is a part of, empty of others.
        kind: Type in C.
        size: Numbers of that vector, 0 where that is not asked.

    Attributes:
        minus: What it is the negative of, None of others.
        opposite: Its negative where that is no longer than itself, else None.
    """

    __slots__ = (
        "atom", "kind", "members", "minus", "opposite", "reads", "size", "text", "uses", "whole",
    )  # fmt: skip

    def __init__(
        self,
        text: str,
        *,
        atom: bool = True,
        reads: frozenset[str] = frozenset(),
        members: frozenset[Origin] = frozenset(),
        whole: str = "",
        kind: str = "float",
        size: int = 0,
    ) -> None:
        self.text, self.atom, self.reads, self.members = text, atom, reads, members
        self.whole, self.kind, self.size = whole, kind, size
        self.minus: Expression | None = None
        self.opposite: Expression | None = None
        self.uses = [0]

    @property
    def is_name(self) -> bool:
        """Whether it may be written twice, since it computes nothing."""
        return self.atom and "(" not in self.text

    def marked(self, mark: str, *, whole: str = "") -> Expression:
        """The same member of a state, read at another time."""
        reads = frozenset({self.text + mark})
        return type(self)(self.text, reads=reads, whole=whole, kind=self.kind, size=self.size)

    def to(self, kind: str) -> Expression:  # noqa: ARG002
        """As it is written to a place of a type in C."""
        return self

    def bare(self) -> str:
        """Text where no parentheses are needed.

        Raises:
            ValueError: It would be computed a second time.
        """
        self.uses[0] += 1
        if self.uses[0] > 1 and not self.is_name:
            raise ValueError(f"{self.text} is used twice: name it by `let`")
        return self.text

    def operand(self, *, signed: bool = False) -> str:
        """Text within an operation; ``signed`` where a minus may stand before a name."""
        text = self.bare()
        return text if self.atom or (signed and text[0] == "-") else f"({text})"

    def scaled(self, share: float) -> Expression:
        """The product with a constant, which takes the sign of a negative."""
        text = self.operand()
        found, other = (
            joined(f"{expression(factor).text} * {text}", self) for factor in (share, -share)
        )
        found.opposite, other.minus, other.uses = other, found, found.uses
        return found

    def _with(self, sign: str, other: Any, *, swapped: bool = False) -> Expression:
        if isinstance(other, np.ndarray):
            return NotImplemented  # type: ignore[no-any-return]  # the array takes it apart
        own = expression(other, self.kind)
        parts = (own, self) if swapped else (self, own)
        return joined(f" {sign} ".join(part.operand() for part in parts), *parts)

    def __add__(self, other: Any) -> Expression:
        """The sum."""
        return self._with("+", other)

    def __radd__(self, other: Any) -> Expression:
        """The sum."""
        return self._with("+", other, swapped=True)

    def __sub__(self, other: Any) -> Expression:
        """The difference."""
        return self._with("-", other)

    def __rsub__(self, other: Any) -> Expression:
        """The difference."""
        return self._with("-", other, swapped=True)

    def __mul__(self, other: Any) -> Expression:
        """The product."""
        return self._with("*", other)

    def __rmul__(self, other: Any) -> Expression:
        """The product."""
        return self._with("*", other, swapped=True)

    def __truediv__(self, other: Any) -> Expression:
        """The quotient."""
        return self._with("/", other)

    def __rtruediv__(self, other: Any) -> Expression:
        """The quotient."""
        return self._with("/", other, swapped=True)

    def __floordiv__(self, other: Any) -> Expression:
        """The quotient of whole numbers from 0 on."""
        return self._with("/", other)

    def __mod__(self, other: Any) -> Expression:
        """The rest of a division of whole numbers from 0 on."""
        return self._with("%", other)

    def __xor__(self, other: Any) -> Expression:
        """The bits in which whole numbers from 0 on differ."""
        return self._with("^", other)

    def __neg__(self) -> Expression:
        """The negative."""
        return joined(f"-{self.operand()}", self)

    def negative(self) -> Expression:
        """The negative, which a sum subtracts; the negative of a negative is what it was."""
        if self.minus is not None or self.opposite is not None:
            return self.minus or self.opposite or self
        found = joined(f"-{self.text if self.atom else f'({self.text})'}", self)
        found.minus = self
        if not self.is_name:
            found.uses = self.uses
        return found

    def __lt__(self, other: Any) -> Condition:
        """Whether it is less."""
        return self._compared("<", other)

    def __le__(self, other: Any) -> Condition:
        """Whether it is not more."""
        return self._compared("<=", other)

    def __gt__(self, other: Any) -> Condition:
        """Whether it is more."""
        return self._compared(">", other)

    def __ge__(self, other: Any) -> Condition:
        """Whether it is not less."""
        return self._compared(">=", other)

    def _compared(self, sign: str, other: Any) -> Condition:
        parts = self, expression(other, self.kind)
        text = f" {sign} ".join(part.operand(signed=True) for part in parts)
        return Condition((joined(text, *parts),))


@dataclass(frozen=True, slots=True)
class Condition:
    """Comparisons all of which must hold; ``against`` is the text of what holds where they do not,
    empty where it is written with ``!``; ``ored`` is one that holds where one of others does.
    """

    terms: tuple[Expression, ...]
    against: str = ""
    ored: bool = False

    def __and__(self, other: Condition) -> Condition:
        """Both conditions."""
        return Condition(self.terms + other.terms)

    def __or__(self, other: Condition) -> Condition:
        """One of both conditions, or both."""
        terms = self.terms + other.terms
        left = self.text() if self.ored else self.operand()
        text = f"{left} || {other.operand()}"
        return Condition((joined(text, *terms, atom=False, kind="bool"),), ored=True)

    def __bool__(self) -> bool:
        """Nothing decides it here.

        Raises:
            TypeError: Always: what depends on a condition is chosen by the arithmetic.
        """
        raise TypeError("a step cannot branch on a number: use `choose` or `either`")

    def negated(self) -> Condition:
        """That it does not hold."""
        text = self.against or f"!{self.operand()}"
        atom = not self.against and text[1] != "("
        return Condition((joined(text, *self.terms, atom=atom, kind="bool"),))

    @property
    def is_name(self) -> bool:
        """Whether it is a name."""
        return len(self.terms) == 1 and self.terms[0].is_name

    def operand(self) -> str:
        """Text within another condition."""
        return self.terms[0].operand() if len(self.terms) == 1 else f"({self.text()})"

    def text(self) -> str:
        """What stands between the parentheses of ``if``."""
        if len(self.terms) == 1:
            return self.terms[0].bare()
        return " && ".join(term.operand() for term in self.terms)


# What stands behind the digits of an integer.
_SUFFIXES = {
    "long": "L",
    "uint32_t": "U",
    "uint64_t": "U",
    "unsigned int": "U",
    "int": "",
    "int32_t": "",
}


def expression(value: Any, kind: str = "float") -> Expression:
    """A number as an expression; constants become literals of a type."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, Condition):
        single = len(value.terms) == 1 and value.terms[0].atom
        return joined(value.text(), *value.terms, atom=single, kind="bool")
    if isinstance(value, bool):
        return Expression(str(value).lower(), kind="bool")
    if kind in _SUFFIXES:
        return Expression(f"{int(value)}{_SUFFIXES[kind]}", kind=kind)
    return Expression(float_literal(float(value)))


def joined(
    text: str, *parts: Expression, atom: bool = False, whole: str = "", kind: str = ""
) -> Expression:
    """An expression made of others, of their type unless another is given."""
    return Expression(
        text,
        atom=atom,
        reads=frozenset[str]().union(*(part.reads for part in parts)),
        members=frozenset[Origin]().union(*(part.members for part in parts)),
        whole=whole,
        kind=kind or (parts[-1].kind if parts else "float"),
    )


def equal(a: Any, b: Any) -> Condition:
    """Whether two whole numbers are the same."""
    own = a if isinstance(a, Expression) else b
    parts = expression(a, own.kind), expression(b, own.kind)
    texts = [part.operand() for part in parts]
    return Condition((joined(" == ".join(texts), *parts, kind="bool"),), " != ".join(texts))


def whole_kind(value: Any) -> str:
    """Type in C of a Python number."""
    whole = isinstance(value, int) and not isinstance(value, bool)
    return "int32_t" if whole else "float"


def name_of(name: str, kind: str) -> Any:
    """What a name stands for: a condition where it is one of ``bool``, else a number."""
    found = Expression(name, kind=kind)
    return Condition((found,)) if kind == "bool" else found


WIDTH = 110  # Of lines.


def folded(begin: str, text: str, end: str, indent: str) -> list[str]:
    """Lines of a statement, broken at operators and commas of the outermost parentheses.

    Args:
        begin, end: What stands before and behind the text.
        indent: White space of the first line.
    """
    if len(indent) + len(begin) + len(text) + len(end) <= WIDTH:
        return [f"{indent}{begin}{text}{end}"]
    further = indent + "    "
    lines, rest = [f"{indent}{begin.rstrip()}"], text + end
    while len(further) + len(rest) > WIDTH:
        place = _break(rest, WIDTH - len(further))
        if not place:
            break
        lines.append(further + rest[:place].rstrip())
        rest = rest[place:].lstrip()
    return [*lines, further + rest]


def _break(text: str, most: int) -> int:
    """Last place, no further than ``most``, behind a comma, else before an operator, of the
    outermost level that has one; 0 where there is none.
    """
    found: dict[tuple[int, bool], int] = {}
    depth = 0
    for at, sign in enumerate(text[: most + 1]):
        depth += (sign in "({[") - (sign in ")}]")
        behind = text[at - 1] == ","
        before = text[at + 1 : at + 3] in ("+ ", "- ", "* ", "/ ", "&&", "||", "? ", ": ")
        if at >= most // 4 and sign == " " and (before or behind):
            found[depth, not behind] = at
    return found[min(found)] if found else 0
