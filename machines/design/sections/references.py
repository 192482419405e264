"""The section ``control.references``: slopes of the references, and voltage feedback."""

from __future__ import annotations

from pydantic import Field

from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.settings import (
    ReferenceSettings,
    VoltageFeedbackSettings,
    settings_from,
)
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    Bandwidth,
    PhaseCurrent,
    Section,
    SlewRate,
    TorqueSlope,
)
from dqforge.machines.files.positioned_yaml import YamlDocument


class VoltageFeedbackSection(Section):
    """Field weakening by voltage feedback, beside the references of the map."""

    bandwidth: Bandwidth = Field(
        description="largest bandwidth at any speed (rad/s, or Hz times 2 pi)"
    )
    current: PhaseCurrent | None = Field(
        default=None,
        description="largest d current that it adds (A peak); default all that the limit leaves",
    )


class ReferencesSection(Section):
    """How fast references move, and what corrects them."""

    torque_slope: TorqueSlope | None = Field(
        default=None, description="largest slope of the torque reference (N m/s)"
    )
    current_slope: SlewRate | None = Field(
        default=None, description="largest slope of the vector of the current reference (A/s)"
    )
    voltage_feedback: VoltageFeedbackSection | None = Field(
        default=None,
        description="an integrator that weakens the field further where the voltage is at its end",
    )


def check_references(
    section: ReferencesSection | None,
    machine: Machine,
    export: ExportSection,
    document: YamlDocument,
    *,
    any_back_emf: bool,
) -> None:
    """Check what the section needs of the machine.

    ``export`` is what is emitted, ``any_back_emf`` says that the machine is one of model: waveform.
    Raises `InputError` with a position.
    """
    if section is None:
        return
    path = ("control", "references")
    if any_back_emf:
        raise document.error(
            "control.references is for machines with a sinusoidal back-EMF; remove it, or the "
            "machine's model: waveform",
            path,
            key=True,
        )
    if not set(export.control) <= {"float32"}:
        raise document.error(
            "control.references is not there in fixed point; write export.control: float32, or "
            "remove it",
            path,
            key=True,
        )
    if section.voltage_feedback is not None and machine.omega_m_max is None:
        raise document.error(
            "control.references.voltage_feedback needs the largest speed; write "
            "machine.max_speed, such as 6000 rpm",
            (*path, "voltage_feedback"),
            key=True,
        )


def read_references(section: ReferencesSection | None) -> ReferenceSettings:
    """What the section asks for, in SI units."""
    if section is None:
        return ReferenceSettings()
    feedback = section.voltage_feedback
    return settings_from(
        ReferenceSettings,
        section,
        voltage_feedback=None
        if feedback is None
        else settings_from(VoltageFeedbackSettings, feedback),
    )
