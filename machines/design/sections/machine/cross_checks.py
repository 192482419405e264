"""Checks of the machine as a whole: against its name plate, and of kept halves against the fit."""

from __future__ import annotations

from dqforge.machines.design import design as datasheet
from dqforge.machines.design.design import ROUNDING_OF_DATA
from dqforge.machines.design.sections.fit import FitSection
from dqforge.machines.design.sections.machine.schema import MachineSection
from dqforge.machines.design.settings import bare_speed_hint
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine, largest_torque_within
from dqforge.machines.entries.rules import si_of
from dqforge.machines.files.positioned_yaml import YamlDocument
from dqforge.machines.units.quantities import format_quantity


def check_machine(section: MachineSection, machine: Machine, document: YamlDocument) -> None:
    """Check the machine as a whole against its name plate; raises `InputError` with a position."""
    if isinstance(machine, LinearMachine) and machine.psi_pm == 0.0 and machine.l_d == machine.l_q:
        raise document.error(
            "machine: no magnet flux and inductance_d equal to inductance_q, so it gives no "
            "torque; write magnet_flux or two different inductances",
            ("machine", "inductance_q"),
        )
    rated = section.rated
    torque, speed, power, frequency = map(
        si_of, (rated.torque, rated.speed, rated.power, rated.frequency)
    )
    if frequency is not None and speed is not None:
        with document.at(("machine", "rated", "frequency")):
            datasheet.check_rated_frequency(machine.pole_pairs, frequency, speed)
    if power is not None and torque is not None and speed is not None:
        with document.at(("machine", "rated", "power")):
            datasheet.check_rated_power(power, torque, speed)
    if rated.current is not None:
        current = datasheet.peak_current(
            rated.current.si, rated.current.kind or "", section.connection
        )
        _check_rated_current(current, machine, document)
    if torque is not None:
        with document.at(("machine", "rated", "torque")):
            datasheet.check_rated_torque(torque, largest_torque_within(machine, machine.i_max))
    most = machine.omega_m_max
    if (
        rated.speed is not None
        and most is not None
        and rated.speed.si > most * (1.0 + ROUNDING_OF_DATA)
    ):
        hint = bare_speed_hint(rated.speed)
        message = (
            f"machine.rated.speed {format_quantity(rated.speed.si, 'rpm')} is above max_speed; "
            f"{hint}"
        )
        raise document.error(message, ("machine", "rated", "speed"))


def _check_rated_current(current: float, machine: Machine, document: YamlDocument) -> None:
    if current <= machine.i_max * (1.0 + ROUNDING_OF_DATA):
        return
    raise document.error(
        f"machine.rated.current is {format_quantity(current, 'A')} peak, above max_current "
        f"{format_quantity(machine.i_max, 'A')} peak; check the kinds (peak or rms) of both",
        ("machine", "rated", "current"),
    )


def check_halves(machine: MachineSection, fit: FitSection, document: YamlDocument) -> None:
    """Refuse what cannot keep the halves of a flux map apart."""
    section = machine.flux_map
    if section is None or section.symmetry != "keep":
        return
    budget = any(part is not None for part in (fit.torque_error, fit.loss_penalty, fit.flash))
    if budget or fit.format in ("q15", "q31"):
        raise document.error(
            "machine.flux_map.symmetry: keep needs references in float32 of a given form; write "
            "fit: format: float32 and leave the budget out, or symmetry: average",
            ("machine", "flux_map", "symmetry"),
        )
