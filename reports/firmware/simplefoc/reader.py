"""SimpleFOC's motors read: sketches, the header that is written, lines of the Commander."""

from __future__ import annotations

from pathlib import PurePath

from dqforge.optimizer.firmware.configuration import Configuration
from dqforge.optimizer.firmware.simplefoc_format.simplefoc_configuration import configuration
from dqforge.reports.firmware.simplefoc import script, sketch


def recognise(name: str, text: str) -> bool:
    """Whether a file sets members of a motor of SimpleFOC.

    Parameters
    ----------
    name:
        Its name.
    text:
        Its text.
    """
    if "BLDCMotor" in text:
        return name.lower().endswith((".h", ".hpp", ".ino", ".cpp", ".cc", ".c"))
    return script.is_script(text)


def read(text: str, place: str) -> Configuration:
    """The configuration of the motor in a file.

    Parameters
    ----------
    text:
        The file's text.
    place:
        Its path, for messages.

    Raises
    ------
    InputError
        It has no motor of SimpleFOC, or a value is no number; with the line.
    """
    name = PurePath(place).stem
    if "BLDCMotor" not in text and script.is_script(text):
        own, origins = script.members_of(text, place)
        return configuration(name, own, origins)
    found = sketch.sketch_of(text, place)
    own, origins = sketch.members_of(found)
    remarks = ()
    if found.others:
        others = ", ".join(found.others)
        remarks = (f"of several motors the first, {found.motor}, is read; {others} are not",)
    return configuration(name, own, origins, remarks)
