"""A design from files of a firmware: read, written as a design file, and checked as any other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from dqforge.machines.design.catalogue import load_text, overridden, read_override
from dqforge.machines.design.numerical import numerical_errors
from dqforge.machines.errors import InputError, NoSolutionError, leading_path
from dqforge.machines.files.positioned_yaml import parse_yaml
from dqforge.machines.records import dataclass
from dqforge.optimizer.firmware.configuration import Configuration, Origin, PiGains
from dqforge.optimizer.firmware.solve import profile_of
from dqforge.reports.firmware_files.design_text import MadeDesign, design_of
from dqforge.reports.firmware_files.recognised import in_file, read_configuration

_SOURCE = "design.yaml"


@dataclass(frozen=True, slots=True)
class DesignFromFiles:
    """A design file's text, what it was made of, and keys that are missing in it, each with an
    example: those that a design needs, and those without which a part of the file is left out.
    """

    text: str
    configuration: Configuration
    missing: tuple[tuple[str, str], ...]
    wanted: tuple[tuple[str, str], ...]


def design_from_files(files: Sequence[Path], settings: Sequence[str] = ()) -> DesignFromFiles:
    """A design file from files of a firmware.

    Where it lacks nothing that a design needs, it has passed the checks of every design.

    Args:
        files: Of one firmware.
        settings: Keys that are set, such as ``inverter.v_dc=48 V``.

    Raises:
        InputError: A file is of no known firmware, or a value in it is none that a design can have.
    """
    configuration, read = read_configuration(files)
    names = [Path(file.source).name for file in read]
    given = {".".join(read_override(setting).parts) for setting in settings}
    with in_file(str(files[0])):
        made = design_of(configuration, names, pll=_pll(configuration), given=given)
    text = made.text
    if settings and made.missing:
        also = " ".join(f"--set {key}='{example}'" for key, example in made.missing)
        raise InputError(
            f"the file does not say all that a design needs; give {also} as well",
            source=str(files[0]),
            line=1,
        )
    if not made.missing:
        text = _checked(text, settings, made, configuration, str(files[0]))
    return DesignFromFiles(text, configuration, made.missing, made.wanted)


def _pll(configuration: Configuration) -> PiGains | None:
    """The phase-locked loop that makes the speed of a firmware."""
    try:
        with numerical_errors():
            profile = profile_of(configuration)
    except (InputError, NoSolutionError):
        return None
    if profile.speed is None or profile.speed.feedback.kind != "pll":
        return None
    return PiGains(profile.speed.feedback.kp, profile.speed.feedback.ki)


def _origin(path: str, made: MadeDesign, configuration: Configuration) -> Origin | None:
    """Where the value of a key of the design stands, or of the first one below it."""
    below = (name for key, name in made.origins.items() if key.startswith(path) and path)
    names = (made.origins.get(path, ""), *below)
    return next(
        (configuration.origins[name] for name in names if name in configuration.origins), None
    )


def _checked(
    text: str,
    settings: Sequence[str],
    made: MadeDesign,
    configuration: Configuration,
    file: str,
) -> str:
    """The text with keys set; what is no design is refused in the place of the file that says
    it.
    """
    try:
        if settings:
            _, text = overridden(parse_yaml(text.encode("utf-8"), _SOURCE), text, settings)
        load_text(text.encode("utf-8"), _SOURCE)
    except InputError as error:
        if error.source != _SOURCE:
            raise
        path = ".".join(str(part) for part in leading_path(error.message))
        origin = _origin(path, made, configuration)
        if origin is None:
            raise InputError(error.message, source=file, line=1) from None
        message = f"{origin.key} {origin.text}: {error.message}"
        raise InputError(message, source=file, line=origin.line) from None
    return text
