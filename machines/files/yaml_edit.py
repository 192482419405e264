"""A YAML text that says something else: changed values in their places,
everything around them as it was.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import NamedTuple

import yaml

from dqforge.machines.files.positioned_yaml import YamlValue, parse_value, parse_yaml

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
