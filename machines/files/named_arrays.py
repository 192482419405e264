"""Named arrays, which every file of a flux map is made of before anybody asks what they mean,
and their limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

MOST_BYTES = 256_000_000  # Decoded bytes of all arrays of a file.
MOST_POINTS = 4_000_000  # Values of one array of a file.
_MOST_LISTED = 20


@dataclass(frozen=True, slots=True)
class NamedArray:
    """One array of a file: where it stands, the last part of that, its values and its
    declared unit ('' if none).

    ``lines`` are the one-based lines of a text table that the values of a column stand in,
    shape (K,).
    """

    path: str
    name: str
    values: NDArray[Any]
    unit: str = ""
    lines: NDArray[np.intp] | None = None

    @property
    def group(self) -> str:
        """Where the array stands without its name."""
        return self.path.removesuffix(self.name)

    @property
    def labels(self) -> tuple[str, str, str]:
        """What a user may call the array."""
        return self.path, self.name, f"{self.name} [{self.unit}]"

    @property
    def title(self) -> str:
        """Path with shape, or with what the array holds instead of numbers."""
        path = f"{self.path} [{self.unit}]" if self.unit else self.path
        return f"{path} {self.values.shape}" if self.numeric else f"{path} ({self.held})"

    @property
    def numeric(self) -> bool:
        """Whether the array holds numbers."""
        return self.values.dtype.kind in "iufc"

    @property
    def held(self) -> str:
        """What the array holds, if not numbers."""
        names = {
            "O": "Python objects, cells or references",
            "U": "text",
            "S": "text",
            "b": "truth values",
        }
        return names.get(self.values.dtype.kind, "records")


def listed(arrays: Sequence[NamedArray]) -> str:
    """Names and shapes of arrays, in one line."""
    more = f" and {len(arrays) - _MOST_LISTED} more" if len(arrays) > _MOST_LISTED else ""
    return (
        ", ".join(array.title for array in arrays[:_MOST_LISTED]) + more
        if arrays
        else "no arrays at all"
    )


def check_bytes(total: int, source: str) -> None:
    """Refuse arrays that take too much memory once decoded, as those of a small archive may."""
    if total > MOST_BYTES:
        message = f"the arrays take more than {MOST_BYTES / 1e6:g} MB once decoded"
        raise InputError(f"{message}; save those of the map alone, or a coarser one", source=source)


@contextmanager
def reading(form: str, source: str) -> Iterator[None]:
    """Around a library's reader, which raises anything for a damaged file:
    that becomes one line for the user.

    Raises:
        InputError: What was raised within; of one that the library did not know as such its reason,
            and what to do.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(
            f"cannot read this {form} file ({reason}); save it again", source=source
        ) from error
