"""JSON of others: values with their paths, so that each complaint names its place."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from typing import Any

from dqforge.machines.devices.checks import Place
from dqforge.machines.errors import InputError
from dqforge.machines.wording import shown

_MOST_ENTRIES = 200


_MOST_POINTS = 2000


class Node:
    """A value of the file with its path."""

    __slots__ = ("path", "source", "value")

    def __init__(self, value: Any, path: str, source: str) -> None:
        self.value, self.path, self.source = value, path, source

    @property
    def place(self) -> Place:
        """Where the value stands."""
        return Place(self.source, self.path or "the file")

    def __getitem__(self, key: str) -> Node:
        """Value of a key, None where there is none; raises `InputError` if this is no object."""
        if not isinstance(self.value, dict):
            raise self.place.fault(f"expected an object with keys such as '{key}'; write {{...}}")
        return Node(self.value.get(key), f"{self.path}.{key}" if self.path else key, self.source)

    def __iter__(self) -> Iterator[Node]:
        """Entries of a list; none of null."""
        if self.value is None:
            return iter(())
        if not isinstance(self.value, list):
            raise self.place.fault("expected a list; write [...]")
        if len(self.value) > _MOST_ENTRIES:
            raise self.place.fault(
                f"the list has {len(self.value)} entries; write at most {_MOST_ENTRIES}"
            )
        return iter(
            [Node(part, f"{self.path}[{k}]", self.source) for k, part in enumerate(self.value)]
        )

    def number(self) -> float:
        """Finite number; raises `InputError` if this is none."""
        found = self.optional()
        if found is None:
            raise self.place.fault("the number is missing; write it")
        return found

    def optional(self) -> float | None:
        """Finite number, or None for null."""
        value = self.value
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.place.fault(
                f"{shown(value)[:60]} is not a number; write one without quotes and units"
            )
        try:
            found = float(value)
        except OverflowError:
            found = math.inf
        if not math.isfinite(found):
            raise self.place.fault(f"{found} is not finite; write a number, or remove the point")
        return found

    def pair(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Two lists of numbers of equal length."""
        if not (
            isinstance(self.value, list)
            and len(self.value) == 2
            and all(isinstance(r, list) for r in self.value)
        ):
            raise self.place.fault("expected two lists; write [[x0, x1, ...], [y0, y1, ...]]")
        left, right = self.value
        if not left or len(left) != len(right):
            raise self.place.fault(
                f"the lists have {len(left)} and {len(right)} numbers; write as many of both"
            )
        if len(left) > _MOST_POINTS:
            raise self.place.fault(
                f"the curve has {len(left)} points; write at most {_MOST_POINTS}"
            )
        rows = [
            tuple(
                Node(part, f"{self.path}[{k}][{j}]", self.source).number()
                for j, part in enumerate(row)
            )
            for k, row in enumerate(self.value)
        ]
        return rows[0], rows[1]

    def text(self) -> str:
        """Short text, '' for anything else."""
        return self.value if isinstance(self.value, str) else ""


def parsed(content: bytes, source: str) -> Any:
    """Content of a JSON file, not-finite numbers included.

    Raises `InputError` with a position if it is none.
    """
    try:
        return json.loads(content.decode("utf-8-sig"))
    except UnicodeDecodeError as error:
        message = f"byte {error.start} is not UTF-8; save the file with the encoding UTF-8"
        raise InputError(message, source=source) from None
    except json.JSONDecodeError as error:
        message = f"not JSON: {error.msg}; export the device again"
        raise InputError(message, source=source, line=error.lineno, column=error.colno) from None
    except RecursionError:
        raise InputError(
            "not a device: nested too deeply; export the device again", source=source
        ) from None
    except ValueError:
        raise InputError("a number has too many digits; write at most 17", source=source) from None
