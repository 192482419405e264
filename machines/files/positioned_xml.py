"""XML of others: elements with their lines, and nothing that a document type could bring along."""

from __future__ import annotations

import io
import re
from dataclasses import dataclass, field
from xml.parsers import expat

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.files.text_table import TextTable, read_table

_MOST_ELEMENTS = 50_000


_MOST_DEPTH = 32


@dataclass(slots=True)
class Element:
    """An element: its name without namespace, its attributes, text, children,
    line and path of names.

    ``start`` and ``end`` are the places of its start tag and of its end tag in the text as UTF-8;
    both are that of the one tag where it has no other.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    path: str
    text: str = ""
    children: list[Element] = field(default_factory=list)
    start: int = 0
    end: int = 0

    def children_named(self, tag: str) -> list[Element]:
        """Children of a name, in their order."""
        return [child for child in self.children if child.tag == tag]


class _Tree:
    """The elements of a file, as the parser meets them."""

    def __init__(self, source: str, again: str) -> None:
        self.source, self.again = source, again
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.characters
        # Entities and files of others come with a document type only.
        self.parser.StartDoctypeDeclHandler = self.refuse
        self.stack: list[Element] = []
        self.root: Element | None = None
        self.count = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Take the begin of an element."""
        self.count += 1
        name, line = tag.rpartition(":")[2], self.parser.CurrentLineNumber
        if self.count > _MOST_ELEMENTS or len(self.stack) >= _MOST_DEPTH:
            message = f"more than {_MOST_ELEMENTS} elements or {_MOST_DEPTH} levels; {self.again}"
            raise InputError(message, source=self.source, line=line)
        parent = self.stack[-1] if self.stack else None
        element = Element(
            name,
            attributes,
            line,
            name if parent is None else f"{parent.path}/{name}",
            start=self.parser.CurrentByteIndex,
        )
        if parent is None:
            self.root = element
        else:
            parent.children.append(element)
        self.stack.append(element)

    def end(self, _tag: str) -> None:
        """Take the end of an element."""
        self.stack.pop().end = self.parser.CurrentByteIndex

    def characters(self, text: str) -> None:
        """Take text."""
        self.stack[-1].text += text

    def refuse(self, *_: object) -> None:
        """Refuse a document type."""
        message = "a document type (<!DOCTYPE ...>) is not read; remove it"
        raise InputError(message, source=self.source, line=self.parser.CurrentLineNumber)


def parsed(content: bytes | str, source: str, again: str = "export the device again") -> Element:
    """Root of an XML file.

    Args:
        content: Bytes of the file, or its text, whatever encoding that claims; the parser of the
            standard library, without document types, entities or other files.
        source: Its name, for messages.
        again: What messages advise.

    Raises:
        InputError: The file is not XML, has a document type, or is too deep or too large; with the
            line.
    """
    tree = _Tree(source, again)
    try:
        tree.parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        message = f"not XML: {reason}; {again}"
        raise InputError(
            message, source=source, line=error.lineno, column=error.offset + 1
        ) from None
    except (LookupError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            "not XML: its encoding is not known; save it as UTF-8", source=source, line=1
        ) from None
    if tree.root is None:
        raise InputError(f"not XML: there are no elements; {again}", source=source, line=1)
    return tree.root


# Large text tables of nothing but numbers below a header, read in one piece by NumPy.
#
# The header and the first rows are read as any table is; where the rest holds only numbers in the
# same columns, NumPy's own parser takes it, with the same values at a fraction of time and memory.
# Everything else goes the usual way.

_HEAD = 65_536


_PLAIN = re.compile(rb"[0-9+\-.eE,;\t \r\nnNaA]*")


_MARKS = (";", "\t", ",", None)


def read_numeric_table(content: bytes, source: str) -> TextTable | None:
    """Table of a large text whose rows are plain numbers with decimal points.

    None where it is not that plain.
    """
    head = _head(content, source)
    if head is None:
        return None
    first = int(head.lines[0])
    start = _start_of_line(content, first)
    body = memoryview(content)[start:]
    if not _PLAIN.fullmatch(body):
        return None
    rows = content.count(b"\n", start) + (not content.endswith(b"\n"))
    for mark in _MARKS:
        values = _parsed(body, mark)
        if values is None or values.shape != (
            rows,
            head.values.shape[1],
        ):  # an empty line would shift all numbers
            continue
        if np.array_equal(values[: head.lines.size], head.values, equal_nan=True):
            lines = np.arange(first, first + rows, dtype=np.intp)
            return TextTable(source, head.names, head.units, values, lines, head.preamble)
    return None


def _head(content: bytes, source: str) -> TextTable | None:
    """Table of the first whole lines of a large text, None where other lines stand among its
    rows.
    """
    end = content.rfind(b"\n", 0, _HEAD) + 1
    if end == 0 or len(content) <= _HEAD:
        return None
    try:
        head = read_table(content[:end], source)
    except InputError:
        return None
    return head if head.lines[-1] - head.lines[0] + 1 == head.lines.size else None


def _start_of_line(content: bytes, line: int) -> int:
    """Place of the first byte of a one-based line."""
    place = 0
    for _ in range(line - 1):
        place = content.index(b"\n", place) + 1
    return place


def _parsed(body: memoryview, mark: str | None) -> FloatArray | None:
    """Numbers of all rows, shape (rows, columns).

    None where a cell is no number or a row is longer.
    """
    try:
        values = np.loadtxt(io.BytesIO(body), delimiter=mark, ndmin=2, comments=None)
    except ValueError:
        return None
    return None if np.isinf(values).any() else values
