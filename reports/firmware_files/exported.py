"""Files of a firmware from what was solved for it, each read back and held against that."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge import __version__
from dqforge.machines.errors import InputError, VerificationError
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues
from dqforge.reports.firmware.registry import TARGETS
from dqforge.reports.firmware.target import FileTitle, Target
from dqforge.reports.firmware.text_file import TextFile, decoded_file
from dqforge.reports.firmware_files.recognised import Targets, in_file, read_file, together

if TYPE_CHECKING:
    from dqforge.machines.design.design import Design
    from dqforge.optimizer.firmware.solve import FirmwareFit


def file_title(design: Design, fit: FirmwareFit) -> FileTitle:
    """What stands at the head of the files of a design."""
    return FileTitle(
        design.export.prefix,
        design.name,
        design.digest,
        __version__,
        tuple(shortfall.words for shortfall in fit.shortfalls),
    )


def target_named(fit: FirmwareFit, targets: Targets = TARGETS) -> Target:
    """The target of what was solved; raises InputError where its files are not written."""
    found = targets.get(fit.name)
    if found is None:
        raise InputError(f"export.firmware: files of {fit.name} are not written; leave it out")
    return found


def firmware_files(
    design: Design,
    fit: FirmwareFit,
    existing: TextFile | None = None,
    targets: Targets = TARGETS,
) -> dict[str, bytes]:
    """Files of a firmware by name.

    Args:
        design: What was solved.
        fit: What the firmware is given of it.
        existing: A file of the firmware whose other fields are kept; it is then among the files
            under its own name, in its own encoding.
        targets: Those of the package, or others.

    Raises:
        InputError: The existing file is not one of the firmware.
        VerificationError: What was written does not read back as what was to be written.
    """
    target = target_named(fit, targets)
    if existing is None:
        files = target.write(fit.configuration, file_title(design, fit), None)
    else:
        files = _into(design, fit, existing, target)
    read_back(files, fit.configuration, target, whole=existing is None)
    return files


def _into(design: Design, fit: FirmwareFit, existing: TextFile, target: Target) -> dict[str, bytes]:
    """The existing file with the values of the design, and no other file."""
    check_existing(existing, target)
    own = PurePath(existing.source).name
    try:
        with in_file(existing.source):
            files = target.write(fit.configuration, file_title(design, fit), existing.text)
    except InputError as error:
        error.source = existing.source  # which writers do not know
        raise
    alike = [name for name in files if PurePath(name).suffix == PurePath(own).suffix]
    readable = [name for name in alike or files if _recognised(target, own, files[name])]
    if not readable:
        raise InputError(
            f"cannot be rewritten as a file of {target.title}; leave --into out",
            source=existing.source,
        )
    text = files[readable[0]].decode("utf-8")
    return {own: existing.encoded(text.replace("\r\n", "\n"))}


def check_existing(existing: TextFile, target: Target) -> None:
    """Refuse a file whose fields cannot be kept.

    Raises:
        InputError: It is not one of the firmware, or not what that writes; with the line.
    """
    if not target.recognise(PurePath(existing.source).name, existing.text):
        raise InputError(
            f"is no file of {target.title}; name one that it writes",
            source=existing.source,
            line=1,
        )
    read_file(target, existing)


def _recognised(target: Target, name: str, content: bytes) -> bool:
    return target.recognise(name, content.decode("utf-8", "replace"))


def read_back(
    files: Mapping[str, bytes], configuration: Configuration, target: Target, *, whole: bool = True
) -> tuple[str, ...]:
    """Read the files back and hold them against what they were made of.

    Args:
        files: By name.
        configuration: What they were made of.
        target: Whose they are.
        whole: Whether they may say nothing else; false for files with fields of others.

    Returns:
        Names of the files that a reader knows; others (a script beside the file) are not read.

    Raises:
        VerificationError: One of them says something else, or none is known.
    """
    known = _known(files, target)
    names, found = ", ".join(file.source for file in known), together(target, known)
    if not whole:
        alone = target.read_several is not None
        decided = _without(_own(configuration) if alone else configuration, target.of_project)
        if target.one_meaning:
            decided = replace(decided, version=found.version)
        differences = [(names, misread(decided, found))]
    else:
        # A file of several may say less than they do together (one inductance, without the ratio).
        part = _own if len(known) > 1 and target.read_several is not None else _whole
        differences = [
            (file.source, contradicting(part(configuration), part(read_file(target, file))))
            for file in known
        ]
        differences.append((names, differing(configuration, found)))
    for source, difference in differences:
        if difference:
            raise VerificationError(f"{source}: reads back as something else: {difference}")
    return tuple(file.source for file in known)


# Relative difference of values that two ages of a format print with different digits.
_OTHER_DIGITS = 1e-5


def _own(configuration: Configuration) -> Configuration:
    """What a file says by its own names, without what is worked out of several of them: one file
    of several, in which values of others stand, says that only with the others.
    """
    return replace(configuration, drive=DriveValues(), current_d=None, current_q=None, speed=None)


def _without(configuration: Configuration, names: frozenset[str]) -> Configuration:
    own = {key: value for key, value in configuration.own.items() if key not in names}
    return replace(configuration, own=own)


def _whole(configuration: Configuration) -> Configuration:
    return configuration


def _known(files: Mapping[str, bytes], target: Target) -> list[TextFile]:
    """Those of the files that the target's reader knows."""
    decoded = [decoded_file(content, name) for name, content in files.items()]
    known = [file for file in decoded if target.recognise(PurePath(file.source).name, file.text)]
    if not known:
        raise VerificationError(
            f"{', '.join(files)}: the reader of {target.method.name} does not know its own files"
        )
    return known


def read_files(files: Mapping[str, bytes], target: Target) -> Configuration:
    """What the files that a reader knows say together, with the places of the values."""
    return together(target, _known(files, target))


def differing(wanted: Configuration, found: Configuration, *, whole: bool = True) -> str:
    """The first difference of two configurations in what they say, "" where there is none.

    Unless they are held against each other as a whole, the second may say more than the first.
    """
    one, other = _values(wanted), _values(found)
    if not whole:
        one = {key: value for key, value in one.items() if value is not None}
        other = {key: value for key, value in other.items() if key in one}
    for key in [*one, *(key for key in other if key not in one)]:
        if one.get(key) != other.get(key):
            return f"{key} is {other.get(key)}, not {one.get(key)}"
    return ""


def misread(wanted: Configuration, found: Configuration) -> str:
    """The first value that a file with fields of others says differently, "" where there is none.

    Such a file holds the names of its own age alone, so that it may say less. Names of another
    age may stand for other numbers: what they amount to is held against each other then, as
    nearly as their digits allow.
    """
    if wanted.version == found.version:
        return contradicting(wanted, found)
    one, other = _values(replace(wanted, own={})), _values(replace(found, own={}))
    for key, value in one.items():
        read = other.get(key)
        if not isinstance(value, (int, float)) or not isinstance(read, (int, float)):
            continue
        if not math.isclose(value, read, rel_tol=_OTHER_DIGITS):
            return f"{key} is {read}, not {value}"
    return ""


def contradicting(wanted: Configuration, found: Configuration) -> str:
    """The first value that both state, and state differently; "" where there is none."""
    one, other = _values(wanted), _values(found)
    for key, value in one.items():
        if value is not None and other.get(key) is not None and other[key] != value:
            return f"{key} is {other[key]}, not {value}"
    return ""


def _values(configuration: Configuration) -> dict[str, object]:
    """What a configuration says, by name, without where it stands and what is said of it."""
    plain = replace(configuration, own={}, origins={})
    found: dict[str, object] = {
        "firmware": plain.firmware,
        "version": plain.version,
        **{name: getattr(plain.drive, name) for name in plain.drive.__slots__},
    }
    for name in ("current_d", "current_q", "speed"):
        gains = getattr(plain, name)
        found[f"{name}.kp"] = None if gains is None else gains.kp
        found[f"{name}.ki"] = None if gains is None else gains.ki
    return found | {f"own.{key}": value for key, value in configuration.own.items()}
