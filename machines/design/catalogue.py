"""The library of complete designs that ships with the package, and the file that
a new design starts from.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from importlib import resources
from importlib.resources.abc import Traversable

from dqforge.machines.design.design import Design
from dqforge.machines.design.loader import load_text
from dqforge.machines.errors import InputError
from dqforge.machines.wording import close_matches, shown

_SUFFIX = ".yaml"


_TEMPLATE = "template"


# Names are matched before they meet the file system, so none can leave the folder.
_NAME = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*")


def _folder() -> Traversable:
    return resources.files("dqforge.machines") / "library"


def names() -> list[str]:
    """Names of the designs in the library, in alphabetical order."""
    files = (entry.name for entry in _folder().iterdir() if entry.name.endswith(_SUFFIX))
    return sorted(name.removesuffix(_SUFFIX) for name in files if name != _TEMPLATE + _SUFFIX)


def read_text(name: str) -> bytes:
    """Bytes of a design in the library.

    Raises
    ------
    InputError
        There is no design of this name.
    """
    known = names()
    if not _NAME.fullmatch(name) or name not in known:
        matches = close_matches(name, known) or [
            known_name for known_name in known if name and name in known_name
        ]
        hint = (
            f"did you mean {' or '.join(matches[:2])}?"
            if matches
            else f"there are {', '.join(known)}"
        )
        raise InputError(f"no design {shown(name)} in the library; {hint}")
    return (_folder() / (name + _SUFFIX)).read_bytes()


def load(name: str, settings: Sequence[str] = ()) -> Design:
    """Design from the library, with keys set as by `load_text`.

    Raises `InputError` when there is none of this name.
    """
    return load_text(read_text(name), name + _SUFFIX, settings=settings)


def template(machine: str | None = None) -> bytes:
    """Bytes of a commented design file to start from: one of the library, or a general one.

    Raises
    ------
    InputError
        There is no design of this name.
    """
    if machine is not None:
        return read_text(machine)
    return (_folder() / (_TEMPLATE + _SUFFIX)).read_bytes()
