"""Records of modules by a name, each module loaded when its record is first asked for."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import TypeVar

K = TypeVar("K")
V = TypeVar("V")


class LoadedByName(Mapping[K, V]):
    """Records by name.

    Args:
        places: By name, module and attribute of the record: ``dqforge.room.module:RECORD``.
    """

    def __init__(self, places: Mapping[K, str]) -> None:
        self._places = places

    def __getitem__(self, name: K) -> V:
        module, _, attribute = self._places[name].partition(":")
        found: V = getattr(import_module(module), attribute)
        return found

    def __iter__(self) -> Iterator[K]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __contains__(self, name: object) -> bool:
        """Whether there is one of the name; nothing is loaded for that."""
        return name in self._places
