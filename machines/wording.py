"""Words of messages: input values as they are shown, and what an unknown word
may have been meant to be.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

# Numbers of wires and legs, which names spell out.
_NUMERALS = {"3": "three", "4": "four", "6": "six"}


def shown(value: object, longest: int = 40) -> str:
    """Text of an input value for an error message: quoted, one line, printable,
    at most `longest` characters.
    """
    text = str(value)
    text = text if len(text) <= longest else text[: longest - 3] + "..."
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
    return difflib.get_close_matches(_spelled_out(word), known, n=limit, cutoff=0.6)


def _spelled_out(word: str) -> str:
    """`word` with a numeral before a letter written as its name: 4-leg is four-leg."""
    return re.sub(r"^[346](?=[-_ ]?[A-Za-z])", lambda found: _NUMERALS[found[0]], word)
