"""One record per firmware whose files are written and read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from dqforge.machines.records import dataclass

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration
    from dqforge.optimizer.firmware.firmware_method import FirmwareMethod


@dataclass(frozen=True, slots=True)
class FileTitle:
    """What stands at the head of a file where its format permits: prefix of names, name of the
    design, digest of the design file, version of dqforge, and remarks (one line each).
    """

    prefix: str
    name: str
    digest: str
    version: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Target:
    """One firmware: how its files are written, recognised and read.

    Args:
        method: Its gains and its loops.
        title: Its name as people write it, with the versions that the format is that of.
        write: Files by name from a configuration; the text of an existing file, where one is given,
            is kept but for the values that the configuration decides.
        recognise: Whether a file, by its name and its text, is one of this firmware.
        read: The configuration in a text; the place (a path) is for messages. Raises InputError
            with place and line where it is not what the firmware writes.
        read_several: The configuration that several files state together, from text and place of
            each; None where each file is understood by itself.
        of_project: Own names of what a board or a project decides (scales of its sensing,
            thresholds of its faults): an existing file keeps them, whatever a new one would say.
        one_meaning: Whether an own name stands for the same number in files of every version.
    """

    method: FirmwareMethod
    title: str
    write: Callable[[Configuration, FileTitle, str | None], dict[str, bytes]]
    recognise: Callable[[str, str], bool]
    read: Callable[[str, str], Configuration]
    read_several: Callable[[Sequence[tuple[str, str]]], Configuration] | None = None
    of_project: frozenset[str] = frozenset()
    one_meaning: bool = False
