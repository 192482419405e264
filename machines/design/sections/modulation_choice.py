"""Reading of the section on the choice of modulator and switching frequency."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field

from dqforge.machines.design.design import Reading
from dqforge.machines.design.settings import (
    ChoiceSettings,
    ModulatorList,
    bare_speed_hint,
    settings_from,
)
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.dq_machines.synchronous import Machine
from dqforge.machines.entries.kinds import (
    Current,
    Listing,
    Rate,
    Ratio,
    ResistanceRatio,
    Section,
    Share,
    Speed,
    Temperature,
)
from dqforge.machines.entries.rules import si_of
from dqforge.machines.names import (
    Strategy,
)
from dqforge.machines.units.quantities import format_quantity

_CHOICE = ChoiceSettings(f_min=1.0, f_max=1.0, omega_m=1.0)


class BandSection(Section):
    """A band of frequencies."""

    min: Rate = Field(description="its lower end (Hz)")
    max: Rate = Field(description="its upper end (Hz)")


class ChoiceSection(Section):
    """Modulator and switching frequency of least loss over torque and speed, and a rule
    for the firmware.
    """

    min_frequency: Rate = Field(description="least switching frequency (Hz), for noise and control")
    max_frequency: Rate = Field(description="largest switching frequency (Hz)")
    avoid: Annotated[Listing[BandSection], Field(max_length=10)] = Field(
        default=(),
        description=(
            "bands of switching frequencies that are not used, a list of {min: ..., max: ...}"
        ),
    )
    modulations: ModulatorList = Field(
        default=_CHOICE.modulations, description="modulators to choose from; default all"
    )
    strategy: Strategy | None = Field(
        default=None, description="whose currents flow; default operation.strategy"
    )
    speed: Speed | None = Field(
        default=None,
        description="largest mechanical speed (rad/s; write rpm); default machine.max_speed",
    )
    ripple_current: Current | None = Field(
        default=None, description="largest ripple of a phase current (A, r.m.s.); default: any"
    )
    ripple_share: Share | None = Field(
        default=None,
        description="the same as a share of the r.m.s. current limit (write 2 %), instead",
    )
    max_junction_temperature: Temperature | None = Field(
        default=None,
        description=(
            "largest junction temperature (degC, also without a unit); default the device's"
        ),
    )
    carrier_ratio: Ratio | None = Field(
        default=None,
        description="least number of carrier periods in an electrical period; default 20",
    )
    ripple_resistance: ResistanceRatio | None = Field(
        default=None,
        description=(
            "winding resistance at the switching frequency over that of the fundamental; default 1"
        ),
    )
    torques: int = Field(default=_CHOICE.torques, ge=2, le=60, description="torques of the grid")
    speeds: int = Field(default=_CHOICE.speeds, ge=2, le=60, description="speeds of the grid")
    frequencies: int = Field(
        default=_CHOICE.frequencies,
        ge=2,
        le=16,
        description="switching frequencies that the search for a rule begins with",
    )
    questions: int = Field(
        default=_CHOICE.questions,
        ge=0,
        le=2,
        description="questions that the rule in the header may ask",
    )


_SECTION = "modulation_choice"


def read_choice(
    section: ChoiceSection | None,
    strategy: Strategy,
    inverter: Inverter,
    machine: Machine,
    i_max: float,
    reading: Reading,
) -> ChoiceSettings | None:
    """Choice of modulator and switching frequency, None where the file asks for none.

    Args:
        section, strategy: The section, and the strategy of the design.
        inverter, machine, reading: The drive, and where remarks go.
        i_max: Current limit in A (peak), to which a share of the ripple refers.

    Raises:
        InputError: The inverter has no device, a range is empty, a modulator is named twice, the
            ripple is given twice, or nothing tells the largest speed.
    """
    if section is None:
        return None
    document = reading.document
    if inverter.device is None:
        message = f"{_SECTION} needs the switch; write the section inverter.device"
        raise document.error(message, (_SECTION,), key=True)
    _check(section, reading)
    return settings_from(
        ChoiceSettings,
        section,
        f_min=section.min_frequency.si,
        f_max=section.max_frequency.si,
        omega_m=_speed(section, machine, reading),
        strategy=strategy if section.strategy is None else section.strategy,
        bands=tuple((band.min.si, band.max.si) for band in section.avoid),
        ripple_max=_ripple(section, i_max, reading),
        junction_max=si_of(section.max_junction_temperature),
    )


def _check(section: ChoiceSection, reading: Reading) -> None:
    document = reading.document
    low, high = section.min_frequency, section.max_frequency
    if low.si > high.si:
        message = (
            f"{_SECTION}.max_frequency: {high.text} lies below min_frequency {low.text}; exchange "
            "them"
        )
        raise document.error(message, (_SECTION, "max_frequency"))
    for index, name in enumerate(section.modulations):
        if name in section.modulations[:index]:
            message = f"{_SECTION}.modulations: '{name}' is listed twice; remove one"
            raise document.error(message, (_SECTION, "modulations", index))
    for index, band in enumerate(section.avoid):
        if band.min.si >= band.max.si:
            message = (
                f"{_SECTION}.avoid[{index}]: max {band.max.text} does not lie above min "
                f"{band.min.text}"
            )
            raise document.error(f"{message}; exchange them", (_SECTION, "avoid", index, "max"))
        if band.min.si < low.si and band.max.si > high.si:
            message = (
                f"{_SECTION}.avoid[{index}] leaves nothing from {low.text} to {high.text}; make it "
                "narrower"
            )
            raise document.error(message, (_SECTION, "avoid", index, "min"))
    if section.ripple_current is not None and section.ripple_share is not None:
        message = f"{_SECTION}: ripple_current and ripple_share say the same; keep one"
        raise document.error(message, (_SECTION, "ripple_share"), key=True)


def _ripple(section: ChoiceSection, i_max: float, reading: Reading) -> float | None:
    """Largest ripple in A (r.m.s.)."""
    share = si_of(section.ripple_share)
    if share is None:
        return si_of(section.ripple_current)
    if share == 0.0:
        message = f"{_SECTION}.ripple_share: no inverter is without ripple; write e.g. 2 %"
        raise reading.document.error(message, (_SECTION, "ripple_share"))
    ripple = share * i_max / math.sqrt(2.0)
    shown = format_quantity(ripple, "A")
    reading.remarks.append(
        f"{_SECTION}.ripple_share permits {shown} (r.m.s.): of the current limit over sqrt(2)"
    )
    return ripple


def _speed(section: ChoiceSection, machine: Machine, reading: Reading) -> float:
    """Largest speed in rad/s."""
    given, most, document = si_of(section.speed), machine.omega_m_max, reading.document
    if given is None:
        if most is None:
            message = f"{_SECTION}: the largest speed is unknown; write speed: 6000 rpm here"
            raise document.error(message, (_SECTION,), key=True)
        reading.remarks.append(
            f"{_SECTION}.speed is {format_quantity(most, 'rpm')}: machine.max_speed"
        )
        return most
    if section.speed is not None and most is not None and given > most * (1.0 + 1e-9):
        shown = (
            f"{format_quantity(given, 'rpm')} is above machine.max_speed "
            f"{format_quantity(most, 'rpm')}"
        )
        raise document.error(
            f"{_SECTION}.speed: {shown}; {bare_speed_hint(section.speed)}", (_SECTION, "speed")
        )
    return given
