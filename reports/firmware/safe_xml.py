"""XML files of firmware: elements with their lines, and values replaced where they stand.

No document type, no entities, no other files (`dqforge.machines.files.positioned_xml`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from xml.sax.saxutils import escape, quoteattr

from dqforge.machines.errors import InputError
from dqforge.machines.files.positioned_xml import Element, parsed

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
