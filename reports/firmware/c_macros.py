"""C headers of others, read without a compiler: macros and assignments with their lines and
values, and other values put where theirs stand.
"""

from __future__ import annotations

import math
import operator
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import field, replace
from itertools import accumulate
from typing import NoReturn
from xml.sax.saxutils import escape, quoteattr

from dqforge.machines.errors import InputError, shown
from dqforge.machines.files.positioned_xml import Element, parsed
from dqforge.machines.records import dataclass
from dqforge.reports.firmware.target import IN_RANGE, in_range

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


# Plain arithmetic of C, evaluated without running anything: numbers, operators, casts, and
# functions that the caller names.
#
# Bounded in length and depth; whatever is no arithmetic has no value.

Number = float | int
Functions = Mapping[str, Callable[..., float]]

MOST_TOKENS = 2_000


_C_ARITHMETIC_MOST_DEPTH = 40


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
        if depth > _C_ARITHMETIC_MOST_DEPTH:
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
        if depth > _C_ARITHMETIC_MOST_DEPTH:
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


# XML files of firmware: elements with their lines, and values replaced where they stand.
#
# No document type, no entities, no other files (`dqforge.machines.files.positioned_xml`).

_AGAIN = "save the file again"


_ATTRIBUTE = re.compile(rb"""([^\s=<>"']+)\s*=\s*("[^"]*+"?|'[^']*+'?)""")


def parsed_xml(text: str, source: str) -> Element:
    """Root of an XML text.

    Raises:
        InputError: It is not XML, has a document type, or is too deep or too large; with the line.
    """
    return parsed(text, source, _AGAIN)


def elements(root: Element) -> Iterator[Element]:
    """An element and all below it, as they stand in the text."""
    waiting = [root]
    while waiting:
        element = waiting.pop()
        yield element
        waiting += reversed(element.children)


def with_texts(text: str, source: str, values: Mapping[str, str]) -> str:
    """The text with other texts in the children of its root of these names; those that are
    missing stand at its end. A child that is there twice is changed twice.

    Raises:
        InputError: As `parsed_xml`; or one of them has children itself.
    """
    root, content = parsed_xml(text, source), text.encode("utf-8")
    edits = []
    for name, value in values.items():
        for element in root.children_named(name):
            if element.children:
                message = f"{name} holds elements, not a value; {_AGAIN}"
                raise InputError(message, source=source, line=element.line)
            edits.append(_replaced_text(content, element, value))
    missing = [name for name in values if not root.children_named(name)]
    if missing:
        lines = "".join(f"    <{name}>{escape(values[name])}</{name}>\n" for name in missing)
        edits.append(_inserted(content, root, lines))
    return _edited(content, edits)


def with_attribute(text: str, source: str, name: str, values: Mapping[int, str]) -> str:
    """The text with other values of an attribute of elements, by the ``start`` of the element.

    An element without the attribute is left as it is. Raises InputError as `parsed_xml`.
    """
    content = text.encode("utf-8")
    edits = []
    for element in elements(parsed_xml(text, source)):
        if element.start in values:
            tag_end = _tag_end(content, element.start)
            for found in _ATTRIBUTE.finditer(content, element.start, tag_end):
                if found[1] == name.encode("utf-8"):
                    new = quoteattr(values[element.start]).encode("utf-8")
                    edits.append((found.start(2), found.end(2), new))
    return _edited(content, edits)


Edit = tuple[int, int, bytes]


def _tag_end(content: bytes, start: int) -> int:
    """Place behind the ``>`` of a tag, past those in quotes."""
    found = re.compile(rb"""<(?:[^<>"']|"[^"]*+"|'[^']*+')*+>""").match(content, start)
    return len(content) if found is None else found.end()


def _replaced_text(content: bytes, element: Element, value: str) -> Edit:
    behind, written = _tag_end(content, element.start), escape(value).encode("utf-8")
    if content[behind - 2 : behind] == b"/>":
        name = re.compile(rb"<([^\s/>]+)").match(content, element.start)
        tag = b"" if name is None else name[1]
        return behind - 2, behind, b">" + written + b"</" + tag + b">"
    return behind, element.end, written


def _inserted(content: bytes, root: Element, lines: str) -> Edit:
    behind = _tag_end(content, root.start)
    if content[behind - 2 : behind] == b"/>":
        return behind - 2, behind, f">\n{lines}</{root.tag}>".encode()
    before = b"" if content[: root.end].endswith(b"\n") else b"\n"
    return root.end, root.end, before + lines.encode("utf-8")


def _edited(content: bytes, edits: list[Edit]) -> str:
    for start, end, new in sorted(edits, reverse=True):
        content = content[:start] + new + content[end:]
    return content.decode("utf-8")
