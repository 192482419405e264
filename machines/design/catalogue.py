"""The library of complete designs that ships with the package, and the file that
a new design starts from.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dqforge.machines.files.library_files import DESIGNS, TEMPLATE

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design


def names() -> list[str]:
    """Names of the designs in the library, in alphabetical order."""
    return DESIGNS.names()


def read_text(name: str) -> bytes:
    """Bytes of a design in the library; raises `InputError` when there is none of this name."""
    return DESIGNS.read(name)


def load(name: str, settings: Sequence[str] = ()) -> Design:
    """Design from the library, with keys set as by `load_text`.

    Raises `InputError` when there is none of this name.
    """
    from dqforge.machines.design.loader import load_text

    return load_text(read_text(name), DESIGNS.source(name), settings=settings)


def template(machine: str | None = None) -> bytes:
    """Bytes of a commented design file to start from: one of the library, or a general one.

    Raises:
        InputError: There is no design of this name.
    """
    return DESIGNS.read_unlisted(TEMPLATE) if machine is None else read_text(machine)
