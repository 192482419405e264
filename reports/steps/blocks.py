"""Statements of a function in C, in the order of their text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from dqforge.reports.c_code.numbers import comment_text
from dqforge.reports.steps.record_text import LINE
from dqforge.reports.steps.symbols import Origin, folded

_T = TypeVar("_T")


@dataclass(slots=True)
class Block:
    """Statements of a function in the order of their text; ``names`` are taken in it, ``inside``
    in the blocks of its loops, and ``declared`` lines stand before the first statement that is no
    declaration, None without one; ``remarks`` wait for the next one; ``fixed`` lines, those of
    constants, stand before all others.
    """

    indent: str
    names: set[str]
    lines: list[str] = field(default_factory=list)
    declared: int | None = None
    inside: set[str] = field(default_factory=set)
    fixed: int = 0
    remarks: list[str] = field(default_factory=list)

    def inner(self) -> Block:
        """A block in it."""
        return Block(self.indent + "    ", set(self.names))

    def take(self, name: str) -> None:
        """Take a name.

        Raises:
            ValueError: It is taken.
        """
        if name in self.names | self.inside:
            raise ValueError(f"there is a {name} already")
        self.names.add(name)

    def add(self, begin: str, text: str, meaning: str = "") -> None:
        """A statement, with a comment behind or above it."""
        found = folded(begin, text, ";", self.indent)
        if meaning:
            said = f"/* {comment_text(meaning)} */"
            if len(found) == 1 and len(found[0]) + len(said) < LINE:
                found[0] += f" {said}"
            else:
                found.insert(0, f"{self.indent}{said}")
        self.lines += [*self._remarked(), *found]

    def _remarked(self) -> list[str]:
        found, self.remarks = self.remarks, []
        return found

    def close(self) -> None:
        """Nothing comes behind a remark."""
        if self.remarks:
            self.work([])
            self.lines += self._remarked()

    def variable(self, kind: str, name: str) -> None:
        """Declare what statements will give its value, before all of them."""
        if self.declared is None:
            self.lines.append(f"{self.indent}{kind} {name};")
        else:
            self.lines.insert(self.declared, f"{self.indent}{kind} {name};")
            self.declared += 1

    def constants(self, lines: Sequence[str]) -> None:
        """Declarations before all others."""
        self.lines[self.fixed : self.fixed] = lines
        self.fixed += len(lines)
        if self.declared is not None:
            self.declared += len(lines)

    def first(self, lines: Sequence[str]) -> None:
        """Statements before all others."""
        if lines:
            self.work([])
            place = (self.declared or 0) + bool(self.lines)
            self.lines[place:place] = lines

    def work(self, lines: Sequence[str]) -> None:
        """Statements that are no declarations."""
        if self.declared is None:
            self.declared = len(self.lines)
            self.lines += [""] if self.lines else []
        if lines:
            self.lines += [*self._remarked(), *lines]


@dataclass(slots=True)
class Functions:
    """What steps have needed so far: ``texts`` and ``results`` of functions, by name, and which
    members of their arguments they change, ``members`` of records, and ``vectors`` that are
    declared nowhere else. A function with a result and no text stands elsewhere; those of
    ``filled`` put the numbers of such a vector through pointers. ``kinds`` are
    the types of results that are no ``float``, ``names`` those in C of functions that have others,
    and ``constants`` records with their addresses, and the members through which they are reached.
    """

    texts: dict[str, str] = field(default_factory=dict)
    results: dict[str, type[Any] | None] = field(default_factory=dict)
    changes: dict[str, list[frozenset[str]]] = field(default_factory=dict)
    members: set[Origin] = field(default_factory=set)
    vectors: dict[str, type[Any]] = field(default_factory=dict)
    filled: dict[str, type[Any]] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    constants: list[tuple[Any, str, frozenset[Origin]]] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Arm(Generic[_T]):
    """One of the branches of a statement: the lines that begin it, what it computes, whether a
    break ends it, and whether it is ``dropped`` where it is empty.
    """

    head: list[str]
    branch: Callable[[], _T]
    breaks: bool = False
    dropped: bool = False

    def text(self, body: Block) -> list[str]:
        """Its lines with those of its block."""
        body.close()
        if self.dropped and not body.lines:
            return []
        if not self.breaks:
            return [*self.head, *body.lines]
        end = [f"{body.indent}break;"]
        if body.declared == 0 or not body.lines:
            return [*self.head, *body.lines, *end]
        *above, label = self.head
        return [*above, f"{label} {{", *body.lines, *end, f"{body.indent[4:]}}}"]
