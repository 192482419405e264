"""Reading of the section on the choice of modulator and switching frequency."""

from __future__ import annotations

import math

from dqforge.machines.checks import si_of
from dqforge.machines.quantities import format_quantity
from dqforge.machines.reading import Reading
from dqforge.machines.schema import ChoiceSection, DesignFile
from dqforge.machines.settings import ChoiceSettings
from dqforge.machines.speed_remarks import bare_speed_hint
from dqforge.machines.synchronous import Machine

_SECTION = "modulation_choice"


def read_choice(sections: DesignFile, machine: Machine, i_max: float, reading: Reading) -> ChoiceSettings | None:
    """Choice of modulator and switching frequency, None where the file asks for none.

    Parameters
    ----------
    sections, machine, reading:
        The file, the machine in it, and where remarks go.
    i_max:
        Current limit in A (peak), to which a share of the ripple refers.

    Raises
    ------
    InputError
        The inverter has no device, a range is empty, a modulator is named twice, the ripple is given twice, or nothing
        tells the largest speed.
    """
    section = sections.modulation_choice
    if section is None:
        return None
    document = reading.document
    if sections.inverter.device is None:
        message = f"{_SECTION} needs the switch; write the section inverter.device"
        raise document.error(message, (_SECTION,), key=True)
    _check(section, reading)
    default = ChoiceSettings(section.min_frequency.si, section.max_frequency.si, 1.0)
    ratio, resistance = si_of(section.carrier_ratio), si_of(section.ripple_resistance)
    return ChoiceSettings(
        f_min=default.f_min,
        f_max=default.f_max,
        omega_m=_speed(section, machine, reading),
        strategy=sections.operation.strategy if section.strategy is None else section.strategy,
        modulations=section.modulations,
        bands=tuple((band.min.si, band.max.si) for band in section.avoid),
        ripple_max=_ripple(section, i_max, reading),
        junction_max=si_of(section.max_junction_temperature),
        carrier_ratio=default.carrier_ratio if ratio is None else ratio,
        ripple_resistance=default.ripple_resistance if resistance is None else resistance,
        torques=section.torques,
        speeds=section.speeds,
        frequencies=section.frequencies,
        questions=section.questions,
    )


def _check(section: ChoiceSection, reading: Reading) -> None:
    document = reading.document
    low, high = section.min_frequency, section.max_frequency
    if low.si > high.si:
        message = f"{_SECTION}.max_frequency: {high.text} lies below min_frequency {low.text}; exchange them"
        raise document.error(message, (_SECTION, "max_frequency"))
    for index, name in enumerate(section.modulations):
        if name in section.modulations[:index]:
            message = f"{_SECTION}.modulations: '{name}' is listed twice; remove one"
            raise document.error(message, (_SECTION, "modulations", index))
    for index, band in enumerate(section.avoid):
        if band.min.si >= band.max.si:
            message = f"{_SECTION}.avoid[{index}]: max {band.max.text} does not lie above min {band.min.text}"
            raise document.error(f"{message}; exchange them", (_SECTION, "avoid", index, "max"))
        if band.min.si < low.si and band.max.si > high.si:
            message = f"{_SECTION}.avoid[{index}] leaves nothing from {low.text} to {high.text}; make it narrower"
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
    reading.remarks.append(f"{_SECTION}.ripple_share permits {shown} (r.m.s.): of the current limit over sqrt(2)")
    return ripple


def _speed(section: ChoiceSection, machine: Machine, reading: Reading) -> float:
    """Largest speed in rad/s."""
    given, most, document = si_of(section.speed), machine.omega_m_max, reading.document
    if given is None:
        if most is None:
            message = f"{_SECTION}: nothing tells the largest speed; write speed: 6000 rpm here"
            raise document.error(message, (_SECTION,), key=True)
        reading.remarks.append(f"{_SECTION}.speed is {format_quantity(most, 'rpm')}: machine.max_speed")
        return most
    if section.speed is not None and most is not None and given > most * (1.0 + 1e-9):
        shown = f"{format_quantity(given, 'rpm')} is above machine.max_speed {format_quantity(most, 'rpm')}"
        raise document.error(f"{_SECTION}.speed: {shown}; {bare_speed_hint(section.speed)}", (_SECTION, "speed"))
    return given
