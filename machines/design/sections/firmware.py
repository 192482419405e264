"""The key ``control.firmware``: whose loops are to run the drive."""

from __future__ import annotations

from typing import Annotated, Any, get_args

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
)
from pydantic_core import CoreSchema

from dqforge.machines.design.settings import FirmwareSettings
from dqforge.machines.entries.kinds import Positive, Section
from dqforge.machines.entries.rules import EntryError, not_one_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import Firmware


class FirmwareSection(Section):
    """Third-party firmware: its name, or a mapping with settings that are not to be chosen."""

    name: Firmware = Field(description="whose loops are evaluated, and for which gains are chosen")
    pll_kp: Positive | None = Field(
        default=None,
        description="of the phase-locked loop that makes the speed (1/s); default: chosen",
    )
    pll_ki: Positive | None = Field(
        default=None,
        description="of the phase-locked loop that makes the speed (1/s^2); default: chosen",
    )

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """The name alone is permitted, too."""
        return {"anyOf": [{"enum": list(get_args(Firmware)), "type": "string"}, handler(core)]}


def _named(value: object) -> object:
    """A mapping for the name of a firmware; other values as they are."""
    if not isinstance(value, str):
        return value
    if value not in get_args(Firmware):
        raise EntryError(not_one_of(value, get_args(Firmware)))
    return {"name": value}


AnyFirmware = Annotated[FirmwareSection, BeforeValidator(_named)]


def check_firmware(
    section: FirmwareSection | None, document: YamlDocument, *, any_back_emf: bool, gains: bool
) -> None:
    """Check what the key needs; raises `InputError` with a position.

    ``any_back_emf`` says that the machine is one of model: waveform, ``gains`` is control.gains.
    """
    path = ("control", "firmware")
    if section is None:
        return
    if not gains:
        raise document.error(
            "control.firmware needs gains, and control.gains is false; remove one of them",
            path,
            key=True,
        )
    if any_back_emf:
        raise document.error(
            "control.firmware: no such firmware controls machines of model: waveform in its own "
            "structure; remove it",
            path,
            key=True,
        )
    if (section.pll_kp is None) != (section.pll_ki is None):
        given = "pll_kp" if section.pll_ki is None else "pll_ki"
        raise document.error(
            "control.firmware: pll_kp and pll_ki belong together; write both, or neither to have "
            "them chosen",
            (*path, given),
            key=True,
        )


def read_firmware(section: FirmwareSection | None) -> FirmwareSettings | None:
    """The firmware with what is given of it."""
    if section is None:
        return None
    if section.pll_kp is None or section.pll_ki is None:
        return FirmwareSettings(section.name)
    return FirmwareSettings(section.name, (section.pll_kp, section.pll_ki))
