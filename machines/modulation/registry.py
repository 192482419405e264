"""All modulators by name: the records of the files in ``families``, in the order of
`dqforge.machines.names.ModulationName`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import get_args

from dqforge.machines.modulation import families
from dqforge.machines.modulation.modulator import Modulator
from dqforge.machines.names import ModulationName


def _found() -> dict[ModulationName, Modulator]:
    """The records of all files, in the order of the words; a word without a record is an error."""
    files = (
        import_module(f"{families.__name__}.{file.name}")
        for file in iter_modules(families.__path__)
    )
    records = {record.name: record for file in files for record in file.MODULATORS}
    return {name: records[name] for name in get_args(ModulationName)}


_RECORDS = _found()

# The modulators by name, continuous ones first.
MODULATORS: Mapping[ModulationName, Modulator] = MappingProxyType(_RECORDS)


@contextmanager
def registered(*modulators: Modulator) -> Iterator[None]:
    """Let further modulators count as those of the package, as long as the context lasts.

    Args:
        modulators: Their records, whose names are new.

    Raises:
        ValueError: A name is taken.
    """
    taken = [record.name for record in modulators if record.name in _RECORDS]
    if taken:
        raise ValueError(f"there is a modulator {taken[0]} already")
    try:
        _RECORDS.update((record.name, record) for record in modulators)
        yield
    finally:
        for record in modulators:
            _RECORDS.pop(record.name, None)
