"""The section ``export``: what may be written, and what is made of it."""

from __future__ import annotations

from pydantic import Field

from dqforge.machines.design.settings import (
    ExportSettings,
    settings_from,
)
from dqforge.machines.entries.kinds import (
    ControlFormats,
    FirmwareNames,
    Prefix,
    Section,
)
from dqforge.machines.names import Application, NumberFormat

_EXPORT = ExportSettings(prefix="motor")


class ExportSection(Section):
    """The header."""

    prefix: Prefix = Field(
        default=_EXPORT.prefix, description="first part of every name in the code, a C identifier"
    )
    vectors: int = Field(
        default=_EXPORT.vectors, ge=16, le=4096, description="least number of test vectors"
    )
    control: ControlFormats = Field(
        default=_EXPORT.control,
        description="control functions as C: float32, q15, q31 or a list of them; default none",
    )
    frame_tables: bool = Field(
        default=_EXPORT.frame_tables,
        description="tables of the frames dqx and dqy over the angle, with their decoupling terms",
    )
    firmware: FirmwareNames = Field(
        default=_EXPORT.firmware,
        description=(
            "configuration files of other firmware: vesc, simplefoc, moteus, odrive, nxp, st, ti, "
            "infineon or a list of them; default none"
        ),
    )
    application: Application | None = Field(
        default=None,
        description=(
            "skeleton: a program with interrupts, offsets, alignment or start, stop and faults "
            "around the control functions, which are in float32 then; default none"
        ),
    )

    @property
    def formats(self) -> tuple[NumberFormat, ...]:
        """Formats of the control functions, each once: the program calls those in float32."""
        asked = ("float32",) if self.application and not self.control else self.control
        return tuple(dict.fromkeys(asked))


def read_export(section: ExportSection) -> ExportSettings:
    """What the section ``export`` asks for."""
    return settings_from(
        ExportSettings,
        section,
        control=section.formats,
        firmware=tuple(dict.fromkeys(section.firmware)),
    )
