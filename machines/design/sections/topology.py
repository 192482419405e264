"""What the topology of the inverter asks of other keys: the choke and the capacitors that it has,
and a modulator where the design may choose one.
"""

from __future__ import annotations

from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.modulation_choice import ChoiceSection
from dqforge.machines.design.sections.operation import OperationSection
from dqforge.machines.errors import InputError
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import Topology
from dqforge.machines.topologies import TOPOLOGIES, contradiction


def check_topology(
    inverter: InverterSection,
    operation: OperationSection,
    choice: ChoiceSection | None,
    used_by: str,
    document: YamlDocument,
) -> None:
    """Check the keys that only some topologies have.

    ``used_by`` names what the midpoint of a split link is needed for, empty where for nothing.
    Raises `InputError` with a position.
    """
    _check_neutral(inverter, used_by, document)
    if TOPOLOGIES[inverter.topology].modulated:
        return
    found = contradiction("operation.modulation", inverter.topology, operation.modulation)
    if found:
        raise document.error(found, ("operation", "modulation"))
    if choice is not None:
        message = (
            f"modulation_choice: {inverter.topology} has a modulator of its own, so that there is "
            "none to choose; remove the section"
        )
        raise document.error(message, ("modulation_choice",), key=True)


def _check_neutral(inverter: InverterSection, used_by: str, document: YamlDocument) -> None:
    """Check that the neutral's parts are there where they are needed, and nowhere else."""
    rule, name = TOPOLOGIES[inverter.topology], inverter.topology
    if inverter.neutral_inductance is not None and "n" not in rule.legs:
        raise _misplaced("neutral_inductance", "neutral on a leg of its own", name, document)
    conducting = "n" in rule.legs or rule.midpoint or rule.diodes
    if inverter.neutral_resistance is not None and not conducting:
        raise document.error(
            f"inverter.neutral_resistance: {name} has no conductor from the star point; remove the "
            "key",
            ("inverter", "neutral_resistance"),
            key=True,
        )
    if inverter.midpoint_capacitance is not None and not rule.midpoint:
        raise _misplaced("midpoint_capacitance", "link in two halves", name, document)
    if rule.midpoint and used_by and inverter.midpoint_capacitance is None:
        message = (
            f"inverter.topology: {name} needs midpoint_capacitance for {used_by}; write "
            "midpoint_capacitance: 4.7 mF, both halves of the link together"
        )
        raise document.error(message, ("inverter", "topology"))


def _misplaced(key: str, what: str, name: Topology, document: YamlDocument) -> InputError:
    other = next(
        topology
        for topology, rule in TOPOLOGIES.items()
        if (rule.midpoint if key == "midpoint_capacitance" else "n" in rule.legs)
    )
    return document.error(
        f"inverter.{key}: {name} has no {what}; remove the key, or write topology: {other}",
        ("inverter", key),
        key=True,
    )
