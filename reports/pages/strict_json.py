"""JSON as dqforge writes it, read so that no two readers take it for different things."""

from __future__ import annotations

import json
from typing import Any


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise ValueError("a key stands twice")
    return found


def _constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")


def strict_json(content: str | bytes) -> Any:
    """Plain data of a document.

    Raises:
        ValueError: It is no JSON, a key stands twice in one object, or a number is not finite.
        RecursionError: It is nested too deeply.
    """
    return json.loads(content, object_pairs_hook=_unique, parse_constant=_constant)
