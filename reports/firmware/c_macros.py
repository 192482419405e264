"""C headers of others, read without a compiler: macros and assignments with their lines and
values, and other values put where theirs stand.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from itertools import accumulate
from typing import NoReturn

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.machines.wording import shown
from dqforge.reports.firmware.c_arithmetic import (
    MOST_TOKENS,
    Functions,
    NotArithmeticError,
    Number,
    Unknown,
    evaluated,
    tokens_of,
)
from dqforge.reports.firmware.text_file import IN_RANGE, in_range

MOST_DEFINITIONS = 20_000


_MOST_DEPTH = 64


_PASSED = re.compile(
    r"""//[^\n]*|/\*.*?(?:\*/|\Z)|"(?:\\.|[^"\\\n])*+"?|'(?:\\.|[^'\\\n])*+'?""", re.DOTALL
)


_WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*", re.ASCII)


_DIRECTIVE = re.compile(r"^[ \t]*#[ \t]*([a-z]+)\b[ \t]*([^\n]*)$", re.MULTILINE | re.ASCII)


_DEFINED = re.compile(r"([A-Za-z_]\w*)(\([^)\n]*\))?[ \t]*", re.ASCII)


_ASKED = re.compile(r"\bdefined\s*(?:\(\s*([A-Za-z_]\w*)\s*\)|([A-Za-z_]\w*))", re.ASCII)


_ASSIGNED = re.compile(
    r"(?<![\w.\]])(?<!->)([A-Za-z_]\w*(?:(?:->|\.)[A-Za-z_]\w*|\[\d{1,6}\]){0,40})"
    r"[ \t]*=(?!=)[ \t\n]*([^;{}=\n][^;{}=]*+);",
    re.ASCII,
)


@dataclass(frozen=True, slots=True)
class Definition:
    """One ``#define`` (or assignment): name, text behind it without comments, one-based line,
    place of the text in the file, and whether the conditions around it let it count.
    """

    name: str
    text: str
    line: int
    start: int
    end: int
    taken: bool = True
    function: bool = False


@dataclass(frozen=True, slots=True)
class Macros:
    """The macros of a header, or its assignments, by name; of several of one name the last counts.

    ``every`` has those that conditions leave out, too.
    """

    source: str
    every: tuple[Definition, ...]
    functions: Functions = field(default_factory=dict)
    by_name: Mapping[str, Definition] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        """Whether a macro of this name counts."""
        return name in self.by_name

    def __iter__(self) -> Iterator[str]:
        """Names in the order of the file."""
        return iter(self.by_name)

    def text(self, name: str) -> str | None:
        """Text of a macro without comments, None where there is none."""
        found = self.by_name.get(name)
        return None if found is None else found.text

    def line(self, name: str) -> int | None:
        """One-based line of a macro."""
        found = self.by_name.get(name)
        return None if found is None else found.line

    def value(self, name: str) -> Number | None:
        """Value of a macro, None where there is none or it is no arithmetic."""
        found = self.by_name.get(name)
        return None if found is None else self.value_of(found)

    def value_of(self, definition: Definition) -> Number | None:
        """Value of one definition, which may be one that conditions leave out."""
        try:
            value = evaluated(_expanded(definition.text, self), self.functions)
        except NotArithmeticError:
            return None
        return None if isinstance(value, Unknown) else value

    def number(self, name: str) -> float | None:
        """Value of a macro, None where there is none of this name.

        Raises:
            InputError: It is there and no number; with its line.
        """
        if name not in self.by_name:
            return None
        value = self.value(name)
        if value is None:
            self.refuse(name, f"is {shown(self.text(name))}, not a number; write one")
        if not in_range(value):
            self.refuse(name, f"is beyond every firmware's range; {IN_RANGE}")
        return float(value)

    def needed(self, name: str) -> float:
        """Value of a macro; raises InputError as `number`, and where there is none."""
        value = self.number(name)
        if value is None:
            message = f"{name} is missing; write '#define {name}' and a number"
            raise InputError(message, source=self.source)
        return value

    def whole(self, name: str) -> int | None:
        """Value of a macro as a whole number; raises InputError as `number`."""
        value = self.number(name)
        if value is not None and (not value.is_integer() or abs(value) > 2**53):
            self.refuse(name, f"is {value:g}; write a whole number")
        return None if value is None else int(value)

    def refuse(self, name: str, complaint: str) -> NoReturn:
        """Raise InputError on a macro, with its line."""
        raise InputError(f"{name} {complaint}", source=self.source, line=self.line(name))


def read_macros(
    text: str,
    source: str,
    functions: Functions | None = None,
    known: Mapping[str, str] | None = None,
) -> Macros:
    """Macros of a header.

    Conditions are worked out as C does from what the file defines above them; a name that it does
    not define equals itself alone. Where that leaves a condition open, its first branch counts.

    Args:
        text: With line feeds at the ends of lines.
        source: Its file, for messages.
        functions: What wraps such as ``FRAC16(x)`` make of their arguments, by name.
        known: Texts of macros that are defined elsewhere.

    Raises:
        InputError: A comment is not closed, a condition has no end, or there are too many macros.
    """
    plain, lines = without_comments(text, source), _Lines(text)
    found = Macros(source, (), functions or {}, {})
    names = dict(found.by_name) | {
        name: Definition(name, value, 0, 0, 0) for name, value in (known or {}).items()
    }
    every: list[Definition] = []
    branches: list[_Branch] = []
    for directive in _DIRECTIVE.finditer(plain):
        word, rest = directive[1], directive[2]
        taken = all(branch.taken for branch in branches)
        if word == "define":
            definition = _definition(directive, lines, taken=taken)
            if definition is None:
                continue
            every.append(definition)
            if taken:
                names.pop(definition.name, None)
                names[definition.name] = definition
        elif word == "undef" and taken:
            names.pop(rest.strip(), None)
        elif word in ("if", "ifdef", "ifndef", "elif", "else", "endif"):
            so_far = Macros(source, (), found.functions, names)
            _conditional(word, rest, branches, so_far, lines.of(directive.start()))
        if len(every) > MOST_DEFINITIONS or len(branches) > _MOST_DEPTH:
            message = f"more than {MOST_DEFINITIONS} macros or {_MOST_DEPTH} nested conditions"
            line = lines.of(directive.start())
            raise InputError(f"{message}; name a smaller header", source=source, line=line)
    if branches:
        message = "the condition has no #endif; write it, or copy the whole file"
        raise InputError(message, source=source, line=branches[-1].line)
    own = {name: definition for name, definition in names.items() if definition.line}
    return Macros(source, tuple(every), found.functions, own)


def read_assignments(text: str, source: str, functions: Functions | None = None) -> Macros:
    """Assignments such as ``params.motor.r = 0.05f;``, by what is assigned, as `Macros`.

    Raises:
        InputError: A comment is not closed, or there are too many.
    """
    plain, lines = without_comments(text, source), _Lines(text)
    found: list[Definition] = []
    for part in _ASSIGNED.finditer(plain):
        value = part[2].rstrip()
        start = part.start(2)
        end = start + len(value)
        found.append(Definition(part[1], value, lines.of(part.start()), start, end))
        if len(found) > MOST_DEFINITIONS:
            message = f"more than {MOST_DEFINITIONS} assignments; name a smaller file"
            raise InputError(message, source=source, line=found[-1].line)
    by_name = {definition.name: definition for definition in found}
    return Macros(source, tuple(found), functions or {}, by_name)


def with_values(text: str, macros: Macros, values: Mapping[str, str]) -> str:
    """The text with other texts behind macros (or assignments) of it; everything else stays.

    Names that it does not define are left out: see what is missing in ``macros``. A text that
    stands for the same number, in the same wrap, stays as well.
    """
    edits = [
        (macros.by_name[name].start, macros.by_name[name].end, value)
        for name, value in values.items()
        if name in macros and not _same_number(macros, name, value)
    ]
    for start, end, value in sorted(edits, reverse=True):
        lead = " " if start == end and not text[:start].endswith((" ", "\t")) else ""
        text = text[:start] + lead + value + text[end:]
    return text


def _same_number(macros: Macros, name: str, text: str) -> bool:
    """Whether a text has the value that stands behind a macro, and the names in it as well."""
    old = macros.by_name[name]
    if _WORD.findall(old.text) != _WORD.findall(text):
        return False
    one, other = macros.value_of(old), macros.value_of(replace(old, text=text))
    return one is not None and one == other


def without_comments(text: str, source: str) -> str:
    """The text with blanks for its comments and for the ends of continued lines: every character
    keeps its place.

    Raises:
        InputError: A comment is not closed.
    """

    def blank(found: re.Match[str]) -> str:
        part = found[0]
        if part[0] in "\"'":
            return part
        if part.startswith("/*") and (len(part) < 4 or not part.endswith("*/")):
            line = text.count("\n", 0, found.start()) + 1
            message = "the comment is not closed; write */, or copy the whole file"
            raise InputError(message, source=source, line=line)
        # A comment over several lines is one blank: its ends of lines end no directive.
        return " " * len(part)

    return _PASSED.sub(blank, text.replace("\\\n", "  "))


class _Lines:
    """One-based lines of the places in a text."""

    def __init__(self, text: str) -> None:
        lengths = (len(line) + 1 for line in text.split("\n"))
        self.starts = [0, *accumulate(lengths)]

    def of(self, place: int) -> int:
        return bisect_right(self.starts, place)


def _definition(directive: re.Match[str], lines: _Lines, *, taken: bool) -> Definition | None:
    head = _DEFINED.match(directive[2])
    if head is None:
        return None
    called = head[2] is not None
    text = directive[2][head.end() :].rstrip()
    start = directive.start(2) + head.end()
    line = lines.of(directive.start(2))
    return Definition(head[1], text, line, start, start + len(text), taken, called)


@dataclass(slots=True)
class _Branch:
    """A condition under way: whether its present branch counts, whether one has counted, and the
    line of its beginning.
    """

    taken: bool
    done: bool
    line: int


def _conditional(word: str, rest: str, branches: list[_Branch], macros: Macros, line: int) -> None:
    """Take a directive that begins, changes or ends a condition."""
    if word in ("if", "ifdef", "ifndef"):
        holds = _holds(word, rest, macros)
        branches.append(_Branch(holds, holds, line))
    elif not branches:
        message = f"#{word} without #if; copy the whole file"
        raise InputError(message, source=macros.source, line=line)
    elif word == "endif":
        branches.pop()
    else:
        last = branches[-1]
        last.taken = not last.done and (word == "else" or _holds("if", rest, macros))
        last.done = last.done or last.taken


def _holds(word: str, rest: str, macros: Macros) -> bool:
    """Whether a branch counts, as far as the file says; one that stays open counts."""
    if word in ("ifdef", "ifndef"):
        return (rest.partition(" ")[0].strip() in macros) == (word == "ifdef")
    asked = _ASKED.sub(lambda found: str(int((found[1] or found[2]) in macros)), rest)
    try:
        value = evaluated(_expanded(asked, macros), macros.functions)
    except NotArithmeticError:
        return True
    return isinstance(value, Unknown) or bool(value)


def _expanded(text: str, macros: Macros) -> list[str]:
    """Tokens of a text with the macros in it written out, as C does; bounded in their number."""
    found: list[str] = []
    # Each entry: what remains of a text, and the names it came from, which are not written out.
    waiting = [(iter(tokens_of(text)), frozenset[str]())]
    steps = 0
    while waiting:
        tokens, within = waiting[-1]
        token = next(tokens, None)
        steps += 1
        if token is None:
            waiting.pop()
            continue
        definition = macros.by_name.get(token)
        if definition is None or definition.function or token in within:
            found.append(token)
        elif len(waiting) > _MOST_DEPTH:
            raise NotArithmeticError("macros nested too deeply")
        else:
            waiting.append((iter(tokens_of(definition.text)), within | {token}))
        if len(found) > MOST_TOKENS or steps > 4 * MOST_TOKENS:
            raise NotArithmeticError("macros that grow too long")
    return found
