"""SimpleFOC's motors read: sketches, the header that is written, lines of the Commander."""

from __future__ import annotations

import math
from pathlib import PurePath
from typing import TYPE_CHECKING

from dqforge.optimizer.firmware.simplefoc_format import V_DC, configuration
from dqforge.optimizer.firmware.targets.simplefoc import voltage_limit
from dqforge.reports.firmware.simplefoc import script, sketch

if TYPE_CHECKING:
    from dqforge.optimizer.firmware.configuration import Configuration, Number


def recognise(name: str, text: str) -> bool:
    """Whether a file sets members of a motor of SimpleFOC.

    Args:
        name: Its name.
        text: Its text.
    """
    if "BLDCMotor" in text:
        return name.lower().endswith((".h", ".hpp", ".ino", ".cpp", ".cc", ".c"))
    return script.is_script(text)


def read(text: str, place: str) -> Configuration:
    """The configuration of the motor in a file.

    Args:
        text: The file's text.
        place: Its path, for messages.

    Raises:
        InputError: It has no motor of SimpleFOC, or a value is no number; with the line.
    """
    name = PurePath(place).stem
    if "BLDCMotor" not in text and script.is_script(text):
        own, origins = script.members_of(text, place)
        return configuration(name, own, origins)
    found = sketch.sketch_of(text, place)
    own, origins = sketch.members_of(found)
    own = _with_voltages(own)
    remarks: tuple[str, ...] = ()
    if found.others:
        others = ", ".join(found.others)
        remarks = (f"of several motors the first, {found.motor}, is read; {others} are not",)
    return configuration(name, own, origins, remarks)


def _with_voltages(own: dict[str, Number]) -> dict[str, Number]:
    """The members with the voltages that the text works out from the link, as far as that is
    known.
    """
    limit = voltage_limit(float(own[V_DC])) if V_DC in own else math.nan
    filled = {name: limit if math.isnan(value) else value for name, value in own.items()}
    return {name: value for name, value in filled.items() if not math.isnan(value)}
