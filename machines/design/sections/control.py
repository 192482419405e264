"""The section ``control``: what may be written, what is made of it, and
what is checked across it.
"""

from __future__ import annotations

import math

from pydantic import Field

from dqforge.machines.design.design import ROUNDING_OF_DATA, Reading
from dqforge.machines.design.sections.chosen_together import chosen_together
from dqforge.machines.design.sections.control_loops import (
    CurrentLoopSection,
    SpeedLoopSection,
    check_method,
    check_schedule,
)
from dqforge.machines.design.sections.export import ExportSection
from dqforge.machines.design.sections.firmware import AnyFirmware, read_firmware
from dqforge.machines.design.sections.observer import ObserverSection, check_observer
from dqforge.machines.design.sections.per_unit import PerUnitSection, read_bases
from dqforge.machines.design.sections.references import ReferencesSection, read_references
from dqforge.machines.design.sections.six_step import SixStepSection, read_six_step
from dqforge.machines.design.sections.speed_measurement import (
    check_measurement,
    read_measurement,
)
from dqforge.machines.design.sections.start_up import StartUpSection, read_start_up
from dqforge.machines.design.sections.tolerances import TolerancesSection, read_tolerances
from dqforge.machines.design.settings import (
    ControlSettings,
    CurrentLoopSettings,
    GainWish,
    ObserverSettings,
    SpeedLoopSettings,
    StartUpSettings,
    settings_from,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    Rate,
    Section,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.names import (
    LEARNED_OBSERVERS,
    SPEED_OBSERVER,
)
from dqforge.machines.places import about
from dqforge.machines.units.quantities import format_quantity


class StartUpWithObserverSection(StartUpSection):
    """From standstill to speed without an encoder."""

    observer: ObserverSection | None = Field(
        default=None, description="estimator from standstill on, for saliency"
    )


class ControlSection(Section):
    """Sampling and controllers."""

    sampling_frequency: Rate | None = Field(
        default=None,
        description="sampling of the current control (Hz); default the switching frequency",
    )
    current_loop: CurrentLoopSection = Field(
        default_factory=CurrentLoopSection, description="current controllers"
    )
    speed_loop: SpeedLoopSection | None = Field(
        default=None, description="speed controller, if one is wanted"
    )
    observer: ObserverSection | None = Field(
        default=None, description="speed observer, if one is wanted"
    )
    per_unit: PerUnitSection = Field(
        default_factory=PerUnitSection, description="bases of the per-unit gains"
    )
    tolerances: TolerancesSection | None = Field(
        default=None,
        description="how far the drive may be from its data; every loop must hold throughout",
    )
    references: ReferencesSection | None = Field(
        default=None, description="slopes of the references, and what corrects them"
    )
    firmware: AnyFirmware | None = Field(
        default=None,
        description="firmware of others whose loops run the drive: vesc, simplefoc, ...",
    )
    six_step: SixStepSection | None = Field(
        default=None,
        description="for the observers zero-crossing and emf-integration: the six-step drive",
    )
    start_up: StartUpWithObserverSection | None = Field(
        default=None, description="from standstill to speed without an encoder"
    )
    gains: bool = Field(
        default=True, description="false: no loops are tuned, the header holds the references alone"
    )


def check_loops(control: ControlSection, machine: Machine, document: YamlDocument) -> None:
    """Check that each controller has the keys that its method needs.

    Raises `InputError` with a position.
    """
    check_method(control.current_loop, ("control", "current_loop"), document)
    check_schedule(control.current_loop, machine, document)
    wants_inertia = []
    if control.speed_loop is not None:
        check_method(control.speed_loop, ("control", "speed_loop"), document)
        check_measurement(control.speed_loop.measurement, control.observer is not None, document)
        wants_inertia.append("speed_loop")
    low = None if control.start_up is None else control.start_up.observer
    if low is not None and low.method != SPEED_OBSERVER:
        check_observer(low, document, ("control", "start_up", "observer"))
    if control.observer is not None:
        check_observer(control.observer, document)
        if control.observer.method == SPEED_OBSERVER:
            wants_inertia.append("observer")
        if machine.psi_pm == 0.0:
            message = (
                "control.observer: this observer needs a magnet flux, the machine has none; remove "
                "it"
            )
            raise document.error(message, ("control", "observer"), key=True)
    if wants_inertia and machine.inertia is None:
        message = (
            f"control.{wants_inertia[0]} needs the inertia; write machine.inertia, such as 200e-6 "
            "kg m^2"
        )
        raise document.error(message, ("control", wants_inertia[0]), key=True)


def check_observer_format(
    control: ControlSection, export: ExportSection, document: YamlDocument
) -> None:
    """Refuse integers where the observer has none.

    Raises `InputError` with a position.
    """
    method = None if control.observer is None else control.observer.method
    if method in LEARNED_OBSERVERS and not set(export.control) <= {"float32"}:
        message = (
            f"control.observer: the method '{method}' is not there in fixed point; write "
            "export.control: float32, or method: flux"
        )
        raise document.error(message, ("control", "observer", "method"))


def sampling_warning(machine: Machine, f_s: float) -> str:
    """Sentence on a sampling (Hz) that is slow against the electrical frequency at top speed,
    or an empty text.
    """
    if machine.omega_m_max is None:
        return ""
    f_e = machine.pole_pairs * machine.omega_m_max / (2.0 * math.pi)
    if f_s >= 10.0 * f_e:
        return ""
    return (
        f"at {format_quantity(machine.omega_m_max, 'rpm')} there are only {f_s / f_e:.2g} samples "
        "per electrical period; the current control needs about ten"
    )


def check_sampling(section: ControlSection, f_sw: float, document: YamlDocument) -> None:
    """Check the sampling against the switching frequency ``f_sw`` in Hz.

    Raises `InputError` with a position.
    """
    sampling = section.sampling_frequency
    if sampling is not None and not f_sw / 10.0 <= sampling.si <= 2.0 * f_sw * (
        1.0 + ROUNDING_OF_DATA
    ):
        raise document.error(
            f"control.sampling_frequency {sampling.text} does not belong to a switching frequency "
            f"of {format_quantity(f_sw, 'Hz')}; write {format_quantity(f_sw / 10.0, 'Hz')} to "
            f"{format_quantity(2.0 * f_sw, 'Hz')}",
            ("control", "sampling_frequency"),
        )


def _left_open(section: ControlSection) -> bool:
    """Whether a speed loop on a position observer is left to the rule for both."""
    loop, observer = section.speed_loop, section.observer
    if loop is None or observer is None or observer.method == SPEED_OBSERVER:
        return False
    return loop.method == "symmetrical-optimum" and "spread" not in loop.model_fields_set


@about("control")
def read_control(
    section: ControlSection,
    machine: Machine,
    inverter: Inverter,
    i_max: float,
    rated_speed: float | None,
    reading: Reading,
    *,
    any_back_emf: bool,
) -> ControlSettings:
    """Controllers in SI units, with the bases that the file leaves open.

    ``i_max`` in A (peak) is the current limit of the drive, ``rated_speed`` in rad/s (mechanical)
    that of the machine, if known; ``any_back_emf`` as of `read_bases`. Gains are taken as required,
    see `read_gain_wish`.
    """
    f_s = si_of(section.sampling_frequency)
    if f_s is None:
        f_s = inverter.f_sw
        reading.remarks.append(
            "control.sampling_frequency is taken as the switching frequency, "
            f"{format_quantity(f_s, 'Hz')}"
        )
    warning = sampling_warning(machine, f_s)
    reading.remarks.extend([warning] if warning else [])
    speed_loop, observer = section.speed_loop, section.observer
    bases = read_bases(
        section.per_unit, machine, inverter, i_max, rated_speed, reading, any_back_emf=any_back_emf
    )
    largest = bases.speed if machine.omega_m_max is None else machine.omega_m_max
    own_loop = (
        None
        if speed_loop is None
        else settings_from(
            SpeedLoopSettings,
            speed_loop,
            measurement=read_measurement(speed_loop.measurement, largest),
        )
    )
    own_observer = None if observer is None else settings_from(ObserverSettings, observer)
    tolerances = read_tolerances(
        section.tolerances, speed_loop is not None, machine, inverter, i_max, reading
    )
    if own_loop is not None and own_observer is not None and _left_open(section):
        own_loop, own_observer = chosen_together(
            own_loop, own_observer, inverter, tolerances, reading
        )
    return ControlSettings(
        t_s=1.0 / f_s,
        current_loop=settings_from(CurrentLoopSettings, section.current_loop),
        speed_loop=own_loop,
        observer=own_observer,
        bases=bases,
        tolerances=tolerances,
        references=read_references(section.references),
        firmware=read_firmware(section.firmware),
        six_step=read_six_step(section.six_step, None if observer is None else observer.method),
        start_up=_read_start_up(section.start_up, reading),
    )


def _read_start_up(
    section: StartUpWithObserverSection | None, reading: Reading
) -> StartUpSettings | None:
    """The start, with the settings of its own observer."""
    own = None if section is None else section.observer
    low = None if own is None else settings_from(ObserverSettings, own)
    return read_start_up(section, reading, observer=low)


def read_gain_wish(
    section: ControlSection, named: bool, needed: bool, document: YamlDocument
) -> GainWish:
    """Whether the design can do without gains, checked against what needs them.

    ``named`` says that the file has the section, ``needed`` that something else of the design
    needs gains. Raises `InputError` with a position.
    """
    if section.gains:
        return "required" if named or needed else "optional"
    wants = (section.speed_loop, section.observer, section.tolerances)
    if needed or section.current_loop.schedule or any(part is not None for part in wants):
        raise document.error(
            "control.gains is false, but the speed loop, observer, schedule, tolerances, "
            "export.control or simulation of this design need gains; leave it out, or those",
            ("control", "gains"),
        )
    return "none"
