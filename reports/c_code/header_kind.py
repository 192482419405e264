"""A kind of header beside the main one: its data, its way back and its harness."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from dqforge.reports.c_code.harness import Programme

SWEEP_POINTS = 20_000


SWEEP_SEED = 7


@dataclass(frozen=True, slots=True)
class FurtherHeader:
    """One kind of header.

    Parameters
    ----------
    name:
        Part of the file names ``<prefix>_<name>.h`` and of the key
        ``<name>_header`` in ``result.json``.
    read:
        Model from its plain data and the whole result; raises InputError where they
        are not what dqforge writes.
    programme:
        Harness, inputs and results of a model.
    vectors:
        Whether ``<prefix>_<name>_vectors.h`` is written too.
    """

    name: str
    read: Callable[[Mapping[str, Any], Mapping[str, Any]], Any]
    programme: Callable[[Any], Programme]
    vectors: bool = True

    @property
    def key(self) -> str:
        """Key of its plain data in ``result.json``."""
        return f"{self.name}_header"

    def files(self, prefix: str) -> list[str]:
        """Names of its files."""
        return [
            f"{prefix}_{self.name}.h",
            *([f"{prefix}_{self.name}_vectors.h"] if self.vectors else []),
        ]
