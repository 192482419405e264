"""What a shell offers for a word that is being typed: drives of the library and files near by.

Asked at every press of a key: nothing heavy is imported.
"""

from __future__ import annotations

import os
from pathlib import Path

from dqforge.machines.files.library_files import DESIGNS, STUDIES

_DESIGNS = (".yaml", ".yml")


def drives(begun: str) -> list[str]:
    """Drives of the library whose names begin so."""
    return [name for name in DESIGNS.names() if name.startswith(begun)]


def designs(begun: str) -> list[str]:
    """Drives of the library, and design files and folders, whose names begin so."""
    return [*drives(begun), *_near(begun)]


def studies(begun: str) -> list[str]:
    """Studies of the library, and study files and folders, whose names begin so."""
    shipped = [name for name in STUDIES.names() if name.startswith(begun)]
    return [*shipped, *_near(begun)]


def _near(begun: str) -> list[str]:
    """Files that may hold a design, and folders with a mark behind them; no hidden ones."""
    folder, part = os.path.split(begun)
    try:
        entries = sorted(Path(folder or ".").iterdir())
    except OSError:
        return []
    shown = [each for each in entries if each.name.startswith(part) and each.name[0] != "."]
    typed = begun.removesuffix(part)
    named = [(each, f"{typed}{each.name}") for each in shown]
    folders = [f"{name}/" for each, name in named if each.is_dir()]
    files = [name for each, name in named if each.suffix.lower() in _DESIGNS and each.is_file()]
    return [*folders, *files]
