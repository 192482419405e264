"""Words of messages: input values as they are shown, and what an unknown word
may have been meant to be.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def shown(value: object) -> str:
    """Text of an input value for an error message: quoted, one line, printable,
    at most 40 characters.
    """
    text = str(value)
    text = text if len(text) <= 40 else text[:37] + "..."
    return "'" + "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text) + "'"


def close_matches(word: str, candidates: Iterable[str], limit: int = 2) -> list[str]:
    """Candidates that `word` may have been meant to be, best first.

    A candidate that differs in upper and lower case alone leaves no doubt,
    and is then the only one.
    """
    known = list(candidates)
    folded = [c for c in known if c.casefold() == word.casefold()]
    if folded:
        return [max(folded, key=lambda c: sum(a == b for a, b in zip(c, word, strict=False)))]
    return difflib.get_close_matches(word, known, n=limit, cutoff=0.6)
