"""What is gathered while a design file is read: conversions, remarks,
and the files that it names.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping
from dataclasses import field
from pathlib import Path
from typing import Any, TypeVar, cast

from dqforge.machines.design import datasheet
from dqforge.machines.design.datasheet import Connection
from dqforge.machines.design.design import DesignFiles
from dqforge.machines.design.values import InputValue
from dqforge.machines.entries.rules import Quantity
from dqforge.machines.errors import InputError
from dqforge.machines.files.input_files import MEGABYTE, read_regular_file
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.flux_maps.evidence import FluxEvidence
from dqforge.machines.places import KeyPath, dotted
from dqforge.machines.records import dataclass

MAX_FILE_BYTES = 256_000_000
_MOST_RECALLED = 256
_Made = TypeVar("_Made")


def with_slashes(name: str) -> str:
    """The name of a file as every system reads it; a design from Windows may have the other kind
    of slash.
    """
    return name.replace("\\", "/")


@dataclass(frozen=True, slots=True)
class Recalled:
    """What was made once, and what making it added to each list of its `Reading`."""

    made: object
    added: tuple[tuple[Any, ...], ...]


@dataclass(slots=True)
class Reading:
    """A design file in the course of being read.

    Args:
        document: The file with its positions.
        text: Its bytes.
        folder: Where the files lie that it names, or None where it may name none.

    ``converted`` holds for paths of converted values what is used and what was done, ``derived``
    values that follow from others, ``remarks`` sentences on what the file leaves open, ``files``
    the bytes of the files that it names, ``names`` the names of these (empty for what the package
    ships), ``flux_evidence`` what was found about its flux maps. ``connection`` is that of the
    machine's windings. ``supplied`` holds the files that may be named where they are in memory,
    None where they lie in ``folder``. ``memory`` keeps what files and coefficients became, for
    other readings that share it (`recalled`).
    """

    document: YamlDocument
    text: bytes
    folder: Path | None
    converted: dict[str, tuple[float, str]] = field(default_factory=dict)
    derived: list[InputValue] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    files: list[bytes] = field(default_factory=list)
    flux_evidence: list[FluxEvidence] = field(default_factory=list)
    connection: Connection = "star"
    names: list[str] = field(default_factory=list)
    supplied: Mapping[str, bytes] | None = None
    memory: dict[Hashable, Recalled] | None = None

    def given(self) -> DesignFiles:
        """Everything that was read, from which the same design can be read again."""
        named = {
            name: content for name, content in zip(self.names, self.files, strict=True) if name
        }
        return DesignFiles(self.text, tuple(named.items()))

    def digest(self) -> str:
        """SHA-256 of the design file, or of its bytes and the digests of the files that it names,
        in their order.
        """
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

    def machine_peak(self, quantity: Quantity, path: KeyPath) -> float:
        """Peak current of a line from a current of the machine, with a note when it was converted.

        Raises:
            InputError: The machine is in delta, and the kind leaves open whether a line or a
                winding is meant.
        """
        kind, name = quantity.kind or "peak", dotted(path)
        self.check_current_kind(quantity, path)
        value = datasheet.peak_current(quantity.si, kind, self.connection)
        parts = ["r.m.s. value times sqrt(2)"] if kind.endswith("rms") else []
        if self.connection == "delta" and kind.startswith("winding"):
            parts.append("current of a winding times sqrt(3) is that of a line")
        if parts:
            self.converted[name] = (value, "; ".join(parts))
        return value

    def check_current_kind(self, quantity: Quantity, path: KeyPath) -> None:
        """Refuse a kind of current that a delta leaves open; raises `InputError`."""
        kind = quantity.kind or "peak"
        if self.connection == "delta" and " " not in kind:
            raise self.document.error(
                f"{dotted(path)}: in a delta the current of a line is sqrt(3) times that of a "
                f"winding; write {{value: {quantity.text}, kind: line {kind}}} or kind: winding "
                f"{kind}",
                path,
            )

    def per_phase(self, quantity: Quantity, path: str) -> float:
        """Phase value of a resistance or inductance, with a note when it was converted."""
        kind = quantity.kind or "phase"
        value = datasheet.phase_resistance(quantity.si, kind, self.connection)
        if kind == "line-to-line":
            star = (
                "star connection" if self.connection == "star" else "equivalent star of the delta"
            )
            self.converted[path] = (value, f"half of the line-to-line value ({star})")
        elif self.connection == "delta":
            self.converted[path] = (
                value,
                "a third of the winding's value (equivalent star of the delta)",
            )
        return value

    def phase_flux(self, quantity: Quantity, path: str) -> float:
        """Flux linkage of a phase in Wb (peak), with a note when it was converted."""
        kind = quantity.kind or "peak"
        value = datasheet.peak_flux(quantity.si, kind, self.connection)
        parts = [f"peak of phase from the {kind} value"] if kind != "peak" else []
        if self.connection == "delta":
            parts.append("that of a winding over sqrt(3) (equivalent star of the delta)")
        if parts:
            self.converted[path] = (value, "; ".join(parts))
        return value

    def recalled(self, key: Hashable, make: Callable[[], _Made]) -> _Made:
        """What ``make`` returns, from memory where another reading has made it for ``key``.

        What it adds to this reading on the way (files, remarks, values) is added again.
        """
        if self.memory is None:
            return make()
        kept = self.memory.get(key)
        lists: tuple[list[Any], ...] = (
            self.derived,
            self.remarks,
            self.files,
            self.flux_evidence,
            self.names,
        )
        if kept is None:
            before = [len(entries) for entries in lists]
            made = make()
            added = tuple(
                tuple(entries[count:]) for entries, count in zip(lists, before, strict=True)
            )
            if len(self.memory) >= _MOST_RECALLED:
                self.memory.pop(next(iter(self.memory)))
            self.memory[key] = Recalled(made, added)
            return made
        for entries, more in zip(lists, kept.added, strict=True):
            entries.extend(more)
        return cast("_Made", kept.made)

    def is_beside(self, name: str) -> bool:
        """Whether there is such a file in the folder of the design or below it."""
        name = with_slashes(name)
        if self.supplied is not None:
            return self.supplied.get(name) is not None
        return self.folder is not None and (self.folder / name).is_file()

    def read_beside(self, name: str, path: KeyPath, most_bytes: int = MAX_FILE_BYTES) -> bytes:
        """Content of a file that the design names, from its own folder or one below it.

        Raises:
            InputError: The name leads elsewhere, or the file cannot be read or is too large.
        """
        name = with_slashes(name)
        if self.supplied is not None:
            content = self._in_memory(name, path, most_bytes)
            self.files.append(content)
            self.names.append(name)
            return content
        if self.folder is None:
            raise self.document.error("a design of the library cannot name files", path)
        home = self.folder.resolve()
        try:
            place = (home / name).resolve()
        except (OSError, RuntimeError):  # links that lead in a circle
            raise self.document.error(
                f"the links of '{name}' lead in a circle; name the file itself", path
            ) from None
        if not place.is_relative_to(home) or Path(name).is_absolute():
            raise self.document.error(
                f"the file '{name}' lies outside the folder of the design; copy it beside the "
                "design file",
                path,
            )
        try:
            if not place.exists():
                raise self.document.error(
                    f"there is no file '{name}' beside the design file; check the name", path
                )
            content = read_regular_file(place, most_bytes, name)
        except OSError as error:
            raise self.document.error(
                f"the file '{name}' cannot be read: {error.strerror}", path
            ) from None
        except InputError as error:
            if error.source != name:
                raise
            raise self.document.error(f"the file '{name}': {error.message}", path) from None
        self.files.append(content)
        self.names.append(name)
        return content

    def _in_memory(self, name: str, path: KeyPath, most_bytes: int) -> bytes:
        """One of the supplied files; raises `InputError` where it is not there or too large."""
        content = None if self.supplied is None else self.supplied.get(name)
        if content is None:
            raise self.document.error(
                f"there is no file '{name}' beside the design file; check the name", path
            )
        if len(content) > most_bytes:
            raise self.document.error(
                f"the file '{name}' has {len(content) / MEGABYTE:.4g} MB, at most "
                f"{most_bytes / MEGABYTE:.4g} MB can be read",
                path,
            )
        return content


# A torque that is written as the limit itself, rounded, is meant to be the limit.
ROUNDING_OF_DATA = 1e-3
