"""Which firmware a file is of, and the configuration in it; of several files, in all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path

from dqforge.machines.design.numerical import numerical_errors
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Firmware
from dqforge.optimizer.firmware.configuration import Configuration, DriveValues
from dqforge.reports.firmware.target import TARGETS, Target, TextFile, read_text_file

Targets = Mapping[Firmware, Target]


def known_files(targets: Targets = TARGETS) -> str:
    """What can be read, in words."""
    return "; ".join(target.title for target in targets.values()) or "none yet"


def recognised(file: TextFile, targets: Targets = TARGETS) -> Target | None:
    """The target whose file it is, None where it is of none."""
    name = Path(file.source).name
    return next((one for one in targets.values() if one.recognise(name, file.text)), None)


def target_of_file(file: TextFile, targets: Targets = TARGETS) -> Target:
    """The target whose file it is.

    Raises:
        InputError: It is of none; the message lists what is known.
    """
    found = recognised(file, targets)
    if found is None:
        message = f"no firmware is known that writes this; known are: {known_files(targets)}"
        raise InputError(message, source=file.source, line=1)
    return found


def read_configuration(
    places: Sequence[str | Path], targets: Targets = TARGETS
) -> tuple[Configuration, list[TextFile]]:
    """The configuration in one file, or in several of one firmware, and those files.

    Raises:
        InputError: A file cannot be read, is of no known firmware, is not what that writes, or is
            of another one than the first.
    """
    files = [read_text_file(place) for place in places]
    target = target_of_file(files[0], targets)
    for file in files[1:]:
        other = target_of_file(file, targets)
        if other is not target:
            message = (
                f"is a file of {other.method.name}, the first is one of {target.method.name}; name "
                "files of one firmware"
            )
            raise InputError(message, source=file.source, line=1)
    return together(target, files), files


def together(target: Target, files: Sequence[TextFile]) -> Configuration:
    """The configuration that several files of one firmware state together.

    Raises:
        InputError: As `read_file`.
    """
    if target.read_several is not None and len(files) > 1:
        with in_file(files[0].source):
            return target.read_several([(file.text, file.source) for file in files])
    found = read_file(target, files[0])
    for file in files[1:]:
        found = merged(found, read_file(target, file))
    return found


def read_file(target: Target, file: TextFile) -> Configuration:
    """The configuration in one file.

    Raises:
        InputError: It is not what the firmware writes, or its numbers are beyond all bounds.
    """
    with in_file(file.source):
        return target.read(file.text, file.source)


@contextmanager
def in_file(source: str) -> Iterator[None]:
    """Block that works on a file: its refusals and numerical trouble are InputError with the file
    and a line, the first where they are about the file as a whole.
    """
    try:
        with numerical_errors():
            yield
    except NoSolutionError as error:
        raise InputError(error.message, source=source, line=1) from None
    except InputError as error:
        error.source = source if error.source is None else error.source
        error.line = 1 if error.line is None else error.line
        raise


def merged(first: Configuration, second: Configuration) -> Configuration:
    """Two files of one firmware as one; where both say something else, the first counts, and the
    contradiction is named.
    """
    drive, contradictions = {}, [*first.contradictions, *second.contradictions]
    for part in fields(DriveValues):
        mine, other = getattr(first.drive, part.name), getattr(second.drive, part.name)
        drive[part.name] = other if mine is None else mine
        if mine is not None and other is not None and mine != other:
            contradictions.append(_contradiction(first, second, part.name))
    return replace(
        first,
        drive=DriveValues(**drive),
        current_d=first.current_d or second.current_d,
        current_q=first.current_q or second.current_q,
        speed=first.speed or second.speed,
        own={**second.own, **first.own},
        origins={**second.origins, **first.origins},
        conventions=tuple(dict.fromkeys((*first.conventions, *second.conventions))),
        contradictions=tuple(dict.fromkeys(contradictions)),
    )


def _contradiction(first: Configuration, second: Configuration, name: str) -> str:
    said = [_said(configuration, name) for configuration in (first, second)]
    return f"{said[0]} and {said[1]} do not agree: the first counts"


def _said(configuration: Configuration, name: str) -> str:
    origin = configuration.origins.get(name)
    value = getattr(configuration.drive, name)
    return f"{name} {value:g}" if origin is None else f"{origin.key} {origin.text}"
