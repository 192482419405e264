"""Pages of the documentation read as sessions: the commands, files and Python blocks that a reader
goes through in order, and what the page says that comes of them.

A page may begin with keys between two lines ``---``:

===========  =========================================================================
``sessions`` ``quick``: the page runs with the default tests, else with the campaign
``requires`` programs beside dqforge that must be installed, such as ``qemu-system-arm``
``extras``   optional parts of dqforge that the page installs, such as ``explore``
===========  =========================================================================
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_FENCE = re.compile(r"^(?P<indent>\s*)(?P<fence>`{3,}|~{3,}|:{3,})\s*(?P<info>.*?)\s*$")
_DIRECTIVE = re.compile(r"^\{(?P<name>[\w-]+)\}\s*(?P<argument>.*)$")
_OPTION = re.compile(r"^:(?P<key>[\w-]+):\s*(?P<value>.*)$")
_DOWNLOAD = re.compile(r"\{download\}`(?:[^`<]*<)?(?P<path>[^`<>]+)>?`")
_FIGURE = re.compile(r"!\[[^\]]*\]\((?P<path>[^)\s]+\.svg)\)")
_EXIT = re.compile(r"^\[exit (\d+)\]$")
SHOWN = ("code-block", "code", "literalinclude")


class PageError(Exception):
    """A page that is no session: where, and what to write instead."""


@dataclass(frozen=True)
class Command:
    """A line of the shell, the lines that the page shows under it, and its exit code.

    ``expected`` begins on line ``under`` of the page; without lines anything may come.
    """

    line: int
    text: str
    expected: tuple[str, ...]
    under: int
    exit_code: int = 0


@dataclass(frozen=True)
class WrittenFile:
    """A file that the reader writes from the page."""

    line: int
    name: str
    content: str


@dataclass(frozen=True)
class CopiedFile:
    """A file that the reader downloads; ``source`` is relative to the page."""

    line: int
    name: str
    source: str


@dataclass(frozen=True)
class Code:
    """A block of Python, and what the page says that it prints (None: not said)."""

    line: int
    text: str
    expected: tuple[str, ...] | None
    under: int


@dataclass(frozen=True)
class Figure:
    """A figure shown; where the session has drawn a file of that name, they are the same."""

    line: int
    source: str


Step = Command | WrittenFile | CopiedFile | Code | Figure


@dataclass(frozen=True)
class Block:
    """A fenced block: what stands behind the fence, its options, its lines from ``line`` on."""

    info: str
    options: dict[str, str]
    lines: list[str]
    line: int
    opened: int

    @property
    def language(self) -> str:
        """Language of a block that is only shown, or of a directive that shows code."""
        found = _DIRECTIVE.match(self.info)
        return found["argument"] if found else self.info

    @property
    def text(self) -> str:
        return "".join(f"{line}\n" for line in self.lines)


@dataclass(frozen=True)
class Page:
    """A page: its keys, its steps in order."""

    path: Path
    keys: dict[str, str]
    steps: list[Step]

    @property
    def is_quick(self) -> bool:
        return self.keys.get("sessions") == "quick"

    @property
    def requires(self) -> list[str]:
        return self.keys.get("requires", "").split()

    @property
    def extras(self) -> list[str]:
        return self.keys.get("extras", "").split()


def read_page(path: Path) -> Page:
    """Read a page.

    Raises:
        PageError: Of a block that is never closed, and of lines before the first command of a
            session.
    """
    text = path.read_text(encoding="utf-8")
    return Page(path, _keys(text.splitlines()), steps_of(text, str(path)))


def steps_of(text: str, where: str) -> list[Step]:
    """Steps of a page's text; ``where`` names it in errors."""
    steps: list[Step] = []
    printed: tuple[int, Code] | None = None
    for part in parts_of(text.splitlines(), 1, where):
        if isinstance(part, tuple):
            number, line = part
            steps += _mentions(line, number)
            printed = None if line.strip() else printed
            continue
        if printed is not None and part.info == "text":
            index, code = printed
            steps[index] = Code(code.line, code.text, tuple(part.lines), part.line)
        printed = None
        if part.info == "python":
            code = Code(part.line, part.text, None, part.line)
            printed = (len(steps), code)
            steps.append(code)
        else:
            steps += _steps_of_block(part, where)
    return steps


def parts_of(lines: list[str], first: int, where: str) -> Iterator[Block | tuple[int, str]]:
    """Blocks and the lines between them; directives with text in them are text."""
    at = 0
    while at < len(lines):
        opening = _FENCE.match(lines[at])
        if opening is None or (opening["fence"][0] == ":" and not opening["info"]):
            yield first + at, lines[at]
            at += 1
            continue
        end = _closing(lines, at, opening["fence"])
        if end is None:
            raise PageError(f"{where}:{first + at}: this block is never closed")
        inside = textwrap.dedent("\n".join(lines[at + 1 : end])).split("\n")[: end - at - 1]
        directive = _DIRECTIVE.match(opening["info"])
        if directive is not None and directive["name"] not in SHOWN:
            yield from parts_of(inside, first + at + 1, where)
        else:
            yield _block(opening["info"], inside, first + at)
        at = end + 1


def _closing(lines: list[str], opened: int, fence: str) -> int | None:
    pattern = re.compile(rf"^\s*{re.escape(fence[0])}{{{len(fence)},}}\s*$")
    return next((n for n in range(opened + 1, len(lines)) if pattern.match(lines[n])), None)


def _block(info: str, lines: list[str], opened: int) -> Block:
    options = {}
    skipped = 0
    if info.startswith("{"):
        while skipped < len(lines) and (option := _OPTION.match(lines[skipped])):
            options[option["key"]] = option["value"]
            skipped += 1
        if options and skipped < len(lines) and not lines[skipped].strip():
            skipped += 1
    return Block(info, options, lines[skipped:], opened + 1 + skipped, opened)


def _keys(lines: list[str]) -> dict[str, str]:
    """Keys at the head of the page, one to a line."""
    if not lines or lines[0] != "---" or "---" not in lines[1:]:
        return {}
    head = lines[1 : lines.index("---", 1)]
    pairs = [line.partition(":") for line in head]
    return {key.strip(): value.strip() for key, _, value in pairs}


def _mentions(line: str, number: int) -> list[Step]:
    """Downloads and figures in a line of text."""
    copied = [found["path"] for found in _DOWNLOAD.finditer(line)]
    shown = [found["path"] for found in _FIGURE.finditer(line)]
    return [
        *(CopiedFile(number, Path(path).name, path) for path in copied),
        *(Figure(number, path) for path in shown),
    ]


def _steps_of_block(block: Block, where: str) -> list[Step]:
    name = block.options.get("caption", "")
    if block.info == "console":
        return list(commands_of(block, where))
    if name and block.info.startswith("{literalinclude}"):
        return [CopiedFile(block.opened, name, block.language)]
    if name:
        return [WrittenFile(block.opened, name, block.text)]
    return []


def commands_of(block: Block, where: str) -> Iterator[Command]:
    """Commands of a session in the terminal, each with the lines under it."""
    starts = [n for n, line in enumerate(block.lines) if line.startswith("$ ")]
    before = block.lines[: starts[0]] if starts else block.lines
    if any(line.strip() for line in before):
        raise PageError(f"{where}:{block.line}: a session begins with a command, '$ ...'")
    for start, end in zip(starts, [*starts[1:], len(block.lines)], strict=True):
        under = start + 1
        while under < end and block.lines[under - 1].endswith("\\"):
            under += 1
        text = "\n".join([block.lines[start][2:], *block.lines[start + 1 : under]])
        expected = [line.rstrip() for line in block.lines[under:end]]
        while expected and not expected[-1]:
            expected.pop()
        stopped = _EXIT.match(expected[-1]) if expected else None
        code = int(stopped[1]) if stopped else 0
        shown = tuple(expected[:-1] if stopped else expected)
        yield Command(block.line + start, text, shown, block.line + under, code)
