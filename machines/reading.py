"""What is gathered while a design file is read: conversions, remarks, and the files that it names."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path

from dqforge.machines import datasheet
from dqforge.machines.design import InputValue
from dqforge.machines.entries import Quantity
from dqforge.machines.errors import InputError
from dqforge.machines.input_files import read_regular_file
from dqforge.machines.yaml_source import KeyPath, YamlDocument

MAX_FILE_BYTES = 256_000_000


@dataclass(slots=True)
class Reading:
    """A design file in the course of being read.

    Parameters
    ----------
    document:
        The file with its positions.
    text:
        Its bytes.
    folder:
        Where the files lie that it names, or None where it may name none.

    ``converted`` holds for paths of converted values what is used and what was done, ``derived`` values that follow
    from others, ``remarks`` sentences on what the file leaves open, ``files`` the bytes of the files that it names.
    """

    document: YamlDocument
    text: bytes
    folder: Path | None
    converted: dict[str, tuple[float, str]] = field(default_factory=dict)
    derived: list[InputValue] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    files: list[bytes] = field(default_factory=list)

    def digest(self) -> str:
        """SHA-256 of the design file, or of its bytes and the digests of the files that it names, in their order."""
        if not self.files:
            return hashlib.sha256(self.text).hexdigest()
        whole = self.text + b"".join(hashlib.sha256(content).digest() for content in self.files)
        return hashlib.sha256(whole).hexdigest()

    def peak(self, quantity: Quantity, path: str) -> float:
        """Peak of a current entry, with a note when it was converted."""
        value = datasheet.peak_current(quantity.si, quantity.kind or "peak")
        if quantity.kind == "rms":
            self.converted[path] = (value, "r.m.s. value times sqrt(2)")
        return value

    def per_phase(self, quantity: Quantity, path: str) -> float:
        """Phase value of a resistance or inductance, with a note when it was converted."""
        value = datasheet.phase_resistance(quantity.si, quantity.kind or "phase")
        if quantity.kind == "line-to-line":
            self.converted[path] = (value, "half of the line-to-line value (star connection)")
        return value

    def is_beside(self, name: str) -> bool:
        """Whether there is such a file in the folder of the design or below it."""
        return self.folder is not None and (self.folder / name).is_file()

    def read_beside(self, name: str, path: KeyPath, most_bytes: int = MAX_FILE_BYTES) -> bytes:
        """Content of a file that the design names, from its own folder or one below it.

        Raises
        ------
        InputError
            The name leads elsewhere, or the file cannot be read or is too large.
        """
        if self.folder is None:
            raise self.document.error("a design of the library cannot name files", path)
        home = self.folder.resolve()
        try:
            place = (home / name).resolve()
        except (OSError, RuntimeError):  # links that lead in a circle
            raise self.document.error(f"the links of '{name}' lead in a circle; name the file itself", path) from None
        if not place.is_relative_to(home) or Path(name).is_absolute():
            raise self.document.error(
                f"the file '{name}' lies outside the folder of the design; copy it beside the design file", path
            )
        try:
            if not place.exists():
                raise self.document.error(f"there is no file '{name}' beside the design file; check the name", path)
            content = read_regular_file(place, most_bytes, name)
        except OSError as error:
            raise self.document.error(f"the file '{name}' cannot be read: {error.strerror}", path) from None
        except InputError as error:
            if error.source != name:
                raise
            raise self.document.error(f"the file '{name}': {error.message}", path) from None
        self.files.append(content)
        return content
