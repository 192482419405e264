"""Configuration files of other firmware: read, explained, made designs, and written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues
from dqforge.optimizer.firmware.firmware_method import JudgedFirmware, drive_values
from dqforge.optimizer.firmware.solve import Explained, FirmwareFit, explain, method_of
from dqforge.reports.firmware.design_made import (
    design_from_files,
    read_configuration,
    require_settling,
)
from dqforge.reports.firmware.target import read_text_file
from dqforge.reports.firmware.written_files import plain_explained, plain_fit
from dqforge.reports.output.folder import put_files, sha256
from dqforge.reports.plain_data import PlainData
from dqforge.reports.run import solved_files
from dqforge.reports.session.drives import in_python
from dqforge.reports.session.result import Result

Places = str | Path | Sequence[str | Path]


def _paths(files: Places) -> list[Path]:
    """One file, or several, as paths.

    Raises:
        InputError: There is none.
    """
    found = [Path(files)] if isinstance(files, str | Path) else [Path(file) for file in files]
    if not found:
        raise InputError("files: no file is named; give the file of a firmware")
    return found


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FirmwareFile(Result):
    """What files of another firmware say, and what that amounts to in its loops."""

    found: Explained

    @property
    def configuration(self) -> Configuration:
        """What they say in SI units, with origins, conventions and contradictions."""
        return self.found.configuration

    @property
    def machine(self) -> DriveValues:
        """The machine that the loops are judged on, in the timing of the files."""
        return self.found.drive

    @property
    def loops(self) -> JudgedFirmware:
        """Margins, poles and remarks of its loops; a loop is None where too little is known."""
        return self.found.judged

    def plain(self) -> PlainData:
        """By the keys of ``dqforge explain --json``."""
        return plain_explained(self.found)


def read_firmware(files: Places, *, machine: Design | None = None) -> FirmwareFile:
    """The configuration in a file of another firmware, or in several of one.

    Args:
        files: One file, or several of one firmware.
        machine: A design whose machine it runs on, in place of the one that it tells of.

    Raises:
        InputError: A file is of no known firmware, or not what that writes; with the line.
    """
    configuration, _ = read_configuration(_paths(files))
    return FirmwareFile(explain(configuration, None if machine is None else drive_values(machine)))


def design_from_firmware(files: Places, changes: Mapping[str, str] | None = None) -> Design:
    """A design of what files of another firmware say, its gains kept, judged as that firmware.

    Args:
        files: One file, or several of one firmware.
        changes: Keys that they do not say, with texts as by ``--set``: ``{"inverter.v_dc": "48
            V"}``.

    Raises:
        InputError: As `read_firmware`; or they do not say all that a design needs, and ``changes``
            neither.
    """
    paths = _paths(files)
    settings = [f"{key}={value}" for key, value in (changes or {}).items()]
    with in_python():
        made = design_from_files(paths, settings)
    if made.missing:
        keys = ", ".join(f"{key!r}: {example!r}" for key, example in made.missing)
        raise InputError(
            f"changes: the file does not contain all that a design needs; give {{{keys}}}",
            source=str(paths[0]),
        )
    with in_python():
        return load_text(made.text.encode("utf-8"), "design made of a firmware's file")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FirmwareExport(Result):
    """A design as another firmware runs it: ``files`` by name, and what they hold and cost."""

    found: FirmwareFit
    files: Mapping[str, bytes]

    @property
    def configuration(self) -> Configuration:
        """What the files say in SI units, rounded as they print it."""
        return self.found.configuration

    @property
    def loops(self) -> JudgedFirmware:
        """Margins of the loops with the rounded numbers."""
        return self.found.judged

    @property
    def shortfalls(self) -> tuple[str, ...]:
        """What the format cannot hold, one sentence each; ``found`` has the prices."""
        return tuple(shortfall.words for shortfall in self.found.shortfalls)

    def write(self, folder: str | Path) -> list[Path]:
        """Put the files into a folder; each takes the place of an old one in one piece."""
        return put_files(Path(folder), self.files)

    def plain(self) -> PlainData:
        """As ``dqforge export --for`` prints it, with the SHA-256 of each file."""
        hashes = {name: sha256(content) for name, content in self.files.items()}
        return plain_fit(self.found) | {"files": hashes}


@on_design("export")
def export_for(
    design: Design, firmware: str, *, into: str | Path | None = None, settle: bool = True
) -> FirmwareExport:
    """A design as the files of another firmware, each read back before it is given out.

    Args:
        design: The design.
        firmware: Whose files: ``vesc``, ``simplefoc``, ``moteus``, ``odrive``, ``nxp``, ``st``,
            ``ti`` or ``infineon``.
        into: An existing file whose other fields are kept.
        settle: Whether the loops are simulated, and refused where they do not settle.

    Raises:
        InputError: There is no such firmware, it needs what the design does not say, or the file is
            not its.
        NoSolutionError: Its loops do not settle on this drive; says why.
    """
    name = method_of(firmware, option="firmware").name
    existing = None if into is None else read_text_file(into)
    ((fit, files),) = solved_files(design, (name,), existing)
    if settle:
        require_settling(design, fit)
    return FirmwareExport(fit, files)
