"""Files that ship with the package, found by name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable

from dqforge.machines.errors import InputError
from dqforge.machines.wording import close_matches, shown

_SUFFIX = ".yaml"


# Names are matched before they meet the file system, so none can leave the folder.
_NAME = re.compile(r"[a-z0-9]+(?:-[a-z0-9]+)*")


@dataclass(frozen=True, slots=True)
class LibraryFiles:
    """YAML files of one kind below the folder ``library``.

    Parameters
    ----------
    kind:
        What one of them holds, for messages.
    below:
        Folder below ``library``; empty for itself.
    unlisted:
        Names that are no entries of the library.
    """

    kind: str
    below: str = ""
    unlisted: tuple[str, ...] = ()

    def _folder(self) -> Traversable:
        library = resources.files("dqforge.machines") / "library"
        return library / self.below if self.below else library

    def names(self) -> list[str]:
        """Names of the entries, in alphabetical order."""
        files = (entry.name for entry in self._folder().iterdir() if entry.name.endswith(_SUFFIX))
        found = (name.removesuffix(_SUFFIX) for name in files)
        return sorted(name for name in found if name not in self.unlisted)

    def read(self, name: str) -> bytes:
        """Bytes of the entry of a name.

        Raises
        ------
        InputError
            There is none of this name; the message has those that are like it.
        """
        known = self.names()
        if not _NAME.fullmatch(name) or name not in known:
            matches = close_matches(name, known) or [
                part for part in known if name and name in part
            ]
            hint = (
                f"did you mean {' or '.join(matches[:2])}?"
                if matches
                else f"there are {', '.join(known)}"
            )
            raise InputError(f"no {self.kind} {shown(name)} in the library; {hint}")
        return self.read_unlisted(name)

    def read_unlisted(self, name: str) -> bytes:
        """Bytes of a file that is there, listed or not."""
        return (self._folder() / self.source(name)).read_bytes()

    def source(self, name: str) -> str:
        """What messages call the file of an entry."""
        return name + _SUFFIX
