"""What a page says that comes, against what came: ``...`` alone on a line stands for any lines,
none too, and within a line for any text. Blanks at the end of lines, and empty lines before the
first and after the last, count for nothing.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from itertools import pairwise

ANY = "..."
# A number that programs built by others may round in another way: its last digits.
_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")


def lines_that_came(text: str) -> list[str]:
    """Lines without what nobody sees: blanks at their ends, empty ones before and after."""
    lines = [line.rstrip() for line in text.replace("\r\n", "\n").split("\n")]
    while lines and not lines[0]:
        lines.pop(0)
    while lines and not lines[-1]:
        lines.pop()
    return lines


def is_said(said: str, came: str) -> bool:
    """Whether a line is what the page says, ``...`` for any text."""
    pattern = ".*".join(re.escape(part) for part in said.rstrip().split(ANY))
    return re.fullmatch(pattern, came) is not None


def first_difference(said: Sequence[str], came: Sequence[str]) -> tuple[int, int] | None:
    """Where the page and the output part: a line of each, or None.

    Either is the number of lines where nothing is left of it.
    """
    reached = {0}
    for number, line in enumerate(said):
        if line.strip() == ANY:
            after = set(range(min(reached), len(came) + 1))
        else:
            after = {at + 1 for at in reached if at < len(came) and is_said(line, came[at])}
        if not after:
            return number, min(reached)
        reached = after
    return None if len(came) in reached else (len(said), max(reached))


def told(said: Sequence[str], came: Sequence[str], under: int) -> str:
    """The first difference in words, with the line of the page; empty where there is none."""
    found = first_difference(said, came)
    if found is None:
        return ""
    number, at = found
    line = said[number] if number < len(said) else "(nothing more)"
    instead = came[at] if at < len(came) else "(nothing more)"
    whole = "".join(f"\n  | {each}" for each in came) or "\n  (nothing)"
    return f"line {under + number} says\n  - {line}\n  + {instead}\nall that came:{whole}"


def updated(said: Sequence[str], came: Sequence[str]) -> list[str]:
    """Write what came into what the page says, and keep ``...`` where it stood.

    The lines between two ``...`` become as many lines of the output, those that are most like
    them; ``?`` alone on a line becomes all that came.
    """
    if list(said) == ["?"]:
        return list(came)
    if first_difference(said, came) is None:
        return list(said)
    marks = [-1, *(n for n, line in enumerate(said) if line.strip() == ANY), len(said)]
    written: list[str] = []
    at = 0
    for left, right in pairwise(marks):
        piece = list(said[left + 1 : right])
        if left == -1 and right == len(said):
            lines, at = list(came), len(came)
        elif left == -1:
            lines, at = list(came[: len(piece)]), len(piece)
        elif right == len(said):
            at = max(at, len(came) - len(piece))
            lines = list(came[at:]) if piece else []
        else:
            at = _most_like(piece, came, at)
            lines = list(came[at : at + len(piece)])
            at += len(piece)
        written += _keeping_gaps(piece, lines)
        if right < len(said):
            written.append(said[right])
    return written


def _most_like(piece: Sequence[str], came: Sequence[str], start: int) -> int:
    """Line from which on the output is most like a piece of the page."""
    text = "\n".join(piece)
    last = max(start, len(came) - len(piece))

    def likeness(at: int) -> float:
        window = "\n".join(came[at : at + len(piece)])
        return difflib.SequenceMatcher(None, text, window, autojunk=False).ratio()

    return max(range(start, last + 1), key=likeness)


def _keeping_gaps(said: Sequence[str], came: Sequence[str]) -> list[str]:
    """Lines that came, those with ``...`` in them as the page has them where they still hold."""
    gaps = [line for line in said if ANY in line]
    return [next((gap for gap in gaps if is_said(gap, line)), line) for line in came]


# A clipped area or a mark, named by a hash of its corners.
_AREA = re.compile(r"(?<=-)[pm][0-9a-f]{10}\b")


def same_drawing(said: str, came: str, tolerance: float = 1e-3) -> bool:
    """Whether two figures have the same text and the same numbers but for rounding, which the names
    of areas and marks follow.
    """
    said, came = (_AREA.sub("area", text) for text in (said, came))
    if said == came:
        return True
    if _NUMBER.sub("#", said) != _NUMBER.sub("#", came):
        return False
    pairs = zip(_NUMBER.findall(said), _NUMBER.findall(came), strict=True)
    return all(
        abs(float(a) - float(b)) <= tolerance * max(1.0, abs(float(a))) for a, b in pairs if a != b
    )
