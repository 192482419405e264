"""What the sections of a design say once they are read: numbers in SI units and words by their
paths, the same for every way to write them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from dqforge.machines.design.schema import DesignFile
from dqforge.machines.entries.kinds import Section
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.entries.two_sided import Between
from dqforge.machines.places import KeyPath
from dqforge.machines.records import dataclass

_OF_NO_MEANING = ("name", "about")  # Keys that change no number of a row.


@dataclass(frozen=True, slots=True)
class ResolvedValues:
    """Numbers (SI units) and words (kinds, names, what is left out) of a design by their paths."""

    numbers: Mapping[KeyPath, float]
    words: Mapping[KeyPath, str | bool | None]

    def below(self, path: KeyPath) -> ResolvedValues:
        """Those of one part."""
        length = len(path)
        return ResolvedValues(
            {key: value for key, value in self.numbers.items() if key[:length] == path},
            {key: value for key, value in self.words.items() if key[:length] == path},
        )

    def without(self, path: KeyPath) -> ResolvedValues:
        """All but those of one part."""
        length = len(path)
        return ResolvedValues(
            {key: value for key, value in self.numbers.items() if key[:length] != path},
            {key: value for key, value in self.words.items() if key[:length] != path},
        )

    def plus(self, other: ResolvedValues) -> ResolvedValues:
        """Those of both."""
        return ResolvedValues({**self.numbers, **other.numbers}, {**self.words, **other.words})


def resolved_values(file: DesignFile) -> ResolvedValues:
    """All values of a design that change what comes out of it.

    Names, origins and notes are left out; a key that the file leaves out stands with its default.
    """
    numbers: dict[KeyPath, float] = {}
    words: dict[KeyPath, str | bool | None] = {}
    for path, value in _values(file, ()):
        if isinstance(value, float):
            numbers[path] = value + 0.0  # -0 is 0
        else:
            words[path] = value
    return ResolvedValues(numbers, words)


def _values(value: object, path: KeyPath) -> Iterator[tuple[KeyPath, float | str | bool | None]]:
    """Single values with their paths."""
    if isinstance(value, Quantity):
        yield path, float(value.si)
        # The unit tells a share from a time.
        yield (*path, "kind"), f"{value.kind or ''} {value.unit}"
    elif isinstance(value, Between):
        yield from _values(value.low, (*path, "from"))
        yield from _values(value.high, (*path, "to"))
    elif isinstance(value, Section):
        yield path, type(value).__name__
        for name in type(value).model_fields:
            if path or name not in _OF_NO_MEANING:
                yield from _values(getattr(value, name), (*path, name))
    elif isinstance(value, tuple):
        yield path, f"list of {len(value)}"
        for index, part in enumerate(value):
            yield from _values(part, (*path, index))
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield path, float(value)
    else:
        yield path, value if value is None or isinstance(value, bool) else str(value)
