"""YAML input with positions: what is read safely, and where every key and value stands.

The text is read event by event, so a hostile file meets the limits before anything is built from
it. Plain scalars follow the YAML 1.2 core schema (no sexagesimal numbers, no octal, no dates, and
``no`` is a text, not a truth value).
"""

from __future__ import annotations

import codecs
import json
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import field
from pathlib import Path
from typing import NamedTuple, NoReturn

import yaml

from dqforge.machines.errors import (
    InputError,
    KeyPath,
    Position,
    behind_option,
    close_matches,
    dotted,
    nearest,
    option_at,
    shown,
)
from dqforge.machines.files.input_files import read_regular_file
from dqforge.machines.records import dataclass

MAX_BYTES = 1 << 20


MAX_DEPTH = 32


MAX_NODES = 20_000


MAX_DIGITS = 40


YamlValue = bool | int | float | str | list["YamlValue"] | dict[str, "YamlValue"] | None


_INT = re.compile(r"[-+]?[0-9]+")


_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")


_WORDS = {
    "": None,
    "~": None,
    "null": None,
    "Null": None,
    "NULL": None,
    "true": True,
    "True": True,
    "TRUE": True,
    "false": False,
    "False": False,
    "FALSE": False,
}


_NOT_TEXT = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True, slots=True)
class YamlDocument:
    """The content of one file and the position of each of its parts.

    ``keys`` and ``values`` map the path of a part, such as ``("machine", "poles")``, to where its
    key and its value begin. List entries have the position of their value in both. ``options``
    holds the option of the command line for each part that one set, ``renamed`` the former path of
    each key that the file writes by a former name.
    """

    source: str
    data: dict[str, YamlValue]
    keys: dict[KeyPath, Position]
    values: dict[KeyPath, Position]
    options: dict[KeyPath, str] = field(default_factory=dict)
    renamed: dict[KeyPath, KeyPath] = field(default_factory=dict)

    def position(self, path: KeyPath, *, key: bool = False) -> Position:
        """Where a part begins, or the nearest enclosing part that is in the file."""
        return nearest(self.keys, self.values, path, key=key)

    def error(self, message: str, path: KeyPath, *, key: bool = False) -> InputError:
        """Build an error that points to a part of this file, or names the option that set it."""
        option = option_at(self.options, self.keys, path)
        if option is not None:
            return InputError(behind_option(message, path), source=option)
        line, column = self.position(path, key=key)
        return InputError(message, source=self.source, line=line, column=column)

    @contextmanager
    def at(self, path: KeyPath, *, key: bool = False) -> Iterator[None]:
        """Give a position to each `InputError` without one that the block raises."""
        try:
            yield
        except InputError as error:
            if error.line is not None or error.source in self.options.values():
                raise
            raise self.error(f"{dotted(path)}: {error.message}", path, key=key) from None


def read_bytes(path: str | Path, known: Callable[[], list[str]] = list) -> bytes:
    """Content of a design file; ``known`` are names that may stand in place of a file.

    Raises:
        InputError: There is no such file, it is no regular file, it cannot be read, or it is larger
            than 1 MiB.
    """
    try:
        return read_regular_file(path, MAX_BYTES)
    except InputError as error:
        raise InputError(_advice(Path(path), error, known), source=str(path)) from None


def _advice(path: Path, error: InputError, known: Callable[[], list[str]]) -> str:
    """What to say of a design file that cannot be read."""
    if error.message.startswith("there is no such file"):
        return f"no such file{_similar_files(path, known)}"
    if error.message.startswith("this is a folder"):
        inside = path / "design.yaml"
        named = f"write {inside}" if inside.is_file() else "name the design file in it"
        return f"this is a folder; {named}"
    if "can be read" in error.message:
        return f"{error.message}; a design file has a few kilobytes"
    return error.message


_MOST_NAMES = 3


def _similar_files(path: Path, known: Callable[[], list[str]]) -> str:
    try:
        names = [entry.name for entry in path.parent.iterdir() if entry.suffix in (".yaml", ".yml")]
    except OSError:
        return "; its folder does not exist either"
    matches = close_matches(path.name, names)
    if not matches and str(path) == path.name and not path.suffix:
        others = known()
        begun = [name for name in others if name.startswith(path.name)]
        matches = begun[:_MOST_NAMES] or close_matches(path.name, others)
    return f"; did you mean {' or '.join(matches)}?" if matches else ""


def parse_yaml(content: bytes, source: str) -> YamlDocument:
    """Read a YAML file that holds one mapping.

    Args:
        content: The file's bytes, UTF-8 with or without byte order mark.
        source: File name for messages.

    Raises:
        InputError: With a position: not UTF-8, control characters, not YAML, several documents,
            anchors, tags, duplicate keys, too large or too deep, empty, or not a mapping.
    """
    text = _decode(content, source)
    if "\t" not in text:  # of tabs the two have different opinions
        with suppress(yaml.YAMLError):  # the slower one says it in the words that are translated
            return _built(text, source, _QUICK)
    try:
        return _built(text, source, yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        raise translated(error, source) from None
    except yaml.YAMLError as error:
        raise InputError(f"not YAML: {shown(error)}", source=source) from None


# The same events ten times as fast, where PyYAML was built with its library.
_QUICK = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _built(text: str, source: str, loader: type[yaml.SafeLoader]) -> YamlDocument:
    """The document that a loader's events make."""
    builder = _Builder(source)
    for event in yaml.parse(text, Loader=loader):
        builder.feed(event)
    return builder.document()


def parse_value(text: str, source: str) -> YamlValue:
    """Value of one key, written as it stands behind the colon in a file, on one line.

    Args:
        text: A number, a word or text, ``[a, b]`` or ``{key: value}``.
        source: What messages call it.

    Raises:
        InputError: As `parse_yaml`; and where a mapping or a list has no braces or brackets, or a
            comment follows.
    """
    _refuse_no_text(text, source)
    builder, end = _Builder(source), 0
    try:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            if isinstance(event, yaml.CollectionStartEvent) and not event.flow_style:
                builder.fail(
                    "': ' and '- ' start a mapping or a list; put a text with them in quotes", event
                )
            builder.feed(event)
            mark = event.end_mark
            end = (
                mark.index
                if isinstance(event, yaml.NodeEvent | yaml.CollectionEndEvent) and mark
                else end
            )
    except yaml.MarkedYAMLError as error:
        raise translated(error, source) from None
    if text[end:].strip():
        raise InputError(
            f"{shown(text[end:].strip())} behind the value is not read; put a text in quotes",
            source=source,
        )
    return builder.root[0] if builder.root else None


def _decode(content: bytes, source: str) -> str:
    if len(content) > MAX_BYTES:
        raise InputError(
            f"the file is larger than {MAX_BYTES} bytes; a design file has a few kilobytes",
            source=source,
        )
    content = content.removeprefix(codecs.BOM_UTF8)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line, column = position_of(content[: error.start].decode("utf-8"))
        message = (
            f"the byte 0x{content[error.start]:02X} is not UTF-8; save the file with the encoding "
            "UTF-8"
        )
        raise InputError(message, source=source, line=line, column=column) from None
    _refuse_no_text(text, source)
    return text


def _refuse_no_text(text: str, source: str) -> None:
    """Raise at the first character that has no place in a text."""
    match = _NOT_TEXT.search(text)
    if match is not None:
        line, column = position_of(text[: match.start()])
        message = f"the character U+{ord(match.group()):04X} is not text; remove it"
        raise InputError(message, source=source, line=line, column=column)


@dataclass(slots=True)
class _Frame:
    """One list or mapping under construction; `key` is the mapping key that waits for its value."""

    node: list[YamlValue] | dict[str, YamlValue]
    path: KeyPath
    key: str | None = None


@dataclass(slots=True)
class _Builder:
    """Turns the stream of events into plain values, iteratively."""

    source: str
    keys: dict[KeyPath, Position] = field(default_factory=dict)
    values: dict[KeyPath, Position] = field(default_factory=dict)
    stack: list[_Frame] = field(default_factory=list)
    root: list[YamlValue] = field(default_factory=list)
    nodes: int = 0
    documents: int = 0

    def feed(self, event: yaml.Event) -> None:
        """Take the next event.

        Raises:
            InputError: The event breaks one of the limits.
        """
        if isinstance(event, yaml.DocumentStartEvent):
            self.documents += 1
            if self.documents > 1:
                self.fail("a second document ('---') begins here; write one design per file", event)
        elif isinstance(event, yaml.NodeEvent):
            self._node(event)
        elif isinstance(event, (yaml.SequenceEndEvent, yaml.MappingEndEvent)):
            self.stack.pop()

    def fail(self, message: str, event: yaml.Event) -> NoReturn:
        """Raise an error at the position of an event."""
        line, column = _begin(event)
        raise InputError(message, source=self.source, line=line, column=column)

    def _node(self, event: yaml.NodeEvent) -> None:
        self.nodes += 1
        if self.nodes > MAX_NODES:
            self.fail(
                f"more than {MAX_NODES} keys and values; a design file has about a hundred", event
            )
        if len(self.stack) >= MAX_DEPTH and isinstance(
            event, (yaml.SequenceStartEvent, yaml.MappingStartEvent)
        ):
            self.fail(f"nested deeper than {MAX_DEPTH} levels; a design file needs four", event)
        if isinstance(event, yaml.AliasEvent):
            self.fail("references ('*name') are not read; write the value itself", event)
        if event.anchor is not None:
            self.fail("anchors ('&name') are not read; remove it", event)
        if getattr(event, "tag", None) is not None:
            self.fail(
                f"tags such as {shown(getattr(event, 'tag', ''))} are not read; remove it", event
            )
        frame = self.stack[-1] if self.stack else None
        if frame is not None and isinstance(frame.node, dict) and frame.key is None:
            self._key(event, frame)
        else:
            self._value(event, frame)

    def _key(self, event: yaml.NodeEvent, frame: _Frame) -> None:
        if not isinstance(event, yaml.ScalarEvent):
            self.fail("a key must be a plain word, not a list or a mapping", event)
        key = event.value
        path = (*frame.path, key)
        if key == "<<" and not event.style:
            self.fail("merge keys ('<<') are not read; write the keys themselves", event)
        if path in self.keys:
            first = self.keys[path]
            self.fail(
                f"the key {shown(key)} is given twice, first in line {first.line}, column "
                f"{first.column}; remove one of them",
                event,
            )
        self.keys[path] = _begin(event)
        frame.key = key

    def _value(self, event: yaml.NodeEvent, frame: _Frame | None) -> None:
        value: YamlValue
        if isinstance(event, yaml.ScalarEvent):
            value = self._scalar(event)
        else:
            value = {} if isinstance(event, yaml.MappingStartEvent) else []
        path: KeyPath = ()
        if frame is None:
            self.root.append(value)
        elif isinstance(frame.node, dict):
            key = frame.key or ""
            path, frame.node[key], frame.key = (*frame.path, key), value, None
        else:
            path = (*frame.path, len(frame.node))
            self.keys[path] = _begin(event)
            frame.node.append(value)
        self.values[path] = _begin(event)
        if isinstance(value, (list, dict)):
            self.stack.append(_Frame(value, path))

    def _scalar(self, event: yaml.ScalarEvent) -> bool | int | float | str | None:
        text = event.value
        if event.style:  # None or empty where nothing is quoted
            return text
        if text in _WORDS:
            return _WORDS[text]
        number = _INT.fullmatch(text) or _FLOAT.fullmatch(text)
        if number is None:
            return text
        if len(text) > MAX_DIGITS:
            self.fail(
                f"the number {shown(text)} has more than {MAX_DIGITS} digits; write it shorter",
                event,
            )
        if _INT.fullmatch(text):
            return int(text)
        if not math.isfinite(float(text)):
            self.fail(f"the number {shown(text)} is too large; write a smaller one", event)
        return float(text)

    def document(self) -> YamlDocument:
        """The finished document; raises `InputError` when it is empty or not a mapping."""
        if not self.root or self.root[0] is None:
            raise InputError(
                "the file is empty; 'dqforge new' writes one to start from",
                source=self.source,
                line=1,
                column=1,
            )
        data = self.root[0]
        if not isinstance(data, dict):
            kind = "a list" if isinstance(data, list) else f"the text {shown(data)}"
            line, column = self.values[()]
            message = (
                f"the file holds {kind}; a design file begins with keys such as 'dqforge: 1' and "
                "'name: ...'"
            )
            raise InputError(message, source=self.source, line=line, column=column)
        return YamlDocument(self.source, data, self.keys, self.values)


def _begin(event: yaml.Event) -> Position:
    # Events of the pure Python loader always carry marks; the annotation allows for hand-made ones.
    mark = event.start_mark
    return Position(1, 1) if mark is None else Position(mark.line + 1, mark.column + 1)


# A YAML text that says something else: changed values in their places,
# everything around them as it was.

_NOT_PRINTED = "[^\x20-\x7e\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]"


class _Edit(NamedTuple):
    """What stands from ``start`` to ``end`` of the text becomes ``text``."""

    start: int
    end: int
    text: str


def edited(text: str, old: dict[str, YamlValue], new: dict[str, YamlValue]) -> str:
    """A text that holds other values; comments and what did not change stay where they are.

    Args:
        text: What `parse_yaml` accepts, without byte order mark.
        old: What it holds.
        new: What it shall hold.

    Returns:
        A text of which `parse_yaml` makes ``new``.
    """
    if _same(old, new):
        return text
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert root is not None
    found = text
    for edit in sorted(_edits(root, old, new), reverse=True):
        found = found[: edit.start] + edit.text + found[edit.end :]
    if _holds(found, new):
        return found
    # Keys that are written in an unusual way ('? key'), among which nothing can be put.
    return "".join(f"{written(key)}: {written(value)}\n" for key, value in new.items())


def _holds(text: str, wanted: dict[str, YamlValue]) -> bool:
    try:
        return _same(parse_yaml(text.encode("utf-8"), "").data, wanted)
    except ValueError:
        return False


def _same(one: YamlValue, other: YamlValue) -> bool:
    """Whether two values are the same, 1, 1.0 and true being three."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(
            _same(value, other[key]) for key, value in one.items()
        )
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(_same(a, b) for a, b in zip(one, other, strict=True))
    return type(one) is type(other) and one == other


def _edits(node: yaml.Node, old: YamlValue, new: YamlValue) -> Iterator[_Edit]:
    """What to change in the text of a node."""
    if _same(old, new):
        return
    if isinstance(old, dict) and isinstance(new, dict) and old.keys() <= new.keys():
        assert isinstance(node, yaml.MappingNode)
        for key, value in node.value:
            yield from _edits(value, old[key.value], new[key.value])
        added = {key: value for key, value in new.items() if key not in old}
        yield from [_insertion(node, added)] if added else []
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for entry, before, after in zip(node.value, old, new, strict=True):
            yield from _edits(entry, before, after)
    else:
        yield _replacement(node, new)


def _insertion(node: yaml.MappingNode, added: dict[str, YamlValue]) -> _Edit:
    """New keys: the last ones within braces, else before the first one, where their column is
    known.
    """
    pairs = [f"{written(key)}: {written(value)}" for key, value in added.items()]
    if node.flow_style:
        place = node.value[-1][1].end_mark.index if node.value else node.start_mark.index + 1
        return _Edit(place, place, (", " if node.value else "") + ", ".join(pairs))
    first = node.value[0][0].start_mark
    return _Edit(
        first.index, first.index, "".join(f"{pair}\n{' ' * first.column}" for pair in pairs)
    )


def _replacement(node: yaml.Node, new: YamlValue) -> _Edit:
    """A new value where an old one stood."""
    start, last = node.start_mark.index, _last(node)
    end = last.end_mark.index
    block_text = isinstance(last, yaml.ScalarNode) and last.style in ("|", ">")
    space = " " if start == end else ""  # a key without a value: the place right behind its colon
    return _Edit(start, end, space + written(new) + ("\n" if block_text else ""))


def _last(node: yaml.Node) -> yaml.Node:
    """Where a node ends: of a mapping in lines its last value, not the comments behind that."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        return _last(node.value[-1][1] if isinstance(node, yaml.MappingNode) else node.value[-1])
    return node


def written(value: YamlValue) -> str:
    """A value on one line, as `parse_value` reads it."""
    if isinstance(value, dict):
        return (
            "{"
            + ", ".join(f"{written(key)}: {written(entry)}" for key, entry in value.items())
            + "}"
        )
    if isinstance(value, list):
        return "[" + ", ".join(written(entry) for entry in value) + "]"
    if isinstance(value, str):
        return value if _is_plain(value) else _quoted(value)
    return json.dumps(value) if value is None or isinstance(value, bool) else repr(value)


def _is_plain(text: str) -> bool:
    """Whether a text needs no quotes anywhere."""
    return (
        re.fullmatch(r"[A-Za-z0-9][\w./%^*+() -]*", text, re.ASCII) is not None
        and parse_value(text, "") == text
    )


def _quoted(text: str) -> str:
    return re.sub(
        _NOT_PRINTED, lambda found: f"\\u{ord(found[0]):04x}", json.dumps(text, ensure_ascii=False)
    )


# What the YAML parser complains of, in plain English with a position.

_LINE_END = re.compile(r"\r\n|\r|\n")


# What the YAML library says, and what it means to somebody who edits a design file.
_PLAIN_ENGLISH = (
    ("found character '\\t'", "a tab is used for indentation; write spaces"),
    (
        "mapping values are not allowed",
        (
            "a ':' where none can stand; check the indentation, the space behind each ':', or use "
            "quotes"
        ),
    ),
    (
        "could not find expected ':'",
        "this line has no 'key: value'; write a colon and a space behind the key",
    ),
    (
        "expected '<document start>'",
        "this line does not continue the mapping above; line up the keys",
    ),
    (
        "expected <block end>",
        "this line does not line up with its neighbours; indent the keys of a section equally",
    ),
    ("expected ',' or '}'", "a '{' is not closed; separate the entries by commas and end with '}'"),
    ("expected ',' or ']'", "a '[' is not closed; separate the entries by commas and end with ']'"),
    ("found unexpected end of stream", "a quoted text is not closed; write the missing quote"),
    ("found unexpected document separator", "a quoted text is not closed; write the missing quote"),
    (
        "expected the node content",
        "a bracket, comma or mark stands where a value must; write the value, or use quotes",
    ),
    (
        "expected alphabetic or numeric",
        "'&' and '*' start references, which are not read; put the text in quotes",
    ),
    ("cannot start any token", "this character must stand in quotes at the start of a value"),
    (
        "unknown escape character",
        "a backslash in double quotes starts an escape; use single quotes",
    ),
    (
        "sequence entries are not allowed",
        "a list entry '-' is not allowed here; put it on its own indented line",
    ),
)


def position_of(before: str) -> Position:
    """Position of the character behind a text."""
    lines = _LINE_END.split(before)
    return Position(len(lines), len(lines[-1]) + 1)


def translated(error: yaml.MarkedYAMLError, source: str) -> InputError:
    """What the parser found wrong, in our words and with a position."""
    problem = error.problem or "not YAML"
    message = next((text for start, text in _PLAIN_ENGLISH if start in problem), None)
    mark = error.problem_mark or error.context_mark
    if message is None:
        message = f"not YAML: {shown(problem)[1:-1]}"
    elif "not closed" in message or "'key: value'" in message:
        # The library reports where it gave up; the user wants to see where the trouble began.
        mark = error.context_mark or mark
    if mark is None:
        return InputError(message, source=source)
    return InputError(message, source=source, line=mark.line + 1, column=mark.column + 1)
