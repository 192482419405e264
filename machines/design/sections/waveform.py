"""The section ``waveform``: what may be written, what is made of it,
and what is checked across it.
"""

from __future__ import annotations

from pydantic import Field

from dqforge.machines.design.sections.inverter import InverterSection
from dqforge.machines.design.sections.machine_schema import MachineSection
from dqforge.machines.design.settings import (
    WaveformSettings,
    settings_from,
)
from dqforge.machines.entries.kinds import (
    Current,
    Section,
    Share,
    SlewRate,
    SmallShare,
    Speed,
    Torque,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    OpenPhase,
    WaveformForm,
)

_WAVEFORM = WaveformSettings()


class WaveformSection(Section):
    """Phase currents of a machine whose back-EMF is not sinusoidal."""

    torque: Torque | None = Field(
        default=None, description="torque of the comparison (N m); default: most of dq"
    )
    speed: Speed | None = Field(
        default=None, description="its mechanical speed (rad/s; write rpm); default: base speed"
    )
    ripple: Share | None = Field(
        default=None, description="permitted deviation of the torque (write 5 %); default 0"
    )
    neutral_current: Current | None = Field(
        default=None, description="largest neutral current (A); default: none"
    )
    open_phase: OpenPhase | None = Field(
        default=None, description="a phase that carries no current: a, b or c"
    )
    slew_rate: SlewRate | None = Field(
        default=None, description="largest rate of change of a current (A/s)"
    )
    form: WaveformForm = Field(default=_WAVEFORM.form, description="what the firmware evaluates")
    error: SmallShare | None = Field(
        default=None, description="largest error of it over the peak; default 0.5 %"
    )


def check_waveform(
    section: WaveformSection,
    machine: MachineSection,
    inverter: InverterSection,
    document: YamlDocument,
) -> None:
    """Check that the section on phase currents, and a topology with a neutral,
    have a machine they are for.

    Raises `InputError` with a position.
    """
    is_waveform = machine.model == "waveform"
    if section.model_fields_set and not is_waveform:
        message = (
            "waveform: phase currents are shaped for a machine of model: waveform; write it, or "
            "remove the section"
        )
        raise document.error(message, ("waveform",), key=True)
    if machine.inductance_harmonics is not None:
        _check_saliency(section, inverter, document)
    if inverter.topology != "three-wire" and not is_waveform:
        raise document.error(
            f"inverter.topology: {inverter.topology} serves machines of model: waveform; "
            "write three-wire",
            ("inverter", "topology"),
        )
    for key in (
        () if is_waveform else ("neutral_inductance", "neutral_resistance", "midpoint_capacitance")
    ):
        if getattr(inverter, key) is not None:
            raise document.error(
                f"inverter.{key}: it serves machines of model: waveform; remove it",
                ("inverter", key),
                key=True,
            )


def _check_saliency(
    section: WaveformSection, inverter: InverterSection, document: YamlDocument
) -> None:
    """Check that nothing is asked for that needs constant inductances."""
    if section.form == "table":
        message = (
            "waveform.form: a table over the angle needs currents in proportion to the torque, "
            "which those of a machine with inductance_harmonics are not; write harmonics"
        )
        raise document.error(message, ("waveform", "form"))
    if inverter.topology == "diode-neutral":
        message = (
            "inverter.topology: diode-neutral is not offered for a machine with "
            "inductance_harmonics; write three-wire"
        )
        raise document.error(message, ("inverter", "topology"))


def read_waveform(section: WaveformSection) -> WaveformSettings:
    """What the section ``waveform`` asks for."""
    return settings_from(
        WaveformSettings,
        section,
        omega_m=si_of(section.speed),
        neutral=si_of(section.neutral_current),
        slew=si_of(section.slew_rate),
    )
