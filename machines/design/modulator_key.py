"""Keys of a design that name modulators."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, ValidatorFunctionWrapHandler, WrapValidator

from dqforge.machines.entries.kinds import Listing
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName


def _known(value: Any, words: ValidatorFunctionWrapHandler) -> Any:
    """Let a registered modulator pass; all else is judged by the words of the package."""
    return value if isinstance(value, str) and value in MODULATORS else words(value)


ModulatorKey = Annotated[ModulationName, WrapValidator(_known)]  # The name of a modulator.

# Some modulators, each at most once.
ModulatorList = Annotated[Listing[ModulatorKey], Field(min_length=1, max_length=len(MODULATORS))]
