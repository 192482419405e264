"""The design file as a schema: every key with its meaning, unit and default.

The models hold what the file says; `dqforge.machines.design.catalogue` turns it into a
`dqforge.machines.design.design.Design`.
"""

from __future__ import annotations

import re
from typing import Any

from pydantic import Field

from dqforge.machines.design.sections.control import ControlSection
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.field_weakening import WeakeningSection
from dqforge.machines.design.sections.fit import FitSection
from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.losses import LossSection
from dqforge.machines.design.sections.machine_schema import MachineSection
from dqforge.machines.design.sections.modulation_choice import ChoiceSection
from dqforge.machines.design.sections.operation import OperationSection
from dqforge.machines.design.sections.simulation import SimulationSection
from dqforge.machines.design.sections.waveform import WaveformSection
from dqforge.machines.entries.former_keys import deprecated_properties
from dqforge.machines.entries.kinds import (
    About,
    Name,
    Section,
    Version,
)


class DesignFile(Section):
    """Design of a motor drive: machine, inverter, control, and what is to be generated."""

    dqforge: Version = Field(description="version of this format")
    name: Name = Field(description="one line that names the design, at most 80 characters")
    about: About = Field(default="", description="a paragraph on the design")
    machine: MachineSection
    inverter: InverterSection
    control: ControlSection = Field(default_factory=ControlSection)
    operation: OperationSection = Field(default_factory=OperationSection)
    fit: FitSection = Field(default_factory=FitSection)
    losses: LossSection | None = Field(default=None, description="loss comparison, optional")
    waveform: WaveformSection = Field(
        default_factory=WaveformSection, description="phase currents, for machine.model waveform"
    )
    field_weakening: WeakeningSection | None = Field(
        default=None, description="two-dimensional current references, optional"
    )
    modulation_choice: ChoiceSection | None = Field(
        default=None, description="choice of modulator and switching frequency, optional"
    )
    simulation: SimulationSection | None = Field(
        default=None, description="simulation in the time domain, optional"
    )
    export: ExportSection = Field(default_factory=ExportSection)


# Name of the schema; 1 is the version of the format. No host is promised, so it is no address.
SCHEMA_ID = "urn:dqforge:schema:design:1"

_SIMPLE = (
    str,
    int,
    float,
    list,
)  # defaults worth showing; those of whole sections repeat their keys


def json_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the design file, for editors and for documentation."""
    return named_schema(DesignFile, SCHEMA_ID, "dqforge design file")


def named_schema(model: type[Section], identifier: str, title: str) -> dict[str, Any]:
    """Tidied JSON Schema of the model of a file.

    Args:
        model: What the file is read into.
        identifier: Its ``$id``, an absolute URI.
        title: What editors call it.
    """
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": identifier,
        "title": title,
    }
    schema: dict[str, Any] = tidied(model.model_json_schema())
    return head | schema


def tidied(schema: Any) -> Any:
    """Schema without generated titles and without null, which the reader refuses."""
    if isinstance(schema, list):
        return [tidied(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    tidy: dict[str, Any] = {}
    for key, value in schema.items():
        if (key == "title" and isinstance(value, str)) or (
            key == "default" and not isinstance(value, _SIMPLE)
        ):
            continue
        if key == "properties":
            tidy[key] = tidied(deprecated_properties(value))
        elif key == "anyOf":
            choices = [choice for choice in value if choice != {"type": "null"}]
            # An optional entry with several forms arrives as a choice within a choice.
            tidy |= tidied(choices[0]) if len(choices) == 1 else {"anyOf": tidied(choices)}
        elif key == "description" and isinstance(value, str):
            # Docstrings are wrapped; a description has one line for each of its paragraphs.
            tidy[key] = re.sub(r"(?<!\n)\n(?!\n)", " ", value)
        else:
            tidy[key] = tidied(value)
    return tidy
