"""JSON files of firmware: numbers with their lines, and values replaced where they stand."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, NoReturn

from dqforge.machines.errors import InputError, shown
from dqforge.machines.records import dataclass
from dqforge.reports.firmware.target import IN_RANGE, in_range

Path = tuple[str | int, ...]


_MOST_DEPTH = 32


_MOST_VALUES = 100_000


_TOKEN = re.compile(r'"(?:\\.|[^"\\])*+"?|[{}\[\],:]|[^\s{}\[\],:"]++', re.DOTALL)


_TOO_MANY_DIGITS = re.compile(r"\d{4000}")


_AGAIN = "save the file again"


@dataclass(frozen=True, slots=True)
class JsonText:
    """A JSON text: its value, and where each value in it begins and ends, by its path."""

    source: str
    text: str
    root: Any
    spans: Mapping[Path, tuple[int, int]]

    def value(self, *path: str | int) -> Any:
        """What stands at a path, None where nothing does."""
        found = self.root
        for part in path:
            if isinstance(found, dict) and isinstance(part, str):
                found = found.get(part)
            elif isinstance(found, list) and isinstance(part, int) and 0 <= part < len(found):
                found = found[part]
            else:
                return None
        return found

    def line(self, *path: str | int) -> int | None:
        """One-based line of the value at a path."""
        span = self.spans.get(path)
        return None if span is None else self.text.count("\n", 0, span[0]) + 1

    def number(self, *path: str | int) -> float | None:
        """The number at a path, None where there is none or null.

        Raises:
            InputError: Something else stands there; with its line.
        """
        found = self.value(*path)
        if found is None:
            return None
        if isinstance(found, bool) or not isinstance(found, int | float):
            self.refuse(path, f"is {shown(_short(found))}, not a number; write one")
        if not in_range(found):
            self.refuse(path, f"is beyond every firmware's range; {IN_RANGE}")
        return float(found)

    def whole(self, *path: str | int) -> int | None:
        """The whole number at a path; as `number`."""
        found = self.number(*path)
        if found is not None and (not found.is_integer() or abs(found) > 2**53):
            self.refuse(path, f"is {found:g}; write a whole number")
        return None if found is None else int(found)

    def written(self, *path: str | int) -> str:
        """The text of a value as it is written, "" where there is none."""
        span = self.spans.get(path)
        return "" if span is None else self.text[slice(*span)]

    def refuse(self, path: Path, complaint: str) -> NoReturn:
        """Raise InputError on the value at a path, with its line."""
        name = ".".join(str(part) for part in path) or "the file"
        message = f"{shown(name)[1:-1]} {complaint}"
        raise InputError(message, source=self.source, line=self.line(*path))


def _short(value: Any) -> str:
    return json.dumps(value)[:60] if not isinstance(value, dict | list) else type(value).__name__


def parsed_json(text: str, source: str, *, constants: bool = False) -> JsonText:
    """A JSON text with the places of its values.

    With ``constants`` Infinity, -Infinity and NaN are taken, as Python writes them; `JsonText`
    refuses them where a number is asked for.

    Raises:
        InputError: It is not JSON, a key stands there twice, a number is not finite, or it is
            nested too deeply or too large; with the line.
    """
    _check_depth(text, source)
    twice: list[str] = []

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            twice.append(next(key for k, (key, _) in enumerate(pairs) if key in dict(pairs[:k])))
        return found

    def constant(name: str) -> float:
        if constants:
            return float(name)
        line = _line(text, max(text.find(name), 0))
        message = f"{name} is not a number of JSON; write a finite one"
        raise InputError(message, source=source, line=line)

    try:
        root = json.loads(text, object_pairs_hook=unique, parse_constant=constant)
    except json.JSONDecodeError as error:
        message = f"not JSON: {error.msg}; {_AGAIN}"
        raise InputError(message, source=source, line=error.lineno, column=error.colno) from None
    except InputError:
        raise
    except (ValueError, RecursionError):
        digits = _TOO_MANY_DIGITS.search(text)
        line = 1 if digits is None else _line(text, digits.start())
        message = "a number has too many digits; write at most 17"
        raise InputError(message, source=source, line=line) from None
    if twice:
        line = _line(text, max(text.rfind(json.dumps(twice[0])), 0))
        message = f"the key {shown(twice[0])} stands there twice; remove one"
        raise InputError(message, source=source, line=line)
    return JsonText(source, text, root, dict(_spans(text)))


def _line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1


def _check_depth(text: str, source: str) -> None:
    """Refuse what is nested too deeply, before anything of it is read."""
    depth = values = 0
    for token in _TOKEN.finditer(text):
        mark = token[0]
        depth += (mark in "{[") - (mark in "}]")
        values += mark in ",{["
        if depth > _MOST_DEPTH or values > _MOST_VALUES:
            message = f"more than {_MOST_DEPTH} levels or {_MOST_VALUES} values; {_AGAIN}"
            raise InputError(message, source=source, line=_line(text, token.start()))


def _spans(text: str) -> Iterator[tuple[Path, tuple[int, int]]]:
    """Path, begin and end of every value of a valid text, inner ones first."""
    stack: list[tuple[Path, int, bool]] = []
    path: Path = ()
    key = False
    for token in _TOKEN.finditer(text):
        mark = token[0]
        if mark in "{[":
            key = mark == "{"
            stack.append((path, token.start(), key))
            path = path if key else (*path, 0)
        elif mark in "}]":
            path, start, _ = stack.pop()
            yield path, (start, token.end())
            key = False
        elif mark == ",":
            parent, _, key = stack[-1]
            last = path[-1]
            path = parent if key or not isinstance(last, int) else (*parent, last + 1)
        elif mark == ":":
            key = False
        elif key:
            path = (*stack[-1][0], json.loads(mark))
        else:
            yield path, token.span()


def with_json_values(
    text: str, source: str, values: Mapping[tuple[str, ...], Any], *, constants: bool = False
) -> str:
    """The text with other values at these paths of keys; what is missing is put in front of its
    neighbours, everything else stays as it stands; ``constants`` as in `parsed_json`.

    Raises:
        InputError: As `parsed_json`; or a value stands where an object must.
    """
    found = parsed_json(text, source, constants=constants)
    present = {path: value for path, value in values.items() if path in found.spans}
    edits = [
        (*found.spans[path], json.dumps(value))
        for path, value in present.items()
        if not _same_number(found.value(*path), value)
    ]
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    for path in reversed([path for path in values if path not in present]):
        text = _with_key(parsed_json(text, source, constants=constants), path, values[path])
    return text


def _same_number(one: Any, other: Any) -> bool:
    """Whether two values are the same number, however it is written."""
    numbers = all(type(value) in (int, float) for value in (one, other))
    return numbers and bool(one == other)


def _with_key(found: JsonText, path: tuple[str, ...], value: Any) -> str:
    """The text with a value at a path that is not there yet."""
    length = max(k for k in range(len(path)) if path[:k] in found.spans)
    parent = path[:length]
    if not isinstance(found.value(*parent), dict):
        found.refuse(parent, "is no object; write {...}")
    for key in reversed(path[length + 1 :]):
        value = {key: value}
    place = found.spans[parent][0] + 1
    margin = re.match(r"\s*", found.text[place:])
    blank = "" if margin is None else margin[0]
    filled = bool(found.value(*parent))
    written = f"{json.dumps(path[length])}: {json.dumps(value)}" + ("," if filled else "")
    lead = blank if filled else ""
    return found.text[:place] + lead + written + found.text[place:]
